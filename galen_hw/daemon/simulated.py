"""The daemon in simulated time: all devices, services and the virtual robot in one process, on one clock.

Devices, services and virtual devices are handed their time, so that one loop can let it pass from one event to the next: as
fast as the work allows, and at most `speed` times as fast as the machine's clock. Nothing can be late, whatever else the
machine does: stamps, ages, rates and time-outs are those of a robot whose computer keeps up; a busy machine is only slower.
Stamps are ahead of the machine's clock, by what was gained; or behind it where not even its speed is reached.
"""

import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from galen_hw.clock import NS_PER_S
from galen_hw.config.paths import Addresses
from galen_hw.daemon.layout import SENSOR
from galen_hw.daemon.orders import Orders, make_device
from galen_hw.daemon.port import Port, Waker
from galen_hw.daemon.virtual import WIRE_OF
from galen_hw.daemon.worker import Worker, run_orders
from galen_hw.drivers.virtual.memory import MemoryRobot, MemoryWire
from galen_hw.drivers.virtual.process import SENSORS, Options
from galen_hw.waiting import readable

if TYPE_CHECKING:
    from galen_hw.clock import TimeBase
    from galen_hw.config.load import DeviceSetup

AHEAD_NS: Final = 2_000_000
"""How far, on the machine's clock, simulated time may be ahead before it is waited for."""
LOOK_NS: Final = 1_000_000
"""Sockets are looked at so often, on the machine's clock."""
BEHIND_NS: Final = 100_000_000
"""What is lost beyond this is not made up for: no burst follows a busy moment."""
JUDGED_NS: Final = 5 * NS_PER_S
SLOW: Final = 0.9
"""Of the speed asked for; what is less is said."""
log = logging.getLogger("galen-hw")


class SimulatedTime:
    """Time that passes from event to event; begins with the machine's clock.

    Args:
        speed: how many times as fast as the machine's clock it is at most; clock: the machine's, ns.
    """

    def __init__(self, speed: float, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.speed, self._clock = speed, clock
        self.now_ns = self._from_ns = self._judged_from_ns = clock()
        self._real_ns = self._looked_ns = self._judged_ns = self.now_ns
        self._is_slow = False

    def monotonic_ns(self) -> int:
        """Nanoseconds of simulated time."""
        return self.now_ns

    def pass_until(self, until_ns: int, fds: Sequence[int]) -> list[int]:
        """Let time pass until `until_ns`, or until one of `fds` can be read; those that can."""
        real = self._clock()
        ahead_ns = round((until_ns - self._from_ns) / self.speed) - (real - self._real_ns)
        if ahead_ns > AHEAD_NS:
            ready = readable(fds, ahead_ns / NS_PER_S)
            self._looked_ns = real = self._clock()
            if ready:
                until_ns = min(until_ns, self._from_ns + round((real - self._real_ns) * self.speed))
        else:
            ready = []
            if real - self._looked_ns > LOOK_NS:
                self._looked_ns, ready = real, readable(fds, 0.0)
            if -ahead_ns > BEHIND_NS:
                self._real_ns -= ahead_ns
        self.now_ns = max(self.now_ns, until_ns)
        if real - self._judged_ns > JUDGED_NS:
            self._judge(real)
        return ready

    def _judge(self, real_ns: int) -> None:
        """Say once that the speed asked for is not reached, and again after it has been."""
        reached = (self.now_ns - self._judged_from_ns) / (real_ns - self._judged_ns)
        self._judged_from_ns, self._judged_ns = self.now_ns, real_ns
        is_slow = reached < SLOW * self.speed
        if is_slow and not self._is_slow:
            log.warning(
                "this machine is too busy: the virtual robot runs %.2g times as fast as the clock, not %g",
                reached,
                self.speed,
            )
        self._is_slow = is_slow


class SimulatedWorker(Worker):
    """The one process of a daemon in simulated time.

    Args:
        orders, lifeline: see `Worker`.
        robot: virtual, entered; it lives on the same clock.
        passing: the clock.
    """

    def __init__(self, orders: Orders, lifeline: int, robot: MemoryRobot, passing: SimulatedTime) -> None:
        self._robot, self._time = robot, passing
        super().__init__(orders, lifeline, passing.monotonic_ns)

    def _make_port(self, device: "DeviceSetup", time_base: "TimeBase", waker: Waker) -> Port:
        port, name = self._robot.wires[WIRE_OF[device.name]], device.name
        return Port(
            make_device(device, time_base),
            lambda: MemoryWire(port, name, self._now),
            self._now,
            waker.wake,
            optional=device.optional,
            time_base=time_base,
        )

    def _wait(self, until_ns: int) -> list[int]:
        robot = self._robot
        if heard := robot.heard:
            return heard
        fds = [*self._own_fds, robot.control_fd]
        if self._link.inlet.pending or self._link.control.pending:
            ready = readable(fds, 0.0)
        else:
            ready = self._time.pass_until(min(until_ns, robot.wakeup_ns), fds)
        robot.step(self._time.now_ns, asked=robot.control_fd in ready)
        return ready + robot.heard

    def _wait_for_wires(self, seconds: float) -> list[int]:
        self._time.now_ns = min(
            self._time.now_ns + round(seconds * NS_PER_S), max(self._time.now_ns, self._robot.wakeup_ns)
        )
        self._robot.step(self._time.now_ns, asked=False)
        return self._robot.heard


def run(orders: Orders) -> None:
    """Run the process of `orders` to its end."""
    passing = SimulatedTime(orders.speed)
    sensor = orders.document["devices"].get(SENSOR, {}).get("driver", SENSORS[0])
    options = Options(Addresses(Path(orders.runtime)).virtual, sensor=sensor, parent_pid=os.getppid())
    with MemoryRobot(options, passing.monotonic_ns) as robot:
        SimulatedWorker(orders, sys.stdin.fileno(), robot, passing).run()


def main() -> int:
    """Entry point: as that of a worker."""
    return run_orders(run)


if __name__ == "__main__":
    sys.exit(main())
