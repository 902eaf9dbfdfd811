"""What the page of a diagnosis shows: traces, curves, maps, evidence, look-alikes, possible recordings."""

from typing import Any

import numpy as np

from galen_hw.diagnosis.findings.localisation import baseline_residual, organised
from galen_hw.diagnosis.findings.variables import variables
from galen_hw.diagnosis.identifiability.experiment import options_of
from galen_hw.diagnosis.identifiability.rivals import rivals
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.report.effect_curves import curves_of
from galen_hw.diagnosis.report.plot_data import Alike, Along, Evidence, Option, Traces
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array


def traces_of(work: Work) -> Traces:
    """Return everything that the page draws."""
    bench, scene, before = work.bench, work.bench.scene, baseline_residual(work.model)
    advice = options_of(work.model, work.selection, work.diagnosis.findings)[: CAPS.alike]
    return Traces(
        time=bench.time,
        clock=scene.clock,
        channels=tuple(scene.channels),
        units=tuple(scene.units),
        before=before,
        after=work.model.residual(),
        held_out=np.asarray(bench.held_out),
        along=_along(work, before),
        plane=_plane(work, before),
        curves=curves_of(work),
        evidence=_evidence(work),
        alike=_alike(work),
        options=[Option(a.recipe.name, a.minutes, a.angle) for a in advice],
    )


def _along(work: Work, before: Array, *, least: float = 0.1) -> list[Along]:
    """Return the variables that explain the excess best, one picture a variable, with the region where one was found.

    Args:
        least: share of the excess from which a variable is worth a picture.
    """
    if work.diagnosis.verdict == "agrees":
        return []
    names, regions = work.bench.scene.channels, {w["variable"]: w["range"] for w in work.diagnosis.where}
    out = []
    for v, share, channel in organised(work.bench, variables(work.bench), before):
        region = regions.get(v.name)
        whole = region is None or (region[0] <= v.values.min() and region[1] >= v.values.max())
        inside = None if whole or region is None else (float(region[0]), float(region[1]))
        if share > least or inside is not None:
            out.append(Along(v.label, v.unit, names.index(channel), v.values, share, inside))
    return out[: CAPS.alike]


def _plane(work: Work, before: Array) -> tuple[tuple[str, str, Array], tuple[str, str, Array]] | None:
    """Return the two variables of motion, of two joints where possible, that explain the excess best."""
    motion = (".position", ".velocity")
    known = [v for v in variables(work.bench) if v.name.endswith(motion) and v.about in work.bench.scene.moved]
    order = [v for v, _, _ in organised(work.bench, known, before)]
    if len(order) < 2 or work.diagnosis.verdict == "agrees":
        return None
    a = order[0]
    b = next((v for v in order[1:] if v.about != a.about), order[1])
    return (a.label, a.unit, a.values), (b.label, b.unit, b.values)


def _alike(work: Work) -> list[Alike]:
    """Return the nearest look-alikes of every finding, told apart or not."""
    out = []
    for finding in work.diagnosis.findings:
        tied = {c.effect for c in finding.rivals}
        near = rivals(work.selection, finding, everyone=True)
        shown = [Alike(finding.effect, r.key, r.angle, r.nearest, 0.5 * r.lead, r.key not in tied) for r in near]
        known = {one.rival for one in shown}
        nan = float("nan")
        shown += [Alike(finding.effect, key, nan, nan, nan, apart=False) for key in tied - known]
        out += sorted(shown, key=lambda one: one.apart)[: CAPS.alike]
    return out


def _evidence(work: Work) -> list[Evidence]:
    """Return the best hypothesis of every family before anything was chosen, strongest first."""
    selection, model = work.selection, work.model
    rows: list[Evidence] = []
    seen: set[tuple[Any, ...]] = set()
    kept = {_place(h.effect) for h in model.effects if h.effect is not None}
    refused = {_place(e): paid for e, paid in selection.refused}
    for i in sorted(selection.first, key=lambda i: -selection.first[i].rank):
        effect = selection.scorer.library[i].effect
        if effect is None or _place(effect) in seen or len(rows) == CAPS.evidence:
            continue
        seen.add(_place(effect))
        score = selection.first[i]
        where = ", ".join(effect.joints) or str(getattr(effect, "channel", "") or "")
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
