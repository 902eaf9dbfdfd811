"""A hand-made Robotous RFT sensor, for the driver's tests."""

from dataclasses import dataclass, field

from conformance.peer import Run
from paired_peer import PairedPeer

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.robotous_rft import RobotousRft
from galen_hw.drivers.robotous_rft.codec import OUTPUT_RATES_HZ, encode_data


@dataclass
class Sensor(PairedPeer):
    """Streams the number of the sample on every axis, or `axes`, less its bias; obeys only 0x0C and 0x11 meanwhile."""

    model: bytes = b"RFT60-HA01"
    serial_number: bytes = b"S-0001"
    rate_code: int = 1
    filter: tuple[int, int] = (0, 0)
    overload: int = 0
    axes: tuple[int, ...] | None = None
    obeys_bias: bool = True
    refuses: dict[int, int] = field(default_factory=dict)
    ids: tuple[int, int, int] = (0x64, 1, 2)
    bias: tuple[int, ...] = (0,) * 6

    @property
    def command_id(self):
        return self.ids[0]

    @property
    def period_ns(self):
        return NS_PER_S // OUTPUT_RATES_HZ[self.rate_code]

    def _obey(self, data, now_ns):
        number = data[0]
        if number == 0x0C:
            self.streaming = False
        elif number == 0x11:
            if self.obeys_bias:
                self.bias = self.raw() if data[1] else (0,) * 6
        elif self.streaming:
            return
        elif number == 0x0B:
            self._begin(now_ns)
        else:
            response = (bytes([number]) + self._answer(number, data)).ljust(16, b"\0")
            self._put_pair(self._frames(response[:8], response[8:]), now_ns)

    def _answer(self, number, data):
        if number in self.refuses:
            return bytes([0, self.refuses[number]])
        if number == 0x0F:
            self.rate_code = data[1]
        if number == 0x08:
            self.filter = (data[1], data[2])
        texts = {1: self.model, 2: self.serial_number, 3: b"1.7", 0x10: bytes([self.rate_code])}
        return {**texts, 9: bytes(self.filter), 0x12: b"\0\0\3\0\0\0"}.get(number, b"\1\0")

    def raw(self):
        return self.axes or (self.number % 20000,) * 6

    def _sample(self):
        axes = tuple(raw - bias for raw, bias in zip(self.raw(), self.bias, strict=True))
        return self._frames(*encode_data(axes, self.overload))

    def _frames(self, first, second):
        return [CanFrame(self.ids[1], first), CanFrame(self.ids[2], second)]


def run_of(sensor=None, **settings):
    """A started device against a sensor."""
    return Run(RobotousRft("ft", RobotousRft.Settings(**settings), TimeBase()), sensor or Sensor()).start()
