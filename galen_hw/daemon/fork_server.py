"""Starts processes that have everything loaded: one process has imported the program once, and forks the others.

An interpreter that loads the program anew costs half a second of a core and more, which the daemon would pay for each of its
processes, at the start and whenever one dies. The fork server is forked itself, before there are threads or sockets, does
nothing but fork, and ends with the process that made it. Without it (it was killed) processes are started the long way.
"""

import importlib
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NoReturn, Self

import msgspec

from galen_hw.drivers.virtual.start import Process
from galen_hw.errors import EXIT_INTERNAL
from galen_hw.waiting import readable

ANSWERS_WITHIN_S: Final = 20.0
"""A fork takes milliseconds, and seconds where the machine is far too busy."""
STATUS_WITHIN_S: Final = 0.5
"""From the end of a process to its status; later, the fork server itself is gone."""
UNKNOWN_STATUS: Final = 255
_LOOK_S: Final = 0.1
_LARGEST: Final = 65536
_MOST_FDS: Final = 16
_ALL: Final = 2**31 - 1
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
log = logging.getLogger("galen-hw")


class _Order(msgspec.Struct):
    """What to start: a module's `main` with its words, and the numbers that its descriptors are to have."""

    module: str
    words: tuple[str, ...]
    numbers: tuple[int, ...]
    session: bool


class _Report(msgspec.Struct):
    """A process was started (no status yet, its pidfd with the report), or has ended."""

    pid: int
    status: int | None = None


class ForkServer:
    """The end of the process that wants others started; a context manager, whose exit ends the server but no process.

    To be made while the process has one thread and no socket that others must not have.
    """

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if not self.pid:
            ours.close()
            _serve(theirs)
        theirs.close()
        self._socket, self._statuses = ours, dict[int, int]()
        self._alive = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._give_up()

    def start(
        self, module: str, words: Sequence[str], fds: Mapping[int, int] | None = None, *, session: bool = False
    ) -> Process:
        """Start a process; without a server, an interpreter of its own.

        Args:
            module: whose `main` it runs; words: its command line, the first of which names it.
            fds: number there: descriptor here; those not named: 0, 1 and 2 are the same as here, nothing else is open.
            session: in a session of its own.
        """
        order = _Order(module, tuple(words), tuple(fds or {}), session)
        if self._alive and (child := self._forked(order, tuple((fds or {}).values()))) is not None:
            return child
        return _executed(order, fds or {})

    def _forked(self, order: _Order, fds: Sequence[int]) -> "Forked | None":
        try:
            socket.send_fds(self._socket, [msgspec.json.encode(order)], fds)
            until = time.monotonic() + ANSWERS_WITHIN_S
            while time.monotonic() < until and not _is_stopped(self.pid):
                if readable([self._socket.fileno()], _LOOK_S) and (started := self._take()) is not None:
                    return Forked(started[0], started[1], self)
        except OSError:
            pass
        log.warning("the fork server is gone: processes are started the long way, which takes seconds")
        self._give_up()
        return None

    def _take(self) -> tuple[int, int] | None:
        """Take one report; pid and pidfd where it tells of a start.

        Raises:
            OSError: the server is gone.
        """
        content, fds, _, _ = socket.recv_fds(self._socket, _LARGEST, 1, socket.MSG_DONTWAIT)
        if not content:
            raise ConnectionResetError
        report = msgspec.json.decode(content, type=_Report)
        if report.status is None:
            return report.pid, fds[0]
        self._statuses[report.pid] = report.status
        return None

    def status_of(self, pid: int) -> int | None:
        """The status with which a process has ended, once the server has said so."""
        with suppress(OSError):
            while self._alive and readable([self._socket.fileno()], 0.0):
                self._take()
        return self._statuses.pop(pid, None)

    def _give_up(self) -> None:
        """End a server that is no longer wanted, or does not answer: it must not start something later."""
        if self._alive:
            self._alive = False
            self._socket.close()
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)


class Forked:
    """A process that the server has forked; see `Process`. Not a child of this process, hence held by its pidfd."""

    def __init__(self, pid: int, pidfd: int, server: ForkServer) -> None:
        self.pid, self.returncode = pid, None
        self._pidfd, self._server = pidfd, server
        self._ended_at: float | None = None

    returncode: int | None

    def poll(self) -> int | None:
        """See `Process.poll`."""
        if self.returncode is None and readable([self._pidfd], 0.0):
            now = time.monotonic()
            self._ended_at = now if self._ended_at is None else self._ended_at
            status = self._server.status_of(self.pid)
            if status is None and now - self._ended_at > STATUS_WITHIN_S:
                status = UNKNOWN_STATUS
            if status is not None:
                self.returncode = status
                os.close(self._pidfd)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """See `Process.wait`."""
        until = None if timeout is None else time.monotonic() + timeout
        while (status := self.poll()) is None:
            left = 1.0 if until is None else until - time.monotonic()
            if left <= 0.0:
                raise subprocess.TimeoutExpired("process", timeout or 0.0)
            if self._ended_at is None:
                readable([self._pidfd], left)
            else:
                time.sleep(0.001)  # it has ended, and its status is on the way
        return status

    def terminate(self) -> None:
        """See `Process.terminate`."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """See `Process.kill`."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.returncode is None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, number)


def _is_stopped(pid: int) -> bool:
    """Return whether somebody has stopped a process (SIGSTOP): it will not answer."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] in {"T", "t"}
    return False


def _executed(order: _Order, fds: Mapping[int, int]) -> "subprocess.Popen[bytes]":
    """The long way: `subprocess` gives standard streams any descriptor, others under their own number only."""
    streams: dict[str, Any] = {name: fds.get(number) for number, name in enumerate(("stdin", "stdout", "stderr"))}
    others = {number: fd for number, fd in fds.items() if number > 2}
    assert all(number == fd for number, fd in others.items())
    command = [sys.executable, "-m", order.module, *order.words]
    child: subprocess.Popen[bytes] = subprocess.Popen(
        command, pass_fds=tuple(others), start_new_session=order.session, **streams
    )
    return child


def _serve(ours: socket.socket) -> NoReturn:
    """Fork as told, until the other end is gone; signals to the whole group are for others to judge."""
    _name("fork")
    before = {number: signal.signal(number, signal.SIG_IGN) for number in _SIGNALS}
    wake, woken = socket.socketpair()
    woken.setblocking(False)
    signal.set_wakeup_fd(woken.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready = select.select([ours, wake], (), ())[0]
        if wake in ready:
            wake.recv(4096)
            _report_ended(ours)
        if ours in ready:
            content, fds, _, _ = socket.recv_fds(ours, _LARGEST, _MOST_FDS)
            if not content:
                os._exit(0)
            order = msgspec.json.decode(content, type=_Order)
            if not (pid := os.fork()):
                _become(order, fds, before)
            pidfd = os.pidfd_open(pid)
            socket.send_fds(ours, [msgspec.json.encode(_Report(pid))], [pidfd])
            for fd in (pidfd, *fds):
                os.close(fd)


def _report_ended(ours: socket.socket) -> None:
    with suppress(ChildProcessError, BrokenPipeError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            ours.send(msgspec.json.encode(_Report(ended[0], os.waitstatus_to_exitcode(ended[1]))))


def _become(order: _Order, fds: Sequence[int], before: Mapping[signal.Signals, object]) -> NoReturn:
    """Be the process of an order, to its end."""
    status = EXIT_INTERNAL
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        if order.session:
            os.setsid()
        _arrange(dict(zip(order.numbers, fds, strict=True)))
        sys.argv = [order.module, *order.words]
        _name(order.words[0])
        status = int(importlib.import_module(order.module).main())
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException:  # noqa: BLE001 - as the interpreter does at its end
        traceback.print_exc()
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _arrange(fds: Mapping[int, int]) -> None:
    """Give descriptors their numbers, by way of numbers that nothing uses, and close what is not ours."""
    top = max([2, *fds, *fds.values()]) + 1
    aside = {number: os.dup2(fd, top + i) for i, (number, fd) in enumerate(fds.items())}
    for number, fd in aside.items():
        os.dup2(fd, number)
    kept = sorted({0, 1, 2, *fds})
    for low, high in zip(kept, [*kept[1:], _ALL], strict=True):
        os.closerange(low + 1, high)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115 - what the parent's has read ahead is not ours


def _name(word: str) -> None:
    """What `ps` and `top` show; the command line stays that of the process from which all were forked."""
    with suppress(OSError):
        Path("/proc/self/comm").write_text(f"galen-{word}", encoding="utf-8")
