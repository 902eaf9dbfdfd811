"""A virtual Galil DMC-40x0 family controller at the other end of a serial line, written from the data sheets."""

from galen_hw.drivers.virtual.galil_dmc.device import VirtualGalilDmc

__all__ = ["VirtualGalilDmc"]
