"""Hardware interface of the Galen surgical robot: drivers, calibration, compensation, deflection, diagnosis."""

from galen_hw import version

__version__ = version.VERSION

__all__ = ["__version__"]
