"""The joint model of all readings of a sweep, with its derivative by every unknown.

At a pose with sensor orientation R, gravity g and s = (R Exp(u))^T Exp(a) g:

    reading = tool ( m s, h x s ) + body ( m_b (s - s_0), h_b x (s - s_0) ) + bias + drift(t)

h = m c is the first moment, s_0 is s where the sensor was zeroed (0 if it was not), `tool` is 1 with the tool on. All
is linear but the two small rotations: a tilts gravity about base x and y (the base is not level), u turns the sensor
on its link (mounting). The equations and the picture of the frames are in `docs/calibration.md`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.identification.poses import Poses
from galen_hw.physics.rigid import gravity_in_sensor, weight_map
from galen_hw.spatial import Array, rotation_exp, skew

CHANNELS: Final = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
TOOL: Final = ("mass", "moment.x", "moment.y", "moment.z")
BODY: Final = tuple(f"bias_body.{name}" for name in TOOL)
BIAS: Final = tuple(f"bias.{c}" for c in CHANNELS)
TILT: Final = ("gravity.tilt_x", "gravity.tilt_y")
PRIOR_MOMENT: Final = 3e-3
"""kg m: 0.1 kg at 3 cm from the sensor's origin."""
PRIOR_ZERO: Final = (0.02, 0.02, 0.02, 5e-4, 5e-4, 5e-4)
"""N and N m: how well a sensor that was zeroed still reads zero (its average's noise, and drift since)."""
MOUNT: Final = ("mounting.x", "mounting.y", "mounting.z")


@dataclass(frozen=True, slots=True)
class Unknowns:
    """Which unknowns a fit has beside the tool's mass and first moment.

    Args:
        bias: six constant offsets beyond what the zeroing explains.
        trust_zero: the sensor was zeroed, so that these offsets are small (`PRIOR_ZERO`).
        body: the bias body's mass and first moment (from poses with no tool, or from the zeroing).
        drift: degree of a polynomial in time for each channel; 0 for none.
        tilt: two angles of the gravity's direction.
        mount: three angles of the sensor on its link.
    """

    bias: bool = True
    trust_zero: bool = False
    body: bool = False
    drift: int = 0
    tilt: bool = False
    mount: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        drift = tuple(name for k in range(self.drift) for name in drift_names(k))
        parts = (
            (True, TOOL),
            (self.body, BODY),
            (self.bias, BIAS),
            (True, drift),
            (self.tilt, TILT),
            (self.mount, MOUNT),
        )
        return tuple(name for there, names in parts if there for name in names)


class Model:
    """Prediction and derivative at the poses of a sweep.

    Args:
        poses: the rows.
        unknowns: what is fitted.
        span: (first, last) time of the whole sweep, by which the drift's clock runs from -1 to 1.
    """

    def __init__(self, poses: Poses, unknowns: Unknowns, span: tuple[float, float]) -> None:
        self.poses, self.unknowns, self.names = poses, unknowns, unknowns.names
        self.columns = {name: i for i, name in enumerate(self.names)}
        self.clock = clock(poses.clock, span)
        self.known = np.zeros((6, 3)) if poses.bias_body is None else weight_map(poses.bias_body)
        self.basis = normal_basis(poses.gravity)
        self._linear: tuple[Array, Array] | None = None

    def evaluate(self, theta: Array) -> tuple[Array, Array]:
        """Predicted readings (n, 6) and their derivative (n, 6, p) at parameters (p,)."""
        if self._linear is not None:
            constant, J = self._linear
            return J @ theta + constant, J
        J = np.zeros((len(self.poses), 6, len(self.names)))
        s, by_tilt, by_mount = self._gravity(theta, self.poses.R)
        on = self.poses.tool.astype(float)[:, None, None]
        hung, hung_by_tilt, hung_by_mount = s, by_tilt, by_mount
        if self.poses.zero is not None:
            s0, s0_by_tilt, s0_by_mount = self._gravity(theta, self.poses.zero[None])
            hung, hung_by_tilt, hung_by_mount = s - s0, by_tilt - s0_by_tilt, by_mount - s0_by_mount
        self._fill(J, TOOL, on * weight_columns(s))
        if self.unknowns.body:
            self._fill(J, BODY, weight_columns(hung))
        if self.unknowns.bias:
            self._fill(J, BIAS, np.broadcast_to(np.eye(6), (len(J), 6, 6)))
        for k in range(self.unknowns.drift):
            self._fill(J, drift_names(k), self._power(k + 1)[:, None, None] * np.eye(6))
        constant = hung @ self.known.T
        prediction = J @ theta + constant
        if not (self.unknowns.tilt or self.unknowns.mount):
            self._linear = constant, J
            return prediction, J
        W_t, W_b = self._maps(theta)
        if self.unknowns.tilt:
            self._fill(J, TILT, on * (W_t @ by_tilt) + W_b @ hung_by_tilt)
        if self.unknowns.mount:
            self._fill(J, MOUNT, on * (W_t @ by_mount) + W_b @ hung_by_mount)
        return prediction, J

    def prior(self, theta: Array) -> tuple[Array, Array]:
        """Rows (k, p) and targets (k,), in standard deviations, of what is known before any pose.

        The bias body's first moment along gravity at the zeroing pose leaves no trace without poses of the bare
        sensor; what hangs on a sensor's face lies within centimetres, which is all that is assumed.
        """
        scales = np.full(len(theta), np.inf)
        if self.unknowns.body:
            first = self.columns[BODY[1]]
            scales[first : first + 3] = PRIOR_MOMENT
        if self.unknowns.bias and self.unknowns.trust_zero:
            first = self.columns[BIAS[0]]
            scales[first : first + 6] = PRIOR_ZERO
        rows = np.diag(1.0 / scales)[np.isfinite(scales)]
        return rows, -rows @ theta

    def _power(self, k: int) -> Array:
        """Legendre's P_k of the clock, so that the terms hardly correlate."""
        return np.asarray(np.polynomial.legendre.legval(self.clock, np.eye(k + 1)[k]))

    def _fill(self, J: Array, names: tuple[str, ...], values: Array) -> None:
        first = self.columns[names[0]]
        J[:, :, first : first + len(names)] = values

    def _maps(self, theta: Array) -> tuple[Array, Array]:
        """(6, 3) maps of s to the wrench of tool and bias body."""
        c = self.columns
        tool = theta[[c[name] for name in TOOL]]
        body = theta[[c[name] for name in BODY]] if self.unknowns.body else np.zeros(4)
        return moment_map(tool), moment_map(body) + self.known

    def _gravity(self, theta: Array, R: Array) -> tuple[Array, Array, Array]:
        """Gravity s (n, 3) and its derivatives by tilt (n, 3, 2) and mounting (n, 3, 3)."""
        tilt, turn = self.angles(theta)
        turned, g = R @ rotation_exp(turn), rotation_exp(tilt) @ self.poses.gravity
        s = gravity_in_sensor(turned, g)
        by_tilt = np.swapaxes(turned, -1, -2) @ (-skew(g) @ left_jacobian(tilt) @ self.basis)
        return s, by_tilt, skew(s) @ left_jacobian(-turn)

    def angles(self, theta: Array) -> tuple[Array, Array]:
        """Rotation vectors (3,) of the tilt of gravity (base) and of the sensor's mounting (sensor)."""
        c = self.columns
        tilt = self.basis @ theta[[c[n] for n in TILT]] if self.unknowns.tilt else np.zeros(3)
        turn = theta[[c[n] for n in MOUNT]] if self.unknowns.mount else np.zeros(3)
        return tilt, turn


def drift_names(k: int) -> tuple[str, ...]:
    """Names of the drift's terms of degree k + 1."""
    return tuple(f"drift{k + 1}.{c}" for c in CHANNELS)


def clock(time: Array, span: tuple[float, float]) -> Array:
    """Time as -1 at the first and 1 at the last moment of the sweep."""
    first, last = span
    return np.asarray((2.0 * time - first - last) / max(last - first, 1e-9))


def weight_columns(s: Array) -> Array:
    """(n, 6, 4): derivative of a weight's wrench by its mass and first moment, at gravity s (n, 3)."""
    out = np.zeros((len(s), 6, 4))
    out[:, :3, 0], out[:, 3:, 1:] = s, -skew(s)
    return out


def moment_map(body: Array) -> Array:
    """(6, 3) map of s to the wrench of a body given as (mass, first moment)."""
    W = np.zeros((6, 3))
    W[:3], W[3:] = body[0] * np.eye(3), skew(body[1:])
    return W


def normal_basis(g: Array) -> Array:
    """(3, 2) unit vectors normal to g: base x and y if g is along z."""
    z = -g / np.linalg.norm(g)
    x = np.eye(3)[np.argmin(np.abs(z))] if abs(z[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x)], axis=-1)


def left_jacobian(v: Array) -> Array:
    """J (3, 3) with Exp(v + dv) = Exp(J dv) Exp(v) to first order."""
    angle = float(np.linalg.norm(v))
    K = skew(v)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * K
    a, b = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + a * K + b * K @ K)
