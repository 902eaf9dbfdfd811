"""Judgement of a model on held-out data, and backward elimination of unsupported effects."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.cross_validation import cross_validated
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.residual_model import Remainder
from galen_hw.diagnosis.selection.acceptance import undo_each_other
from galen_hw.diagnosis.stats.paired_test import Gain, paired
from galen_hw.diagnosis.validation.judgement import ELSEWHERE, Judged, touched
from galen_hw.diagnosis.validation.other_recording import apply, noise_ratio, undisturbed
from galen_hw.diagnosis.validation.support import HoldoutTest
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import effect_class
from galen_hw.physics.scenes.base import Scene

if TYPE_CHECKING:
    from galen_hw.spatial import Array


def judge(model: Model, holdout: Scene | None, first: Judged | None = None) -> Judged:
    """Return errors before and after on held-out rows, or on another recording.

    `first`: an earlier judgement; smaller models are judged on the same rows as the largest, or a poor one would call its
    residual a contact and be judged on the other rows.
    """
    bench = model.bench
    keys = list(dict.fromkeys(h.effect.KEY for h in model.effects if h.effect is not None))
    # The baseline's constants are fitted by plain least squares.
    baseline = Model(bench, [Hypothesis(None, h.raw, h.raw) for h in model.nuisances], [], bench.whole)
    smaller = {
        key: model.without([h for h in model.effects if h.effect is not None and key == h.effect.KEY]) for key in keys
    }
    floor = bench.noise.sigma**2
    residual: Array
    if holdout is None:
        rows = bench.judged if bench.judged.any() else bench.train
        name = "contiguous blocks set aside" if bench.judged.any() else "the recording itself"
        before = np.asarray(np.mean(baseline.residual()[rows] ** 2, axis=0))
        judged = Judged(name, before, np.mean(model.residual()[rows] ** 2, axis=0), {}, floor)
        free = rows & ~touched(model)
        if 0 < free.sum() < rows.sum():
            judged.outside_contacts = np.asarray(np.mean(model.residual()[free] ** 2, axis=0))
        test = HoldoutTest(
            floor, lambda part: part.residual()[rows], lambda part: part.residual(white=True)[rows], model, baseline
        )
    else:
        if first is None or first.good is None:
            good, episodes = undisturbed(model, holdout)
        else:
            good, episodes = first.good, first.episodes
        residual = apply(model, holdout, good)
        before = np.mean(apply(baseline, holdout, good)[good] ** 2, axis=0)
        floor = floor * noise_ratio(model, residual[good])
        judged = Judged(
            ELSEWHERE, before, np.mean(residual[good] ** 2, axis=0), {}, floor, episodes=episodes, good=good
        )
        noise = replace(bench.noise, rows=bench.rows.of(holdout.segments), cache={})
        test = HoldoutTest(
            floor,
            lambda part: apply(part, holdout, good)[good],
            lambda part: noise.bridged(apply(part, holdout, good), good)[good],
            model,
            baseline,
        )
    for key, part in smaller.items():
        judged.without[key] = np.mean(test.raw(part) ** 2, axis=0)
        _ask(judged, key, test, (model, part, baseline), len(smaller), elsewhere=holdout is not None)
    judged.by_place = _places(model, test, len(smaller))
    return judged


def _ask(
    judged: Judged, key: str, test: HoldoutTest, models: tuple[Model, Model, Model], questions: int, *, elsewhere: bool
) -> None:
    """Test one kind of effect on held-out rows.

    A momentary effect shows nowhere else: its own rows alone support it, and held-out rows can only contradict it.

    Args:
        models: with all effects, without the one asked for, and without any; elsewhere: another recording judges.
    """
    model, part, baseline = models
    informative, tests = test.could_tell(part, questions), test.gains(part)
    if not effect_class(key).lasting():
        # In another recording these rows only show the sizes of other episodes.
        if not elsewhere and informative and all(one.fall < 0.0 for one in tests):
            judged.refused.add(key)
        tests = [_at_moments(model, part, baseline)]
    elif elsewhere and not informative:
        judged.cross_validated.add(key)
        tests = [_cross_validated_gain(model, part)]
    elif test.belied(part, _channels(model, key), questions):
        judged.refused.add(key)
    # The first gain is that of raw errors.
    judged.gains[key], judged.tests[key] = tests[0], tests


def _at_moments(model: Model, part: Model, baseline: Model) -> Gain:
    """Return the gain of what a smaller model lacks, on its training rows, which alone hold its moments."""
    good, sigma = ~model.bench.excluded_rows, model.bench.noise.sigma
    residual, without, before = (one.residual()[good] / sigma for one in (model, part, baseline))
    learnt = sum(h.effective_parameters(whole=True) for h in model.effects) - sum(
        h.effective_parameters(whole=True) for h in part.effects
    )
    return paired(without, residual, np.mean(before**2, axis=0) - 1.0, parameters=learnt)


def _cross_validated_gain(model: Model, part: Model) -> Gain:
    """Return the gain of what a smaller model lacks, on held-out blocks of its own recording.

    A temperature or a joint that does not move in another recording neither supports an effect nor contradicts it.
    """
    each = (model, part, model.without(model.effects))
    residual, without, before = (cross_validated(model.bench, one.parts, one.white, whitened=True) for one in each)
    return paired(without, residual, np.mean(before**2, axis=0) - 1.0)


def judge_remainder(model: Model, holdout: Scene | None, judged: Judged, remainder: Remainder | None) -> Judged:
    """Return the judgement with a remainder's predictions, in the channels where held-out data support them."""
    bench = model.bench
    if remainder is None:
        return judged
    if holdout is None:
        rows = bench.judged if bench.judged.any() else bench.train
        residual = model.residual()[rows]
        fuller = residual - remainder.own(bench.width)[rows]
    else:
        said = remainder.predict(holdout, bench.rows.of(holdout.segments), bench.width)
        if said is None:
            return judged
        good = np.ones(len(said), dtype=bool) if judged.good is None else judged.good
        residual, fuller = (apply(model, holdout, good, besides)[good] for besides in (None, said))
    unnamed = judged.after.copy()
    for c in remainder.parts:
        better = float(np.mean(fuller[:, c] ** 2))
        with_it, without = (x[:, [c]] / np.sqrt(judged.floor[c]) for x in (fuller, residual))
        gain = paired(without, with_it, judged.before[[c]] / judged.floor[[c]] - 1.0)
        if gain.credible(questions=len(remainder.parts)):
            unnamed[c] = better
    return replace(judged, with_generic=unnamed) if np.any(unnamed != judged.after) else judged


def _unexplained_channels(model: Model, key: str) -> list[int]:
    """Return the channels whose residual counts as unexplained; none for contacts, which are compared moment by moment."""
    touching = any(h.effect is not None and key == h.effect.KEY and h.effect.touches for h in model.effects)
    return [] if touching else _channels(model, key)


def _channels(model: Model, key: str) -> list[int]:
    return sorted({c for h in model.effects if h.effect is not None and key == h.effect.KEY for c in h.raw.channels})


def _places(model: Model, test: HoldoutTest, questions: int) -> dict[int, list[Gain]]:
    """Return the gains of each lasting effect whose kind is in several places, where these rows are informative."""
    keys = [h.effect.KEY for h in model.effects if h.effect is not None]
    out: dict[int, list[Gain]] = {}
    for k, h in enumerate(model.effects):
        if h.effect is None or not h.effect.lasting() or keys.count(h.effect.KEY) < 2:
            continue
        part = model.without([h])
        if test.could_tell(part, questions):
            out[k] = test.gains(part, h.raw.channels)
    return out


def backward_eliminated(model: Model, holdout: Scene | None, judged: Judged | None = None) -> tuple[Model, Judged]:
    """Remove effects that held-out data do not support, one at a time (backward elimination).

    A momentary effect shows nowhere else, and need not be supported there; it only must not make its channels worse. Where a kind
    is in several places (friction in five joints), each place needs its own support. Effects whose parameters are not significant
    go; effects stay without which another one is implausible. The model is fitted again after each removal: of two that explain
    the same one stays, and of two that need each other both do.

    Args:
        judged: of a larger model, whose rows are judged on again.
    """
    while True:
        judged = judge(model, holdout, judged)
        asked = len(judged.tests)
        weak = [
            (judged.gains[key].share, key)
            for key, tests in judged.tests.items()
            if key in judged.refused
            or not (_supported(judged, tests, _unexplained_channels(model, key), asked) or _is_needed(model, key))
        ]
        places = [
            (max(one.share for one in tests), k)
            for k, tests in judged.by_place.items()
            if not _supported(judged, tests, model.effects[k].raw.channels, asked)
        ]
        vague = _vague(model)
        if vague:
            out = vague
        elif places:
            # One place first: the kind may be supported without it.
            out = [model.effects[min(places)[1]]]
        elif weak:
            out = [h for h in model.effects if h.effect is not None and min(weak)[-1] == h.effect.KEY]
        else:
            return model, judged
        model = model.without(out)


def _supported(judged: Judged, tests: Sequence[Gain], channels: Sequence[int], questions: int) -> bool:
    """Return whether one of the tests is credible given what the model leaves unexplained."""
    return any(one.credible(unexplained=judged.unexplained(channels), questions=questions) for one in tests)


def _is_needed(model: Model, key: str) -> bool:
    """Return whether another effect is implausible without this kind: a loop whose linear part has a gear's sign."""
    smaller = model.without([h for h in model.effects if h.effect is not None and key == h.effect.KEY])
    return len(_impossible(smaller)) > len(_impossible(model))


def _impossible(model: Model) -> list[Effect]:
    """Return effects whose parameters do not fit their names."""
    spread, scene = np.sqrt(model.variance), model.bench.scene
    each = [(h.effect, s) for h, s in zip(model.parts, model.slices(), strict=True) if h.effect is not None]
    return [effect for effect, s in each if not effect.possible(scene, model.final[s], spread[s])]


def _vague(model: Model) -> list[Hypothesis]:
    """Return effects whose parameters do not prove their names or any size, and those that patch what another one misses.

    A size is two standard errors. Of several without one the least clear goes first: another one may then have its own. What
    two effects do is not to cancel but for a small part: then the rarer kind goes.
    """
    clear = [(model.clearness(h), k) for k, h in enumerate(model.effects)]
    if clear and min(clear)[0] < 2.0:
        return [model.effects[min(clear)[1]]]
    if undone := _cancelled(model):
        return undone
    effects = [
        (h, h.effect, s)
        for h, s in zip(model.parts, model.slices(), strict=True)
        if h.effect is not None and h.effect.PROVES
    ]
    if not effects:
        return []
    spread, every = np.sqrt(model.variance), [e for _, e, _ in effects]
    return [h for h, e, s in effects if e.patches(every) or not e.known(model.final[s], spread[s])]


def _cancelled(model: Model) -> list[Hypothesis]:
    """Return the rarer one of two effects of which each undoes nearly all that the other does; empty without such two."""
    each = [
        (h.effect.complexity, h, h.change(model.final[s], model.bench.width) / model.bench.noise.sigma)
        for h, s in zip(model.parts, model.slices(), strict=True)
        if h.effect is not None
    ]
    pairs = (pair for pair in combinations(each, 2) if undo_each_other(pair[0][2], pair[1][2]))
    return [max(pair, key=lambda one: one[0])[1] for pair in pairs][:1]
