"""Gathers what devices, services and processes say of themselves into one topic, and says once what needs an operator.

Pure: what must be measured (ages, loads, the disk) is measured where it happens and comes in `status`; what only the wrench
can tell (losses, noise, drift) is told from the wrench.
"""

import math
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, ClassVar, Final

from pydantic import BaseModel

from galen_hw.clock import NS_PER_S
from galen_hw.config.tool_file import ToolFile, parse_tool
from galen_hw.errors import GalenError, WrongCommandError
from galen_hw.messages import (
    TOPICS,
    CompensationState,
    Fault,
    Health,
    JointsState,
    Message,
    Request,
    Status,
    TopicHealth,
    WrenchCompensated,
)
from galen_hw.services.health.alarms import Alarms
from galen_hw.services.health.judgement import Judgement, Known
from galen_hw.services.health.rest import RestWatch
from galen_hw.services.health.settings import HealthSettings
from galen_hw.services.service import Output, Service, ServiceContext
from galen_hw.version import VERSION

SILENT_NS: Final = 3 * NS_PER_S
"""Three periods of `status`."""
MOST_SOURCES: Final = 64
SAID: Final = ("part ", "degraded ")
"""Causes that their source tells of itself, unless it is silent."""
COUNTED: Final = ("wrench/compensated", "wrench/contact")
"""Whose losses and validity are known: the second is made of the same samples, with their `valid`."""
MOST_LOST: Final = 1_000_000
"""Of one gap in `seq`; what is beyond is no loss."""


class HealthService(Service):
    """Publishes `health` once a second, and a `fault` for each alarm when it comes; it takes no requests."""

    Settings: ClassVar[type[BaseModel]] = HealthSettings
    consumes: ClassVar[tuple[str, ...]] = ("wrench/compensated", "compensation/state", "joints/state", "status")
    produces: ClassVar[tuple[str, ...]] = ("health", "fault", "status")
    patience_s: ClassVar[float] = 0.05
    takes_old: ClassVar[bool] = True  # It counts: what it passed over when it is late itself would look like a loss.

    def __init__(self, name: str, settings: HealthSettings, context: ServiceContext) -> None:
        self.name, self._context = name, context
        self._rest = RestWatch()
        self._alarms = Alarms()
        self._judgement = Judgement(settings, self._alarms)
        self._statuses: dict[str, tuple[Status, int]] = {}
        self._before: dict[str, Status] = {}
        self._tool_text = ""
        self._tool: ToolFile | None = None
        self._tare: tuple[float, ...] = ()
        self._last_seq = -1
        self._samples = self._lost = self._valid = 0
        self._all = {"samples": 0, "lost": 0}
        self._seq = dict.fromkeys(self.produces, 0)
        self._next_ns = 0

    def handle(self, topic: str, message: Message, now_ns: int) -> list[Output]:
        """Take a wrench, a state, joints or a status."""
        if type(message) is WrenchCompensated:
            self._count(message)
            if self._rest.take(message):
                self._judgement.noise(self._rest.second, self._tool)
        elif type(message) is JointsState:
            if any(message.moving.values()):
                self._rest.interrupt()
        elif type(message) is CompensationState:
            self._take_state(message)
        elif type(message) is Status and (message.source in self._statuses or len(self._statuses) < MOST_SOURCES):
            if message.source in self._statuses:
                self._before[message.source] = self._statuses[message.source][0]
            self._statuses[message.source] = message, now_ns
        return []

    def _count(self, message: WrenchCompensated) -> None:
        gap = message.seq - self._last_seq - 1
        if self._last_seq >= 0 and 0 < gap <= MOST_LOST:
            self._lost += gap
        self._last_seq = message.seq
        self._samples += 1
        self._valid += message.valid

    def _take_state(self, message: CompensationState) -> None:
        if (tare := tuple(message.tare)) != self._tare:
            self._tare = tare
            self._rest.interrupt()
            self._judgement.tared()
        if message.tool_file != self._tool_text:
            self._tool_text, self._tool = message.tool_file, _tool(message.tool_file)
            self._judgement.tared()

    def tick(self, now_ns: int) -> list[Output]:
        """Once a second: judge, and say."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + NS_PER_S
        wall_s = self._context.time_base.timestamp(now_ns)
        self._all["samples"] += self._samples
        self._all["lost"] += self._lost
        known = self._known(now_ns)
        self._judgement.all(known, self._rest, self._tool, (now_ns / NS_PER_S, wall_s))
        outputs: list[Output] = [("health", self._health(known, now_ns))]
        for alarm in self._alarms.take_raised():
            if alarm.cause.startswith(SAID) and known.parts.get(alarm.cause.partition(" ")[2]) != "silent":
                continue
            header = self._header("fault", now_ns)
            outputs.append(("fault", Fault(**header, valid=True, what=alarm.what, where=self.name, todo=alarm.todo)))
        count = len(self._alarms.all())
        detail = f"{count} alarm{'s' if count > 1 else ''}" if count else "no alarm"
        outputs.append(("status", Status(**self._header("status", now_ns), valid=True, state="ready", detail=detail)))
        self._samples = self._lost = self._valid = 0
        return outputs

    def _known(self, now_ns: int) -> Known:
        """What is known of everything now."""
        fresh = {n: s for n, (s, heard) in self._statuses.items() if 0 <= now_ns - heard <= SILENT_NS}
        parts = {n: fresh[n].state if n in fresh else "silent" for n in self._statuses}
        details = {n: s.detail for n, (s, _) in self._statuses.items()}
        todos = {n: s.todo for n, (s, _) in self._statuses.items()}
        gauges = self._gauges(fresh)
        return Known(parts, details, todos, gauges, self._topics(fresh), self._grown(fresh, "saturated"))

    def _gauges(self, fresh: Mapping[str, Status]) -> dict[str, float]:
        found = {f"{name} {key}": value for name, status in fresh.items() for key, value in status.gauges.items()}
        total = self._samples + self._lost
        found["lost_share"] = self._lost / total if total else math.nan
        second, rest = self._rest.second, self._rest.rest
        if second is not None:
            found["noise_n"], found["noise_nm"] = float(second.noise[:3].max()), float(second.noise[3:].max())
        if self._tool is not None and self._tool.noise_floor is not None:
            floor = self._tool.noise_floor
            found["calibration_noise_n"], found["calibration_noise_nm"] = max(floor[:3]), max(floor[3:])
        if rest is not None:
            found["rest_s"] = float(rest.seconds)
            found["rest_force_n"], found["rest_torque_nm"] = _size(rest.offset[:3]), _size(rest.offset[3:])
            found["drift_n_per_s"], found["drift_nm_per_s"] = _size(rest.slope[:3]), _size(rest.slope[3:])
        if self._tool is not None and self._tool.origin is not None:
            made = _epoch(self._tool.origin.date)
            found["calibration_age_days"] = (self._context.time_base.timestamp(self._next_ns) - made) / 86400.0
        return found

    def _topics(self, fresh: Mapping[str, Status]) -> dict[str, TopicHealth]:
        """Rates and ages of what the processes of the daemon have published between their last two statuses."""
        found: dict[str, TopicHealth] = {}
        for source, status in fresh.items():
            before = self._before.get(source)
            elapsed = (status.t_ns - before.t_ns) / NS_PER_S if before is not None else 0.0
            if not source.startswith("daemon.") or before is None or not elapsed > 0.0:
                continue
            for name, topic in TOPICS.items():
                key = f"published {name}"
                if topic.rate_hz and key in status.counters:
                    rate = max(0, status.counters[key] - before.counters.get(key, 0)) / elapsed
                    ages = {f"{w}_s": status.gauges.get(f"{w}_s {name}", 0.0) for w in ("p50", "p99", "worst")}
                    found[name] = self._topic(name, rate, topic.rate_hz, ages, found.get(name))
        return found

    def _topic(
        self, name: str, rate: float, nominal: float, ages: Mapping[str, float], other: TopicHealth | None
    ) -> TopicHealth:
        """One row; several processes publish `status`."""
        if other is not None:
            rate += other.rate_hz
        if name not in COUNTED or not self._samples:
            return TopicHealth(rate_hz=rate, nominal_hz=nominal, **ages)
        lost, valid = self._lost / (self._samples + self._lost), self._valid / self._samples
        return TopicHealth(rate_hz=rate, nominal_hz=nominal, lost_share=lost, valid_share=valid, **ages)

    def _grown(self, fresh: Mapping[str, Status], counter: str) -> int:
        """By how much a counter of the sensor has grown between its last two statuses."""
        name = self._context.sensor
        if name not in fresh or name not in self._before:
            return 0
        return max(0, fresh[name].counters.get(counter, 0) - self._before[name].counters.get(counter, 0))

    def _health(self, known: Known, now_ns: int) -> Health:
        return Health(
            **self._header("health", now_ns),
            valid=True,
            state=self._alarms.worst,
            alarms=self._alarms.all(),
            parts=known.parts,
            details=known.details,
            topics=known.topics,
            gauges=known.gauges,
            counters=dict(self._all),
            versions={"galen_hw": VERSION, "python": platform.python_version(), "kernel": platform.release()},
        )

    def _header(self, topic: str, t_ns: int) -> dict[str, Any]:
        self._seq[topic] += 1
        timestamp = self._context.time_base.timestamp(t_ns)
        return {"timestamp": timestamp, "t_ns": t_ns, "seq": self._seq[topic] - 1, "source": self.name}

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """Refuse: there is nothing to ask for.

        Raises:
            WrongCommandError: always.
        """
        raise WrongCommandError(f"no command {request.name!r}", where=self.name, todo="see galen-hw status")

    def snapshot(self) -> dict[str, Any]:
        """Nothing outlives the process."""
        return {"version": 1, "identity": self._context.identity}

    def restore(self, state: dict[str, Any]) -> bool:
        """Take a snapshot back."""
        return (state.get("version"), state.get("identity")) == (1, self._context.identity)


def _tool(text: str) -> ToolFile | None:
    try:
        return parse_tool(text, "compensation/state") if text else None
    except GalenError:
        return None


def _size(vector: Any) -> float:
    return float(math.sqrt(sum(float(x) ** 2 for x in vector)))


def _epoch(date: str) -> float:
    """Seconds since the epoch of an ISO date, NaN where it is none."""
    try:
        found = datetime.fromisoformat(date)
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError, OSError):
        return math.nan
