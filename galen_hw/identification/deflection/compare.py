"""All models side by side on sets that none of them saw: same configuration, new configuration, other day."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Score:
    """How a model did on held-out sets.

    Args:
        model: its name.
        rmse: held-out kind ("same configuration", "new configuration", "other day") to rms of the tip's error, m.
        released: rms of the error while the force is back at zero after a push, m; what hysteresis and creep leave.
        residual: rms of residual give after a release that was not predicted, over the rms of what there was.
        predicted: per held-out set, (N, d) give.
    """

    model: str
    rmse: dict[str, float]
    released: float
    residual: float
    predicted: dict[str, Array]


def judge(model: DeflectionModel, held_out: Mapping[str, Sequence[DeflectionSet]]) -> Score:
    """Errors of a fitted model; what is left of the registration, a set's constant, goes by its first rest."""
    rmse, released, predicted, residuals = {}, [], {}, []
    for kind, sets in held_out.items():
        errors = []
        for s in sets:
            give = model.predict(s)
            predicted[s.name] = give
            error = s.give[:, :3] - give[:, :3]
            error = error - error[first_rest(s)].mean(axis=0)
            errors.append(error)
            released.append(error[after_push(s)])
            residuals.append(residual_give(s, give))
        if errors:
            rmse[kind] = _rms(np.concatenate(errors))
    late = np.concatenate(released) if released else np.zeros((0, 3))
    pairs = np.concatenate(residuals) if residuals else np.zeros((0, 2, 3))
    share = _rms(pairs[:, 0] - pairs[:, 1]) / max(_rms(pairs[:, 0]), 1e-12) if len(pairs) else float("nan")
    return Score(model.NAME, rmse, _rms(late) if len(late) else float("nan"), share, predicted)


def residual_give(data: DeflectionSet, give: Array, settle_s: float = 0.3) -> Array:
    """(K, 2, 3) what is left of the give after each of K releases, measured and predicted, from the first rest on."""
    start, free = first_rest(data), after_push(data)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(int), [0]])))
    out = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        rows = np.flatnonzero(data.time[a:b] > data.time[a] + settle_s) + a
        if len(rows) >= 20:  # Shorter rests are crossings of zero, and their means are noise.
            both = [(g[rows, :3].mean(axis=0) - g[start, :3].mean(axis=0)) for g in (data.give, give)]
            out.append(np.stack(both))
    return np.array(out).reshape(-1, 2, 3)


def wall_shares(data: DeflectionSet, give: Array, walls: int = 9) -> tuple[float, float]:
    """Mean of `wrong_side` over walls across the way that the tip gives, for the reported and the corrected tip."""
    true = data.give[:, :3] - data.give[first_rest(data), :3].mean(axis=0)
    corrected = give[:, :3] - give[first_rest(data), :3].mean(axis=0)
    _, vectors = np.linalg.eigh(true.T @ true)
    normal = vectors[:, -1]
    places = np.quantile(true @ normal, np.linspace(0.1, 0.9, walls))
    shares = [wrong_side(np.zeros_like(true), corrected, true, normal, float(p)) for p in places]
    return float(np.mean([s[0] for s in shares])), float(np.mean([s[1] for s in shares]))


def first_rest(data: DeflectionSet) -> Array:
    """(N,) bool: rows before the first push, where the arm has not been loaded yet."""
    size = np.linalg.norm(data.force, axis=1)
    pushed = np.flatnonzero(size > max(0.05 * size.max(), 0.1))
    rows = np.zeros(len(data), dtype=bool)
    rows[: max(int(pushed[0]) if len(pushed) else len(rows), 1)] = True
    return rows


def after_push(data: DeflectionSet) -> Array:
    """(N,) bool: rows without force that come after a push."""
    size = np.linalg.norm(data.force, axis=1)
    free = size < max(0.05 * size.max(), 0.1)
    return np.asarray(free & ~np.asarray(first_rest(data), dtype=bool))


def wrong_side(reported: Array, corrected: Array, true: Array, normal: Array, offset_m: float) -> tuple[float, float]:
    """Shares of the time in which the reported and the corrected tip are on the wrong side of the wall n . x = offset.

    Args:
        reported, corrected, true: (N, 3) tip, m; normal: (3,) of the wall.
    """
    side = [np.sign(p @ normal - offset_m) for p in (reported, corrected, true)]
    return float(np.mean(side[0] != side[2])), float(np.mean(side[1] != side[2]))


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
