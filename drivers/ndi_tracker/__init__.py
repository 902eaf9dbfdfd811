"""NDI optical tracker (Polaris, Vega, Aurora) by the Combined API, on a serial line or a socket, without I/O."""

from galen_hw.drivers.ndi_tracker.device import NdiTracker

__all__ = ["NdiTracker"]
