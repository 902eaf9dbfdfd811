"""Recordings as tables: a folder with `recording.csv` or `recording.parquet` and `recording.json`."""

import importlib.util
import shutil
import tempfile
from contextlib import suppress
from csv import Error as CsvError
from csv import reader, writer
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.extras import need
from galen_hw.recording.checks import check
from galen_hw.recording.info import INFO, RecordingInfo, read_info
from galen_hw.recording.parquet_file import parquet_table
from galen_hw.recording.recording import Recording
from galen_hw.spatial import Array

if TYPE_CHECKING:
    import pyarrow as pa

# ruff: noqa: A002 - `format` is the word of the seam

EMPTY = ["", "NaN", "nan", "NAN", "NA", "N/A", "null", "None"]
"""Cells that mean "not measured"."""
ROW_GROUP = 65536
"""Rows that are written at once."""
CSV, PARQUET = "recording.csv", "recording.parquet"


def read_table(path: Path, *, info_needed: bool = True) -> Recording:
    """Read a table folder (or one of its files).

    Args:
        path: the folder, its CSV, Parquet or JSON.
        info_needed: without `recording.json` it is an error; a simulation may do without.

    Raises:
        UsageError: missing or unreadable, with file, column and row.
    """
    folder, table, notes = _locate(path)
    info_file = folder / INFO
    info = read_info(info_file) if info_needed or info_file.exists() else RecordingInfo()
    columns = _read_csv(table) if table.suffix == ".csv" else _read_parquet(table)
    notes += _tidy(columns, table)
    beside = folder / "simulation"
    simulated = read_table(beside, info_needed=False) if beside.is_dir() else None
    recording = Recording(columns, info, folder, simulated)
    warnings = (*notes, *check(recording))
    return Recording(columns, info, folder, simulated, warnings)


def _locate(path: Path) -> tuple[Path, Path, list[str]]:
    if path.is_file() and path.suffix in (".csv", ".parquet"):
        return path.parent, path, []
    folder = path.parent if path.is_file() and path.name == INFO else path
    if not folder.is_dir():
        raise UsageError("not a recording", where=str(path), todo="give a table folder or an MCAP file")
    found = [folder / name for name in (CSV, PARQUET) if (folder / name).is_file()]
    if not found:
        todo = "give the folder that holds it, an MCAP file, or a file of another program (docs/import.md)"
        raise UsageError(f"there is no {CSV} or {PARQUET}", where=str(folder), todo=todo)
    both = [f"{PARQUET} lies beside {CSV} and is not read"] if len(found) == 2 else []
    return folder, found[0], both


def _read_csv(file: Path) -> dict[str, Array]:
    text = _text(file)
    first, _, rest = text.partition("\n")
    try:
        header = next(reader([first.rstrip("\r")]), [])
    except CsvError as error:
        raise UsageError(
            f"the header cannot be read ({error})", where=str(file), todo="name the columns there"
        ) from None
    names = _names([cell.strip() for cell in header], file)
    _check_cells(text, len(names), file)
    if not rest.strip():
        raise UsageError("there are no rows", where=str(file), todo="record something first")
    quick = importlib.util.find_spec("pyarrow") is not None
    return _with_pyarrow(rest, names, file) if quick else _without_pyarrow(rest, names, file)


def _with_pyarrow(rest: str, names: list[str], file: Path) -> dict[str, Array]:
    """Cells by column, in a tenth of the time."""
    import pyarrow as pa
    from pyarrow import csv

    convert = csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=EMPTY)
    try:
        table = csv.read_csv(
            BytesIO(rest.encode()), read_options=csv.ReadOptions(column_names=names), convert_options=convert
        )
    except pa.ArrowException as error:
        raise _bad_cell(rest, names, file, error) from None
    return {name: _copied(table[name]) for name in names}


def _copied(column: "pa.ChunkedArray") -> Array:
    """Copy floats out of arrow's memory, which cannot be written to; empty cells are NaN.

    By its buffers: `to_numpy` loads pandas, and drops a Ctrl-C that comes in that third of a second.
    """
    out = np.empty(len(column))
    row = 0
    for chunk in column.chunks:
        bits, data = chunk.buffers()
        part = out[row : row + len(chunk)]
        part[:] = np.frombuffer(data, dtype=float, count=len(chunk), offset=out.itemsize * chunk.offset)
        if chunk.null_count:
            there = np.unpackbits(np.frombuffer(bits, dtype=np.uint8), bitorder="little")[chunk.offset :][: len(chunk)]
            part[there == 0] = np.nan
        row += len(chunk)
    return out


def _without_pyarrow(rest: str, names: list[str], file: Path) -> dict[str, Array]:
    """Cells by column with Python alone: a robot's computer reads its own sweeps without the extra."""
    empty = dict.fromkeys(EMPTY, float("nan"))
    try:
        rows = [row for row in reader(rest.splitlines()) if row]
        for number, row in enumerate(rows, 1):
            if len(row) != len(names):
                what = f"{len(row)} cells where the header has {len(names)}"
                raise UsageError(what, where=f"{file}, row {number}", todo="complete the row")
        table = np.array([[empty[c] if (c := cell.strip()) in empty else _number(c) for cell in row] for row in rows])
    except (CsvError, ValueError) as error:
        raise _bad_cell(rest, names, file, error) from None
    return {name: table[:, k].copy() for k, name in enumerate(names)}


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(file), todo="give a UTF-8 CSV file") from error


def _names(names: list[str], file: Path) -> list[str]:
    """The header, checked.

    Raises:
        UsageError: empty, numbers, another separator, or a name twice.
    """
    if not any(names):
        raise UsageError("there are no columns", where=str(file), todo="the first line must name them")
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        raise UsageError("the columns are not separated by commas", where=str(file), todo="write it with commas")
    if all(_is_number(name) for name in names):
        raise UsageError("there is no header", where=str(file), todo="the first line must name the columns")
    for place, name in enumerate(names, 1):
        if not name:
            raise UsageError("a column has no name", where=f"{file}, column {place}", todo="name it in the first line")
        if name in names[: place - 1]:
            raise UsageError(f"column {name!r} is there twice", where=str(file), todo="keep one of them")
    return names


def _number(word: str) -> float:
    """A cell's number; Python's own `1_000` is none.

    Raises:
        ValueError: it is no number.
    """
    return float("no number" if "_" in word else word)


def _is_number(word: str) -> bool:
    try:
        _number(word)
    except ValueError:
        return False
    return True


def _check_cells(text: str, width: int, file: Path) -> None:
    """Every row has as many cells as the header; a row that was cut off is none."""
    if '"' in text:
        return
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.count(",") + 1
        if cells != width and line.strip():
            raise UsageError(
                f"{cells} cells where the header has {width}", where=f"{file}, line {number}", todo="complete the row"
            )


def _bad_cell(rest: str, names: list[str], file: Path, error: Exception) -> UsageError:
    """The error for the first cell that is not a number."""
    with suppress(CsvError):  # a cell that is too long for the reader is none of these
        for number, row in enumerate(reader(rest.splitlines()), 1):
            for name, cell in zip(names, row, strict=False):
                if cell.strip() not in EMPTY and not _is_number(cell):
                    where, todo = f"{file}, column {name!r}, row {number}", "leave empty what was not measured"
                    return UsageError(f"{cell[:40]!r} is not a number", where=where, todo=todo)
    return UsageError(f"not a table of numbers ({str(error)[:120]})", where=str(file), todo="check the file")


def _read_parquet(file: Path) -> dict[str, Array]:
    need("import", str(file), "pyarrow")
    import pyarrow as pa

    try:
        table = parquet_table(file)
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise UsageError(f"not readable as Parquet ({error})", where=str(file), todo="check the file") from error
    names = _names(list(table.column_names), file)
    columns: dict[str, Array] = {}
    for name, column in zip(names, table.columns, strict=True):
        try:
            columns[name] = _copied(column.cast(pa.float64()))
        except pa.ArrowException:
            where = f"{file}, column {name!r}"
            raise UsageError(f"holds {column.type}, not numbers", where=where, todo="write floats") from None
    return columns


def _tidy(columns: dict[str, Array], file: Path) -> list[str]:
    """Refuse what nothing can be made of; leave out empty columns and say so."""
    notes = []
    rows = len(next(iter(columns.values())))
    if rows == 0:
        raise UsageError("there are no rows", where=str(file), todo="record something first")
    for name in list(columns):
        infinite = np.isinf(columns[name])
        if infinite.any():
            columns[name] = np.where(infinite, np.nan, columns[name])
            notes.append(f"{name}: {int(infinite.sum())} infinite values are taken as not measured")
        if np.isnan(columns[name]).all():
            notes.append(f"{name}: every cell is empty; the column is left out")
            del columns[name]
    if not set(columns) - {"time", "segment"}:
        raise UsageError("nothing was measured, every column is empty", where=str(file), todo="check the file")
    for name in ("time", "segment"):
        bad = np.flatnonzero(np.isnan(columns.get(name, np.zeros(1))))
        if len(bad):
            where = f"{file}, column {name!r}, row {bad[0] + 1}"
            raise UsageError("the cell is empty", where=where, todo="fill it, or leave the column out")
    segment = columns.get("segment", np.zeros(1))
    if np.any(segment != np.round(segment)):
        raise UsageError("not whole numbers", where=f"{file}, column 'segment'", todo="number the runs 0, 1, 2, ...")
    return notes


def write_table(
    recording: Recording, folder: Path | str, format: Literal["csv", "parquet"] = "csv", *, overwrite: bool = False
) -> Path:
    """Write a table folder, all or nothing; every digit is kept, so that reading it back gives the same bits.

    Args:
        recording: its columns, info and simulation are written, and the URDF that it names is copied.
        folder: must not exist yet (or be empty), unless `overwrite`.
        format: of the table.
        overwrite: replace a recording that is there.

    Raises:
        UsageError: the folder is there already, or cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not overwrite)):
        raise UsageError("is there already", where=str(folder), todo="give another folder, or --overwrite")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as scratch:
            ready = Path(scratch) / folder.name
            _write_into(recording, ready, format)
            if folder.exists():
                folder.rename(Path(scratch) / "old")
            ready.rename(folder)
    except OSError as error:
        raise UsageError(f"cannot be written ({error.strerror or error})", where=str(folder)) from error
    return folder


def _write_into(recording: Recording, folder: Path, format: str) -> None:
    folder.mkdir()
    if format == "csv":
        _write_csv(recording, folder / CSV)
    else:
        _write_parquet(recording, folder / PARQUET)
    (folder / INFO).write_text(recording.info.to_json(), encoding="utf-8")
    urdf = recording.urdf
    if isinstance(urdf, str):
        (folder / Path(recording.info.robot or "").name).write_text(urdf, encoding="utf-8")
    elif urdf is not None and urdf.is_file():
        shutil.copy(urdf, folder / urdf.name)
    if recording.simulation is not None:
        _write_into(recording.simulation, folder / "simulation", format)


def _ordered(recording: Recording) -> dict[str, Any]:
    return {n: v.astype(np.int64) if n == "segment" else v for n, v in recording.columns.items()}


def _write_csv(recording: Recording, file: Path) -> None:
    columns = [values.tolist() for values in _ordered(recording).values()]
    # An empty line is no row, so that a lone column says it in words.
    empty = "" if len(columns) > 1 else "NaN"
    with file.open("w", encoding="utf-8", newline="\n") as out:
        writer(out, lineterminator="\n").writerow(recording.columns)
        for row in zip(*columns, strict=True):
            # repr is the shortest text that gives the same bits back; NaN is not equal to itself.
            out.write(",".join([repr(x) if x == x else empty for x in row]) + "\n")  # noqa: PLR0124


def _write_parquet(recording: Recording, file: Path) -> None:
    need("import", str(file), "pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

    # The buffers as they are: given numpy's arrays, pyarrow would load pandas (40 MB) to see whether they are of its kind.
    arrays = {}
    for name, values in _ordered(recording).items():
        kind, code = (pa.int64(), np.int64) if name == "segment" else (pa.float64(), np.float64)
        buffer = pa.py_buffer(np.ascontiguousarray(values, dtype=code))
        arrays[name] = pa.Array.from_buffers(kind, len(values), [None, buffer])
    # Measured numbers hardly come twice, and a dictionary of them would be a second table in memory.
    pq.write_table(pa.table(arrays), file, row_group_size=ROW_GROUP, use_dictionary=False)
    pa.default_memory_pool().release_unused()
