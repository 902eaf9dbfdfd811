"""The virtual robot's truth: what hangs on the sensor and how noisy it is (source: `spec/galen-nominal`).

No estimator, configuration or service may import these numbers: they are what the program has to find out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from galen_hw.errors import UsageError


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body that hangs on the sensor.

    Args:
        name: what people call it.
        mass: kg.
        com: (3,) centre of mass in the sensor frame, m.
        tip: (3,) working point in the sensor frame, m.
        inertia: (3,) diagonal about the centre of mass, sensor axes, kg m^2; zeros for a point mass.
    """

    name: str
    mass: float
    com: tuple[float, float, float]
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)


BIAS_BODY: Final = Body("bias", 0.085, (0.002, -0.001, 0.011))
"""What hangs on the sensor with no tool: adapter plate and screws."""

TOOLS: Final[dict[str, Body]] = {
    body.name: body
    for body in (
        Body("pointer", 0.152, (0.012, -0.003, -0.046), (0.0, 0.0, -0.165), (2.1e-4, 2.0e-4, 3.0e-5)),
        Body("retractor", 0.287, (0.031, 0.004, -0.063), (0.045, 0.0, -0.140), (5.6e-4, 6.4e-4, 1.4e-4)),
    )
}

NOISE_SIGMA: Final = (0.015, 0.015, 0.020, 2.5e-4, 2.5e-4, 2.0e-4)
"""One sigma of one sample: force N, torque N m."""


def tool_named(tool: str | Mapping[str, Any] | Body | None) -> Body | None:
    """The body of a tool's name or of its numbers (`name`, `mass`, `com`, `tip`, `inertia`); None is no tool.

    Raises:
        UsageError: no such tool, or numbers that no body can have.
    """
    if tool is None or isinstance(tool, Body):
        return tool
    if isinstance(tool, str):
        if tool not in TOOLS:
            raise UsageError(f"no tool {tool!r}", where="virtual robot", todo=f"one of: {', '.join(TOOLS)}, or none")
        return TOOLS[tool]
    return _body(tool)


def _body(numbers: Mapping[str, Any]) -> Body:
    unknown = set(numbers) - {"name", "mass", "com", "tip", "inertia"}
    if unknown or not {"mass", "com"} <= set(numbers):
        raise UsageError("a tool is {name, mass, com, tip, inertia}", where="virtual robot", todo="give mass and com")
    body = Body(
        name=str(numbers.get("name", "custom")),
        mass=float(numbers["mass"]),
        com=_triple(numbers["com"]),
        tip=_triple(numbers.get("tip", (0.0, 0.0, 0.0))),
        inertia=_triple(numbers.get("inertia", (0.0, 0.0, 0.0))),
    )
    if body.mass < 0.0 or min(body.inertia) < 0.0:
        raise UsageError("mass and inertia cannot be negative", where=f"tool {body.name}", todo="check the numbers")
    return body


def _triple(value: Any) -> tuple[float, float, float]:
    numbers = [float(x) for x in value]
    if len(numbers) != 3:
        raise UsageError(f"three numbers expected, got {len(numbers)}", where="virtual robot", todo="give x, y, z")
    return (numbers[0], numbers[1], numbers[2])
