"""Which frames of a Bota sensor are samples whose time is known, and how many frames are missing between them.

**Time.** A sample bears our own stamp, taken when the package handed the frame over. That is its time only if the frame did
not wait in the package's buffer, which it does while nobody reads: at the start (half a second's worth in 1.1.16), and whenever
the machine stands still. How long it waited is the difference of the two clocks, ours less the package's, above the least that
this difference has been: a frame that waited longer than `patience` (`stall_ns`, or half a period if that is longer) counts as
late. The least is let rise by 1 % of the time, which is more than clocks differ, and is believed once it has not fallen, and no
frame was late, for five times the patience: so what is left of the start's buffer never passes for prompt. A stamp that
went backwards, or a clock that was set, begins this anew. Where the stamp stands still (an interface that has none) frames are
late for five times the patience after each silence.

**Losses** are told by the package's stamp, as far as it goes: it is whole microseconds modulo 2^32 that have been through a
float32 (`findings/bota-driver-float32-stamps.sh`), so that between two stamps an error of up to one step of a float32 of that
size may stand: 2 us after 17 s of the stamp's clock, 256 us after 36 minutes. A step is divided by the period and rounded. As
long as the step of the float32 is less than half a period that is exact (up to 1.9 kHz at its worst, with what is left for
jitter); beyond, what rounding alone could make is taken off first, and single losses pass uncounted. A clock that was set,
or runs backwards, counts as no loss: more cannot be missing than our own clock has room for.

**Doubled** is a frame that equals the last one to the bit, stamp and all. Equal stamps alone mean nothing where periods are
short: rounding makes them equal.
"""

from dataclasses import dataclass

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.bota.codec import Frame


def step_of(before_us: int, after_us: int) -> int | None:
    """Return the us from one stamp to the next, over their turn at 2^32; None where the stamp went backwards."""
    step_us = (after_us - before_us) % (1 << 32)
    return step_us if step_us < 1 << 31 else None


def spacing_of(before_us: int, after_us: int) -> int:
    """Return by how many us rounding may have put two stamps wrong against each other: one step of a float32."""
    return 1 << max(0, max(before_us, after_us).bit_length() - 24)


def missing(before_us: int, after_us: int, period_us: float) -> int:
    """Return how many frames lack between two stamps, for certain; 0 where the stamp went backwards."""
    spacing_us = spacing_of(before_us, after_us)
    margin_us = 0 if 2 * spacing_us < period_us else spacing_us
    return max(0, round(((step_of(before_us, after_us) or 0) - margin_us) / period_us) - 1)


@dataclass(slots=True)
class Sieve:
    """Takes the frames of one stream.

    Args:
        period_ns: of the stream; stall_ns: see above.
        counters: of the device; counts lost, late, doubled.
    """

    period_ns: int
    stall_ns: int
    counters: dict[str, int]
    _last: Frame | None = None
    _last_ns: int = 0
    _begun_ns: int = 0
    _waited_ns: int = 0
    _settled: bool = False
    _settles_ns: int = 0

    def take(self, frame: Frame, t_ns: int) -> bool:
        """Return whether a frame that was received at `t_ns` is a sample of that time."""
        last, pace_ns = self._last, t_ns - self._last_ns
        if frame == last:
            self.counters["doubled"] += 1
            return False
        self._last, self._last_ns = frame, t_ns
        if last is None:
            self._begun_ns = t_ns
            self._unsettle(t_ns)
            prompt = False
        else:
            self._count_lost(last, frame, t_ns)
            prompt = self._is_prompt(last, frame, pace_ns, t_ns)
        self.counters["late"] += not prompt
        return prompt

    @property
    def patience_ns(self) -> int:
        """Longest that a sample may have waited."""
        return max(self.stall_ns, self.period_ns // 2)

    def _is_prompt(self, last: Frame, frame: Frame, pace_ns: int, t_ns: int) -> bool:
        step_us, spacing_us = step_of(last.stamp_us, frame.stamp_us), spacing_of(last.stamp_us, frame.stamp_us)
        if step_us is None:
            self._waited_ns = 0
            self._unsettle(t_ns)
        elif step_us == 0 and self.period_ns >= 2000 * spacing_us:  # no stamp to tell by
            if pace_ns > self.period_ns + self.patience_ns:
                self._unsettle(t_ns)
        else:
            waited_ns = self._waited_ns + pace_ns - 1000 * step_us - min(pace_ns, 1000 * step_us) // 100
            self._waited_ns = max(0, waited_ns)
            late = waited_ns > self.patience_ns + 1000 * spacing_us
            if -waited_ns > self.period_ns // 2 + 1000 * spacing_us or (late and not self._settled):
                self._unsettle(t_ns)
            elif late:
                return False
        self._settled = self._settled or t_ns >= self._settles_ns
        return self._settled

    def _unsettle(self, t_ns: int) -> None:
        self._settled, self._settles_ns = False, t_ns + 5 * self.patience_ns

    def _count_lost(self, last: Frame, frame: Frame, t_ns: int) -> None:
        lost = missing(last.stamp_us, frame.stamp_us, self.period_ns / 1000)
        # The package may have kept a second's frames before it was asked for the first.
        if lost * self.period_ns <= t_ns - self._begun_ns + NS_PER_S:
            self.counters["lost"] += lost
