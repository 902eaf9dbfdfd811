"""Rows of a recording: averaging over neighbours, contiguous blocks, folds, and held-out rows."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.lazy import cached_property
from galen_hw.physics.signals.differentiation import CUT, low_passed
from galen_hw.spatial import Array

Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Chosen = Mask | Index
"""Rows as a mask or by number."""


@dataclass(frozen=True)
class Rows:
    """Groups of `stride` neighbouring rows of one segment, averaged into one.

    Args:
        segments: runs of continuous rows.
        stride: rows in a group; 1 keeps all.
        cut: cycles a row above which signals are filtered off before, forth and back; 0 filters nothing.
    """

    segments: tuple[slice, ...]
    stride: int = 1
    cut: float = 0.0

    def of(self, segments: Sequence[slice]) -> "Rows":
        """Return the same groups of another recording."""
        return replace(self, segments=tuple(segments))

    @cached_property
    def starts(self) -> Index:
        """First row of every group."""
        return np.concatenate([np.arange(s.start, s.stop, self.stride) for s in self.segments]).astype(np.intp)

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """Slices of the groups of each segment."""
        edges = np.cumsum([0] + [-(-(s.stop - s.start) // self.stride) for s in self.segments])
        return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self.starts)

    def average(self, x: Array) -> Array:
        """Return means (M, ...) of (N, ...) over the groups."""
        x = self.filtered(x)
        if self.stride == 1:
            return x
        out = np.empty((len(self), *x.shape[1:]))
        for segment, run in zip(self.segments, self.runs, strict=True):
            whole, rest = divmod(segment.stop - segment.start, self.stride)
            middle, end = segment.start + whole * self.stride, run.start + whole
            if whole:
                groups = x[segment.start : middle].reshape(whole, self.stride, -1)
                out[run.start : end] = (np.einsum("gsk->gk", groups) / self.stride).reshape(whole, *x.shape[1:])
            if rest:
                out[end] = x[middle : segment.stop].mean(axis=0)
        return out

    def late(self, x: Array, steps: Sequence[float], *, bowed: bool = False) -> Array:
        """Return means of signals delayed by so many rows in each segment; the end rows are held.

        As `operators.delay` on an even clock, averaged, without interpolating each row between its neighbours.
        """
        flat = self.filtered(x).reshape(len(x), -1)
        parts = [
            _late(flat[part], late, self.stride, bowed=bowed) for part, late in zip(self.segments, steps, strict=True)
        ]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).reshape(len(self), *x.shape[1:])

    def filtered(self, x: Array) -> Array:
        """Return signals (N, ...) low-passed at `cut`; a gap (NaN) is interpolated first, and stays one."""
        if not self.cut:
            return x
        out = np.array(x, dtype=float)
        for part in self.segments:
            flat = out[part].reshape(part.stop - part.start, -1)
            gaps, at = ~np.isfinite(flat), np.arange(len(flat))
            for j in np.flatnonzero(gaps.any(axis=0) & ~gaps.all(axis=0)):
                good = ~gaps[:, j]
                flat[:, j] = np.interp(at, at[good], flat[good, j])
            passed = low_passed(np.nan_to_num(flat), 1.0, self.cut / CUT)
            out[part] = np.where(gaps, np.nan, passed).reshape(out[part].shape)
        return out

    def differences(self, x: Array) -> Array:
        """Return central differences (M, k) of averaged columns, by the row and within each run; 0 in a run of one row."""
        parts = (x[run] for run in self.runs)
        return np.concatenate([np.gradient(part, axis=0) if len(part) > 1 else np.zeros_like(part) for part in parts])

    def spread(self, x: Mask) -> Mask:
        """Return the mask (M,) of the groups that hold any marked row (N,)."""
        return np.asarray(np.logical_or.reduceat(x, self.starts))


def _late(x: Array, steps: float, stride: int, *, bowed: bool) -> Array:
    """Return means (G, k) over groups of `stride` rows of x (n, k), delayed by so many rows."""
    count, groups = len(x), -(-len(x) // stride)
    whole = int(np.floor(min(max(steps, -float(count)), float(count))))
    share = steps - whole
    bow = 0.5 * share * (1.0 - share) if bowed else 0.0
    # Groups of which every row lies between two recorded ones, and has two before it.
    begin = min(max(-(-(whole + 2) // stride), 0), groups)
    end = max(min(count, count + whole) // stride, begin)
    out = np.empty((groups, x.shape[1]))
    if begin < end:
        a, b = begin * stride - whole, end * stride - whole
        edges = ((share + bow) * x[a - 1 : b : stride] - bow * x[a - 2 : b - 1 : stride]) / stride
        middle = np.einsum("gsk->gk", x[a:b].reshape(end - begin, stride, -1), out=out[begin:end])
        middle /= stride
        middle += edges[:-1]
        middle -= edges[1:]
    for first, last in ((0, begin), (end, groups)):
        if first < last:
            rows = np.arange(first * stride, min(last * stride, count)) - whole
            here, before = x[np.clip(rows, 0, count - 1)], x[np.clip(rows - 1, 0, count - 1)]
            starts = np.arange(0, len(rows), stride)
            sizes = np.diff(starts, append=len(rows))
            late = here + share * (before - here)
            if bow and (inside := (rows >= 2) & (rows < count)).any():
                late[inside] -= bow * (here - 2.0 * before + x[np.clip(rows - 2, 0, count - 1)])[inside]
            out[first:last] = np.add.reduceat(late, starts, axis=0) / sizes[:, None]
    return out


def true_runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first row of each run of marked rows in a mask (N,), and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def blocks(runs: tuple[slice, ...], count: int) -> Index:
    """Return the block number (M,) of every row: about `count` contiguous blocks that do not cross segments."""
    total = sum(r.stop - r.start for r in runs)
    out, number = np.empty(total, dtype=np.intp), 0
    for run in runs:
        size = run.stop - run.start
        pieces = min(max(1, round(count * size / total)), size)
        out[run] = number + np.minimum(np.arange(size) * pieces // size, pieces - 1)
        number += pieces
    return out


FOLDS: Final = 5


def folds(block: Index, count: int = FOLDS) -> Index:
    """Deal blocks out in turn, and return the fold (M,) of every row, none of them empty.

    There are as many folds as blocks where these are fewer than `count`, and each row is a block where there is but one: whatever
    is learnt without a fold has rows to be learnt from, and every fold has rows to be judged on.

    Args:
        block: (M,) block number of every row.
    """
    number = np.unique(block, return_inverse=True)[1] if len(block) else block
    if len(block) and number.max() == 0:
        number = np.arange(len(block))
    return np.asarray(number % max(min(count, int(number.max(initial=0)) + 1), 1), dtype=np.intp)


def set_aside(block: Index, share: float, seed: int) -> Mask:
    """Return the mask (M,) of held-out rows: whole blocks, spread over the recording."""
    numbers = np.unique(block)
    count = round(share * len(numbers))
    if len(numbers) < 4 or count < 1:
        return np.zeros(len(block), dtype=bool)
    rng = np.random.default_rng(seed)
    edges = np.linspace(0, len(numbers), count + 1)
    chosen = [numbers[int(rng.integers(int(a), max(int(b), int(a) + 1)))] for a, b in itertools.pairwise(edges)]
    return np.isin(block, chosen)
