"""One recording from residual to verdict."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from galen_hw.diagnosis import adequacy, seek
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.confusion import confusions
from galen_hw.diagnosis.experiment import next_experiment
from galen_hw.diagnosis.final import Model, merit, offsets, settle_model
from galen_hw.diagnosis.findings import findings_of, unknown_finding
from galen_hw.diagnosis.guards import Premise, premises
from galen_hw.diagnosis.judge import Judged, judge
from galen_hw.diagnosis.locate import channels_of, episodes_of, where_of
from galen_hw.diagnosis.result import Diagnosis, Finding, Verdict
from galen_hw.diagnosis.rows import Mask
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.select import Selection, at_first_sight, library, select
from galen_hw.physics.event_effects import Glitches
from galen_hw.physics.scene import Scene
from galen_hw.physics.table import effect_class
from galen_hw.spatial import Array


@dataclass
class Work:
    """What the diagnosis went through, for reports and tests."""

    bench: Bench
    selection: Selection
    model: Model
    judged: Judged
    left: list[adequacy.Left]
    diagnosis: Diagnosis
    glitches: list[Finding] = field(default_factory=list)


Progress = Callable[[str, float], None]
"""Told what is being done and which share (0 to 1) of the whole is behind."""


def diagnose(
    scene: Scene,
    *,
    name: str = "",
    holdout: Scene | None = None,
    share: float = 0.3,
    seed: int = 0,
    progress: Progress | None = None,
) -> Work:
    """Locate, name, model and judge.

    Args:
        scene: the recording.
        name: how it is called in the answer.
        holdout: a second recording to be judged on; else `share` of contiguous blocks is set aside.
        seed: of the choice of blocks.
        progress: told how far the work is.

    Raises:
        UsageError: the recording cannot be compared at all.
    """
    tell = progress or _silent
    tell("checking the recording", 0.0)
    premise = premises(scene)
    scene = premise.scene
    bench = Bench(scene, 0.0 if holdout is not None else share, seed)
    glitch = _glitches(bench)
    tell("simulating every effect", 0.1)
    effects = library(bench)
    columns = [bench.raw(effect) for effect in effects]
    generic = adequacy.compact(bench)
    tell("learning the noise", 0.25)
    bench.learn_noise(columns, [*generic, *(bench.raw(s.effect) for s in at_first_sight(bench))])
    hypotheses = [bench.made(e, raw) for e, raw in zip(effects, columns, strict=True)]
    tell("choosing effects", 0.4)
    selection, model = _chosen(bench, hypotheses, blind=bool(premise.wrong))
    tell("judging on held-out data", 0.8)
    judged = judge(model, holdout)
    tell("looking at what is left", 0.85)
    left = adequacy.leftovers(bench, model.parts, model.rest(), model.rest(white=True))
    diagnosis = _said(model, selection, judged, left, premise, glitch, name)
    diagnosis.holdout = judged.name
    tell("done", 1.0)
    return Work(bench, selection, model, judged, left, diagnosis)


def _silent(stage: str, share: float) -> None:
    del stage, share


def _chosen(bench: Bench, hypotheses: list[Hypothesis], *, blind: bool) -> tuple[Selection, Model]:
    """The better of two searches.

    With offsets always in the model and judged at the end (a drift is not called an offset), and with offsets among the
    hypotheses (a constant error of geometry is not called one).
    """
    if blind:
        nothing = Selection(Scorer(bench, hypotheses))
        return nothing, settle_model(bench, nothing.scorer, nothing)
    selection = select(bench, Scorer(bench, hypotheses))
    model = settle_model(bench, selection.scorer, selection)
    own = offsets(bench)
    if not own:
        return selection, model
    y, timing = bench.y, bench.timing
    bench.y, bench.timing = bench.whole, []
    other = select(bench, Scorer(bench, [*own, *hypotheses], free=False))
    rival = settle_model(bench, other.scorer, other)
    if merit(rival) > merit_of(model, y) + 6.0:
        return other, rival
    bench.y, bench.timing = y, timing
    return selection, model


def merit_of(model: Model, y: Array) -> float:
    """Merit of a model on the residual that it was made for."""
    bench = model.bench
    now, bench.y = bench.y, y
    try:
        return merit(model)
    finally:
        bench.y = now


def _glitches(bench: Bench) -> list[Glitches]:
    """Marks isolated samples and leaves them out of everything."""
    marked = seek.spikes(bench.scene.residual, tuple(bench.scene.segments))
    spoilt = np.asarray(marked.any(axis=1))
    rows = np.flatnonzero(spoilt)
    if len(rows) < 3 and not _far(marked):
        return []
    bench.dropped = bench.rows.spread(spoilt)
    bench.whole = np.where(bench.dropped[:, None], np.nan, bench.whole)
    for c in range(bench.width):
        good = np.isfinite(bench.whole[:, c])
        bench.whole[:, c] = np.interp(np.arange(len(good)), np.flatnonzero(good), bench.whole[good, c])
    bench.y = bench.whole
    names = tuple(n for n, m in zip(bench.scene.channels, np.asarray(marked.any(axis=0)), strict=True) if m)
    return [Glitches(names, tuple(int(r) for r in rows))]


def _far(marked: Mask) -> bool:
    return bool(marked.any()) and int(marked.any(axis=1).sum()) >= 2


def _said(
    model: Model,
    selection: Selection,
    judged: Judged,
    left: list[adequacy.Left],
    premise: Premise,
    glitch: list[Glitches],
    name: str,
) -> Diagnosis:
    bench = model.bench
    findings = [f for f in findings_of(model, selection, judged, glitch) if _supported(f, judged)]
    for finding in findings:
        finding.confounded_with = confusions(model, selection, finding)
    rest = _strong(left, judged, bench)
    if premise.wrong or rest:
        findings.append(unknown_finding(bench, rest, premise))
    verdict = _verdict(findings, rest, premise)
    advice = next_experiment(model, selection, findings, rest)
    notes = list(premise.notes)
    if verdict == "agrees":
        notes.append(_limit(bench))
    return Diagnosis(
        recording=name,
        holdout="",
        predict=bench.scene.observations.predict,
        verdict=verdict,
        channels=channels_of(bench, judged),
        where=where_of(model) if findings else [],
        when=episodes_of(model, glitch) if findings else [],
        findings=findings,
        fit=judged.fit(bench, left),
        next_experiment=advice,
        notes=notes,
        terms=[
            h.effect.to_term(bench.scene, model.final[s])
            for h, s in zip(model.parts, model.slices(), strict=True)
            if h.effect is not None
        ],
    )


LEAST_GAIN = 0.002


def _supported(finding: Finding, judged: Judged) -> bool:
    """Nothing is claimed that held-out data do not support; what belongs to moments cannot show in another recording."""
    if finding.effect == "glitches":
        return True
    gain = finding.evidence["heldout_gain"]
    elsewhere = judged.name == "another recording" and effect_class(finding.effect).EPISODIC
    return gain > (-LEAST_GAIN if elsewhere else LEAST_GAIN)


def _strong(left: list[adequacy.Left], judged: Judged, bench: Bench) -> list[adequacy.Left]:
    """Leftovers that are worth saying: above chance, and not a trifle beside what was found or the noise."""
    out = []
    for one in left:
        if not 0.0 < one.share <= 1.0:
            continue  # it does not explain the rows that it was judged on
        size = float(np.mean(one.predicted**2))
        before = float(judged.before[one.channel] - bench.noise.sigma[one.channel] ** 2)
        # A rounded reading follows its signal in part: a fifth of the rounding's variance is no physics.
        rounding = 0.2 * float(bench.steps[one.channel]) ** 2 / 12.0
        if size > max(0.01 * bench.noise.sigma[one.channel] ** 2, rounding) and size > 0.03 * before:
            out.append(one)
    return out


def _verdict(findings: list[Finding], rest: list[adequacy.Left], premise: Premise) -> Verdict:
    named = [f for f in findings if f.effect != "unknown"]
    if premise.wrong:
        return "unexplained"
    if not named:
        return "unexplained" if rest else "agrees"
    return "partly_explained" if rest else "explained"


def _limit(bench: Bench) -> str:
    """The smallest effect that would have been seen, in words."""
    rows = max(int(bench.train.sum()), 1)
    least = np.sqrt(2.0 * 14.0 / rows) * bench.noise.sigma
    worst = ", ".join(f"{n} {v:.2g}" for n, v in zip(bench.scene.channels, least, strict=True))
    return f"an effect of this rms in one channel would have been seen: {worst}"
