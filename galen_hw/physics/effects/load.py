"""Effects of bodies and gravity: a different load, a tilted base, forgotten inertia."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.covariates import covariates
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, in_all, in_channel
from galen_hw.physics.effects.parameters import IN_PROPORTION, Parameter
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.joint import EffortScene
from galen_hw.spatial import Array, rotation_exp

MOMENTS = ("moment_x", "moment_y", "moment_z")
INERTIA = ("inertia_xx", "inertia_xy", "inertia_yy", "inertia_xz", "inertia_yz", "inertia_zz")


@dataclass(frozen=True)
class Payload(Effect):
    """The carried body differs: mass dm, first moment d(m c) and inertia enter Newton and Euler linearly.

    Source: Atkeson, An, Hollerbach 1986. `part`: "mass" (at the believed centre of mass), "body" (mass and moment), "full"
    (with inertia about the sensor's origin), "point" (mass and moment, with the inertia of mass at one point:
    I = m (c.c 1 - c c^T), by its slopes in m and m c where c is `at`; what is small has hardly more, and a motion that
    turns about one axis alone would give it any). `joint`: not what is carried, but the link that this joint moves, in efforts:
    "mass" is a point at its believed centre of mass. `still`: its weight alone, of a recording whose baseline holds no more (a
    filtered sensor, a simulation of poses), or that a controller takes off, set to another tool. `since`: from that moment (s)
    on, as what is picked up, put down or slips in its clamp; such moments are sought in the residual. `by`: in proportion to a
    covariate, per unit of it (a gripper's jaw that opens, a vessel that fills). Visible when gravity turns in the sensor.
    Confused with gain and cross_talk, and with bias where it does not turn.
    """

    KEY = "payload"
    SAYS = "the carried body's mass or centre of mass differs from what is believed"
    KNOWN_BY = "it turns with gravity in the sensor as a weight does"
    CONFIRMED_BY = "repeat the poses with a second, known mass"
    HEAD = ("mass", "moment_.")
    ALIKE: ClassVar = {
        "sensor_mounting": "a shifted sensor changes the torque as a moved centre of mass does",
        "cable_drag": "over these poses the cable pulls much as a weight does",
        "step": "where gravity hardly turns, another body from a moment on is another offset",
    }
    COMPLEXITY = 1
    RIGID = True
    part: str = "body"
    at: tuple[float, float, float] | None = None
    still: bool = False
    joint: str = ""
    since: float | None = None
    by: str = ""

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield the parts; inertia only where something accelerates, and without that too where the baseline has none."""
        port = scene.body_port() if scene.observations.predict in ("wrench", "effort") else None
        if port is None:
            return
        yield from (cls(part) for part in ("mass", "moment", "body"))
        for name in covariates(scene.observations.columns):
            yield from (cls(part, by=name) for part in ("moment", "body"))
        if isinstance(scene, EffortScene):
            for joint in scene.moved:
                if (link := scene.link_port(joint)) is not None and np.any(link[0][:, :, :4]):
                    yield from (cls(part, joint=joint) for part in ("mass", "moment", "body"))
        if np.any(np.abs(port[:, :, 4:]) > 0.0) and scene.clock:
            yield cls("full")
        weight = scene.weight_port() if scene.clock else None
        if weight is not None and not np.array_equal(weight, port):
            yield from (cls(part, still=True) for part in ("mass", "moment", "body"))

    @property
    def bound(self) -> bool:
        """Whether it is a point of mass, which binds moment to mass."""
        return self.at is not None

    @property
    def jump(self) -> float | None:
        """The moment, s, when it changed."""
        return self.since

    def jumping(self, moment: float) -> Self:
        """Return it changed at another moment."""
        return replace(self, since=moment)

    def staged(self, start: float, length: float) -> Self:
        """Return it changed in the middle, if it changes at all."""
        return self if self.since is None else self.jumping(start + 0.5 * length)

    @property
    def location(self) -> tuple[str, ...]:
        """Where it sits: what changed at a moment is beside what was there all along."""
        later = () if self.since is None else ("later",)
        return (*super().location, *later, *((self.by,) if self.by else ()))

    @property
    def remark(self) -> str:
        """A sentence on what changed, and when."""
        if self.still:
            return "It is weight alone, without inertia: a controller takes it off for another tool, or a filter passes no more."
        if self.by:
            return f"What is told a unit of {self.by.removeprefix('covariate.')} goes in proportion to {self.by}."
        return "" if self.since is None else f"It is so from {self.since:.4g} s on."

    def told_by(self, theta: Array, *, farthest: float = 0.5) -> Self | None:
        """Return a small body where mass and moment (4 and more,) say that it is; None if that is no place near a sensor.

        Args:
            farthest: m from the sensor to the middle of what a hand or a clip may have put on the tool.
        """
        if (
            self.still
            or self.joint
            or self.since is not None
            or self.by
            or self.part not in ("body", "full", "point")
            or theta[0] == 0.0
        ):
            return None
        x, y, z = (float(v) for v in theta[1:4] / theta[0])
        return replace(self, part="point", at=(x, y, z)) if x * x + y * y + z * z < farthest**2 else None

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the changes of mass, first moment and inertia."""
        a_unit = f"{IN_PROPORTION}{self.by.removeprefix('covariate.')}" if self.by else ""
        mass, moments = [Parameter("mass", f"kg{a_unit}")], [Parameter(name, f"kg m{a_unit}") for name in MOMENTS]
        inertia = [Parameter(name, "kg m^2") for name in INERTIA]
        body = mass + moments
        chosen = {"mass": mass, "moment": moments, "body": body, "point": body, "full": body + inertia}
        return tuple(chosen[self.part])

    def columns(self, scene: Scene) -> Columns:
        """Return the body's port."""
        if self.joint:
            return self._of_link(scene)
        port = scene.weight_port() if self.still else scene.body_port()
        assert port is not None, "proposed only where there is a port"
        values = port @ self._bodies(scene)
        if self.since is not None:
            values = values * (scene.time >= self.since)[:, None, None]
        if self.by:
            values = values * np.asarray(scene.observations.columns[self.by], dtype=float)[:, None, None]
        return Columns(tuple(range(len(scene.channels))), values)

    def _of_link(self, scene: Scene) -> Columns:
        link = scene.link_port(self.joint) if isinstance(scene, EffortScene) else None
        assert link is not None, "proposed only where there is a port"
        port, com = link
        point = np.concatenate([[1.0], com, _inertia_of_moment(com) @ com])
        bodies = {"mass": point[:, None], "moment": np.eye(10)[:, 1:4], "body": np.eye(10)[:, :4]}[self.part]
        return Columns(tuple(range(len(scene.channels))), port @ bodies)

    def body(self, scene: Scene, theta: Array) -> Array | None:
        """Return what it changes of a body at the sensor, (10,); None: it is on a link, or not there all along."""
        if self.joint or self.since is not None or self.by:
            return None
        return np.asarray(self._bodies(scene) @ theta)

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether what is carried with it weighs something, and is a distribution of mass where its inertia is free.

        Where it is known what is carried; what a controller takes off may be more. Second moments about the centre of mass
        along any axis u, u . S u with S = tr(I) / 2 - I, are of no sign but positive (Wensing, Kim, Slotine 2018).
        """
        carried = scene.carried_mass(self.joint)
        if self.part == "moment" or self.still or self.by or carried <= 0.0:
            return True
        if carried + theta[0] + 3.0 * spread[0] <= 0.0:
            return False
        tool = scene.belief.tool
        whole = tool.with_parameters(theta) if self.part == "full" and scene.observations.predict == "wrench" else None
        if whole is None:
            return True
        least, axes = np.linalg.eigh(0.5 * np.trace(whole.inertia) * np.eye(3) - whole.inertia)
        x, y, z = u = axes[:, 0]
        to_com = float(u @ whole.com)
        # S about the origin less m (u . c)^2, by mass, first moment and inertia.
        slopes = np.array(
            [
                to_com**2,
                *(-2.0 * to_com * u),
                0.5 - x * x,
                -2.0 * x * y,
                0.5 - y * y,
                -2.0 * x * z,
                -2.0 * y * z,
                0.5 - z * z,
            ]
        )
        return bool(least[0] + 3.0 * np.abs(slopes) @ spread >= 0.0)

    def _bodies(self, scene: Scene) -> Array:
        """Return the inertial parameters (10, k) per parameter of its own."""
        if self.part == "mass":
            return np.concatenate([[1.0], scene.belief.tool.com, np.zeros(6)])[:, None]
        if self.part == "moment":
            return np.eye(10)[:, 1:4]
        out = np.eye(10)[:, : 10 if self.part == "full" else 4]
        if self.part == "point":
            assert self.at is not None, "told by a body"
            # I is of degree one in m and m c together: its slopes where they stand are the whole of it there (Euler).
            at = np.array(self.at)
            of_moment = _inertia_of_moment(at)
            out[4:, 0], out[4:, 1:4] = -of_moment @ at, 2.0 * of_moment
        return out


def _inertia_of_moment(c: Array) -> Array:
    """Return the inertia (6, 3) about the origin, in the order of INERTIA, of mass at c (3,), by its first moment m c."""
    out = np.empty((6, 3))
    for k, unit in enumerate(np.eye(3)):
        inertia = c[k] * np.eye(3) - 0.5 * (np.outer(unit, c) + np.outer(c, unit))
        out[:, k] = [inertia[0, 0], inertia[0, 1], inertia[1, 1], inertia[0, 2], inertia[1, 2], inertia[2, 2]]
    return out


@dataclass(frozen=True)
class BaseTilt(Effect):
    """Gravity does not point where the model says: g' = exp([a, b, 0]) g, a and b about the base's x and y.

    Visible when the sensor turns about more than one axis. Confused with the offset of a first, level joint (roll
    of the Galen about x), and with payload where the poses are few.
    """

    KEY = "base_tilt"
    SAYS = "gravity does not point where the model says"
    KNOWN_BY = "it is what a turned gravity gives in all channels at once"
    CONFIRMED_BY = "put a level on the base, or turn the arm about a second axis"
    HEAD = ("tilt_.",)
    ALIKE: ClassVar = {
        "joint_offset": "the first joint turns about a level axis, as a tilt of the base does",
        "link_geometry": "a tilt before the first axis is the base's",
    }
    TOLD_APART: ClassVar = {
        "joint_offset": "put a level on the base; no motion of the arm can",
        "link_geometry": "put a level on the base; no motion of the arm can",
    }
    COMPLEXITY = 1
    RIGID = True
    GEOMETRY_ORDER = 2
    axis: str = "xy"

    @classmethod
    def propose(cls, scene: Scene) -> Iterator[Self]:
        """Yield both axes, and each alone."""
        if scene.gravity_port() is not None:
            yield from (cls(axis) for axis in ("x", "y", "xy"))

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the angles of gravity about the base's axes."""
        return tuple(Parameter(f"tilt_{letter}", "rad") for letter in self.axis)

    def columns(self, scene: Scene) -> Columns:
        """Return small turns of gravity through its port."""
        port = scene.gravity_port()
        assert port is not None, "proposed only where there is a port"
        turns = [np.cross(np.eye(3)["xy".index(a)], scene.belief.gravity) for a in self.axis]
        return Columns(tuple(range(len(scene.channels))), port @ np.stack(turns, axis=-1))

    def exact(self, scene: Scene, theta: Array) -> Array | None:
        """Return the change by the turned gravity itself."""
        port = scene.gravity_port()
        assert port is not None, "proposed only where there is a port"
        return np.asarray(port @ (self._turned(scene, theta) - scene.belief.gravity))

    def stands(self, scene: Scene, theta: Array) -> Scene | None:
        """Return the scene under the turned gravity."""
        return scene.under(self._turned(scene, theta))

    def _turned(self, scene: Scene, theta: Array) -> Array:
        vector = np.zeros(3)
        for letter, angle in zip(self.axis, theta, strict=True):
            vector["xy".index(letter)] = angle
        return np.asarray(rotation_exp(vector) @ scene.belief.gravity)


@dataclass(frozen=True)
class Inertial(Effect):
    """Forces of acceleration that the model leaves out.

    With joints: r = k (m a_c and Euler's terms) of the known bodies, k = 1, in a static model. `lever` (letters of the
    sensor's axes): the sensor's orientation alone is known, or its IMU sits elsewhere; its origin is at r from the centre of
    turn (from the IMU), and a = (alpha x + omega x omega x) r. A lever along the axis of turn is not seen and not asked for.
    `joint`: a rotor that turns with a joint's motor, r = J ddq in its effort, which the file of a robot seldom holds. Visible
    in quick motion. Confused with payload (inertia), with vibration, and with drift where the motion is slow.
    """

    KEY = "inertial"
    SAYS = "forces of acceleration that the static model leaves out"
    KNOWN_BY = "it follows the accelerations by the known masses"
    COMPLEXITY = 1
    HEAD = ("share", "lever_.", "rotor_inertia")
    NEEDS_CLOCK = True
    MEETS_BODIES = False
    lever: str = ""
    joint: str = ""

    @classmethod
    def propose(cls, scene: Scene, *, least: float = 0.03) -> Iterator[Self]:
        """Yield it where the baseline holds weight alone, and where the way of the sensor's origin is not recorded.

        Args:
            least: size of the answer to a lever along one axis over that of the largest, below which the
                turning does not show it.
        """
        if not scene.clock:
            return
        if scene.inertial_port() is not None:
            yield cls()
        for joint in scene.moved if scene.observations.predict == "effort" and scene.belief.robot is not None else ():
            if any(joint_of(name) == joint for name in scene.channels):
                yield cls(joint=joint)
        port = scene.turn_port()
        if port is not None:
            size = np.linalg.norm(port, axis=(0, 1))
            yield cls("".join(a for a, s in zip("xyz", size, strict=True) if s > least * size.max()))

    def parameters(self, scene: Scene, *, farthest: float = 2.0) -> tuple[Parameter, ...]:
        """Return the share of the rigid prediction, 1 when only inertia was left out; or the lever.

        Args:
            farthest: m between a sensor and the centre about which an arm turns it: the reach of the largest
                that carry one by hand.
        """
        if self.lever:
            return tuple(Parameter(f"lever_{a}", "m", furthest=farthest) for a in self.lever)
        if self.joint:
            turns = scene.units[self._place(scene)] == "N m"
            return (Parameter("rotor_inertia", "kg m^2" if turns else "kg", 0.0),)
        return (Parameter("share", "1", 0.0, expected=1.0),)

    def columns(self, scene: Scene) -> Columns:
        """Return the inertial port, or that of the lever."""
        if self.lever:
            turn = scene.turn_port()
            assert turn is not None, "proposed only where there is a port"
            return Columns(tuple(range(len(scene.channels))), turn[:, :, ["xyz".index(a) for a in self.lever]])
        if self.joint:
            return in_channel(self._place(scene), [scene.rates[1][:, scene.joint_index(self.joint)]])
        port = scene.inertial_port()
        assert port is not None, "proposed only where there is a port"
        return in_all([port], len(scene.channels))

    def _place(self, scene: Scene) -> int:
        return next(i for i, name in enumerate(scene.channels) if joint_of(name) == self.joint)
