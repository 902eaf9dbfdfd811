"""Robotous RFT force/torque sensor, streaming over CAN; RFT series manual, revision 1.7."""

from galen_hw.drivers.robotous_rft.device import RobotousRft

__all__ = ["RobotousRft"]
