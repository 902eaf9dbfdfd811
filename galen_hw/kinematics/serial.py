"""How the links of a URDF move, by pinocchio: a chain to the sensor, with whatever stands beside it on the same tree."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from galen_hw.errors import UsageError
from galen_hw.kinematics.joint_map import JointMap, joint_map, sources
from galen_hw.kinematics.motion import NOMINAL_GRAVITY, Motion, batch
from galen_hw.kinematics.urdf import FREE, TURNING, Urdf, read_urdf
from galen_hw.spatial import Array

WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class UrdfChain:
    """Links of a URDF and the joints that move them.

    Its `joint_names` are all joints that move and follow no other, in pinocchio's order; `keeping` makes them fewer.
    Positions are plain: rad of revolute and continuous joints, m of prismatic ones; a joint that mimics another is
    computed from it.

    Args:
        urdf: Path of the file, or its text as a str.
        sensor_link: link whose frame is the sensor's; `Urdf.longest` if None.
        base_link: link in which poses are given; the root if None. Joints may move it.
        gravity: (3,) m/s^2 in the base's axes, as the base stands at the zero of the joints that move it.

    Raises:
        UsageError: the file cannot be read, or a link is not in it.
    """

    def __init__(
        self,
        urdf: Path | str,
        *,
        sensor_link: str | None = None,
        base_link: str | None = None,
        gravity: ArrayLike = NOMINAL_GRAVITY,
    ) -> None:
        self.urdf: Urdf = read_urdf(urdf)
        self.model = _load(self.urdf)
        self.name: str = self.model.name
        self._data = self.model.createData()
        self.sensor_link: str = sensor_link or self.urdf.longest()
        self.base_link: str = base_link or self.urdf.root
        self._sensor, self._base = self._frame(self.sensor_link), self._frame(self.base_link)
        self._check_free()
        pin.framesForwardKinematics(self.model, self._data, joint_map(self.urdf, self._order, ()).b)
        self._T_zero_base: Array = np.array(self._data.oMf[self._base].homogeneous)
        self._read(joint_map(self.urdf, self._order))
        self.gravity: Array = np.asarray(gravity, dtype=float)
        self.model.gravity.linear = self._T_zero_base[:3, :3] @ self.gravity

    @property
    def _order(self) -> tuple[str, ...]:
        """All joints of the model that move."""
        return tuple(self.model.names)[1:]

    def _read(self, joints: JointMap) -> Self:
        """Read the joints of a map; where none of them moves the base, it stands where the map has it."""
        self._map = joints
        self.joint_names: tuple[str, ...] = joints.names
        places = [self._order.index(name) for name in joints.names]
        endless = np.array([self.urdf.joints[name].kind == "continuous" for name in joints.names], dtype=bool)
        self.lower: Array = np.where(endless, -np.inf, self.model.lowerPositionLimit[places])
        self.upper: Array = np.where(endless, np.inf, self.model.upperPositionLimit[places])
        if set(self.moving_base).intersection(joints.names):
            return self._stand(None)
        pin.framesForwardKinematics(self.model, self._data, joints.b)
        return self._stand(np.array(self._data.oMf[self._base].homogeneous))

    def _stand(self, T_root_base: Array | None) -> Self:
        """The base stands there (4, 4) in the root; None: its joints say where."""
        self._T_root_base = T_root_base
        self._inv_base = None if T_root_base is None else np.linalg.inv(T_root_base)
        return self

    def _of(self, model: pin.Model) -> Self:
        other = copy(self)
        vars(other).update(model=model, _data=model.createData())
        return other

    def _check_free(self) -> None:
        lost = [name for name in self._path if self.urdf.joints[name].kind in FREE]
        if lost:
            where, what = f"{self.urdf.where}: joint {lost[0]}", f"{self.urdf.joints[lost[0]].kind} joints are not read"
            todo = "name links that no such joint parts as base_link and sensor_link"
            raise UsageError(f"{what}, and it moves the sensor in the base", where=where, todo=todo)

    def _frame(self, link: str) -> int:
        if not self.model.existFrame(link, pin.FrameType.BODY):
            known = ", ".join(self.urdf.links)
            raise UsageError(f"no link {link!r}", where=self.name, todo=f"one of: {known}")
        return int(self.model.getFrameId(link, pin.FrameType.BODY))

    def _scratch(self, rows: Array) -> pin.Data:
        """Pinocchio's working memory: every batch has its own, so that threads may ask at once; live rows share one."""
        return self._data if len(rows) == 1 else self.model.createData()

    @property
    def _path(self) -> tuple[str, ...]:
        return self._between(self.base_link, self.sensor_link)

    def _between(self, one: str, other: str) -> tuple[str, ...]:
        """Joints of the file on the way from a link to another, fixed ones too."""
        up, down = self.urdf.carriers(one), self.urdf.carriers(other)
        return tuple(j for j in up[::-1] if j not in down) + tuple(j for j in down if j not in up)

    def moving(self, link: str | None = None, against: str | None = None) -> tuple[str, ...]:
        """Joints that have to be read for the pose of a link (the sensor's if None) in another (the base) to be known."""
        return sources(self.urdf, self._between(against or self.base_link, link or self.sensor_link))

    @property
    def independent(self) -> tuple[str, ...]:
        """All joints of the file that move and follow no other."""
        return joint_map(self.urdf, self._order).names

    def beyond(self, link: str) -> tuple[str, ...]:
        """Joints that move what a link carries: those that are read to know it."""
        carriers = self.urdf.carriers(link)
        below = (j for n in self.urdf.links if (c := self.urdf.carriers(n))[: len(carriers)] == carriers for j in c)
        return sources(self.urdf, [j for j in dict.fromkeys(below) if j not in carriers])

    @property
    def moving_base(self) -> tuple[str, ...]:
        """Joints that move the base against the root."""
        return sources(self.urdf, self.urdf.carriers(self.base_link))

    def keeping(self, names: Sequence[str], at: Mapping[str, float] | None = None) -> Self:
        """The same robot of which only some joints are read: others stand `at` rad or m, at zero where nothing is said."""
        return self._of(self.model)._read(  # noqa: SLF001 - a copy of its own
            joint_map(self.urdf, self._order, names, at)
        )

    def standing(self) -> Self:
        """The same robot with poses in a frame that does not move with the base: where the base is at its joints' zero.

        There gravity is constant, and accelerations are those of mechanics.
        """
        return self._of(self.model)._stand(self._T_zero_base)  # noqa: SLF001 - a copy of its own

    @property
    def chain(self) -> tuple[tuple[str, ...], ...]:
        """Joints that carry the sensor, the base's first, one a link."""
        carried = self.urdf.carriers(self.sensor_link)
        below = self.urdf.carriers(self.base_link) if self._T_root_base is None else ()
        return tuple((name,) for name in carried if name in self.joint_names and name not in below)

    def slides(self, joint: str) -> bool:
        """Return whether a joint is prismatic."""
        return self.urdf.joints[joint].kind == "prismatic"

    def _moved_by(self, joint: str) -> int:
        """Frame of the link that a joint moves, at the joint."""
        return int(self.model.getFrameId(joint, pin.FrameType.JOINT))

    def frame_pose(self, q: ArrayLike, link: str | None = None) -> Array:
        """Pose (N, 4, 4) of `link` (the sensor if None) in the base."""
        return self._pose(q, self._sensor if link is None else self._frame(link))

    def link_pose(self, q: ArrayLike, joint: str) -> Array:
        """Pose (N, 4, 4) in the base of the link that a joint moves, at the joint."""
        return self._pose(q, self._moved_by(joint))

    def _pose(self, q: ArrayLike, frame: int) -> Array:
        rows = self._map.positions(batch(q))
        data = self._scratch(rows)

        def one(qi: Array) -> Array:
            pin.forwardKinematics(self.model, data, qi)
            T = pin.updateFramePlacement(self.model, data, frame)
            if self._inv_base is None:
                T = pin.updateFramePlacement(self.model, data, self._base).actInv(T)
            return np.asarray(T.homogeneous)

        poses = by_rows(one, (4, 4), rows)
        return poses if self._inv_base is None else np.asarray(self._inv_base @ poses)

    def sensor_pose(self, q: ArrayLike) -> Array:
        """Pose (N, 4, 4) of the sensor in the base."""
        return self.frame_pose(q)

    def sensor_jacobian(self, q: ArrayLike) -> Array:
        """Twist [v, w] of the sensor's origin per joint rate, (N, 6, n), against the base and in its axes."""
        return self._jacobian(q, self._sensor)

    def link_jacobian(self, q: ArrayLike, joint: str) -> Array:
        """The same of the link that a joint moves, at the joint."""
        return self._jacobian(q, self._moved_by(joint))

    def _jacobian(self, q: ArrayLike, frame: int) -> Array:
        rows = self._map.positions(batch(q))
        data = self._scratch(rows)

        def one(qi: Array) -> Array:
            J = np.asarray(pin.computeFrameJacobian(self.model, data, qi, frame, WORLD)).reshape(6, -1)
            if self._T_root_base is not None:
                return _turned(self._T_root_base, J)
            Jb = np.asarray(pin.computeFrameJacobian(self.model, data, qi, self._base, WORLD)).reshape(6, -1)
            at, base = (pin.updateFramePlacement(self.model, data, f) for f in (frame, self._base))
            carried = Jb[:3] + np.cross(Jb[3:], (at.translation - base.translation)[:, None], axis=0)
            return _turned(base.homogeneous, J - np.concatenate([carried, Jb[3:]]))

        return self._map.joined(by_rows(one, (6, self.model.nv), rows))

    def sensor_motion(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Motion:
        """Pose of the sensor in the base, its acceleration and rates against the root in the base's axes, see `Motion`."""
        all_q, v, a = self._moved(q, dq, ddq)
        data = self._scratch(all_q)

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            pin.forwardKinematics(self.model, data, qi, vi, ai)
            pin.updateFramePlacement(self.model, data, self._sensor)
            base = pin.updateFramePlacement(self.model, data, self._base).rotation
            R = base if self._T_root_base is None else self._T_root_base[:3, :3]
            speed = pin.getFrameVelocity(self.model, data, self._sensor, WORLD)
            rise = pin.getFrameClassicalAcceleration(self.model, data, self._sensor, WORLD)
            return np.stack([rise.linear, speed.angular, rise.angular]) @ R

        rates = by_rows(one, (3, 3), all_q, v, a)
        return Motion(self.sensor_pose(q), rates[:, 0], rates[:, 1], rates[:, 2])

    def _moved(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, Array, Array]:
        """Of all joints of the model."""
        return self._map.positions(batch(q)), self._map.rates(batch(dq)), self._map.rates(batch(ddq))

    def turning_frames(self, q: ArrayLike) -> list[tuple[str, Array, Array]]:
        """Of each joint that turns the sensor: its name, frame (N, 4, 4) in the base just before it turns, axis (3,) there."""
        rows, out = self._map.positions(batch(q)), []
        data = self.model.createData()
        names = [name for (name,) in self.chain if self.urdf.joints[name].kind in TURNING]
        places = [self._order.index(name) + 1 for name in names]

        def one(qi: Array) -> Array:
            pin.forwardKinematics(self.model, data, qi)
            if self._inv_base is None:
                base = pin.updateFramePlacement(self.model, data, self._base).inverse().homogeneous
            else:
                base = self._inv_base
            before = [data.oMi[self.model.parents[j]] * self.model.jointPlacements[j] for j in places]
            return np.array([base @ T.homogeneous for T in before])

        frames = by_rows(one, (len(names), 4, 4), rows)
        for k, (name, j) in enumerate(zip(names, places, strict=True)):
            out.append((name, frames[:, k], np.asarray(self.model.joints[j].createData().S).reshape(6)[3:]))
        return out


def _load(urdf: Urdf) -> pin.Model:
    try:
        return pin.buildModelFromXML(urdf.text)
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"not a readable URDF ({error})", where=urdf.where[:80], todo="check the file") from error


def _turned(T: Array, J: Array) -> Array:
    """(6, n) of the root's axes in those of a frame (4, 4)."""
    return np.asarray(np.kron(np.eye(2), T[:3, :3].T) @ J)


def by_rows(one: Callable[..., Array], shape: tuple[int, ...], *inputs: Array) -> Array:
    """Apply pinocchio's one-sample functions row by row."""
    out = np.empty((len(inputs[0]), *shape))
    # pinocchio gives a vector for some matrices of one column, and of no frame. Else a reshape takes longer than the dynamics.
    thin = shape[-1:] == (1,) or not out.size
    for i, row in enumerate(zip(*inputs, strict=True)):
        out[i] = np.reshape(one(*row), shape) if thin else one(*row)
    return out
