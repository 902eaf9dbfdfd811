"""What every device says about itself: faults at most once a second a kind, a status a second, sequence numbers."""

from dataclasses import dataclass, field
from typing import Final

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import Output
from galen_hw.messages import Fault, Status

FAR_NS: Final = 1 << 62
"""A wake-up time that never comes (146 years of uptime)."""


@dataclass(slots=True)
class Reporter:
    """Makes the `status` and `fault` messages of one device.

    Args:
        name: of the device in the configuration.
        where: the device for people, e.g. "ft (ATI NETCANOEM, ids 0x200 to 0x20F)".
        time_base: monotonic to wall clock.
    """

    name: str
    where: str
    time_base: TimeBase
    status_due_ns: int = FAR_NS
    _seq: dict[str, int] = field(default_factory=dict)
    _said_ns: dict[str, int] = field(default_factory=dict)
    _reported_ns: int = 0
    _reported_samples: int = 0

    def start(self, now_ns: int) -> None:
        """Publish a status at once, then once a second."""
        self.status_due_ns = now_ns

    def next_seq(self, topic: str) -> int:
        """The next sequence number of a topic."""
        seq = self._seq.get(topic, -1) + 1
        self._seq[topic] = seq
        return seq

    def fault(self, now_ns: int, kind: str, what: str, todo: str = "") -> list[Output]:
        """A fault, or nothing when one of the same kind was published within the last second."""
        said_ns = self._said_ns.get(kind)
        if said_ns is not None and abs(now_ns - said_ns) < NS_PER_S:
            return []
        self._said_ns[kind] = now_ns
        message = Fault(
            timestamp=self.time_base.timestamp(now_ns),
            t_ns=now_ns,
            seq=self.next_seq("fault"),
            valid=True,
            source=self.name,
            what=what,
            where=self.where,
            todo=todo,
        )
        return [("fault", message)]

    def rate_hz(self, now_ns: int, samples: int) -> float:
        """Samples a second since the last status; 0 when no time has passed."""
        elapsed_ns = now_ns - self._reported_ns
        return (samples - self._reported_samples) * NS_PER_S / elapsed_ns if elapsed_ns > 0 else 0.0

    def status(
        self,
        now_ns: int,
        state: str,
        detail: str,
        counters: dict[str, int],
        gauges: dict[str, float],
        todo: str = "",
    ) -> Output:
        """Make the status message and set the time of the next one; `todo`: what to do where the state is not well."""
        self._reported_ns, self._reported_samples = now_ns, counters.get("samples", 0)
        self.status_due_ns = now_ns + NS_PER_S
        message = Status(
            timestamp=self.time_base.timestamp(now_ns),
            t_ns=now_ns,
            seq=self.next_seq("status"),
            valid=True,
            source=self.name,
            state=state,
            detail=detail,
            counters=dict(counters),
            gauges=gauges,
            todo=todo,
        )
        return ("status", message)
