"""All models side by side on sets that none of them saw: same configuration, new configuration, other day."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.spatial import Array

HELD = 0.95
"""Of a push's largest force: it is held."""
LEAST_REST = 20
"""Rows of a rest whose mean is worth taking; shorter ones are crossings of zero, and their means are noise."""


@dataclass(frozen=True)
class Score:
    """How a model did on held-out sets; all errors are counted as `counted` does.

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
    """Errors of a fitted model on the rows that count."""
    rmse, released, predicted, residuals = {}, [], {}, []
    for kind, sets in held_out.items():
        errors = []
        for s in sets:
            give = model.predict(s)
            predicted[s.name] = give
            error = counted(s, s.give[:, :3] - give[:, :3])
            errors.append(error[judged(s)])
            released.append(error[after_push(s)])
            residuals.append(residual_give(s, give))
        if errors:
            rmse[kind] = _rms(np.concatenate(errors))
    late = np.concatenate(released) if released else np.zeros((0, 3))
    pairs = np.concatenate(residuals) if residuals else np.zeros((0, 2, 3))
    share = _rms(pairs[:, 0] - pairs[:, 1]) / max(_rms(pairs[:, 0]), 1e-12) if len(pairs) else float("nan")
    return Score(model.NAME, rmse, _rms(late) if len(late) else float("nan"), share, predicted)


def residual_give(data: DeflectionSet, give: Array) -> Array:
    """(K, 2, 3) what is left of the give after each of K releases, measured and predicted, from the mean of all K on."""
    found = rests(data)
    means = np.array([[g[rows, :3].mean(axis=0) for g in (data.give, give)] for rows in found]).reshape(-1, 2, 3)
    return np.asarray(means - means.mean(axis=0)) if len(means) > 1 else np.zeros((0, 2, 3))


def wall_shares(data: DeflectionSet, give: Array, walls: int = 9) -> tuple[float, float]:
    """Mean of `wrong_side` over walls across the way that the tip gives, for the reported and the corrected tip."""
    rows = judged(data)
    true, corrected = (counted(data, g[:, :3])[rows] for g in (data.give, give))
    _, vectors = np.linalg.eigh(true.T @ true)
    normal = vectors[:, -1]
    places = np.quantile(true @ normal, np.linspace(0.1, 0.9, walls))
    shares = [wrong_side(np.zeros_like(true), corrected, true, normal, float(p)) for p in places]
    return float(np.mean([s[0] for s in shares])), float(np.mean([s[1] for s in shares]))


def counted(data: DeflectionSet, values: Array) -> Array:
    """(N, ...) values less their mean over the later half of the rests, which takes what is left of the registration out.

    Not over the earlier ones: what the friction remembers there of the way to the place nobody knows, and the pushes wipe
    that out one joint after the other. A set without a rest is counted from the mean of the rows that count.
    """
    found = rests(data)
    found = found[len(found) // 2 :]
    zero = (
        np.mean([values[rows].mean(axis=0) for rows in found], axis=0) if found else values[judged(data)].mean(axis=0)
    )
    return np.asarray(values - zero)


def judged(data: DeflectionSet) -> NDArray[np.bool_]:
    """(N,) bool: rows from the first hold on; before it nobody knows what the friction remembers."""
    size, free = np.linalg.norm(data.force, axis=1), np.flatnonzero(after_push(data))
    first = size[: free[0]] if len(free) else size
    return np.arange(len(data)) >= np.argmax(first >= HELD * first.max())


def rests(data: DeflectionSet, settle_s: float = 0.3) -> list[NDArray[np.intp]]:
    """Rows of each rest after a push, without its first moments; crossings of zero are too short to be one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], after_push(data).astype(int), [0]])))
    spans = [np.arange(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    settled = [rows[data.time[rows] > data.time[rows[0]] + settle_s] for rows in spans]
    return [rows for rows in settled if len(rows) >= LEAST_REST]


def first_rest(data: DeflectionSet) -> NDArray[np.bool_]:
    """(N,) bool: rows before the first push."""
    size = np.linalg.norm(data.force, axis=1)
    pushed = np.flatnonzero(size > max(0.05 * size.max(), 0.1))
    rows = np.zeros(len(data), dtype=bool)
    rows[: max(int(pushed[0]) if len(pushed) else len(rows), 1)] = True
    return rows


def after_push(data: DeflectionSet) -> NDArray[np.bool_]:
    """(N,) bool: rows without force that come after a push."""
    size = np.linalg.norm(data.force, axis=1)
    free = size < max(0.05 * size.max(), 0.1)
    return np.asarray(free & ~first_rest(data))


def wrong_side(reported: Array, corrected: Array, true: Array, normal: Array, offset_m: float) -> tuple[float, float]:
    """Shares of the time in which the reported and the corrected tip are on the wrong side of the wall n . x = offset.

    Args:
        reported, corrected, true: (N, 3) tip, m; normal: (3,) of the wall.
    """
    side = [np.sign(p @ normal - offset_m) for p in (reported, corrected, true)]
    return float(np.mean(side[0] != side[2])), float(np.mean(side[1] != side[2]))


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
