"""The controller's command language: from bytes to lines, from a line to commands and their operands."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.format import Rejected

LINE_LIMIT: Final = 80
CR: Final = 0x0D
LF: Final = 0x0A
REVISION_REQUEST: Final = b"\x12\x16"
LETTERS: Final = "ABCDEFGH"
_ALIASES: Final = str.maketrans("XYZW", "ABCD")
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)$")
_VARIABLE: Final = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}$")


@dataclass(frozen=True, slots=True)
class Line:
    """A whole line, without its end; `overflowed` when it was longer than the controller takes."""

    text: str
    overflowed: bool = False


@dataclass(slots=True)
class LineReader:
    """Collects bytes into lines. ^R^V anywhere asks for the revision; LF is ignored."""

    _text: bytearray = field(default_factory=bytearray)
    _control: bool = False
    _overflowed: bool = False

    def feed(self, byte: int) -> Line | bytes | None:
        """One byte; a line, `REVISION_REQUEST`, or nothing yet. The overflow is told at once, the rest is swallowed."""
        if self._control:
            self._control = False
            if byte == REVISION_REQUEST[1]:
                return REVISION_REQUEST
        if byte == REVISION_REQUEST[0]:
            self._control = True
            return None
        if byte == CR:
            swallowed, text = self._overflowed, self._text.decode("latin-1")
            self.clear()
            return None if swallowed else Line(text)
        if byte == LF or self._overflowed:
            return None
        self._text.append(byte)
        if len(self._text) > LINE_LIMIT:
            self._overflowed = True
            return Line(self._text.decode("latin-1"), overflowed=True)
        return None

    def clear(self) -> None:
        """Forget the line so far."""
        self._text.clear()
        self._overflowed = False


@dataclass(frozen=True, slots=True)
class Command:
    """Two letters and what follows them, or an assignment to a variable.

    Args:
        name: two upper-case letters, or the variable's name.
        rest: the text after them, stripped.
        variable: whether this is `name=expression`.
    """

    name: str
    rest: str = ""
    variable: bool = False


def split_line(text: str) -> list[str]:
    """Commands of a line; `;` inside quotes does not separate."""
    parts, current, quoted = [], "", False
    for char in text:
        quoted ^= char == '"'
        if char == ";" and not quoted:
            parts.append(current)
            current = ""
        else:
            current += char
    return [*parts, current]


def parse(text: str) -> Command | None:
    """One command; None for an empty one.

    Raises:
        Rejected: lower case, or not two letters (code 1).
    """
    text = text.strip()
    if not text:
        return None
    name, equals, rest = text.partition("=")
    upper_pair = len(name) in (2, 3) and name.isalpha() and name.isupper()
    if equals and not upper_pair and _VARIABLE.match(name.strip()):
        return Command(name.strip(), rest.strip(), variable=True)
    if len(text) < 2 or not text[:2].isascii() or not text[:2].isalpha() or not text[:2].isupper():
        raise Rejected(1)
    return Command(text[:2], text[2:].strip())


def axes_of(text: str, count: int) -> list[int]:
    """Indices of an axis list such as `ABC`, `XY` or nothing (all axes).

    Raises:
        Rejected: a letter that is no axis of this controller (code 4).
    """
    letters = text.replace(" ", "").replace(",", "").translate(_ALIASES)
    if not letters:
        return list(range(count))
    indices = [LETTERS.find(letter) for letter in letters]
    if any(not 0 <= index < count for index in indices):
        raise Rejected(4)
    return indices


def slots_of(rest: str, count: int) -> Iterator[tuple[int, str]]:
    """(axis, text) of `1,,3`, `A=1` or `?,?`; empty places are skipped. An axis letter applies to one axis.

    Raises:
        Rejected: too many places, or no such axis (code 4).
    """
    letter, equals, value = rest.partition("=")
    if equals:
        wanted = range(count) if letter.strip() == "*" else axes_of(letter.strip(), count)
        yield from ((axis, value.strip()) for axis in wanted)
        return
    places = rest.split(",")
    if len(places) > count:
        raise Rejected(4)
    for axis, place in enumerate(places):
        if place.strip():
            yield axis, place.strip()


def number(text: str) -> float:
    """A plain number, or `$` and hexadecimal.

    Raises:
        Rejected: neither (code 4).
    """
    text = text.strip()
    if _NUMBER.match(text):
        return float(text)
    if re.match(r"\$[0-9A-Fa-f]{1,8}$", text):
        return float(int(text[1:], 16))
    raise Rejected(4)
