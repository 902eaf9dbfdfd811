"""Where the virtual robot's joints are at any time, and how its sensor then moves."""

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.clock import NS_PER_S
from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.spatial import Array

JointState: TypeAlias = tuple[Array, Array, Array]
"""(q, dq, ddq), each (n,): m or rad and their rates."""

EXTRAPOLATION_S: Final = 0.1
"""A controller that has not been heard of for so long has stopped."""

_KEPT: Final = 4096
_CLOSE_NS: Final = 1_000_000


class JointHistory:
    """What the motor controller said of its joints, interpolated and extrapolated.

    Args:
        count: number of joints; they rest at zero until told otherwise.
    """

    def __init__(self, count: int) -> None:
        zeros = np.zeros(count)
        self._times: list[int] = [0]
        self._states: list[JointState] = [(zeros, zeros, zeros)]
        self._moving = False
        self._frozen: JointState | None = None

    def set(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t_ns: int) -> None:
        """Add a state at `t_ns`; what was said of that time or later is forgotten."""
        state = (np.array(q, dtype=float), np.array(dq, dtype=float), np.array(ddq, dtype=float))
        while len(self._times) > 1 and self._times[-1] >= t_ns:
            self._times.pop()
            self._states.pop()
        moving = bool(state[1].any() or state[2].any())
        if not moving and not self._moving and (state[0] == self._states[-1][0]).all():
            return  # Still at rest at the same place: one state says it all, and caches stay warm.
        self._times.append(t_ns)
        self._states.append(state)
        self._moving, self._frozen = moving, None
        if len(self._times) > 2 * _KEPT:
            del self._times[:_KEPT], self._states[:_KEPT]

    def at(self, t_ns: int) -> JointState:
        """The state at `t_ns`; while the robot rests this is the very same object again."""
        last = self._times[-1]
        if t_ns >= last:
            return self._extrapolated((t_ns - last) / NS_PER_S) if self._moving else self._states[-1]
        index = bisect_right(self._times, t_ns)
        return self._states[0] if index == 0 else self._between(index - 1, t_ns)

    def _extrapolated(self, dt: float) -> JointState:
        q, dq, ddq = self._states[-1]
        if dt <= EXTRAPOLATION_S:
            return q + dt * dq + (0.5 * dt * dt) * ddq, dq + dt * ddq, ddq
        if self._frozen is None:
            end = q + EXTRAPOLATION_S * dq + (0.5 * EXTRAPOLATION_S**2) * ddq
            self._frozen = (end, np.zeros_like(q), np.zeros_like(q))
        return self._frozen

    def _between(self, index: int, t_ns: int) -> JointState:
        """Cubic through positions and velocities, so that both are continuous; the acceleration is the cubic's.

        Between states that lie closer together the nanosecond of their times would show in it: there it is the states'.
        """
        (qa, va, aa), (qb, vb, ab) = self._states[index], self._states[index + 1]
        ta, tb = self._times[index], self._times[index + 1]
        if not (va.any() or vb.any() or aa.any() or ab.any()) and (qa == qb).all():
            return self._states[index]
        if (tb - ta) > EXTRAPOLATION_S * NS_PER_S and not (va.any() or aa.any()):
            return self._states[index]  # It rested; the new state came as a jump.
        h = (tb - ta) / NS_PER_S
        s = (t_ns - ta) / (tb - ta)
        d = (qb - qa) / h
        c2, c3 = 3.0 * d - 2.0 * va - vb, va + vb - 2.0 * d
        q = qa + h * s * (va + s * (c2 + s * c3))
        own = aa + s * (ab - aa) if tb - ta < _CLOSE_NS else (2.0 * c2 + 6.0 * s * c3) / h
        return q, va + s * (2.0 * c2 + 3.0 * s * c3), own


@dataclass(frozen=True, slots=True)
class SensorMotion:
    """How the sensor moves, in base coordinates and without gravity; compare `kinematics.Motion`, one sample.

    Args:
        R: (3, 3) sensor to base; p, v, a: (3,) of its origin, m and per s; omega, alpha: (3,) rad/s, rad/s^2.
        rest: nothing moves: v, a, omega and alpha are zero.
    """

    R: Array
    p: Array
    v: Array
    a: Array
    omega: Array
    alpha: Array
    rest: bool


MotionFunction: TypeAlias = Callable[[JointState], SensorMotion]


def motion_function(robot: Robot) -> MotionFunction:
    """The sensor's motion of a joint state. For the Galen in plain floats: ten times quicker for a single sample."""
    return _galen_motion(robot) if isinstance(robot, GalenRobot) else _general_motion(robot)


def _general_motion(robot: Robot) -> MotionFunction:
    def motion(state: JointState) -> SensorMotion:
        q, dq, ddq = state
        m = robot.sensor_motion(q, dq, ddq)
        v = robot.sensor_jacobian(q)[0, :3] @ dq
        rest = not (dq.any() or ddq.any())
        return SensorMotion(m.T[0, :3, :3], m.T[0, :3, 3], v, m.acceleration[0], m.omega[0], m.alpha[0], rest)

    return motion


_V3: TypeAlias = tuple[float, float, float]


def _cross(a: _V3, b: _V3) -> _V3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _galen_motion(robot: GalenRobot) -> MotionFunction:
    """Chain of platform, roll and tilt differentiated twice by hand."""
    platform = _delta(robot)
    ox, oy, oz = robot.platform_to_roll
    arm0, end0 = robot.roll_to_tilt, robot.tilt_to_sensor

    def motion(state: JointState) -> SensorMotion:
        c1, c2, c3, roll, tilt = state[0].tolist()
        dc1, dc2, dc3, droll, dtilt = state[1].tolist()
        ac1, ac2, ac3, aroll, atilt = state[2].tolist()
        cr, sr, ct, st = math.cos(roll), math.sin(roll), math.cos(tilt), math.sin(tilt)
        arm = (arm0[0], cr * arm0[1] - sr * arm0[2], sr * arm0[1] + cr * arm0[2])
        ex, ey, ez = ct * end0[0] + st * end0[2], end0[1], ct * end0[2] - st * end0[0]
        end = (ex, cr * ey - sr * ez, sr * ey + cr * ez)
        omega = (droll, dtilt * cr, dtilt * sr)
        # The tilt axis (0, cr, sr) itself turns with the roll.
        alpha = (aroll, atilt * cr - dtilt * droll * sr, atilt * sr + dtilt * droll * cr)
        p, v, a = platform((c1, c2, c3), (dc1, dc2, dc3), (ac1, ac2, ac3))
        w1, a1 = (droll, 0.0, 0.0), (aroll, 0.0, 0.0)
        va, ve = _cross(w1, arm), _cross(omega, end)
        terms = (_cross(a1, arm), _cross(w1, va), _cross(alpha, end), _cross(omega, ve))
        return SensorMotion(
            R=np.array(((ct, 0.0, st), (sr * st, cr, -sr * ct), (-cr * st, sr, cr * ct))),
            p=np.array((p[0] + ox + arm[0] + end[0], p[1] + oy + arm[1] + end[1], p[2] + oz + arm[2] + end[2])),
            v=np.array((v[0] + va[0] + ve[0], v[1] + va[1] + ve[1], v[2] + va[2] + ve[2])),
            a=np.array([a[i] + terms[0][i] + terms[1][i] + terms[2][i] + terms[3][i] for i in range(3)]),
            omega=np.array(omega),
            alpha=np.array(alpha),
            rest=not (any(omega) or any(alpha) or dc1 or dc2 or dc3 or ac1 or ac2 or ac3),
        )

    return motion


def _delta(robot: GalenRobot) -> Callable[[_V3, _V3, _V3], tuple[_V3, _V3, _V3]]:
    """Platform position, velocity and acceleration of the carriages: |rod| = L, and differentiated once and twice."""
    delta = robot.delta
    towers = [(delta.radius * math.cos(a), delta.radius * math.sin(a)) for a in delta.azimuths]

    def solve(rods: list[_V3], right: list[float]) -> _V3:
        r1, r2, r3 = rods
        c23, c31, c12 = _cross(r2, r3), _cross(r3, r1), _cross(r1, r2)
        det = r1[0] * c23[0] + r1[1] * c23[1] + r1[2] * c23[2]
        a, b, c = (x / det for x in right)
        return (
            a * c23[0] + b * c31[0] + c * c12[0],
            a * c23[1] + b * c31[1] + c * c12[1],
            a * c23[2] + b * c31[2] + c * c12[2],
        )

    home2 = delta.rod_length**2 - delta.radius**2
    meet = _meeting_point(towers, delta.rod_length, math.sqrt(home2))

    def platform(c: _V3, dc: _V3, ddc: _V3) -> tuple[_V3, _V3, _V3]:
        x, y, z = meet(c)
        flat = [(x - tx, y - ty) for tx, ty in towers]
        rods = [(fx, fy, math.sqrt(max(delta.rod_length**2 - fx * fx - fy * fy, 1e-6))) for fx, fy in flat]
        v = solve(rods, [rod[2] * d for rod, d in zip(rods, dc, strict=True)])
        flat2 = v[0] * v[0] + v[1] * v[1]
        right = [rod[2] * dd - flat2 - (v[2] - d) ** 2 for rod, d, dd in zip(rods, dc, ddc, strict=True)]
        return (x, y, z), v, solve(rods, right)

    return platform


def _meeting_point(towers: list[tuple[float, float]], length: float, home: float) -> Callable[[_V3], _V3]:
    """The upper point that is `length` from three carriages: two linear equations in x, y and z, then a quadratic."""
    (x1, y1), (x2, y2), (x3, y3) = towers
    ux, uy, wx, wy = x2 - x1, y2 - y1, x3 - x1, y3 - y1
    det = ux * wy - uy * wx

    def meet(c: _V3) -> _V3:
        h1, h2, h3 = c[0] - home, c[1] - home, c[2] - home
        k2 = 0.5 * (x2 * x2 + y2 * y2 + h2 * h2 - x1 * x1 - y1 * y1 - h1 * h1)
        k3 = 0.5 * (x3 * x3 + y3 * y3 + h3 * h3 - x1 * x1 - y1 * y1 - h1 * h1)
        # x = ax + bx z, y = ay + by z
        ax, bx = (k2 * wy - k3 * uy) / det, -((h2 - h1) * wy - (h3 - h1) * uy) / det
        ay, by = (k3 * ux - k2 * wx) / det, -((h3 - h1) * ux - (h2 - h1) * wx) / det
        dx, dy = ax - x1, ay - y1
        a, b = bx * bx + by * by + 1.0, bx * dx + by * dy - h1
        disc = b * b - a * (dx * dx + dy * dy + h1 * h1 - length * length)
        z = (math.sqrt(max(disc, 0.0)) - b) / a  # Out of reach the rods stay stretched: a world has no NaN.
        return ax + bx * z, ay + by * z, z

    return meet
