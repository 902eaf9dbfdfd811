"""From what is known to alarms, in an operator's words."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.config.tool_file import ToolFile
from galen_hw.messages import Alarm, TopicHealth
from galen_hw.services.health.alarms import Alarms
from galen_hw.services.health.rest import Floats, Rest, RestWatch, Second
from galen_hw.services.health.settings import HealthSettings

MB: Final = 1e6
STEADY_S: Final = 5
"""Seconds in a row that must be too noisy."""
LOOK: Final = "see galen-hw monitor"
TARE: Final = "if nothing touches the tool, tare it"


@dataclass(frozen=True, slots=True)
class Known:
    """Hold what is known of everything at one time; see `Health`.

    Args:
        todos: what each source says is to be done about itself, empty where it says nothing.
        saturated: samples of the last second that were.
    """

    parts: dict[str, str]
    details: dict[str, str]
    todos: dict[str, str]
    gauges: dict[str, float]
    topics: dict[str, TopicHealth]
    saturated: int


class Judgement:
    """Judges once a second; the alarms are kept in `alarms`."""

    def __init__(self, settings: HealthSettings, alarms: Alarms) -> None:
        self._s, self._alarms = settings, alarms
        self._ratio, self._noisy, self._quiet = math.nan, 0, 0

    def tared(self) -> None:
        """What is left of the wrench at rest is something else from now on."""
        self._alarms.forget("offset")
        self._alarms.forget("drift")

    def noise(self, second: Second | None, tool: ToolFile | None) -> None:
        """Take a second's noise over that of the calibration."""
        if second is None or tool is None or tool.noise_floor is None or not all(x > 0.0 for x in tool.noise_floor):
            self._ratio = math.nan
            return
        self._ratio = max(float(x) / y for x, y in zip(second.noise, tool.noise_floor, strict=True))
        self._noisy = self._noisy + 1 if self._ratio >= self._s.noise_ratio else 0
        self._quiet = self._quiet + 1 if self._ratio < self._s.noise_clear_ratio else 0

    def all(self, known: Known, watch: RestWatch, tool: ToolFile | None, now: tuple[float, float]) -> None:
        """Judge everything; `now`: monotonic s and s since the epoch."""
        self._parts(known, now)
        self._samples(known, now)
        self._machine(known, now)
        self._noise_alarm(now)
        if watch.rest is not None and tool is not None:
            self._offset(watch.rest, now)
            self._drift(watch.rest, now)

    def _parts(self, known: Known, now: tuple[float, float]) -> None:
        for name, state in known.parts.items():
            detail = known.details.get(name, "")
            words = f"{name}: {detail}" if detail and state != "silent" else f"{name} is {state}"
            # What a silent part has said last is of another trouble.
            todo = (known.todos.get(name, "") if state != "silent" else "") or LOOK
            self._say(f"part {name}", "fault", words, todo, now, bad=state in ("fault", "silent"))
            self._say(f"degraded {name}", "advice", words, todo, now, bad=state == "degraded")

    def _samples(self, known: Known, now: tuple[float, float]) -> None:
        n, lost = known.saturated, known.gauges.get("lost_share", math.nan)
        words = f"the sensor was at its limit in {n} samples of the last second"
        self._say(
            "saturation", "warning", words, "take the load off; zero or repair it if nothing loads it", now, bad=n > 0
        )
        words = f"{100 * lost:.2g} % of the samples were lost on the way"
        self._judge(
            "losses", "warning", lost, (self._s.lost_share, self._s.lost_share), words, "is the machine too busy?", now
        )
        wrench = known.topics.get("wrench/compensated")
        if wrench is not None:
            words = f"wrenches are {1e3 * wrench.p99_s:.3g} ms old when they leave (1 in 100)"
            limits = (self._s.late_s, self._s.late_clear_s)
            self._judge("latency", "warning", wrench.p99_s, limits, words, "end what else runs on this machine", now)

    def _machine(self, known: Known, now: tuple[float, float]) -> None:
        s = self._s
        load = max((v for k, v in known.gauges.items() if " bus_load_share " in k), default=math.nan)
        words, limits = f"the CAN bus is {100 * load:.0f} % full", (s.bus_load_share, s.bus_load_clear_share)
        self._judge(
            "bus load", "warning", load, limits, words, "lower the sensor's rate, or give it a bus of its own", now
        )
        free = _gauge(known, " disk_free_bytes")
        words = f"only {free / MB:.0f} MB are free on the disk of the calibrations"
        self._judge("disk", "warning", free, (s.disk_free_mb * MB, s.disk_clear_mb * MB), words, "make room", now)
        hot = _gauge(known, " machine_temperature_c")
        words = f"the computer is at {hot:.0f} degrees"
        self._judge("hot", "warning", hot, (s.machine_c, s.machine_clear_c), words, "look at its fans", now)
        days, most = known.gauges.get("calibration_age_days", math.nan), s.old_calibration_days
        words = f"the calibration in use is {days:.0f} days old"
        self._judge(
            "old calibration", "advice", days if most else math.nan, (most, most), words, "calibrate again", now
        )

    def _noise_alarm(self, now: tuple[float, float]) -> None:
        on = self._alarms.is_on("noise")
        bad = self._noisy >= STEADY_S or (on and self._quiet < STEADY_S)
        if not math.isnan(self._ratio) or not on:
            words = f"the sensor's noise is {self._ratio:.1f} times that of the calibration"
            todo = "check the sensor's cable and what vibrates; then calibrate again"
            self._say("noise", "warning", words, todo, now, bad=bad)

    def _offset(self, rest: Rest, now: tuple[float, float]) -> None:
        s = self._s
        force, torque = _norm(rest.offset[:3]), _norm(rest.offset[3:])
        share = max(force / s.felt_force_n, torque / s.felt_torque_nm)
        level = "warning" if share >= 1.0 else "advice"
        words = f"the wrench at rest is {force:.2f} N and {1e3 * torque:.0f} N mm off zero" + (
            ", which a hand feels" if share >= 1.0 else ""
        )
        self._judge("offset", level, share, (s.advise_share, s.clear_share), words, TARE, now)

    def _drift(self, rest: Rest, now: tuple[float, float]) -> None:
        """A drift is as bad as the time is short in which it will be felt."""
        s = self._s
        force, torque = _norm(rest.slope[:3]), _norm(rest.slope[3:])
        each_s = max(force / s.felt_force_n, torque / s.felt_torque_nm)
        left = (1.0 - self._share(rest)) / each_s if each_s > 0.0 else math.inf
        level = "warning" if left <= s.ahead_s / 10.0 else "advice"
        when = "it is felt already" if left <= 0.0 else f"felt in {_duration(left)}"
        words = f"the wrench at rest drifts by {_rate(force, 'N')} and {_rate(1e3 * torque, 'N mm')}: {when}"
        self._judge("drift", level, max(0.0, left), (s.ahead_s, 2.0 * s.ahead_s), words, TARE, now)

    def _share(self, rest: Rest) -> float:
        return max(_norm(rest.offset[:3]) / self._s.felt_force_n, _norm(rest.offset[3:]) / self._s.felt_torque_nm)

    def _say(self, cause: str, level: str, what: str, todo: str, now: tuple[float, float], *, bad: bool) -> None:
        since = self._alarms.since(cause, now[1])
        alarm = Alarm(cause=cause, level=level, what=what, todo=todo, since=since)
        self._alarms.state(cause, now, (lambda: alarm) if bad else None)

    def _judge(
        self,
        cause: str,
        level: str,
        value: float,
        limits: tuple[float, float],
        what: str,
        todo: str,
        now: tuple[float, float],
    ) -> None:
        alarm = Alarm(cause=cause, level=level, what=what, todo=todo, since=self._alarms.since(cause, now[1]))
        self._alarms.judge(cause, value, *limits, now, lambda: alarm)


def _gauge(known: Known, ending: str) -> float:
    return next((v for k, v in known.gauges.items() if k.endswith(ending)), math.nan)


def _norm(vector: Floats) -> float:
    return float(np.linalg.norm(vector))


def _rate(value: float, unit: str) -> str:
    """A rate in the unit of time in which it is a number for people."""
    return f"{value:.2g} {unit}/s" if value >= 0.01 else f"{60.0 * value:.2g} {unit}/min"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"
