"""One recording from residual to verdict."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis import adequacy, seek
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.confusion import confusions
from galen_hw.diagnosis.experiment import next_experiment
from galen_hw.diagnosis.final import Model, merit, offsets, settle_model, weighed
from galen_hw.diagnosis.findings import findings_of, unknown_finding
from galen_hw.diagnosis.guards import Premise, premises, quiet
from galen_hw.diagnosis.judge import Judged, judge, judge_remainder
from galen_hw.diagnosis.locate import channels_of, episodes_of, where_of
from galen_hw.diagnosis.remainder import Remainder, learn
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.rows import Mask
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.select import FLEXIBLE, at_first_sight, library, select
from galen_hw.diagnosis.selection import Selection
from galen_hw.diagnosis.verdict import beyond, strong, verdict_of
from galen_hw.diagnosis.wanted import poor
from galen_hw.physics.effect import Columns, Effect
from galen_hw.physics.event_effects import Contact, Glitches
from galen_hw.physics.scene import Scene
from galen_hw.physics.table import effect_class
from galen_hw.spatial import Array

MERIT = 6.0
"""Difference of merit from which the other of two models is taken."""
FEWEST = 2
"""Isolated samples that are a finding."""
COARSE = 3000
"""Rows of the first look: motion is slow beside a force sensor's samples."""


@dataclass
class Work:
    """What the diagnosis went through, for reports and tests; `left`: what was worth saying of what is left."""

    bench: Bench
    selection: Selection
    model: Model
    judged: Judged
    left: list[adequacy.Left]
    diagnosis: Diagnosis


Progress = Callable[[str, float], None]
"""Told what is being done and which share (0 to 1) of the whole is behind."""


# The matrices are many and small: BLAS gains nothing by threads, and beside other work they wait for one another for longer
# than they compute.
@threadpool_limits.wrap(limits=1, user_api="blas")  # type: ignore[untyped-decorator]
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
    held = 0.0 if holdout is not None else share
    holdout = None if holdout is None else quiet(holdout)
    bench, coarse = Bench(scene, held, seed), Bench(scene, held, seed, COARSE)
    glitch = _glitches(bench)
    coarse.leave_out(bench.spoilt)
    tell("simulating every effect", 0.1)
    effects = library(bench)
    columns, coarser = _columns(effects, bench, coarse)
    tell("a first look", 0.25)
    known = _first_look(bench, coarse, effects, coarser, blind=bool(premise.wrong))
    bench.stream = coarse.stream
    # What moves with the robot cannot be told from noise before it is known what is there: the first noise was too small
    # rather than too large. Now it is learnt from what the first model leaves, and everything is asked again.
    tell("learning the noise", 0.4)
    generic = adequacy.families(bench)
    bench.learn_noise((), known.columns(bench, generic))
    tell("choosing effects", 0.5)
    selection, model, left = _searched(bench, effects, columns, generic, blind=bool(premise.wrong))
    tell("judging on held-out data", 0.9)
    chosen = weighed(model)
    model, judged = _earned(chosen, holdout)
    if model is not chosen:
        left = _left(bench, generic, model)
    glitch = [] if premise.wrong else _confirmed(glitch, model)
    left = strong(left, judged, bench)
    if (left or _touches(model)) and not premise.wrong:
        model, judged, left = _predicted(generic, model, holdout, judged, left)
    diagnosis = _said(model, selection, judged, left, premise, glitch, name)
    diagnosis.holdout = judged.name
    tell("done", 1.0)
    return Work(bench, selection, model, judged, left, diagnosis)


@dataclass(frozen=True)
class _Known:
    """What a first look has found: effects (with parameters where these are not linear), generic functions by channel."""

    effects: list[tuple[Effect, Array]]
    left: dict[int, str]

    def columns(self, bench: Bench, generic: list[adequacy.Family]) -> list[Columns]:
        """On the rows of a bench: what must not pass for noise."""
        out = [bench.raw(effect) for effect, _ in self.effects]
        everywhere = tuple(range(bench.width))
        for effect, theta in self.effects:
            change = effect.exact(bench.scene, theta)
            if change is not None:
                out.append(Columns(everywhere, bench.rows.average(change)[:, :, None]))
        for channel, kind in self.left.items():
            out += [Columns((channel,), one.basis[:, None, :]) for one in generic if one.kind == kind]
        return out


def _columns(effects: list[Effect], *benches: Bench) -> tuple[list[Columns], ...]:
    """Columns of all effects on the rows of several benches of one scene, computed once."""
    out: tuple[list[Columns], ...] = tuple([] for _ in benches)
    for effect in effects:
        columns = effect.columns(benches[0].scene_of(effect))
        for bench, mine in zip(benches, out, strict=True):
            mine.append(bench.averaged(columns))
    return out


def _first_look(bench: Bench, coarse: Bench, effects: list[Effect], columns: list[Columns], *, blind: bool) -> _Known:
    """Effects and leftovers under a noise that is too small rather than too large, on few rows."""
    generic = adequacy.families(coarse)
    seen = [coarse.raw(s.effect) for s in at_first_sight(bench)]
    coarse.learn_noise(columns, [*adequacy.compact(coarse, generic), *seen], above=coarse.motion_band())
    _, model, left = _searched(coarse, effects, columns, generic, blind=blind)
    if not left and len(coarse.noise.edges):
        # What is finely structured passes for quick noise. Only blocks that it was not fitted on can tell, whatever the noise.
        coarse.noise = coarse.noise.flat()
        left = adequacy.leftovers(
            coarse, generic, [h.raw for h in model.parts], model.rest(), model.rest() / coarse.noise.sigma
        )
    parts = zip(model.parts, model.slices(), strict=True)
    chosen = [(h.effect, model.final[s]) for h, s in parts if h.effect is not None]
    return _Known(chosen, {x.channel: x.kind for x in reversed(left)})


def _searched(
    bench: Bench, effects: list[Effect], columns: list[Columns], generic: list[adequacy.Family], *, blind: bool
) -> tuple[Selection, Model, list[adequacy.Left]]:
    """The chosen model under the present noise, and what it leaves."""
    hypotheses = [bench.made(e, raw) for e, raw in zip(effects, columns, strict=True)]
    selection, model = _chosen(bench, hypotheses, blind=blind)
    return selection, model, _left(bench, generic, model)


def _left(bench: Bench, generic: list[adequacy.Family], model: Model) -> list[adequacy.Left]:
    return adequacy.leftovers(bench, generic, [h.white for h in model.parts], model.rest(), model.rest(white=True))


def _earned(model: Model, holdout: Scene | None, judged: Judged | None = None) -> tuple[Model, Judged]:
    """The model without what held-out data do not support, the least supported first; what belongs to moments shows nowhere else.

    Where a kind stands in several places (friction in five joints), each place has to earn its own.

    Args:
        judged: of a larger model, whose rows are judged on again.
    """
    while True:
        judged = judge(model, holdout, judged)
        lasting = [k for k in judged.without if not effect_class(k).EPISODIC and not effect_class(k).BRIEF]
        sole = len(judged.without) == 1
        weak = [
            (judged.support[key], key) for key in lasting if poor(judged.support[key], judged.sure[key], alone=sole)
        ]
        places = [(support, k) for k, (support, sure) in judged.places.items() if poor(support, sure, alone=False)]
        if places:
            # One place first: the kind may earn its name without it.
            out = [model.effects[min(places)[1]]]
        elif weak:
            out = [h for h in model.effects if h.effect is not None and min(weak)[1] == h.effect.KEY]
        else:
            return model, judged
        model = model.without(out)


_Rest = tuple[Model, Remainder | None]
"""A model, and what generic functions predict of what it leaves."""

YIELDING = (*FLEXIBLE, "contact")
"""Effects that bend far enough to take part of what has no name."""


def _predicted(
    generic: list[adequacy.Family], model: Model, holdout: Scene | None, judged: Judged, rest: list[adequacy.Left]
) -> tuple[Model, Judged, list[adequacy.Left]]:
    """What is left predicted without a name, where held-out data support that.

    A flexible effect has a name only if it says more than generic functions do in its place: what these explain better alone
    has none.
    """
    now, remainder = _explained(model, rest)
    judged = judge_remainder(model, holdout, judged, remainder)
    for out in _yielding(model):
        less, plainly = _earned(model.without([h for h in model.effects if id(h) in out]), holdout, judged)
        its_rest = strong(_left(model.bench, generic, less), judged, model.bench)
        reached, its_own = _explained(less, its_rest)
        touches = [h for h in _touches(model) if id(h) in out]
        # Asked of contacts alone: what else leaves with them may have been there.
        always = len(touches) == len(out) and all(
            _is_always_there(h, (model, remainder), (less, its_own)) for h in touches
        )
        if reached > now + MERIT or always:
            other = judge_remainder(less, holdout, plainly, its_own)
            # A contact is fitted to the moments that it is judged on: nothing else can do as well there.
            if always or float(np.sum(other.reached / judged.floor)) < float(np.sum(judged.reached / judged.floor)):
                return less, other, its_rest
    return model, judged, rest


FORETOLD = 0.5
"""Share of what a contact takes in its moments from which functions of the motion that foretell it make it none."""


def _is_always_there(contact: Hypothesis, whole: _Rest, less: _Rest) -> bool:
    """Whether what was taken for a contact follows from the motion, as generic functions learnt on other blocks say.

    Nobody pushes by the arm's position: a force that is there all along is loud wherever the arm goes far.

    Args:
        whole: the model with the contact and what is predicted of its rest; less: the same without the contact.
    """
    bench, channels = whole[0].bench, list(contact.raw.channels)
    during = bench.train & np.asarray(contact.raw.values.any(axis=(1, 2)))

    def left(model: Model, remainder: Remainder | None) -> Array:
        rest = model.rest() if remainder is None else model.rest() - remainder.crossed
        return np.asarray(np.mean(rest[during][:, channels] ** 2, axis=0) / bench.noise.sigma[channels] ** 2)

    if not during.any():
        return False
    taken, missed = left(less[0], None) - left(*whole), left(*less) - left(*whole)
    # A touch acts in all channels at once: one in which the motion says much does not speak for the others.
    matters = taken > 1.0
    return bool(matters.any() and np.all(missed[matters] <= (1.0 - FORETOLD) * taken[matters]))


def _touches(model: Model) -> list[Hypothesis]:
    return [h for h in model.effects if isinstance(h.effect, Contact)]


def _explained(model: Model, rest: list[adequacy.Left]) -> tuple[float, Remainder | None]:
    """Merit of a model together with what generic functions predict of its rest on blocks left out; and these."""
    kinds: dict[int, set[str]] = {}
    for one in rest:
        kinds.setdefault(one.channel, set()).add(one.kind)
    remainder = learn(model, kinds)
    return merit(model) + (0.0 if remainder is None else remainder.gain), remainder


def _yielding(model: Model) -> list[set[int]]:
    """Sets of effects that might be no more than part of what has no name: all flexible ones together, then kind by kind."""
    kinds: dict[str, set[int]] = {}
    for h in model.effects:
        if h.effect is not None and h.effect.KEY in YIELDING:
            kinds.setdefault(h.effect.KEY, set()).add(id(h))
    every = set().union(*kinds.values())
    return [every, *kinds.values()] if len(kinds) > 1 else list(kinds.values())


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

    def searched(on: Bench, own: list[Hypothesis]) -> tuple[Selection, Model]:
        selection = select(on, Scorer(on, [*own, *hypotheses], free=not own))
        return selection, settle_model(on, selection.scorer, selection)

    own = offsets(bench)
    if not own:
        return searched(bench, own)
    # Each has what the search changes (the residual without bends, the late stream) to itself, and a core if there are two.
    twin = copy(bench)
    both = Parallel(n_jobs=2, require="sharedmem")(delayed(searched)(*one) for one in ((bench, []), (twin, own)))
    (selection, model), (other, rival) = both
    if merit(rival) <= merit(model) + MERIT:
        return selection, model
    bench.y, bench.timing, bench.stream = twin.y, twin.timing, twin.stream
    other.scorer.bench = rival.bench = bench
    return other, rival


def _glitches(bench: Bench) -> list[Glitches]:
    """Marks isolated samples and leaves them out of everything."""
    marked = seek.spikes(bench.scene.raw_residual, tuple(bench.scene.segments))
    spoilt = np.asarray(marked.any(axis=1))
    rows = np.flatnonzero(spoilt)
    if len(rows) < FEWEST:
        return []
    bench.leave_out(spoilt)
    names = tuple(n for n, m in zip(bench.scene.channels, np.asarray(marked.any(axis=0)), strict=True) if m)
    return [Glitches(names, tuple(int(r) for r in rows))]


FAR = 6.0
"""Standard deviations by which a glitch must stand off what the model says, not only off its neighbours."""
NEAR, TAIL = 3.5, 3.0
"""Noise with heavy tails: so many times more samples between so many standard deviations and `FAR` than beyond it."""


def _confirmed(glitch: list[Glitches], model: Model) -> list[Glitches]:
    """Isolated samples that the model does not explain either: a cusp of physics looks isolated until it is modelled."""
    bench = model.bench
    place = np.searchsorted(bench.rows.starts, np.arange(len(bench.scene)), side="right") - 1
    explained = bench.whole - model.rest()
    out = []
    for one in glitch:
        rows = np.array(one.rows)
        channels = [bench.scene.channels.index(name) for name in one.channels]
        rest = bench.scene.raw_residual[rows] - explained[place[rows]]
        far = np.abs(rest) > FAR * np.sqrt(bench.rows.stride) * bench.noise.sigma
        far &= ~_heavy_tailed(bench.scene.raw_residual - explained[place], bench, far.sum(axis=0))
        kept = far[:, channels].any(axis=1)
        names = tuple(bench.scene.channels[c] for c in channels if far[kept, c].any())
        if kept.sum() >= FEWEST:
            out.append(Glitches(names, tuple(int(r) for r in rows[kept])))
    return out


def _heavy_tailed(rest: Array, bench: Bench, far: Array) -> Mask:
    """(C,) whether a channel's far samples (C,) are but the end of a tail that thins out towards them (N, C)."""
    z = np.abs(rest) / (np.sqrt(bench.rows.stride) * bench.noise.sigma)
    between = np.sum((z > NEAR) & (z <= FAR), axis=0)
    usual = 2.0 * len(z) * float(norm.sf(NEAR))
    return np.asarray(between - 2.0 * usual > TAIL * far)


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
    findings = findings_of(model, selection, judged, glitch)
    for finding in findings:
        finding.confounded_with = confusions(model, selection, finding)
    rest = left or beyond(judged, bench)
    if premise.wrong or rest:
        findings.append(unknown_finding(bench, judged, rest, premise))
    verdict = verdict_of(findings, rest, premise)
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


def _limit(bench: Bench) -> str:
    """The smallest effect that would have been seen, in words."""
    rows = max(int(bench.train.sum()), 1)
    least = np.sqrt(2.0 * 14.0 / rows) * bench.noise.sigma
    worst = ", ".join(f"{n} {v:.2g}" for n, v in zip(bench.scene.channels, least, strict=True))
    return f"an effect of this rms in one channel would have been seen: {worst}"
