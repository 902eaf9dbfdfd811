"""Galil DMC motor controller on a serial line or a socket (`socket://`), as a device without I/O."""

from galen_hw.drivers.galil_dmc.device import GalilDmc

__all__ = ["GalilDmc"]
