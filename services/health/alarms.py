"""Alarms that do not flicker: each comes beyond one limit and goes below another, and stays a while."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from galen_hw.messages import Alarm

LEVELS: Final = ("good", "advice", "warning", "fault")
HOLD_S: Final = 3.0
"""An alarm whose cause is over stays so long, so that one can read it."""


@dataclass(slots=True)
class _Gate:
    """One alarm: whether it is on, since when (s since the epoch), and when its cause was last seen (monotonic s)."""

    alarm: Alarm
    seen_s: float


@dataclass(slots=True)
class Alarms:
    """All alarms that are on, by cause; `raised` are those that have come since it was asked last."""

    _on: dict[str, _Gate] = field(default_factory=dict)
    _raised: list[Alarm] = field(default_factory=list)

    def is_on(self, cause: str) -> bool:
        """Return whether an alarm of this cause is on."""
        return cause in self._on

    def judge(
        self, cause: str, value: float, on: float, off: float, now: tuple[float, float], say: Callable[[], Alarm]
    ) -> None:
        """Look at a value: on at or beyond `on`, off below `off`; with `on` < `off` it is small values that are bad.

        Args:
            now: monotonic s and s since the epoch; say: the alarm's words; NaN changes nothing.
        """
        if math.isnan(value):
            return
        sign = 1.0 if on >= off else -1.0
        bad = sign * value >= sign * (off if self.is_on(cause) else on)
        self.state(cause, now, say if bad else None)

    def state(self, cause: str, now: tuple[float, float], say: Callable[[], Alarm] | None) -> None:
        """Set an alarm by its cause alone: `say` while it is there, None when it is not."""
        gate = self._on.get(cause)
        if say is not None:
            alarm = say()
            if gate is None:
                self._raised.append(alarm)
            self._on[cause] = _Gate(alarm, now[0])
        elif gate is not None and not 0.0 <= now[0] - gate.seen_s < HOLD_S:
            del self._on[cause]

    def forget(self, cause: str) -> None:
        """What an alarm was about is not there any more."""
        self._on.pop(cause, None)

    def since(self, cause: str, wall_s: float) -> float:
        """Since when an alarm is on; `wall_s` if it is not."""
        gate = self._on.get(cause)
        return wall_s if gate is None else gate.alarm.since

    def all(self) -> list[Alarm]:
        """Those that are on, the worst first."""
        return sorted((g.alarm for g in self._on.values()), key=lambda a: (-LEVELS.index(a.level), a.since, a.cause))

    @property
    def worst(self) -> str:
        """Level of the worst one, "good" if there is none."""
        return max((g.alarm.level for g in self._on.values()), key=LEVELS.index, default=LEVELS[0])

    def take_raised(self) -> list[Alarm]:
        """Those that have come since the last call."""
        raised, self._raised = self._raised, []
        return raised
