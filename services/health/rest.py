"""Noise, offset and drift of the compensated wrench, told from the seconds in which nobody touches the tool.

Nobody says when a hand is on the tool; but a hand trembles. Each second is cut into `BLOCKS` means. What they scatter
about a straight line is compared with what white noise of the second's own standard deviation s would leave of n samples
each, s / sqrt(n); a second is at rest when no axis scatters more than `CALM` times that (or half of s, for a sensor whose
noise is slow), and neither the joints nor the compensation have changed. s is from third differences, which a push (below
10 Hz) leaves alone (as in the watch over the gauges). `LEAST_S` such seconds in a row are a rest: their last means, and the
slope of their straight line with its standard error.

A hand that holds still to a hundredth of a newton for five seconds would be taken for rest; so would a cloth that hangs on
the tool. The words of the alarm therefore say "if nothing touches the tool".
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from galen_hw.clock import NS_PER_S
from galen_hw.messages import WrenchCompensated

BLOCKS: Final = 20
CALM: Final = 2.5
"""Of `BLOCKS` means: nine standard deviations of their scatter, and less than a tremor of 1 % of 2 N."""
SLOW_NOISE_SHARE: Final = 0.5
FEWEST: Final = 8 * BLOCKS
"""Samples of a second that can be judged."""
MOST: Final = 20_000
LEAST_S: Final = 5
LONGEST_S: Final = 120
SURE: Final = 6.0
"""Standard errors that a slope must be away from zero, so that no noise is taken for drift in years of seconds."""
LARGEST: Final = 1e4
"""N or N m; what is beyond is no wrench."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Second:
    """One second: noise (6,) of one sample, means (6,), their standard error and slope per s, whether nobody touched it."""

    noise: Floats
    mean: Floats
    error: Floats
    slope: Floats
    rest: bool

    def follows(self, before: "Second") -> bool:
        """Return whether it goes on where the second before has left off: a sensor drifts, a hand lets go."""
        expected = before.mean + (before.slope + self.slope) / 2.0
        # The slope within a second has sqrt(12) times the error of its mean.
        error = 4.0 * math.sqrt(12.0) * self.error + SLOW_NOISE_SHARE * self.noise
        return bool((np.abs(self.mean - expected) <= error).all())


@dataclass(frozen=True, slots=True)
class Rest:
    """A rest: how long, where the wrench is now (6,), how fast it goes (6,) per s, 0 where that is not certain."""

    seconds: int
    offset: Floats
    slope: Floats


class RestWatch:
    """Takes compensated wrenches; `second` is the last whole one, `rest` the rest that lasts, None while there is none."""

    def __init__(self) -> None:
        self.second: Second | None = None
        self.rest: Rest | None = None
        self._seconds: deque[Second] = deque(maxlen=LONGEST_S)
        self._made_by: tuple[object, ...] = ()
        self._begin(0)

    def interrupt(self) -> None:
        """Something else than the sensor has changed or may have (a move, a tare): what follows is a new rest."""
        self._disturbed = True

    def take(self, message: WrenchCompensated) -> bool:
        """Add a sample; true when it has completed a second."""
        made_by = (message.tool, message.calibration, message.enabled)
        if made_by != self._made_by:
            self._made_by, self.second = made_by, None
            self.interrupt()
        ended = not self._from_ns <= message.t_ns < self._from_ns + NS_PER_S
        if ended:
            self._end(message.t_ns)
        f, t = message.force, message.torque
        row = (f.x, f.y, f.z, t.x, t.y, t.z)
        usable = message.valid and message.blend >= 1.0 and all(abs(value) <= LARGEST for value in row)
        if not usable:
            self._disturbed = True
        elif len(self._rows) < MOST:
            self._rows.append(row)
        return ended

    def _begin(self, t_ns: int) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._from_ns, self._disturbed = t_ns, False

    def _end(self, t_ns: int) -> None:
        late = t_ns - self._from_ns >= 2 * NS_PER_S or t_ns < self._from_ns
        self.second = judge(np.array(self._rows)) if len(self._rows) >= FEWEST else None
        second = self.second if not self._disturbed else None
        if late or second is None or not second.rest or (self._seconds and not second.follows(self._seconds[-1])):
            self._seconds.clear()
        if second is not None and second.rest:
            self._seconds.append(second)
        self.rest = rest_of(list(self._seconds)) if len(self._seconds) >= LEAST_S else None
        self._begin(t_ns)


def judge(rows: Floats) -> Second:
    """What one second's samples (N, 6) tell."""
    third = np.diff(rows, 3, axis=0) ** 2
    # The median of parts: a push that begins or a knock is in one or two of them.
    noise = np.sqrt(np.median([part.mean(axis=0) for part in np.array_split(third, BLOCKS // 2)], axis=0) / 20.0)
    size = len(rows) // BLOCKS
    blocks = rows[: size * BLOCKS].reshape(BLOCKS, size, 6).mean(axis=1)
    time = np.arange(BLOCKS) - (BLOCKS - 1) / 2.0
    slope = time @ blocks / (time @ time)
    left = blocks - blocks.mean(axis=0) - np.outer(time, slope)
    scatter = np.sqrt(np.sum(left**2, axis=0) / (BLOCKS - 2))
    calm = scatter <= np.maximum(CALM * noise / math.sqrt(size), SLOW_NOISE_SHARE * noise) + 1e-12
    return Second(noise, rows.mean(axis=0), noise / math.sqrt(len(rows)), BLOCKS * slope, bool(calm.all()))


def rest_of(seconds: Sequence[Second]) -> Rest:
    """Offset and slope of consecutive seconds at rest.

    The longest of the last n, n / 2, n / 4, ... seconds (at least `LEAST_S`) that are one straight line: a drift that has
    just begun is not averaged with the time before.
    """
    means = np.array([second.mean for second in seconds])
    expected = np.array([second.error for second in seconds])
    n = len(means)
    while True:
        rest, scatter = _line(means[-n:])
        if n // 2 < LEAST_S or bool((scatter <= CALM * expected[-n:].mean(axis=0)).all()):
            return rest
        n //= 2


def _line(means: Floats) -> tuple[Rest, Floats]:
    """The straight line of means (N, 6), and their scatter (6,) about it."""
    n = len(means)
    time = np.arange(n) - (n - 1) / 2.0
    spread = float(time @ time)
    slope = time @ means / spread
    left = means - means.mean(axis=0) - np.outer(time, slope)
    scatter = np.sqrt(np.sum(left**2, axis=0) / (n - 2))
    certain = np.abs(slope) > SURE * scatter / math.sqrt(spread)
    slope = np.where(certain, slope, 0.0)
    recent = means[-LEAST_S:]
    # The middle of the last seconds, carried on to now where it certainly moves.
    return Rest(n, recent.mean(axis=0) + slope * (len(recent) / 2.0), slope), scatter
