"""Hardware interface of the Galen surgical robot: drivers, calibration, compensation, deflection, diagnosis."""

from galen_hw.version import VERSION as __version__

__all__ = ["__version__"]
