"""Comparison of candidates in each other's place, each at its optimum."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from galen_hw.diagnosis.estimation.candidate import Hypothesis, identity_of, place_of, with_parameters
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import fit, residuals
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain
from galen_hw.diagnosis.estimation.linearisation import nonlinear_restored, tangent
from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.stats.paired_test import paired
from galen_hw.physics.effects.base import DOUBT, Effect
from galen_hw.spatial import Array


def in_place(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> dict[int, Score]:
    """Return the scores of every hypothesis in the place of the chosen one i, itself included; near rivals at their optimum.

    Where i is nonlinear, the others are scored on the residual with its nonlinear remainder restored.
    """
    others, residual = [j for j in chosen if j != i], scorer.solve(chosen)[2]
    firm, found = len(scorer.library), dict[object, tuple[Hypothesis, Score]]()
    with nonlinear_restored(scorer, i), without_timing(scorer, i) as for_a_while:
        scores = scorer.scores(others)[0]
        if i not in scores:
            return {j: s for j, s in scores.items() if j < firm}
        gain = scorer.solve(others)[2] - residual
        scores[i] = replace(scores[i], gain=gain, rank=scores[i].rank + gain - scores[i].gain)
        for j in _near(scorer, scores, i):
            h = scorer.library[j]
            if h.theta is None and j != i and _is_nonlinear(bench, h):
                scores[j] = at_nonlinear_optimum(bench, scorer, others, j, scores[j])
            elif _on_a_grid(h):
                better = polished(bench, scorer, others, j)
                if better != j:
                    scores.update(scorer.scores(others, [better])[0])
        if for_a_while:
            for j in sorted((j for j in scores if j >= firm), key=lambda j: scores[j].rank):
                h = scorer.library[j]
                found[h.effect.family if h.effect else None] = h, scores.pop(j)
    if found:
        scorer.append([h for h, _ in found.values()])
        scores |= {firm + k: score for k, (_, score) in enumerate(found.values())}
    return scores


@contextmanager
def without_timing(scorer: Scorer, i: int) -> Iterator[bool]:
    """Remove the timing effect i from the output stage while the context lasts.

    Yield whether any columns pass through it: then hypotheses that join the library meanwhile leave it again.
    """
    bench, own, before = scorer.bench, scorer.library[i].effect, scorer.bench.timing
    others = [(end, theta) for end, theta in before if end != own]
    key = "" if own is None or len(others) == len(before) else own.KEY
    behind = [h for h in scorer.library if h.effect is not None and key in h.effect.BEHIND and h.theta is None]
    if not behind:
        yield False
        return
    with bench.delivering(others):
        fresh = [bench.hypothesis(h.effect, h.trials) for h in behind if h.effect is not None]
        with scorer.trying(fresh):
            yield True


def _is_nonlinear(bench: Bench, h: Hypothesis) -> bool:
    return h.effect is not None and h.effect.bends(bench.scene, np.zeros(h.count))


def _near(scorer: Scorer, scores: dict[int, Score], i: int) -> list[int]:
    """Return the chosen hypothesis and the best of the kinds that nearly reach its score."""
    leaders: dict[object, int] = {}
    for j in sorted(scores, key=lambda j: -scores[j].rank - scores[j].beyond):
        effect = scorer.library[j].effect
        short = scores[i].rank - scores[j].rank - scores[j].beyond
        if effect is None or short > LIMITS.near * scores[i].gain:
            break
        if loosens(effect, scorer.library[i].effect):
            continue
        leaders.setdefault(identity_of(effect), j)
    rivals = [j for j in leaders.values() if j != i][: LIMITS.rivals]
    return [i, *rivals]


def loosens(other: Effect | None, effect: Effect | None) -> bool:
    """Return whether the other is the linear relaxation of the effect, or a needlessly general response.

    A relaxation has more parameters than the physics. A response of second order in the place of a delay or a lag that is quicker
    than the rows follows noise between them; all timing effects are tested together elsewhere.
    """
    if other is None or effect is None:
        return False
    if other.swings and effect.CLOCK:
        return not effect.swings
    return effect.curved and not other.curved and place_of(other) == place_of(effect)


def _on_a_grid(h: Hypothesis) -> bool:
    """Return whether its searched values are from a grid; what was proposed from the residual has found its own."""
    return h.effect is not None and bool(h.effect.searched()) and h.trials == 1


def at_nonlinear_optimum(bench: Bench, scorer: Scorer, chosen: list[int], i: int, score: Score) -> Score:
    """Return the score of a nonlinear effect at its own optimum (Gauss-Newton) instead of by its slope at zero."""
    rows = np.flatnonzero(bench.train)
    before = float(np.sum(residuals(bench, scorer, chosen)[1][rows] ** 2))
    best = max(
        score.gain, *(before - float(np.sum(residual**2)) for residual in _gauss_newton_steps(bench, scorer, chosen, i))
    )
    return replace(score, gain=best, rank=score.rank + best - score.gain)


def _gauss_newton_steps(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> Iterator[Array]:
    """Yield whitened residuals (n, C) of the training rows with a nonlinear effect, after each Gauss-Newton step."""
    h, y, theta = scorer.library[i], bench.y, scorer.solve([*chosen, i])[0][-scorer.library[i].count :]
    base = scorer.parts(chosen)
    rows = np.flatnonzero(bench.train)
    for _ in range(2):
        new = tangent(bench, h, theta)
        assert new.nonlinear is not None, "a tangent has one"
        target = bench.whitened(y - new.nonlinear)
        model = [*base, new]
        solved = fit(model, target, rows, bench.width)
        residual = target[rows].copy()
        for part, t in with_parameters(model, solved):
            residual[:, list(part.white.channels)] -= part.white.values[rows] @ t
        theta = solved[-h.count :]
        yield residual


def vuong_statistic(bench: Bench, scorer: Scorer, others: list[int], i: int, j: int) -> float:
    """Return by how many standard errors hypothesis i explains the training blocks better than j, given the others.

    A likelihood ratio below its own spread is no evidence: it may be what both miss.

    Source: Vuong 1989, the likelihood ratio of models that are not nested, over blocks since rows depend on each other.
    """
    worse, better = (_best_residual(bench, scorer, others, k) for k in (j, i))
    gain = paired(worse, better, np.zeros(1))
    return gain.fall / max(gain.error, 1e-300)


def _best_residual(bench: Bench, scorer: Scorer, others: list[int], i: int) -> Array:
    """Return the whitened residual (n, C) of the training rows with hypothesis i at its optimum."""
    h = scorer.library[i]
    if h.theta is None and _is_nonlinear(bench, h):
        return min(_gauss_newton_steps(bench, scorer, others, i), key=lambda residual: float(np.sum(residual**2)))
    # The nonlinear remainder of a tangent is not in its columns.
    with nullcontext() if h.nonlinear is None else scorer.against(bench.y - h.nonlinear):
        pinned = None if h.effect is None else h.effect.pinned(bench.scene)
        if pinned is None or np.isnan(pinned).any():
            return residuals(bench, scorer, [*others, i])[1][bench.train]
    own = np.zeros_like(bench.y)
    own[:, list(h.raw.channels)] = h.raw.values @ pinned
    with scorer.against(bench.y - own):
        return residuals(bench, scorer, others)[1][bench.train]


def polished(bench: Bench, scorer: Scorer, chosen: list[int], i: int, passes: int = 1) -> int:
    """Optimise the searched values of a hypothesis, one after the other; return its number in the library, new or old."""
    hypothesis = scorer.library[i]
    effect = hypothesis.effect
    if effect is None or not effect.searched():
        return i
    given, best = ConditionalGain(bench, scorer, chosen), -np.inf
    for remaining in reversed(range(passes if len(effect.searched()) > 1 else 1)):
        for name, value in effect.searched().items():
            effect = _along(bench, given, effect, name, value)
        if remaining:
            before, best = best, given.gain(bench.hypothesis(effect))
            if best < before + LIMITS.tie:
                break
    scorer.append([bench.hypothesis(effect, hypothesis.trials)])
    last = len(scorer.library) - 1
    pair, _ = scorer.scores(chosen, [i, last])
    return last if last in pair and (i not in pair or pair[last].gain > pair[i].gain) else i


def _along(bench: Bench, given: ConditionalGain, effect: Effect, name: str, value: float) -> Effect:
    bound = effect.SEARCHED[name]
    wide = effect.doubt(bench.scene)

    def cost(log_value: float) -> float:
        h = bench.hypothesis(effect.with_searched({name: float(np.exp(log_value))}))
        return -given.gain(h)

    low, high = max(np.log(value / wide), np.log(bound.low)), min(np.log(value * wide), np.log(bound.high))
    if not high > low:
        return effect
    # Where the size is fixed, the searched value is the size; a narrow peak needs a finer tolerance.
    coarse = wide >= DOUBT and effect.pinned(bench.scene) is None
    tolerance, most = (3e-3, 12) if coarse else (min(1e-3, 1e-2 * np.log(wide)), 20)
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": tolerance, "maxiter": most})
    return effect.with_searched({name: float(np.exp(found.x))}) if found.fun < cost(np.log(value)) else effect
