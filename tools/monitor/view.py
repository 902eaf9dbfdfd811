"""What has been heard on the bus: every topic with its rate, age and losses, and the last status of each source."""

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from galen_hw.messages import Fault, Message, Status

if TYPE_CHECKING:
    from galen_hw.bus import Subscriber

WINDOW_S: Final = 2.0


@dataclass
class TopicView:
    """What has been heard of one topic within the last seconds."""

    message: Message
    times: "deque[float]" = field(default_factory=deque)
    messages: int = 0
    valid: int = 0


class View:
    """What has been heard of every topic, and the last status of each source."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicView] = {}
        self.statuses: dict[str, Status] = {}
        self.last_fault, self.last_fault_s = "", 0.0
        self._since = time.monotonic()

    def listen(self, subscriber: "Subscriber", seconds: float) -> None:
        """Take what comes for so long."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            received = subscriber.receive(left)
            if received is not None:
                self.take(*received, now=time.monotonic())

    def take(self, topic: str, message: Message, now: float) -> None:
        """Count one message."""
        seen = self.topics.setdefault(topic, TopicView(message))
        seen.message = message
        seen.messages += 1
        seen.valid += message.valid
        seen.times.append(now)
        while seen.times[0] < now - WINDOW_S:
            seen.times.popleft()
        if isinstance(message, Status):
            self.statuses[message.source] = message
        elif isinstance(message, Fault):
            self.last_fault_s = now
            self.last_fault = f"{message.where or message.source}: {message.what}; {message.todo}".rstrip("; ")

    def rate_hz(self, topic: str, now: float) -> float:
        """Messages a second over the window."""
        recent = [t for t in self.topics[topic].times if t > now - WINDOW_S]
        return len(recent) / max(1e-3, min(WINDOW_S, now - self._since))

    def as_json(self, lost: dict[str, int]) -> dict[str, Any]:
        """Everything, for scripts; numbers that are not finite become null."""
        import msgspec

        now, now_ns = time.monotonic(), time.monotonic_ns()
        topics = {
            name: {
                "rate_hz": round(self.rate_hz(name, now), 2),
                "age_s": round((now_ns - seen.message.t_ns) / 1e9, 6),
                "messages": seen.messages,
                "lost": lost.get(name, 0),
                "valid": seen.message.valid,
                "valid_share": round(seen.valid / seen.messages, 4),
                "last": _finite(msgspec.to_builtins(seen.message)),
            }
            for name, seen in sorted(self.topics.items())
        }
        status = {name: _finite(msgspec.to_builtins(s)) for name, s in sorted(self.statuses.items())}
        return {"topics": topics, "status": status, "last_fault": self.last_fault}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
