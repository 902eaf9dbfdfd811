"""Which process owns which device and service: the hops of a message follow from it."""

from dataclasses import dataclass
from typing import Final

from galen_hw.config.load import Setup

CORE: Final = "core"
SENSOR: Final = "ft"
MOTORS: Final = "motors"
TRACKER: Final = "tracker"

PROCESS_OF: Final[dict[str, str]] = {
    # device or service: process. What is not named here has a process of its own name.
    SENSOR: CORE,
    "compensation": CORE,
    MOTORS: "motion",
    "calibration": "motion",
    "admittance": "motion",
    TRACKER: "tracking",
    "deflection": "tracking",
}

LOOKERS: Final = frozenset({"health"})
"""Processes that only look: the start does not wait for them, and when one dies the arm may go on."""

PRIORITY_BELOW_CORE: Final[dict[str, int]] = {CORE: 0, "motion": 5}
"""Processes that run in real time where permitted: joints that are stamped late are joints in the wrong place."""


@dataclass(frozen=True, slots=True)
class Share:
    """What one process owns: names of devices and of services."""

    devices: tuple[str, ...] = ()
    services: tuple[str, ...] = ()


def lay_out(setup: Setup) -> dict[str, Share]:
    """Every process with its share; `core` always exists, for it owns the bus, and is the only one in simulated time."""
    if setup.speed != 1.0:
        return {CORE: Share(tuple(setup.devices), tuple(setup.services))}
    devices: dict[str, list[str]] = {CORE: []}
    services: dict[str, list[str]] = {}
    for name in setup.devices:
        devices.setdefault(PROCESS_OF.get(name, name), []).append(name)
    for name in setup.services:
        services.setdefault(PROCESS_OF.get(name, name), []).append(name)
    processes = [*devices, *(p for p in services if p not in devices)]
    return {p: Share(tuple(devices.get(p, ())), tuple(services.get(p, ()))) for p in processes}
