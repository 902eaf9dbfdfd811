"""What has been heard on the bus: every topic with its rate, age and losses, and the last status of each source."""

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import msgspec

from galen_hw.messages import TOPICS, Fault, Message, Status

if TYPE_CHECKING:
    from galen_hw.bus import Subscriber

WINDOW_S: Final = 2.0
PERIODS: Final = 3.0
"""Of a topic's nominal rate without a message, after which it is silent."""
LEAST_S: Final = 0.5
"""But no sooner: on a busy machine everything waits so long now and then."""


def fresh_for_s(topic: str) -> float:
    """How old the last message of a topic may be before nothing of it counts any more, s; events are never too old."""
    rate_hz = TOPICS[topic].rate_hz
    return max(LEAST_S, PERIODS / rate_hz) if rate_hz else math.inf


@dataclass
class TopicView:
    """What has been heard of one topic within the last seconds.

    Args:
        message: the last one, of time `heard_s` (monotonic, s).
    """

    message: Message
    heard_s: float = 0.0
    times: "deque[float]" = field(default_factory=deque)
    messages: int = 0
    valid: int = 0


class View:
    """What has been heard of every topic, and the last status of each source with the time at which it came."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicView] = {}
        self.statuses: dict[str, tuple[Status, float]] = {}
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
        seen.message, seen.heard_s = message, now
        seen.messages += 1
        seen.valid += message.valid
        seen.times.append(now)
        while seen.times[0] < now - WINDOW_S:
            seen.times.popleft()
        if isinstance(message, Status):
            self.statuses[message.source] = message, now
        elif isinstance(message, Fault):
            self.last_fault_s = now
            self.last_fault = f"{message.where or message.source}: {message.what}; {message.todo}".rstrip("; ")

    def age_s(self, topic: str, now: float) -> float:
        """Age of what the last message tells, s: since it was read from the wire, or since it came here."""
        seen = self.topics[topic]
        return now - min(seen.heard_s, seen.message.t_ns / 1e9)

    def is_old(self, topic: str, now: float) -> bool:
        """Return whether the last message must not be taken for the present any more, whatever it says of itself."""
        return self.age_s(topic, now) > fresh_for_s(topic)

    def is_silent(self, source: str, now: float) -> bool:
        """Return whether a source has not said for too long how it is."""
        return now - self.statuses[source][1] > fresh_for_s("status")

    def rate_hz(self, topic: str, now: float) -> float:
        """Messages a second over the window."""
        recent = [t for t in self.topics[topic].times if t > now - WINDOW_S]
        return len(recent) / max(1e-3, min(WINDOW_S, now - self._since))

    def as_json(self, lost: dict[str, int]) -> dict[str, Any]:
        """Everything, for scripts; numbers that are not finite become null, what is old is not valid, a source may be silent."""
        now = time.monotonic()
        topics = {
            name: {
                "rate_hz": round(self.rate_hz(name, now), 2),
                "age_s": round(self.age_s(name, now), 6),
                "old": self.is_old(name, now),
                "messages": seen.messages,
                "lost": lost.get(name, 0),
                "valid": seen.message.valid and not self.is_old(name, now),
                "valid_share": round(seen.valid / seen.messages, 4),
                "last": _finite(msgspec.to_builtins(seen.message)),
            }
            for name, seen in sorted(self.topics.items())
        }
        status = {
            name: _finite(msgspec.to_builtins(s)) | ({"state": "silent"} if self.is_silent(name, now) else {})
            for name, (s, _) in sorted(self.statuses.items())
        }
        return {"topics": topics, "status": status, "last_fault": self.last_fault}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
