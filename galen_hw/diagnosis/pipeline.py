"""The diagnosis of one recording, from residual to verdict."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from threadpoolctl import threadpool_limits

from galen_hw.diagnosis.answer import answer
from galen_hw.diagnosis.detection import outliers
from galen_hw.diagnosis.findings.claims import add_claims, claim_before
from galen_hw.diagnosis.first_look import benches, effect_columns, first_look, restarted
from galen_hw.diagnosis.lack_of_fit import structure_test, trees
from galen_hw.diagnosis.preprocessing.checks import Screening, held_out, screened
from galen_hw.diagnosis.searching import pruned, searched
from galen_hw.diagnosis.selection.proposals import library
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.deadline import Deadline
from galen_hw.diagnosis.validation.flexible_effects import (
    has_flexible_effects,
    predict_unnamed,
    remaining_structures,
    structures_of_holdout,
)
from galen_hw.diagnosis.validation.verdict import strong, telling, verdict_of
from galen_hw.diagnosis.work import Work
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises import Examination, examined

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
    time_limit: float = LIMITS.seconds,
) -> Work:
    """Diagnose a recording: locate, name, model and judge what the simulation left out.

    Args:
        scene: the recording.
        name: how it is called in the answer.
        holdout: a second recording to be judged on; else `share` of contiguous blocks is held out.
        seed: of the choice of blocks.
        progress: told how far the work is.
        repair: put right what is certain (`premises`); else the same is refused.
        time_limit: s, after which the search for better models stops, and the best so far is judged.

    Raises:
        UsageError: the recording cannot be compared at all.
    """
    tell = progress or _silent
    tell("checking the recording", 0.0)
    deadline = Deadline(time_limit)
    examination = examined(scene.observations, repair=repair)
    raw = scene if holdout is None else holdout
    screening = _comparable(scene, examination)
    scene = screening.scene
    held = 0.0 if holdout is not None else share
    holdout = None if holdout is None else held_out(_alike(holdout, examination, repair=repair), screening.notes)
    bench, coarse, glitch = benches(scene, held, seed, deadline)
    tell("simulating every effect", 0.1)
    effects, (columns, coarser) = effect_columns(library(bench), bench, coarse)
    tell("a first look", 0.25)
    known = first_look(bench, coarse, effects, coarser, blind=bool(screening.wrong))
    holdout = restarted(bench, known, holdout)
    deadline.extend()
    # What moves with the robot cannot be told from noise before it is known what is there: the first noise was too small
    # rather than too large. Now it is learnt from the first model's residual, and everything is tested again.
    tell("learning the noise", 0.4)
    generic = structure_test.families(bench)
    learn = partial(known.learn_noise, effects, columns)
    learn(bench, generic)
    tell("choosing effects", 0.5)
    searches, structures = searched(bench, effects, columns, generic, blind=bool(screening.wrong), start=known.effects)
    if not (structures or screening.wrong or deadline.passed()) and (passed := trees.hidden(searches[0][1])):
        # Structure that passed for slow noise hides other effects too: all is tested again with it excluded from the noise.
        generic += [structure_test.Family(one.kind, one.basis, local=False) for one in passed]
        also = [Columns((one.channel,), one.basis[:, None, 1:]) for one in passed]
        before = searches[0][1]
        before.bench.reset()
        learn(before.bench, generic, also)
        searches, structures = searched(before.bench, effects, columns, generic, blind=False, start=before.placed())
        structures = structures or trees.hidden(searches[0][1])
    tell("judging on held-out data", 0.9)
    selection, chosen, model, judged = pruned(searches, holdout, nothing=bool(screening.wrong))
    bench = selection.bench
    if model is not chosen:
        structures = remaining_structures([model], generic)[0]
    structures = strong(structures, judged, bench)
    if not telling(structures):
        # The noise's own spectrum may be off by as much: only what trees foretell too is structure.
        structures = structures and trees.hidden(model)
    glitch = [] if screening.wrong else outliers.confirmed(glitch, model)
    if (structures or has_flexible_effects(model)) and not screening.wrong:
        model, judged, structures = predict_unnamed(generic, model, holdout, judged, structures)
    if not structures and holdout is not None and not screening.wrong:
        structures = structures_of_holdout(model, holdout, judged)
    after = claim_before(judged, raw, bench.scene.channels, examination)
    diagnosis = answer(model, selection, judged, structures, screening, glitch, name)
    add_claims(diagnosis, examination, judged, after, bench, lambda found: verdict_of(found, structures, screening))
    diagnosis.notes[:0] = deadline.note
    tell("done", 1.0)
    return Work(bench, selection, model, judged, structures, diagnosis)


def _comparable(scene: Scene, examination: Examination) -> Screening:
    """Return the repaired recording without the rows that cannot be compared, with notes."""
    out = screened(scene if examination.observations is scene.observations else scene_of(examination.observations))
    out.take(examination)
    return out


def _alike(holdout: Scene, examination: Examination, *, repair: bool) -> Scene:
    """Return the held-out recording repaired by itself, with the machine's properties as found in the first."""
    ours, theirs = examination.observations.belief, holdout.observations.belief
    zeroed = theirs.zeroed_rotation if theirs.zeroed_rotation is None else theirs.zeroed_rotation @ ours.sensor_turn
    belief = replace(theirs, sensor_turn=ours.sensor_turn, gravity=ours.gravity, tool=ours.tool, zeroed_rotation=zeroed)
    same = replace(holdout.observations, belief=belief) if examination.claims else holdout.observations
    found = examined(same, repair=repair).observations
    return holdout if found is holdout.observations else scene_of(found)


def _silent(stage: str, share: float) -> None:
    del stage, share
