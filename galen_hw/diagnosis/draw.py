"""From the work of a diagnosis to what its page shows: traces, each effect's own curve, the table of evidence."""

from typing import Any

import numpy as np

from galen_hw.diagnosis.engine import Work
from galen_hw.diagnosis.traces import Curve, Evidence, Traces
from galen_hw.physics.effect import Effect
from galen_hw.spatial import Array

MOST_EVIDENCE = 30
AGAINST_SPEED = ("friction",)
AGAINST_POSITION = (
    "hysteresis",
    "backlash",
    "torque_ripple",
    "cable_drag",
    "joint_scale",
    "joint_offset",
    "compliance",
)


def traces_of(work: Work) -> Traces:
    """Everything that the page draws."""
    bench, scene = work.bench, work.bench.scene
    return Traces(
        time=bench.rows.average(scene.time),
        clock=scene.clock,
        channels=tuple(scene.channels),
        units=tuple(scene.units),
        before=bench.whole,
        after=work.model.rest(),
        held_out=np.asarray(bench.aside),
        maps=_maps(work),
        curves=_curves(work),
        evidence=_evidence(work),
    )


def _maps(work: Work) -> list[tuple[str, Array]]:
    """Positions and speeds of the joints that moved, and time."""
    bench, scene = work.bench, work.bench.scene
    out: list[tuple[str, Array]] = []
    for joint in scene.moved[:5]:
        k = scene.joint_index(joint)
        out.append((f"{joint}, position", bench.rows.average(scene.q[:, k])))
    if scene.clock:
        speeds = bench.rows.average(scene.rates[0])
        out += [(f"{joint}, speed", speeds[:, scene.joint_index(joint)]) for joint in scene.moved[:5]]
        out.append(("time, s", bench.rows.average(scene.time)))
    return [(label, x) for label, x in out if np.isfinite(x).all()]


def _curves(work: Work) -> list[Curve]:
    """One picture an effect (at most eight): in its strongest channel, all other effects taken off."""
    model, rest = work.model, work.model.rest()
    out: list[Curve] = []
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is None or len(out) == 8:
            continue
        change = h.raw.values @ model.theta[s]
        best = int(np.argmax(np.std(change, axis=0) / work.bench.noise.sigma[list(h.raw.channels)]))
        channel = h.raw.channels[best]
        out.append(_curve(work, h.effect, change[:, best], rest[:, channel], channel))
    return out


def _curve(work: Work, effect: Effect, change: Array, rest: Array, channel: int) -> Curve:
    scene, rows = work.bench.scene, work.bench.rows
    name, unit = scene.channels[channel], scene.units[channel]
    label, x, loop = ("time, s" if scene.clock else "row"), rows.average(scene.time), True
    joint = next((j for j in effect.joints if j in scene.moved), None)
    if joint is not None:
        k = scene.joint_index(joint)
        if effect.KEY in AGAINST_SPEED:
            label, x, loop = f"speed of {joint}, rad/s or m/s", rows.average(scene.rates[0][:, k]), False
        elif effect.KEY in AGAINST_POSITION:
            label, x, loop = f"position of {joint}, rad or m", rows.average(scene.q[:, k]), effect.KEY == "hysteresis"
    place = f"{effect.KEY}, {joint or name}"
    return Curve(effect.KEY, place, label, f"{name}, {unit}", x, change + rest, change, loop)


def _evidence(work: Work) -> list[Evidence]:
    """The best of every family before anything was chosen, strongest first; then what was kept."""
    selection, model = work.selection, work.model
    rows: list[Evidence] = []
    seen: set[tuple[Any, ...]] = set()
    kept = {_place(h.effect) for h in model.effects if h.effect is not None}
    refused = {_place(e): paid for e, paid in selection.refused}
    order = sorted(selection.first, key=lambda i: -selection.first[i].rank)
    for i in order:
        effect = selection.scorer.library[i].effect
        if effect is None or _place(effect) in seen or len(rows) == MOST_EVIDENCE:
            continue
        seen.add(_place(effect))
        score, where = selection.first[i], ", ".join(effect.joints) or str(getattr(effect, "channel", "") or "")
        gain = refused.get(_place(effect), float("nan"))
        outcome, reason = "not needed", "nothing of it is left beside what was kept"
        if _place(effect) in kept:
            outcome, reason = "kept", ""
        elif _place(effect) in refused:
            outcome, reason = "refused", "does not pay on blocks left out"
        elif score.surprise <= selection.needed:
            reason = "chance reaches as much"
        rows.append(Evidence(effect.KEY, where, score.rank, float(np.exp(-score.surprise)), gain, outcome, reason))
    return rows


def _place(effect: Effect) -> tuple[Any, ...]:
    return (effect.KEY, *effect.joints, str(getattr(effect, "channel", "")))
