"""The gain of one more hypothesis given a model, and Levenberg-Marquardt steps to its nonlinear optimum."""

from typing import TYPE_CHECKING

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import residuals
from galen_hw.diagnosis.estimation.linearisation import contribution, tangent
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.linear_algebra import inverse_root, solve_sym
from galen_hw.physics.effects.columns import Columns
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.stats.sampling import Index


class ConditionalGain:
    """Compute the gain of one more hypothesis given a model, by the Schur complement of the normal equations."""

    def __init__(self, bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
        model = [h for h in scorer.parts(chosen) if np.isnan(h.fixed).all()]
        residual, rows = residuals(bench, scorer, chosen)[1], bench.train
        self.train, self.width, self.scene = rows, bench.width, bench.scene
        self.residual = [residual[rows, c] for c in range(bench.width)]
        ends = np.cumsum([0, *(h.count for h in model)])
        self.at: list[Index] = []
        self.columns: list[Array] = []
        G = np.zeros((ends[-1], ends[-1]))
        for c in range(bench.width):
            mine = [(h, k) for k, h in enumerate(model) if c in h.white.channels and h.count]
            at = [np.arange(ends[k], ends[k + 1]) for _, k in mine]
            parts = [h.white.values[:, h.white.channels.index(c)][rows] for h, _ in mine]
            self.at.append(np.concatenate([np.empty(0, dtype=np.intp), *at]))
            self.columns.append(np.concatenate([np.empty((int(rows.sum()), 0)), *parts], axis=1))
            G[np.ix_(self.at[c], self.at[c])] += self.columns[c].T @ self.columns[c]
        # Once: a search evaluates hundreds of trial points given one model.
        self.root = inverse_root(G)

    def gain(self, h: Hypothesis) -> float:
        """Return the fall of the whitened sum of squares when the hypothesis joins."""
        own, r = self.products(h)
        pinned = h.pinned_gain(self.scene, own, r)
        return pinned if pinned is not None else float(r @ solve_sym(own, r[:, None])[:, 0])

    def fixed_gain(self, h: Hypothesis) -> float:
        """Return the gain of the columns with all coefficients fixed at 1."""
        own, r = self.products(h)
        return float(2.0 * r.sum() - own.sum())

    def products(self, h: Hypothesis) -> tuple[Array, Array]:
        """Return the Schur complement (k, k) of its columns and the projected right-hand side (k,)."""
        own, r, cross = np.zeros((h.count, h.count)), np.zeros(h.count), np.zeros((len(self.root), h.count))
        for i, c in enumerate(h.white.channels):
            X = h.white.values[:, i][self.train]
            own += X.T @ X
            r += X.T @ self.residual[c]
            cross[self.at[c]] += self.columns[c].T @ X
        explained = self.root.T @ cross
        return own - explained.T @ explained, r


def descended(
    bench: Bench,
    given: ConditionalGain,
    h: Hypothesis,
    theta: Array,
    steps: int = BUDGET.steps,
    *,
    enough: float = 0.1,
    first: float = 0.001,
    stuck: float = 1e6,
) -> tuple[float, Hypothesis]:
    """Return the least cost given a model that damped steps from theta (k,) reach within bounds, and the tangent there.

    Source: Levenberg 1944, Marquardt 1963; the model's own parameters are solved for at each step (variable projection).

    Args:
        enough: fall of twice the log likelihood that an undamped step must promise, and that must have been paid for another.
        first: damping of the first step, of the square of each column; ten times more where a step does not pay,
            a tenth where it does.
        stuck: damping beyond which no step pays.
    """
    assert h.effect is not None, "nuisances are linear"
    named = h.effect.parameters(bench.scene)
    low, high = np.array([max(p.low, -p.furthest) for p in named]), np.array([min(p.high, p.furthest) for p in named])
    theta = np.clip(theta, low, high)
    here, cost, A, r = _step_from(bench, given, h, theta)
    damping = first
    for _ in range(steps):
        step = solve_sym(A + damping * np.diag(np.diag(A)), r[:, None])[:, 0]
        if damping <= first and float(r @ step) < enough:
            break
        further = np.clip(theta + step, low, high)
        paid = cost - _cost(bench, given, h, further)
        if not paid > 0.0:
            damping *= 10.0
            if damping > stuck:
                break
            continue
        theta, damping = further, 0.1 * damping
        here, cost, A, r = _step_from(bench, given, h, theta)
        if paid < enough:
            break
    return cost, here


def _cost(bench: Bench, given: ConditionalGain, h: Hypothesis, theta: Array) -> float:
    """Return the whitened sum of squares given a model with the effect at theta, less that without it."""
    assert h.effect is not None, "nuisances are linear"
    there = contribution(bench, h.effect, theta)
    return -given.fixed_gain(bench.hypothesis_of(None, Columns(tuple(range(bench.width)), there[:, :, None])))


def _step_from(
    bench: Bench, given: ConditionalGain, h: Hypothesis, theta: Array
) -> tuple[Hypothesis, float, Array, Array]:
    """Return the tangent at theta, its cost given the model, and normal equations A (k, k), r (k,) of the next step."""
    here = tangent(bench, h, theta)
    assert here.nonlinear is not None, "a tangent has one"
    own = here.nonlinear + here.raw.values @ theta
    raw = Columns(here.raw.channels, np.concatenate([here.raw.values, own[:, :, None]], axis=2))
    G, b = given.products(bench.hypothesis_of(None, raw))
    return here, float(G[-1, -1] - 2.0 * b[-1]), G[:-1, :-1], b[:-1] - G[:-1, -1]
