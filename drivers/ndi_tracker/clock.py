"""The tracker's frame number as the sample clock: host time of a frame from the least delayed of the recent replies."""

from collections import deque
from typing import Final, Literal, TypeAlias

from galen_hw.clock import NS_PER_S

Event: TypeAlias = Literal["", "restart", "jump"]

AHEAD_NS: Final = NS_PER_S // 10
BEHIND_NS: Final = NS_PER_S // 2
BEHIND_TIMES: Final = 10


class FrameClock:
    """Host time of frame n = n * period + offset; offset is the least (read time - n * period) of a sliding window.

    A reply can be late (transmission, adapter, scheduler), never early: so the least delayed reply of the window is
    the best one. The window bounds what a difference of the two clocks can add: 50 ppm over 10 s is 0.5 ms. The
    constant part of the delay (exposure, the tracker's own computing, the least transmission) stays in: see the
    setting `latency_s`.

    Args:
        period_ns: of one frame.
        window_frames: length of the window.
    """

    def __init__(self, period_ns: float, window_frames: int = 600) -> None:
        self._period_ns, self._window = period_ns, window_frames
        self.reset()

    def reset(self) -> None:
        """Forget the offset."""
        self._least: deque[tuple[int, int]] = deque()
        self._last_frame: int | None = None
        self._behind = 0

    def take(self, frame: int, t_ns: int) -> Event:
        """Learn from a frame read at `t_ns`; says whether the counter began again, or left the host's time."""
        offset = t_ns - self._since_zero(frame)
        event = self._event(frame, offset)
        if event:
            self.reset()
        if frame != self._last_frame:
            self._last_frame = frame
            while self._least and self._least[-1][1] >= offset:
                self._least.pop()
            self._least.append((frame, offset))
            while self._least[0][0] < frame - self._window:
                self._least.popleft()
        return event

    def time_of(self, frame: int) -> int:
        """Host time of a frame; `take` has been called before."""
        return self._least[0][1] + self._since_zero(frame)

    def _event(self, frame: int, offset: int) -> Event:
        if self._last_frame is None:
            return ""
        if frame < self._last_frame:
            return "restart"
        least = self._least[0][1]
        if offset < least - AHEAD_NS:
            return "jump"
        self._behind = self._behind + 1 if offset > least + BEHIND_NS and frame != self._last_frame else 0
        return "jump" if self._behind >= BEHIND_TIMES else ""

    def _since_zero(self, frame: int) -> int:
        return round(frame * self._period_ns)
