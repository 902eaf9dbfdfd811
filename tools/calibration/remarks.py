"""What a person should know about a calibration beside its numbers: one honest line each."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from galen_hw.identification.candidates import SIGNIFICANT, Candidate, gain
from galen_hw.identification.model import CHANNELS
from galen_hw.identification.poses import Poses
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.tools.calibration.result import Result

CLEARLY = 1e-4
SAME_GRAVITY = 0.05
"""m/s^2: two poses closer than this are the same for every weight, gain, cross-talk and mounting."""


def remarks(result: "Result") -> Iterator[str]:
    """All remarks on a result."""
    yield from _left_aside(result)
    yield from _excess(result)
    yield from _drift(result)
    yield from _rotations(result)
    yield from _split(result)


def show(value: float, channel: str) -> str:
    """A force in N or a torque in N mm."""
    return f"{value:.3f} N" if channel.startswith("F") else f"{1e3 * value:.2f} N mm"


def _left_aside(result: "Result") -> Iterator[str]:
    rows = result.fit.outliers
    if len(rows):
        numbers = ", ".join(str(i + 1) for i in rows[:8]) + (" ..." if len(rows) > 8 else "")
        verb = "does not fit the rest and is" if len(rows) == 1 else "do not fit the rest and are"
        yield f"{len(rows)} of {len(result.fit.weight)} poses {verb} left aside: {numbers}"


def _excess(result: "Result") -> Iterator[str]:
    """Channels whose residual is larger than noise, and whether any model of gravity could explain it."""
    fit, rows = result.fit, result.poses.fit
    rms = np.sqrt(np.mean(fit.residual[fit.weight > 0.0] ** 2, axis=0))
    expected = np.sqrt(np.mean(rows.variance, axis=0))
    for k, channel in enumerate(CHANNELS):
        triple = slice(0, 3) if k < 3 else slice(3, 6)
        others = np.delete(rms[triple], k % 3)
        if np.isfinite(expected[k]):
            p = stats.chi2.sf(fit.freedom * (rms[k] / expected[k]) ** 2, fit.freedom)
            excess, compared = (
                p < CLEARLY and rms[k] > 1.5 * expected[k],
                f"noise explains {show(expected[k], channel)}",
            )
        else:
            excess = bool(rms[k] > 2.0 * np.mean(others))
            compared = f"{rms[k] / np.mean(others):.1f} times the other axes"
        if excess:
            why = _replicates(rows, fit.residual, k)
            yield f"{channel}: the residual of {show(rms[k], channel)} is above noise ({compared}){why}"


def _replicates(rows: Poses, residual: Array, k: int) -> str:
    """Scatter among poses that have the same gravity in the sensor: no model of gravity can take that away."""
    scatter, freedom = _pure_scatter(gravity_in_sensor(rows.R, rows.gravity), rows.wrench[:, k], rows)
    if freedom < 5:
        return ""
    share = scatter**2 / max(float(np.mean(residual[:, k] ** 2)), 1e-300)
    text = f"; poses with the same gravity in the sensor differ by {show(scatter, CHANNELS[k])}"
    return f"{text}, so most of it has no cause in weight, gain, cross-talk or mounting" if share > 0.5 else text


def _pure_scatter(s: Array, values: Array, rows: Poses) -> tuple[float, int]:
    """Pooled standard deviation within groups of equal gravity (and tool), and its degrees of freedom."""
    left, total, freedom = list(range(len(s))), 0.0, 0
    while left:
        first = left[0]
        near = np.linalg.norm(s[left] - s[first], axis=1) < SAME_GRAVITY
        group = [i for i, n in zip(left, near, strict=True) if n and rows.tool[i] == rows.tool[first]]
        total += float(np.sum((values[group] - values[group].mean()) ** 2))
        freedom += len(group) - 1
        left = [i for i in left if i not in group]
    return float(np.sqrt(total / max(freedom, 1))), freedom


def _drift(result: "Result") -> Iterator[str]:
    row = _candidate(result, "drift")
    # What left-out poses do not want is an error that poses share, whatever its p-value says of single channels.
    if row is None or row.estimate is None or not row.p_value < SIGNIFICANT or not result.fit.model.unknowns.drift:
        return
    drift, std = row.estimate.drift, row.estimate.drift_std
    k = int(np.argmax(np.abs(drift) / np.maximum(std, 1e-300)))
    clock = result.poses.time
    span = "over the sweep" if clock is None else f"in {clock[-1] - clock[0]:.0f} s"
    size = show(drift[k], CHANNELS[k])
    yield f"the sensor drifts: {CHANNELS[k]} by {size} {span} (p = {row.p_value:.1g}); it is in the fit"


def _rotations(result: "Result") -> Iterator[str]:
    for key, sentence in (
        ("tilt", "gravity is tilted against the base"),
        ("mount", "the sensor is turned on its link"),
    ):
        row = _candidate(result, key)
        if row is None or row.estimate is None or not row.p_value < SIGNIFICANT:
            continue
        angle = float(np.linalg.norm(row.estimate.tilt if key == "tilt" else row.estimate.mounting))
        used = result.best.key == key or (key == "tilt" and result.fit.model.unknowns.tilt)
        what = f"{sentence} by {np.degrees(angle):.2f} degrees (p = {row.p_value:.1g})"
        if used:
            yield f"{what}; it is in the fit"
        elif key == "mount" and gain(row, result.best) > 0.0:
            yield f"{what}, and left-out poses are predicted better with it: correct the robot's model and fit again"


def _split(result: "Result") -> Iterator[str]:
    if result.best.key == "zeroing":
        yield (
            "no poses without the tool: mass and centre of mass are told from the bias body by the zeroing alone, "
            "the centre of mass along gravity at the zeroing pose only within centimetres; their sum is sure"
        )
    if result.poses.zero is None and result.poses.bias_body is None:
        yield "it is not said where the sensor was zeroed: the mass is all that hangs on it"
    zeroing = _candidate(result, "zeroing")
    if zeroing is not None and result.best.key != "zeroing":
        yield "the constant offset is not what zeroing a bias body leaves: the mass is all that hangs on the sensor"


def _candidate(result: "Result", key: str) -> Candidate | None:
    return next((c for c in result.comparison.candidates if c.key == key), None)
