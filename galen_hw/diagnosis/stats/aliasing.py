"""Frequencies of recorded rows behind those that their averages show."""

from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.lazy import cached_property
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def folded(frequency: float, rate: float) -> float:
    """Return the frequency, Hz, as which rows at a rate, Hz, show another one."""
    above = frequency % rate
    return float(min(above, rate - above))


@dataclass(frozen=True, eq=False)
class Aliases:
    """Tell which frequency of the recorded rows is behind a line in the spectrum of the averaged ones.

    A mean over neighbouring rows weakens what is faster than the averaged rows can follow, and does not remove it: an oscillation
    of 32 Hz shows at 18 Hz in rows averaged to 50 a second.

    Args:
        scene: the recording; rows: its averages; left_out: (N,) rows of outliers, interpolated here as those that were not read.
    """

    scene: Scene
    rows: Rows
    left_out: Mask

    def recorded(self, frequency: float, channel: int) -> float:
        """Return the frequency, Hz, that contributes most to a line of the averaged rows at this one, in a channel."""
        power = self._spectra[channel]
        lines = frequency / self._rate * self._groups
        multiples = np.arange(0, self.rows.stride // 2 + 1) * self._groups
        places = np.unique(np.concatenate([multiples + lines, multiples - lines]))
        places = places[(places > 0.0) & (places < len(power) - 1)]
        if not len(places):
            return frequency
        # A line between two places of the spectrum shows in both.
        below = places.astype(np.intp)
        strongest = int(np.argmax(np.maximum(power[below], power[below + 1])))
        return float(places[strongest] / self._groups * self._rate)

    def passed(self, frequency: float) -> float:
        """Return the share of an oscillation's amplitude that is left in the averages."""
        cycles = frequency / (self._rate * self.rows.stride)
        return float(np.abs(np.sinc(self.rows.stride * cycles) / np.sinc(cycles)))

    @cached_property
    def _longest(self) -> slice:
        """The rows (n,) of the longest segment that fill whole groups."""
        part = max(self.scene.segments, key=lambda one: one.stop - one.start)
        return slice(part.start, part.stop - (part.stop - part.start) % self.rows.stride)

    @property
    def _groups(self) -> int:
        part = self._longest
        return int((part.stop - part.start) // self.rows.stride)

    @cached_property
    def _rate(self) -> float:
        """Averaged rows a second."""
        time = self.scene.time[self._longest]
        return (len(time) - 1) / (float(np.ptp(time)) * self.rows.stride)

    @cached_property
    def _spectra(self) -> list[Array]:
        """Power spectrum of every channel's residual, weighted by what the averages pass; none where all rows are kept."""
        if self.rows.stride == 1:
            return [np.empty(0) for _ in self.scene.channels]
        residual = self.rows.filtered(self.scene.residual)
        at = np.arange(self._longest.stop - self._longest.start)
        cycles = np.fft.rfftfreq(len(at))
        passed = (np.sinc(self.rows.stride * cycles) / np.sinc(cycles)) ** 2
        out = []
        for column in residual[self._longest].T:
            good = np.flatnonzero(np.isfinite(column) & ~self.left_out[self._longest])
            x = np.interp(at, good, column[good]) if len(good) else np.zeros(len(at))
            power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) ** 2
            out.append((passed * power).astype(np.float32))
        return out
