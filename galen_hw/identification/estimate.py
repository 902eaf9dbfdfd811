"""From fitted parameters to what a person and a tool's file want: mass, centre of mass, biases, with covariance."""

from dataclasses import dataclass

import numpy as np

from galen_hw.identification.fit import Fit
from galen_hw.identification.model import BIAS, BODY, TOOL, drift_names
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array, rotation_exp

TOOL_NAMES = ("mass", "com.x", "com.y", "com.z")


@dataclass(frozen=True)
class Estimate:
    """What a fit found, in physical parameters.

    Args:
        names, values, covariance: mass (kg), com (m), then bias (N, N m) and bias body where they were fitted.
        t95: half-width of a 95 % interval in standard deviations.
        tilt: rotation vector of gravity from its nominal direction (base), rad; mounting: of the sensor on its link.
        gravity: (3,) in the base, m/s^2.
        drift: (6,) change over the whole sweep, N and N m; its standard deviations in `drift_std`.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    t95: float
    tilt: Array
    mounting: Array
    gravity: Array
    drift: Array
    drift_std: Array

    def __getitem__(self, name: str) -> float:
        """One value."""
        return float(self.values[self.names.index(name)])

    @property
    def std(self) -> Array:
        """(k,) one standard deviation of each value."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def pick(self, prefix: str) -> tuple[Array, Array]:
        """Values and standard deviations of all names that begin so."""
        chosen = [i for i, name in enumerate(self.names) if name.startswith(prefix)]
        return self.values[chosen], self.std[chosen]

    @property
    def mass(self) -> float:
        """The tool's, kg."""
        return self["mass"]

    @property
    def com(self) -> Array:
        """The tool's centre of mass in the sensor frame, (3,) m."""
        return self.pick("com.")[0]

    @property
    def bias(self) -> Array:
        """(6,) at the end of the sweep; zero where it was not fitted."""
        values, _ = self.pick("bias.")
        return values if len(values) else np.zeros(6)

    @property
    def bias_body(self) -> Body | None:
        """The bias body, if it was fitted."""
        values, _ = self.pick("bias_body.")
        return Body(float(values[0]), values[1:]) if len(values) else None


def estimate(fit: Fit) -> Estimate:
    """Physical parameters of a fit; covariance carried over to first order."""
    c, theta, unknowns = fit.model.columns, fit.theta, fit.model.unknowns
    names, values, rows = list(TOOL_NAMES), [], []
    for there, block in ((True, TOOL), (unknowns.body, BODY)):
        if there:
            value, D = _body(theta, c, block)
            values.append(value)
            rows.append(D)
    if unknowns.body:
        names += [f"bias_body.{name}" for name in TOOL_NAMES]
    if unknowns.bias:
        D = _end_of_sweep(fit)
        names += list(BIAS)
        values.append(D @ theta)
        rows.append(D)
    D = np.vstack(rows)
    tilt, turn = fit.model.angles(theta)
    drift, drift_std = _drift(fit)
    gravity = rotation_exp(tilt) @ fit.model.poses.gravity
    covariance = D @ fit.covariance @ D.T
    return Estimate(tuple(names), np.concatenate(values), covariance, fit.t95, tilt, turn, gravity, drift, drift_std)


def _body(theta: Array, columns: dict[str, int], block: tuple[str, ...]) -> tuple[Array, Array]:
    """Mass and centre of mass, and their derivative (4, p)."""
    i = [columns[name] for name in block]
    mass, com = theta[i[0]], theta[i[1:]] / theta[i[0]]
    D = np.zeros((4, len(theta)))
    D[0, i[0]] = 1.0
    D[1:, i[0]] = -com / mass
    D[1:, i[1:]] = np.eye(3) / mass
    return np.array([mass, *com]), D


def _end_of_sweep(fit: Fit) -> Array:
    """(6, p): bias plus all of the drift's terms, which are 1 at the end."""
    D = np.zeros((6, len(fit.theta)))
    for names in (BIAS, *(drift_names(k) for k in range(fit.model.unknowns.drift))):
        D[np.arange(6), [fit.model.columns[name] for name in names]] = 1.0
    return D


def _drift(fit: Fit) -> tuple[Array, Array]:
    """Change from the first to the last moment: twice the terms of odd degree."""
    D = np.zeros((6, len(fit.theta)))
    for k in range(0, fit.model.unknowns.drift, 2):
        D[np.arange(6), [fit.model.columns[name] for name in drift_names(k)]] = 2.0
    return D @ fit.theta, np.sqrt(np.maximum(np.diag(D @ fit.covariance @ D.T), 0.0))


def predict(found: Estimate, R: Array, zero: Array | None, known: Body | None) -> Array:
    """Wrench (n, 6) expected at orientations R (n, 3, 3) with the tool, at the end of the sweep."""
    from galen_hw.physics.rigid import predicted_wrench

    mounted = R @ rotation_exp(found.mounting)
    zeroed = None if zero is None else zero @ rotation_exp(found.mounting)
    return predicted_wrench(
        mounted,
        Body(found.mass, found.com),
        bias_body=found.bias_body or known,
        zeroed_rotation=zeroed,
        offset=found.bias,
        gravity=found.gravity,
    )
