"""What comes over the bus during one set, as rows at the tracker's frames."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.identification.deflection.registration import MarkerWatch, Places
from galen_hw.kinematics import Robot
from galen_hw.messages import JointsState, Message, TrackedPose, WrenchCompensated, WrenchRaw
from galen_hw.spatial import Array, inverse, quaternion_from_rotation, rotation_from_quaternion, transform

TOPICS = ("wrench/raw", "wrench/compensated", "joints/state", "tracker/tool", "tracker/reference")
HALF_FRAME_S = 1.0 / 120.0
LOST, REPEATED = "frames lost", "frames repeated"
LEAST_SEEN: Final = 0.5
REGISTERED: Final = ("T_marker_base", "T_tip_tool", "position_std", "rotation_std")
"""What a set keeps of the registration."""


def _matrix(message: TrackedPose) -> Array:
    """(4, 4), NaN where the marker is missing."""
    p, q = message.position, message.orientation
    xyzw = np.array([q.x, q.y, q.z, q.w])
    if message.missing or not message.valid or not np.isfinite([p.x, p.y, p.z, *xyzw]).all() or not xyzw.any():
        return np.full((4, 4), np.nan)
    return transform(rotation_from_quaternion(xyzw), [p.x, p.y, p.z])


@dataclass
class Rows:
    """One set while it is recorded.

    Args:
        robot: whose joints are listened to.
        watch: notices moved markers, swapped handles, lost frames; kept over the session.
    """

    robot: Robot
    watch: MarkerWatch
    warnings: Counter[str] = field(default_factory=Counter)
    saturated: int = 0
    moving: bool = False
    force_now: Array = field(default_factory=lambda: np.zeros(3))
    q: Array | None = None
    _tool: list[tuple[int, int, Array]] = field(default_factory=list)
    _reference: dict[int, Array] = field(default_factory=dict)
    _wrench: dict[str, list[tuple[int, float, float, float]]] = field(default_factory=lambda: {"raw": [], "done": []})
    _joints: list[tuple[int, Array]] = field(default_factory=list)
    _looked: int = 0

    def take(self, topic: str, message: Message) -> None:
        """One message of `TOPICS`."""
        if isinstance(message, JointsState):
            q = np.array([message.position.get(name, np.nan) for name in self.robot.joint_names])
            self.moving = any(message.moving.values())
            if message.valid and np.isfinite(q).all():
                self.q = q
                self._joints.append((message.t_ns, q))
        elif isinstance(message, WrenchRaw):
            self.saturated += message.saturated
            if message.valid and not message.saturated:
                self._wrench["raw"].append(_force(message))
                self.force_now = np.array(self._wrench["raw"][-1][1:])
        elif isinstance(message, WrenchCompensated):
            if message.valid and message.enabled:
                self._wrench["done"].append(_force(message))
        elif isinstance(message, TrackedPose) and topic == "tracker/reference":
            self._reference[message.frame] = _matrix(message)
        elif isinstance(message, TrackedPose):
            self._tool.append((message.t_ns, message.frame, _matrix(message)))

    def look(self) -> list[str]:
        """What the watch says of frames of which both markers have come since the last look."""
        lines: list[str] = []
        newest = max(self._reference, default=-1)
        while self._looked < len(self._tool):
            t_ns, frame, T = self._tool[self._looked]
            if frame not in self._reference and frame >= newest:
                break  # Its other half is still to come.
            found = self.watch.look(frame, t_ns / NS_PER_S, self._reference.get(frame, T * np.nan), T)
            if any("repeats" in line for line in found):
                self._tool[self._looked] = t_ns, frame, T * np.nan
            for line in found:
                kind, count = _counted(line)
                self.warnings[kind] += count
            lines += found
            self._looked += 1
        return lines

    @property
    def alarms(self) -> list[str]:
        """What the watch has said apart from single frames."""
        return [line for line in self.warnings if line not in (LOST, REPEATED)]

    @property
    def spoiled(self) -> list[str]:
        """Why the set cannot be used, a line each with what to do; empty when it can."""
        lines = self.alarms
        missed = self.warnings[LOST] + self.warnings[REPEATED]
        if self.seen < LEAST_SEEN:
            lines.append(f"the tool was seen in {self.seen:.0%} of the frames: turn the markers to the tracker")
        elif missed > LEAST_SEEN * len(self._tool):
            lines.append(f"{missed} frames were lost or repeated: look after the tracker's line")
        if self.saturated:
            lines.append(f"the force was at its limit in {self.saturated} samples: push less")
        if not self._wrench["raw"] and not self.saturated:
            lines.append("no force was heard: galen-hw check")
        return lines

    @property
    def seen(self) -> float:
        """Share of the frames in which both markers were seen."""
        if not self._tool:
            return 0.0
        both = [
            np.isfinite(T[0, 0]) and np.isfinite(self._reference.get(f, T * np.nan)[0, 0]) for _, f, T in self._tool
        ]
        return float(np.mean(both))

    def arrays(self) -> dict[str, Any]:
        """`time` (N,) s, `q` (N, n), `force` (N, 3) sensor axes, `M` (N, 4, 4) tool in the reference marker's frame."""
        frames = [(t, f, T) for t, f, T in self._tool if f in self._reference]
        t = np.array([f[0] for f in frames], dtype=np.int64)
        start = t[0] if len(t) else 0
        time = (t - start) / NS_PER_S
        reference = np.array([self._reference[f[1]] for f in frames]).reshape(-1, 4, 4)
        tool = np.array([f[2] for f in frames]).reshape(-1, 4, 4)
        M = np.full_like(tool, np.nan)
        both = np.isfinite(tool + reference).all(axis=(1, 2)) if len(tool) else np.zeros(0, bool)
        if both.any():
            # The reference is at rest (the watch says if not): its own noise, times its distance, is averaged away.
            M[both] = inverse(middle(reference[both])) @ tool[both]
        done, raw = self._wrench["done"], self._wrench["raw"]
        force = _means(np.array(done if len(done) > 0.9 * len(raw) else raw, dtype=float), start, time)
        tq = np.array([(ns - start) / NS_PER_S for ns, _ in self._joints])
        q = np.array([v for _, v in self._joints])
        at = np.stack([np.interp(time, tq, c) for c in q.T], axis=1) if len(q) else np.zeros((len(time), 0))
        return {"time": time, "q": at, "force": force, "M": M}


def _counted(line: str) -> tuple[str, int]:
    """A warning's kind and how many it stands for."""
    if "lost" in line:
        return LOST, int(line.split(" ", 1)[0])
    return (REPEATED, 1) if "repeats" in line or "twice" in line else (line, 1)


def middle(T: Array) -> Array:
    """(4, 4) median place and mean turn of a marker that was still, from (N, 4, 4)."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3].mean(axis=0))
    return transform(U @ Vt, np.median(T[:, :3, 3], axis=0))


def _force(message: WrenchRaw | WrenchCompensated) -> tuple[int, float, float, float]:
    f = message.force
    return message.t_ns, f.x, f.y, f.z


def _means(samples: Array, start: int, time: Array) -> Array:
    """(N, 3) mean force over each frame; NaN where no sample came."""
    out = np.full((len(time), 3), np.nan)
    if not len(samples):
        return out
    t = (samples[:, 0] - start) / NS_PER_S
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(samples[:, 1:], axis=0)])
    a, b = np.searchsorted(t, time - HALF_FRAME_S), np.searchsorted(t, time + HALF_FRAME_S)
    some = b > a
    out[some] = (sums[b[some]] - sums[a[some]]) / (b - a)[some, None]
    return out


def tip_columns(robot: Robot, places: Places, found: dict[str, Any]) -> dict[str, Array]:
    """Columns of a set: joints, force on the tip, and the tip in the base as the tracker sees it (report, 14)."""
    T = inverse(places.T_marker_base) @ found["M"] @ inverse(places.T_tip_tool)
    seen = np.isfinite(T[:, 0, 0])
    xyzw = np.full((len(T), 4), np.nan)
    xyzw[seen] = quaternion_from_rotation(T[seen, :3, :3])
    columns = {"time": found["time"]}
    if "segment" in found:
        columns["segment"] = found["segment"]
    columns |= {f"joint.{n}.position": found["q"][:, i] for i, n in enumerate(robot.joint_names)}
    columns |= {f"applied.force.{a}": found["force"][:, i] for i, a in enumerate("xyz")}
    columns |= {f"pose.position.{a}": T[:, i, 3] for i, a in enumerate("xyz")}
    return columns | {f"pose.orientation.{a}": xyzw[:, i] for i, a in enumerate("xyzw")}
