"""The orders of one process, and the devices and services that it builds from them."""

import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from galen_hw.config.load import DeviceSetup, Setup, Tables, check_document
from galen_hw.config.problems import Places
from galen_hw.config.robot import build_robot, identity
from galen_hw.daemon.layout import MOTORS, SENSOR, TRACKER
from galen_hw.daemon.port import Port, Waker
from galen_hw.services.service import Service, ServiceContext

if TYPE_CHECKING:
    from galen_hw.clock import TimeBase
    from galen_hw.daemon.keep import Keeper
    from galen_hw.drivers.device import Device
    from galen_hw.drivers.transport import Transport

log = logging.getLogger("galen-hw")


class Orders(msgspec.Struct, frozen=True):
    """What the supervisor tells a process on its standard input, one line of JSON.

    Args:
        name, devices, services: the process and its share.
        document: the settings; path: of their file.
        drivers, transports, services_table: what may be named there.
        runtime, state_dir: directories; virtual: the wires lead to virtual devices.
        wall_minus_monotonic_ns: one time base for the whole tree.
        processes: of the tree, in the order of the pulse board; pulse_fd: the board's memory.
        speed: of simulated time, see `simulated`.
    """

    name: str
    devices: tuple[str, ...]
    services: tuple[str, ...]
    document: dict[str, Any]
    path: str
    drivers: dict[str, str]
    transports: dict[str, str]
    services_table: dict[str, str]
    runtime: str
    state_dir: str
    virtual: bool
    wall_minus_monotonic_ns: int
    processes: tuple[str, ...]
    pulse_fd: int
    speed: float = 1.0

    def whole(self) -> Setup:
        """The whole set-up, checked again.

        Raises:
            ConfigError: it has changed meaning since the supervisor checked it.
        """
        tables = Tables(self.drivers, self.transports, self.services_table)
        path = Path(self.path)
        return check_document(self.document, path, Places(path.name, ""), tables)

    def share_of(self, setup: Setup) -> Setup:
        """Only what this process owns."""
        devices = {n: d for n, d in setup.devices.items() if n in self.devices}
        services = {n: s for n, s in setup.services.items() if n in self.services}
        return Setup(setup.config, setup.path, devices, services, virtual=self.virtual)


def make_device(device: DeviceSetup, time_base: "TimeBase") -> "Device[Any]":
    """A device without a wire."""
    made: Device[Any] = device.driver(device.name, device.settings, time_base)
    return made


def build_port(device: DeviceSetup, time_base: "TimeBase", waker: Waker, *, alone: bool = False) -> Port:
    """A device with its wire, both closed yet; `alone`: on a wire that no other process uses, or not at all."""
    machine = make_device(device, time_base)

    def make() -> "Transport[Any]":
        made: Transport[Any] = device.transport(device.transport_settings)
        made.alone = alone
        return made

    return Port(machine, make, time.monotonic_ns, waker.wake, optional=device.optional, time_base=time_base)


def build_services(
    setup: Setup, whole: Setup, time_base: "TimeBase", state_dir: Path, keeper: "Keeper"
) -> dict[str, Service]:
    """The services of a process' share, with what was kept of them given back."""
    if not setup.services:
        return {}
    names = {role: role if role in whole.devices else "" for role in (SENSOR, MOTORS, TRACKER)}
    context = ServiceContext(
        robot=build_robot(setup.config),
        time_base=time_base,
        state_dir=state_dir,
        identity=identity(setup.config),
        sensor=names[SENSOR],
        motors=names[MOTORS],
        tracker=names[TRACKER],
        virtual=setup.virtual,
    )
    services: dict[str, Service] = {}
    for name, section in setup.services.items():
        service: Service = section.service(name, section.settings, context)
        kept = keeper.read(name)
        if kept is not None and not service.restore(kept):
            log.warning("%s: what was kept belongs to another version or robot; starting afresh", name)
        services[name] = service
    return services
