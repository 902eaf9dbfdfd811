"""Propose jumps of a residual: single ones, staircases, slips and changes of load."""

import itertools
from dataclasses import replace
from typing import TypeGuard

import numpy as np
from scipy.fft import dct, fft, idct

from galen_hw.diagnosis.detection.proposal import FEW_ROWS, SHARED, Sought, moment, slow_spread
from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.effects.base import LOADS, Effect
from galen_hw.physics.effects.events import Step
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def steps(scene: Scene, residual: Array, rows: Rows, noise: Noise | None = None) -> list[Sought]:
    """Return the jump that explains most of the residual (M, C), channel by channel and over all channels.

    Where the noise is known to be coloured, the gains are those of generalised least squares.
    """
    N, C = residual.shape
    if N < FEW_ROWS:
        return []
    gain, names, places = _gains(residual, noise), scene.channels, places_of(N)
    found = [Sought(Step((names[c],), moment(scene, rows, int(np.argmax(gain[:, c])) + 1)), places) for c in range(C)]
    if C > 1:
        row = int(np.argmax(gain.sum(axis=1)))
        found.append(Sought(Step(tuple(names), moment(scene, rows, row + 1)), places))
        some = tuple(n for n, g in zip(names, gain[row], strict=True) if g > SHARED * gain[row].max())
        if 1 < len(some) < C:
            found.append(Sought(Step(some, moment(scene, rows, row + 1)), places))
    return found


def places_of(rows: int) -> int:
    """Return the number of independent places at which a jump can be found in so many rows."""
    return rows // 4


def staircases(scene: Scene, residual: Array, noise: Noise) -> list[Sought]:
    """Return up to six jumps of each channel, and of channels together, that jointly explain most of a residual (M, C).

    Each is placed where it explains most given those before it, and once more given all others. What returns to its former level
    is no staircase: somebody touched the arm.
    """
    N, C = residual.shape
    if N < FEW_ROWS:
        return []
    found = [([c], _stairs(residual[:, [c]], noise, [c])) for c in range(C)]
    if C > 1:
        rows = _stairs(residual, noise, list(range(C)))
        taken = (residual.var(axis=0) - _treads(residual, rows).var(axis=0)) / np.maximum(
            slow_spread(residual) ** 2, 1e-300
        )
        found.append((np.flatnonzero(taken > SHARED * taken.max()).tolist(), rows))
    out = []
    for own, rows in found:
        if len(rows) > 1 and not _returns(residual[:, own], rows):
            first, *later = (moment(scene, noise.rows, row) for row in sorted(rows))
            step = Step(tuple(scene.channels[c] for c in own), first, later=tuple(later))
            out.append(Sought(step, places_of(N) ** len(rows)))
    return out


def _stairs(
    residual: Array, noise: Noise, own: list[int], *, worth: float = 25.0, hardly: float = 0.2, most: int = 6
) -> list[int]:
    """Return first rows of up to `most` treads of a staircase in the residual (M, c) of channels `own`, by gain.

    Args:
        worth: gain, a channel, that a further jump must have given those that are there.
        hardly: share of the excess that two jumps must explain for others to be sought: what never rests is no staircase.
        most: stairs; more are a slope, or a random walk.
    """
    rows: list[int] = []
    whole = residual.var(axis=0)
    excess = whole - slow_spread(residual) ** 2
    while len(rows) < most:
        gain = _gains(_treads(residual, rows), noise, own).sum(axis=1)
        row = int(np.argmax(gain)) + 1
        if gain[row - 1] < worth * len(own) or row in rows:
            break
        rows.append(row)
        for k in range(len(rows)):
            others = rows[:k] + rows[k + 1 :]
            again = int(np.argmax(_gains(_treads(residual, others), noise, own).sum(axis=1))) + 1
            rows[k] = rows[k] if again in others else again
        if len(rows) > 1 and np.all(whole - _treads(residual, rows).var(axis=0) < hardly * excess):
            break
    return rows


def _treads(residual: Array, rows: list[int]) -> Array:
    """Return a residual (M, C) without its mean between jumps."""
    edges = [0, *sorted(rows), len(residual)]
    return np.concatenate([residual[a:b] - residual[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])


def _returns(residual: Array, rows: list[int], *, same: float = 0.01, sure: float = 4.0) -> bool:
    """Return whether a staircase in a residual (M, c) ever returns from a tread to the one before, by jumps and noise.

    Args:
        same: share of the larger jump's square by which two levels may differ and be one.
        sure: variances of the difference by which they may do so besides.
    """
    edges, spread = [0, *sorted(rows), len(residual)], np.maximum(slow_spread(residual), 1e-300)
    level = np.stack([residual[a:b].mean(axis=0) / spread for a, b in itertools.pairwise(edges)])
    error = residual.shape[1] / np.diff(edges)
    jump = np.sum(np.diff(level, axis=0) ** 2, axis=1)
    back = np.sum((level[2:] - level[:-2]) ** 2, axis=1)
    return bool(np.any(back < same * np.maximum(jump[1:], jump[:-1]) + sure * (error[2:] + error[:-2])))


def is_seen_by_itself(effect: Effect | None) -> TypeGuard[Step]:
    """Return whether it is a jump of readings: what has slipped on the arm shows as the arm turns."""
    return isinstance(effect, Step) and not effect.carried


def relocated(scene: Scene, residual: Array, step: Step, noise: Noise) -> Sought:
    """Return a jump at the moment where it explains most of a residual (M, C) that still contains it, in its own channels.

    Found given a poorer model its moment may be off, and a contact between the two moments would make up for that.
    """
    own = [scene.channels.index(name) for name in step.channels]
    row = int(np.argmax(_gains(residual[:, own], noise, own).sum(axis=1)))
    return Sought(replace(step, moment=moment(scene, noise.rows, row + 1)), places_of(len(residual)))


def _gains(residual: Array, noise: Noise | None, own: list[int] | None = None) -> Array:
    """Return the gain (M - 1, c) of a jump before each row but the first of a residual (M, c) of channels `own` (all).

    It is 0 near both ends.
    """
    white = noise is None or not len(noise.edges) or len(noise.rows.runs) > 1
    gain = _white_jumps(residual) if noise is None or white else _jumps(residual, noise, own)
    margin = max(len(residual) // 60, 3)
    gain[:margin], gain[-margin:] = 0.0, 0.0
    return gain


def _white_jumps(residual: Array) -> Array:
    """Return the gain (M - 1, C) of a jump before each row but the first, for white noise."""
    N = len(residual)
    z = (residual - residual.mean(axis=0)) / np.maximum(slow_spread(residual), 1e-300)
    k = np.arange(1, N)[:, None]
    return np.asarray(np.cumsum(z, axis=0)[:-1] ** 2 / (k * (N - k) / N))


def _jumps(residual: Array, noise: Noise, own: list[int] | None = None) -> Array:
    """Return the same by generalised least squares, for all moments at once: the noise is diagonal in the cosine transform.

    Line j of a jump before row k of N is -sqrt(2 / N) sin(pi j k / N) / (2 sin(pi j / (2 N))).
    """
    N = len(residual)
    lines = np.arange(1, N)[:, None]
    level = noise.spectrum(lines[:, 0] / (2.0 * N))[:, slice(None) if own is None else own]
    weighed = np.zeros_like(residual)
    weighed[1:] = dct(residual, axis=0, norm="ortho")[1:] / level
    inner = np.cumsum(idct(weighed, axis=0, norm="ortho"), axis=0)[:-1]
    power = np.zeros_like(residual)
    power[1:] = 1.0 / (2.0 * N * np.sin(np.pi * lines / (2.0 * N)) ** 2 * level)
    square = 0.5 * (power.sum(axis=0) - fft(power, axis=0).real[1:])
    return np.asarray(inner**2 / square)


def slips(scene: Scene, residual: Array, rows: Rows) -> list[Sought]:
    """Return the slip of each carried body at the moment at which it explains most of the residual (M, C).

    The baseline places what is carried by the whole recording: it fits the same columns over all rows, with the square S. After a
    moment a slip of the square A keeps A - A S^-1 A beside the baseline.
    """
    if len(residual) < FEW_ROWS:
        return []
    out = []
    for one in scene.slipping():
        own = list(one.channels)
        X, r = _normalised(rows.average(one.values), residual[:, own])
        A, b, moments = _products_after(X, r)
        whole = np.linalg.pinv(np.einsum("mck,mcl->kl", X, X), rcond=1e-9, hermitian=True)
        when = _best_moment(scene, A - A @ whole @ A, b, moments, rows)
        out.append(Sought(Step(tuple(scene.channels[c] for c in own), when, one.name), places_of(len(residual))))
    return out


def loads(scene: Scene, residual: Array, rows: Rows) -> list[Sought]:
    """Return the moment at which another load explains most of the residual (M, C): a part picked up, or one that slips.

    The free offsets of the channels take their part of it. A push on an arm that stands is as a load on its motors: it has to
    explain more than another offset of every motor does there.
    """
    port = scene.body_port() if scene.clock and scene.observations.predict in LOADS else None
    if port is None or len(residual) < FEW_ROWS:
        return []
    out = []
    for part, body in (("moment", slice(1, 4)), ("body", slice(0, 4))):
        X, r = _normalised(rows.average(port[:, :, body]), residual)
        A, b, moments = _products_after(X, r)
        sums = np.cumsum(X[::-1], axis=0)[::-1][moments]
        gains = _load_gains(A - np.einsum("mck,mcl->mkl", sums, sums) / len(residual), b)
        best = int(np.argmax(gains))
        if scene.observations.predict == "effort" and gains[best] <= np.max(np.sum(_white_jumps(r), axis=1)):
            continue
        when = moment(scene, rows, int(moments[best]))
        out.append(Sought(Payload(part, since=when), places_of(len(residual))))
    return out


def _normalised(X: Array, residual: Array) -> tuple[Array, Array]:
    """Return columns (M, c, k) and a residual (M, c) over its quick standard deviation, the columns of equal size."""
    sigma = np.maximum(slow_spread(residual), 1e-300)
    X = X / sigma[:, None]
    return X / np.maximum(np.sqrt(np.mean(X**2, axis=(0, 1))), 1e-300), (residual - residual.mean(axis=0)) / sigma


def _products_after(X: Array, residual: Array, *, count: int = 400) -> tuple[Array, Array, Array]:
    """Return squares (m, k, k) of columns (M, c, k) after moments, products (m, k) with a residual (M, c), first rows (m,).

    Args:
        count: moments that are tested.
    """
    margin = max(len(residual) // 60, 3)
    moments = np.unique(np.linspace(margin, len(residual) - margin - 1, count).astype(int))
    each = np.einsum("mck,mcl->mkl", X, X), np.einsum("mck,mc->mk", X, residual)
    A, b = (np.cumsum(one[::-1], axis=0)[::-1][moments] for one in each)
    return A, b, moments


def _best_moment(scene: Scene, free: Array, b: Array, moments: Array, rows: Rows) -> float:
    """Return the moment, s, with the largest gain, see `_load_gains`."""
    return moment(scene, rows, int(moments[int(np.argmax(_load_gains(free, b)))]))


def _load_gains(free: Array, b: Array) -> Array:
    """Return the gains b A^-1 b (m,) of squares A (m, k, k) and products b (m, k)."""
    return np.asarray(np.einsum("mk,mkl,ml->m", b, np.linalg.pinv(free, rcond=1e-6, hermitian=True), b))
