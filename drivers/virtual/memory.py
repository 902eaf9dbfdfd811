"""The virtual robot in the process of its drivers: wires of memory, on a clock that both ends are handed."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Final, Generic, Self

from galen_hw.drivers.device import Wire
from galen_hw.drivers.transport import Transport
from galen_hw.drivers.virtual.ports import Port
from galen_hw.drivers.virtual.process import Options, VirtualProcess

_NO_DESCRIPTOR: Final = -2
"""Descriptors of memory are numbers below this, which nothing waits for."""


class MemoryPort(Port):
    """One device, whose wire is a list on either side.

    Args:
        device: of the virtual robot; on a line without a baud rate both sides always understand each other.
        number: which wire of the robot it is.
        clock: ns, the host's too.
    """

    def __init__(self, device: Any, number: int, clock: Callable[[], int]) -> None:
        self._device, self._number, self._clock = device, number, clock
        self.address = {"memory": number}
        self.bit_rate = int(getattr(device, "bit_rate", 0))
        self.inbox: list[Any] = []
        """What the host has not read yet."""
        self.is_open = False
        self._counters = {"sent": 0, "received": 0}

    def fileno(self) -> int:
        """No descriptor, but a number of its own."""
        return _NO_DESCRIPTOR - self._number

    def read(self, now_ns: int) -> None:
        """Nothing: the host hands over what it sends."""

    def take(self, wires: list[Any]) -> None:
        """What the host sends; a change of the line, which is empty bytes, means nothing here."""
        now = self._clock()
        for wire in wires:
            if wire:
                self._device.feed(wire, now)
        self._counters["received"] += len(wires)
        self.write(now)

    def write(self, now_ns: int) -> None:
        """What the device says; to nobody, while the wire is closed."""
        out = self._device.poll(now_ns)
        self._counters["sent"] += len(out)
        if self.is_open:
            self.inbox += out

    @property
    def wakeup_ns(self) -> int:
        """The device's."""
        return int(self._device.wakeup_ns)

    def close(self) -> None:
        """Forget what nobody has read."""
        self.is_open = False
        self.inbox = []

    @property
    def counters(self) -> dict[str, int]:
        """Frames or chunks each way."""
        return dict(self._counters)


class MemoryWire(Transport[Wire], Generic[Wire]):
    """The host's end of a `MemoryPort`; stamped when the host reads, as on any wire."""

    def __init__(self, port: MemoryPort, name: str, clock: Callable[[], int]) -> None:
        self._port, self._clock, self.address = port, clock, f"memory:{name}"
        self.bus_bit_rate = port.bit_rate

    def open(self) -> None:
        """See `Transport.open`."""
        self._port.close()
        self._port.is_open = True

    def send(self, wires: list[Wire]) -> None:
        """See `Transport.send`."""
        self._port.take(wires)

    def receive(self, timeout_s: float) -> list[tuple[Wire, int]]:
        """See `Transport.receive`; never waits."""
        found, self._port.inbox = self._port.inbox, []
        now = self._clock()
        return [(wire, now) for wire in found]

    def close(self) -> None:
        """See `Transport.close`."""
        self._port.close()

    def fileno(self) -> int:
        """See `MemoryPort.fileno`."""
        return self._port.fileno()

    @property
    def counters(self) -> dict[str, int]:
        """See `MemoryPort.counters`."""
        return self._port.counters


class MemoryRobot(VirtualProcess):
    """The virtual robot without a loop of its own; whoever owns it lets time pass with `step`.

    Args:
        options: see `Options`; of its wires only the folder of the control socket is used.
        clock: ns.
    """

    def __init__(self, options: Options, clock: Callable[[], int]) -> None:
        super().__init__(options, clock)
        self.wires: dict[str, MemoryPort] = {}
        self.control_fd = -1
        """Readable when somebody asks something on the control socket."""

    def __enter__(self) -> Self:
        super().__enter__()
        self.control_fd = int(self._control.fileno())
        return self

    def _open_ports(self, stack: ExitStack) -> None:
        for number, (name, device) in enumerate(self.devices.items()):
            self.wires[name] = MemoryPort(device, number, self.clock)
            self._add(stack, name, self.wires[name])

    @property
    def wakeup_ns(self) -> int:
        """When a device wants to say something."""
        return min(port.wakeup_ns for port in self.wires.values())

    @property
    def heard(self) -> list[int]:
        """Descriptors of the wires on which something waits for the host."""
        return [port.fileno() for port in self.wires.values() if port.inbox]

    def step(self, now_ns: int, *, asked: bool) -> None:
        """Let the world come to `now_ns`; `asked`: look at the control socket too."""
        self.world.advance(now_ns)
        for port in self.wires.values():
            if port.wakeup_ns <= now_ns:
                port.write(now_ns)
        if asked:
            self._answer_control()
