"""A hand-made STRAIN board, for the driver's tests."""

from dataclasses import dataclass

from conformance.peer import Run
from paired_peer import MS, PairedPeer

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.iit_strain import IitStrain
from galen_hw.drivers.iit_strain.codec import encode_vector

FULL_SCALES = (1500, 1500, 2000, 35, 35, 25)


@dataclass
class Board(PairedPeer):
    """Streams the number of the sample on every axis, or `counts`; obeys while it streams, as the board does."""

    address: int = 1
    board: int = 12
    serial_number: bytes = b"SN042"
    full_scales: tuple[int, ...] = FULL_SCALES
    counts: tuple[int, ...] | None = None
    limits: tuple[int, int] = (0, 0)
    period_ms: int = 10

    @property
    def command_id(self):
        return 0x200 | self.address

    @property
    def period_ns(self):
        return self.period_ms * MS

    def _obey(self, data, now_ns):
        if data[0] == 0x07:
            self.streaming = False
            if data[1] == 0:
                self._begin(now_ns)
        elif data[0] == 0x08:
            self.period_ms = data[1]
        answers = {0x1A: self.serial_number.ljust(7, b"\0"), 0x1C: bytes([self.board, 2, 0, 7, 2, 0, 0])}
        if data[0] == 0x18:
            answers[0x18] = data[1:2] + self.full_scales[data[1]].to_bytes(2, "big")
        if data[0] in answers:
            self._put(CanFrame(0x200 | self.address << 4, data[:1] + answers[data[0]]), now_ns)

    def _sample(self):
        counts = self.counts or (self.number % 30000,) * 6
        base = 0x300 | self.address << 4
        return [
            CanFrame(base | 0xA, encode_vector(counts[:3], self.limits[0])),
            CanFrame(base | 0xB, encode_vector(counts[3:], self.limits[1])),
        ]


def run_of(board=None, **settings):
    """A started device against a board."""
    return Run(IitStrain("ft", IitStrain.Settings(**settings), TimeBase()), board or Board()).start()
