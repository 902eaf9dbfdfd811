"""From hypotheses to findings: one for each key, with all its channels, joints and parameters."""

from typing import TYPE_CHECKING

import numpy as np

from galen_hw.diagnosis.adequacy import Left
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.guards import Premise
from galen_hw.diagnosis.judge import Judged
from galen_hw.diagnosis.result import Finding, Value
from galen_hw.diagnosis.select import CHANCE, Selection
from galen_hw.diagnosis.words import SAYS
from galen_hw.physics.event_effects import Glitches

if TYPE_CHECKING:
    from galen_hw.spatial import Array


def findings_of(model: Model, selection: Selection, judged: Judged, glitch: list[Glitches]) -> list[Finding]:
    """All findings, most certain and largest first."""
    by_key: dict[str, list[Hypothesis]] = {}
    for h in model.effects:
        assert h.effect is not None, "effects, not nuisances"
        by_key.setdefault(h.effect.KEY, []).append(h)
    out = [_finding(model, selection, judged, key, parts) for key, parts in by_key.items()]
    out.sort(key=lambda f: -f.evidence["score"])
    return out + [_glitch(model.bench, g) for g in glitch]


def _finding(model: Model, selection: Selection, judged: Judged, key: str, parts: list[Hypothesis]) -> Finding:
    bench = model.bench
    where = dict(zip(map(id, model.parts), model.slices(), strict=True))
    energy = np.zeros(bench.width)
    parameters: dict[str, Value] = {}
    for n, h in enumerate(parts):
        s = where[id(h)]
        signal = np.zeros((len(bench.rows), bench.width))
        signal[:, list(h.raw.channels)] = h.raw.values @ model.final[s]
        energy += (
            np.mean((signal - signal.mean(axis=0)) ** 2 + (key in ("bias", "joint_offset")) * signal**2, axis=0)
            / bench.noise.sigma**2
        )
        parameters |= _parameters(model, h, s, prefix=_prefix(bench, h) if len(parts) > 1 else "", number=n)
    channels = [bench.scene.channels[c] for c in np.argsort(-energy) if energy[c] > 0.02 * energy.max()]
    joints = list(dict.fromkeys(j for h in parts if h.effect is not None for j in h.effect.joints))
    score, surprise = _evidence(model, selection, parts)
    gain = judged.gain(key)
    chance = float(min(1.0, CHANCE * np.exp(np.clip(selection.needed - surprise, -650.0, 6.0))))
    place = f" ({', '.join(joints)})" if joints else ""
    says = f"{SAYS[key][0].upper()}{SAYS[key][1:]}{place}. On held-out data it takes {100 * gain:.0f} % of the excess."
    evidence = {"heldout_gain": gain, "score": score, "false_alarm_probability": chance}
    return Finding(key, channels, joints, says, parameters, evidence)


def _prefix(bench: Bench, h: Hypothesis) -> str:
    effect = h.effect
    place = getattr(effect, "channel", "") or getattr(effect, "joint", "")
    del bench
    return f"{place}: " if place else ""


def _parameters(model: Model, h: Hypothesis, s: slice, prefix: str, number: int) -> dict[str, Value]:
    bench, effect = model.bench, h.effect
    assert effect is not None, "effects, not nuisances"
    spread = np.sqrt(np.maximum(np.diag(model.covariance)[s], 0.0))
    named = zip(effect.parameters(bench.scene), model.final[s], spread, strict=True)
    mark = prefix or (f"{number + 1}: " if number else "")
    out = {f"{mark}{p.name}": Value(float(v), float(d), p.unit) for p, v, d in named}
    for name, value in effect.searched().items():
        out[f"{mark}{name}"] = Value(value, _searched_spread(model, h, s, name, value), effect.SEARCHED[name].unit)
    if hasattr(effect, "moment"):
        out[f"{mark}moment"] = Value(float(effect.moment), 0.0, "s")
    return out


def _searched_spread(model: Model, h: Hypothesis, s: slice, name: str, value: float) -> float:
    """From the curvature of the fit along the searched value, the linear parameters following."""
    bench, effect = model.bench, h.effect
    assert effect is not None, "effects, not nuisances"
    step = 1e-3 * value if name in ("frequency", "wave_number") else 0.02 * value
    step = 1e-6 * value if name == "frequency" else step
    up, down = (bench.add(effect.with_searched({name: value + sign * step})) for sign in (1.0, -1.0))
    channels = list(h.white.channels)
    slope = ((up.white.values - down.white.values) @ model.final[s] / (2.0 * step)).reshape(-1)
    own = h.white.values.reshape(-1, h.count)
    ones = np.eye(len(channels))[np.tile(np.arange(len(channels)), len(bench.rows))]
    X = np.concatenate([own, ones], axis=1)
    X = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    left = slope - X @ np.linalg.lstsq(X, slope, rcond=1e-9)[0]
    information = float(left @ left)
    rest = model.rest(white=True)[bench.train][:, channels]
    return float(np.sqrt(max(float(np.mean(rest**2)), 1.0) / information)) if information > 0 else float(value)


def _evidence(model: Model, selection: Selection, parts: list[Hypothesis]) -> tuple[float, float]:
    """Score and surprise of a finding: of its parts together, or the z of a constant."""
    scorer, score, surprise = selection.scorer, 0.0, 0.0
    for i, h in zip(selection.chosen, selection.hypotheses, strict=True):
        if any(h is p for p in parts) and i in selection.evidence:
            score += selection.evidence[i].rank
            surprise = max(surprise, selection.evidence[i].surprise)
    if score == 0.0:
        where = dict(zip(map(id, model.parts), model.slices(), strict=True))
        for h in parts:
            s = where[id(h)]
            gain = float(np.sum(model.final[s] ** 2 / np.maximum(np.diag(model.covariance)[s], 1e-300)))
            score += gain
            surprise = max(surprise, 0.5 * gain)
    del scorer
    return float(score), float(surprise)


def _glitch(bench: Bench, glitch: Glitches) -> Finding:
    rows: Array = np.asarray(glitch.rows)
    places = [bench.scene.channels.index(name) for name in glitch.channels]
    size = float(np.median(np.abs(bench.scene.residual[rows][:, places]).max(axis=1)))
    share = len(rows) / max(len(bench.scene), 1)
    return Finding(
        "glitches",
        list(glitch.channels),
        [],
        f"{len(rows)} isolated samples stand far off their neighbours; they are left out of every fit.",
        {"count": Value(float(len(rows)), 0.0, "1"), "size": Value(size, 0.0, bench.scene.units[places[0]])},
        {"heldout_gain": float(1.0 - share), "score": 40.0 * len(rows), "false_alarm_probability": 1e-9},
    )


def unknown_finding(bench: Bench, left: list[Left], premise: Premise) -> Finding:
    """What nothing named explains."""
    names = bench.scene.channels
    channels = list(dict.fromkeys([*premise.channels, *(names[one.channel] for one in left)]))
    if premise.wrong:
        says, share, z = premise.wrong[0], 0.0, 10.0
    else:
        best = left[0]
        says = f"Structure is left that no named effect explains: it depends on {best.kind} in {names[best.channel]}."
        share, z = best.share, best.z
    evidence = {"heldout_gain": 0.0, "score": float(z), "false_alarm_probability": 2e-4}
    return Finding("unknown", channels, [], says, {"share_left": Value(float(share), 0.0, "1")}, evidence)
