"""A virtual NDI tracker (Polaris family) at the other end of a serial line, written from the Combined API's facts."""

from galen_hw.drivers.virtual.ndi_tracker.device import VirtualNdiTracker

__all__ = ["VirtualNdiTracker"]
