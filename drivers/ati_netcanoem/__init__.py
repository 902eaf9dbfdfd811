"""ATI force/torque sensor on a NETCANOEM board (9105-NETCANOEM), polled over CAN; manual 9610-05-1030."""

from galen_hw.drivers.ati_netcanoem.device import AtiNetcanoem

__all__ = ["AtiNetcanoem"]
