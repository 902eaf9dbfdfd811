"""What is not linear in its parameters: effects linearised anew where they stand, late streams, searched values polished."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize_scalar

from galen_hw.diagnosis import stream
from galen_hw.diagnosis.algebra import solve_sym
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.linear import fit, rests
from galen_hw.diagnosis.score import Score, Scorer
from galen_hw.physics.effect import DOUBT, Columns, Downstream, Effect
from galen_hw.physics.sensor_effects import Saturation
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.rows import Index
    from galen_hw.physics.scene import Scene


def settle(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """Nonlinear effects are linearised anew where they stand; what they do beyond their slope is taken off the residual."""
    rebase(scorer, chosen)
    for _ in range(3):
        theta = scorer.solve(chosen)[0]
        done = sum(h.count for h in scorer.base)
        beyond, fresh, moved = np.zeros_like(bench.y), [], False
        for place, i in enumerate(chosen):
            h = scorer.library[i]
            t, done = theta[done : done + h.count], done + h.count
            if h.effect is None or h.effect.exact(bench.scene, t) is None:
                continue
            new = _settled(bench, scorer, chosen, i) if h.effect.curved else tangent(bench, h, t)
            assert new.bend is not None, "a tangent has one"
            assert new.theta is not None, "a tangent has one"
            beyond += new.bend
            moved = (
                moved or h.theta is None or bool(np.max(np.abs(h.theta - new.theta)) > 1e-3 * np.max(np.abs(new.theta)))
            )
            fresh.append((place, new))
        if not fresh or not moved:
            return
        bench.y = bench.whole - beyond
        scorer.append([h for _, h in fresh])
        for k, (place, _) in enumerate(fresh):
            chosen[place] = len(scorer.library) - len(fresh) + k
        scorer.retarget(bench.y)


def straightened(scorer: Scorer, chosen: list[int]) -> Array:
    """(M, C) residual less what the effects of a model predict beyond their slopes."""
    bends = [b for i in chosen if (b := scorer.library[i].bend) is not None]
    return np.asarray(scorer.bench.whole - sum(bends, np.zeros_like(scorer.bench.whole)))


def rebase(scorer: Scorer, chosen: list[int]) -> None:
    """The scorer is given the residual that belongs to a model, if it has another's."""
    y = straightened(scorer, chosen)
    if not _same(scorer, y):
        scorer.bench.y = y
        scorer.retarget(y)


def as_if(scorer: Scorer, chosen: list[int]) -> AbstractContextManager[None]:
    """The scorer for a while on the residual that belongs to a model."""
    y = straightened(scorer, chosen)
    return nullcontext() if _same(scorer, y) else scorer.against(y)


def _same(scorer: Scorer, y: Array) -> bool:
    return bool(np.max(np.abs(y - scorer.bench.y) / scorer.bench.noise.sigma, initial=0.0) < ROUNDING)


def _settled(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> Hypothesis:
    """The chosen hypothesis i, which is curved, at its optimum beside the others."""
    h = scorer.library[i]
    assert h.theta is not None, "it is chosen as a tangent"
    with unbent(scorer, i):
        beside = Beside(bench, scorer, [j for j in chosen if j != i])
    return descended(bench, beside, h, h.theta, AGAIN)[1]


def tangent(bench: Bench, h: Hypothesis, theta: Array) -> Hypothesis:
    """The hypothesis linearised at theta, with what it predicts there beyond slope times theta."""
    effect, scene = h.effect, bench.scene
    assert effect is not None, "nuisances are linear"
    here = effect.change(scene, theta)
    slopes = []
    for k, stride in enumerate(effect.strides(scene, theta).tolist()):
        step = np.zeros(h.count)
        step[k] = stride
        slopes.append((effect.change(scene, theta + step) - effect.change(scene, theta - step)) / (2.0 * stride))
    raw = bench.averaged(Columns(tuple(range(bench.width)), np.stack(slopes, axis=-1)))
    out = bench.made(effect, raw, h.looked)
    out.theta, out.bend = theta, bench.rows.average(here) - raw.values @ theta
    return out


NEARLY = 0.1
"""Share of a chosen effect's gain within which a rival may be better at its optimum than by its slope or on its grid."""
SLOPED = 0.25
"""The same of one that is not linear: its slope at zero is not yet what it does."""
MOST_NEAR = 3


def in_place(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> dict[int, Score]:
    """Scores of every hypothesis in the place of the chosen one i, which is among them; near rivals at their optimum.

    Where i is bent, the others are scored on the residual with its bend put back, as if i had never been there.
    """
    others, rest = [j for j in chosen if j != i], scorer.solve(chosen)[2]
    firm, found = len(scorer.library), dict[object, tuple[Hypothesis, Score]]()
    with unbent(scorer, i), unclocked(scorer, i) as for_a_while:
        scores = scorer.scores(others)[0]
        if i not in scores:
            return {j: s for j, s in scores.items() if j < firm}
        gain = scorer.solve(others)[2] - rest
        scores[i] = replace(scores[i], gain=gain, rank=scores[i].rank + gain - scores[i].gain)
        for j in _near(scorer, scores, i):
            h = scorer.library[j]
            if h.theta is None and j != i and _is_bent(bench, h):
                scores[j] = bent(bench, scorer, others, j, scores[j])
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
def unclocked(scorer: Scorer, i: int) -> Iterator[bool]:
    """The scorer for a while with other ends of the stream (a filter behind a delay) as if the chosen i had never been there.

    Whether there are any: then what joins the library meanwhile leaves it again.
    """
    bench, own, before = scorer.bench, scorer.library[i].effect, scorer.bench.timing
    others = [(end, theta) for end, theta in before if end != own]
    key = "" if own is None or len(others) == len(before) else own.KEY
    behind = [h for h in scorer.library if h.effect is not None and key in h.effect.BEHIND and h.theta is None]
    if not behind:
        yield False
        return
    bench.timing = others
    try:
        fresh = [bench.made(h.effect, bench.raw(h.effect), h.looked) for h in behind if h.effect is not None]
        with scorer.trying(fresh):
            yield True
    finally:
        bench.timing = before


def _is_bent(bench: Bench, h: Hypothesis) -> bool:
    return h.effect is not None and h.effect.exact(bench.scene, np.zeros(h.count)) is not None


def unbent(scorer: Scorer, i: int) -> AbstractContextManager[None]:
    """The scorer for a while on the residual as if the chosen hypothesis i had never been there."""
    bend = scorer.library[i].bend
    return nullcontext() if bend is None else scorer.against(scorer.bench.y + bend)


def _near(scorer: Scorer, scores: dict[int, Score], i: int) -> list[int]:
    """The chosen hypothesis and the best of the kinds that nearly reach it."""
    leaders: dict[object, int] = {}
    for j in sorted(scores, key=lambda j: -scores[j].rank - scores[j].beyond):
        effect = scorer.library[j].effect
        short = scores[i].rank - scores[j].rank - scores[j].beyond
        if effect is None or short > SLOPED * scores[i].gain:
            break
        if short > NEARLY * scores[i].gain and not _is_bent(scorer.bench, scorer.library[j]):
            continue
        leaders.setdefault((effect.family, *effect.searched()), j)
    rivals = [j for j in leaders.values() if j != i][:MOST_NEAR]
    return [i, *rivals]


def _on_a_grid(h: Hypothesis) -> bool:
    """Whether it has searched values, and these from a grid; what was sought in the residual has found its own."""
    return h.effect is not None and bool(h.effect.searched()) and h.looked == 1


ROUNDING = 1e-6
"""Of the noise."""
LATER = 0.1
"""A delay or lag that moves by more than this share makes all other effects' columns anew."""


def retime(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """What a late or lagging stream delivers of the other effects is late too: a delayed play is not a delay plus a play."""
    for _ in range(2):
        theta, now = scorer.solve(chosen)[0], list[tuple[Downstream, Array]]()
        done = sum(h.count for h in scorer.base)
        for i in chosen:
            h = scorer.library[i]
            t, done = theta[done : done + h.count], done + h.count
            if isinstance(h.effect, Downstream):
                now.append((h.effect, t))
        before = bench.stream
        load(bench, scorer, chosen)
        if _same_timing(bench.timing, now) and _same_clips(now, before, bench.stream):
            return
        bench.timing = now
        bench.stream.limited = frozenset(stream.limited(now))
        scorer.retime()
        settle(bench, scorer, chosen)


def load(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """The bench's stream is given what the model adds to the simulation: a reading that clips, clips all of it."""
    scene, theta = bench.scene, scorer.solve(chosen)[0]
    standing, done = np.zeros(bench.width), 0
    for h in scorer.base:
        if len(h.raw.channels) == 1:
            standing[h.raw.channels[0]] = theta[done]
        done += h.count
    effects = []
    for i in chosen:
        h = scorer.library[i]
        t, done = theta[done : done + h.count], done + h.count
        if h.effect is not None:
            effects.append((h.effect, t))
    carried = stream.carried(scene, effects, bench.timing)
    bench.stream = scene.carrying(standing, carried, stream.limited(bench.timing))


def _same_clips(timing: list[tuple[Downstream, Array]], old: "Scene", new: "Scene") -> bool:
    """Whether the readings that clip are the same ones, and come back to the same constants."""
    clips = [effect for effect, _ in timing if isinstance(effect, Saturation)]
    return all(np.array_equal(c.clipped(old), c.clipped(new)) for c in clips)


def _same_timing(old: list[tuple[Downstream, Array]], new: list[tuple[Downstream, Array]]) -> bool:
    return len(old) == len(new) and all(
        a == b and bool(np.max(np.abs(s - t)) <= LATER * np.max(np.abs(t)))
        for (a, s), (b, t) in zip(old, new, strict=True)
    )


def bent(bench: Bench, scorer: Scorer, chosen: list[int], i: int, score: Score) -> Score:
    """The score of a nonlinear effect at its own optimum (Gauss and Newton) instead of by its slope at zero."""
    rows = np.flatnonzero(bench.train)
    before = float(np.sum(rests(bench, scorer, chosen)[1][rows] ** 2))
    best = max(score.gain, *(before - float(np.sum(rest**2)) for rest in _approached(bench, scorer, chosen, i)))
    return replace(score, gain=best, rank=score.rank + best - score.gain)


def _approached(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> Iterator[Array]:
    """(n, C) whitened rests of the training rows by the model with a nonlinear effect, after each step of the search."""
    h, y, theta = scorer.library[i], bench.y, scorer.solve([*chosen, i])[0][-scorer.library[i].count :]
    base = [scorer.library[j] for j in [*range(len(scorer.base)), *chosen]]
    rows = np.flatnonzero(bench.train)
    for _ in range(2):
        new = tangent(bench, h, theta)
        assert new.bend is not None, "a tangent has one"
        target = bench.whitened(y - new.bend)
        model = [*base, new]
        solved = fit(model, target, rows, bench.width)
        rest, done = target[rows].copy(), 0
        for part in model:
            rest[:, list(part.white.channels)] -= part.white.values[rows] @ solved[done : done + part.count]
            done += part.count
        theta = solved[-h.count :]
        yield rest


def ahead(bench: Bench, scorer: Scorer, others: list[int], i: int, j: int) -> float:
    """By how many standard errors hypothesis i explains the training blocks better than j, both beside the others.

    Source: Vuong 1989, the likelihood ratio of models that are not nested, over blocks since rows depend on each other.
    Beside its own spread from block to block a likelihood ratio shows whether it is evidence, or what both miss.
    """
    fall = np.sum(_best_rest(bench, scorer, others, j) ** 2 - _best_rest(bench, scorer, others, i) ** 2, axis=1)
    _, block = np.unique(bench.block[bench.train], return_inverse=True)
    each = np.bincount(block, weights=fall)
    spread = float(each.std(ddof=1) * np.sqrt(len(each))) if len(each) > 1 else np.inf
    return float(each.sum() / max(spread, 1e-300))


def _best_rest(bench: Bench, scorer: Scorer, others: list[int], i: int) -> Array:
    """(n, C) whitened rest of the training rows with hypothesis i at its optimum."""
    h = scorer.library[i]
    if h.theta is None and _is_bent(bench, h):
        return min(_approached(bench, scorer, others, i), key=lambda rest: float(np.sum(rest**2)))
    # What a tangent predicts beyond its slope is not in its columns.
    with nullcontext() if h.bend is None else scorer.against(bench.y - h.bend):
        pinned = None if h.effect is None else h.effect.pinned(bench.scene)
        if pinned is None or np.isnan(pinned).any():
            return rests(bench, scorer, [*others, i])[1][bench.train]
    own = np.zeros_like(bench.y)
    own[:, list(h.raw.channels)] = h.raw.values @ pinned
    with scorer.against(bench.y - own):
        return rests(bench, scorer, others)[1][bench.train]


def polished(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> int:
    """The same effect with its searched values at the optimum: a new place in the library, or the old one."""
    hypothesis = scorer.library[i]
    effect = hypothesis.effect
    if effect is None or not effect.searched():
        return i
    for name, value in effect.searched().items():
        effect = _along(bench, scorer, chosen, effect, name, value)
    scorer.append([bench.add(effect, hypothesis.looked)])
    last = len(scorer.library) - 1
    pair, _ = scorer.scores(chosen, [i, last])
    return last if last in pair and (i not in pair or pair[last].gain > pair[i].gain) else i


def _along(bench: Bench, scorer: Scorer, chosen: list[int], effect: Effect, name: str, value: float) -> Effect:
    bound = effect.SEARCHED[name]
    beside = Beside(bench, scorer, chosen)
    wide = effect.doubt(bench.scene)

    def cost(log_value: float) -> float:
        h = bench.add(effect.with_searched({name: float(np.exp(log_value))}))
        return -beside.gain(h)

    low, high = max(np.log(value / wide), np.log(bound.low)), min(np.log(value * wide), np.log(bound.high))
    if not high > low:
        return effect
    # Where the size is not free, the searched value is the size; a narrow peak is a number by itself.
    coarse = wide >= DOUBT and effect.pinned(bench.scene) is None
    tolerance, most = (3e-3, 12) if coarse else (min(1e-3, 1e-2 * np.log(wide)), 20)
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": tolerance, "maxiter": most})
    return effect.with_searched({name: float(np.exp(found.x))}) if found.fun < cost(np.log(value)) else effect


class Beside:
    """What one more hypothesis would add to a model, from inner products with that model's columns alone."""

    def __init__(self, bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
        model = [scorer.library[i] for i in [*range(len(scorer.base)), *chosen]]
        model = [h for h in model if np.isnan(h.held).all()]
        rest, rows = rests(bench, scorer, chosen)[1], bench.train
        self.train, self.width, self.scene = rows, bench.width, bench.scene
        self.rest = [rest[rows, c] for c in range(bench.width)]
        ends = np.cumsum([0, *(h.count for h in model)])
        self.at: list[Index] = []
        self.columns: list[Array] = []
        self.G = np.zeros((ends[-1], ends[-1]))
        for c in range(bench.width):
            mine = [(h, k) for k, h in enumerate(model) if c in h.white.channels and h.count]
            at = [np.arange(ends[k], ends[k + 1]) for _, k in mine]
            parts = [h.white.values[:, h.white.channels.index(c)][rows] for h, _ in mine]
            self.at.append(np.concatenate([np.empty(0, dtype=np.intp), *at]))
            self.columns.append(np.concatenate([np.empty((int(rows.sum()), 0)), *parts], axis=1))
            self.G[np.ix_(self.at[c], self.at[c])] += self.columns[c].T @ self.columns[c]

    def gain(self, h: Hypothesis) -> float:
        """Fall of the whitened sum of squares when it joins."""
        own, r = self.products(h)
        pinned = h.pinned_gain(self.scene, own, r)
        return pinned if pinned is not None else float(r @ solve_sym(own, r[:, None])[:, 0])

    def whole(self, h: Hypothesis) -> float:
        """The same of what is known by size: its columns as they are."""
        own, r = self.products(h)
        return float(2.0 * r.sum() - own.sum())

    def products(self, h: Hypothesis) -> tuple[Array, Array]:
        """(k, k) of its columns beside the model, and (k,) with what that leaves."""
        own, r, cross = np.zeros((h.count, h.count)), np.zeros(h.count), np.zeros((len(self.G), h.count))
        for i, c in enumerate(h.white.channels):
            X = h.white.values[:, i][self.train]
            own += X.T @ X
            r += X.T @ self.rest[c]
            cross[self.at[c]] += self.columns[c].T @ X
        if len(self.G):
            own -= cross.T @ solve_sym(self.G, cross)
        return own, r


STEPS = 30
AGAIN = 4
"""Steps of what was at its optimum before something else changed."""
ENOUGH = 0.1
"""Fall of twice the log likelihood by which a step must have paid for another."""
DAMPING = 1e-3
"""Of the first step, of the square of each column; ten times more where a step does not pay, a tenth where it does."""
STUCK = 1e6


def descended(
    bench: Bench, beside: Beside, h: Hypothesis, theta: Array, steps: int = STEPS
) -> tuple[float, Hypothesis]:
    """The least cost beside a model that damped steps from theta (k,) lead to, and the tangent there.

    Source: Levenberg 1944, Marquardt 1963; the model's own parameters are solved for at each step (variable projection).
    """
    assert h.effect is not None, "nuisances are linear"
    low = np.array([p.low for p in h.effect.parameters(bench.scene)])
    here, cost, A, r = _step_from(bench, beside, h, theta)
    damping = DAMPING
    for _ in range(steps):
        further = np.maximum(theta + solve_sym(A + damping * np.diag(np.diag(A)), r[:, None])[:, 0], low)
        paid = cost - _cost(bench, beside, h, further)
        if not paid > 0.0:
            damping *= 10.0
            if damping > STUCK:
                break
            continue
        theta, damping = further, 0.1 * damping
        here, cost, A, r = _step_from(bench, beside, h, theta)
        if paid < ENOUGH:
            break
    return cost, here


def _cost(bench: Bench, beside: Beside, h: Hypothesis, theta: Array) -> float:
    """Whitened sum of squares beside a model with the effect at theta, less that without it."""
    assert h.effect is not None, "nuisances are linear"
    there = bench.rows.average(h.effect.change(bench.scene, theta))
    return -beside.whole(bench.made(None, Columns(tuple(range(bench.width)), there[:, :, None])))


def _step_from(bench: Bench, beside: Beside, h: Hypothesis, theta: Array) -> tuple[Hypothesis, float, Array, Array]:
    """The tangent at theta, its cost beside the model, and normal equations A (k, k), r (k,) of a step from there."""
    here = tangent(bench, h, theta)
    assert here.bend is not None, "a tangent has one"
    own = here.bend + here.raw.values @ theta
    raw = Columns(here.raw.channels, np.concatenate([here.raw.values, own[:, :, None]], axis=2))
    G, b = beside.products(bench.made(None, raw))
    return here, float(G[-1, -1] - 2.0 * b[-1]), G[:-1, :-1], b[:-1] - G[:-1, -1]
