"""What the pages are shown: the bus, heard in a thread of its own while a page is open."""

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from galen_hw.bus import BATCH_TOPIC, CommandClient, Subscriber
from galen_hw.config.load import load
from galen_hw.config.paths import Addresses
from galen_hw.config.robot import build_robot
from galen_hw.daemon.tables import TABLES
from galen_hw.decoding import UnreadableError, decode_batch, decode_message
from galen_hw.errors import GalenError
from galen_hw.kinematics import Robot
from galen_hw.messages import (
    CalibrationProgress,
    CompensationState,
    Fault,
    Health,
    JointsState,
    Message,
    Pose,
    WrenchCompensated,
    WrenchRaw,
)
from galen_hw.tools.dashboard.arm import arm_lines, positions
from galen_hw.tools.dashboard.bins import Bins

TURN_S: Final = 0.02
MOST: Final = 500
"""Messages that one turn looks into, a fifth of a second of them: where more had piled up, the rest is only read past, for the
present is what is wanted."""
LOOK_S: Final = 1.0
ANSWER_S: Final = 0.5
SILENT_S: Final = 0.5
KEPT_FAULTS: Final = 20
WRENCHES: Final = ("wrench/raw", "wrench/compensated")
SHOWN: Final = (
    *WRENCHES,
    "joints/state",
    "pose/reported",
    "pose/corrected",
    "compensation/state",
    "health",
    "fault",
    "calibration/progress",
)


class Feed:
    """Hears the bus between `open` and `close`, which are counted: one for each page.

    Args:
        addresses: of the daemon, which may come and go.
    """

    def __init__(self, addresses: Addresses) -> None:
        self._addresses = addresses
        self._pages = 0
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._threads: list[threading.Thread] = []
        self._robot: Robot | None = None
        self._config = ""
        self.bins = Bins()
        self.info: dict[str, Any] = {}
        self.faults: list[dict[str, Any]] = []
        self.fault_count = 0
        self._last: dict[str, bytes] = {}
        self._heard_s: dict[str, float] = {}
        self.unreadable = 0

    def open(self) -> None:
        """A page is there: hear, if nobody does yet."""
        with self._lock:
            self._pages += 1
            if self._pages == 1:
                self._end = threading.Event()
                self._last, self._heard_s = {}, {}  # what was heard before nobody looked is no silence of anything
                jobs = (self._hear, self._look)
                self._threads = [threading.Thread(target=job, daemon=True) for job in jobs]
                for thread in self._threads:
                    thread.start()

    def close(self) -> None:
        """A page is gone; after the last one nothing is heard, and nothing costs anything."""
        with self._lock:
            self._pages -= 1
            if self._pages == 0:
                self._end.set()

    def last(self, topic: str) -> Message | None:
        """The newest message of a topic."""
        payload = self._last.get(topic)
        if payload is None:
            return None
        try:
            return decode_message(topic.encode(), payload)[1]
        except UnreadableError:
            self.unreadable += 1
            return None

    def _hear(self) -> None:
        end, bins = self._end, self.bins
        with Subscriber(self._addresses.batches, (BATCH_TOPIC, *SHOWN)) as subscriber:
            while not end.wait(TURN_S):
                taken = 0
                while (frames := subscriber.receive_bytes(0.0)) is not None and not end.is_set():
                    taken += self._take_batch(frames[1], bins if taken < MOST else None)

    def _take_batch(self, batch: bytes, bins: Bins | None) -> int:
        """Take the messages of a batch; return how many there were."""
        try:
            messages = decode_batch(batch)
        except UnreadableError:
            self.unreadable += 1
            return 0
        for topic, payload in messages:
            self._take(topic, payload, bins)
        return len(messages)

    def _take(self, topic: bytes, payload: bytes, bins: Bins | None) -> None:
        """Take a message; without `bins` the traces stay empty where it was measured."""
        name = topic.decode(errors="replace")
        self._last[name] = payload
        self._heard_s[name] = time.monotonic()
        if (bins is None or name not in WRENCHES) and name != "fault":
            return
        try:
            message = decode_message(topic, payload)[1]
        except UnreadableError:
            self.unreadable += 1
            return
        if bins is not None and isinstance(message, WrenchRaw | WrenchCompensated):
            bins.add(message)
        elif isinstance(message, Fault):
            said = {"at": message.timestamp, "where": message.where or message.source}
            self.faults = [*self.faults[1 - KEPT_FAULTS :], said | {"what": message.what, "todo": message.todo}]
            self.fault_count += 1

    def _look(self) -> None:
        """Ask the daemon what it is, again and again: it may be another one."""
        end = self._end
        while True:
            self.info = self._ask()
            if self.info and self.info["config"] != self._config:
                self._config = self.info["config"]
                self._robot = self._read_robot()
            if end.wait(LOOK_S):
                return

    def _ask(self) -> dict[str, Any]:
        with suppress(GalenError):
            self._addresses.require_daemon()
            with CommandClient(self._addresses.command) as client:
                return client.call("daemon", "info", timeout_s=ANSWER_S)
        return {}

    def _read_robot(self) -> Robot | None:
        """The configured robot; None, and no drawing, where its settings cannot be read from here."""
        try:
            return build_robot(load(Path(self._config), TABLES).config)
        except GalenError:
            return None

    def live(self) -> dict[str, Any]:
        """All that changes fast, as a page is sent it; ages in s."""
        now = time.monotonic()
        raw, done = self.last("wrench/raw"), self.last("wrench/compensated")
        state, joints = self.last("compensation/state"), self.last("joints/state")
        found: dict[str, Any] = {"type": "live", "now": now, "ages": self._ages(now), "why": self._why(now, raw, done)}
        if isinstance(state, CompensationState):
            found |= {"tool": state.tool, "calibration": state.calibration, "enabled": state.enabled}
            found["tared"] = any(abs(x) > 0.0 for x in state.tare)
        if isinstance(joints, JointsState):
            found["joints"] = {"position": joints.position, "moving": any(joints.moving.values())}
            found["joints"] |= {"estop": joints.estop, "enabled": all(joints.enabled.values())}
            found["arm"] = self._arm(joints, done)
        progress = self.last("calibration/progress")
        if isinstance(progress, CalibrationProgress) and now - self._heard_s["calibration/progress"] < 2.0:
            found["progress"] = {"state": progress.state, "pose": progress.pose, "poses": progress.poses}
            found["progress"] |= {"remaining_s": progress.remaining_s, "detail": progress.detail}
        return found

    def _ages(self, now: float) -> dict[str, float]:
        """Of the newest message of each topic, since it was measured or since it came, whichever is longer ago."""
        ages = {}
        for topic in ("wrench/raw", "wrench/compensated", "joints/state", "pose/reported", "health"):
            message = self.last(topic)
            if message is not None:
                ages[topic] = round(now - min(message.t_ns / 1e9, self._heard_s[topic]), 3)
        return ages

    def _why(self, now: float, raw: Message | None, done: Message | None) -> str:
        """See `why_not_valid`."""
        if not self.info:
            return "No robot: the daemon does not run"
        raw = raw if isinstance(raw, WrenchRaw) else None
        done = done if isinstance(done, WrenchCompensated) else None
        return why_not_valid(now, raw, done, now - self._heard_s.get("wrench/raw", -SILENT_S))

    def _arm(self, joints: JointsState, done: Message | None) -> dict[str, Any]:
        found: dict[str, Any] = {}
        q = positions(self._robot, joints) if self._robot is not None else None
        if self._robot is not None and q is not None:
            found = arm_lines(self._robot, q)
            rotation = found.pop("rotation")
            if isinstance(done, WrenchCompensated):
                f = (done.force.x, done.force.y, done.force.z)
                found["force"] = [sum(r * x for r, x in zip(row, f, strict=True)) for row in rotation]
        for key, topic in (("tip", "pose/reported"), ("corrected", "pose/corrected")):
            pose = self.last(topic)
            if isinstance(pose, Pose) and time.monotonic() - pose.t_ns / 1e9 < SILENT_S:
                found[key] = [pose.position.x, pose.position.y, pose.position.z]
                found[f"{key}_model"] = pose.model
        return found

    def health(self) -> dict[str, Any] | None:
        """The newest health, with its age; None before there was one."""
        found = self.last("health")
        if not isinstance(found, Health):
            return None
        alarms = [{"level": a.level, "what": a.what, "todo": a.todo, "since": a.since} for a in found.alarms]
        topics = {n: {"rate_hz": t.rate_hz, "p99_s": t.p99_s, "lost": t.lost_share} for n, t in found.topics.items()}
        head = {"type": "health", "state": found.state, "age_s": time.monotonic() - self._heard_s["health"]}
        gauges = found.gauges
        return head | {
            "alarms": alarms,
            "parts": found.parts,
            "details": found.details,
            "topics": topics,
            "gauges": gauges,
        }


def why_not_valid(
    now: float, raw: WrenchRaw | None, done: WrenchCompensated | None, unheard_s: float = float("inf")
) -> str:
    """Why the wrench must not be used at `now` (monotonic s), in an operator's words; empty if it may be.

    Args:
        now: monotonic s; raw, done: the newest that were heard.
        unheard_s: how long ago `raw` came: an old sample that has only just come is no silence of the sensor.
    """
    if raw is None or (age_s := now - raw.t_ns / 1e9) > SILENT_S:
        if raw is not None and unheard_s <= SILENT_S:
            return f"What is shown is {age_s:.0f} s old: this computer is too busy to keep up"
        return "The sensor is silent" + (f" for {age_s:.0f} s" if raw is not None else "")
    if done is None or now - done.t_ns / 1e9 > SILENT_S:
        return "The compensation is silent"
    reasons = (
        (raw.saturated, "The sensor is at its limit: take the load off"),
        (done.valid, ""),
        (done.tool_unseen, "Zeroed, and the tool not felt since: put it on, or zero again with it off"),
        (done.unzeroed, "The sensor is not zeroed: take the tool off, then press Zero the sensor"),
        (done.joints_extrapolated, "The joints are silent or late"),
        (not raw.valid, "The sensor does not vouch for its samples"),
    )
    return next((text for holds, text in reasons if holds), "The wrench is not valid: see Health")
