"""Inner products of the columns of many hypotheses, computed when they are first asked for."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from galen_hw.diagnosis.stats.sampling import Index, Mask
from galen_hw.spatial import Array


class Group(NamedTuple):
    """Columns that belong together.

    Args:
        size: how many; columns: by channel, numbers within the group and (n, k) values of those that are not zero throughout.
    """

    size: int
    columns: dict[int, tuple[Index, Array]]


class _ColumnStack(NamedTuple):
    """Columns stacked next to each other.

    Args:
        at: their numbers; room: (n, m) array whose first columns they are; later ones may be overwritten.
    """

    at: Index
    room: Array

    @classmethod
    def of(cls, at: Index, X: Array, *, least: int = 32) -> "_ColumnStack":
        """Return a stack of columns X, with spare room where they are few.

        Args:
            least: columns for which there is room where few come: inner products with many narrow arrays cost
                more than with a wide one.
        """
        if len(at) >= least:
            return cls(at, X)
        return cls(at[:0], np.empty((len(X), least), order="F")).joined(at, X)

    @property
    def columns(self) -> Array:
        """Columns (n, len(at))."""
        return self.room[:, : len(self.at)]

    def takes(self, count: int) -> bool:
        """Return whether there is room for so many more."""
        return bool(len(self.at) + count <= self.room.shape[1])

    def joined(self, at: Index, X: Array) -> "_ColumnStack":
        """Return the stack with more columns X (n, k)."""
        self.room[:, len(self.at) : len(self.at) + len(at)] = X
        return _ColumnStack(np.concatenate([self.at, at]), self.room)

    def renumbered(self, numbers: Index) -> "_ColumnStack":
        """Return those columns that keep a number: new ones by the old, ascending; -1: none."""
        at = numbers[self.at]
        kept = at >= 0
        return _ColumnStack(at, self.room) if kept.all() else _ColumnStack.of(at[kept], self.columns[:, kept])


class _Stacks:
    """Columns of each channel, side by side in the order of their numbers or as they came."""

    def __init__(self, width: int, channels: list[list[_ColumnStack]] | None = None) -> None:
        self.channels: list[list[_ColumnStack]] = channels or [[] for _ in range(width)]

    def copy(self) -> "_Stacks":
        """Return another that may grow by itself."""
        return _Stacks(0, [list(stack) for stack in self.channels])

    def push(self, channel: int, at: Index, X: Array) -> None:
        """Take more columns (n, k) of a channel, with their numbers."""
        stack = self.channels[channel]
        if stack and stack[-1].takes(len(at)):
            stack[-1] = stack[-1].joined(at, X)
        else:
            stack.append(_ColumnStack.of(at, X))

    def renumbered(self, numbers: Index) -> "_Stacks":
        """Return those columns that keep a number.

        Args:
            numbers: new ones by the old, ascending; -1: none.
        """
        return _Stacks(
            0, [[new for part in stack if len((new := part.renumbered(numbers)).at)] for stack in self.channels]
        )

    def parts(self, channel: int, first: int) -> Iterator[tuple[Index, Array]]:
        """Yield numbers and columns (n, k) of a channel, in order, from a number on."""
        for part in self.channels[channel]:
            skip = int(np.searchsorted(part.at, first)) if first else 0
            if skip < len(part.at):
                yield part.at[skip:], part.columns[:, skip:]


class InnerProducts:
    """Columns channel by channel, and their inner products over all channels.

    A search looks at thousands of columns and puts dozens into its models. What it asks for is each group of columns within
    itself, and those of the models with all others: the whole matrix would cost the square of the library's size.

    Args:
        width: number of channels.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._stacks, self._known = _Stacks(width), _Stacks(width)
        self._blocks: list[Array] = []
        self._owner = np.empty(0, dtype=np.intp)
        # Row of a column in the table of known products, -1: none; these are of the first so many columns.
        self._row = np.empty(0, dtype=np.intp)
        self._table, self._rows, self._reach = np.empty((0, 0)), 0, 0

    def __len__(self) -> int:
        """Return the number of columns."""
        return len(self._owner)

    def append(self, groups: list[Group]) -> None:
        """Take more columns."""
        sizes = [group.size for group in groups]
        starts = (len(self) + np.concatenate([[0], np.cumsum(sizes)])).astype(np.intp)
        self._owner = np.concatenate([self._owner, len(self._blocks) + np.repeat(np.arange(len(groups)), sizes)])
        self._row = np.concatenate([self._row, np.full(sum(sizes), -1, dtype=np.intp)])
        for group in groups:
            block = np.zeros((group.size, group.size))
            for at, X in group.columns.values():
                block[np.ix_(at, at)] += X.T @ X
            self._blocks.append(block)
        for c in range(self._width):
            fresh = [
                (start, group.columns[c]) for start, group in zip(starts, groups, strict=False) if c in group.columns
            ]
            if fresh:
                at = np.concatenate([start + own for start, (own, _) in fresh])
                self._stacks.push(c, at, np.concatenate([X for _, (_, X) in fresh], axis=1))

    @contextmanager
    def fewer_again(self) -> Iterator[None]:
        """Forget, in the end, what was appended meanwhile."""
        kept = self.__dict__ | {"_stacks": self._stacks.copy(), "_known": self._known.copy(), "_row": self._row.copy()}
        kept["_blocks"] = list(self._blocks)
        try:
            yield
        finally:
            self.__dict__.update(kept)

    def forget(self, groups: Mask) -> Mask:
        """Forget groups of columns (m,), in the order in which they came.

        Returns:
            (len,) which columns are left; they move up.
        """
        kept = ~groups[self._owner]
        known = np.zeros(self._rows, dtype=bool)
        known[self._row[kept & (self._row >= 0)]] = True
        self._table = self._table[: self._rows, : self._reach][np.ix_(known, kept[: self._reach])]
        self._rows, self._reach = self._table.shape
        self._row = _ranks(known)[self._row[kept]]
        self._blocks = [block for block, gone in zip(self._blocks, groups.tolist(), strict=True) if not gone]
        self._owner = _ranks(~groups)[self._owner[kept]]
        self._stacks, self._known = (stacks.renumbered(_ranks(kept)) for stacks in (self._stacks, self._known))
        return kept

    def with_targets(self, targets: list[Array], first: int) -> Array:
        """Return inner products (len - first, k) of the columns from a number on with targets, (n, k) of each channel."""
        out = np.zeros((len(self) - first, targets[0].shape[1]))
        for c, target in enumerate(targets):
            for at, X in self._stacks.parts(c, first):
                out[at - first] += X.T @ target
        return out

    def within(self, at: Index) -> Array:
        """Return inner products (m, k, k) within groups of k columns each.

        Args:
            at: (m,) a column of each.
        """
        return np.array([self._blocks[group] for group in self._owner[at].tolist()])

    def between(self, a: Index, b: Index) -> Array:
        """Return inner products (len(a), len(b)) of columns with columns."""
        self._learn(self._missing(a, b))
        rows, columns = self._row[a], self._row[b]
        out, known = np.zeros((len(a), len(b))), rows >= 0
        out[known] = self._table[np.ix_(rows[known], b)]
        if known.all():
            return out
        rest, other = ~known, columns >= 0
        out[np.ix_(rest, other)] = self._table[np.ix_(columns[other], a[rest])].T
        if not other.all():
            # Both are of the same group: of two groups, one would be known.
            group = self._owner[a[rest][0]]
            first = np.searchsorted(self._owner, group)
            out[np.ix_(rest, ~other)] = self._blocks[group][np.ix_(a[rest] - first, b[~other] - first)]
        return out

    def _missing(self, a: Index, b: Index) -> list[int]:
        """Return groups to be computed so that of each pair of columns one is known: of a model all but its last."""
        left, right = (list(dict.fromkeys(self._owner[x[self._row[x] < 0]].tolist())) for x in (a, b))
        return left[:-1] if set(left) == set(right) else min(left, right, key=len)

    def _learn(self, groups: list[int]) -> None:
        """Bring the rows that are known to all columns, and those of more groups into the table."""
        new = np.flatnonzero(np.isin(self._owner, groups))
        if not len(new) and self._reach == len(self):
            return
        old, reach, size = self._rows, self._reach, len(self)
        self._rows, self._reach = old + len(new), size
        if self._rows > self._table.shape[0] or size > self._table.shape[1]:
            # With spare room: a search appends thousands of times.
            table = np.empty((self._rows + self._rows // 2 + 32, size + size // 2))
            table[:old, :reach] = self._table[:old, :reach]
            self._table = table
        self._table[:old, reach:size] = 0.0
        self._table[old : self._rows, :size] = 0.0
        self._row[new] = np.arange(old, self._rows)
        for c in range(self._width):
            for at, X in self._known.parts(c, 0):
                for more, Y in self._stacks.parts(c, reach):
                    self._table[np.ix_(self._row[at], more)] += X.T @ Y
            own = [(at[asked], X[:, asked]) for at, X in self._stacks.parts(c, 0) if (asked := np.isin(at, new)).any()]
            if own:
                at, X = np.concatenate([at for at, _ in own]), np.concatenate([X for _, X in own], axis=1)
                self._known.push(c, at, X)
                for more, Y in self._stacks.parts(c, 0):
                    self._table[np.ix_(self._row[at], more)] += X.T @ Y


def _ranks(kept: Mask) -> Index:
    """Return the new number (n + 1,) of each that is kept, -1 for the others and in the last place, which is that of -1."""
    return np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
