"""A deflection session at work: moves, guides, records, registers and writes set after set."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.config.tool_file import ToolFile
from galen_hw.documents import load_json
from galen_hw.errors import HardwareError, UsageError
from galen_hw.identification.deflection.registration import MarkerWatch, Places, register_both
from galen_hw.kinematics import Robot
from galen_hw.recording import Recording, RecordingInfo, write_table
from galen_hw.recording.session import Session
from galen_hw.services.recorder import open_new
from galen_hw.spatial import Array, inverse, transform
from galen_hw.tools.collect.plan import FIRST_SET, Plan, Push, Step
from galen_hw.tools.collect.rows import REGISTERED, Rows, middle, tip_columns

MOVE_WITHIN_S: Final = 60.0
STILL_S: Final = 0.5
LISTEN_S: Final = 1.0
SHOW_S: Final = 0.1
LEAST_FRAMES: Final = 20
SILENT_S: Final = 2.0
"""Without a message, time that is told by messages stands still, and is not waited for."""
TRIES: Final = 4
TRACE: Final = 60
TAPE: Final = "{}.mcap"
"""The messages of a set, beside its table's folder."""


class Hand(Protocol):
    """Who pushes."""

    def push(self, force: Array, rise_s: float, dwell_s: float) -> None:
        """Ask for, or give, one push of a force (3,) N, base axes."""


@dataclass
class CollectSession:
    """One session on the bus.

    Args:
        plan: what to do; hand: who pushes; show: takes lines for people and the live state.
        context: of the MCAP files, see `recording.session.Session`.
        simulated: the robot's time is not this machine's (`--speed`): time is what its messages say.
    """

    plan: Plan
    robot: Robot
    tool: ToolFile
    subscriber: Subscriber
    motors: CommandClient
    hand: Hand
    say: Callable[[str], None]
    show: Callable[["CollectSession", str], None] = lambda *_: None
    context: dict[str, Any] = field(default_factory=dict)
    simulated: bool = False
    watch: MarkerWatch = field(default_factory=MarkerWatch)
    peaks: dict[str, Array] = field(default_factory=dict)
    """Largest force along +x +y +z -x -y -z of each place, N: the coverage."""
    trace: deque[Array] = field(default_factory=lambda: deque(maxlen=TRACE))
    """(3,) force on the tip, N, base axes, of the last seconds; `target`: the push that is wanted now."""
    target: Array = field(default_factory=lambda: np.zeros(3))
    registration: Places | None = None
    rows: Rows = field(init=False)
    _tape: Session | None = None
    _base: TimeBase = field(default_factory=TimeBase.now)
    _offset: Array = field(default_factory=lambda: np.zeros(3))
    _said: set[str] = field(default_factory=set)
    _newest_ns: int = 0

    def __post_init__(self) -> None:
        self.rows = Rows(self.robot, self.watch)

    def run(self) -> None:
        """All steps that are left; each is on the disk before the next begins.

        Raises:
            HardwareError: no tracker, the tool never visible, the arm does not move, base or marker moved.
        """
        self._need_tracker()
        self.motors.call("motors", "enable")
        for step in self.plan.left:
            with self._taped(step):
                if step.purpose == "calibration":
                    self._calibrate(step)
                else:
                    self._push(step)

    def _need_tracker(self) -> None:
        self._listen(LISTEN_S)
        where = "tracker/tool, tracker/reference"
        found = self.rows.arrays()
        if not found["time"].size:
            raise HardwareError("no tracker", where=where, todo="connect it (galen-hw check), then go on")
        if not self.rows.seen:
            todo = "turn both marker bodies to the tracker, then go on"
            raise HardwareError("the tool or the reference marker is never seen", where=where, todo=todo)

    @contextmanager
    def _taped(self, step: Step) -> Iterator[None]:
        """All messages go to a file of the set, whole whatever ends it."""
        with open_new(self.plan.folder / TAPE.format(step.name), overwrite=True) as stream:
            self._tape = Session(stream, **self.context)
            try:
                yield
            finally:
                self._tape.finish()
                self._tape = None

    def _listen(self, seconds: float, text: str = "") -> None:
        """Take messages for so long."""
        if self.simulated and not self._newest_ns:
            # A simulated robot's clock runs ahead of this one's, and is known by its messages alone.
            self._hear(SILENT_S)
        until = self._now_s() + seconds
        shown, heard = 0.0, time.monotonic()
        while (left := until - self._now_s()) > 0.0 and time.monotonic() - heard < max(seconds, SILENT_S):
            if self._hear(min(left, SHOW_S)):
                heard = time.monotonic()
            if time.monotonic() - shown > SHOW_S:
                shown = time.monotonic()
                self._look(text)

    def _hear(self, seconds: float) -> bool:
        """Take the next message, if one comes in time."""
        received = self.subscriber.receive(seconds)
        if received is None:
            return False
        self._newest_ns = max(self._newest_ns, received[1].t_ns)
        self.rows.take(*received)
        if self._tape is not None:
            self._tape.add(*received, round(self._now_s() * NS_PER_S) + self._base.wall_minus_monotonic_ns)
        return True

    def _now_s(self) -> float:
        """Time of the robot: monotonic, s."""
        return self._newest_ns / NS_PER_S if self.simulated and self._newest_ns else time.monotonic()

    def _look(self, text: str) -> None:
        """What the tracker's watch has to say, and the live picture."""
        for line in self.rows.look():
            if "frame" not in line and line not in self._said:
                self._said.add(line)
                self.say(f"tracker: {line}")
        if self.rows.q is not None:
            R = self.robot.sensor_pose(self.rows.q)[0, :3, :3]
            self.trace.append(R @ (self.rows.force_now - self._offset))
        self.show(self, text)

    def _move(self, place: list[float]) -> None:
        """Go there and wait until still."""
        names = self.robot.joint_names
        self.motors.call("motors", "move_jp", {"position": dict(zip(names, place, strict=True))})
        until = self._now_s() + MOVE_WITHIN_S
        still_since = self._now_s()
        while self._now_s() - still_since < STILL_S:
            before = self.rows.q
            self._listen(0.1, "moving")
            there = self.rows.q is not None and np.all(np.abs(self.rows.q - place) < 2e-3)
            rests = before is not None and self.rows.q is not None and np.all(np.abs(self.rows.q - before) < 1e-4)
            if self.rows.moving or not (there and rests):
                still_since = self._now_s()
            if self._now_s() > until:
                raise HardwareError("the arm does not come to rest", where="motors", todo="galen-hw check, then go on")

    def _begin(self) -> None:
        """Rows of a new set or place; what was warned of before it has been said."""
        self.rows.look()
        self.rows = Rows(self.robot, self.watch)

    def _calibrate(self, step: Step) -> None:
        """Still at several places without force: where the markers sit."""
        parts = []
        for number, place in enumerate(step.places, start=1):
            self._move(place)
            self._begin()
            text = f"{step.name}: place {number} of {len(step.places)}, do not touch the tool"
            for _ in range(TRIES):  # Frames that are lost cost time only, while nothing moves.
                self._listen(self.plan.still_s, text)
                found = self.rows.arrays()
                if np.count_nonzero(np.isfinite(found["M"][:, 0, 0])) >= LEAST_FRAMES:
                    break
            if self.rows.alarms:
                raise HardwareError(self.rows.alarms[0], where=step.name, todo="put it right, then go on")
            parts.append(found)
        poses = [(p["M"][np.isfinite(p["M"][:, 0, 0])], p["q"]) for p in parts]
        usable = [(M, q) for M, q in poses if len(M) >= LEAST_FRAMES]
        if len(usable) < 4:
            raise HardwareError(
                f"the tool is seen at {len(usable)} of {len(poses)} places",
                where=step.name,
                todo="turn the markers to the tracker, or move the tracker, then go on",
            )
        M = np.array([middle(m) for m, _ in usable])
        B = np.array([self._tip(np.median(q, axis=0)[None])[0] for _, q in usable])
        if step.name != FIRST_SET:
            self._register_again()
        if self.registration is not None:
            # A marker that slipped makes as good a registration as before: of another tool.
            off = np.median([self.registration.off(m, b) for m, b in zip(M, B, strict=True)], axis=0)
            self._refuse_moved(step, self.registration, float(off[0]), float(off[1]))
        self._compare(step, register_both(M, B), len(M))
        joined = {k: np.concatenate([p[k] for p in parts]) for k in ("q", "M", "force")}
        steps = np.cumsum([0.0] + [p["time"][-1] + 1.0 for p in parts[:-1]])
        joined["time"] = np.concatenate([p["time"] + t for p, t in zip(parts, steps, strict=True)])
        joined["segment"] = np.concatenate([np.full(len(p["time"]), float(i)) for i, p in enumerate(parts)])
        joined["force"] = np.zeros_like(joined["force"])
        self._write(step, joined)

    def _compare(self, step: Step, found: Places, count: int) -> None:
        """Say how good a registration is, and whether it agrees with the first one."""
        sure = f", base +/- {1e3 * np.linalg.norm(found.position_std):.2f} mm"
        sure = "" if np.isnan(found.position_std).any() else sure
        self.say(f"{step.name}: registered over {count} places, {1e3 * found.scatter_m:.2f} mm rms{sure}")
        if self.registration is None:
            self.registration = found
            return
        moved = float(np.linalg.norm((inverse(self.registration.T_marker_base) @ found.T_marker_base)[:3, 3]))
        unsure = 3.0 * float(np.nan_to_num(np.linalg.norm([self.registration.position_std, found.position_std])))
        if moved > self.registration.limits[0] + unsure:
            self.say(f"since the first calibration set the base moved by {1e3 * moved:.2f} mm: record again")

    def _push(self, step: Step) -> None:
        """One set of pushes at one place."""
        plan = self.plan
        self._register_again()
        self._move(step.places[0])
        self._begin()
        self._listen(plan.rest_s, f"{step.name}: do not touch the tool")
        self._need_registration(step)
        for number, force in enumerate(step.pushes, start=1):
            for sign in (1.0, -1.0):
                push = Push(tuple(float(sign * f) for f in force))  # type: ignore[arg-type]
                self.target = np.array(push.force)
                self.hand.push(self.target, plan.rise_s, plan.dwell_s)
                text = f"{step.name}, push {number} of {len(step.pushes)}: {push.words()}, hold {plan.dwell_s:g} s"
                self._listen(2.0 * plan.rise_s + plan.dwell_s, text)
            self.target = np.zeros(3)
            self._listen(plan.rest_s, f"{step.name}: let go")
        if self.rows.spoiled:
            for line in self.rows.spoiled:
                self.say(f"{step.name}: not kept, {line}")
            return
        found = self.rows.arrays()
        rest = found["time"] < 0.8 * plan.rest_s
        R = self.robot.sensor_pose(found["q"])[:, :3, :3]
        # At one place the tool's weight and the sensor's offset are constant: the rest before the pushes removes them.
        found["force"] = np.einsum("nij,nj->ni", R, found["force"] - np.nanmean(found["force"][rest], axis=0))
        self._cover(step, found["force"])
        self._write(step, found)

    def _need_registration(self, step: Step) -> None:
        """At rest the tool's marker must be where the registration says.

        Raises:
            HardwareError: base or marker has moved since.
        """
        assert self.registration is not None, "the first step is a calibration set"
        found = self.rows.arrays()
        seen = np.isfinite(found["M"][:, 0, 0])
        self._offset = self.rows.force_now
        if np.count_nonzero(seen) < LEAST_FRAMES:
            return  # What is not seen is said at the end of the set.
        T_base_tip = self._tip(np.median(found["q"], axis=0)[None])[0]
        self._refuse_moved(step, self.registration, *self.registration.off(middle(found["M"][seen]), T_base_tip))

    @staticmethod
    def _refuse_moved(step: Step, registration: Places, off_m: float, off_rad: float) -> None:
        """Raise if the tool's marker is farther (m, rad) from its place than noise and give explain."""
        limits = registration.limits
        if off_m > limits[0] or off_rad > limits[1]:
            what = f"the marker is {1e3 * off_m:.1f} mm and {1e3 * off_rad:.0f} mrad from where it was registered"
            todo = "put marker and base back and go on, or begin a new session folder"
            raise HardwareError(what, where=step.name, todo=todo)

    def _register_again(self) -> None:
        """The registration of this session's first calibration set, when the session is taken up again."""
        if self.registration is not None:
            return
        path = self.plan.folder / FIRST_SET / "recording.json"
        try:
            kept = load_json(path.read_text(encoding="utf-8"))["registration"]
            X, Z, position, rotation = (np.array(kept[k], dtype=float) for k in REGISTERED)
            self.registration = Places(X, Z, position, rotation, kept["scatter_m"], kept["scatter_rad"])
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
        places, tool = self.registration, self.tool
        registered = {k: np.nan_to_num(getattr(places, k)).tolist() for k in REGISTERED}
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
            "virtual": bool(self.context.get("virtual")),
            "registration": registered | {"scatter_m": places.scatter_m, "scatter_rad": places.scatter_rad},
            "tracker_warnings": dict(self.rows.warnings),
        }
        columns = tip_columns(self.robot, places, found)
        write_table(Recording(columns, RecordingInfo.model_validate(info)), self.plan.folder / step.name)
        seen = np.isfinite(found["M"][:, 0, 0])
        self.say(f"{step.name}: kept, {len(seen)} frames, {seen.mean():.0%} seen")
