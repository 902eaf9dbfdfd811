"""CSV of any separator, with a point or a comma for decimals, with or without a preamble and a line of units."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.extras import need
from galen_hw.formats.contents import UTF16, Contents, Head, Stream, head_of, unreadable
from galen_hw.formats.units import any_unit, canonical
from galen_hw.recording.table import EMPTY
from galen_hw.spatial import Array

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS: Final = (";", "\t", ",", "|", " ")
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$|[+-]?(nan|inf)$", re.IGNORECASE)
_COMMA_NUMBER: Final = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?$")
LOST: Final = [*EMPTY, "MISSING", "missing", "-", "--", "#N/A", "NULL", "none", "OCCLUDED"]
"""Cells that mean "not measured", here and elsewhere."""


@dataclass(frozen=True)
class Layout:
    """How a CSV is written.

    Args:
        separator; decimal: "." or ","; header: line of the names, from 0; None where there is none.
        names: of the columns; units: of a line of their own, else empty; first: line of the first row.
    """

    separator: str
    decimal: str
    header: int | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int


Score = tuple[float, bool, int]


def sniff(head: Head) -> bool:
    """Return whether it is a text with rows of numbers."""
    return layout_of(head.lines) is not None


def layout_of(lines: Sequence[str]) -> Layout | None:
    """How the first lines of a file are written; None where they are no table of numbers."""
    best: tuple[Score, Layout] | None = None
    for separator in SEPARATORS:
        found = _layout(lines, separator)
        if found is not None and (best is None or found[0] > best[0]):
            best = found
    return None if best is None else best[1]


def _layout(lines: Sequence[str], separator: str) -> tuple[Score, Layout] | None:
    """How well the rows fit this separator, and the layout: cells that are numbers, then names above them, then width."""
    rows = [_cells(line, separator) for line in lines]
    numeric = {
        i: _numbers(cells) for i, cells in enumerate(rows) if _numbers(cells) >= 1 and 2 * _numbers(cells) >= len(cells)
    }
    if not numeric:
        return None
    width = Counter(len(rows[i]) for i in numeric).most_common(1)[0][0]
    fitting = [i for i in numeric if len(rows[i]) == width]
    first = fitting[0]
    commas = sum(bool(_COMMA_NUMBER.match(cell)) for i in fitting for cell in rows[i])
    points = sum("." in cell for i in fitting for cell in rows[i])
    above = [i for i in range(first - 1, max(-1, first - 4), -1) if len(rows[i]) == width and not _numbers(rows[i])]
    # Units stand between the names and the first row.
    units = above[0] if len(above) > 1 and _are_units(rows[above[0]]) else None
    header = None if not above else above[0] if units is None else above[1]
    names = [f"column_{i + 1}" for i in range(width)] if header is None else [c.lstrip("#% ") for c in rows[header]]
    known = tuple(rows[units]) if units is not None else ()
    layout = Layout(separator, "," if commas > points else ".", header, tuple(_distinct(names)), known, first)
    share = sum(numeric[i] for i in fitting) / (width * len(fitting))
    return (round(share, 2), header is not None, width), layout


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def _numbers(cells: Sequence[str]) -> int:
    return (
        sum(bool(_NUMBER.match(cell) or _COMMA_NUMBER.match(cell)) or cell in LOST for cell in cells)
        if any(_NUMBER.match(cell) or _COMMA_NUMBER.match(cell) for cell in cells)
        else 0
    )


def _are_units(cells: Sequence[str]) -> bool:
    words = [cell.strip("[]() ") for cell in cells]
    return any(words) and all(any_unit(word) or word in ("", "-") for word in words)


def _distinct(names: Sequence[str]) -> list[str]:
    """Names with a number behind those that come again or are empty."""
    seen: Counter[str] = Counter()
    out = []
    for i, name in enumerate(names):
        plain = name or f"column_{i + 1}"
        seen[plain] += 1
        out.append(plain if seen[plain] == 1 else f"{plain}.{seen[plain]}")
    return out


def read(path: Path) -> Contents:
    """One stream of the columns that hold numbers.

    Raises:
        UsageError: it cannot be read.
    """
    stream, notes, passed = read_stream(path)
    return Contents([stream], passed, notes)


def read_stream(path: Path, layout: Layout | None = None) -> tuple[Stream, list[str], list[str]]:
    """The stream, what is odd, and what holds no numbers.

    Args:
        path: of the file; layout: how it is written, where that is known.

    Raises:
        UsageError: it cannot be read.
    """
    lines = _lines(path)
    layout = layout or layout_of(lines[:400])
    if layout is None:
        raise UsageError("not a table of numbers", where=str(path))
    rows, lost, notes = _whole_rows(lines, layout)
    if layout.header not in (None, 0):
        notes.append(f"lines before the names are passed over: {layout.header}")
    if layout.header is None:
        notes.append("no line of names: columns are called column_1, column_2, ...")
    if layout.decimal == ",":
        notes.append("a comma is read as the decimal point")
    cells = _frame(path, rows, layout)
    stream = Stream("", {}, lost=lost)
    passed = []
    for i, name in enumerate(layout.names):
        values, bad, stamps = numbers(cells[i])
        if values is None:
            passed.append(f"{name}: text, not taken")
            continue
        if stamps:
            stream.units[name] = "s"
            notes.append(f"{name}: dates and times are read as s since 1970 (UTC where no zone is named)")
        if bad:
            notes.append(f"{name}: {bad} cells that are no numbers are taken as not measured")
        stream.columns[name] = values
        unit = layout.units[i].strip("[]() ") if layout.units else ""
        if unit not in ("", "-"):
            stream.units[name] = unit
    return stream, notes, passed


def _lines(path: Path) -> list[str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error.strerror) from error
    if data[:2] in UTF16:
        return data.decode("utf-16", "replace").splitlines()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    # Not splitlines(): other line ends of Unicode are characters of a cell.
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _whole_rows(lines: list[str], layout: Layout) -> tuple[list[str], dict[str, int], list[str]]:
    """Rows that have all their cells; those that have not are counted, and the first is named."""
    separators = len(layout.names) - 1
    kept, short, first_short = [], 0, 0
    quoted = any('"' in line for line in lines[:100])
    for number, line in enumerate(lines[layout.first :], layout.first + 1):
        if not line.strip() or line.startswith("#"):
            continue
        count = (
            len(_cells(line, layout.separator)) - 1
            if quoted or layout.separator == " "
            else line.count(layout.separator)
        )
        if count == separators or (count == separators + 1 and line.rstrip().endswith(layout.separator)):
            kept.append(line)
        else:
            short, first_short = short + 1, first_short or number
    notes = (
        []
        if not short
        else [f"line {first_short} has not {separators + 1} cells" + (", nor have others" if short > 1 else "")]
    )
    return kept, {"a row that is not whole": short} if short else {}, notes


def _frame(path: Path, rows: list[str], layout: Layout) -> "pd.DataFrame":
    need("import", str(path), "pandas")
    import pandas as pd

    # Every digit of a number counts; newer pandas reads so by itself, and warns of being told.
    told = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: dict[str, Any] = {"float_precision": "round_trip"} if told else {}
    try:
        found: pd.DataFrame = pd.read_csv(
            StringIO("\n".join(rows) + "\n"),
            header=None,
            names=list(range(len(layout.names))),
            index_col=False,
            sep=r"\s+" if layout.separator == " " else layout.separator,
            decimal=layout.decimal,
            na_values=LOST,
            skipinitialspace=True,
            **exact,
        )
    except (ValueError, pd.errors.ParserError) as error:
        raise unreadable(path, error) from None
    return found


def numbers(cells: "pd.Series[float]") -> tuple[Array | None, int, bool]:
    """A column's numbers, how many of its cells are none, and whether they were dates; None where it is text."""
    import pandas as pd

    if pd.api.types.is_bool_dtype(cells) or pd.api.types.is_numeric_dtype(cells):
        return np.asarray(cells.to_numpy(dtype=float, na_value=np.nan)), 0, False
    text = cells.astype("string").str.strip()
    values = pd.to_numeric(text.replace({"True": "1", "False": "0", "true": "1", "false": "0"}), errors="coerce")
    there = int(text.notna().sum())
    good = int(values.notna().sum())
    if good >= max(1, there // 2):
        return np.asarray(values.to_numpy(dtype=float, na_value=np.nan)), there - good, False
    stamps = pd.to_datetime(text, errors="coerce", utc=True, format="ISO8601")
    good = int(stamps.notna().sum())
    if there and good >= max(1, there // 2):
        ns = stamps.dt.as_unit("ns").astype("int64").to_numpy()
        seconds: Array = np.array(ns, dtype=np.float64) / NS_PER_S
        seconds[stamps.isna().to_numpy()] = np.nan
        return seconds, there - good, True
    return None, there, False


def header_of(path_or_head: Path | Head) -> tuple[str, ...]:
    """Names in the header of a CSV; none where it is no table."""
    head = head_of(path_or_head) if isinstance(path_or_head, Path) else path_or_head
    layout = layout_of(head.lines[:400]) if head.text else None
    return () if layout is None or layout.header is None else layout.names


__all__ = ["Layout", "canonical", "header_of", "layout_of", "numbers", "read", "read_stream", "sniff"]
