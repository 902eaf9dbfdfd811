"""Faults of a wire with the real driver on it: bus-off, an adapter that is pulled out, each as its user reads it."""

import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import can

from galen_hw.clock import TimeBase
from galen_hw.daemon.port import Port, Waker
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.can_transport import CanSettings, CanTransport
from galen_hw.drivers.device import Device
from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.serial_transport import SerialSettings, SerialTransport
from galen_hw.drivers.transport import Transport
from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.library_bus import InProcessCan
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.drivers.virtual.world import World
from galen_hw.messages import Fault, Message, WrenchRaw

BASE = TimeBase.now()
BUS_OFF, RESTARTED = 0x40, 0x100
PATIENCE_S = 20.0


class Heard:
    """A sensor's port and all that it said."""

    def __init__(self, device: Device, wire: Callable[[], Transport]) -> None:
        self.waker = Waker()
        self.port = Port(device, wire, time.monotonic_ns, self.waker.wake, time_base=BASE)
        self.messages: list[Message] = []

    def until(self, condition: Callable[[], bool]) -> None:
        until = time.monotonic() + PATIENCE_S
        pause = threading.Event()
        while not condition():
            assert time.monotonic() < until, [m for m in self.messages if isinstance(m, Fault)][-3:]
            self.messages += [o[1] for o in self.port.step(readable=True) if isinstance(o, tuple)]
            pause.wait(0.001)

    def faults(self, words: str) -> list[Fault]:
        return [m for m in self.messages if isinstance(m, Fault) and words in m.what]

    def samples_after(self, t_ns: int) -> list[WrenchRaw]:
        return [m for m in self.messages if isinstance(m, WrenchRaw) and m.t_ns > t_ns]

    def close(self) -> None:
        self.port.close()
        self.waker.close()


def sensor(interface: str, channel: str) -> Heard:
    wire = CanSettings(interface=interface, channel=channel)
    return Heard(AtiNetcanoem("ft", AtiNetcanoem.Settings(rate_hz=200.0), BASE), lambda: CanTransport(wire))


def test_bus_off_is_a_fault_and_samples_come_back_after_the_restart() -> None:
    """The kernel's error frame: a fault of the wire that says what to do, no sample; restarted: samples, same sensor."""
    world = World()
    device = VirtualAtiNetcanoem(AtiSettings(), world)
    with (
        InProcessCan(device, "bus-off"),
        can.Bus(interface="virtual", channel="bus-off") as controller,
        closing(sensor("virtual", "bus-off")) as own,
    ):
        own.until(lambda: own.port.device.ready)
        world.faults.add("ft.silent")
        controller.send(can.Message(arbitration_id=BUS_OFF, is_error_frame=True, data=bytes(8)))
        own.until(lambda: bool(own.faults("bus-off: nothing is sent")))
        fault = own.faults("bus-off")[0]
        assert (fault.source, fault.where) == ("ft.wire", "virtual:bus-off")
        assert "termination" in fault.todo
        own.until(lambda: bool(own.faults("does not answer any more")))
        assert not own.port.device.ready
        silent_ns = own.messages[-1].t_ns
        assert own.samples_after(silent_ns) == []

        world.faults.discard("ft.silent")
        controller.send(can.Message(arbitration_id=RESTARTED, is_error_frame=True, data=bytes(8)))
        own.until(lambda: len(own.samples_after(silent_ns)) > 10)
        assert own.faults("started again after bus-off")
        assert own.port.state == "open", "the wire needs no opening again"
    assert own.samples_after(silent_ns)[-1].valid


def test_an_adapter_that_is_unplugged_is_a_fault_and_opened_again(tmp_path: Path) -> None:
    """Its end of the pty goes with the whole virtual robot; another one is plugged in at the same name."""
    folder = tmp_path / "robot"
    with closing(sensor("slcan", str(folder / "can0"))) as own:
        with virtual_robot(folder):
            own.until(lambda: own.port.device.ready)
        own.until(lambda: bool(own.faults("the wire is gone")))
        fault = own.faults("the wire is gone")[0]
        assert fault.source == "ft.wire"
        assert "check the adapter and its cable" in fault.todo
        gone_ns = fault.t_ns
        own.until(lambda: own.port.state == "failed")
        with virtual_robot(folder):
            own.until(lambda: len(own.samples_after(gone_ns)) > 10)
    assert min(m.t_ns for m in own.samples_after(gone_ns)) > gone_ns


def test_a_motors_cable_that_is_out_and_back_is_a_fault_and_opened_again(tmp_path: Path) -> None:
    """The controller's line over a real serial transport: a fault that names it, and ready again once it is back."""
    folder = tmp_path / "robot"
    wire = SerialSettings(url=str(folder / "motors"), baud_rate=115200)
    device = GalilDmc("motors", GalilDmc.Settings(), BASE)
    with closing(Heard(device, lambda: SerialTransport(wire))) as own:
        with virtual_robot(folder):
            own.until(lambda: device.ready)
        own.until(lambda: any(fault.source == "motors.wire" for fault in own.faults("")))
        with virtual_robot(folder):
            own.until(lambda: own.port.state == "open" and device.ready)
        fault = next(fault for fault in own.faults("") if fault.source == "motors.wire")
        assert fault.where.endswith("motors")
        assert fault.todo
