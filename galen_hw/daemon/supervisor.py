"""The supervisor: starts the processes, answers commands, feeds the watchdog, starts again what dies, ends cleanly."""

import contextlib
import logging
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import msgspec

from galen_hw.clock import TimeBase
from galen_hw.config.load import Setup, Tables
from galen_hw.config.paths import Addresses
from galen_hw.daemon.broker import Broker
from galen_hw.daemon.fork_server import ForkServer
from galen_hw.daemon.layout import CORE, LOOKERS, MOTORS, Share, lay_out
from galen_hw.daemon.links import Beat, DeviceState
from galen_hw.daemon.lock import lock
from galen_hw.daemon.notify import Notifier
from galen_hw.daemon.orders import Orders
from galen_hw.daemon.port import Waker
from galen_hw.daemon.pulse import LOOP, PulseBoard
from galen_hw.daemon.readiness import Readiness, waits_for
from galen_hw.daemon.viewers import Viewers
from galen_hw.drivers.virtual.start import Process
from galen_hw.errors import EXIT_FOUND, EXIT_HARDWARE, EXIT_OK, EXIT_USAGE, HardwareError
from galen_hw.messages import TOPICS
from galen_hw.version import VERSION
from galen_hw.waiting import readable

WORKER: Final = "galen_hw.daemon.worker"
SIMULATED: Final = "galen_hw.daemon.simulated"
TURN_S: Final = 0.05
REST_WITHIN_S: Final = 6.0
SILENT_AFTER_S: Final = 8.0
STILL_AFTER_S: Final = 3.0
"""As `SILENT_AFTER_S`, for the loops that the arm hangs on."""
NOTICED_MARGIN_S: Final = 0.15
"""Beyond the time within which its watchers notice a death: a few of their turns."""
STALE_S: Final = 0.5
"""A loop that has not turned for so long is said to stand still."""
DEATHS_ALLOWED: Final = 5
WITHIN_S: Final = 60.0
log = logging.getLogger("galen-hw")


@dataclass
class _Process:
    """One process of the tree and its history."""

    share: Share
    child: Process | None = None
    lifeline: IO[bytes] | None = None
    started: float = 0.0
    start_at: float = 0.0
    deaths: "deque[float]" = field(default_factory=deque)
    still: bool = False


class Supervisor:
    """Runs a set-up until it is told to stop.

    Args:
        setup: checked settings; tables: what they may name.
        addresses: of this daemon, in a runtime directory that exists.
        state_dir: where services keep what they have learnt.
        fork_server: starts the processes.
        on_ready: called once, when samples flow, with a summary and the viewers' address (empty for none).
        parent_pid: end with that process.

    Raises:
        UsageError: another daemon runs in this runtime directory. HardwareError: the parent has ended already.
    """

    def __init__(
        self,
        setup: Setup,
        tables: Tables,
        addresses: Addresses,
        state_dir: Path,
        fork_server: ForkServer,
        on_ready: Callable[[str, str], None] = lambda *_: None,
        parent_pid: int | None = None,
    ) -> None:
        self._parent = _watch(parent_pid)
        self._setup, self._tables, self._addresses, self._state_dir = setup, tables, addresses, state_dir
        self._lock = lock(addresses)
        self._fork_server = fork_server
        self._on_ready = on_ready
        self._time_base = TimeBase.now()
        self._processes = {name: _Process(share) for name, share in lay_out(setup).items()}
        self._pulse_fd = PulseBoard.make()
        self._board = PulseBoard(self._pulse_fd, tuple(self._processes))
        owners = {t: n for n, p in self._processes.items() for t in (*p.share.devices, *p.share.services)}
        section = setup.config.daemon
        self._broker = Broker(addresses, owners, self._processes, section.command_timeout_s, self._info)
        bus = setup.config.bus
        self._viewers = Viewers(bus.viewers, addresses, bus.queue_messages, bus.keys)
        self._notifier = Notifier()
        self._waker = Waker()
        self._stopping = False
        self._is_ready = False
        self._waiting = ""
        optional = {name: device.optional for name, device in setup.devices.items()}
        self._readiness = Readiness(optional, section.start_timeout_s, section.optional_wait_s, time.monotonic())

    def stop(self) -> None:
        """End soon; from a signal handler."""
        self._stopping = True
        self._waker.wake()

    def run(self) -> int:
        """Start the tree and watch over it; the exit status when it has ended, with nothing left running."""
        status = EXIT_OK
        try:
            for name in self._processes:
                self._start(name)
            while not self._stopping and status == EXIT_OK:
                self._wait()
                self._broker.step()
                status = self._look_after() or self._look_at_readiness()
                self._tell()
        finally:
            self._notifier.stopping()
            self._end()
        return status

    def _start(self, name: str) -> None:
        process = self._processes[name]
        orders = Orders(
            name=name,
            devices=process.share.devices,
            services=process.share.services,
            document=self._setup.config.model_dump(mode="json", exclude_unset=True),
            path=str(self._setup.path),
            drivers=dict(self._tables.drivers),
            transports=dict(self._tables.transports),
            services_table=dict(self._tables.services),
            runtime=str(self._addresses.runtime),
            state_dir=str(self._state_dir),
            virtual=self._setup.virtual,
            wall_minus_monotonic_ns=self._time_base.wall_minus_monotonic_ns,
            processes=tuple(self._processes),
            pulse_fd=self._pulse_fd,
            speed=self._setup.speed,
        )
        self._board.forget(name)
        reading, writing = os.pipe()
        process.lifeline = os.fdopen(writing, "wb")
        process.child = self._fork_server.start(
            WORKER if self._setup.speed == 1.0 else SIMULATED, [name], {0: reading, self._pulse_fd: self._pulse_fd}
        )
        os.close(reading)
        process.started, process.start_at = time.monotonic(), 0.0
        self._broker.heard_ns[name] = time.monotonic_ns()
        _give(process.lifeline, msgspec.json.encode(orders) + b"\n")

    def _wait(self) -> None:
        fds = [self._waker.fd, *(s.FD for s in self._broker.sockets), *([self._parent] if self._parent else [])]
        pending = any(int(s.EVENTS) & 1 for s in self._broker.sockets)
        ready = readable(fds, 0.0 if pending else TURN_S)
        if self._waker.fd in ready:
            self._waker.clear()
        if self._parent in ready:
            self._stopping = True

    def _look_after(self) -> int:
        """Start again what has died or gone silent; an exit status when it is hopeless."""
        now = time.monotonic()
        self._viewers.step(now)
        for name, process in self._processes.items():
            if process.child is None:
                if now >= process.start_at:
                    self._start(name)
                continue
            still_s = self._look_at_loop(name, process)
            silent_s = max(still_s, now - self._broker.heard_ns[name] / 1e9)
            limit_s = STILL_AFTER_S if self._moves_the_arm(name) else SILENT_AFTER_S
            if process.child.poll() is None and silent_s > limit_s and name in self._broker.beats:
                log.error("%s: silent for %.0f s; it is ended and started again", name, silent_s)
                process.child.kill()
                process.child.wait()
            if (code := process.child.poll()) is not None and (status := self._bury(name, process, code, now)):
                return status
        return EXIT_OK

    def _moves_the_arm(self, name: str) -> bool:
        """Return whether the arm hangs on this process: it moves it, or feels what it does."""
        return name == CORE or MOTORS in self._processes[name].share.devices

    def _look_at_loop(self, name: str, process: _Process) -> float:
        """Seconds since the loop of a process has turned, 0 before it did; said once where it stands still."""
        seen_ns = self._board.seen_ns(name, LOOP)
        still_s = (time.monotonic_ns() - seen_ns) / 1e9 if seen_ns else 0.0
        if process.still != (still := still_s > STALE_S):
            process.still = still
            if still:
                log.error("%s: has not run for %.1f s", name, still_s)
        return still_s

    def _bury(self, name: str, process: _Process, code: int, now: float) -> int:
        _end_lifeline(process)
        process.child = None
        self._broker.lost(name)
        process.deaths.append(now)
        while process.deaths and process.deaths[0] < now - WITHIN_S:
            process.deaths.popleft()
        is_world = self._setup.speed != 1.0  # the virtual robot has died with it
        if name not in LOOKERS and (is_world or not self._is_ready or len(process.deaths) > DEATHS_ALLOWED):
            # What dies before the first sample would only die again; a status of our own means that it has said why.
            if code not in (EXIT_USAGE, EXIT_HARDWARE):
                log.error("%s: ended with status %d; giving up", name, code)
            return code if code > 0 else EXIT_FOUND
        wait_s = max(0.25 * 2 ** (len(process.deaths) - 1), self._noticed_s(name))
        log.error("%s: ended with status %d; started again in %.2g s", name, code, wait_s)
        process.start_at = now + wait_s
        if MOTORS not in process.share.devices and name not in LOOKERS:
            self._broker.command(MOTORS, "stop")
        return EXIT_OK

    def _noticed_s(self, name: str) -> float:
        """Seconds until the death of a process has surely stopped the arm for good: no motion is to outlive what watched it.

        Forked, a process is back sooner than its silence is noticed: the motors' process would not know that nobody has felt
        what the arm did, and the controller not that nobody has led it.
        """
        motors = self._setup.devices.get(MOTORS)
        of_controller = 0.0 if motors is None else float(getattr(motors.settings, "watchdog_s", 0.0))
        limit_s = self._setup.config.daemon.blind_after_s if name == CORE else 0.0
        if MOTORS in self._processes[name].share.devices:
            limit_s = max(limit_s, of_controller)
        return limit_s + NOTICED_MARGIN_S if limit_s else 0.0

    def _look_at_readiness(self) -> int:
        """READY once all that is required answers and samples flow; an exit status when that cannot be."""
        if self._is_ready:
            return EXIT_OK
        missing = [name for name in self._processes if name not in self._broker.beats and name not in LOOKERS]
        verdict = self._readiness.judge(
            time.monotonic(), self._device_states(), all_up=not missing, flows=self._flows()
        )
        if verdict.refused:
            return self._refuse(verdict.devices, missing)
        if verdict.ready:
            self._is_ready = True
            self._notifier.ready()
            self._on_ready(self._summary(), self._viewers.address)
        else:
            self._say_waiting(missing)
        return EXIT_OK

    def _say_waiting(self, missing: Sequence[str]) -> None:
        """One line each time that what the start waits for has changed."""
        silent = {
            n: DeviceState(wire="closed", ready=False, optional=d.optional) for n, d in self._setup.devices.items()
        }
        waiting = waits_for(silent | self._device_states(), missing, flows=self._flows())
        if waiting and waiting != self._waiting:
            log.info("waiting for %s", waiting)
        self._waiting = waiting

    def _flows(self) -> bool:
        if not self._processes[CORE].share.devices:
            return CORE in self._broker.beats
        return self._broker.beats.get(CORE, Beat()).progress > 0

    def _refuse(self, states: Mapping[str, DeviceState], missing: Sequence[str]) -> int:
        for name, state in states.items():
            what, where, todo = state.problem or ("does not answer", "", "is it switched on, and the right device?")
            place = where if name in where else f"devices.{name}{f' ({where})' if where else ''}"
            print(f"galen-hw run: {place}: {what}{f'; {todo}' if todo else ''}", file=sys.stderr)
        if not states:
            for name in missing:
                print(f"galen-hw run: process {name}: has not started; is the machine overloaded?", file=sys.stderr)
            if not missing:
                print("galen-hw run: no samples flow; see galen-hw check", file=sys.stderr)
        return EXIT_HARDWARE

    def _device_states(self) -> dict[str, DeviceState]:
        """The known ones, in the order of the settings."""
        known = {n: s for b in self._broker.beats.values() for n, s in b.devices.items()}
        return {n: known[n] for n in self._setup.devices if n in known}

    def _tell(self) -> None:
        signs = {n: self._board.seen_ns(n, LOOP) for n in self._processes if self._moves_the_arm(n)}
        self._notifier.progress(signs | {"samples": self._broker.beats.get(CORE, Beat()).progress})
        self._notifier.status(self._summary())

    def _summary(self) -> str:
        still = [n for n, p in self._processes.items() if p.still]
        devices = {d for n in still for d in self._processes[n].share.devices}
        words = [f"{n} {'silent' if n in devices else _word(s)}" for n, s in self._device_states().items()]
        words += [f"process {n} does not run" for n in still]
        restarts = sum(len(p.deaths) for p in self._processes.values())
        return ", ".join([*words, *([f"{restarts} restarts"] if restarts else [])]) or "starting"

    def _info(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "config": str(self._setup.path),
            "robot": self._setup.config.robot.name,
            "virtual": self._setup.virtual,
            "speed": self._setup.speed,
            "ready": self._is_ready,
            "bus": self._addresses.bus,
            "viewers": self._viewers.address,
            "state_dir": str(self._state_dir),
            "processes": {n: p.child.pid if p.child else 0 for n, p in self._processes.items()}
            | ({"viewers": self._viewers.pid} if self._viewers.address else {}),
            "unreadable_frames": self._broker.unreadable,
            "devices": {n: msgspec.to_builtins(s) for n, s in self._device_states().items()},
            "units": {n: d.settings.units for n, d in self._setup.devices.items() if hasattr(d.settings, "units")},
            "services": list(self._setup.services),
            "topics": list(TOPICS),
        }

    def _end(self) -> None:
        """The motors' process first, so that the robot is at rest; then the others; what does not end is killed."""
        order = sorted(self._processes, key=lambda n: (MOTORS not in self._processes[n].share.devices, n == CORE))
        first = [n for n in order if MOTORS in self._processes[n].share.devices]
        for group in (first, [n for n in order if n not in first]):
            running = [(p, p.child) for n in group if (p := self._processes[n]).child is not None]
            for process, _ in running:
                _end_lifeline(process)
            until = time.monotonic() + REST_WITHIN_S
            for child in [c for _, c in running if c is not None]:
                try:
                    child.wait(max(0.1, until - time.monotonic()))
                except subprocess.TimeoutExpired:
                    child.kill()
                    child.wait()
        self._viewers.close()
        self._broker.close()
        self._board.close()
        os.close(self._pulse_fd)
        self._waker.close()
        if self._parent:
            os.close(self._parent)
        # ZeroMQ leaves them when a process ends fast; a client would take them for a daemon that does not answer.
        self._addresses.remove_sockets()
        os.close(self._lock)


def install_signals(supervisor: Supervisor) -> None:
    """SIGTERM, SIGHUP (a terminal that is closed; not with nohup) and Ctrl-C end the daemon cleanly."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: supervisor.stop())


def _word(state: DeviceState) -> str:
    """How a device is doing, for one line of all."""
    if state.held:
        return f"held at rest ({state.held})"
    return "ready" if state.ready else state.wire if state.wire != "open" else "silent"


def _watch(pid: int | None) -> int | None:
    """A descriptor that is readable once that process has ended; None without one.

    Raises:
        HardwareError: it has ended already.
    """
    if pid is None:
        return None
    try:
        return os.pidfd_open(pid)
    except OSError as error:
        raise HardwareError(f"no process {pid} ({error.strerror})", where="--parent-pid") from None


def _give(pipe: IO[bytes], content: bytes) -> None:
    try:
        pipe.write(content)
        pipe.flush()
    except BrokenPipeError:
        return  # it died at once; `_bury` will see it


def _end_lifeline(process: _Process) -> None:
    """The process notices, brings its devices to rest and ends; so it does when we are gone ourselves."""
    if process.lifeline is not None:
        with contextlib.suppress(BrokenPipeError):
            process.lifeline.close()
        process.lifeline = None
