"""A calibration from poses to a tool's file: fit, verification, remarks for people."""

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError

from galen_hw.config.tool_file import BiasBody, BodyStd, Origin, ToolFile, one_line
from galen_hw.identification.candidates import Candidate, Comparison, compare
from galen_hw.identification.estimate import Estimate
from galen_hw.identification.excitation import Excitation, require_excitation, require_precision
from galen_hw.identification.fit import Fit, span_of
from galen_hw.identification.model import Model
from galen_hw.identification.poses import Poses
from galen_hw.identification.sense import require_sense
from galen_hw.spatial import Array
from galen_hw.tools.calibration.remarks import remarks
from galen_hw.version import VERSION


@dataclass(frozen=True)
class Verification:
    """Poses that the fit has not seen, before and after compensation.

    Args:
        kind: "held-out poses" or, where none were held out, "each pose left out in turn".
        time: (m,) s or row number; before, after: (m, 6) reading, and reading minus prediction.
        expected: (6,) scatter of a pose's mean by the sensor's noise alone; NaN where not known.
    """

    kind: str
    time: Array
    before: Array
    after: Array
    expected: Array

    @property
    def rms(self) -> Array:
        """(6,) after compensation."""
        return np.asarray(np.sqrt(np.mean(self.after**2, axis=0)))

    @property
    def rms_before(self) -> Array:
        """(6,) of the raw reading."""
        return np.asarray(np.sqrt(np.mean(self.before**2, axis=0)))


@dataclass(frozen=True)
class Result:
    """Everything a calibration has to say.

    Args:
        name: of the tool; poses: of the sweep; comparison: the candidates.
        excitation: of the fitted poses with the tool; verification: on poses not fitted.
        remarks: what a person should know, one line each.
    """

    name: str
    poses: Poses
    comparison: Comparison
    excitation: Excitation
    verification: Verification
    remarks: tuple[str, ...]

    @property
    def best(self) -> Candidate:
        """The recommended candidate."""
        return self.comparison.best

    @property
    def fit(self) -> Fit:
        """Its fit."""
        assert self.best.fit is not None
        return self.best.fit

    @property
    def estimate(self) -> Estimate:
        """Its parameters."""
        assert self.best.estimate is not None
        return self.best.estimate


def analyse(name: str, poses: Poses, where: str, notes: tuple[str, ...] = ()) -> Result:
    """Fit all candidates, verify the recommended one and note what is odd.

    Args:
        name: of the tool; poses: of the whole sweep; where: what errors name; notes: remarks from reading.

    Raises:
        UsageError: the sweep cannot excite a parameter, or leaves it too uncertain; it is named.
    """
    rows = poses.fit
    found = require_excitation(rows.R[rows.tool], rows.gravity, where)
    if np.any(~rows.tool):
        require_excitation(rows.R[~rows.tool], rows.gravity, f"{where}, poses without the tool")
    comparison = compare(poses)
    free = next(c for c in comparison.candidates if c.key == "robust")
    judged = free if comparison.recommended == "zeroing" else comparison.best
    assert judged.estimate is not None
    require_precision(judged.estimate, where)
    verification = _verify(poses, comparison.best)
    assert comparison.best.fit is not None
    require_sense(judged.estimate, comparison.best.fit.weight, verification.before, verification.after, where)
    result = Result(name, poses, comparison, found, verification, ())
    return replace(result, remarks=(*notes, *remarks(result)))


def _verify(poses: Poses, best: Candidate) -> Verification:
    """Prediction of the held-out poses; where there are none, of each pose by all others."""
    assert best.fit is not None
    rows = poses.held_out
    if len(rows) >= 3:
        model = Model(rows, best.fit.model.unknowns, span_of(poses.fit))
        after, kind = rows.wrench - model.evaluate(best.fit.theta)[0], "held-out poses"
    else:
        rows = poses.fit
        after, kind = best.left_out[rows.tool], "each pose left out in turn"
        rows = rows.select(rows.tool)
    return Verification(kind, rows.clock, rows.wrench, after, np.sqrt(np.mean(rows.variance, axis=0)))


@dataclass(frozen=True, slots=True)
class Setting:
    """On what the calibration was made.

    Args:
        robot, sensor_serial, virtual: what it is bound to; sweep: path of the raw sweep.
        zeroed_at: joints or quaternion, as in the tool's file; date: None for now.
    """

    robot: str
    sensor_serial: str = ""
    sweep: str = ""
    zeroed_at: dict[str, float] | tuple[float, float, float, float] | None = None
    date: str | None = None
    virtual: bool = False


def tool_file(result: Result, nominal: ToolFile, setting: Setting) -> ToolFile:
    """The tool's file of a result; its generation is given when it is saved.

    Raises:
        UsageError: the numbers are impossible.
    """
    found, fit = result.estimate, result.fit
    bias_std = found.pick("bias.")[1]
    origin = Origin(
        date=setting.date or dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
        software=f"galen-hw {VERSION}",
        robot=setting.robot,
        sensor_serial=setting.sensor_serial,
        virtual=setting.virtual,
        method=result.best.key,
        reason=result.comparison.reason,
        sweep=setting.sweep,
        fit_poses=len(result.poses.fit),
        verify_poses=len(result.poses.held_out),
        condition=_digits(result.best.condition),
        remarks=result.remarks,
    )
    data = {
        "schema": 1,
        "name": nominal.name,
        "tip": nominal.tip,
        "contact": nominal.contact,
        "inertia": nominal.inertia,
        "mass": _digits(found.mass),
        "com": _list(found.com),
        "std": BodyStd(mass=_digits(found.std[0]), com=_triple(found.std[1:4])),
        "coverage_factor": _digits(found.t95),
        "parameters": found.names,
        "covariance": [_list(row) for row in found.covariance],
        "bias": _list(found.bias),
        "bias_std": _list(bias_std) if len(bias_std) else None,
        "bias_body": _bias_body(result),
        "zeroed_at": setting.zeroed_at,
        "gravity": _list(found.gravity),
        "residual": _list(fit.sigma),
        "verified": _list(result.verification.rms),
        "noise_floor": _list(result.poses.noise) if np.isfinite(result.poses.noise).all() else None,
        "terms": nominal.terms,
        "origin": origin,
    }
    try:
        return ToolFile.model_validate(data)
    except ValidationError as error:
        raise one_line(error, setting.sweep) from error


def with_terms(nominal: ToolFile, terms: Sequence[Mapping[str, object]]) -> ToolFile:
    """Return a tool's file with terms that were solved before the fit, in the place of older ones of the same effects."""
    if not terms:
        return nominal
    new = {str(term["effect"]) for term in terms}
    kept = [t.model_dump() for t in nominal.terms if t.effect not in new]
    data = nominal.model_dump(by_alias=True, exclude_none=True) | {"terms": [*kept, *(dict(t) for t in terms)]}
    return ToolFile.model_validate(data)


def _bias_body(result: Result) -> BiasBody | None:
    found, known = result.estimate, result.poses.bias_body
    if found.bias_body is not None:
        std = found.pick("bias_body.")[1]
        body, spread = found.bias_body, BodyStd(mass=_digits(std[0]), com=_triple(std[1:]))
        return BiasBody(mass=max(_digits(body.mass), 0.0), com=_triple(body.com), std=spread)
    return None if known is None else BiasBody(mass=known.mass, com=_triple(known.com))


def _digits(value: float) -> float:
    """Nine digits: far below any uncertainty, and readable."""
    return float(f"{value:.9g}")


def _list(values: Array) -> list[float]:
    return [_digits(v) for v in values]


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = _list(values)
    return x, y, z
