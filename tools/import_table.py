"""`galen-hw import`: a table folder as an MCAP file, for viewers and for `galen-hw replay`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from galen_hw.errors import EXIT_OK

if TYPE_CHECKING:
    from galen_hw.recording import Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="table folder: docs/recording.md")
    parser.add_argument("file", metavar="FILE", type=Path, help="MCAP file to be made")
    parser.add_argument("--encoding", choices=("json", "msgpack"), default="json", help="of the messages")
    parser.add_argument("--overwrite", action="store_true", help="overwrite the file")
    parser.epilog = "example: galen-hw import run run.mcap"


def run(args: argparse.Namespace) -> int:
    """Write it, and say what is odd about it."""
    from galen_hw.recording import read_recording
    from galen_hw.recording.to_mcap import write_mcap

    recording = read_recording(args.folder)
    write_mcap(recording, args.file, encoding=args.encoding, overwrite=args.overwrite)
    print(f"{args.file}: {len(recording)} rows, {len(recording.columns)} columns")
    for line in (*recording.warnings, *_premises(recording)):
        print(f"  {line}")
    return EXIT_OK


def _premises(recording: "Recording") -> list[str]:
    """What the premises say of what is compared; the file holds the cells as they were."""
    from galen_hw.premises import examined
    from galen_hw.tools.diagnose_input import observations_of

    if recording.info.predict is None:
        return []
    return [remark.what for remark in examined(observations_of(recording)).remarks]
