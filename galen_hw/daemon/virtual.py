"""The virtual robot in place of the configured wires."""

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from galen_hw.config.load import Setup, Tables, with_transports
from galen_hw.daemon.layout import MOTORS, SENSOR, TRACKER
from galen_hw.drivers.virtual.start import Starter, virtual_robot

MARKERS: Final = ("tool", "reference")
WIRE_OF: Final = {SENSOR: "can0", MOTORS: "motors", TRACKER: "tracker"}


@contextmanager
def virtual_setup(setup: Setup, tables: Tables, folder: Path, starter: Starter | None = None) -> Iterator[Setup]:
    """Start the virtual robot in `folder` and yield the set-up with its wires; it ends with the block, or with us.

    Devices that the virtual robot does not have are left out. Its tracker is as strict as a real one: marker bodies that
    the settings do not name get the definitions that come with the virtual robot, those that they name keep their own.
    `starter`: see `start_virtual`.

    Raises:
        HardwareError: it does not start; its own line says why.
    """
    sensor = setup.config.devices[SENSOR].driver if SENSOR in setup.config.devices else "ati_netcanoem"
    with virtual_robot(folder, sensor=sensor, starter=starter) as robot:
        _run_like_hardware(robot.pid, setup.config.daemon.realtime_priority)
        wires = {name: dict(robot.addresses[wire]) for name, wire in WIRE_OF.items() if wire in robot.addresses}
        markers = {role: {"rom_file": robot.files[f"{role}.rom"]} for role in MARKERS}
        own = {TRACKER: {"markers": markers}} if _markers_open(setup) else {}
        yield with_transports(setup, wires, tables, settings=own)


def _markers_open(setup: Setup) -> bool:
    """Return whether the configuration leaves open which marker bodies there are; the virtual ones are then taken."""
    return TRACKER in setup.devices and "markers" not in setup.config.devices[TRACKER].settings


def _run_like_hardware(pid: int, priority: int) -> None:
    """Hardware does not wait for the programs of this machine: its stand-in does not either, where permitted."""
    if priority:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(priority))
