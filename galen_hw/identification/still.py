"""Find the poses in a continuous recording: the spans in which nothing moves, averaged."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.spatial import Array

SLOW: Final = 0.005
"""rad/s or m/s below which a joint rests (beneath the noise of a differentiated encoder)."""
LEAST_S, TRIM_S = 0.15, 0.10
"""Shortest span that counts, and what is cut off its beginning while the tool still swings."""
SAME_POSE: Final = 0.003
"""rad or m: two spans closer than this are one pose that was interrupted."""


@dataclass(frozen=True, slots=True)
class Span:
    """Rows `first` to `last` (without it) in which nothing moves."""

    first: int
    last: int


def still_spans(time: Array, motion: Array) -> list[Span]:
    """Spans at rest.

    Args:
        time: (n,) s; motion: (n, k) joint positions, or quaternions, whose change is the motion.
    """
    moving = _speed(time, motion) > SLOW
    spans = []
    for first, last in _runs(~moving):
        start = int(np.searchsorted(time, time[first] + TRIM_S))
        if last - start >= 3 and time[last - 1] - time[start] >= LEAST_S:
            spans.append(Span(start, last))
    return _merged(spans, motion)


def average(spans: list[Span], values: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Mean (m, k), variance of a single sample (m, k) and number of samples (m,) of each span, NaN left out."""
    means = [np.nanmean(values[s.first : s.last], axis=0) for s in spans]
    variances = [np.nanvar(values[s.first : s.last], axis=0, ddof=1) for s in spans]
    counts = [int(np.isfinite(values[s.first : s.last]).all(axis=1).sum()) for s in spans]
    return np.array(means), np.array(variances), np.array(counts, dtype=np.int64)


def _speed(time: Array, motion: Array) -> Array:
    """Largest rate (n,) of any column over a window of about 0.1 s, so that quantisation is no motion."""
    step = max(float(np.median(np.diff(time))), 1e-6)
    half = max(round(0.05 / step), 1)
    before, after = np.arange(len(time)) - half, np.arange(len(time)) + half
    before, after = before.clip(0), after.clip(None, len(time) - 1)
    change = np.abs(motion[after] - motion[before])
    rate: Array = np.nanmax(change, axis=1) / np.maximum(time[after] - time[before], step)
    return rate


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _merged(spans: list[Span], motion: Array) -> list[Span]:
    merged: list[Span] = []
    for span in spans:
        here = np.nanmedian(motion[span.first : span.last], axis=0)
        if merged:
            there = np.nanmedian(motion[merged[-1].first : merged[-1].last], axis=0)
            if span.first - merged[-1].last < 3 and float(np.nanmax(np.abs(here - there))) < SAME_POSE:
                merged[-1] = Span(merged[-1].first, span.last)
                continue
        merged.append(span)
    return merged
