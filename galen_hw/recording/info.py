"""`recording.json`: what the columns of a recording belong to."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, ValidationError

from galen_hw.documents import DocumentError, load_json
from galen_hw.errors import UsageError
from galen_hw.units import STANDARD_GRAVITY

INFO, URDF = "recording.json", "robot.urdf"
"""Documents that a recording of one file bears within it."""
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


def _full_inertia(value: Any) -> Any:
    """Three principal moments stand for a diagonal 3 x 3."""
    if isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(v, (int, float)) for v in value):
        a, b, c = value
        return [[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]]
    return value


class _Part(BaseModel):
    """A JSON object of the recording; keys that are not known are kept and warned of."""

    model_config = ConfigDict(extra="allow", frozen=True, protected_namespaces=(), populate_by_name=True)


class Tool(_Part):
    """The tool that the simulation believes in; whatever is not known is None."""

    name: str = ""
    mass: FiniteFloat | None = Field(default=None, ge=0.0, description="kg")
    com: Vector | None = Field(default=None, description="centre of mass in the sensor frame, m")
    inertia: Annotated[tuple[Vector, Vector, Vector] | None, BeforeValidator(_full_inertia)] = Field(
        default=None, description="about the centre of mass, kg m^2"
    )
    tip: Vector | None = Field(default=None, description="in the sensor frame, m")


class BiasBody(_Part):
    """What hangs on the sensor with no tool; its weight was zeroed away at `zeroed_at`."""

    mass: FiniteFloat = Field(ge=0.0, description="kg")
    com: Vector = Field(description="in the sensor frame, m")
    inertia: Annotated[tuple[Vector, Vector, Vector] | None, BeforeValidator(_full_inertia)] = None


class Compliance(_Part):
    """Give of the joints, m/N or rad/(N m) by joint name."""

    joint: dict[str, FiniteFloat] = {}


class Model(_Part):
    """What the baseline holds."""

    bias: Literal["free"] | None = None
    dynamics: Literal["rigid", "static"] = "rigid"
    compliance: Compliance | None = None


AXES = ("x", "y", "z", "w")


class RecordingInfo(_Part):
    """The keys of `recording.json`; SI units. `unknown` lists keys that the program does not read.

    Two keys are galen-hw's own: `sensor_serial` (empty where not known) and `virtual` (made on a virtual robot).
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    robot: str | None = None
    base_link: str | None = None
    sensor_link: str | None = None
    tip_link: str | None = None
    distal_bodies: tuple[str, ...] | None = None
    tool: Tool | None = None
    bias_body: BiasBody | None = None
    zeroed_at: tuple[FiniteFloat, ...] | dict[str, FiniteFloat] | None = None
    gravity: Vector = (0.0, 0.0, -STANDARD_GRAVITY)
    predict: Literal["wrench", "pose", "effort", "position", "targets"] | None = None
    model: Model = Model()
    ranges: dict[str, tuple[FiniteFloat, FiniteFloat]] = {}
    notes: Any = None
    sensor_serial: str = ""
    virtual: bool = False

    @property
    def unknown(self) -> tuple[str, ...]:
        """Keys of the file that are not in the specification, dotted."""
        found = list(self.model_extra or {})
        parts = {"tool": self.tool, "bias_body": self.bias_body, "model": self.model}
        for name, part in parts.items():
            found += [f"{name}.{key}" for key in (part.model_extra or {})] if part is not None else []
        return tuple(found)

    def zeroed_joints(self, joint_names: tuple[str, ...]) -> tuple[float, ...] | None:
        """Joint positions at which the sensor was zeroed, in the order asked for; None where not given as joints.

        Four numbers for a robot that has not four joints are a quaternion, see `zeroed_quaternion`.

        Raises:
            UsageError: a joint is missing, or the number of values fits neither joints nor a quaternion.
        """
        zeroed = self.zeroed_at
        if zeroed is None or self.zeroed_quaternion(joint_names) is not None:
            return None
        if isinstance(zeroed, dict):
            missing = [name for name in joint_names if name not in zeroed]
            if missing:
                raise UsageError(f"no value for joint {missing[0]!r}", where="recording.json: zeroed_at")
            return tuple(zeroed[name] for name in joint_names)
        if len(zeroed) != len(joint_names):
            raise UsageError(
                f"{len(zeroed)} values for {len(joint_names)} joints",
                where="recording.json: zeroed_at",
                todo="give one a joint, or a quaternion x y z w",
            )
        return zeroed

    def zeroed_quaternion(self, joint_names: tuple[str, ...] = ()) -> tuple[float, ...] | None:
        """Sensor orientation (x, y, z, w) at which the sensor was zeroed; None where not given as a quaternion.

        A quaternion is four numbers, or four named x, y, z and w.
        """
        zeroed = self.zeroed_at
        if isinstance(zeroed, dict):
            named = set(zeroed) == set(AXES) and not set(joint_names) & set(AXES)
            return tuple(zeroed[axis] for axis in AXES) if named else None
        return zeroed if zeroed is not None and len(zeroed) == 4 and len(joint_names) != 4 else None

    def to_json(self) -> str:
        """The text of `recording.json`: only what was set, keys as in the specification."""
        values = self.model_dump(mode="json", by_alias=True, exclude_unset=True)
        return json.dumps({"schema": 1} | values, indent=1, ensure_ascii=False) + "\n"


def parse_info(text: str, where: str) -> RecordingInfo:
    """The info of a JSON text.

    Raises:
        UsageError: not JSON, or a value that does not fit; `where` is the file.
    """
    try:
        values = load_json(text)
    except DocumentError as error:
        place = error.within(where) + (f", column {error.column}" if error.column else "")
        raise UsageError(error.what, where=place, todo="correct the file") from error
    if not isinstance(values, dict):
        raise UsageError("not a JSON object", where=where, todo='write at least {"schema": 1}')
    return info_of(values, where)


def info_of(values: dict[str, Any], where: str) -> RecordingInfo:
    """The info of values that were read.

    Raises:
        UsageError: a value does not fit; `where` is the file.
    """
    try:
        return RecordingInfo.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise UsageError(
            f"{first['msg'][0].lower()}{first['msg'][1:]}, found {str(first['input'])[:60]!r}{more}",
            where=f"{where}: {key}",
            todo="see docs/recording.md",
        ) from error


def read_info(path: Path) -> RecordingInfo:
    """The info of a file.

    Raises:
        UsageError: missing, unreadable or wrong.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        todo = 'write one that says what the columns belong to, at least {"schema": 1, "robot": null}'
        raise UsageError("there is no recording.json", where=str(path.parent), todo=todo) from error
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(path), todo="check the file") from error
    return parse_info(text, str(path))
