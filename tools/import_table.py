"""`galen-hw import`: recordings of other programs (or a table folder) as a table folder or an MCAP file."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from galen_hw.errors import EXIT_OK, UsageError
from galen_hw.tools.robot_given import add_robot, keys_given, robot_given, with_keys

if TYPE_CHECKING:
    from galen_hw.formats import Imported
    from galen_hw.formats.mapping import Map
    from galen_hw.recording import Recording

LARGE: Final = 100_000
"""Rows from which a table is written as Parquet unless another format is asked for: text would take minutes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        help="recordings, or URLs of them: docs/import.md lists the formats",
    )
    parser.add_argument("-o", "--output", metavar="OUT", type=Path, help="folder to be made, or a file NAME.mcap")
    parser.add_argument("--map", metavar="MAP.toml", type=Path, help="which column is which, as --write-map wrote it")
    parser.add_argument(
        "--write-map", metavar="MAP.toml", type=Path, help="write the map that would be used, to be edited"
    )
    add_robot(parser)
    parser.add_argument(
        "--predict", choices=("wrench", "pose", "effort", "position", "targets"), help="what is to be compared"
    )
    parser.add_argument("--format", choices=("csv", "parquet"), help=f"of the table (parquet from {LARGE} rows on)")
    parser.add_argument("--encoding", choices=("json", "msgpack"), default="json", help="of an MCAP file's messages")
    parser.add_argument("--overwrite", action="store_true", help="overwrite what is there")
    parser.epilog = "example: galen-hw import bag -o run --robot arm.urdf"


def run(args: argparse.Namespace) -> int:
    """Read, show what was taken for what, write."""
    from galen_hw.formats.remote import at_hand, place

    args.files = [place(word) for word in args.files]
    second = args.files[1] if len(args.files) == 2 else None
    if args.output is None and isinstance(second, Path) and not second.exists():
        todo = f"galen-hw import {args.files[0]} -o {second}"
        raise UsageError("there is no such recording", where=str(second), todo=todo)
    if args.output is None and args.write_map is None:
        raise UsageError("where to?", where="-o", todo=f"e.g. galen-hw import {args.files[0]} -o FOLDER")
    for file in args.files:
        if isinstance(file, Path) and not file.exists():
            raise UsageError("there is no such recording", where=str(file), todo="give a file or a folder")
    with at_hand(args.files) as args.files:
        return _import(args)


def _import(args: argparse.Namespace) -> int:
    from galen_hw.formats import import_files
    from galen_hw.formats.own import is_own
    from galen_hw.recording import read_recording
    from galen_hw.tools.progress import working

    robot, reading = robot_given(args), f"reading {args.files[0].name}"
    if len(args.files) == 1 and is_own(args.files[0]) and args.write_map is None:
        with working(reading):
            recording = with_keys(read_recording(args.files[0]), args, robot)
        return _write(recording, args)
    with working(reading):
        imported = import_files(args.files, args.map, keys_given(args), robot)
    _show(imported)
    if args.write_map is not None:
        _write_map(imported.used, args)
    if args.output is None:
        return EXIT_OK
    if imported.used.doubtful:
        family, places = next(iter(imported.used.doubtful.items()))
        todo = "choose in a map: --write-map MAP.toml, edit it, then --map MAP.toml"
        raise UsageError(f"{family} may be {' or '.join(places)}", where=str(args.files[0]), todo=todo)
    return _write(imported.recording, args)


def _write_map(used: "Map", args: argparse.Namespace) -> None:
    from galen_hw.formats.mapping import write_map

    if args.write_map.exists() and not args.overwrite:
        raise UsageError("is there already", where=str(args.write_map), todo="give another name, or --overwrite")
    if args.robot is not None and args.robot.is_file():
        # A xacro is expanded only where it is named, each time.
        plain = used.info.get("robot") == args.robot.name
        used.info["robot"] = str(args.robot.resolve()) if plain else None
    write_map(used, args.write_map)
    print(f"{args.write_map}: edit it, then --map {args.write_map}")


def _show(imported: "Imported") -> None:
    """What was taken for what, and where every row went."""
    for name in imported.formats:
        print(f"read as {name}")
    rows = [(e.target, f"{e.stream or 'table'}: {e.column}", e.unit or "SI", e.factor) for e in imported.used.entries]
    widths = [
        max((len(word) for word in words), default=0) for words in (*zip(*(row[:2] for row in rows), strict=True),)
    ]
    for target, source, unit, scale in rows:
        times = "" if scale == 1.0 else f"  x {scale:.6g}"
        print(f"  {target:{widths[0]}}  <- {source:{widths[1]}}  {unit}{times}".rstrip())
    for line in (*imported.account, *imported.notes):
        print(f"  {line}")


def _write(recording: "Recording", args: argparse.Namespace) -> int:
    from galen_hw.recording import write_table
    from galen_hw.recording.checks import check
    from galen_hw.recording.to_mcap import write_mcap
    from galen_hw.tools.progress import working

    out: Path = args.output
    with working(f"writing {out.name}") as progress:
        if out.suffix == ".mcap":
            write_mcap(recording, out, encoding=args.encoding, overwrite=args.overwrite)
        else:
            kind: Literal["csv", "parquet"] = args.format or ("parquet" if len(recording) >= LARGE else "csv")
            write_table(recording, out, kind, overwrite=args.overwrite)
        progress(f"examining {out.name}", 0.5)
        lines = [*dict.fromkeys((*recording.warnings, *check(recording))), *_premises(recording)]
    # After the bar, which would take what is printed to its own terminal.
    print(f"{out}: {len(recording)} rows, {len(recording.columns)} columns")
    for line in lines:
        print(f"  {line}")
    return EXIT_OK


def _premises(recording: "Recording") -> list[str]:
    """What the premises say of what is compared; what is written holds the cells as they were."""
    from galen_hw.errors import GalenError
    from galen_hw.premises import examined
    from galen_hw.recording.observations import observations_of

    if recording.info.predict is None:
        return []
    try:
        return [remark.what for remark in examined(observations_of(recording)).remarks]
    except GalenError as error:
        return [str(error)]
