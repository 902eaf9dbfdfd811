"""Read IIT F/T sensors (FT45, FT58) with a STRAIN or STRAIN2 board, streaming over CAN; iCub CAN protocol."""

from galen_hw.drivers.iit_strain.device import IitStrain

__all__ = ["IitStrain"]
