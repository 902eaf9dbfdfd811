"""ROS messages as arrays: where the numbers of one message stand, and then of all messages of the same shape at once.

A message of ROS is its fields one after the other; only texts and sequences make its shape. Messages whose lengths and
texts are the same byte for byte have their numbers at the same places, so that one walk through the first of them serves
for all: a million messages are a handful of array operations.
"""

import re
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Nanoseconds
from galen_hw.spatial import Array

Bytes = np.ndarray[Any, Any]
CODES: Final = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
} | {
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
MOST_ELEMENTS: Final = 64
"""Longer arrays (images, clouds, maps) are no columns."""
MOST_SHAPES: Final = 200
BATCH: Final = 8192
"""Messages that are decoded at once: few enough that what waits is little beside the table, many enough that loops are none."""


class ShapeError(ValueError):
    """A message that is not of its type, or of a type that is not known."""


@dataclass
class Shape:
    """Where the numbers of messages stand.

    Args:
        first: the message that was walked through; spans: places of what must be the same in all; texts: by name.
        fields: name, place and numpy code of each number.
    """

    first: bytes
    fields: list[tuple[str, int, str]] = field(default_factory=list)
    spans: list[tuple[int, int]] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)

    @cached_property
    def columns(self) -> dict[str, int]:
        """Number of the field by the name of its column: numbers that a list of names of their length names are called by it."""
        named = self._named()
        return {named.get(name, name): i for i, (name, _, _) in enumerate(self.fields)}

    def _named(self) -> dict[str, str]:
        """`position[2]` as `position[elbow]`, where the message has as many different names as positions."""
        lists: dict[tuple[str, str], list[str]] = {}
        for name, _, _ in self.fields:
            if found := _ELEMENT.match(name):
                lists.setdefault((found["head"], found["list"]), []).append(name)
        out: dict[str, str] = {}
        for (head, place), elements in lists.items():
            for key in ("name", "joint_names", "names"):
                names = [self.texts.get(f"{head}{key}[{i}]", "") for i in range(len(elements))]
                more = f"{head}{key}[{len(elements)}]" in self.texts
                if all(names) and not more and len(set(names)) == len(names):
                    out |= {element: f"{head}{place}[{text}]" for element, text in zip(elements, names, strict=True)}
        return out

    def fits(self, table: Bytes) -> "np.ndarray[Any, np.dtype[np.bool_]]":
        """(N,) which of messages of this length, (N, length) bytes, have this shape."""
        first, same = np.frombuffer(self.first, dtype=np.uint8), np.ones(len(table), dtype=bool)
        for start, end in self.spans:
            same &= (table[:, start:end] == first[start:end]).all(axis=1)
        return same

    def code(self, name: str) -> str:
        """Numpy's code of a column."""
        return self.fields[self.columns[name]][2]


_ELEMENT: Final = re.compile(r"(?P<head>(?:.*\.)?)(?P<list>[^.\[]+)\[\d+\]$")


class _Walk:
    """One pass through a message."""

    def __init__(self, types: Mapping[str, Any], raw: bytes, *, cdr: bool) -> None:
        self._types, self._raw, self._cdr = types, raw, cdr
        self._big = cdr and len(raw) > 1 and raw[1] in (0, 2, 6, 8, 10)
        self._head = 4 if cdr else 0
        self._place = self._head
        self.shape = Shape(raw, spans=[(0, 4)] if cdr else [])

    def message(self, kind: str, name: str, *, kept: bool = True) -> None:
        if kind not in self._types:
            raise ShapeError(f"the type {kind} is not known")
        fields = self._types[kind][1]
        if not fields and self._cdr:
            self._skip(1, 1)  # an empty struct is one byte
        for part, description in fields:
            self._field(description, f"{name}.{part}" if name else part, kept=kept)

    def _field(self, description: Any, name: str, *, kept: bool) -> None:
        node, inner = int(description[0]), description[1]
        if node == 1:
            self._base(inner[0], name, kept=kept)
        elif node == 2:
            self.message(inner, name, kept=kept)
        else:
            element, size = inner
            count = size if node == 3 else self._count()
            self._elements(element, name, count, kept=kept)

    def _elements(self, element: Any, name: str, count: int, *, kept: bool) -> None:
        kept = kept and count <= MOST_ELEMENTS
        if int(element[0]) == 1 and element[1][0] in CODES and not kept:
            size = np.dtype(CODES[element[1][0]]).itemsize
            if count:
                self._skip(size, count * size)
            return
        if count > len(self._raw):
            raise ShapeError("a sequence is longer than the message")
        for i in range(count):
            self._field(element, f"{name}[{i}]", kept=kept)

    def _base(self, kind: str, name: str, *, kept: bool) -> None:
        if kind == "string":
            self._text(name)
            return
        if kind not in CODES:
            raise ShapeError(f"{kind} is not read")
        size = np.dtype(CODES[kind]).itemsize
        place = self._skip(size, size)
        if kept:
            self.shape.fields.append((name, place, (">" if self._big else "<") + CODES[kind]))

    def _skip(self, align: int, size: int) -> int:
        place = self._place
        if self._cdr:
            place = (place - self._head + align - 1) // align * align + self._head
        self._place = place + size
        if self._place > len(self._raw):
            raise ShapeError("it ends before its last field")
        return place

    def _count(self) -> int:
        place = self._skip(4, 4)
        self.shape.spans.append((place, place + 4))
        return int.from_bytes(self._raw[place : place + 4], "big" if self._big else "little")

    def _text(self, name: str) -> None:
        size = self._count()
        place = self._skip(1, size)
        self.shape.spans.append((place, place + size))
        self.shape.texts[name] = self._raw[place : place + size].rstrip(b"\0").decode("utf-8", "replace")


def shape_of(types: Mapping[str, Any], kind: str, raw: bytes, *, cdr: bool) -> Shape:
    """Where the numbers of a message stand.

    Args:
        types: field definitions by type, as rosbags writes them; kind: of the message; raw: the message; cdr: of ROS 2.

    Raises:
        ShapeError: it is not of that type.
    """
    walk = _Walk(types, raw, cdr=cdr)
    walk.message(kind, "")
    return walk.shape


class _Part:
    """The numbers of all messages of one shape, as they came; buffers that grow in place are never held twice."""

    def __init__(self, shape: Shape) -> None:
        self.shape, self.rows = shape, bytearray()
        self._values = [bytearray() for _ in shape.fields]

    def add(self, index: Bytes, table: Bytes) -> None:
        """Take messages (n, length) that are the rows `index`."""
        self.rows += index.astype(np.uint32).tobytes()
        for buffer, (_, place, code) in zip(self._values, self.shape.fields, strict=True):
            buffer.extend(table[:, place : place + np.dtype(code).itemsize].tobytes())

    @property
    def index(self) -> Bytes:
        """(n,) the rows."""
        return np.frombuffer(self.rows, dtype=np.uint32)

    def take(self, name: str) -> Bytes | None:
        """(n,) the numbers of a column, whose memory is given up here; None where the shape has none."""
        at = self.shape.columns.get(name)
        if at is None:
            return None
        buffer, self._values[at] = self._values[at], bytearray()
        return np.frombuffer(buffer, dtype=self.shape.fields[at][2])


class Gatherer:
    """The messages of one topic, as columns.

    Args:
        types, kind, cdr: see `shape_of`.

    `lost` counts messages that could not be read, by reason; `texts` are those of the first message of the last shape.
    """

    def __init__(self, types: Mapping[str, Any], kind: str, *, cdr: bool) -> None:
        self._types, self.kind, self._cdr = types, kind, cdr
        self._parts: dict[int, list[_Part]] = {}
        self._waiting: dict[int, tuple[bytearray, list[int]]] = {}
        self._logged = array("q")
        self.lost: dict[str, int] = {}
        self.texts: dict[str, str] = {}

    def add(self, raw: bytes, log_ns: int) -> None:
        """Take one message."""
        waiting = self._waiting.get(len(raw))
        if waiting is None:
            waiting = self._waiting[len(raw)] = (bytearray(), [])
        waiting[0].extend(raw)
        waiting[1].append(len(self._logged))
        self._logged.append(log_ns)
        if len(waiting[1]) >= BATCH:
            self._settle(len(raw))

    def _settle(self, length: int) -> None:
        """Decode what waits: shape by shape, until none is left."""
        data, rows = self._waiting.pop(length)
        index, known = np.array(rows, dtype=np.uint32), self._parts.setdefault(length, [])
        table, turn = np.frombuffer(data, dtype=np.uint8).reshape(len(rows), length), 0
        while len(index):
            if turn == len(known):
                shape = self._new_shape(table[0].tobytes())
                if shape is None:
                    table, index = table[1:], index[1:]
                    continue
                known.append(_Part(shape))
            same = known[turn].shape.fits(table)
            if same.all():  # as nearly always: nothing is picked out, nothing copied
                known[turn].add(index, table)
                return
            known[turn].add(index[same], table[same])
            table, index, turn = table[~same], index[~same], turn + 1

    def _new_shape(self, raw: bytes) -> Shape | None:
        many = sum(map(len, self._parts.values())) >= MOST_SHAPES
        try:
            shape = None if many else shape_of(self._types, self.kind, raw, cdr=self._cdr)
            why = f"more than {MOST_SHAPES} shapes of message"
        except ShapeError as error:
            shape, why = None, str(error)
        if shape is None:
            self.lost[why] = self.lost.get(why, 0) + 1
            return None
        self.texts.update(shape.texts)
        return shape

    def columns(self) -> tuple[dict[str, Array], Nanoseconds, Nanoseconds | None]:
        """Every number by its name, (N,), NaN in messages without it; when they were logged; and their headers' stamps.

        The memory is given up as the columns are made: of a million messages nothing is held twice.
        """
        for length in list(self._waiting):
            self._settle(length)
        parts = [part for some in self._parts.values() for part in some]
        logged, places = np.frombuffer(self._logged, dtype=np.int64), [part.index for part in parts]
        if self.lost:
            there = np.sort(np.concatenate([*places, np.zeros(0, dtype=np.uint32)]))
            logged, places = logged[there], [np.searchsorted(there, index) for index in places]
        stamps = _stamps(parts, places, len(logged))
        names = dict.fromkeys(n for part in parts for n in part.shape.columns if not n.startswith("header."))
        columns = {name: _filled(name, parts, places, len(logged)) for name in names}
        self._parts.clear()
        return columns, logged, stamps


def _filled(name: str, parts: list[_Part], places: list[Bytes], count: int) -> Array:
    """A column of all shapes; of one shape alone it is the buffer itself."""
    if len(parts) == 1 and parts[0].shape.code(name) == "<f8":
        found = parts[0].take(name)
        assert found is not None, "the shape has it"
        return found
    out = np.full(count, np.nan)
    for place, part in zip(places, parts, strict=True):
        if (values := part.take(name)) is not None:
            out[place] = values
    return out


def _stamps(parts: list[_Part], places: list[Bytes], count: int) -> Nanoseconds | None:
    """Stamps of the headers, ns since the epoch; None where a message has none."""
    stamps = np.zeros(count, dtype=np.int64)
    for place, part in zip(places, parts, strict=True):
        seconds, rest = part.take("header.stamp.sec"), part.take("header.stamp.nanosec")
        if seconds is None or rest is None:
            return None
        stamps[place] = seconds.astype(np.int64) * NS_PER_S + rest
    return stamps if parts else None
