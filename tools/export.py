"""`galen-hw export`: a recording as a table folder, or as a file of another program."""

import argparse
from pathlib import Path

from galen_hw.errors import EXIT_OK, UsageError

TABLES = ("csv", "parquet")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    from galen_hw.formats.writing import EXPORTS

    parser.add_argument("recording", metavar="RECORDING", type=Path, help="recording of any format")
    parser.add_argument("folder", metavar="OUT", type=Path, help="folder or file to be made")
    also = "; ".join(f"{name}: {what}" for name, (_, what) in EXPORTS.items())
    parser.add_argument(
        "--format", choices=(*TABLES, *EXPORTS), default="csv", help=f"csv, parquet: a table folder; {also}"
    )
    parser.add_argument("--compensated", action="store_true", help="also the wrench as it was compensated live")
    parser.add_argument("--overwrite", action="store_true", help="overwrite what is there")
    parser.epilog = "example: galen-hw export run.mcap run; galen-hw export run.mcap bag --format rosbag2"


def run(args: argparse.Namespace) -> int:
    """Write it, and say what is odd about it."""
    from galen_hw.formats import read
    from galen_hw.formats.writing import export
    from galen_hw.recording import write_table

    recording = read(args.recording, compensated=args.compensated)
    lines: list[str] = []
    if args.format in TABLES:
        write_table(recording, args.folder, args.format, overwrite=args.overwrite)
    elif recording.columns:
        lines = export(recording, args.folder, args.format, overwrite=args.overwrite)
    else:
        raise UsageError("there are no columns", where=str(args.recording))
    print(f"{args.folder}: {len(recording)} rows, {len(recording.columns)} columns")
    for line in (*lines, *recording.warnings):
        print(f"  {line}")
    return EXIT_OK
