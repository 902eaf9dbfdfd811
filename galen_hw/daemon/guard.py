"""Watches, in the process of the motors, whether the daemon still feels what the arm does; pure, time is an argument."""

from collections.abc import Callable, Collection, Mapping
from typing import Final

from galen_hw.clock import NS_PER_S

LONGEST_STEP_NS: Final = NS_PER_S // 40
"""Of the time between two joint states, what counts at most: a stall of the whole machine is nobody's silence."""


class Guard:
    """Says that the arm must not move, since nobody would feel it: no samples of the sensor, or no core process.

    Only time in which the motors are heard counts: a motor that is not heard cannot be told to stop either, and the
    time-out on its controller stands in. What never gave a sign of life is not missed, but nothing moves before it has.

    Args:
        signs: by what is missed without it ("no wrench"): when it was seen last, monotonic ns, 0 for never.
        after_s: silence that is taken for blindness.
        optional: those that are not waited for, but missed once they have been there.
    """

    def __init__(self, signs: Mapping[str, Callable[[], int]], after_s: float, optional: Collection[str] = ()) -> None:
        self._signs, self._after_ns = dict(signs), round(after_s * NS_PER_S)
        self._awaited = [what for what in signs if what not in optional]
        self._seen = dict.fromkeys(signs, 0)
        self._missed_ns = dict.fromkeys(signs, 0)
        self._known: set[str] = set()
        self._heard_ns = 0

    def heard(self, now_ns: int) -> None:
        """The motors have been heard; look whether the others have since."""
        step = min(now_ns - self._heard_ns, LONGEST_STEP_NS) if self._heard_ns else 0
        self._heard_ns = now_ns
        for what, seen in self._signs.items():
            last = seen()
            if last != self._seen[what]:
                self._seen[what], self._missed_ns[what] = last, 0
                if last:
                    self._known.add(what)
                    continue
            self._missed_ns[what] += step

    @property
    def blind(self) -> str:
        """What is missed though it had been there, and for how long; empty if nothing is."""
        found = [(ns, what) for what, ns in self._missed_ns.items() if what in self._known and ns > self._after_ns]
        return f"{found[0][1]} for {found[0][0] / NS_PER_S:.2g} s" if found else ""

    @property
    def missing(self) -> str:
        """What forbids a motion: blindness, or what has not been there yet; empty if all is well."""
        awaited = next((what for what in self._awaited if what not in self._known), "")
        return self.blind or (f"{awaited} yet" if awaited else "")
