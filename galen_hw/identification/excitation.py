"""Whether a sweep can tell the parameters apart.

With six free biases only changes of gravity in the sensor, s = R^T g, carry information. With S the scatter matrix of
s over the poses, the mass is seen through tr S, and the first moment h (in h x s) through (tr S) 1 - S: a centre of
mass cannot be seen along a direction that gravity never leaves. `docs/calibration.md` derives both.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.estimate import TOOL_NAMES, Estimate
from galen_hw.identification.fit import Fit
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.spatial import Array

LEAST_SPREAD: Final = 0.5
"""m/s^2: gravity must turn by about 3 degrees in the sensor."""
LEAST_POSES: Final = 4
WIDEST_MASS, WIDEST_COM = 0.10, 0.005
"""Widest 95 % half-interval: share of the mass; m."""


@dataclass(frozen=True, slots=True)
class Excitation:
    """How far the poses excite each parameter.

    Args:
        spread: rms change of gravity, m/s^2, that bears on mass, com.x, com.y, com.z.
        worst: name of the weakest parameter; direction: (3,) of the centre of mass that is seen least.
    """

    spread: dict[str, float]
    worst: str
    direction: Array


def excitation(R: Array, gravity: Array) -> Excitation:
    """Spread of gravity over the orientations R (n, 3, 3) of one tool's poses."""
    s = gravity_in_sensor(R, gravity)
    S = np.cov(s.T, bias=True) if len(s) > 1 else np.zeros((3, 3))
    information = np.trace(S) * np.eye(3) - S
    _, vectors = np.linalg.eigh(information)
    weak = vectors[:, 0]
    inverse = np.linalg.inv(information + 1e-12 * np.eye(3))
    spread = {"mass": float(np.sqrt(max(np.trace(S), 0.0)))}
    for k, axis in enumerate("xyz"):
        spread[f"com.{axis}"] = float(1.0 / np.sqrt(inverse[k, k]))
    worst = "mass" if spread["mass"] < LEAST_SPREAD else f"com.{'xyz'[int(np.argmax(np.abs(weak)))]}"
    return Excitation(spread, worst, weak)


def require_excitation(R: Array, gravity: Array, where: str) -> Excitation:
    """Refuse poses that cannot show a parameter, naming it.

    Raises:
        UsageError: too few poses, or gravity hardly turns in the sensor.
    """
    if len(R) < LEAST_POSES:
        what = f"{len(R)} pose{'s' if len(R) != 1 else ''} for the fit, {LEAST_POSES} are the least"
        raise UsageError(what, where=where, todo="measure more orientations")
    found = excitation(R, gravity)
    weak = [name for name, value in found.spread.items() if value < LEAST_SPREAD]
    if weak:
        what = f"this sweep cannot excite {', '.join(weak)}"
        if "mass" in weak:
            why = f"gravity turns by {found.spread['mass'] / 9.81:.3f} rad rms in the sensor"
            raise UsageError(f"{what}: {why}", where=where, todo="add poses at other roll and tilt angles")
        axis = weak[0].removeprefix("com.")
        why = f"gravity in the sensor only moves along its {axis} axis"
        raise UsageError(f"{what}: {why}", where=where, todo="add poses that turn about another axis")
    return found


def require_precision(found: Estimate, where: str) -> None:
    """Refuse an estimate that is too uncertain to compensate with, naming the parameter.

    Raises:
        UsageError: an interval is too wide, or the mass is not positive.
    """
    half = found.t95 * found.std[:4]
    if found.mass - half[0] <= 0.0:
        what = f"the mass comes out as {found.mass:.4f} +- {half[0]:.4f} kg: nothing hangs on the sensor"
        todo = "put the tool on, zero the sensor once and not at each pose, and check the sign convention of the wrench"
        raise UsageError(what, where=where, todo=todo)
    limits = (WIDEST_MASS * found.mass, WIDEST_COM, WIDEST_COM, WIDEST_COM)
    for name, width, limit in zip(TOOL_NAMES, half, limits, strict=True):
        if not width <= limit:
            unit = "kg" if name == "mass" else "m"
            what = f"{name} is only known to +- {width:.2g} {unit} (95 %), the limit is {limit:.2g}"
            raise UsageError(what, where=where, todo="more poses, more samples, or wider angles")


def condition(fit: Fit) -> float:
    """Condition number of the weighted problem, its columns scaled to the same size."""
    white = _weighted(fit)
    size = np.linalg.norm(white, axis=0)
    singular = np.linalg.svd(white / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300))


def inflation(fit: Fit) -> dict[str, float]:
    """How much wider each parameter's interval is than if all the others were known."""
    white = _weighted(fit)
    size = np.linalg.norm(white, axis=0)
    scaled = white / np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-14, hermitian=True)
    return {name: float(np.sqrt(max(inverse[i, i], 0.0))) for i, name in enumerate(fit.model.names)}


def _weighted(fit: Fit) -> Array:
    prior, _ = fit.model.prior(fit.theta)
    white = (fit.derivative / fit.scale[:, :, None]).reshape(-1, len(fit.theta))
    return np.vstack([white, prior])
