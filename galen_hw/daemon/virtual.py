"""The virtual robot in place of the configured wires."""

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from galen_hw.config.load import Setup, Tables, with_transports
from galen_hw.daemon.layout import MOTORS, SENSOR, TRACKER
from galen_hw.drivers.virtual.ndi_tracker.definition import DEFINITIONS
from galen_hw.drivers.virtual.start import Starter, virtual_robot
from galen_hw.errors import UsageError

CALIBRATION: Final = "calibration"
LONGEST_BEAT_S: Final = 60.0
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


@contextmanager
def simulated_setup(setup: Setup, tables: Tables, folder: Path, speed: float) -> Iterator[Setup]:
    """The set-up for simulated time: the virtual robot is then a part of the one process (see `simulated`).

    A client of a sweep beats on the machine's clock, and is given so many times as long.

    Raises:
        UsageError: the folder cannot be used.
    """
    files = {name: folder / name for name in DEFINITIONS}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in files.items():
            path.write_bytes(DEFINITIONS[name])
    except OSError as error:
        raise UsageError(f"cannot be used ({error.strerror})", where=str(folder), todo="choose --dir") from error
    wires: dict[str, dict[str, Any]] = {name: {"url": f"memory://{name}"} for name in (MOTORS, TRACKER)}
    wires[SENSOR] = {"interface": "virtual", "channel": "can0"}
    markers = {role: {"rom_file": str(files[f"{role}.rom"])} for role in MARKERS}
    own = {TRACKER: {"markers": markers}} if _markers_open(setup) else {}
    services = {}
    if CALIBRATION in setup.services:
        beat_s = getattr(setup.services[CALIBRATION].settings, "heartbeat_s", 1.0)
        services[CALIBRATION] = {"heartbeat_s": min(LONGEST_BEAT_S, max(1.0, speed) * beat_s)}
    made = with_transports(setup, wires, tables, settings=own, services=services)
    try:
        yield replace(made, speed=speed)
    finally:
        for path in files.values():
            path.unlink(missing_ok=True)


def _markers_open(setup: Setup) -> bool:
    """Return whether the configuration leaves open which marker bodies there are; the virtual ones are then taken."""
    return TRACKER in setup.devices and "markers" not in setup.config.devices[TRACKER].settings


def _run_like_hardware(pid: int, priority: int) -> None:
    """Hardware does not wait for the programs of this machine: its stand-in does not either, where permitted."""
    if priority:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(priority))
