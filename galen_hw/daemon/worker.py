"""One process of the daemon: builds its share of devices and services and runs their loop until it is told to stop."""

import logging
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.config.load import DeviceSetup, Setup
from galen_hw.config.paths import Addresses
from galen_hw.config.schema import DaemonSection
from galen_hw.daemon import logs
from galen_hw.daemon.guard import Guard
from galen_hw.daemon.host import Host
from galen_hw.daemon.keep import DeviceKeeper, Keeper
from galen_hw.daemon.layout import CORE, MOTORS, PRIORITY_BELOW_CORE, SENSOR
from galen_hw.daemon.links import REPLY, REQUEST, Beat, CoreLink, DeviceState, EdgeLink, Origin
from galen_hw.daemon.measures import Measures
from galen_hw.daemon.orders import Orders, build_port, build_services
from galen_hw.daemon.port import Port, Waker
from galen_hw.daemon.pulse import LOOP, WRENCH, PulseBoard
from galen_hw.daemon.realtime import GarbageKeeper, raise_priority, share_one_core, sharpen_timers
from galen_hw.decoding import LARGEST_MESSAGE, UnreadableError, decode_message, decode_reply, decode_request
from galen_hw.errors import EXIT_OK, GalenError
from galen_hw.messages import STREAMS, CommandError, Status
from galen_hw.waiting import readable

BEAT_NS: Final = NS_PER_S // 10
STATUS_NS: Final = NS_PER_S
KEEP_EACH: Final = 20
"""Statuses between two times that what devices know is written down."""
REST_WITHIN_S: Final = 2.0
MOST_DESCRIPTORS: Final = 1024
MAIN_TOPICS: Final = ("wrench/compensated", "wrench/raw")
CATCH_UP: Final = 1024
"""Messages looked through in one turn by a process that has fallen behind; about ten milliseconds."""
log = logging.getLogger("galen-hw")


class Worker:
    """The loop of one process.

    Args:
        orders: what to run and where.
        lifeline: a descriptor that ends (reads as empty) when the supervisor is gone.
        now: monotonic nanoseconds.
    """

    def __init__(self, orders: Orders, lifeline: int, now: Callable[[], int] = time.monotonic_ns) -> None:
        self._orders, self._lifeline, self._now = orders, lifeline, now
        whole = orders.whole()
        self._setup = orders.share_of(whole)
        self._time_base = TimeBase(orders.wall_minus_monotonic_ns)
        self._waker = Waker()
        self._stopping = False
        self._keeper = Keeper(Path(orders.state_dir) / "services")
        services = build_services(self._setup, whole, self._time_base, Path(orders.state_dir), self._keeper)
        ports = {n: self._make_port(d, self._time_base, self._waker) for n, d in self._setup.devices.items()}
        self._device_keeper = DeviceKeeper(Path(orders.state_dir) / "devices", virtual=orders.virtual)
        for name, port in ports.items():
            self._device_keeper.give_back(name, port.device)
        addresses = Addresses(Path(orders.runtime))
        origin = Origin(self._setup.config.robot.name, orders.virtual)
        self._link: CoreLink | EdgeLink = (
            CoreLink(orders.name, addresses, origin, self._setup.config.bus.queue_messages)
            if orders.name == CORE
            else EdgeLink(orders.name, addresses, origin)
        )
        self._board = PulseBoard(orders.pulse_fd, orders.processes)
        self._guard = self._make_guard(whole) if MOTORS in ports else None
        self.host = Host(
            orders.name,
            ports,
            services,
            self._link,
            clock=now,
            on_done=self._keep,
            forbids=lambda: self._guard.missing if self._guard else "",
        )
        self._link.adapt(self.host.wants)
        self._consumed = {topic.encode() for topic in self.host.consumed}
        self._unreadable = 0
        self._ports = list(ports.values())
        self._own_fds = [lifeline, self._waker.fd, self._link.control.fd]
        patience_s = min((s.patience_s for s in services.values() if s.consumes), default=0.0)
        self._patience_ns = 0 if orders.name == CORE else round(patience_s * NS_PER_S)
        self._next_inlet_ns = 0
        if not self._patience_ns:
            self._own_fds.append(self._link.inlet.fd)
        self._next_beat_ns = self._next_status_ns = self._next_due_ns = 0
        self._status_seq = self._turns = self._wrenches = self._joints = 0
        self._may_jump = orders.name != CORE and not any(s.takes_old for s in services.values())
        self._passed_over = self._old_before = 0
        self._held: dict[str, str] = {}
        self._others = {name: 0 for name in orders.processes if orders.name == CORE and name != CORE}
        self._garbage = GarbageKeeper(self._setup.config.daemon.garbage_interval_s)
        self._measures = Measures(Path(orders.state_dir) if orders.name == CORE else None)

    def run(self) -> None:
        """Run until the lifeline ends; on every way out the devices are brought to rest first."""
        self._link.begun_ns = self._now()
        try:
            while not self._stopping:
                self._turn()
        finally:
            self._finish()

    def _turn(self) -> None:
        """Wait for a wire, a socket or a time, and do what is due."""
        self._turns += 1
        due_ns = self._next_due_ns if not self._patience_ns else min(self._next_due_ns, self._next_inlet_ns)
        for port in self._ports:
            due_ns = min(due_ns, port.wakeup_ns)
        ready = self._wait(due_ns)
        host, wires = self.host, 0
        for port in self._ports:
            if port.fd in ready:
                wires += 1
                if outputs := port.receive():
                    host.take(outputs)
            if outputs := port.tend():
                host.take(outputs)
        if self._patience_ns and (now := self._now()) >= self._next_inlet_ns:
            self._next_inlet_ns = now + self._patience_ns
            ready.append(self._link.inlet.fd)
        if len(ready) > wires or self._link.is_pending:
            self._attend(ready)
        now = self._now()
        self._pulse(now)
        if now >= self._next_due_ns:
            host.tick(now)
            self._link.adapt(host.wants)
            self._report(now)
            self._garbage.collect(now)
            self._next_due_ns = min(host.wakeup_ns, self._next_beat_ns)

    def _attend(self, ready: list[int]) -> None:
        """Look at what is no wire: messages and requests of other processes, the lifeline. Most turns have none of it."""
        if heard := self._link.messages(ready):
            self._hear_all(heard)
        self._listen(ready)
        if self._lifeline in ready or self._waker.fd in ready:
            self._look_at_lifeline(ready)

    def _make_guard(self, whole: Setup) -> Guard:
        signs = {f"no sign of life from the process {CORE}": lambda: self._board.seen_ns(CORE, LOOP)}
        optional = set()
        if SENSOR in whole.devices:
            signs[what := "no wrench"] = lambda: self._board.seen_ns(CORE, WRENCH)
            optional = {what} if whole.devices[SENSOR].optional else set()
        return Guard(signs, self._setup.config.daemon.blind_after_s, optional)

    def _pulse(self, now: int) -> None:
        """Give signs of life; where the motors are, look for those of the others, and stop when blind."""
        alive_ns = time.monotonic_ns()  # the machine's clock, which the supervisor has too
        self._board.beat(self._orders.name, LOOP, alive_ns)
        published = self.host.published
        wrenches, joints = published.get("wrench/raw", 0), published.get("joints/state", 0)
        if wrenches != self._wrenches:
            self._wrenches = wrenches
            self._board.beat(self._orders.name, WRENCH, alive_ns)
        if self._guard is None or joints == self._joints:
            return
        self._joints = joints
        self._guard.heard(now)
        device = self.host.ports[MOTORS].device
        if (why := self._guard.blind) and device.live and not device.held:
            self.host.take(device.trip(f"stopped, for nobody feels what the arm does: {why}", now))

    def _wait(self, until_ns: int) -> list[int]:
        fds = [*self._own_fds, *[p.fd for p in self._ports if p.fd is not None]]
        if self._link.is_pending:
            return readable(fds, 0.0)
        timeout = (until_ns - self._now()) / NS_PER_S
        return readable(fds, max(0.0, timeout))

    def _wait_for_wires(self, seconds: float) -> list[int]:
        return readable([fd for p in self._ports if (fd := p.fd) is not None], seconds)

    def _make_port(self, device: DeviceSetup, time_base: TimeBase, waker: Waker) -> Port:
        return build_port(device, time_base, waker)

    def _hear_all(self, heard: Sequence[tuple[bytes, bytes]]) -> None:
        """Hand messages on in their order; a process that has fallen behind goes on with the newest of each topic.

        Else it would work for ever on what is just about too old, while what is new waits behind it. `core` never
        jumps: it has passed everything on already, and what it has to do for a message is little.
        """
        left = list(heard)
        while left:
            if not self._hear(*left.pop(0)) and self._may_jump:
                break
        while left and self._link.inlet.pending and len(left) < CATCH_UP:
            left += self._link.messages(())
        newest = {topic: n for n, (topic, _) in enumerate(left)}
        kept = [w for n, w in enumerate(left) if newest[w[0]] == n or w[0].decode(errors="replace") not in STREAMS]
        self._passed_over += len(left) - len(kept)
        for topic, payload in kept:
            self._hear(topic, payload)

    def _hear(self, topic: bytes, payload: bytes) -> bool:
        """Hand a message on; false when it was too old for that."""
        if topic not in self._consumed:
            return True
        try:
            name, message = decode_message(topic, payload)
        except UnreadableError:
            self._unreadable += 1
            return True
        if message.t_ns < self._link.begun_ns and name in STREAMS:
            self._link.backlog += 1
            return True
        return self.host.from_bus(name, message)

    def _listen(self, ready: list[int]) -> None:
        for frames in self._link.control.take(ready):
            kind, payload = frames[0], frames[-1]
            try:
                if kind == REPLY:
                    self.host.reply_from_outside(decode_reply(payload))
                elif kind == REQUEST and not isinstance(
                    request := decode_request(payload, LARGEST_MESSAGE), CommandError
                ):
                    self.host.from_outside(request)
                    self._link.adapt(self.host.wants)  # at once: a command may wait for what it now wants
                else:
                    self._unreadable += 1
            except UnreadableError:
                self._unreadable += 1

    def _look_at_lifeline(self, ready: list[int]) -> None:
        if self._waker.fd in ready:
            self._waker.clear()
        if self._lifeline in ready and not os.read(self._lifeline, 4096):
            self._stopping = True

    def _report(self, now: int) -> None:
        if now < self._next_beat_ns:
            return
        self._next_beat_ns = now + BEAT_NS
        published = self.host.published
        main = next(
            (t for t in MAIN_TOPICS if any(t in s.produces for s in self.host.services.values())), MAIN_TOPICS[-1]
        )
        self._link.beat(Beat(published.get(main, 0), {n: self._device_state(n, p) for n, p in self.host.ports.items()}))
        if now >= self._next_status_ns:
            self._next_status_ns = now + STATUS_NS
            self._publish_status(now)
            if self._status_seq % KEEP_EACH == 0:
                for name in self.host.ports:
                    self._keep(name)
            self._report_others(now)

    def _device_state(self, name: str, port: Port) -> DeviceState:
        problem = None
        if port.error is not None:
            problem = (port.error.what, port.error.where, port.error.todo)
        elif not port.device.ready and (fault := self.host.faults.get(name)) is not None:
            problem = (fault.what, fault.where, fault.todo)
        ready = port.state == "open" and port.device.ready
        held = port.device.held
        if held != self._held.get(name, ""):
            self._held[name] = held
            log.warning("%s: %s", name, held or "may move again")
        return DeviceState(port.state, ready, port.optional, port.attempts, problem, held)

    def _publish_status(self, now: int) -> None:
        self._status_seq += 1
        counters = {
            "turns": self._turns,
            "dropped": self._link.dropped,
            "unreadable": self._unreadable + self._link.unreadable,
            "passed over": self._passed_over,
            "backlog": self._link.backlog,
            **_wire_counters(self.host.ports),
        }
        counters |= {f"published {topic}": n for topic, n in self.host.published.items()}
        counters |= {f"too old {topic}": n for topic, n in self.host.old.items()}
        errors = [p.error for p in self._ports if p.error is not None]
        problems, todos = [e.problem for e in errors], [e.todo for e in errors if e.todo]
        old, self._old_before = sum(self.host.old.values()) - self._old_before, sum(self.host.old.values())
        if old:
            problems.append(f"{old} message{'s' * (old > 1)} too old to be used: the computer is too slow or too busy")
            todos.append("end what else runs on this machine")
        ready = not old and all(p.state == "open" for p in self._ports)
        self._link.publish(
            "status",
            Status(
                timestamp=self._time_base.timestamp(now),
                t_ns=now,
                seq=self._status_seq,
                valid=True,
                source=f"daemon.{self._orders.name}",
                state="ready" if ready else "degraded",
                detail="; ".join(problems),
                counters=counters,
                gauges=self._measures.take(now, self.host.ages, self.host.ports),
                todo="; ".join(todos),
            ),
        )

    def _report_others(self, now: int) -> None:
        """The status of a process that does not run, in its name: it cannot say so itself."""
        for name in self._others:
            silent_ns = now - (self._board.seen_ns(name, LOOP) or now)
            if silent_ns < STATUS_NS // 2:
                continue
            self._others[name] += 1
            detail = f"the process {name} has not run for {silent_ns / NS_PER_S:.1f} s"
            status = Status(
                timestamp=self._time_base.timestamp(now),
                t_ns=now,
                seq=self._others[name],
                valid=True,
                source=f"daemon.{name}",
                state="fault",
                detail=detail,
                todo="wait, it is replaced; if it comes again, the machine is too busy",
            )
            self._link.publish("status", status)

    def _keep(self, name: str) -> None:
        if name in self.host.services:
            self._keeper.keep(name, self.host.services[name].snapshot())
        if name in self.host.ports:
            self._device_keeper.keep_device(name, self.host.ports[name].device, self.host.tool, self._now())

    def _finish(self) -> None:
        for name in self.host.ports:
            self._keep(name)  # Before the rest: afterwards a device does not know any more that it was there.
        for port in self._ports:
            port.rest()
        self.host.end()
        until = time.monotonic() + REST_WITHIN_S
        while self.host.moving and time.monotonic() < until:
            ready = self._wait_for_wires(0.02)
            for port in self._ports:
                self.host.take(port.step(readable=port.fd in ready))
        for name, service in self.host.services.items():
            service.close()
            self._keep(name)
        for port in self._ports:
            port.close()
        self._keeper.close()
        self._device_keeper.close()
        self._link.close()


def _wire_counters(ports: dict[str, Port]) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, port in ports.items():
        if port.transport is not None:
            found |= {f"{name} wire {key}": value for key, value in port.transport.counters.items()}
    return found


def run_orders(run: Callable[[Orders], None]) -> int:
    """Take orders from standard input, which then stays open as the lifeline, and carry them out; the status."""
    # python-can reads MF4 logs where asammdf is installed and loads it, pandas and scipy for that: a second, 100 MB.
    sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]
    logs.set_up()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # They may reach the whole group; the supervisor alone says who ends when, by ending the lifeline.
        signal.signal(number, signal.SIG_IGN)
    # Libraries below (pyserial, python-can) wait with `select`, which takes no descriptor from 1024 on: none may come to be.
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, MOST_DESCRIPTORS), hard))
    orders = msgspec.json.decode(_read_line(sys.stdin.fileno()), type=Orders)
    # Not in simulated time, which never waits: a loop that runs for ten seconds is ended (see `raise_priority`).
    below_core = PRIORITY_BELOW_CORE.get(orders.name) if orders.speed == 1.0 else None
    priority = int(orders.document.get("daemon", {}).get("realtime_priority", DaemonSection().realtime_priority))
    if below_core is not None:
        permitted = raise_priority(max(0, priority - below_core))
        if permitted and orders.name == CORE:
            share_one_core(priority)
    sharpen_timers()
    try:
        run(orders)
    except GalenError as error:
        print(f"galen-hw {orders.name}: {error}", file=sys.stderr)
        return error.exit_code
    return EXIT_OK


def main() -> int:
    """Entry point: see `run_orders`."""
    return run_orders(lambda orders: Worker(orders, sys.stdin.fileno()).run())


def _read_line(fd: int) -> bytes:
    """One line, byte for byte as it comes: nothing of the lifeline may stay in a buffer."""
    line = bytearray()
    while not line.endswith(b"\n"):
        if not (chunk := os.read(fd, 65536)):
            raise SystemExit(EXIT_OK)
        line += chunk
    return bytes(line)


if __name__ == "__main__":
    sys.exit(main())
