"""Which frames of a Robotous RFT stream are one sample: `drivers/pairing.py`; a first frame bears the stream's number."""

from galen_hw.drivers.pairing import Pairer
from galen_hw.drivers.robotous_rft.codec import LENGTH, Command


def pairer(period_ns: int, window_ns: int, stall_ns: int, counters: dict[str, int]) -> Pairer:
    """Return a `Pairer` of this sensor's frames; times in ns."""
    return Pairer(period_ns, window_ns, stall_ns, counters, (LENGTH,), bytes([Command.START_OUTPUT]))
