"""Effects of geometry: joint zeros and scales, links and axes, the sensor's seat."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_all
from galen_hw.physics.effects.parameters import FARTHEST_SCALE, Parameter
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import ArmScene
from galen_hw.physics.scenes.screws import axis_moves, joint_screws
from galen_hw.physics.scenes.wrench import WrenchScene
from galen_hw.spatial import Array, rotation_exp

FURTHEST = {"m": 0.05, "rad": 0.5}
"""An arm that is built so wrong is another arm."""


@dataclass(frozen=True)
class _Encoder(Effect):
    """An error of a joint's encoder, q' = (1 + scale) q + offset, of which one of the two is its parameter."""

    ERROR: ClassVar[str] = ""
    """The parameter: "offset" or "scale"."""
    joint: str

    def columns(self, scene: Scene) -> Columns:
        """Return the slope of the misread arm, else the joint's port times what the error moves it by."""
        slope = _slope(lambda x: self._misread(scene, x))
        ports = [slope] if slope is not None else [self._port(scene, moved) for moved in self._ways()]
        return in_all(ports, len(scene.channels))

    def _port(self, scene: Scene, moved: Callable[[Scene], Array]) -> Array:
        """Return what a motion of the joint changes (N, C), less what it has changed where the reading was set to zero."""

        def change(at: Scene) -> Array | None:
            port = at.joint_port(self.joint)
            return None if port is None else port * moved(at)[:, None]

        port = _less_zero(scene, change)
        assert port is not None, "proposed only where there is a port"
        return port

    def _ways(self) -> tuple[Callable[[Scene], Array], ...]:
        """Return for each parameter how far the error moves the joint (N,) of a scene, per unit."""
        return (lambda at: np.ones(len(at)),)

    def _moved(self, scene: Scene, theta: Array) -> Array:
        """Return how far the error moves the joint (N,)."""
        return sum((t * way(scene) for t, way in zip(theta, self._ways(), strict=True)), np.zeros(len(scene)))

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the change of the misread arm itself, or of the turned one, where its screws are known."""
        misread = self._misread(scene, float(theta[0]))
        if misread is not None:
            return misread
        return _less_zero(scene, lambda at: _by_screw(at, self.joint, self._moved(at, theta)))

    def stands(self, scene: Scene, theta: Array) -> Scene | None:
        """Return the scene with the joint where it really is."""
        return scene.standing_at(self.joint, **{self.ERROR: float(theta[0])})

    def _misread(self, scene: Scene, value: float) -> Array | None:
        return _less_zero(scene, lambda at: at.misread(self.joint, **{self.ERROR: value}))


@dataclass(frozen=True)
class JointOffset(_Encoder):
    """A joint's zero is off: q' = q + d.

    Visible where the channels answer differently in different poses. Confused with bias (position), base_tilt (a first
    joint with a level axis), sensor_mounting (the last joint).
    """

    KEY = "joint_offset"
    SAYS = "the joint's zero is off"
    KNOWN_BY = "one constant angle gives it in all channels and poses"
    CONFIRMED_BY = "visit poses that spread all joints, and check one zero with a level"
    HEAD = ("offset",)
    ALIKE: ClassVar = {
        "sensor_mounting": "the last joint's zero and the sensor's seat turn about the same axis",
        "link_geometry": "over this range of poses a zero and a tilted axis do the same",
        "joint_scale": "over this narrow range of the joint a scale is nearly a constant",
        "compliance": "the load hardly changes",
    }
    TOLD_APART: ClassVar = {"sensor_mounting": "check the last joint's zero with a level; no motion of the arm can"}
    COMPLEXITY = 0
    RIGID = True
    LOAD_POWER = True
    GEOMETRY_ORDER = 1
    ERROR = "offset"

    @classmethod
    def always_fitted(cls, predict: str) -> bool:
        """Return whether it is of a joint that is compared itself."""
        return predict == "position"

    @classmethod
    def fitted_as(cls, channel: str, predict: str) -> Self | None:
        """Return it for a joint that is compared itself."""
        return cls(joint_of(channel)) if predict == "position" else None

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return an offset of the reading."""
        return ["bias"] if scene.observations.predict == "position" else []

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every joint with an answer; in positions the constant of that joint, unless offsets are free."""
        if scene.observations.predict == "position" and scene.belief.bias_free:
            return
        yield from (cls(joint) for joint in scene.joint_names if answers(scene, joint))

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the error of the zero."""
        return (Parameter("offset", scene.joint_units(self.joint)[0]),)


@dataclass(frozen=True)
class JointScale(_Encoder):
    """A joint's scale (gear, encoder) is off: q' = (1 + k) q.

    "eccentric": its encoder errs once a turn, q' = q + s sin q + c cos q, as a disk does that turns about a point beside its
    centre. "coupled": it goes along with a joint nearer to the base, q' = q + k p, as that of a wrist or of an elbow whose motor
    sits before that joint and whose gears or rods were not reckoned with. Visible over a wide range of the joint. Confused with
    joint_offset over a narrow one, with gain.
    """

    KEY = "joint_scale"
    SAYS = "the joint's scale is off"
    KNOWN_BY = "it follows the travel of the joint, or of one before it, in proportion or once a turn"
    CONFIRMED_BY = "visit both ends of the joint's range"
    HEAD = ("scale_error", "coupling", "sine", "cosine")
    ALIKE: ClassVar = {"compliance": "the load is nearly proportional to the joint's travel"}
    RIGID = True
    GEOMETRY_ORDER = 0
    ERROR = "scale"
    part: str = ""
    source: str = ""

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every joint that moves and shows; one that turns may have an eccentric encoder, or go along with another.

        In positions a joint that goes along is a cross_talk of its channel.
        """
        joints, moved = scene.joint_names, scene.moved
        turning = [joint for joint in moved if scene.joint_units(joint)[0] == "rad"]
        for joint in moved:
            if answers(scene, joint):
                yield cls(joint)
                if joint in turning:
                    yield cls(joint, "eccentric")
        if scene.observations.predict == "position":
            return
        for place, joint in enumerate(joints):
            if scene.joint_units(joint)[0] == "rad" and answers(scene, joint):
                # Of three of a wrist the motors sit behind it, and the first moves both others.
                before = joints[max(place - 2, 0) : place]
                yield from (cls(joint, "coupled", source) for source in before if source in turning)

    @property
    def remark(self) -> str:
        """A sentence on an encoder that errs once a turn, or goes along with another joint."""
        if self.source:
            return f"Its reading goes along with {self.source}, as where one gear or rod drives both and is not reckoned with."
        return "Its reading errs once a turn, as that of an eccentric encoder does." if self.part else ""

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the relative error of the scale, the share of the other joint, or the amplitudes of sine and cosine."""
        if self.part == "eccentric":
            return tuple(Parameter(name, "rad", furthest=FURTHEST["rad"]) for name in ("sine", "cosine"))
        return (Parameter("coupling" if self.part else "scale_error", "1", furthest=FARTHEST_SCALE),)

    def stands(self, scene: Scene, theta: Array) -> Scene | None:
        """Return the scene with the joint where it really is; None for other forms, whose errors are small."""
        return None if self.part else super().stands(scene, theta)

    def _misread(self, scene: Scene, value: float) -> Array | None:
        return None if self.part else super()._misread(scene, value)

    def _ways(self) -> tuple[Callable[[Scene], Array], ...]:
        shapes = (np.sin, np.cos) if self.part == "eccentric" else (np.asarray,)
        by = self.source or self.joint
        return tuple(lambda at, shape=shape: shape(at.q[:, at.joint_index(by)]) for shape in shapes)


@dataclass(frozen=True)
class LinkGeometry(Effect):
    """A link's length is off, or an axis is not where or how the model says: screws that move all beyond the joint.

    `errors` are the ports' names: `axis_tilt` and `axis_shift` move the axis and leave the zero pose, `frame_tilt` and
    `frame_shift` move everything beyond it, `rod_length` and `radius` belong to the delta. Visible over a wide range of the
    joints. A frame_tilt is confused with base_tilt before the first joint and sensor_mounting behind the last one.
    """

    KEY = "link_geometry"
    SAYS = "a link or an axis is not where or how the model says"
    KNOWN_BY = "one constant error of the arm gives it in all poses"
    CONFIRMED_BY = "visit poses that spread all joints in random order, with some repeated"
    HEAD = (".*_tilt.*", ".*_shift.*", "rod_length.*", "radius.*")
    ALIKE: ClassVar = {"sensor_mounting": "a tilt behind the last axis is the sensor's seat"}
    TOLD_APART: ClassVar = {"sensor_mounting": "turn the tool by 180 degrees on its flange and repeat the poses"}
    RIGID = True
    GEOMETRY_ORDER = 3
    joint: str
    errors: tuple[str, ...]

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return a tracker that is off where all of it is a shift of where the arm stands."""
        bare = [name.rsplit(": ", 1)[-1] for name in parameters if name != "rms_signal"]
        stands = bool(bare) and all(name.startswith("frame_shift") for name in bare)
        return ["bias"] if scene.observations.predict == "pose" and stands else []

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield every single error, and both tilts or shifts of one axis together."""
        by_joint: dict[str, list[str]] = {}
        for port in scene.geometry_ports():
            if np.any(np.abs(port.values) > 1e-12):
                by_joint.setdefault(port.joint, []).append(port.name)
        for joint, names in by_joint.items():
            yield from (cls(joint, (name,)) for name in names)
            for kind in ("axis_tilt", "frame_tilt", "axis_shift", "frame_shift"):
                pair = tuple(name for name in names if name.startswith(kind))
                if len(pair) > 1:
                    yield cls(joint, pair)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return angles and lengths."""
        units = {port.name: port.unit for port in scene.geometry_ports() if port.joint == self.joint}
        unit = {name: units.get(name, "m") for name in self.errors}
        return tuple(Parameter(name, u, furthest=FURTHEST[u]) for name, u in unit.items())

    def columns(self, scene: Scene) -> Columns:
        """Return the geometry's ports, and what the arm's motion adds."""
        ports = {port.name: port.values for port in scene.geometry_ports() if port.joint == self.joint}
        if scene.zeroing is not None:
            zero = {port.name: port.values for port in scene.zeroing.geometry_ports() if port.joint == self.joint}
            ports = {name: values - zero[name] for name, values in ports.items()}
        moving = [scene.swept_port(self.joint, name) for name in self.errors]
        found = [ports[name] + (0.0 if more is None else more) for name, more in zip(self.errors, moving, strict=True)]
        return in_all(found, len(scene.channels))

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the product of the exponentials; what the arm's motion adds to the first order."""
        amounts = dict(zip(self.errors, theta.tolist(), strict=True))
        out = _less_zero(scene, lambda at: at.screw_port(axis_moves(at, self.joint, amounts)))
        for name, amount in amounts.items():
            moving = scene.swept_port(self.joint, name)
            out = out if out is None or moving is None else out + amount * moving
        return out


@dataclass(frozen=True)
class SensorMounting(Effect):
    """The sensor is turned or shifted on its flange: a constant screw behind the last joint, in sensor axes.

    `turn`: the tool turns with it, tau = c x f as before. `turn_alone` (wrench): the tool stays as it was, and the whole reading
    is turned, Q^T f and Q^T tau; to the first order the two differ by a moment of the tool's weight.

    Visible when gravity (wrench) or the arm (pose) turns in the sensor. Easily confused: a turn about the last joint's axis is
    that joint's offset; for a wrench a shift is a payload's moment, a turn is a skew cross_talk.
    """

    KEY = "sensor_mounting"
    SAYS = "the sensor is turned or shifted on its flange"
    KNOWN_BY = "one constant turn or shift of the sensor gives it in all poses"
    CONFIRMED_BY = "repeat the poses with the tool turned by 180 degrees"
    HEAD = ("turn_.", "shift_.")
    RIGID = True
    GEOMETRY_ORDER = 4
    part: str = "turn"

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield a turn, of a wrench's sensor with its tool or alone, and a shift."""
        unknown = isinstance(scene, ArmScene) and scene.belief.robot is None  # somebody else's simulation
        if unknown or scene.screw_port([np.zeros((len(scene), 6))]) is None:
            return
        yield cls("turn")
        if scene.observations.predict == "wrench":
            yield cls("turn_alone")
        if scene.observations.predict in ("pose", "wrench"):
            yield cls("shift")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the turn about, or shift along, the sensor's axes."""
        unit, name = ("m", "shift") if self.part == "shift" else ("rad", "turn")
        return tuple(Parameter(f"{name}_{letter}", unit, furthest=FURTHEST[unit]) for letter in "xyz")

    def columns(self, scene: Scene) -> Columns:
        """Return the slope of `exact`; a shifted wrench is linear."""
        width = len(scene.channels)
        if self.part == "shift" and scene.observations.predict == "wrench":
            force = scene.simulated[:, :3]
            moved = [np.cross(np.tile(unit, (len(scene), 1)), force) for unit in np.eye(3)]
            return in_all([np.concatenate([np.zeros_like(m), m], axis=1) for m in moved], width)
        step = 1e-6
        ends = [[self._with_zero(scene, sign * step * unit) for unit in np.eye(3)] for sign in (1.0, -1.0)]
        return in_all([(up - down) / (2.0 * step) for up, down in zip(*ends, strict=True)], width)

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the change of the turned or shifted sensor itself."""
        linear = self.part == "shift" and scene.observations.predict == "wrench"
        return None if linear else self._with_zero(scene, theta)

    def _with_zero(self, scene: Scene, vector: Array) -> Array:
        if self.part == "turn_alone":
            read = scene.simulated.reshape(len(scene), 2, 3)
            return np.asarray((read @ rotation_exp(vector) - read).reshape(len(scene), 6))
        out = _less_zero(scene, lambda at: self._moved(at, vector))
        assert out is not None, "proposed only where there is a port"
        return out

    def _moved(self, scene: Scene, vector: Array) -> Array:
        if self.part == "turn" and isinstance(scene, WrenchScene):
            return scene.reseated(vector)
        T = scene.T_sensor if isinstance(scene, ArmScene) else scene.T  # type: ignore[attr-defined]
        along = T[:, :3, :3] @ vector
        if self.part == "shift":
            screw = np.concatenate([along, np.zeros_like(along)], axis=1)
        else:
            screw = np.concatenate([np.cross(T[:, :3, 3], along), along], axis=1)
        out = scene.screw_port([screw])
        assert out is not None, "proposed only where there is a port"
        return out


def answers(scene: Scene, joint: str) -> bool:
    """Return whether any channel answers to the joint."""
    port = scene.joint_port(joint)
    return port is not None and bool(np.nanmax(np.abs(port), initial=0.0) > 1e-12)


def _less_zero(scene: Scene, change: Callable[[Scene], Array | None]) -> Array | None:
    """Return what a wrong arm changes, less what it has changed where the reading was set to zero."""
    out = change(scene)
    zero = None if out is None or scene.zeroing is None else change(scene.zeroing)
    return out if out is None or zero is None else out - zero


def _slope(change: Callable[[float], Array | None], *, stride: float = 1e-4) -> Array | None:
    """Return the central difference at zero.

    Args:
        stride: rad, m or a share: a central difference over twice as much is exact to 1e-8.
    """
    up = change(stride)
    down = None if up is None else change(-stride)
    return None if up is None or down is None else (up - down) / (2.0 * stride)


def _by_screw(scene: Scene, joint: str, amount: Array) -> Array | None:
    screws = joint_screws(scene, joint)
    if screws is None:
        return None
    return scene.screw_port([screws * amount[:, None]])
