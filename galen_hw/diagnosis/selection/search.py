"""Which effects: forward by likelihood with a held-out guard, then drop-one and swaps."""

import numpy as np

from galen_hw.diagnosis.detection import clipping, drift, proposal, spectral_lines, steps
from galen_hw.diagnosis.detection.contacts import contacts
from galen_hw.diagnosis.estimation.cross_validation import crossed
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import cost_without, load, retime, settle_together
from galen_hw.diagnosis.estimation.least_squares import missed, rests
from galen_hw.diagnosis.estimation.linearisation import as_if, rebase, unbent
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer, threshold
from galen_hw.diagnosis.selection.acceptance import WORTH, asked, completes, plausible, shows_in_noise, worth
from galen_hw.diagnosis.selection.comparison import bent, in_place, loosens, polished
from galen_hw.diagnosis.selection.kinds import kind_first
from galen_hw.diagnosis.selection.moves.cable import tightened
from galen_hw.diagnosis.selection.moves.clipping import clipped, levelled
from galen_hw.diagnosis.selection.moves.clock_offset import clock_offset
from galen_hw.diagnosis.selection.moves.contact_profile import finest, followed
from galen_hw.diagnosis.selection.moves.creep_friction import behind_friction
from galen_hw.diagnosis.selection.moves.exchange import regrouped
from galen_hw.diagnosis.selection.moves.pairs import hidden
from galen_hw.diagnosis.selection.moves.refine import enriched
from galen_hw.diagnosis.selection.moves.split import split
from galen_hw.diagnosis.selection.moves.step_times import parted, timed
from galen_hw.diagnosis.selection.moves.timing import one_clock, own_clocks, reclocked
from galen_hw.diagnosis.selection.search_state import Selection, elsewhere
from galen_hw.diagnosis.selection.simplicity import ALIKE, favour, handicap, plainest, slack
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.registry import EFFECTS, effect_class
from galen_hw.physics.effects.timing import Timing

CHANCE = 0.002


TRIES = 8
"""Hypotheses that may fail the guard before a turn of the search gives up."""


MOST = 16


def library(bench: Bench) -> list[Effect]:
    """Every hypothesis that the scene allows; offsets are always in the model and judged at the end."""
    constant = {"bias"} | ({"joint_offset"} if bench.scene.observations.predict == "position" else set())
    return [e for key in EFFECTS if key not in constant for e in effect_class(key).propose(bench.scene)]


def sought(bench: Bench, scorer: Scorer, chosen: list[int]) -> list[proposal.Sought]:
    """What the rest of the present model shows by itself."""
    load(bench, scorer, chosen)
    rest, _ = rests(bench, scorer, chosen)
    found = steps.steps(bench.scene, rest, bench.noise) + steps.staircases(bench.scene, rest, bench.noise)
    found += contacts(bench.scene, rest)
    found += steps.slips(bench.scene, rest, bench.rows.average)
    found += drift.walks(bench.scene, rest, bench.noise)
    found += drift.drifts(bench.scene, rest, bench.rows.average(bench.scene.time))
    found += drift.temperatures(bench.scene, rest, bench.rows.average)
    # A limit that was found before something else was is sought again as if it had not been.
    added = bench.rows.average(np.asarray(bench.stream.standing + bench.stream.carried))
    stream, seen = bench.rows.average(bench.scene.simulated) + added, ~bench.dropped
    found += clipping.saturations(bench.scene, np.asarray(bench.whole - added)[seen], stream[seen])
    known = [effect for i in chosen if isinstance(effect := scorer.library[i].effect, Vibration)]
    return (
        found
        + spectral_lines.lines(bench.scene, rest, bench.rows.runs, known)
        + spectral_lines.ripples(bench.scene, rest)
    )


SAME_LINE = 0.1
"""Of what two lines of the spectrum are apart: sines so near stay in step over the whole recording."""


def _known(bench: Bench, scorer: Scorer, effect: Effect) -> bool:
    """Whether a hypothesis is in the library: turn after turn the rest shows the same, as long as nothing takes it."""
    family = effect.family
    alike = [h.effect for h in scorer.library if h.family == family]
    if not isinstance(effect, Vibration):
        return effect in alike
    near = SAME_LINE / max(float(np.ptp(bench.scene.time)), 1e-9)
    return any(isinstance(one, Vibration) and abs(one.frequency - effect.frequency) < near for one in alike)


def at_first_sight(bench: Bench) -> list[proposal.Sought]:
    """What belongs to moments and shows in the residual itself: it must not pass for noise, whatever it is to be called."""
    rest = bench.whole - np.median(bench.whole, axis=0)
    found = contacts(bench.scene, rest) + spectral_lines.lines(bench.scene, rest, bench.rows.runs, narrow=np.inf)
    return found + steps.steps(bench.scene, rest)[:-1]


def select(bench: Bench, scorer: Scorer) -> Selection:
    """Forward, backward and swap until nothing changes."""
    out = Selection(scorer)
    refused: set[int] = set()
    moved = False
    for turn in range(MOST):
        fresh = [s for s in sought(bench, scorer, out.chosen) if not _known(bench, scorer, s.effect)]
        scorer.append([bench.add(s.effect, s.looked) for s in fresh])
        levelled(bench, scorer, out)
        timed(bench, scorer, out)
        scores, highest = scorer.scores(out.chosen, surrogates=True)
        out.needed = max(out.needed, threshold(highest, CHANCE))
        if turn == 0:
            out.first = scores
        able: list[int] = []
        # What a clock does that is far off no slope promises.
        best = clock_offset(bench, scorer, out.chosen, scores)
        best = _best(bench, scorer, out, scores, refused, able) if best is None else best
        if best is not None:
            _admit(bench, scorer, out, best)
        elif not (
            clipped(bench, scorer, out)
            or split(bench, scorer, out)
            or tightened(bench, scorer, out)
            or behind_friction(bench, scorer, out)
            or regrouped(bench, scorer, out)
            or one_clock(bench, scorer, out)
            or reclocked(bench, scorer, out)
            or (moved and _exchanged(bench, scorer, out, refused))
        ):
            pair = hidden(bench, scorer, out, able)
            if pair is None:
                break
            out.chosen.append(pair)
        settle_together(bench, scorer, out.chosen)
        if _drop(scorer, out):
            settle_together(bench, scorer, out.chosen)
        moved = _swap(bench, scorer, out, refused)
        if moved:
            settle_together(bench, scorer, out.chosen)
        if enriched(bench, scorer, out) or _bound(bench, scorer, out) or followed(bench, scorer, out):
            settle_together(bench, scorer, out.chosen)
        retime(bench, scorer, out.chosen)
        refused.clear()
    # The last turn moved what is searched: what stood before need not stand now.
    if _drop(scorer, out):
        settle_together(bench, scorer, out.chosen)
    for i in out.chosen:
        # What the others can do as well has no score of its own.
        score = _alone(scorer, out.chosen, i)
        if score is not None:
            out.evidence[i] = score
    bench.stand(interaction=0.0)
    rebase(scorer, out.chosen)
    return out


def _admit(bench: Bench, scorer: Scorer, out: Selection, i: int) -> None:
    """A hypothesis joins the model: a first clock as those of each joint if it is these, a spring as a tendon if it is one."""
    out.chosen.append(i)
    parted(bench, scorer, out)
    if not own_clocks(bench, scorer, out):
        tightened(bench, scorer, out, i)


def _best(
    bench: Bench, scorer: Scorer, out: Selection, scores: dict[int, Score], refused: set[int], able: list[int]
) -> int | None:
    """The best hypothesis that chance does not explain and that pays on blocks left out; None when there is none.

    `able` is filled with those that chance does not explain, best first.
    """
    fit = [i for i, s in scores.items() if s.surprise > out.needed and s.rank > 0.0 and i not in refused]
    fit = elsewhere(scorer, out.chosen, fit)
    fit.sort(key=lambda i: -scores[i].rank)
    if not fit:
        return None
    able += sharpened(bench, scorer, out.chosen, scores, fit)
    misfit = scorer.misfit([*out.chosen, able[0]])
    misses = missed(bench, scorer, [*out.chosen, able[0]])
    able.insert(0, plainest(bench, scorer, out.chosen, scores, able, misses))
    able[:0] = kind_first(scorer, scores, able)
    tries = 0
    for i in dict.fromkeys(able):
        if i in refused:
            continue
        if tries == TRIES:
            break
        tries += 1
        better, (paid, whole) = i, worth(bench, scorer, out, i)
        if paid >= 0.5 * WORTH:
            better = polished(bench, scorer, out.chosen, i)
            paid, whole = worth(bench, scorer, out, better) if better != i else (paid, whole)
        share, of_all = asked(bench, out, scorer.library[i].effect, misfit)
        if paid < share and (finer := finest(bench, scorer, out.chosen, i)) != i:
            better, (paid, whole) = finer, worth(bench, scorer, out, finer)
        # Whoever takes nearly all that is left completes the model, however loud the recording was.
        if (
            paid >= share and (whole >= of_all or completes(bench, scorer, [*out.chosen, better], paid))
        ) or shows_in_noise(bench, scorer, out, better):
            if plausible(bench, scorer, out.chosen, better):
                return better
            # At the optimum it is not what it is called; beside it, where other physics is still missing, it may be.
            near = _plausible_kin(bench, scorer, out.chosen, scores, i)
            if near is not None:
                paid, whole = worth(bench, scorer, out, near)
                if paid >= share and whole >= of_all:
                    return near
        refused.update(_kin(scorer, i))
        effect = scorer.library[better].effect
        if effect is not None:
            out.refused.append((effect, paid))
    return None


def _plausible_kin(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], i: int) -> int | None:
    """The best of the same hypothesis at other searched values whose parameters can be what it is called."""
    kin = sorted((j for j in _kin(scorer, i) if j in scores), key=lambda j: -scores[j].rank)
    return next((j for j in kin if scores[j].rank > 0.0 and plausible(bench, scorer, chosen, j)), None)


def _kin(scorer: Scorer, i: int) -> list[int]:
    effect = scorer.library[i].effect
    assert effect is not None, "nuisances are never candidates"
    return [j for j, h in enumerate(scorer.library) if h.effect is not None and h.effect.family == effect.family]


def sharpened(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], able: list[int]) -> list[int]:
    """The able ones ranked again after the leaders of up to four kinds were polished: a coarse grid must not decide."""
    leaders: dict[str, int] = {}
    for i in able:
        effect = scorer.library[i].effect
        if effect is not None and scores[i].rank > 0.75 * scores[able[0]].rank:
            leaders.setdefault(effect.KEY, i)
    fresh = []
    for i in list(leaders.values())[:4]:
        effect = scorer.library[i].effect
        if effect is not None and effect.bends(bench.scene, np.zeros(scorer.library[i].count)):
            scores[i] = bent(bench, scorer, chosen, i, scores[i])
        elif effect is not None and effect.searched() and len(leaders) > 1:
            better = polished(bench, scorer, chosen, i)
            if better != i:
                scores.update(scorer.scores(chosen, [better])[0])
                fresh.append(better)
    return sorted([*able, *(i for i in fresh if i in scores)], key=lambda i: -scores[i].rank)


def _drop(scorer: Scorer, out: Selection) -> bool:
    """Backward: what no longer stands beside the others goes; whether anything did."""
    before = len(out.chosen)
    while len(out.chosen) > 1:
        alone = {i: _alone(scorer, out.chosen, i) for i in out.chosen}
        worst = min(out.chosen, key=lambda i: -np.inf if alone[i] is None else alone[i].rank)  # type: ignore[union-attr]
        score = alone[worst]
        if score is not None and score.rank > 0.0 and score.surprise > 0.7 * out.needed:
            break
        out.chosen.remove(worst)
        rebase(scorer, out.chosen)
    return len(out.chosen) < before


def _alone(scorer: Scorer, chosen: list[int], i: int) -> Score | None:
    """The score of a chosen hypothesis beside the others."""
    with unbent(scorer, i):
        return scorer.scores([j for j in chosen if j != i], [i])[0].get(i)


def _swap(bench: Bench, scorer: Scorer, out: Selection, refused: set[int]) -> bool:
    """Each chosen effect against every rival in its place; whether any was exchanged."""
    start = list(out.chosen)
    for i in list(out.chosen):
        others = [j for j in out.chosen if j != i]
        # A cable has shown by now whether a tendon does what its spring does.
        rivals = {
            j: scorer.in_full(j, s) for j, s in in_place(bench, scorer, out.chosen, i).items() if j not in refused
        }
        rivals = {j: rivals[j] for j in elsewhere(scorer, others, rivals)}
        rivals = {j: s for j, s in rivals.items() if not loosens(scorer.library[j].effect, scorer.library[i].effect)}
        rivals = {j: s for j, s in rivals.items() if j == i or not _left_behind(scorer, i, j)}
        if i not in rivals:
            continue
        # A plainer one need not be better, only as good: what came first in an earlier turn must not decide.
        with unbent(scorer, i):
            able = {j: s.rank + handicap(bench, scorer, others, i, j, rivals) for j, s in rivals.items() if j != i}
        better = sorted((j for j in able if able[j] > rivals[i].rank), key=lambda j: -able[j])
        best = next((j for j in better[:TRIES] if plausible(bench, scorer, others, j)), i)
        margin = 6.0 + slack(missed(bench, scorer, [*others, best])) * rivals[i].gain
        if best in _kin(scorer, i) or (best != i and favour(scorer, i, best) > 0):
            margin = 1.0  # the same thing at a better value, or a plainer one that does as well
        if best == i or able[best] <= rivals[i].rank + margin:
            continue
        trial = [best if j == i else j for j in out.chosen]
        if able[best] - _flattered(bench, scorer, trial, i, best) <= rivals[i].rank + margin:
            continue
        before = crossed(bench, scorer, out.chosen)
        with as_if(scorer, trial):
            after = crossed(bench, scorer, trial)
        if float(np.mean(after / before)) <= 1.0 + ALIKE:
            out.chosen = trial
            parted(bench, scorer, out)
            rebase(scorer, out.chosen)
    return out.chosen != start


def _flattered(bench: Bench, scorer: Scorer, trial: list[int], i: int, best: int) -> float:
    """How much less the trial leaves than it will without the delay or lag i, through which its columns came."""
    gone, come = scorer.library[i].effect, scorer.library[best].effect
    if not isinstance(gone, Timing) or isinstance(come, Timing):
        return 0.0
    with as_if(scorer, trial):
        promised = scorer.solve(trial)[2]
    return max(cost_without(bench, scorer, trial, gone) - promised, 0.0)


def _exchanged(bench: Bench, scorer: Scorer, out: Selection, refused: set[int]) -> bool:
    """Whether one more round of swaps brings other hypotheses in, not only better values of the same.

    What was exchanged last may have made room for better: a wander beside a tool stood for a warm-up beside a cable.
    """
    families = _families(scorer, out.chosen)
    with out.attempt() as attempt:
        attempt.kept = _swap(bench, scorer, out, refused) and _families(scorer, out.chosen) != families
    return attempt.kept


def _left_behind(scorer: Scorer, i: int, j: int) -> bool:
    """Whether j is the chosen i where it stood before it was settled: a tangent says of itself that it reaches anywhere."""
    own, other = scorer.library[i], scorer.library[j]
    return other.theta is not None and own.effect == other.effect and own.effect is not None and own.effect.curved


def _families(scorer: Scorer, chosen: list[int]) -> set[object]:
    return {effect.family for i in chosen if (effect := scorer.library[i].effect) is not None}


BOUND_STEPS = 3
BOUND_MARGIN = 0.1
"""In rank: less would only place the same body a hair elsewhere."""


def _bound(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """An effect whose parameters obey a law that they place themselves stands for a freer one where it ranks above it."""
    changed = False
    for place, i in enumerate(list(out.chosen)):
        others, j = [k for k in out.chosen if k != i], i
        for _ in range(BOUND_STEPS):
            effect = scorer.library[j].effect
            theta, at, _ = scorer.solve([*others, j])
            own = scorer.places[j]
            told = None if effect is None else effect.told_by(theta[(at >= own.start) & (at < own.stop)])
            if told is None:
                break
            scorer.append([bench.add(told)])
            j = len(scorer.library) - 1
        if j == i:
            continue
        scores, _ = scorer.scores(others, [i, j])
        if j in scores and (i not in scores or scores[j].rank > scores[i].rank + BOUND_MARGIN):
            out.chosen[place], changed = j, True
    return changed
