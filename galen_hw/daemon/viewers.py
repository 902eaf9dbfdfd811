"""The viewers' copy of the bus on TCP, in a process of its own.

Whoever may use this machine may connect there, without rights. So nothing that a connection can do (open hundreds, ask for
millions of topics, never read) reaches the processes that sample and move: this one has bounds of its own, costs nobody a
message when it dies, and is started again. The supervisor holds the listening socket, so that the port stays the same.
"""

import logging
import os
import resource
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zmq

from galen_hw.bus import LARGEST_SUBSCRIPTION
from galen_hw.config.paths import Addresses
from galen_hw.decoding import limit
from galen_hw.errors import EXIT_FOUND, EXIT_OK
from galen_hw.keys import CLIENTS, SERVER, secret_of
from galen_hw.messages import TOPICS

MOST_VIEWERS: Final = 32
"""Connections at a time; one more is closed at once, and gets in when there is room."""
MOST_DESCRIPTORS: Final = 128
"""Of the process: its own dozen, the viewers, and those that are being turned away."""
MOST_DATA: Final = 256 << 20
"""Bytes of memory of the process; beyond, it ends and is started again."""
LARGEST_HANDSHAKE: Final = 1024
"""Bytes of a frame where keys are demanded: ZeroMQ holds the proof of a key (about 300) to the bound of messages."""
BACKLOG: Final = 16
PATIENCE_MS: Final = 5
"""How long messages wait, several at once: nobody sees that on a screen, and it leaves the cores to the robot."""
IDLE_MS: Final = 1000
BATCH: Final = 1000
LONGEST_WAIT_S: Final = 10.0
HANDSHAKE_MS: Final = 10_000
log = logging.getLogger("galen-hw")


class Viewers:
    """The supervisor's end: holds the port, starts the process, and starts it again whenever it has ended.

    Args:
        address: "tcp://HOST:PORT" of this machine, port 0 for any free one; empty for no copy at all. A port that is taken
            is replaced by a free one, and a line says so: two robots (or a real and a virtual one) can be looked at.
        addresses: of the daemon; queue: messages kept for one slow viewer.
        keys: folder of CURVE keys (`galen_hw.keys`): who has none of them may not connect, from this machine either.

    Raises:
        UsageError: the daemon's own key cannot be used.
    """

    def __init__(self, address: str, addresses: Addresses, queue: int, keys: Path | None = None) -> None:
        if address and keys is not None:
            secret_of(keys / f"{SERVER}.key_secret")
        self._keys = "" if keys is None else str(keys)
        self._listener = listen(address) if address else None
        self.address = address_of(self._listener) if self._listener else ""
        self._addresses, self._queue = addresses, queue
        self._popen: subprocess.Popen[bytes] | None = None
        self._deaths, self._start_at = 0, 0.0

    @property
    def pid(self) -> int:
        """Of the process; 0 while there is none."""
        return self._popen.pid if self._popen else 0

    def step(self, now: float) -> None:
        """Start the process, or see that it has ended; `now` is monotonic, s."""
        if self._listener is None:
            return
        if self._popen is not None and (code := self._popen.poll()) is not None:
            self._popen = None
            wait_s = min(LONGEST_WAIT_S, 0.25 * 2**self._deaths)
            self._deaths, self._start_at = self._deaths + 1, now + wait_s
            log.warning("viewers' copy of the bus: ended with status %d; started again in %.2g s", code, wait_s)
        if self._popen is None and now >= self._start_at:
            fd = self._listener.fileno()
            words = [self._addresses.bus, str(fd), str(self._queue), self._keys]
            command = [sys.executable, "-m", "galen_hw.daemon.viewers", *words]
            self._popen = subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=(fd,))

    def close(self) -> None:
        """End the process and give the port back."""
        if self._popen is not None:
            assert self._popen.stdin is not None
            with suppress(BrokenPipeError):
                self._popen.stdin.close()
            try:
                self._popen.wait(2.0)
            except subprocess.TimeoutExpired:
                self._popen.kill()
                self._popen.wait()
            self._popen = None
        if self._listener is not None:
            self._listener.close()


def listen(address: str) -> socket.socket | None:
    """Listen at an address, or at a free port of the same host; None if that is not possible either."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    host = host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return _prompt(socket.create_server((host, int(port)), family=family, backlog=BACKLOG))
    except OSError as error:
        why = os.strerror(error.errno) if error.errno else str(error)
    try:
        free = _prompt(socket.create_server((host, 0), family=family, backlog=BACKLOG))
    except OSError:
        log.warning("no copy of the bus for viewers at %s: %s", address, why)
        return None
    log.warning("viewers: %s: %s (another daemon's?); this daemon's are at %s", address, why, address_of(free))
    return free


def _prompt(listener: socket.socket) -> socket.socket:
    """The same, whose connections send small messages at once."""
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


def address_of(listener: socket.socket) -> str:
    """What a viewer connects to."""
    host, port = listener.getsockname()[:2]
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"


class _Copy:
    """The process' own end: takes from the bus what some viewer asks for, and passes it on.

    Args:
        bus: address of the bus; fd: the listening socket; queue: messages kept for one slow viewer.
        keys: folder of CURVE keys, empty for none; most: connections at a time.
    """

    def __init__(self, bus: str, fd: int, queue: int, keys: str = "", most: int = MOST_VIEWERS) -> None:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self._most, self._connections, self._wanted = most, set[int](), set[bytes]()
        self._bus: zmq.Socket[Any] = context.socket(zmq.SUB)
        self._bus.setsockopt(zmq.RCVHWM, queue)
        self._bus.setsockopt(zmq.RECONNECT_IVL, 20)
        limit(self._bus)
        self._bus.connect(bus)
        self._viewers: zmq.Socket[Any] = context.socket(zmq.XPUB)
        self._viewers.setsockopt(zmq.SNDHWM, queue)
        self._viewers.setsockopt(zmq.LINGER, 0)
        self._viewers.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        limit(self._viewers, LARGEST_HANDSHAKE if keys else LARGEST_SUBSCRIPTION)
        if keys:
            from zmq.auth.thread import ThreadAuthenticator

            guard = ThreadAuthenticator(context)
            guard.start()
            guard.configure_curve(domain="*", location=str(Path(keys) / CLIENTS))
            self._viewers.curve_publickey, self._viewers.curve_secretkey = secret_of(
                Path(keys) / f"{SERVER}.key_secret"
            )
            self._viewers.curve_server = True
        events = int(zmq.EVENT_ACCEPTED) | int(zmq.EVENT_DISCONNECTED)
        self._monitor: zmq.Socket[Any] = self._viewers.get_monitor_socket(events)
        self._viewers.setsockopt(zmq.USE_FD, fd)
        # The descriptor listens already, so that the address is but a name. A TCP address would be looked for among the
        # network devices first, and ZeroMQ ends the process where that is not permitted (no AF_NETLINK in the unit).
        self._viewers.bind("ipc://viewers")
        self._poller = zmq.Poller()
        for one in (self._viewers, self._monitor):
            self._poller.register(one, zmq.POLLIN)

    def run(self, lifeline: int) -> None:
        """Pass on until the lifeline ends."""
        self._poller.register(lifeline, zmq.POLLIN)
        while not any(one == lifeline for one, _ in self._poller.poll(PATIENCE_MS if self._wanted else IDLE_MS)):
            self._count_connections()
            self._take_wishes()
            self._pass_on()

    def _count_connections(self) -> None:
        # Here, for the supervisor imports this module too, and with these two come asyncio and a tenth of its start.
        from zmq.utils.monitor import parse_monitor_message

        while self._monitor.poll(0):
            event = parse_monitor_message(self._monitor.recv_multipart())
            fd = int(event["value"])
            if event["event"] != zmq.EVENT_ACCEPTED:
                self._connections.discard(fd)
                continue
            self._connections.add(fd)
            if len(self._connections) > self._most:
                # Ended from below; ZeroMQ then closes it, as it would had the other end gone.
                with suppress(OSError), socket.socket(fileno=os.dup(fd)) as one:
                    one.shutdown(socket.SHUT_RDWR)

    def _take_wishes(self) -> None:
        """Ask the bus for what is asked of us; what can begin no topic is not passed on: its publisher would keep it."""
        while self._viewers.poll(0):
            wish = self._viewers.recv_multipart()[0]
            topic = wish[1:]
            if not any(name.startswith(topic.decode(errors="replace")) for name in TOPICS):
                continue
            if wish[:1] == b"\x01" and topic not in self._wanted:
                self._wanted.add(topic)
                self._bus.setsockopt(zmq.SUBSCRIBE, topic)
            elif wish[:1] == b"\x00" and topic in self._wanted:
                self._wanted.discard(topic)
                self._bus.setsockopt(zmq.UNSUBSCRIBE, topic)

    def _pass_on(self) -> None:
        for _ in range(BATCH):
            if not self._bus.poll(0):
                return
            frames = self._bus.recv_multipart()
            if len(frames) == 2:
                self._viewers.send_multipart(frames, zmq.NOBLOCK)


def main() -> int:
    """Entry point: bus address, listening descriptor and queue as arguments; standard input is the lifeline."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the supervisor alone says who ends when
    bus, fd, queue, keys = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_DESCRIPTORS, MOST_DESCRIPTORS))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_DATA, MOST_DATA))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        os.nice(5)
        # Where memory runs out all the same, this process is the one to go.
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    try:
        _Copy(bus, int(fd), int(queue), keys).run(sys.stdin.fileno())
    except MemoryError:
        return EXIT_FOUND
    zmq.Context.instance().destroy(linger=0)
    return EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
