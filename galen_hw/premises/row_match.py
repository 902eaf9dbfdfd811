"""Rows that do not belong together: a column or a stream turned back to front, sorted by itself, or moved by some rows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import POSITION
from galen_hw.premises.base import Action, Remark, Stage, known_rows, with_matrix
from galen_hw.premises.cells import Mask
from galen_hw.premises.clock import PERIODS_S
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names
from galen_hw.premises.streams import ROWS, late_shares
from galen_hw.premises.thinning import Rates, thinned
from galen_hw.premises.wrench_reading import FORCE, ORIENTATION, TORQUE, readings
from galen_hw.spatial import Array

Rows = NDArray[np.intp]
FEWEST: Final = 24
"""Rows; of fewer one order in a hundred others may fit by chance, where several channels are one motion's."""
FARTHEST: Final = 3
"""Rows by which one file runs ahead of another: a heading, or lines that were lost."""


@dataclass(frozen=True)
class _Order:
    """Hold another order of rows: `rows` (M,) of what is compared belong to `own` (M,) of what drives the simulation."""

    says: str
    todo: str
    rows: Rows
    own: Rows


@dataclass(frozen=True)
class _Pair:
    """Hold what is compared and its simulation, row by row.

    Args:
        seen: the whole recording.
        channels: of y; of a pose those of its place: an orientation is compared relative to its simulation.
        y, x: (N, C) measured and simulated.
        plain: (C,) shares that the simulation leaves, of a motion with the best delay.
        told: (C,) which channels move in both; group: those that are asked together: small moments say little.
        moving: whether rows are samples of a motion.
    """

    seen: Observations
    channels: Sequence[str]
    y: Array
    x: Array
    plain: Array
    told: Mask
    group: Mask
    moving: bool


class RowMatch:
    """Tests whether what is compared has the simulated values in other rows.

    Of each order the share is asked that a simulation leaves unexplained, its size and a constant aside. Nothing physical turns
    a motion back to front, sorts it, or answers with the load of the pose before.
    """

    KEY: ClassVar[str] = "row_match"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one refusal: of all channels, else of those whose rows alone are in another order."""
        pair = _compared(seen)
        if pair is None:
            return
        for ask in (self._all, self._averaged, self._in_memory):
            found = next(ask(pair), None)
            if found is not None:
                yield found
                return
        yield from self._single(pair)

    def _all(self, pair: _Pair) -> Iterator[Remark]:
        """Yield a refusal where all rows are in another order."""
        y, x, plain = pair.y[:, pair.group], pair.x[:, pair.group], pair.plain[pair.group]
        # To and fro in one joint, late, is much like backwards.
        if len(plain) > pair.moving and np.mean(plain) > CRITERIA.gross_left:
            order, left = _best(_orders(len(y), moving=pair.moving), y, x)
            if _fits(left, float(np.mean(plain))):
                yield self._remark(tuple(compared_names(pair.seen)), order, "what is compared")

    def _averaged(self, pair: _Pair) -> Iterator[Remark]:
        """Yield a refusal of poses that hold a share of the pose before."""
        share = _of_the_last(pair.y[:, pair.group], pair.x[:, pair.group]) if pair.seen.time is None else 0.0
        if share > 0.0:
            what = f"each row holds {share:.0%} of the pose before: averaged from before the arm had come to rest"
            todo = "average each pose from when the arm rests"
            yield Remark(self.KEY, what, todo, tuple(compared_names(pair.seen)), Action.REFUSED)

    def _in_memory(self, pair: _Pair) -> Iterator[Remark]:
        """Yield a refusal of vectors that were written row by row and read back column by column, or the other way round."""
        for names in (FORCE, TORQUE, POSITION, tuple(pair.channels)):
            at = [pair.channels.index(name) for name in names if name in pair.channels]
            if len(at) < max(len(names), 2) or np.min(pair.plain[at]) < CRITERIA.half:
                continue
            Y = pair.seen.matrix(*names)
            if not np.isfinite(Y).all():
                continue
            for new in (Y.T.reshape(Y.shape), Y.reshape(Y.T.shape).T):
                some = _rows(with_matrix(pair.seen, names, new))
                if some is None:
                    continue
                scene = scene_of(some[0], rates=some[1])
                left = _unexplained(scene.measured[:, at], scene.simulated[:, at])
                if _fits(float(np.mean(left)), float(np.mean(pair.plain[at]))):
                    says = "were written in one order of memory and read in the other"
                    order = _Order(
                        says, "read them as they were written: rows first, or columns", *(np.arange(len(Y)),) * 2
                    )
                    yield self._remark(names, order, ", ".join(names))

    def _single(self, pair: _Pair) -> Iterator[Remark]:
        """Yield a refusal for each channel whose rows alone are in another order."""
        for c in np.flatnonzero(pair.told & (pair.plain > CRITERIA.half)).tolist():
            y, x = pair.y[:, [c]], pair.x[:, [c]]
            orders = [*(() if pair.moving else _orders(len(y), moving=False)), *_sorted(y[:, 0], x[:, 0])]
            if orders:
                order, left = _best(orders, y, x)
                if _fits(left, float(pair.plain[c])):
                    yield self._remark((pair.channels[c],), order, pair.channels[c])

    def _remark(self, columns: tuple[str, ...], order: _Order, name: str) -> Remark:
        what = f"{name} {order.says}: so read the simulation explains it, and as recorded it does not"
        return Remark(self.KEY, what, order.todo, columns, Action.REFUSED)


def _compared(seen: Observations) -> _Pair | None:
    """Return what is compared and its simulation; None where there is too little of either."""
    some = _rows(seen)
    if some is None or len(some[0]) < FEWEST:
        return None
    scene = scene_of(some[0], rates=some[1])
    count = min(3, len(scene.channels)) if seen.predict == "pose" else len(scene.channels)
    y, x = scene.measured[:, :count], scene.simulated[:, :count]
    if seen.predict == "wrench" and not np.any(np.ptp(x, axis=0) > 0.0):
        # No tool is named: whatever hangs there pulls as gravity does.
        x = np.concatenate([next(iter(readings(some[0]))).expected, np.zeros((len(y), 3))], axis=1)[:, :count]
    told = (np.ptp(x, axis=0) > 0.0) & (np.ptp(y, axis=0) > 0.0)
    if not (np.isfinite(x).all() and np.isfinite(y).all() and told.any()):
        return None
    moving = some[0].time is not None and float(np.median(np.diff(some[0].time))) < PERIODS_S[1]
    plain, late = _unexplained(y, x), late_shares(some) if moving else None
    if late is not None and len(late) == count:
        plain = np.minimum(plain, late)
    group = told & (np.arange(count) < 3) if seen.predict == "wrench" else told
    return _Pair(seen, scene.channels[:count], y, x, plain, told, group, moving)


def _rows(seen: Observations) -> tuple[Observations, Rates] | None:
    return thinned(seen, ROWS) or _oriented(seen)


def _best(orders: Iterable[_Order], y: Array, x: Array) -> tuple[_Order, float]:
    """Return the order that leaves the least of signals (N, C) unexplained by others (N, C), and the mean share."""
    left = [(o, float(np.mean(_unexplained(y[o.rows], x[o.own])))) for o in orders]
    return min(left, key=lambda one: one[1])


def _oriented(seen: Observations) -> tuple[Observations, Rates] | None:
    """Return poses of a sensor whose orientation is all that is known of the machine."""
    names = (*compared_names(seen), *ORIENTATION)
    if seen.predict != "wrench" or seen.time is not None or not seen.has_all(*names):
        return None
    return seen.taken(known_rows(seen, names, ROWS)), None


def _orders(count: int, *, moving: bool) -> Iterator[_Order]:
    """Yield orders of all rows: of a motion that is back to front alone, since one that is moved by some rows is late."""
    every = np.arange(count)
    todo = "give each row what was measured in it: the newest came first, say"
    yield _Order("runs from the last row to the first", todo, every[::-1], every)
    if moving:
        return
    todo = "give each row what was measured in it: a line was lost, or came twice, in one of two files, say"
    for by in (k for k in range(-FARTHEST, FARTHEST + 1) if k):
        rows = every[max(by, 0) : count + min(by, 0)]
        side = f"{abs(by)} row{'s' if abs(by) > 1 else ''} {'late' if by > 0 else 'early'}"
        for first in range(0, count - FEWEST // 2, max(count // 200, 1)):
            kept, moved = every[:first], rows[rows - by >= first]
            own = np.concatenate([kept, moved - by])
            where = f" from row {first} on" if first else ""
            yield _Order(f"comes {side}{where}", todo, np.concatenate([kept, moved]), own)


def _sorted(y: Array, x: Array) -> Iterator[_Order]:
    """Yield the order in which a column (N,) was sorted by itself, if it is."""
    steps = np.diff(y)
    if np.all(steps >= 0.0) or np.all(steps <= 0.0):
        up = y[-1] > y[0]
        says = f"was sorted by itself, the {'smallest' if up else 'largest'} first"
        own = np.argsort(x, kind="stable")
        yield _Order(says, "sort all columns together, or none", np.arange(len(y)), own if up else own[::-1])


def _of_the_last(y: Array, x: Array) -> float:
    """Return the share of the pose before that signals (N, C) hold, where poses (N, C) in any order show it; else 0.

    One share of all channels, beside a constant of each, by least squares: it must leave a quarter at most of what no share does.
    What creeps holds a few per cent.
    """
    if not y.shape[1]:
        return 0.0
    own, step = (v - v.mean(axis=0) for v in ((y - x)[1:], (x[:-1] - x[1:])))
    size = np.maximum(np.sum(step**2, axis=0), 1e-300)
    share = float(np.sum(np.sum(own * step, axis=0) / size) / len(size))
    left = np.sum((own - share * step) ** 2, axis=0) / np.maximum(np.sum(own**2, axis=0), 1e-300)
    sure = CRITERIA.gross_left < share < 1.0 and float(np.mean(left)) < CRITERIA.gross_gain
    return share if sure else 0.0


def _fits(left: float, plain: float) -> bool:
    return left < CRITERIA.gross_left and left < CRITERIA.gross_gain * plain


def _unexplained(y: Array, x: Array) -> Array:
    """Return the shares (C,) of signals (N, C) that others (N, C) leave, a constant and their size aside."""
    own, its = y - np.mean(y, axis=0), x - np.mean(x, axis=0)
    size = np.sum(own**2, axis=0) * np.sum(its**2, axis=0)
    both = np.sum(own * its, axis=0)
    # A size may be wrong, its sign not.
    return np.asarray(1.0 - np.maximum(both, 0.0) ** 2 / np.maximum(size, 1e-300))
