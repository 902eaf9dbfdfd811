"""A daemon of one's own for the time of a command: what `--virtual` means for commands that need a running daemon."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

from galen_hw.config.paths import Addresses
from galen_hw.errors import GalenError, HardwareError
from galen_hw.waiting import readable

READY_WITHIN_S: Final = 150.0
END_WITHIN_S: Final = 20.0


@contextmanager
def own_daemon(
    *,
    config: str | None = None,
    virtual: bool = True,
    runtime: Path | None = None,
    state: Path | None = None,
    speed: float = 1.0,
) -> Iterator[Addresses]:
    """Start `galen-hw run` in a runtime directory of its own, wait until samples flow, end it with the block.

    SIGTERM and SIGHUP end the block as Ctrl-C does, and the daemon ends by itself when this process is gone.

    Args:
        config: settings file; virtual: on a virtual robot.
        runtime: for the sockets; a temporary directory if None.
        state: for tools and calibrations; the user's own if None.
        speed: of a virtual robot: at most so many times as fast as the clock.

    Raises:
        HardwareError: it did not become ready; its own lines on stderr say why.
    """
    with _ended_by_signals(), tempfile.TemporaryDirectory(prefix="galen-hw-") as folder:
        where = runtime or Path(folder)
        words = [
            "run",
            "--dir",
            str(where),
            "--parent-pid",
            str(os.getpid()),
            *(["--virtual"] if virtual else []),
            *(["--config", config] if config else []),
            *(["--speed", f"{speed:g}"] if speed != 1.0 else []),
        ]
        environ = os.environ | ({"GALEN_HW_STATE": str(state)} if state else {})
        command = [sys.executable, "-m", "galen_hw.cli", *words]
        # In a session of its own, so that Ctrl-C reaches the command only, which then ends the daemon in order.
        process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environ, start_new_session=True)
        try:
            _wait_ready(process)
            yield Addresses(where)
        finally:
            _ignore_signals()
            process.terminate()
            try:
                process.wait(timeout=END_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdout is not None
            process.stdout.close()


def _ending_signals() -> list[signal.Signals]:
    """Those that end a command from outside; one that is ignored (nohup) stays so, other threads have no say."""
    if threading.current_thread() is not threading.main_thread():
        return []
    return [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) != signal.SIG_IGN]


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP are a Ctrl-C within the block: whatever it has begun ends in order."""
    before = {number: signal.signal(number, _interrupt) for number in _ending_signals()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _ignore_signals() -> None:
    """A second signal must not cut short what the first has begun."""
    for number in _ending_signals():
        signal.signal(number, signal.SIG_IGN)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    del number, frame
    raise KeyboardInterrupt


def _wait_ready(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdout is not None
    until = time.monotonic() + READY_WITHIN_S
    while (left := until - time.monotonic()) > 0:
        if readable([process.stdout.fileno()], left):
            line = process.stdout.readline()
            if line.startswith(b"ready"):
                return
            if not line:
                process.wait(timeout=END_WITHIN_S)
                raise DaemonEndedError(process.returncode)
    raise HardwareError(f"the daemon is not ready within {READY_WITHIN_S:g} s", where="galen-hw run")


class DaemonEndedError(GalenError):
    """The daemon has ended with this status instead of becoming ready; it has said why on stderr."""

    def __init__(self, status: int) -> None:
        super().__init__("the daemon did not start", where="galen-hw run", todo="see its lines above")
        self.exit_code = status
