"""The time-out on the controller: a program in a thread of its own that stops the axes when the host falls silent.

The host sets `gh=TIME` again and again; the program ends, with ST, once that is older than `ghms` samples, and leaves
in `ghtrip` how many axes it found moving. It is added to the end of what is in the controller's memory (DL #), in RAM
only; a program that runs is left alone. Sources: Galil DMC-40x0 command reference (DL, XQ, HX, TIME, TM, _BG).
"""

from collections.abc import Generator
from typing import Final

from galen_hw.drivers.galil_dmc.codec import axis_mask, numbers
from galen_hw.drivers.galil_dmc.link import Answer, Exchange
from galen_hw.drivers.galil_dmc.scripts import Quiet, RefusedError, Script, SilentError, Step, ask, send

THREAD: Final = 7
"""The last of the eight threads: the others are the user's."""
BEAT: Final = Exchange(f"gh=TIME;MG _XQ{THREAD}")
"""Says that the host lives, and asks whether the program still runs (a line number, or -1)."""
BEATS_A_TIMEOUT: Final = 5
_SAMPLE_US: Final = 1000.0
_LOOK_MS: Final = 4


def program(letters: str) -> list[str]:
    """The program for some axes; its label names its version and the axes, so that another one never passes for it."""
    label = _label(letters)
    return [
        label,
        f"WT {_LOOK_MS}",
        f"JP {label},(TIME-gh)<ghms",
        f"ghtrip={'+'.join(f'_BG{letter}' for letter in letters)}",
        f"ST {letters}",
        "EN",
    ]


def arm(letters: str, timeout_s: float) -> Script:
    """Start the program, loading it where it is missing; what it did before is told.

    Returns:
        "unwatched", why there is no time-out now (empty if there is), and "tripped", whether it has stopped a motion.
    """
    tripped = yield from _tripped()
    try:
        unwatched = yield from _start(letters, timeout_s)
    except RefusedError as error:
        unwatched = str(error)
    return {"unwatched": unwatched, "tripped": tripped}


def _tripped() -> Generator[Step, Answer | None, bool]:
    try:
        (text,) = yield from ask("MG ghtrip")
    except RefusedError:  # a variable that is not there yet
        return False
    return _numbers(text)[0] > 0


def _start(letters: str, timeout_s: float) -> Generator[Step, Answer | None, str]:
    """Why there is no time-out now, empty if there is.

    Raises:
        RefusedError: the controller does not take one of the commands.
    """
    (text,) = yield from ask("MG _TM")
    told = _numbers(text)[0]
    sample_us = told if 1.0 <= told <= 1e5 else _SAMPLE_US
    yield from send([f"HX {THREAD}", f"ghms={round(timeout_s * 1e6 / sample_us)}", "gh=TIME"])
    unwatched = "" if (yield from _run(letters)) else (yield from _load(letters))
    yield from ask("ghtrip=0")  # last, so that what it told is not lost with an answer on the way
    return unwatched


def beaten(answer: Answer) -> bool:
    """Return whether the program ran when it was told that the host lives."""
    try:
        return not any(answer.refused) and numbers(answer.parts[-1])[0] >= 0
    except (ValueError, IndexError):
        return False


def _run(letters: str) -> Generator[Step, Answer | None, bool]:
    try:
        yield from ask(f"XQ {_label(letters)},{THREAD}")
    except RefusedError:
        return False
    return True


def _load(letters: str) -> Generator[Step, Answer | None, str]:
    """Add the program to the controller's memory and start it; why that cannot be, or empty."""
    (text,) = yield from ask("MG " + ",".join(f"_XQ{thread}" for thread in range(THREAD)))
    busy = [thread for thread, line in enumerate(_numbers(text)) if line >= 0]
    if busy:
        return f"a program of its own runs in thread {busy[0]}, beside which none can be loaded"
    lines = "\r".join(["DL #", *program(letters), "\\"])
    answer = yield Exchange(lines, answers=2)  # nothing before the end, then a colon for each of DL and backslash
    if answer is None or any(answer.refused):
        yield Quiet()
        return "it refuses to take the program"
    return "" if (yield from _run(letters)) else "the program that was loaded does not start"


def _numbers(text: str) -> list[float]:
    """One number or more.

    Raises:
        SilentError: something else stands there: no whole answer.
    """
    try:
        found = numbers(text)
    except ValueError:
        found = []
    if not found:
        raise SilentError
    return found


def _label(letters: str) -> str:
    return f"#GHA{axis_mask(letters):02X}"
