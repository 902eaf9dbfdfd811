"""`galen-hw diagnose`: find what a model left out: locate, name, model, prove."""

import argparse
import json
from pathlib import Path

from galen_hw.diagnosis.settings import LIMITS
from galen_hw.errors import EXIT_FOUND, EXIT_OK
from galen_hw.extras import need
from galen_hw.tools.answer import stamped
from galen_hw.tools.robot_given import add_robot
from galen_hw.units import number_in


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="MCAP file, table folder, a file of another program (docs/import.md), a folder of them, or a URL (s3://...)",
    )
    parser.add_argument("--simulation", help="a table that someone else simulated")
    add_robot(parser)
    parser.add_argument(
        "--holdout",
        action="append",
        metavar="RECORDING",
        help="a second recording to be judged on (may be given several times), or the share of blocks to set aside (0.3)",
    )
    parser.add_argument(
        "--together", action="store_true", help="fit all recordings as one: the same machine, several runs"
    )
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="OUT",
        help="print the answer as JSON, the summary on stderr; or write it to this file, as -o does",
    )
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="write the answer as JSON to this file")
    parser.add_argument(
        "--report", metavar="PAGE", type=Path, help="write a page with figures: FILE.html, or a folder for report.html"
    )
    parser.add_argument(
        "--tool", metavar="NAME", help="the tool in hand, of the store or a tool's file (default: as recorded)"
    )
    parser.add_argument(
        "--save-model",
        metavar="OUT.json",
        help="write the tool's file with the terms found, for galen-hw tool import; without a tool the terms alone",
    )
    parser.add_argument(
        "--no-repair", action="store_true", help="refuse what would be put right in memory: units, axes, clocks"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the blocks that are set aside")
    parser.add_argument(
        "--time-limit",
        metavar="S",
        type=number_in("s"),
        default=LIMITS.seconds,
        help="stop the search for better models of a recording after so many seconds, and judge the best so far "
        f"({LIMITS.seconds:g}; 0: never)",
    )
    parser.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster, for many recordings")
    parser.epilog = "example: galen-hw diagnose run.mcap --report report.html --save-model retractor+cable.json"


def run(args: argparse.Namespace) -> int:
    """Diagnose; 0 all agree, 1 a mismatch was found.

    Raises:
        UsageError: wrong use or unreadable input.
    """
    need("diagnose")
    from rich.console import Console

    from galen_hw.config.tool_store import write_atomic
    from galen_hw.formats.remote import place, recordings_in
    from galen_hw.tools.diagnose_many import answers_to
    from galen_hw.tools.diagnose_screen import show

    if args.json and args.json != "-":
        args.output = args.output or Path(args.json)
    printed = args.json == "-"
    _check_outputs(args)
    paths = [p for given in args.recordings for p in recordings_in(place(given))]
    answers = answers_to(paths, args)
    show(Console(stderr=printed), answers)
    if printed or args.output:
        values = [stamped(answer.to_json(), seed=args.seed) for answer in answers]
        text = json.dumps(values if len(values) > 1 else values[0], indent=1, ensure_ascii=False, allow_nan=False)
        if args.output:
            write_atomic(args.output, text + "\n")
        if printed:
            print(text)
    return EXIT_OK if all(a.verdict == "agrees" for a in answers) else EXIT_FOUND


def _check_outputs(args: argparse.Namespace) -> None:
    """What is to be written can be, before minutes of work are spent on it."""
    from galen_hw.tools.outputs import check_file, report_page

    for option, given in (("-o", args.output), ("--save-model", args.save_model)):
        if given:
            check_file(Path(given), option)
    if args.report:
        need("reports", "--report")
        args.report = report_page(args.report)
