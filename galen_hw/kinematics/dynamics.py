"""What the rigid links of a URDF need from their joints, by pinocchio."""

from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from galen_hw.kinematics.serial import UrdfChain, by_rows
from galen_hw.spatial import Array


class UrdfRobot(UrdfChain):
    """A robot read from a URDF: `UrdfChain` with the bodies of its links."""

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint efforts (N, n), N m or N, that the rigid robot needs for this motion under gravity (RNEA).

        A joint that others mimic bears theirs too. What the file says of friction and damping is no part of it.
        """
        rows = self._moved(q, dq, ddq)
        data = self._scratch(rows[0])

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            return np.asarray(pin.rnea(self.model, data, qi, vi, ai))

        return self._map.joined(by_rows(one, (self.model.nv,), *rows))

    def first_moment(self, q: ArrayLike) -> Array | None:
        """Return the first moment (N, 3), kg m, of all links that joints move, about the base's origin and in its axes.

        None: joints move the base itself.
        """
        if self._inv_base is None:
            return None
        still = np.zeros_like(np.asarray(q, dtype=float))
        rows = self._moved(q, still, still)
        data, mass = self._scratch(rows[0]), float(pin.computeTotalMass(self.model))

        def one(qi: Array) -> Array:
            return mass * np.asarray(pin.centerOfMass(self.model, data, qi))

        whole = by_rows(one, (3,), rows[0])
        return np.asarray(whole @ self._inv_base[:3, :3].T + mass * self._inv_base[:3, 3])

    @property
    def carrier(self) -> int | None:
        """Joint of the model that carries the sensor and its load; None where it is fixed to the root."""
        return int(self.model.frames[self._sensor].parentJoint) or None

    def with_load(self, body: ArrayLike) -> Self | None:
        """The same robot whose link at the sensor has inertial parameters (10,) more, as of `load_regressor`.

        None: nothing weighs there then, or it is fixed to the root.
        """
        joint = self.carrier
        if joint is None:
            return None
        total = self.model.inertias[joint].toDynamicParameters() + np.asarray(body, dtype=float)
        if not total[0] > 0.0:
            return None
        other = self._of(pin.Model(self.model))
        other.model.inertias[joint] = pin.Inertia.FromDynamicParameters(total)
        return other

    def carrying(self, mass: float, com: ArrayLike, inertia: ArrayLike) -> Self:
        """The same robot with one more body fixed to its sensor.

        Args:
            mass: kg; com: (3,) in the sensor frame, m; inertia: (3, 3) about the centre of mass, sensor axes, kg m^2.
        """
        other, frame = self._of(pin.Model(self.model)), self.model.frames[self._sensor]
        body = pin.Inertia(float(mass), np.asarray(com, dtype=float), np.asarray(inertia, dtype=float))
        other.model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
        return other

    def without(self, mass: float, com: ArrayLike, inertia: ArrayLike) -> Self:
        """Return the same robot less a body that it carries: inertial parameters add up.

        Args:
            mass: kg; com: (3,) in the sensor frame, m; inertia: (3, 3) about the centre of mass, sensor axes, kg m^2.
        """
        other, frame = self._of(pin.Model(self.model)), self.model.frames[self._sensor]
        body = pin.Inertia(float(mass), np.asarray(com, dtype=float), np.asarray(inertia, dtype=float))
        whole = other.model.inertias[frame.parentJoint].toDynamicParameters()
        rest = whole - frame.placement.act(body).toDynamicParameters()
        other.model.inertias[frame.parentJoint] = pin.Inertia.FromDynamicParameters(rest)
        return other

    def link_body(self, link: str) -> tuple[float, Array, Array]:
        """Mass, kg, centre of mass (3,), m, and inertia about it (3, 3), kg m^2, of a link, in its own axes.

        Raises:
            UsageError: there is no such link.
        """
        self._frame(link)
        own = self.urdf.links[link]
        return own.mass, own.com.copy(), own.inertia.copy()

    def under(self, gravity: ArrayLike) -> Self:
        """The same robot under another gravity (3,), m/s^2, in the axes of its base (see `gravity`)."""
        other = self._of(pin.Model(self.model))
        other.gravity = np.asarray(gravity, dtype=float)
        other.model.gravity.linear = self._T_zero_base[:3, :3] @ other.gravity
        return other

    @property
    def bodiless(self) -> dict[str, int]:
        """Links that a joint moves and that weigh nothing, with all that is fixed to them: names, and that joint of the model."""
        massless = [k for k in range(1, self.model.njoints) if self.model.inertias[k].mass == 0.0]
        return {self.urdf.joints[self.model.names[k]].child: k for k in massless}

    def moved_body(self, joint: str) -> tuple[int, Array]:
        """Return the number of a joint in the model, and the centre of mass (3,) of all that is fixed to it, m, in its axes."""
        number = int(self.model.getJointId(joint))
        return number, np.array(self.model.inertias[number].lever)

    def moved_mass(self, joint: str = "") -> float:
        """Return the mass of all that is fixed to a joint, or to that of the sensor, kg; 0 where none moves it."""
        number = int(self.model.getJointId(joint)) if joint else self.carrier
        return 0.0 if number is None else float(self.model.inertias[number].mass)

    def load_regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint efforts per inertial parameter of the link at the sensor, see `body_regressor`; of nothing where it is fixed."""
        return self.body_regressor(self.carrier or 0, q, dq, ddq)

    def body_regressor(self, joint: int, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint efforts per inertial parameter of what a joint of the model moves, (N, n, 10): m, m c, I about that joint.

        Args:
            joint: of `carrier` or `bodiless`; 0, the root: nothing.
        """
        rows = self._moved(q, dq, ddq)
        data = self._scratch(rows[0])

        def one(qi: Array, vi: Array, ai: Array) -> Array:
            whole = np.asarray(pin.computeJointTorqueRegressor(self.model, data, qi, vi, ai))
            return whole.reshape(self.model.nv, -1)[:, 10 * (joint - 1) : 10 * joint]

        if not joint:
            return np.zeros((len(rows[0]), len(self.joint_names), 10))
        efforts = by_rows(one, (self.model.nv, 10), *rows)
        return np.swapaxes(self._map.joined(np.swapaxes(efforts, 1, 2)), 1, 2)
