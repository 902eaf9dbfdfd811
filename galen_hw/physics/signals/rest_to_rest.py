"""Moves from one rest to the next, each with a spline of its own: a start from rest has a corner that one through all rounds."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, eigh

from galen_hw.physics.signals.splines import DEGREE, MOST_KNOTS
from galen_hw.spatial import Array

PENALTIES: Final = 10.0 ** np.arange(-10.0, 3.0)
"""Of the squared fourth derivative over the pieces."""
MOST_KEPT: Final = 2048
"""Splines that are kept ready: on an even clock the moves of a sweep are alike, and so are those of its joints."""


Ends = tuple[float, float]
"""Rows after the last one of the rest before at which a move begins, and before the first one of the next at which it ends."""


def moved(
    t: Array,
    x: Array,
    *,
    hidden: float = -4.0,
    sampled: int = 12,
    around: int = 9,
    fewest: int = 12,
    fits: float = 1.5,
    exact: float = 1e-15,
    uneven: float = 1e-3,
) -> Array | None:
    """Return a signal (N,) over times (N,) in s by moves and rests, with two derivatives (3, N); None: it is not made of these.

    A rest is a run of equal readings. At its ends speed and acceleration are zero, or the speed alone where an arm starts with
    a jolt. Penalised is the fourth derivative, of which moves of little jerk have little (Flash and Hogan 1985); how much and
    how finely, for all moves alike, and to half a row when each begins and ends, generalised cross-validation says (Craven and
    Wahba 1979). Splines that leave clearly more than the noise of the readings are not believed, unless that is next to nothing.

    Args:
        hidden: rows; where half of the moves begin no later, their readings are too coarse to say how they do.
        sampled: moves that say how smooth all are.
        around: rows of the rests on either side that count as a move's: as far as it may reach.
        fewest: rows of a move; fewer are a step of the encoder or a flicker, and the signal is none of moves and
            rests.
        fits: times the variance of the readings' own noise that the moves' splines may leave.
        exact: share of a signal's variance that they may leave, whatever its noise: readings that hold none.
        uneven: share of a step by which the clock of a recording is even but for rounding.
    """
    rests = _rests(t, x) if np.isfinite(x).all() else []
    between = list(_between(rests, len(x))) if rests else []
    if not between or any(b - a < fewest for a, b, *_ in between):
        return None
    step = float(np.median(np.diff(t)))
    places = [slice(a - around if after else a, b + around if before else b) for a, b, after, before in between]
    even = bool(np.ptp(np.diff(t)) < uneven * step)
    moves = [
        _Move(_clock(t[part], step, even=even), x[part], around * after, around * before, even)
        for part, (_, _, after, before) in zip(places, between, strict=True)
    ]
    found = _best_way(moves[:: max(len(moves) // sampled, 1)])
    if found is None:
        return None
    way, usual = found
    ends = [one.best_ends(way, usual) for one in moves]
    sought = np.concatenate([one.sought(at) for one, at in zip(moves, ends, strict=True)])
    if np.median(sought) <= hidden:
        return None
    out = np.zeros((3, len(x)))
    for a, b in rests:
        out[0, a:b] = x[a]
    left = free = 0.0
    for part, one, at in zip(places, moves, ends, strict=True):
        follows = one.followed(way, at)
        if follows is None:
            return None
        out[:, part], used = follows
        left += float(np.sum((out[0, part] - one.x) ** 2))
        free += len(one.x) - used
    if left > max(fits * _noise(t, x, places) ** 2 * free, exact * len(x) * float(np.var(x))):
        return None
    return np.asarray(out / np.array([[1.0], [step], [step**2]]))


def _clock(t: Array, step: float, *, even: bool) -> Array:
    """Return the times (n,) in rows."""
    return np.arange(float(len(t))) if even else (t - t[0]) / step


class _Way(NamedTuple):
    """How splines go through moves: pieces, equal coefficients at a rest, which of the penalties."""

    pieces: int
    fixed: int
    penalty: int = 0


@dataclass(frozen=True, eq=False)
class _Move:
    """One move, with rows of the rests on either side.

    Args:
        clock: (n,) times of its rows, in rows.
        x: (n,) as read.
        before, after: rows of the rest before and after among them; zero: it is cut off there.
        even: its clock is.
    """

    clock: Array
    x: Array
    before: int
    after: int
    even: bool

    def scores(self, way: _Way, ends: Ends) -> Array:
        """Return the cross-validation (P,) of each penalty; infinite where no spline goes."""
        found = self._splines(way, ends)
        if found is None:
            return np.full(len(PENALTIES), np.inf)
        made, rows = found
        x = self.x
        resting = np.sum((x[: rows.start] - x[0]) ** 2) + np.sum((x[rows.stop :] - x[-1]) ** 2)
        return np.asarray((made.left(x[rows], x[0], x[-1]) + resting) / (1.0 - made.used / len(x)) ** 2)

    def best_ends(
        self,
        way: _Way,
        at: Ends,
        *,
        shifts: tuple[float, ...] = (-8.0, -6.0, -5.0, -4.0, -3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5),
    ) -> Ends:
        """Return where it begins and ends best, one after the other: downhill from where it stands.

        Args:
            shifts: rows after the last one at rest at which a move may begin: its first ones may hide in a
                reading's last digit.
        """
        for side in (k for k, rows in enumerate((self.before, self.after)) if rows):

            def placed(k: int, at: Ends = at, side: int = side) -> Ends:
                return (shifts[k], at[1]) if side == 0 else (at[0], shifts[k])

            def score(k: int, placed: Callable[[int], Ends] = placed) -> float:
                return float(self.scores(way, placed(k))[way.penalty]) if 0 <= k < len(shifts) else np.inf

            k = shifts.index(at[side])
            here = score(k)
            for step in (-1, 1):
                while (there := score(k + step)) < here:
                    k, here = k + step, there
            at = placed(k)
        return at

    def sought(self, ends: Ends) -> list[float]:
        """Return those of its ends that were sought."""
        return [shift for shift, rows in zip(ends, (self.before, self.after), strict=True) if rows]

    def followed(self, way: _Way, ends: Ends) -> tuple[Array, float] | None:
        """Return value and two derivatives by row (3, n), and how many of its rows that uses up."""
        found = self._splines(way, ends)
        if found is None:
            return None
        made, rows = found
        out = np.zeros((3, len(self.x)))
        out[0, : rows.start], out[0, rows.stop :] = self.x[0], self.x[-1]
        out[:, rows] = made.derivatives(made.through(self.x[rows], self.x[0], self.x[-1], way.penalty))
        return out, float(made.used[way.penalty])

    def _splines(self, way: _Way, ends: Ends, *, nothing: float = 1e-6) -> tuple["_Splines", slice] | None:
        """Return splines that may go through it, and the rows between its ends.

        Args:
            nothing: rows that are none.
        """
        u = self.clock
        first = float(u[self.before - 1] + ends[0] if self.before else u[0])
        last = float(u[-self.after] - ends[1] if self.after else u[-1])
        rows = slice(*np.searchsorted(u, [first - nothing, last + nothing]))
        heads, tails = (way.fixed if rest else 0 for rest in (self.before, self.after))
        length, many = round(last - first, 6), rows.stop - rows.start
        if self.even:
            made = _evenly(many, round(float(u[rows.start]) - first, 6), length, way.pieces, heads, tails)
        else:
            made = _made(np.clip(u[rows] - first, 0.0, length), length, way.pieces, heads, tails)
        return None if made is None else (made, rows)


def _best_way(
    moves: Sequence[_Move],
    *,
    numbers: tuple[int, ...] = (6, 12, 24),
    starts: tuple[int, ...] = (3, 2),
    clearly: float = 0.5,
    first: tuple[float, ...] = (-1.0, 0.0),
) -> tuple[_Way, Ends] | None:
    """Return the cross-validation of some moves together, and where to begin; starts with a jolt only where it is clear.

    Args:
        numbers: pieces of a move's spline that are tried.
        starts: equal coefficients at a rest: three start a spline with neither speed nor acceleration, two
            without speed alone.
        clearly: share of the score of starts without a jolt at which starts with one are believed.
        first: rows after the last one at rest where the search for the ends begins: at what suits all moves best.
    """

    def told(way: _Way, ends: Sequence[Ends]) -> tuple[float, int]:
        every = np.sum([one.scores(way, at) for one, at in zip(moves, ends, strict=True)], axis=0)
        return float(np.min(every)), int(np.argmin(every))

    best: list[tuple[float, _Way, Ends]] = []
    for fixed in starts:
        tried: list[tuple[float, _Way, Ends]] = []
        for pieces in numbers:
            way = _Way(pieces, fixed)
            (_, penalty), usual = min((told(way, [(at, at)] * len(moves)), (at, at)) for at in first)
            way = way._replace(penalty=penalty)
            ends = [one.best_ends(way, usual) for one in moves]
            score, penalty = told(way, ends)
            tried.append((score, way._replace(penalty=penalty), usual))
        best.append(min(tried))
    smooth, jolt = best
    if not np.isfinite(min(smooth[0], jolt[0])):
        return None
    return jolt[1:] if jolt[0] < clearly * smooth[0] else smooth[1:]


def _noise(t: Array, x: Array, parts: Sequence[slice]) -> float:
    """Return the standard deviation of the noise of a signal (N,) at times (N,), in its unit, by fourth divided differences.

    Of the smaller ones the mean, and not their median: readings have steps, and half of them may be one.
    """
    every = []
    step = float(np.median(np.diff(t)))
    for part in parts:
        near, read = (np.lib.stride_tricks.sliding_window_view(one[part], 5) for one in (t / step, x))
        shares = 1.0 / np.prod(near[:, :, None] - near[:, None, :] + np.eye(5), axis=2)
        every.append(np.sum(shares * read, axis=1) / np.sqrt(np.sum(shares**2, axis=1)))
    size = np.sort(np.abs(np.concatenate(every)))
    # The smaller four fifths of what is normal have a mean size of 0.5586 standard deviations.
    return float(np.mean(size[: int(0.8 * len(size))])) / 0.5586


def _rests(t: Array, x: Array, *, fewest: int = 16, shortest: float = 0.2) -> list[tuple[int, int]]:
    """Return runs of equal values in a signal (N,) at times (N,), first row and the one after the last.

    Args:
        fewest: equal readings that are a rest; fewer may be a slow move in steps of the encoder.
        shortest: s, of such a rest.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (np.diff(x) == 0.0).astype(int), [0]]))).reshape(-1, 2)
    return [(int(a), int(b) + 1) for a, b in edges if b + 1 - a >= fewest and t[b] - t[a] >= shortest]


def _between(rests: Sequence[tuple[int, int]], n: int) -> Iterator[tuple[int, int, bool, bool]]:
    """Yield the rows between rests, first one and the one after the last, and whether a rest lies before and after."""
    before = [0, *(b for _, b in rests)]
    after = [*(a for a, _ in rests), n]
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        if b > a:
            yield a, b, k > 0, k < len(rests)


class _Splines(NamedTuple):
    """Splines over the rows of a move that begin and end at known times, with the first and last coefficients as at its rests.

    Attributes:
        knots: in rows; places: (n,) of the rows among them.
        along: (n, K) values at the rows along the K directions in which both rows and penalty are diagonal.
        shrinks: (P, K) what each penalty leaves of these; used: (P,) rows that it uses up.
        onto: (C, K) free coefficients of the directions.
        heads, tails: how many coefficients are as at the rests.
        tail: (n,) values of those at the end, together; pulled: (P, K) what the penalties make of these in the directions.
    """

    knots: Array
    places: Array
    along: Array
    shrinks: Array
    used: Array
    onto: Array
    heads: int
    tails: int
    tail: Array
    pulled: Array

    def left(self, x: Array, before: float, after: float) -> Array:
        """Return the sum of squares (P,) that each penalty leaves of a signal (n,) between two rests."""
        y, _, far = self._freed(x, before, after)
        told = self.along.T @ y
        # Its directions are orthonormal over the rows: what no spline reaches, and what the penalty keeps from it.
        kept = (1.0 - self.shrinks) * told + far * self.shrinks * self.pulled
        return np.asarray(np.sum((y - self.along @ told) ** 2) + np.sum(kept**2, axis=1))

    def through(self, x: Array, before: float, after: float, penalty: int) -> Array:
        """Return the coefficients (K,) of the spline with one of the penalties."""
        y, start, far = self._freed(x, before, after)
        found = self.shrinks[penalty] * (self.along.T @ y - far * self.pulled[penalty])
        return np.concatenate([np.full(self.heads, before), start + self.onto @ found, np.full(self.tails, after)])

    def _freed(self, x: Array, before: float, after: float) -> tuple[Array, float, float]:
        """Return the signal (n,) without where it begins, which is no part of how smooth it is, and what the rest makes of it."""
        start = before if self.heads else 0.0
        far = after - start if self.tails else 0.0
        return x - start - far * self.tail, start, far

    def derivatives(self, factors: Array) -> Array:
        """Return value and two derivatives by row (3, n) at the rows."""
        spline = BSpline(self.knots, factors, DEGREE)
        return np.stack([spline(self.places), spline(self.places, 1), spline(self.places, 2)])


@lru_cache(maxsize=MOST_KEPT)
def _evenly(many: int, first: float, length: float, pieces: int, heads: int, tails: int) -> _Splines | None:
    """Return splines over so many rows, the first one at its place."""
    return _made(np.clip(first + np.arange(float(many)), 0.0, length), length, pieces, heads, tails)


def _made(rows: Array, length: float, pieces: int, heads: int, tails: int) -> _Splines | None:
    """Return splines over rows (n,) at places along a length in rows; None: too few rows."""
    if pieces + DEGREE - heads - tails > MOST_KNOTS * len(rows):
        return None
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, length, pieces + 1), np.full(DEGREE, length)])
    basis = BSpline.design_matrix(rows, knots, DEGREE).toarray()
    count = basis.shape[1]
    free, end = slice(heads, count - tails), slice(count - tails, count)
    along, snap = basis[:, free], _snap(pieces)
    try:
        charged, onto = eigh(snap[:, free].T @ snap[:, free], along.T @ along)
    except LinAlgError:  # knots without rows between them
        return None
    shrinks = 1.0 / (1.0 + PENALTIES[:, None] * np.maximum(charged, 0.0))
    pulled = PENALTIES[:, None] * (onto.T @ (snap[:, free].T @ snap[:, end].sum(axis=1)))
    tail = basis[:, end].sum(axis=1)
    return _Splines(knots, rows, along @ onto, shrinks, shrinks.sum(axis=1), onto, heads, tails, tail, pulled)


@lru_cache
def _snap(pieces: int) -> Array:
    """Return fourth derivatives (G, C) over pieces, of all coefficients, at Gauss' two points of each: exact when squared."""
    knots = np.concatenate([np.zeros(DEGREE), np.arange(pieces + 1.0), np.full(DEGREE, float(pieces))])
    points = (np.arange(pieces)[:, None] + 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)).ravel()
    return np.asarray(BSpline(knots, np.eye(pieces + DEGREE), DEGREE)(points, 4))
