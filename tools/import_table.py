"""`galen-hw import`: a table folder as an MCAP file, for viewers and for `galen-hw replay`."""

import argparse
from pathlib import Path

from galen_hw.errors import EXIT_OK


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="table folder: docs/recording.md")
    parser.add_argument("file", metavar="FILE", type=Path, help="MCAP file to be made")
    parser.add_argument("--encoding", choices=("json", "msgpack"), default="json", help="of the messages")
    parser.add_argument("--force", action="store_true", help="overwrite the file")
    parser.epilog = "example: galen-hw import run run.mcap"


def run(args: argparse.Namespace) -> int:
    """Write it, and say what is odd about it."""
    from galen_hw.recording import read_recording
    from galen_hw.recording.to_mcap import write_mcap

    recording = read_recording(args.folder)
    write_mcap(recording, args.file, encoding=args.encoding, overwrite=args.force)
    print(f"{args.file}: {len(recording)} rows, {len(recording.columns)} columns")
    for warning in recording.warnings:
        print(f"  {warning}")
    return EXIT_OK
