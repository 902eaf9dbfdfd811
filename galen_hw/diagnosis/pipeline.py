"""One recording from residual to verdict."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.detection import outliers
from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.initial_state import left_open, supposable
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.estimation.signal_chain import Timing, arrived
from galen_hw.diagnosis.findings.claims import add_claims, claim_before
from galen_hw.diagnosis.findings.from_model import findings_of, unknown_finding
from galen_hw.diagnosis.findings.localisation import channels_of, episodes_of, where_of
from galen_hw.diagnosis.identifiability.experiment import next_experiment
from galen_hw.diagnosis.identifiability.rivals import confusions
from galen_hw.diagnosis.lack_of_fit import structure_test, trees
from galen_hw.diagnosis.preprocessing.checks import held_out, premises
from galen_hw.diagnosis.preprocessing.data_quality import Premise
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.selection.criterion import merit
from galen_hw.diagnosis.selection.finalise import offsets, settle_model, weighed
from galen_hw.diagnosis.selection.moves.clock_offset import far_off
from galen_hw.diagnosis.selection.proposals import at_first_sight, library
from galen_hw.diagnosis.selection.search import select
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.significance import LOG_ODDS
from galen_hw.diagnosis.validation.contact_or_place import outstanding
from galen_hw.diagnosis.validation.flexible_effects import left_by, left_of_another, might_yield, predict_unnamed
from galen_hw.diagnosis.validation.holdout import earned
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.diagnosis.validation.verdict import beyond, contradicted, outlying, strong, trifles, verdict_of
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.base import Columns, Effect
from galen_hw.physics.effects.events import Contact, Glitches
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.sensor import Drift
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises import Examination, examined
from galen_hw.spatial import Array

PARTS = 6
"""Into which a touch is parted so that nothing of it passes for noise."""
LEAST_SHARE = 12
"""Rows for each direction that may be kept from passing for noise."""
COARSE = 3000
"""Rows of the first look: motion is slow beside a force sensor's samples."""


Progress = Callable[[str, float], None]
"""Told what is being done and which share (0 to 1) of the whole is behind."""


# The matrices are many and small: BLAS gains nothing by threads, and beside other work they, and those of trees, wait for one
# another for longer than they compute.
@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def diagnose(
    scene: Scene,
    *,
    name: str = "",
    holdout: Scene | None = None,
    share: float = 0.3,
    seed: int = 0,
    progress: Progress | None = None,
    repair: bool = True,
) -> Work:
    """Locate, name, model and judge.

    Args:
        scene: the recording.
        name: how it is called in the answer.
        holdout: a second recording to be judged on; else `share` of contiguous blocks is set aside.
        seed: of the choice of blocks.
        progress: told how far the work is.
        repair: put right what is certain (`premises`); else the same is refused.

    Raises:
        UsageError: the recording cannot be compared at all.
    """
    tell = progress or _silent
    tell("checking the recording", 0.0)
    examination, raw = examined(scene.observations, repair=repair), holdout or scene
    premise = _comparable(scene, examination)
    scene = premise.scene
    held = 0.0 if holdout is not None else share
    holdout = None if holdout is None else held_out(_alike(holdout, examination, repair=repair), premise.notes)
    bench, coarse, glitch = _benches(scene, held, seed)
    tell("simulating every effect", 0.1)
    effects = library(bench)
    columns, coarser = _columns(effects, bench, coarse)
    tell("a first look", 0.25)
    known = _first_look(bench, coarse, effects, coarser, blind=bool(premise.wrong))
    holdout = _begun(bench, known, holdout)
    # What moves with the robot cannot be told from noise before it is known what is there: the first noise was too small
    # rather than too large. Now it is learnt from what the first model leaves, and everything is asked again.
    tell("learning the noise", 0.4)
    generic = structure_test.families(bench)
    bench.learn_noise((), known.columns(bench, generic))
    tell("choosing effects", 0.5)
    searches, left = _searched(bench, effects, columns, generic, blind=bool(premise.wrong))
    if not left and not premise.wrong and (faint := outliers.faint(searches[0][1])) is not None:
        glitch = outliers.marked(searches[0][1].bench, faint)
        searches, left = _again(searches[0][1].bench, effects, columns, generic, known.columns)
    if not left and not premise.wrong and (passed := trees.hidden(searches[0][1])):
        # What passed for slow noise hides others too: all is asked again beside it.
        generic += [structure_test.Family(one.kind, one.basis, local=False) for one in passed]
        also = [Columns((one.channel,), one.basis[:, None, 1:]) for one in passed]
        searches, left = _again(searches[0][1].bench, effects, columns, generic, known.columns, also)
        left = left or trees.hidden(searches[0][1])
    tell("judging on held-out data", 0.9)
    selection, chosen, model, judged = _held_up(searches, holdout, nothing=bool(premise.wrong))
    bench = selection.bench
    if model is not chosen:
        left = left_by([model], generic)[0]
    left = strong(left, judged, bench)
    small, plain = trifles(model), outstanding(model, judged, left or beyond(judged, model))
    if small or plain is not model:
        model, judged = earned(plain.without(small), holdout, judged)
        left = strong(left_by([model], generic)[0], judged, bench)
    glitch = [] if premise.wrong else outliers.confirmed(glitch, model)
    if (left or might_yield(model)) and not premise.wrong:
        model, judged, left = predict_unnamed(generic, model, holdout, judged, left)
    if not left and holdout is not None and not premise.wrong:
        left = left_of_another(model, holdout, judged)
    after = claim_before(judged, raw, examination)
    diagnosis = _said(model, selection, judged, left, premise, glitch, name)
    add_claims(diagnosis, examination, judged, after, bench, lambda found: verdict_of(found, left, premise))
    tell("done", 1.0)
    return Work(bench, selection, model, judged, left, diagnosis)


def _benches(scene: Scene, held: float, seed: int) -> tuple[Bench, Bench, list[Glitches]]:
    """The data of the search, those of the first look, and the isolated samples that both leave out."""
    bench, coarse = Bench(scene, held, seed), Bench(scene, held, seed, COARSE)
    glitch = outliers.marked(bench)
    coarse.leave_out(bench.spoilt)
    return bench, coarse, glitch


def _comparable(scene: Scene, examination: Examination) -> Premise:
    """The recording as repaired, without the rows that cannot be compared, and what was said of it."""
    out = premises(scene if examination.observations is scene.observations else scene_of(examination.observations))
    out.take(examination)
    return out


def _alike(holdout: Scene, examination: Examination, *, repair: bool) -> Scene:
    """Another recording of the same machine, repaired by itself but for what the machine is: that is as in the first."""
    ours, theirs = examination.observations.belief, holdout.observations.belief
    zeroed = theirs.zeroed_rotation if theirs.zeroed_rotation is None else theirs.zeroed_rotation @ ours.sensor_turn
    belief = replace(theirs, sensor_turn=ours.sensor_turn, gravity=ours.gravity, tool=ours.tool, zeroed_rotation=zeroed)
    same = replace(holdout.observations, belief=belief) if examination.claims else holdout.observations
    found = examined(same, repair=repair).observations
    return holdout if found is holdout.observations else scene_of(found)


@dataclass(frozen=True)
class _Known:
    """What a first look has found: effects (with parameters where these are not linear), generic functions by channel.

    step: between the rows of the first look, s; ends: late clocks, filters and limits that it goes through; stream: the scene
    with all that these effects add.
    """

    effects: list[tuple[Effect, Array]]
    left: dict[int, str]
    step: float
    ends: Timing
    stream: Scene

    def columns(self, bench: Bench, generic: list[structure_test.Family]) -> list[Columns]:
        """On the rows of a bench: what must not pass for noise, as it arrives."""
        with bench.delivering(self.ends):
            out = [bench.raw(effect.relaxed) for effect, _ in self.effects]
            # How a touch swells and turns round inside its episode no plain shape follows; it is no noise for that.
            touches = [effect for effect, _ in self.effects if isinstance(effect, Contact)]
            out += [bench.raw(effect.parted(PARTS)) for effect in touches]
            if self.step > bench.spacing:
                # And where it begins and ends is known to a row of the first look.
                out += [bench.raw(effect.edges(self.step).parted(2)) for effect in touches]
            everywhere = tuple(range(bench.width))
            for effect, theta in self.effects:
                change = effect.exact(bench.scene, theta)
                if change is not None:
                    seen = arrived(bench.stream, effect, change, self.ends)
                    out.append(Columns(everywhere, bench.rows.average(seen)[:, :, None]))
        for channel, kind in self.left.items():
            alike = [one.basis for one in generic if one.kind == kind]
            # In few rows all directions of what looked best would leave too little of the noise, and find themselves again.
            most = max(len(bench.rows) // LEAST_SHARE // len(alike), 2)
            out += [Columns((channel,), basis[:, None, :most]) for basis in alike]
        return out


def _columns(effects: list[Effect], *benches: Bench) -> tuple[list[Columns], ...]:
    """Columns of all effects on the rows of several benches of one scene, computed once."""
    kinds: dict[type[Effect], dict[int, Effect]] = {}
    for place, effect in enumerate(effects):
        kinds.setdefault(type(effect), {})[place] = effect

    def of(kind: type[Effect], alike: dict[int, Effect]) -> dict[int, list[Columns]]:
        kind.ahead(benches[0].scene, list(alike.values()))
        whole = ((place, effect.columns(benches[0].scene_of(effect))) for place, effect in alike.items())
        return {place: [bench.averaged(columns) for bench in benches] for place, columns in whole}

    # The largest kind first: it takes as long as all others.
    work = sorted(kinds.items(), key=lambda one: -len(one[1]))
    done: dict[int, list[Columns]] = {}
    for part in Parallel(n_jobs=2, require="sharedmem", batch_size=1)(delayed(of)(*one) for one in work):
        done |= part
    return tuple([done[place][k] for place in range(len(effects))] for k in range(len(benches)))


def _first_look(bench: Bench, coarse: Bench, effects: list[Effect], columns: list[Columns], *, blind: bool) -> _Known:
    """Effects and leftovers under a noise that is too small rather than too large, on few rows."""
    generic = structure_test.families(coarse)
    seen = [coarse.raw(s.effect) for s in at_first_sight(bench)]
    extra, above = [*structure_test.compact(coarse, generic), *seen], coarse.motion_band()
    coarse.learn_noise(columns, extra, above=above)
    ((_, model), *_), left = _searched(coarse, effects, columns, generic, blind=blind)
    coarse = model.bench
    if shifts := far_off(model):
        # On the clock that was off no effect is like what was measured: slow ones had passed for noise.
        late = [coarse.raw(effect) for effect in effects]
        coarse.begin()
        coarse.learn_noise(late, [*extra, *shifts], above=above)
        ((_, model), *_), left = _searched(coarse, effects, columns, generic, blind=blind)
        coarse = model.bench
    if not left and len(coarse.noise.edges):
        # What is finely structured passes for quick noise. Only blocks that it was not fitted on can tell, whatever the noise.
        coarse.noise = coarse.noise.flat()
        rest = model.rest()
        plain = structure_test.Fitted([h.raw for h in model.parts], rest, rest / coarse.noise.sigma)
        (left,) = structure_test.leftovers(coarse, generic, [plain])
    parts = zip(model.parts, model.slices(), strict=True)
    chosen = [(h.effect, model.final[s]) for h, s in parts if h.effect is not None]
    return _Known(chosen, {x.channel: x.kind for x in reversed(left)}, coarse.spacing, coarse.timing, coarse.stream)


def _begun(bench: Bench, known: _Known, holdout: Scene | None) -> Scene | None:
    """The other recording, and the bench with the stream of the first look: of the beginnings that a model leaves open."""
    beginning = left_open(bench.scene, known.effects)
    bench.begun(bench.scene.begun(beginning))
    bench.stand(stream=known.stream)
    return None if holdout is None else holdout.begun(beginning)


Search = tuple[Selection, Model]
"""How a model was found, and the model."""


def _searched(
    bench: Bench, effects: list[Effect], columns: list[Columns], generic: list[structure_test.Family], *, blind: bool
) -> tuple[list[Search], list[structure_test.Left]]:
    """What was searched under the present noise, the better model first, and what that leaves."""
    hypotheses = [bench.made(e, raw) for e, raw in supposable(bench.scene, effects, columns)]
    bench.know(hypotheses)
    searches = _chosen(bench, hypotheses, blind=blind)
    return searches, left_by([searches[0][1]], generic)[0]


def _again(
    bench: Bench,
    effects: list[Effect],
    columns: list[Columns],
    generic: list[structure_test.Family],
    known: Callable[[Bench, list[structure_test.Family]], list[Columns]],
    also: Sequence[Columns] = (),
) -> tuple[list[Search], list[structure_test.Left]]:
    """Learn the noise anew beside what is known and what showed `also`, and search again."""
    bench.begin()
    bench.learn_noise((), [*known(bench, generic), *also])
    return _searched(bench, effects, columns, generic, blind=False)


def _silent(stage: str, share: float) -> None:
    del stage, share


def _chosen(bench: Bench, hypotheses: list[Hypothesis], *, blind: bool) -> list[Search]:
    """One search or two, the better model first; of two each has a bench of its own, as it left it.

    With offsets always in the model and judged at the end (a drift is not called an offset), and with offsets among the
    hypotheses (a constant error of geometry is not called one).
    """
    if blind:
        nothing = Selection(Scorer(bench, hypotheses))
        return [(nothing, settle_model(bench, nothing.scorer, nothing))]

    def searched(on: Bench, own: list[Hypothesis]) -> Search:
        selection = select(on, Scorer(on, [*own, *hypotheses], free=not own))
        return selection, settle_model(on, selection.scorer, selection)

    own = offsets(bench)
    if not own:
        return [searched(bench, own)]
    # Each has what the search changes (the residual without bends, the late stream) to itself, and a core if there are two.
    first, other = Parallel(n_jobs=2, require="sharedmem")(
        delayed(searched)(*one) for one in ((copy(bench), []), (copy(bench), own))
    )
    better = merit(other[1]) - merit(first[1])
    # A constant that something else accounts for as well is an effect too many.
    if better > LOG_ODDS or (better > 0.0 and len(other[1].effects) < len(first[1].effects)):
        first, other = other, first
    return [first, other]


def _held_up(searches: list[Search], holdout: Scene | None, *, nothing: bool) -> tuple[Selection, Model, Model, Judged]:
    """How it was found, the model that leaves `left`, the model without what held-out data refuse, and how it does on these.

    With `nothing` a premise refuses the recording: constants too are numbers of something else.

    Where some of the better model's names are refused (two offsets in the place of a warm-up), the other search may have found
    what holds: then that is taken.
    """
    (selection, found), *others = searches
    chosen = found.without(list(found.effects)) if nothing else weighed(found)
    model, judged = earned(chosen, holdout)
    if model is chosen or nothing:
        return selection, chosen, model, judged
    for other, rival in others:
        kept, its = earned(weighed(rival), holdout)
        if merit(kept) > merit(model) + LOG_ODDS:
            return other, chosen, kept, its
    return selection, chosen, model, judged


def _said(
    model: Model,
    selection: Selection,
    judged: Judged,
    left: list[structure_test.Left],
    premise: Premise,
    glitch: list[Glitches],
    name: str,
) -> Diagnosis:
    bench = model.bench
    findings = findings_of(model, selection, judged, glitch)
    for finding in findings:
        finding.confounded_with = confusions(model, selection, finding)
    rest = left or beyond(judged, model, untouched=True) or contradicted(judged, model)
    rest = rest if rest or findings else outlying(model)
    if premise.wrong or rest:
        findings.append(unknown_finding(bench, judged, rest, premise))
    verdict = verdict_of(findings, rest, premise)
    advice = next_experiment(model, selection, findings, rest)
    notes = list(premise.notes)
    if verdict == "agrees":
        notes.append(_limit(bench))
    notes += _wandering(model)
    if judged.at_home:
        told = ", ".join(key.replace("_", " ") for key in sorted(judged.at_home))
        notes.append(f"the recording held out hardly rouses {told}: told by blocks left out of the first")
    if bench.scene.heard is not None:
        notes.append(
            f"above {bench.scene.heard:.3g} Hz the noise of the joint positions, differentiated, drowns all: it was filtered out"
        )
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
    """The smallest effect that would have been seen, in words: a slow one, where noise is slow."""
    rows = max(int(bench.train.sum()), 1)
    least = np.sqrt(2.0 * 14.0 / rows * np.maximum(bench.noise.slow, bench.noise.sigma**2))
    worst = ", ".join(f"{n} {v:.2g}" for n, v in zip(bench.scene.channels, least, strict=True))
    return f"an effect of this rms in one channel would have been seen: {worst}"


def _wandering(model: Model) -> list[str]:
    """Which channels wander by more than their quick noise although no drift was found: nobody is to take them for quiet."""
    bench = model.bench
    drifting = {
        name for h in model.effects if isinstance(h.effect, Drift) for name in h.effect.channels or (h.effect.channel,)
    }
    told = [
        f"{name} {wander:.2g} {unit}"
        for name, unit, wander, quick in zip(bench.scene.channels, bench.scene.units, *bench.noise.wander, strict=True)
        if wander > quick and name not in drifting
    ]
    return [f"what wanders so slowly passes for noise, rms: {', '.join(told)}"] if told else []
