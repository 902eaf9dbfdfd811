"""A deflection session at work: moves, guides, records, registers and writes set after set."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.tool_file import ToolFile
from galen_hw.errors import HardwareError, UsageError
from galen_hw.identification.deflection.registration import MarkerWatch, register_both
from galen_hw.kinematics import Robot
from galen_hw.recording import Recording, RecordingInfo, write_table
from galen_hw.spatial import Array, inverse, quaternion_from_rotation, transform
from galen_hw.tools.collect.plan import Plan, Push, Step
from galen_hw.tools.collect.rows import Rows, middle

MOVE_WITHIN_S: Final = 60.0
STILL_S: Final = 0.5
LEAST_SEEN: Final = 0.5
SPEED: Final = 0.3
MOVED_M: Final = 5e-4


class Hand(Protocol):
    """Who pushes."""

    def push(self, force: Array, rise_s: float, dwell_s: float) -> None:
        """Ask for, or give, one push of a force (3,) N, base axes."""


@dataclass
class CollectSession:
    """One session on the bus.

    Args:
        plan: what to do; hand: who pushes; show: takes lines for people and the live state.
    """

    plan: Plan
    robot: Robot
    tool: ToolFile
    subscriber: Subscriber
    motors: CommandClient
    hand: Hand
    say: Callable[[str], None]
    show: Callable[["CollectSession", str], None] = lambda *_: None
    watch: MarkerWatch = field(default_factory=MarkerWatch)
    peaks: dict[str, Array] = field(default_factory=dict)
    """Largest force along +x +y +z -x -y -z of each place, N: the coverage."""
    registration: tuple[Array, Array] | None = None
    rows: Rows = field(init=False)
    _said: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.rows = Rows(self.robot, self.watch)

    def run(self) -> None:
        """All steps that are left; each is on the disk before the next begins.

        Raises:
            HardwareError: no tracker, the tool never visible, the arm does not move.
        """
        self._need_tracker()
        self.motors.call("motors", "enable")
        for step in self.plan.left:
            if step.purpose == "calibration":
                self._calibrate(step)
            else:
                self._push(step)

    def _need_tracker(self) -> None:
        self._listen(2.0)
        if not self.rows.arrays()["time"].size:
            raise HardwareError(
                "no tracker", where="tracker/tool, tracker/reference", todo="connect it (galen-hw check), then go on"
            )

    def _listen(self, seconds: float, text: str = "") -> None:
        """Take messages for so long."""
        until = time.monotonic() + seconds
        shown = 0.0
        while (left := until - time.monotonic()) > 0.0:
            received = self.subscriber.receive(min(left, 0.1))
            if received is not None:
                self.rows.take(*received)
            if time.monotonic() - shown > 0.1:
                shown = time.monotonic()
                for line in self.rows.look():
                    if "lost" not in line and line not in self._said:
                        self._said.add(line)
                        self.say(f"tracker: {line}")
                self.show(self, text)

    def _move(self, place: list[float]) -> None:
        """Go there and wait until still."""
        names = self.robot.joint_names
        self.motors.call("motors", "move_jp", {"position": dict(zip(names, place, strict=True))})
        until = time.monotonic() + MOVE_WITHIN_S
        still_since = time.monotonic()
        while time.monotonic() - still_since < STILL_S:
            before = self.rows.q
            self._listen(0.1, "moving")
            there = self.rows.q is not None and np.all(np.abs(self.rows.q - place) < 2e-3)
            rests = before is not None and self.rows.q is not None and np.all(np.abs(self.rows.q - before) < 1e-4)
            if self.rows.moving or not (there and rests):
                still_since = time.monotonic()
            if time.monotonic() > until:
                raise HardwareError("the arm does not come to rest", where="motors", todo="galen-hw check, then go on")

    def _calibrate(self, step: Step) -> None:
        """Still at several places without force: where the markers sit."""
        parts = []
        for number, place in enumerate(step.places, start=1):
            self._move(place)
            self.rows = Rows(self.robot, self.watch)
            self._listen(1.5, f"{step.name}: place {number} of {len(step.places)}, do not touch the tool")
            parts.append(self.rows.arrays())
        poses = [(p["M"][np.isfinite(p["M"][:, 0, 0])], p["q"]) for p in parts]
        usable = [(M, q) for M, q in poses if len(M) >= 20]
        if len(usable) < 4:
            raise HardwareError(
                f"the tool is seen at {len(usable)} of {len(poses)} places",
                where=step.name,
                todo="turn the markers to the tracker, or move the tracker, then go on",
            )
        M = np.array([middle(m) for m, _ in usable])
        B = np.array([self._tip(np.median(q, axis=0)[None])[0] for _, q in usable])
        found = register_both(M, B)
        left = np.linalg.norm((found[0] @ B @ found[1] - M)[:, :3, 3], axis=1)
        self.say(f"{step.name}: registered over {len(M)} places, {1e3 * float(np.sqrt(np.mean(left**2))):.2f} mm rms")
        if self.registration is not None:
            moved = float(np.linalg.norm((inverse(self.registration[0]) @ found[0])[:3, 3]))
            if moved > MOVED_M:
                self.say(f"since the first calibration set base or marker moved by {1e3 * moved:.2f} mm: record again")
        self.registration = self.registration or found
        joined = {k: np.concatenate([p[k] for p in parts]) for k in ("q", "M", "force")}
        steps = np.cumsum([0.0] + [p["time"][-1] + 1.0 for p in parts[:-1]])
        joined["time"] = np.concatenate([p["time"] + t for p, t in zip(parts, steps, strict=True)])
        joined["segment"] = np.concatenate([np.full(len(p["time"]), float(i)) for i, p in enumerate(parts)])
        joined["force"] = np.zeros_like(joined["force"])
        self._write(step, joined)

    def _push(self, step: Step) -> None:
        """One set of pushes at one place."""
        plan = self.plan
        self._register_again()
        self._move(step.places[0])
        self.rows = Rows(self.robot, self.watch)
        self._listen(plan.rest_s, f"{step.name}: do not touch the tool")
        for number, force in enumerate(step.pushes, start=1):
            for sign in (1.0, -1.0):
                push = Push(tuple(float(sign * f) for f in force))  # type: ignore[arg-type]
                self.hand.push(np.array(push.force), plan.rise_s, plan.dwell_s)
                text = f"{step.name}, push {number} of {len(step.pushes)}: {push.words()}, hold {plan.dwell_s:g} s"
                self._listen(2.0 * plan.rise_s + plan.dwell_s, text)
            self._listen(plan.rest_s, f"{step.name}: let go")
        found = self.rows.arrays()
        if self.rows.seen < LEAST_SEEN:
            share = f"{self.rows.seen:.0%}"
            self.say(f"{step.name}: the tool was seen in {share} of the frames: not kept, record it again")
            return
        if self.rows.saturated:
            self.say(f"{step.name}: the force was at its limit in {self.rows.saturated} samples: push less; not kept")
            return
        rest = found["time"] < 0.8 * plan.rest_s
        R = self.robot.sensor_pose(found["q"])[:, :3, :3]
        # At one place the tool's weight and the sensor's offset are constant: the rest before the pushes removes them.
        found["force"] = np.einsum("nij,nj->ni", R, found["force"] - np.nanmean(found["force"][rest], axis=0))
        self._cover(step, found["force"])
        self._write(step, found)

    def _register_again(self) -> None:
        """The registration of this session's first calibration set, when the session is taken up again."""
        if self.registration is not None:
            return
        import json

        path = self.plan.folder / "calibration-1" / "recording.json"
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))["registration"]
            self.registration = np.array(kept["T_marker_base"]), np.array(kept["T_tip_tool"])
        except (OSError, ValueError, KeyError):
            raise UsageError("no registration", where=str(path), todo="begin the session in a new folder") from None

    def _cover(self, step: Step, force: Array) -> None:
        place = step.name.partition("-")[0]
        peak = np.nanmax(np.hstack([force, -force]), axis=0)
        self.peaks[place] = np.maximum(self.peaks.get(place, np.zeros(6)), peak)

    def _tip(self, q: Array) -> Array:
        return np.asarray(self.robot.sensor_pose(q) @ transform(np.eye(3), self.tool.tip))

    def _write(self, step: Step, found: dict[str, Any]) -> None:
        """The set as a table folder, tip in the base frame."""
        assert self.registration is not None, "the first step is a calibration set"
        X, Z = self.registration
        T = inverse(X) @ found["M"] @ inverse(Z)
        seen = np.isfinite(T[:, 0, 0])
        xyzw = np.full((len(T), 4), np.nan)
        xyzw[seen] = quaternion_from_rotation(T[seen, :3, :3])
        columns = {"time": found["time"]}
        if "segment" in found:
            columns["segment"] = found["segment"]
        columns |= {f"joint.{n}.position": found["q"][:, i] for i, n in enumerate(self.robot.joint_names)}
        columns |= {f"applied.force.{a}": found["force"][:, i] for i, a in enumerate("xyz")}
        columns |= {f"pose.position.{a}": T[:, i, 3] for i, a in enumerate("xyz")}
        columns |= {f"pose.orientation.{a}": xyzw[:, i] for i, a in enumerate("xyzw")}
        tool = self.tool
        about = {"name": tool.name, "tip": tool.tip} | ({"mass": tool.mass, "com": tool.com} if tool.calibrated else {})
        info = {
            "schema": 1,
            "robot": self.plan.robot,
            "predict": "pose",
            "tool": about,
            "gravity": self.robot.gravity.tolist(),
            "purpose": step.purpose,
            "session": self.plan.day,
            "configuration": step.name.partition("-")[0],
            "registration": {"T_marker_base": X.tolist(), "T_tip_tool": Z.tolist()},
            "tracker_warnings": dict(self.rows.warnings),
        }
        write_table(Recording(columns, RecordingInfo.model_validate(info)), self.plan.folder / step.name)
