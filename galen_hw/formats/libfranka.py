"""Logs of libfranka: `franka::logToCSV` and the robot-state log of newer versions; time in ms, joints 1 to 7."""

import re
from pathlib import Path
from typing import Final

from galen_hw.formats.contents import Contents, Head
from galen_hw.formats.csv_table import header_of, read_stream

KINDS: Final = {"q": "position", "dq": "velocity", "tau_J": "effort", "q_d": "command"}
_NAME: Final = re.compile(r"(?:state\.)?(q|dq|tau_J|q_d)\[([0-6])\]$")
_DERIVED: Final = re.compile(r"(state\.)?tau_ext_hat_filtered|(state\.)?dq_d|cmd\.|O_|tau_J_d|q_d\[\d\]\.2|dq_d")
CLOCKS: Final = ("time", "duration")


def sniff(head: Head) -> bool:
    """By the names of the header."""
    names = set(header_of(head))
    rate = {"success_rate", "success rate"} & names
    return bool(rate and names & set(CLOCKS) and ({"q[0]", "state.q[0]"} & names))


def read(path: Path) -> Contents:
    """One stream.

    Raises:
        UsageError: it cannot be read.
    """
    stream, notes, passed = read_stream(path)
    passed = [line for line in passed if not line.startswith("sent commands")]
    stream.columns.pop("sent commands", None)
    for column in stream.columns:
        if found := _NAME.match(column):
            stream.hints[column] = f"joint.joint_{int(found[2]) + 1}.{KINDS[found[1]]}"
    gone = [column for column in stream.columns if _DERIVED.match(column) and column not in stream.hints]
    for column in gone:
        del stream.columns[column]
    passed += [f"not taken, computed by the controller: {', '.join(gone)}"] if gone else []
    clock = next(name for name in CLOCKS if name in stream.columns)
    stream.units[clock] = "ms"
    return Contents([stream], passed, notes, how=["time is in ms, as libfranka writes it"])
