"""Whether each gauge of a force/torque sensor still works, told from its own noise.

A working strain gauge has noise, a load changes smoothly, and both are known: the noise was measured when the sensor
was zeroed. What is tested is therefore the third difference d of the counts, which a hand's push (below 10 Hz) leaves
alone and white noise of standard deviation s makes s sqrt(20) large. Per gauge and window, on every fourth d (those
are independent):

- loud: more of them beyond 2 R s sqrt(20) than noise of R s would have (binomial, 4.6 % each);
- faint: fewer of them beyond s sqrt(20) / 2 R than noise of s / R would have (61.7 %), where s / R is above two counts;
- stuck: the gauge repeats to the bit while others change. A sample rounds to its likeliest count with a probability of
  at most p = erf(1 / (2 sqrt(2) s)), whatever its mean, so that a run of n repeats has at most p^n; or r^n, where r is
  how often it repeated when its noise was measured (noise behind a filter), if that is more.

R = `NOISE_RANGE` is how far the noise may go of itself (motors, temperature). Rounding hides how quiet a gauge is: one
that toggles between two counts may have no noise to speak of, and stay on one of them for ever once its load is a
little another. So the variance of such a coin, 1/4, is taken off s^2 for the third test; where little or nothing
remains, no run is long enough, and a quiet gauge that repeats is no fault. A gauge that did not move at all when its
noise was measured is given a quarter of its fellows' median, for they are built alike: if those are loud, it is broken.
Samples in which nothing changed (a sensor slower than it is read) count for no gauge; but a sensor that always moved
and does not move any more hangs. A knock is short: it fills less of the window than the tests need.

The level of one test is `FALSE_ALARMS_PER_HOUR` shared by all tests of an hour (Bonferroni).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.ma
import numpy.typing as npt

GAUGES: Final = 6
FALSE_ALARMS_PER_HOUR: Final = 1e-5
NOISE_RANGE: Final = 4.0
"""Noise between a quarter and four times what it was is its own."""
FELLOWS_SHARE: Final = 0.25
WINDOW_S: Final = 0.4
STEP_S: Final = 0.05
LEARN_SAMPLES: Final = 100
"""Fewest samples that a noise is measured from; the last `KEPT` at most."""
KEPT: Final = 250
_SHORTEST: Final = 48
_NORM: Final = math.sqrt(20.0)
_COIN_VARIANCE: Final = 0.25
_ROUNDING: Final = math.sqrt(1.0 / 12.0)
_DECIDABLE_COUNTS: Final = 2.0
_BLOCK: Final = 25

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Broken:
    """What is wrong with a gauge: its index (-1: all) and a word."""

    gauge: int
    what: str


def noise_of(counts: Floats) -> Floats:
    """Standard deviation (gauges,) of the white noise in `counts` (samples, gauges), whatever smooth load they bear.

    The median over blocks, so that a knock or two change nothing; what rounding adds is in it.
    """
    third = np.diff(counts, 3, axis=0) ** 2
    blocks = max(1, len(third) // _BLOCK)
    means = [block.mean(axis=0) for block in np.array_split(third, blocks)]
    return np.asarray(np.sqrt(np.median(means, axis=0) / 20.0))


@lru_cache(maxsize=64)
def most_of(n: int, p: float, level: float) -> int:
    """The least k with P(X >= k) <= level for X of Binomial(n, p); n + 1 when there is none."""
    tail, k = 0.0, n + 1
    while k > 0:
        tail += math.comb(n, k - 1) * p ** (k - 1) * (1.0 - p) ** (n - k + 1)
        if tail > level:
            return k
        k -= 1
    return 0


class GaugeWatch:
    """Watches the gauges of one sensor.

    Args:
        rate_hz: of its samples.
    """

    def __init__(self, rate_hz: float) -> None:
        self._size = max(_SHORTEST, round(WINDOW_S * rate_hz))
        self._step = max(1, round(STEP_S * rate_hz))
        tests_an_hour = 3600.0 * rate_hz / self._step * (3 * GAUGES + 1)
        self._level = FALSE_ALARMS_PER_HOUR / tests_an_hour
        kept = max(self._size, KEPT)
        self._kept, self._rows = kept, np.zeros((4 * kept, GAUGES))
        self._noise: Floats | None = None
        self._repeats: Floats = np.zeros(GAUGES + 1)  # logarithms
        self.interrupt()

    def forget(self) -> None:
        """Another sensor, or none."""
        self._noise = None
        self.interrupt()

    def interrupt(self) -> None:
        """The samples that follow are no continuation of those before."""
        self._end = self._judged = 0
        self._new: list[tuple[int, ...]] = []
        self._runs = np.zeros(GAUGES + 1)
        self.broken: tuple[Broken, ...] = ()

    def learn(self) -> None:
        """Measure the noise from the last samples, of a sensor at rest; too few tell nothing."""
        self._store()
        counts = self._rows[max(0, self._end - self._kept) : self._end]
        if len(counts) < LEARN_SAMPLES:
            return
        noise = noise_of(counts)
        self._runs[:] = 0.0
        if not noise.any():
            self._noise = None  # a sensor coarser than its noise: nothing can be told from it
            return
        fellows = np.array([np.median(np.delete(noise, gauge)) for gauge in range(GAUGES)])
        unmoved = noise == 0.0
        self._noise = np.where(unmoved, FELLOWS_SHARE * fellows, noise)
        white = np.sqrt(np.maximum(self._noise**2 - _COIN_VARIANCE, 1e-12))
        likeliest = np.array([math.erf(0.5 / (math.sqrt(2.0) * s)) for s in white])
        same = np.diff(counts, axis=0) == 0.0
        idle = same.all(axis=1)
        seen = (same[~idle].sum(axis=0) + 1.0) / (np.count_nonzero(~idle) + 1.0)
        each = np.maximum(likeliest, np.where(unmoved, 0.0, seen))
        hang = max(float(likeliest.prod()), (np.count_nonzero(idle) + 1.0) / (len(idle) + 1.0))
        self._repeats = np.log(np.minimum(np.append(each, hang), 1.0))

    def take(self, gauges: tuple[int, ...]) -> bool:
        """Add a sample; true when it is time to `judge`, which it is every `STEP_S`."""
        self._new.append(gauges)
        return len(self._new) >= self._step

    @property
    def is_due(self) -> bool:
        """It is time to `judge`."""
        return len(self._new) >= self._step

    def judge(self) -> bool:
        """Look at the samples since the last time; true when `broken` was found out anew. It takes about 0.1 ms."""
        self._store()
        if self._end < _SHORTEST:
            return False
        if self._noise is None:
            self._judged = self._end
            if self._end >= max(LEARN_SAMPLES, self._size):
                self.learn()  # the first samples, until it is zeroed
            return False
        self.broken = tuple(self._judge(self._noise))
        self._judged = self._end
        return True

    def _store(self) -> None:
        """Put the new samples behind the others, several at once: one at a time would cost each of them a microsecond."""
        new, self._new = self._new[-self._kept :], []
        if not new:
            return
        if self._end + len(new) > len(self._rows):
            self._rows[: self._kept] = self._rows[self._end - self._kept : self._end]
            self._judged -= self._end - self._kept
            self._end = self._kept
        self._rows[self._end : self._end + len(new)] = new
        self._end += len(new)

    def _judge(self, noise: Floats) -> list[Broken]:
        self._count_runs()
        stuck = self._runs * self._repeats < math.log(self._level)
        if stuck[GAUGES]:
            return [Broken(-1, "hangs: the same sample again and again")]
        x = self._rows[max(0, self._end - self._size) : self._end]
        a, b, c, d = (x[first : len(x) - 3 + first : 4] for first in range(4))
        third = np.abs(d - a + 3.0 * (b - c)) / _NORM
        n = len(third)
        # However quiet at rest: a load that changes passes from count to count, and rounding makes noise of that.
        most = NOISE_RANGE * np.maximum(noise, _ROUNDING)
        loud = (third > 2.0 * most).sum(axis=0) >= most_of(n, 0.0455003, self._level)
        felt = (third > 0.5 / NOISE_RANGE * noise).sum(axis=0)
        faint = (n - felt >= most_of(n, 0.3829249, self._level)) & (noise > _DECIDABLE_COUNTS * NOISE_RANGE)
        return [
            Broken(gauge, _WORDS[0] if stuck[gauge] else _WORDS[1] if loud[gauge] else _WORDS[2])
            for gauge in np.flatnonzero(stuck[:GAUGES] | loud | faint).tolist()
        ]

    def _count_runs(self) -> None:
        """How long each gauge has repeated while others changed, and all of them together."""
        rows = self._rows[max(0, self._judged - 1) : self._end]
        same = rows[1:] == rows[:-1]
        idle = same.all(axis=1)
        for part, columns in ((slice(GAUGES), same[~idle]), (slice(GAUGES, None), idle[:, None])):
            if len(columns):
                whole, since = columns.all(axis=0), (~columns[::-1]).argmax(axis=0)
                self._runs[part] = np.where(whole, self._runs[part] + len(columns), since)


_WORDS: Final = (
    "is stuck: it repeats to the bit while others have noise",
    f"has more than {NOISE_RANGE:g} times its own noise",
    f"has less than 1/{NOISE_RANGE:g} of its own noise",
)
