"""Generalised least squares fits of a model and their residuals."""

from collections.abc import Sequence

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis, with_parameters
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.stats.linear_algebra import pinned_at
from galen_hw.diagnosis.stats.sampling import Chosen
from galen_hw.spatial import Array

Normal = tuple[Array, Array]
"""Normal equations: inner products (k, k) of a model's whitened columns, and those (k,) with the residual."""


def normal_equations(model: list[Hypothesis], white: Array, parts: Sequence[Chosen], width: int) -> list[Normal]:
    """Return the normal equations of a model on each part of the rows: those of several parts are their sum."""
    size = sum(h.count for h in model)
    out = [(np.zeros((size, size)), np.zeros(size)) for _ in parts]
    starts = np.cumsum([0, *(h.count for h in model)])
    for c in range(width):
        mine = [(h, s) for h, s in zip(model, starts, strict=False) if c in h.white.channels]
        if not mine:
            continue
        at = np.concatenate([np.arange(s, s + h.count) for h, s in mine])
        columns = np.concatenate([h.white.values[:, h.white.channels.index(c)] for h, _ in mine], axis=1)
        for (G, b), rows in zip(out, parts, strict=True):
            X = columns[rows]
            G[np.ix_(at, at)] += X.T @ X
            b[at] += X.T @ white[rows, c]
    return out


def solved(model: list[Hypothesis], normal: Sequence[Normal], stays: Array | None = None) -> Array:
    """Return the parameters (k,) that solve the normal equations of some parts of the rows together.

    `stays`: (k,) fixed values of parameters besides those of the hypotheses themselves, NaN for free ones.
    """
    fixed = np.concatenate([np.empty(0), *(h.fixed for h in model)])
    G, b = (np.sum([one[k] for one in normal], axis=0) for k in range(2))
    return pinned_at(fixed if stays is None else np.where(np.isnan(fixed), stays, fixed), G, b)


def fit(model: list[Hypothesis], white: Array, rows: Chosen, width: int, stays: Array | None = None) -> Array:
    """Fit a model by generalised least squares on some rows, and return its parameters (k,), see `solved`."""
    return solved(model, normal_equations(model, white, [rows], width), stays)


def predicted(model: list[Hypothesis], theta: Array, rows: Chosen, width: int, *, whitened: bool = False) -> Array:
    """Return the prediction (len(rows), C) of a model, raw or whitened."""
    out = np.zeros((len(rows), width))
    for h, t in with_parameters(model, theta):
        columns = h.white if whitened else h.raw
        out[:, list(columns.channels)] += columns.values[rows] @ t
    return out


def residuals(bench: Bench, scorer: Scorer, chosen: list[int]) -> tuple[Array, Array]:
    """Return the residual (M, C) of a model, raw and whitened."""
    theta = scorer.solve(chosen)[0]
    residual, white = bench.y.copy(), scorer.white.copy()
    for h, t in with_parameters(scorer.parts(chosen), theta):
        residual[:, list(h.raw.channels)] -= h.raw.values @ t
        white[:, list(h.white.channels)] -= h.white.values @ t
    return residual, white


def reduced_chi2(bench: Bench, scorer: Scorer, chosen: list[int]) -> float:
    """Return the reduced chi square of a model's residual on the training rows: the larger of whitened and raw.

    It is 1 for noise alone. Missing physics passes for slow noise in the weights of a short recording; single samples show it.
    """
    residual = residuals(bench, scorer, chosen)[0][np.ix_(bench.train, ~bench.without_data)]
    noise = (bench.noise.sigma**2 * bench.noise.slow_power_ratio)[~bench.without_data]
    return max(scorer.misfit(chosen), float(np.mean(residual**2 / noise)))
