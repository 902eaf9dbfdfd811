"""The joint fit: weighted, robust, with a covariance whose intervals hold what they promise.

Each iteration solves the weighted linear problem at the current point (Gauss-Newton; one iteration is exact for the
linear model), then takes the scatter of each channel from what is left, and, if robust, a weight for each whole pose
from how far its six residuals together lie out (a hand or a cable that touched spoils all channels of a pose).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, stats

from galen_hw.identification.model import Model, Unknowns
from galen_hw.identification.poses import Poses
from galen_hw.spatial import Array

ITERATIONS: Final = 40
ROUGH: Final = 6
"""Iterations with Huber's function: it only has to find the neighbourhood."""
HUBER, TUKEY = 3.2, 6.0
"""Tuning for the norm of six whitened residuals (its median is 2.3): Huber's knee and Tukey's zero."""
OUTLIER_CHANCE: Final = 0.01
"""Of calling any good pose of a sweep an outlier."""


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Args:
        model: what was fitted; theta: (p,) parameters; covariance: (p, p).
        residual: (n, 6) reading minus prediction; derivative: (n, 6, p).
        sigma: (6,) scatter of a pose's mean; scale: (n, 6) of each reading, the weights are 1 / scale^2.
        weight: (n,) robust weight of each pose, 1 for a good one.
        freedom: degrees of freedom of the scatter, for Student's t.
    """

    model: Model
    theta: Array
    covariance: Array
    residual: Array
    derivative: Array
    sigma: Array
    scale: Array
    weight: Array
    freedom: float

    @property
    def std(self) -> Array:
        """(p,) one standard deviation."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def t95(self) -> float:
        """Half-width of a 95 % interval in standard deviations."""
        return float(stats.t.ppf(0.975, self.freedom))

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Rows that lie further out than noise would bring any of so many, or that have no weight at all.

        The weight falls with the distance, which squared over six has Fisher's distribution: its scale is estimated too.
        """
        far = 6.0 * stats.f.isf(OUTLIER_CHANCE / len(self.weight), 6, self.freedom)
        return np.flatnonzero(self.weight <= _tukey(np.sqrt(np.minimum(far, TUKEY**2))))

    def value(self, name: str) -> float:
        """One parameter."""
        return float(self.theta[self.model.columns[name]])


def span_of(poses: Poses) -> tuple[float, float]:
    """First and last moment of a sweep."""
    return float(poses.clock.min()), float(poses.clock.max())


def fit(poses: Poses, unknowns: Unknowns, *, robust: bool = True, span: tuple[float, float] | None = None) -> Fit:
    """Fit the joint model to the poses given.

    Args:
        poses: rows to fit (`Poses.fit`); unknowns: what is fitted.
        robust: weigh poses by Huber's function and then Tukey's; otherwise all alike.
        span: of the drift's clock, that of the poses if None.

    Raises:
        numpy.linalg.LinAlgError: the numbers are not finite.
    """
    model = Model(poses, unknowns, span or span_of(poses))
    state = _start(model)
    stages = ("huber", "tukey") if robust else ("none",)
    for stage in stages:
        for turn in range(ROUGH if stage == "huber" else ITERATIONS):
            before = state.theta
            # What is known beforehand has no say until the scatter is known: it would win against a scatter too large.
            state = _iterate(model, state, stage, prior=turn > 1 or stage == "tukey")
            if turn > 2 and np.all(np.abs(state.theta - before) <= 1e-11 + 1e-7 * np.abs(before)):
                break
    return _finish(model, state, stages[-1])


@dataclass(frozen=True, slots=True)
class _State:
    theta: Array
    residual: Array
    J: Array
    sigma: Array
    scale: Array
    weight: Array
    inverse: Array


def _start(model: Model) -> _State:
    theta = np.zeros(len(model.names))
    n = len(model.poses)
    prediction, J = model.evaluate(theta)
    residual = model.poses.wrench - prediction
    scale = np.broadcast_to([1.0, 1.0, 1.0, 0.02, 0.02, 0.02], (n, 6))
    empty = np.zeros((len(theta), len(theta)))
    return _State(theta, residual, J, np.full(6, np.nan), scale, np.ones(n), empty)


def _iterate(model: Model, state: _State, stage: str, *, prior: bool) -> _State:
    white = (state.J / state.scale[:, :, None]) * np.sqrt(state.weight)[:, None, None]
    known, known_target = model.prior(state.theta)
    if not prior:
        known, known_target = known[:0], known_target[:0]
    rows = np.vstack([white.reshape(-1, len(state.theta)), known])
    size = np.linalg.norm(rows, axis=0)
    size[size == 0.0] = 1.0
    target = np.append((state.residual / state.scale * np.sqrt(state.weight)[:, None]).reshape(-1), known_target)
    step, _, _, _ = np.linalg.lstsq(rows / size, target, rcond=1e-10)
    theta = state.theta + step / size
    inverse = _inverse(rows.T @ rows)
    prediction, J = model.evaluate(theta)
    residual = model.poses.wrench - prediction
    share = _leverage(J, state.scale, state.weight, inverse)
    sigma, scale = _scales(model.poses, residual, state.weight, share, stage)
    weight = _weights(residual / scale, share, stage)
    return _State(theta, residual, J, sigma, scale, weight, inverse)


def _leverage(J: Array, scale: Array, weight: Array, inverse: Array) -> Array:
    """(n, 6) share of each reading in its own prediction."""
    white = J / scale[:, :, None]
    return np.asarray(weight[:, None] * np.einsum("ncp,pq,ncq->nc", white, inverse, white))


def _scales(poses: Poses, residual: Array, weight: Array, share: Array, stage: str) -> tuple[Array, Array]:
    """Scatter of each channel, and of each reading: what the poses' own variances say, raised to what is left.

    The residuals' variance is divided by the degrees of freedom that the fit left to the channel.
    """
    relative = _relative(poses)
    z2 = (residual / relative) ** 2
    if stage == "huber":
        # A high breakdown first: the median does not see a minority of touched poses.
        free = np.maximum(1.0 - share.mean(axis=0), 0.1)
        variance = np.median(z2, axis=0) / stats.chi2.ppf(0.5, 1) / free
    else:
        free = np.maximum((weight[:, None] * (1.0 - share)).sum(axis=0), 1.0)
        variance = (weight[:, None] * z2).sum(axis=0) / free / _consistency(stage)
    floor = (1e-13 * np.maximum(np.abs(poses.wrench).max(axis=0), 1e-3)) ** 2
    sigma = np.sqrt(np.maximum(variance, floor))
    return sigma, sigma * relative


def _relative(poses: Poses) -> Array:
    """(n, 6) scatter of each reading in units of the channel's typical one, at most a factor of three apart."""
    variance = np.asarray(poses.variance, dtype=float)
    if not np.all(np.isfinite(variance)) or np.any(variance <= 0.0):
        return np.ones_like(variance)
    # The variance of one pose is itself uncertain: half of it is taken from all the poses.
    pooled = variance.mean(axis=0)
    ratio: Array = np.clip(np.sqrt(0.5 + 0.5 * variance / pooled), 1.0 / 3.0, 3.0)
    return ratio if np.max(variance / pooled) > 4.0 else np.ones_like(ratio)


def _weights(z: Array, share: Array, stage: str) -> Array:
    """(n,) weight of each pose from the norm of its whitened residuals, made comparable by its leverage."""
    if stage == "none":
        return np.ones(len(z))
    d = np.sqrt((z**2 / np.maximum(1.0 - share, 0.2)).sum(axis=1))
    return _huber(d) if stage == "huber" else _tukey(d)


def _huber(d: Array) -> Array:
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(d, 1e-300)))


def _tukey(d: Array) -> Array:
    return np.asarray(np.where(d < TUKEY, (1.0 - (d / TUKEY) ** 2) ** 2, 0.0))


@lru_cache
def _consistency(stage: str) -> float:
    """E[w d^2] / (6 E[w]) for normal residuals: what the weights take off the variance."""
    if stage != "tukey":
        return 1.0
    return _mean(lambda d: _tukey(d) * d**2) / (6.0 * _mean(_tukey))


def _tukey_slope(d: Array) -> Array:
    """The slope w + w' d / 6: how much of a small shift of six residuals reaches the sum, averaged over directions."""
    derivative = np.where(d < TUKEY, -4.0 * d / TUKEY**2 * (1.0 - (d / TUKEY) ** 2), 0.0)
    return np.asarray(_tukey(d) + d * derivative / 6.0)


def _mean(f: Callable[[Array], Array]) -> float:
    """Mean of f over the norm of six standard normal numbers."""
    value, _ = integrate.quad(lambda d: float(f(np.asarray(d))) * stats.chi.pdf(d, 6), 0.0, 15.0, limit=200)
    return float(value)


def _finish(model: Model, state: _State, stage: str) -> Fit:
    """Covariance by the sandwich: bread from the weights' slope, filling from the residuals' 6 x 6 scatter."""
    z = state.residual / state.scale
    share = np.clip(_leverage(state.J, state.scale, state.weight, state.inverse), 0.0, 0.99)
    good = state.weight > 0.0
    slope = np.ones(len(z))
    if stage == "tukey":
        slope = np.clip(_tukey_slope(np.sqrt((z**2 / (1.0 - share)).sum(axis=1))), 0.0, None)
    free = np.maximum((good[:, None] * (1.0 - share)).sum(axis=0), 1.0)
    pulled = state.weight[:, None] * z
    S = pulled.T @ pulled / np.sqrt(np.outer(free, free))
    white = state.J / state.scale[:, :, None]
    prior, _ = model.prior(state.theta)
    bread = _inverse(np.einsum("n,ncp,ncq->pq", slope, white, white) + prior.T @ prior)
    filling = np.einsum("ncp,cd,ndq->pq", white[good], S, white[good]) + prior.T @ prior
    covariance = bread @ filling @ bread
    return Fit(
        model, state.theta, covariance, state.residual, state.J, state.sigma, state.scale, state.weight, free.mean()
    )


def _inverse(A: Array) -> Array:
    """Inverse of a symmetric matrix whose rows have different units."""
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    return np.asarray(np.linalg.pinv(A / np.outer(size, size), rcond=1e-14, hermitian=True) / np.outer(size, size))
