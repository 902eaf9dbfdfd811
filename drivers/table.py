"""The table of drivers: the `driver` key of a device in the configuration, and the class that speaks to it.

To add a sensor: one file with a `Device` subclass (with `Settings` and `wire`), one line here, one table of byte
vectors in `tests/vectors/`, one virtual counterpart in `virtual/`. The conformance checks then run on it.
"""

from typing import Final

DRIVERS: Final[dict[str, str]] = {
    "ati_netcanoem": "galen_hw.drivers.ati_netcanoem:AtiNetcanoem",
    "robotous_rft": "galen_hw.drivers.robotous_rft:RobotousRft",
    "iit_strain": "galen_hw.drivers.iit_strain:IitStrain",
    "galil_dmc": "galen_hw.drivers.galil_dmc:GalilDmc",
    "ndi_tracker": "galen_hw.drivers.ndi_tracker:NdiTracker",
    "bota": "galen_hw.drivers.bota.device:Bota",
}

VIRTUAL_DEVICES: Final[dict[str, str]] = {
    "ati_netcanoem": "galen_hw.drivers.virtual.ati_netcanoem:VirtualAtiNetcanoem",
    "robotous_rft": "galen_hw.drivers.virtual.robotous_rft:VirtualRobotousRft",
    "iit_strain": "galen_hw.drivers.virtual.iit_strain:VirtualIitStrain",
    "galil_dmc": "galen_hw.drivers.virtual.galil_dmc:VirtualGalilDmc",
    "ndi_tracker": "galen_hw.drivers.virtual.ndi_tracker:VirtualNdiTracker",
}

LISTENERS: Final[dict[str, str]] = {
    "ati_netcanoem": "galen_hw.drivers.ati_netcanoem.listen",
    "robotous_rft": "galen_hw.drivers.robotous_rft.listen",
    "iit_strain": "galen_hw.drivers.iit_strain.listen",
}
"""Drivers that also decode a log of their bus: modules with `KEYS`, `recognises` and `listen` (see `listening`)."""
