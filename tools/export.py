"""`galen-hw export`: a recording as a table folder."""

import argparse
from pathlib import Path

from galen_hw.errors import EXIT_OK


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("recording", metavar="RECORDING", type=Path, help="MCAP file (or a table folder)")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="to be made")
    parser.add_argument("--format", choices=("csv", "parquet"), default="csv", help="of the table")
    parser.add_argument("--compensated", action="store_true", help="also the wrench as it was compensated live")
    parser.add_argument("--overwrite", action="store_true", help="overwrite the folder")
    parser.epilog = "example: galen-hw export run.mcap run"


def run(args: argparse.Namespace) -> int:
    """Write it, and say what is odd about it."""
    from galen_hw.formats import read
    from galen_hw.recording import write_table

    recording = read(args.recording, compensated=args.compensated)
    write_table(recording, args.folder, args.format, overwrite=args.overwrite)
    print(f"{args.folder}: {len(recording)} rows, {len(recording.columns)} columns")
    for warning in recording.warnings:
        print(f"  {warning}")
    return EXIT_OK
