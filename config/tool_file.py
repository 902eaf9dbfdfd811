"""A tool's file: its geometry, what the calibration found, and where every number came from.

The nominal files (`config/tools/NAME.json`) hold geometry alone; a calibration adds one generation in the state
directory. All numbers are SI, in the sensor frame about the sensor's origin.
"""

import json
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from galen_hw.documents import DocumentError, intact, load_json, sealed
from galen_hw.errors import UsageError
from galen_hw.units import STANDARD_GRAVITY

SCHEMA: Final = 1
NAME: Final = r"^[a-z0-9][a-z0-9_-]{0,39}$"
MAX_MASS, MAX_REACH, MAX_TIP, MAX_FORCE, MAX_TORQUE = 20.0, 0.6, 1.0, 5000.0, 500.0


def _mass(value: float) -> float:
    if value <= 0.0:
        raise ValueError(f"a mass of {value:.6g} kg is impossible")
    if value > MAX_MASS:
        raise ValueError(f"a mass of {value:.6g} kg is impossible on this arm: is it in grams?")
    return value


def _within(limit: float, what: str) -> AfterValidator:
    def check(value: tuple[float, float, float]) -> tuple[float, float, float]:
        reach = max(map(abs, value))
        if reach > limit:
            raise ValueError(f"{what} lies {reach:.4g} m from the sensor: is it in mm?")
        return value

    return AfterValidator(check)


Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(ge=0.0)]
Mass = Annotated[FiniteFloat, AfterValidator(_mass)]
Com = Annotated[Vector, _within(MAX_REACH, "the centre of mass")]
Tip = Annotated[Vector, _within(MAX_TIP, "the point")]
Wrench = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Scatter = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Matrix = tuple[Vector, Vector, Vector]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), populate_by_name=True)


class BodyStd(_Part):
    """One standard deviation of a body's mass (kg) and centre of mass (m)."""

    mass: Positive
    com: tuple[Positive, Positive, Positive]


class BiasBody(_Part):
    """What hangs on the sensor with no tool (report: body b); a mass of 0 is allowed."""

    mass: Annotated[FiniteFloat, Field(ge=0.0, le=MAX_MASS)]
    com: Com
    std: BodyStd | None = None


class Term(_Part):
    """One more physical effect of the prediction, as `galen-hw diagnose --save-model` writes it.

    `effect` is a key of the table of effects, `parameters` are its own, in SI units.
    """

    effect: Annotated[str, Field(min_length=1)]
    parameters: dict[str, FiniteFloat | tuple[FiniteFloat, ...] | str | None] = {}
    source: str = ""


class Origin(_Part):
    """Where the numbers came from.

    Args:
        method: name of the fit that was accepted; sweep: the raw sweep's folder.
        fit_poses, verify_poses: how many; condition: number of the scaled problem.
        generation: counts up in the state directory; 0 before it is saved.
        virtual: made on a virtual robot: never used on a real one.
    """

    generation: Annotated[int, Field(ge=0)] = 0
    id: str = ""
    date: str
    software: str
    robot: str
    sensor_serial: str = ""
    virtual: bool = False
    method: str
    reason: str = ""
    sweep: str = ""
    fit_poses: Annotated[int, Field(ge=0)] = 0
    verify_poses: Annotated[int, Field(ge=0)] = 0
    condition: Positive = 0.0
    remarks: tuple[str, ...] = ()


class ToolFile(_Part):
    """A tool. `mass` and all that follows are None until it is calibrated.

    The sensor at rest, R taking sensor to base coordinates and g the gravity (base), is predicted to read

        W(mass, com; R) + W(bias_body; R) - W(bias_body; R at `zeroed_at`) + bias,
        W(m, c; R) = [m R^T g, c x m R^T g]

    which is the report's equation (11) and a bias. Without `zeroed_at` the third term is absent.

    Args:
        tip, contact: points on the tool, m; `contact` (where the user pushes) is the tip if None.
        inertia: about the centre of mass, kg m^2, for the dynamic forces; None if not known.
        std: one standard deviation; `covariance` of `parameters` (mass, com.x, ...), in their order.
        coverage_factor: half-width of a 95 % interval in standard deviations (Student's t).
        bias: constant offset beyond the zeroing; gravity: in the base frame, m/s^2.
        residual, verified: RMS over the fit's and over the held-out poses; noise_floor: sigma of one sample.
        terms: further effects that the live services add to the prediction.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    name: Annotated[str, Field(pattern=NAME)]
    tip: Tip
    contact: Tip | None = None
    inertia: Matrix | None = None
    mass: Mass | None = None
    com: Com | None = None
    std: BodyStd | None = None
    coverage_factor: Annotated[FiniteFloat, Field(ge=1.0, le=20.0)] = 1.96
    parameters: tuple[str, ...] = ()
    covariance: tuple[tuple[FiniteFloat, ...], ...] = ()
    bias: Wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bias_std: Scatter | None = None
    bias_body: BiasBody | None = None
    zeroed_at: dict[str, FiniteFloat] | tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    gravity: Vector = (0.0, 0.0, -STANDARD_GRAVITY)
    residual: Scatter | None = None
    verified: Scatter | None = None
    noise_floor: Scatter | None = None
    terms: tuple[Term, ...] = ()
    origin: Origin | None = None

    @property
    def calibrated(self) -> bool:
        """Mass and centre of mass are known."""
        return self.mass is not None and self.com is not None

    @property
    def contact_point(self) -> Vector:
        """Where the user's force is taken to act, sensor frame, m."""
        return self.tip if self.contact is None else self.contact

    @property
    def calibration_id(self) -> str:
        """Identity of the calibration, empty for a nominal file."""
        return self.origin.id if self.origin else ""

    def on_virtual(self) -> Self:
        """The same calibration as one of a virtual robot; a nominal file stays as it is."""
        if self.origin is None:
            return self
        return self.model_copy(update={"origin": self.origin.model_copy(update={"virtual": True})})

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.mass is None) != (self.com is None):
            raise ValueError("mass and com come together")
        if self.calibrated and self.origin is None:
            raise ValueError("a mass without an origin: it must say where it came from")
        limits = (MAX_FORCE,) * 3 + (MAX_TORQUE,) * 3
        if any(abs(b) > limit for b, limit in zip(self.bias, limits, strict=True)):
            raise ValueError("the bias is larger than any sensor's range: is it in counts?")
        if not 9.5 < float(np.linalg.norm(self.gravity)) < 10.1:
            raise ValueError(f"gravity has the size {float(np.linalg.norm(self.gravity)):.4g} m/s^2")
        self._check_covariance()
        return self

    def _check_covariance(self) -> None:
        n = len(self.parameters)
        if len(self.covariance) != n or any(len(row) != n for row in self.covariance):
            raise ValueError(f"the covariance is not {n} x {n}, one row a parameter")
        if n == 0:
            return
        C = np.array(self.covariance)
        scale = np.sqrt(np.outer(np.diag(C).clip(0.0), np.diag(C).clip(0.0))) + 1e-300
        if np.any(np.diag(C) < 0.0) or np.any(np.abs(C - C.T) > 1e-6 * scale) or np.any(np.abs(C) > 1.000001 * scale):
            raise ValueError("the covariance is not one: it must be symmetric and positive")

    def to_json(self) -> str:
        """The text of the file; keys whose value is not known are left out."""
        return _pretty(self._values())

    def to_sealed_json(self) -> str:
        """The text of the file with the digest of its content, as a generation is kept."""
        return _pretty(sealed(self._values()))

    def _values(self) -> dict[str, Any]:
        return self.model_dump(by_alias=True, exclude_none=True, mode="json")


def parse_tool(text: str, where: str) -> ToolFile:
    """A tool's file from its text; one with a `digest` must be what the digest was made of.

    Args:
        text: JSON; where: path that errors name.

    Raises:
        UsageError: not JSON, another schema, a key that is not known, a number that is impossible, or another content
            than was written; one line.
    """
    return parse_sealed(text, where)[0]


def terms_in(text: str, where: str) -> tuple[dict[str, Any], ...]:
    """Return the further effects of a tool's file; none where there is no file.

    Raises:
        UsageError: the file is damaged.
    """
    found = parse_tool(text, where).terms if text else ()
    return tuple({"effect": term.effect, "parameters": dict(term.parameters)} for term in found)


def parse_sealed(text: str, where: str) -> tuple[ToolFile, bool]:
    """As `parse_tool`; and whether the text has a digest (files of 0.1 have none)."""
    try:
        data = load_json(text)
    except DocumentError as error:
        raise UsageError(error.what, where=error.within(where), todo="restore it, or roll back") from error
    if not isinstance(data, dict):
        raise UsageError("not a tool's file", where=where, todo="it must be one JSON object")
    if data.get("schema") != SCHEMA:
        found = "no schema" if "schema" not in data else f"schema {data['schema']!r}"
        raise UsageError(f"{found}, this version reads {SCHEMA}", where=where, todo=f'write "schema": {SCHEMA}')
    try:
        tool = ToolFile.model_validate_json(json.dumps({k: v for k, v in data.items() if k != "digest"}))
    except ValidationError as error:
        raise one_line(error, where) from error
    whole = intact(data)
    if whole is False:
        todo = "roll back or calibrate again; if it was edited on purpose, take its digest out"
        raise UsageError("is not what was written: its digest is another", where=where, todo=todo)
    return tool, whole is True


def one_line(error: ValidationError, where: str) -> UsageError:
    """The first complaint, and how many more there are."""
    first, more = error.errors()[0], error.error_count() - 1
    key = ".".join(str(part) for part in first["loc"])
    text = str(first["msg"]).removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        text = "not a known key"
    if first["type"] == "missing":
        text = "is missing"
    rest = f" (and {more} more)" if more else ""
    return UsageError(
        text + rest, where=f"{where}: {key}" if key else where, todo="correct the file, or calibrate again"
    )


def _pretty(data: Any, indent: int = 0) -> str:
    """JSON with one key a line and vectors on one line."""
    pad = " " * (indent + 1)
    if isinstance(data, dict) and data:
        rows = [f"{pad}{json.dumps(key)}: {_pretty(value, indent + 1)}" for key, value in data.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * indent + "}"
    if isinstance(data, list) and data and isinstance(data[0], (dict, list)):
        rows = [pad + _pretty(value, indent + 1) for value in data]
        return "[\n" + ",\n".join(rows) + "\n" + " " * indent + "]"
    return json.dumps(data)
