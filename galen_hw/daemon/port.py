"""A device on its wire: opened (and re-opened with back-off) beside the loop, fed by it, brought to rest at the end."""

import contextlib
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Final

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import Device, Output
from galen_hw.drivers.reporting import Reporter
from galen_hw.drivers.transport import Transport
from galen_hw.errors import CommandRejectedError, HardwareError
from galen_hw.messages import Request

FIRST_WAIT_S: Final = 0.5
LONGEST_WAIT_S: Final = 10.0
NEVER: Final = 1 << 62


class Port:
    """One device with its transport.

    Args:
        device: the state machine.
        transport: makes a fresh, closed transport; called for each attempt to open.
        clock: monotonic nanoseconds.
        wake: called from another thread when the loop has something to do here.
        optional: the daemon is ready without it.
        time_base: of the faults that are the wire's own; their source is NAME.wire.
    """

    def __init__(
        self,
        device: Device[Any],
        transport: Callable[[], Transport[Any]],
        clock: Callable[[], int],
        wake: Callable[[], None],
        *,
        optional: bool = False,
        time_base: TimeBase | None = None,
    ) -> None:
        self.device, self.optional = device, optional
        self.error: HardwareError | None = None
        self.attempts = 0
        self.fd: int | None = None  # to wait on; None while closed or where a thread reads
        self.transport: Transport[Any] | None = None
        self._make, self._clock, self._wake = transport, clock, wake
        self._opening: _Opening | None = None
        self._reader: _Reader | None = None
        self._retry_ns = 0
        self._wait_s = FIRST_WAIT_S
        self._reporter = Reporter(f"{device.name}.wire", "", time_base or TimeBase())

    @property
    def state(self) -> str:
        """One of "open", "opening", "failed" (waiting to try again) and "closed"."""
        if self.transport is not None:
            return "open"
        return "opening" if self._opening is not None else "failed" if self.error is not None else "closed"

    @property
    def wakeup_ns(self) -> int:
        """When `tend` wants to be called though nothing was received."""
        if self.transport is not None:
            return min(self.device.wakeup_ns, self.transport.wakeup_ns)
        return NEVER if self._opening is not None else self._retry_ns

    def step(self, *, readable: bool) -> list[Output]:
        """Do all there is to do: `receive` where something can be read, and `tend`."""
        return [*(self.receive() if readable else ()), *self.tend()]

    def receive(self) -> list[Output]:
        """Read the wire and feed the device, and nothing else: a sample does not wait for what has time (see `tend`)."""
        outputs: list[Output] = []
        if self.transport is None:
            return outputs
        try:
            self._feed(self.transport.receive(0.0), outputs)
        except HardwareError as error:
            self._lose(error, outputs)
        return outputs

    def tend(self) -> list[Output]:
        """Open the wire, let the device and the wire have their turn, send. A wire that is gone is closed and retried."""
        if self.transport is None:
            self._advance_opening()
            if self.transport is None:
                return []
        outputs: list[Output] = []
        try:
            if self._reader is not None:
                self._feed(self._reader.take(), outputs)
            now = self._clock()
            if self.transport.news:
                self._tell_news(self.transport, outputs, now)
            if self.transport.wakeup_ns <= now:
                self.transport.tend(now)
            if self.device.wakeup_ns <= now:
                wires, more = self.device.poll(now)
                if wires:
                    self.transport.send(wires)
                outputs += more
        except HardwareError as error:
            self._lose(error, outputs)
        return outputs

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Hand a request to the device.

        Raises:
            CommandRejectedError: the wire is not open, or the device refuses.
        """
        if self.transport is None:
            why = str(self.error) if self.error else "its wire is not open yet"
            raise CommandRejectedError(f"not connected ({why})", where=self.device.name)
        return self.device.request(request, now_ns)

    def rest(self) -> None:
        """Send what brings the device to rest."""
        if self.transport is not None:
            with contextlib.suppress(HardwareError):
                self.transport.send(self.device.stop(self._clock()))

    def close(self) -> None:
        """Close the wire, whatever state it is in."""
        self.fd = None
        if self._opening is not None:
            self._opening.abandon()
            self._opening = None
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
        if self.transport is not None:
            self.transport.close()
            self.transport = None

    def _feed(self, received: Iterable[tuple[Any, int]], outputs: list[Output]) -> None:
        feed = self.device.feed
        for wire, t_ns in received:
            outputs += feed(wire, t_ns)

    def _lose(self, error: HardwareError, outputs: list[Output]) -> None:
        """Close a wire that is gone, and say so."""
        self._fail(error)
        self._reporter.where = error.where
        outputs += self._reporter.fault(self._clock(), "gone", error.what, error.todo)

    def _tell_news(self, transport: Transport[Any], outputs: list[Output], now_ns: int) -> None:
        news, transport.news = transport.news, ()
        self._reporter.where = transport.address
        for what, todo in news:
            outputs += self._reporter.fault(now_ns, what, what, todo)

    def _advance_opening(self) -> None:
        if self._opening is None:
            if self._clock() >= self._retry_ns:
                self.attempts += 1
                self._opening = _Opening(self._make, self._wake)
            return
        if not self._opening.done:
            return
        opening, self._opening = self._opening, None
        if opening.error is not None:
            self._fail(opening.error)
            return
        self.transport, self.error, self._wait_s = opening.transport, None, FIRST_WAIT_S
        assert self.transport is not None
        self.fd = self.transport.fileno()
        if self.fd is None:
            self._reader = _Reader(self.transport, self._wake)
        self.device.start(self._clock())

    def _fail(self, error: HardwareError) -> None:
        self.close()
        self.error = error
        self._retry_ns = self._clock() + round(self._wait_s * NS_PER_S)
        self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)


class _Opening:
    """Opens a transport in a thread, since some take seconds (an slcan adapter settles for two)."""

    def __init__(self, make: Callable[[], Transport[Any]], wake: Callable[[], None]) -> None:
        self.transport: Transport[Any] | None = None
        self.error: HardwareError | None = None
        self.done = False
        self._make, self._wake = make, wake
        self._lock, self._abandoned = threading.Lock(), False
        threading.Thread(target=self._open, name="opening", daemon=True).start()

    def abandon(self) -> None:
        """Close what has been or is still being opened."""
        with self._lock:
            self._abandoned = True
            if self.done and self.transport is not None:
                self.transport.close()

    def _open(self) -> None:
        transport = self._make()
        try:
            transport.open()
        except HardwareError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 - a library's own error is the user's hardware error too
            self.error = HardwareError(f"cannot be opened ({error!r})", where=transport.address)
        with self._lock:
            self.transport, self.done = transport, True
            if self._abandoned and self.error is None:
                transport.close()
        self._wake()


class _Reader:
    """Reads a transport without a descriptor in a thread; each read wakes the loop."""

    def __init__(self, transport: Transport[Any], wake: Callable[[], None]) -> None:
        self._transport, self._wake = transport, wake
        self._received: deque[tuple[Any, int]] = deque()
        self._error: HardwareError | None = None
        self._running = True
        self._thread = threading.Thread(target=self._read, name="reader", daemon=True)
        self._thread.start()

    def take(self) -> list[tuple[Any, int]]:
        """What has been read since; raises what ended the reading, after all that came before it."""
        found = []
        while self._received:
            found.append(self._received.popleft())
        if self._error is not None and not found:
            raise self._error
        return found

    def stop(self) -> None:
        """End the thread."""
        self._running = False
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)

    def _read(self) -> None:
        try:
            while self._running:
                if received := self._transport.receive(0.1):
                    self._received.extend(received)
                    self._wake()
        except HardwareError as error:
            self._error = error
        except Exception as error:  # noqa: BLE001 - must reach the loop, a thread that dies silently is worse
            self._error = HardwareError(f"reading failed ({error!r})", where=self._transport.address)
        self._wake()


class Waker:
    """Lets other threads and signal handlers end the loop's wait."""

    def __init__(self) -> None:
        self.fd, self._in = os.pipe()
        os.set_blocking(self.fd, False)
        os.set_blocking(self._in, False)

    def wake(self) -> None:
        """End the wait."""
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._in, b"\0")

    def clear(self) -> None:
        """Forget that it was ended."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self.fd, 512):
                pass

    def close(self) -> None:
        """Close both ends."""
        os.close(self.fd)
        os.close(self._in)
