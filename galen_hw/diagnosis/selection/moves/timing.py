"""Exchange of all timing effects at once: a delay and a lag together, of the whole stream or of each joint.

The search takes one hypothesis after the other. Of a dead time with a first-order lag behind it, the ordinary response of a servo
on a bus, it takes one that is as late as both; given that, the other has no gain by its slope, and what is wrong about the shape
goes to nonlinear effects. Where each joint has its own timing, no single exchange helps.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.interactions import settle_together
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain
from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.estimation.nonlinear import settle
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import held_out_errors, improves
from galen_hw.diagnosis.selection.moves.timing_search import Clocks, ClockSearch, parameter_count
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.paired_test import paired
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.clocks import Shift
from galen_hw.physics.effects.registry import effect_class, shifts
from galen_hw.spatial import Array

RICHER = 0.05
"""Share of the remaining excess in some channel, on held-out blocks, that the timing effects must explain."""
NOTHING = 0.02
"""Of the noise: a smaller excess is none."""
COMPLETE = 0.9
"""The same that each joint's own clocks must take before anything else is known."""
MOST_PER_MODEL = 2
"""Times that one model is asked for its clocks: its other values may have moved since."""


def reclocked(out: Selection) -> bool:
    """Return whether the delays and lags of a model were exchanged for better ones, of the whole stream or of each joint."""
    bench, scorer = out.bench, out.scorer
    # Not for ever: an exchange that the search undoes would be undone again.
    model = out.families
    again = _ends(scorer, out.chosen) and out.clocked[model] < MOST_PER_MODEL
    proposed = shifts(bench.scene) if again else []
    out.clocked[model] += 1
    if not proposed:
        return False
    groups = [e for e in proposed if not e.joint], [e for e in proposed if e.joint]
    for clocks, instead in _sought(bench, scorer, out.chosen, groups):
        if clocks and _exchanged(bench, scorer, out, clocks, instead):
            return True
    return False


def clocks_per_joint(out: Selection) -> bool:
    """Return whether one timing effect per joint replaced the global one, taking 90 % of what its optimum leaves.

    Tested before anything else is chosen: it would take the remaining lateness of servos with different responses.
    """
    bench, scorer = out.bench, out.scorer
    proposed = shifts(bench.scene)
    ends = [e for e in proposed if e.joint]
    if not ends or len(out.chosen) != 1 or not _ends(scorer, out.chosen):
        return False
    # By its slope alone the global timing effect explains less than at its optimum.
    settle_together(bench, scorer, out.chosen)
    (one, _), (each, _) = _sought(bench, scorer, out.chosen, ([e for e in proposed if not e.joint], ends))
    # A response of second order changes the amplitude: it would absorb a scale error.
    swings = any(end.swings for end, _ in one)
    exchanged = bool(one) and _exchanged(bench, scorer, out, one, {}, nearly=1 if swings else 0)
    if len({end.joint for end, _ in each}) < 2 or not _exchanged(bench, scorer, out, each, {}, nearly=2):
        return exchanged
    # Friction is small compared with all of the lateness, and large compared with what the right timing leaves of it.
    out.initial_errors = cross_validated(bench, scorer.parts(out.chosen), scorer.white) ** 2
    return True


def _ends(scorer: Scorer, chosen: list[int]) -> list[int]:
    """Return the delays and lags among the chosen."""
    return [i for i in chosen if (effect := scorer.library[i].effect) is not None and effect.CLOCK]


def _sought(
    bench: Bench, scorer: Scorer, chosen: list[int], groups: Sequence[list[Shift]]
) -> Iterator[tuple[Clocks, dict[Effect, Effect]]]:
    """Yield for each group of places the best timing effects there, instead of the chosen ones.

    And the friction that replaces friction within these lags.
    """
    old = _ends(scorer, chosen)
    # Friction of a servo contains the servo's lag, and is removed with it.
    friction = [e for i in chosen if (e := scorer.library[i].effect) is not None and _has_clock(e)]
    others = [i for i in chosen if i not in old and scorer.library[i].effect not in friction]
    before = [(e.joints, e.searched()) for i in old if (e := scorer.library[i].effect) is not None]
    swings = any("damping" in values for _, values in before)
    limits = {joints: values["speed_limit"] for joints, values in before if "speed_limit" in values}
    none = bench.y + sum((b for i in old if (b := scorer.library[i].nonlinear) is not None), np.zeros_like(bench.y))
    with scorer.against(none):
        given = ConditionalGain(bench, scorer, others)
    for ends in groups:
        mine = [tuple(one for one in friction if e.joint in ("", *one.joints)) for e in ends]
        fastest = [limits.get(e.joints, limits.get(())) for e in ends]
        searches = [
            ClockSearch(bench, given, e, some, swings, limit)
            for e, some, limit in zip(ends, mine, fastest, strict=True)
        ]
        clocks = [clock for search in searches for clock in search.best_interpolation()]
        yield clocks, {one: other for search in searches for one, other in search.replacements.items()}


def _has_clock(effect: Effect) -> bool:
    """Return whether a clock is part of what an effect describes, as the lag of a servo that sticks is."""
    return any(effect_class(key).CLOCK for key in effect.contains)


def _exchanged(
    bench: Bench,
    scorer: Scorer,
    out: Selection,
    clocks: Clocks,
    instead: dict[Effect, Effect],
    *,
    nearly: int = 0,
) -> bool:
    """Return whether a model with other timing effects, all else passed through them, was better and was taken.

    `nearly`: only if these take nearly all excess wherever they are better, in so many channels at least.
    """
    before, errors, old = scorer.solve(out.chosen)[2], held_out_errors(out, out.chosen), _ends(scorer, out.chosen)
    gone = [one for i in old if (one := scorer.library[i].effect) is not None]
    penalty = (parameter_count([one for one, _ in clocks]) - parameter_count(gone)) * float(
        np.log(bench.noise.effective)
    )
    # The interpolation between two rows is no parameter.
    told = {one.interpolation for one in gone} != {one.interpolation for one, _ in clocks}
    plainer = parameter_count([one for one, _ in clocks]) < parameter_count(gone) + told
    with out.attempt() as attempt:
        out.chosen = trial = _with_timing(bench, scorer, [i for i in out.chosen if i not in old], clocks, instead)
        better = before - scorer.solve(trial)[2] - penalty > CRITERIA.log_odds
        attempt.kept = better and _pays(out, errors, held_out_errors(out, trial), nearly=nearly, plainer=plainer)
    if attempt.kept:
        _same_interpolation(scorer, clocks)
    return attempt.kept


def _with_timing(
    bench: Bench, scorer: Scorer, others: list[int], clocks: Clocks, instead: dict[Effect, Effect]
) -> list[int]:
    """Return a model of the other effects passed through these timing effects, converged, and the timing effects."""
    kept = [(end, theta) for end, theta in bench.timing if not end.CLOCK]
    ends = [(effect, np.array([size]) if effect.held is None else effect.held) for effect, size in clocks]
    # Temporarily: the search passes all columns through the chosen timing effects later.
    with bench.delivering([*kept, *ends]):
        fresh = [scorer.retimed(_in_place_of(bench, scorer.library[i], instead)) for i in others]
        for effect, size in clocks:
            h = bench.hypothesis(effect)
            fresh.append(tangent(bench, h, np.array([size])) if effect.SHIFT else h)
        nonlinear = sum((h.nonlinear for h in fresh if h.nonlinear is not None), np.zeros_like(bench.y))
        bench.update_state(y=bench.whole - bench.state.interaction - nonlinear)
        scorer.append(fresh)
        scorer.retarget(bench.y)
        trial = list(range(len(scorer.library) - len(fresh), len(scorer.library)))
        settle(bench, scorer, trial, anew=True)
    return trial


def _same_interpolation(scorer: Scorer, clocks: Clocks) -> None:
    """Give the timing effects in the library the interpolation between rows that the chosen ones of their joints have."""
    told = {end.joints: end.interpolation for end, _ in clocks}
    for i, h in enumerate(scorer.library):
        end = h.effect
        if end is not None and end.CLOCK and end.interpolation != told.get(end.joints, end.interpolation):
            scorer.rename(i, end.interpolated(told[end.joints]))


def _in_place_of(bench: Bench, h: Hypothesis, instead: dict[Effect, Effect]) -> Hypothesis:
    """Return the replacement of the hypothesis, or itself."""
    return h if h.effect is None or h.effect not in instead else bench.hypothesis(instead[h.effect], h.trials)


def _pays(out: Selection, before: Array, after: Array, *, nearly: int, plainer: bool) -> bool:
    """Return whether errors (n, C) on held-out blocks fall as a finding requires; with fewer parameters, do not rise.

    `nearly`: by nearly all of the excess wherever they fall, in so many channels at least.
    """
    gain = paired(before, after, out.initial_mean_square / out.bench.noise.sigma**2 - 1.0)
    if nearly:
        old, new = (np.mean(x**2, axis=0) - 1.0 for x in (before, after))
        fallen = (old - new) / np.maximum(old, NOTHING)
        fallen = fallen[fallen >= RICHER]
        return len(fallen) >= nearly and bool(np.min(fallen) >= COMPLETE) and gain.fall > 0.0
    return gain.tolerable if plainer else improves(out, before, after)
