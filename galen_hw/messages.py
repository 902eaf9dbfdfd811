"""What travels on the bus: one frozen struct a kind, and the table of topics.

Every message starts with the same header. Numbers are SI. `valid` is false unless the producer claims it.
Encoding is a msgpack map with stable keys, so that PlotJuggler's ZeroMQ plug-in reads it without a bridge.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from galen_hw.errors import WrongCommandError


class Vector3(msgspec.Struct, frozen=True, gc=False):
    """Three components along x, y, z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Quaternion(msgspec.Struct, frozen=True, gc=False):
    """A unit quaternion."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """The header of all messages.

    Args:
        timestamp: seconds since the epoch, for viewers.
        t_ns: CLOCK_MONOTONIC where the transport read the wire, ns.
        seq: counts up by one per topic and source; a gap is a loss.
        valid: the producer vouches for the content.
        source: who says so (device or service name of the configuration).
        robot: name of the configured robot; virtual: there is no hardware. The daemon writes both into what it publishes.
    """

    timestamp: float
    t_ns: int
    seq: int
    valid: bool = False
    source: str = ""
    robot: str = ""
    virtual: bool = False


class WrenchRaw(Message, frozen=True, kw_only=True, gc=False):
    """`wrench/raw`: what the sensor reports, in the sensor frame about its origin, never altered (N, N m).

    Args:
        force, torque: about the sensor's origin, N and N m.
        status: the device's own status word, 0 where it has none.
        saturated: a gauge or an axis is at its limit; the wrench must not be used.
        serial_number: of the sensor, empty until read.
        zeroings: how often it was zeroed since its driver knows it; 0: its own offset is in the reading, -1: not known.
    """

    force: Vector3
    torque: Vector3
    status: int = 0
    saturated: bool = False
    serial_number: str = ""
    zeroings: int = -1


class WrenchCompensated(Message, frozen=True, kw_only=True, gc=False):
    """`wrench/compensated` and `wrench/contact`: measured minus predicted (report, equation 12), N and N m.

    Args:
        force, torque: of the hand or the tissue, N and N m.
        tool: name of the tool, empty with compensation off.
        calibration: identity of the calibration that made it (see the tool's file), empty when none.
        enabled: false while compensation is switched off (then equal to raw minus tare).
        joints_age_s: age of the joint state at the sample's time, s; negative is impossible.
        joints_extrapolated: the joint state was extrapolated beyond its bound; `valid` is then false.
        blend: 0 to 1, progress of the change of tool, toggle or tare.
        terms: number of extra physical effects of the tool's file in the prediction.
        unzeroed: the sensor's own offset is in its reading, neither zeroed nor tared away; `valid` is then false, unless
            a calibration is subtracted whose bias was found on the sensor as it is.
        tool_unseen: since the sensor was zeroed it has not read the tool's weight: the tool is off, or was on when it was
            zeroed and its weight is taken off twice; `valid` is false until it is seen or tared.
    """

    force: Vector3
    torque: Vector3
    tool: str = ""
    calibration: str = ""
    enabled: bool = False
    joints_age_s: float = 0.0
    joints_extrapolated: bool = False
    blend: float = 1.0
    terms: int = 0
    unzeroed: bool = False
    tool_unseen: bool = False


class CompensationState(Message, frozen=True, kw_only=True):
    """`compensation/state`: all that is needed to compute the same wrench again; at each change and once a second.

    It holds for the raw samples after `t_ns` (the last one that was made without it).

    Args:
        tool, calibration, enabled: as in `WrenchCompensated`; sensor_serial: last seen.
        problem: why nothing can be valid, empty if nothing is wrong.
        tool_file, settings: JSON texts of the tool's file and of the service's settings; empty without a tool.
        contact: point of `wrench/contact` in the sensor frame, m.
        tare: (6,) N and N m that are taken off beside the prediction.
        residual: (9,) what the blend takes off in addition where it begins: wrench (6), contact point (3).
        blend_from_ns: raw sample at which the running or last blend began.
        samples: `seq` of the next compensated sample.
        tool_awaited: the sensor was zeroed, and the tool was not seen on it since.
    """

    tool: str = ""
    calibration: str = ""
    enabled: bool = False
    sensor_serial: str = ""
    problem: str = ""
    tool_file: str = ""
    settings: str = ""
    contact: Vector3 = Vector3()
    tare: list[float] = []
    residual: list[float] = []
    blend_from_ns: int = 0
    samples: int = 0
    tool_awaited: bool = False


class JointsState(Message, frozen=True, kw_only=True):
    """`joints/state`: by joint name; rad or m, rad/s or m/s, N m or N (NaN where not measured).

    Args:
        position, velocity, effort: by joint.
        moving: the controller says a move is in progress.
        enabled: motor on.
        stop_code: the controller's reason of the last stop.
        at_lower, at_upper: limit switch or software limit active.
        estop: emergency stop or abort input engaged.
    """

    position: dict[str, float]
    velocity: dict[str, float]
    effort: dict[str, float]
    moving: dict[str, bool] = {}
    enabled: dict[str, bool] = {}
    stop_code: dict[str, int] = {}
    at_lower: dict[str, bool] = {}
    at_upper: dict[str, bool] = {}
    estop: bool = False


class Pose(Message, frozen=True, kw_only=True):
    """`pose/reported`, `pose/corrected`: tool tip in the base frame, m.

    Args:
        position, orientation: of the tip in the base frame, m.
        covariance: 6 x 6 row-major of [position (m), rotation vector (rad)]; empty when not known.
        tool: whose tip; model: which deflection model made it, empty for the reported pose.
    """

    position: Vector3
    orientation: Quaternion
    covariance: list[float] = []
    tool: str = ""
    model: str = ""


class TrackedPose(Message, frozen=True, kw_only=True):
    """`tracker/tool`, `tracker/reference`: pose of one marker body in the tracker frame, m.

    Args:
        position, orientation: of the marker body in the tracker's frame, m.
        handle: the tracker's port handle; frame: its frame number at 60 Hz, the sample clock.
        missing: the marker body was not seen; position and orientation are then NaN.
        error_m: the tracker's own fit error.
        port_status, system_status: the tracker's own words, bit by bit as its manual has them.
    """

    handle: str
    frame: int
    position: Vector3
    orientation: Quaternion
    missing: bool = False
    error_m: float = 0.0
    port_status: int = 0
    system_status: int = 0


class Status(Message, frozen=True, kw_only=True):
    """`status`: how a device or service is doing, at least once a second.

    Args:
        state: "starting", "ready", "degraded", "fault" or "stopped".
        detail: one line for people; todo: what an operator should do about a state that is not well, empty otherwise.
        counters: whole numbers that only grow (frames, lost, late, foreign, ...).
        gauges: rates (Hz) and ages (s), each key with its unit.
    """

    state: str
    detail: str = ""
    counters: dict[str, int] = {}
    gauges: dict[str, float] = {}
    todo: str = ""


class Fault(Message, frozen=True, kw_only=True):
    """`fault`: something went wrong, at most once a second of a kind.

    Args:
        what, where, todo: the line that people read; what to do may be empty.
    """

    what: str
    where: str = ""
    todo: str = ""


class CalibrationProgress(Message, frozen=True, kw_only=True):
    """`calibration/progress`: where a sweep stands.

    Args:
        state: "checking", "waiting" (for the operator), "moving", "settling", "averaging",
            "paused" (a device is silent), "done", "stopped".
        pose, poses: which one of how many; remaining_s: estimated time left.
        detail: for people.
    """

    state: str
    pose: int = 0
    poses: int = 0
    remaining_s: float = 0.0
    detail: str = ""


class TopicHealth(msgspec.Struct, frozen=True, kw_only=True):
    """How a topic flows: published a second and what is nominal, share not seen here and share that was valid.

    `lost_share`, `valid_share`: NaN where nobody counts them (all but the compensated wrenches).
    `p50_s`, `p99_s`, `worst_s`: age when published, of the last second; 0 where nothing was.
    """

    rate_hz: float
    nominal_hz: float
    lost_share: float = math.nan
    valid_share: float = math.nan
    p50_s: float = 0.0
    p99_s: float = 0.0
    worst_s: float = 0.0


class Alarm(msgspec.Struct, frozen=True, kw_only=True):
    """Something that an operator should know, from when it is noticed until it is clearly over.

    Args:
        cause: a short name that stays the same, e.g. "drift"; level: "advice", "warning" or "fault".
        since: seconds since the epoch.
    """

    cause: str
    level: str
    what: str
    todo: str = ""
    since: float = 0.0


class Health(Message, frozen=True, kw_only=True):
    """`health`: all that tells whether the daemon and its devices do well, once a second.

    Args:
        state: "good", "advice", "warning" or "fault": the worst of the alarms.
        alarms: what an operator should know, the worst first.
        parts: state of each source of `status`, "silent" when it says nothing; details: its one line.
        topics: by name, of those that have a nominal rate.
        gauges: numbers by name, each with its unit in it; NaN where it is not known.
        counters: whole numbers that only grow; versions: of what runs.
    """

    state: str = "fault"
    alarms: list[Alarm] = []
    parts: dict[str, str] = {}
    details: dict[str, str] = {}
    topics: dict[str, TopicHealth] = {}
    gauges: dict[str, float] = {}
    counters: dict[str, int] = {}
    versions: dict[str, str] = {}


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """A command to a device or service, on the command socket.

    Args:
        id: chosen by the client; the reply bears it.
        target: device or service name of the configuration, e.g. "motors", "compensation".
        name: what to do, e.g. "move_jp", "stop", "select_tool".
        args: SI numbers and plain strings.
        version: of this protocol; another one is refused.
    """

    id: str
    target: str
    name: str
    args: dict[str, Any] = {}
    version: int = 1

    def require_only(self, *known: str) -> None:
        """Refuse arguments that the command does not take: a misspelt one must not mean the default of the right one.

        Raises:
            WrongCommandError: there are others than `known`.
        """
        if unknown := sorted(self.args.keys() - set(known)):
            todo = f"it takes {', '.join(known)}" if known else "it takes no arguments"
            raise WrongCommandError(f"{self.name} takes no {', '.join(unknown)}", where=self.target, todo=todo)


class CommandError(msgspec.Struct, frozen=True, kw_only=True):
    """Why a command was not carried out; `kind` is "rejected", "unknown", "invalid", "timeout" or "fault"."""

    kind: str
    what: str
    where: str = ""
    todo: str = ""


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a `Request`; `error` is None when it was carried out."""

    id: str
    result: dict[str, Any] = {}
    error: CommandError | None = None


SLOW_AGE_S: Final = 2.0
"""Of what comes once a second or as an event: what was said that long ago may be otherwise now."""
STREAM_HZ: Final = 10.0


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the topic table.

    Args:
        message: the struct that is published.
        rate_hz: nominal rate; 0 for events.
        crtk: the community's name for the same thing (Collaborative Robotics Toolkit), if any.
        doc: one line.
        max_age_s: a message whose `t_ns` is older than that when it is published, or read, is not `valid`.
    """

    message: type[Message]
    rate_hz: float
    crtk: str
    doc: str
    max_age_s: float = SLOW_AGE_S

    @property
    def stream(self) -> bool:
        """The next message is on its way: one that is too old is not handed to who acts on it, and never worked off."""
        return self.rate_hz >= STREAM_HZ


STREAM_AGE_S: Final = 0.25
"""Of whatever describes a moving arm: as long as a `servo_jv` drives the motors without being renewed."""


TOPICS: Final[dict[str, Topic]] = {
    "wrench/raw": Topic(WrenchRaw, 1000.0, "", "wrench as the sensor reports it, sensor frame", STREAM_AGE_S),
    "wrench/compensated": Topic(
        WrenchCompensated, 1000.0, "measured_cf", "raw less gravity, bias and effects", STREAM_AGE_S
    ),
    "wrench/contact": Topic(
        WrenchCompensated, 1000.0, "contact/measured_cf", "compensated, at the contact point", STREAM_AGE_S
    ),
    "compensation/state": Topic(
        CompensationState, 1.0, "", "parameters, tare and blend that make the compensated wrench"
    ),
    "joints/state": Topic(
        JointsState, 40.0, "measured_js", "joint positions, velocities, efforts and axis states", STREAM_AGE_S
    ),
    "pose/reported": Topic(Pose, 40.0, "measured_cp", "tool tip by rigid kinematics", STREAM_AGE_S),
    "pose/corrected": Topic(
        Pose, 1000.0, "corrected/measured_cp", "tool tip with the arm's give taken into account", STREAM_AGE_S
    ),
    "tracker/tool": Topic(TrackedPose, 60.0, "tracker/measured_cp", "marker on the tool, tracker frame", STREAM_AGE_S),
    "tracker/reference": Topic(
        TrackedPose, 60.0, "tracker_reference/measured_cp", "marker on the base, tracker frame", STREAM_AGE_S
    ),
    "status": Topic(Status, 1.0, "operating_state", "state, counters and gauges of each device and service"),
    "fault": Topic(Fault, 0.0, "error", "something went wrong: what, where, what to do"),
    "health": Topic(Health, 1.0, "", "alarms, rates, losses, latency, noise and drift: how everything is doing"),
    "calibration/progress": Topic(CalibrationProgress, 0.0, "", "where a sweep stands"),
}


MAX_AGE_NS: Final = {name: round(topic.max_age_s * 1e9) for name, topic in TOPICS.items()}
"""The age limit of each topic."""
STREAMS: Final = frozenset(name for name, topic in TOPICS.items() if topic.stream)


def too_old(topic: str, t_ns: int, now_ns: int) -> bool:
    """Return whether a message with the stamp `t_ns` is too old at `now_ns` to be valid."""
    return now_ns - t_ns > MAX_AGE_NS[topic]


encode: Final[Callable[[msgspec.Struct], bytes]] = msgspec.msgpack.Encoder().encode
"""Msgpack map of a message, keys in the order of its declaration."""
encode_batch: Final[Callable[[list[tuple[bytes, bytes]]], bytes]] = msgspec.msgpack.Encoder().encode
"""Msgpack list of [topic, payload] pairs."""
