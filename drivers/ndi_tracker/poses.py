"""Tracking replies to messages: one for each new frame of a marker body, timed by the frame number."""

import math
from collections.abc import Mapping
from typing import Final

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import Output
from galen_hw.drivers.ndi_tracker.clock import FrameClock
from galen_hw.drivers.ndi_tracker.codec import HARDWARE_FAILURE, OUT_OF_VOLUME, SYSTEM_FAULTS, Tracking, Transform
from galen_hw.drivers.ndi_tracker.settings import Role
from galen_hw.drivers.reporting import Reporter
from galen_hw.messages import Quaternion, TrackedPose, Vector3

_M_PER_MM: Final = 1e-3
_UNIT_TOLERANCE: Final = 0.01
TODO_UNSEEN: Final = "clear the view, clean the markers, check rom_file"
_EVENTS: Final = {
    "restart": ("the tracker's frame counter began again", "record this set anew; poses before and after may differ"),
    "jump": ("the tracker's frame counter jumped against the host's time", "record this set anew"),
}


class NdiPoses:
    """What the marker bodies did.

    Args:
        report: makes faults and sequence numbers.
        frame_rate_hz, latency_s, missing_s: see the driver's settings.
    """

    def __init__(self, report: Reporter, frame_rate_hz: float, latency_s: float, missing_s: float) -> None:
        self._report = report
        self._clock = FrameClock(NS_PER_S / frame_rate_hz)
        self._latency_ns, self._missing_ns = round(latency_s * NS_PER_S), round(missing_s * NS_PER_S)
        names = ("samples", "repeated", "dropped", "missing", "absent", "stray", "restarts", "jumps")
        self.counts = dict.fromkeys(names, 0)
        self.replies = 0
        self._t_ns: dict[str, int] = {}
        self.begin({}, 0)

    def begin(self, roles: Mapping[str, Role], now_ns: int) -> None:
        """A new session of tracking: handles and whose they are."""
        self.replies = 0
        self._roles = dict(roles)
        self._frames: dict[str, int] = {}
        self._seen_ns: dict[str, int] = dict.fromkeys(roles, now_ns)
        self._system_status = 0
        self._clock.reset()

    def take(self, tracking: Tracking, t_ns: int) -> list[Output]:
        """The messages of a reply whose first byte was read at `t_ns`."""
        self.replies += 1
        out = self._system(tracking.system_status, t_ns)
        frames = [t.frame for t in tracking.transforms if t.frame is not None and t.handle in self._roles]
        if frames and (event := self._clock.take(max(frames), t_ns)):
            self.counts[f"{event}s"] += 1
            self._frames.clear()
            out += self._report.fault(t_ns, event, *_EVENTS[event])
        for transform in tracking.transforms:
            out += self._transform(transform, tracking.system_status, t_ns)
        return out

    def unseen(self, now_ns: int) -> list[Role]:
        """The marker bodies not seen for `missing_s`."""
        return [self._roles[handle] for handle, seen in self._seen_ns.items() if now_ns - seen >= self._missing_ns]

    def detail(self, now_ns: int) -> str:
        """One line for people."""
        unseen = self.unseen(now_ns)
        return ", ".join(
            f"{role} ({handle}{', not seen' if role in unseen else ''})" for handle, role in self._roles.items()
        )

    def _transform(self, transform: Transform, system_status: int, t_ns: int) -> list[Output]:
        handle, frame = transform.handle, transform.frame
        role = self._roles.get(handle)
        if role is None:
            self.counts["stray"] += 1
            return []
        if frame is None:
            self.counts["absent"] += 1
            what = f"{role}: handle {handle} is {transform.state}"
            return self._report.fault(t_ns, what, what, "plug the marker body in, then restart")
        last = self._frames.get(handle)
        if last is not None and frame <= last:
            self.counts["repeated"] += 1
            return []
        if last is not None:
            self.counts["dropped"] += frame - last - 1
        self._frames[handle] = frame
        self.counts["samples"] += 1
        out: list[Output] = []
        if transform.state == "ok":
            self._seen_ns[handle] = t_ns
        else:
            out = self._missing(role, handle, t_ns)
        return [self._message(transform, frame, role, system_status), *out]

    def _missing(self, role: Role, handle: str, t_ns: int) -> list[Output]:
        self.counts["missing"] += 1
        if t_ns - self._seen_ns[handle] < self._missing_ns:
            return []
        what = f"{role}: the marker body is not seen"
        return self._report.fault(t_ns, what, what, TODO_UNSEEN)

    def _message(self, transform: Transform, frame: int, role: Role, system_status: int) -> Output:
        topic = f"tracker/{role}"
        t_ns = max(self._clock.time_of(frame) - self._latency_ns, self._t_ns.get(topic, -1) + 1)
        self._t_ns[topic] = t_ns
        q0, qx, qy, qz = transform.quaternion
        x, y, z = (value * _M_PER_MM for value in transform.position_mm)
        norm = math.hypot(q0, qx, qy, qz)
        usable = abs(norm - 1.0) < _UNIT_TOLERANCE and math.isfinite(x + y + z)  # false for NaN
        message = TrackedPose(
            timestamp=self._report.time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._report.next_seq(topic),
            valid=usable and not transform.port_status & OUT_OF_VOLUME and not system_status & HARDWARE_FAILURE,
            source=self._report.name,
            handle=transform.handle,
            frame=frame,
            position=Vector3(x, y, z),
            orientation=Quaternion(*(c / norm for c in (qx, qy, qz, q0))) if usable else Quaternion(qx, qy, qz, q0),
            missing=transform.state == "missing",
            error_m=transform.error_mm * _M_PER_MM,
            port_status=transform.port_status,
            system_status=system_status,
        )
        return (topic, message)

    def _system(self, status: int, t_ns: int) -> list[Output]:
        """Faults of the system status that are new."""
        raised, self._system_status = status & ~self._system_status, status
        faults = [SYSTEM_FAULTS[bit] for bit in SYSTEM_FAULTS if raised & bit]
        return [output for what, todo in faults for output in self._report.fault(t_ns, what, what, todo)]
