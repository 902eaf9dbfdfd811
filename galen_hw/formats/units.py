"""Units as people write them behind a column's name, and their factors to SI."""

import math
import re
from typing import Final

from galen_hw.units import FORCE_TO_NEWTON, STANDARD_GRAVITY, TORQUE_TO_NEWTON_METRE

FACTORS: Final[dict[str, dict[str, float]]] = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
    "force": {key.lower(): factor for key, factor in FORCE_TO_NEWTON.items()} | {"mn": 1e-3, "newton": 1.0},
    "torque": {key.lower().replace("-", ""): factor for key, factor in TORQUE_TO_NEWTON_METRE.items()}
    | {"ncm": 1e-2, "mnm": 1e-3, "lbft": TORQUE_TO_NEWTON_METRE["lbf-ft"], "lbin": TORQUE_TO_NEWTON_METRE["lbf-in"]},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "in": 0.0254, "inch": 0.0254},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "degree": math.pi / 180.0, "degrees": math.pi / 180.0}
    | {"°": math.pi / 180.0, "mrad": 1e-3, "rev": 2.0 * math.pi},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "turn": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "°/s": math.pi / 180.0, "dps": math.pi / 180.0}
    | {"rpm": math.pi / 30.0},
    "acceleration": {"m/s^2": 1.0, "m/s2": 1.0, "m/s²": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3},
    "temperature": {"c": 1.0, "°c": 1.0, "degc": 1.0, "celsius": 1.0},
    "one": {"1": 1.0, "": 1.0},
}
"""By quantity, then by unit in lower case without spaces, points and middle dots."""
ALLOWED: Final[dict[str, tuple[str, ...]]] = {
    "time": ("time",),
    "force": ("force",),
    "torque": ("torque",),
    "position": ("length",),
    "joint position": ("angle", "length"),
    "joint velocity": ("turn", "speed"),
    "joint effort": ("torque", "force"),
    "acceleration": ("acceleration",),
    "angular velocity": ("turn",),
    "temperature": ("temperature",),
    "one": ("one",),
}
"""Quantities of a column of ours, and what units they may be in."""
_SPELT: Final = re.compile(r"[\s.·*_-]")


def canonical(unit: str) -> str:
    """As the tables write it: lower case, no spaces, points, dots or dashes."""
    return _SPELT.sub("", unit.strip()).lower()


def factor(unit: str, quantity: str) -> float | None:
    """From a unit to SI, for a quantity of `ALLOWED`; None where it is no unit of that."""
    word = canonical(unit)
    for family in ALLOWED.get(quantity, ()):
        if word in FACTORS[family]:
            return FACTORS[family][word]
    return None


def any_unit(unit: str) -> bool:
    """Return whether it is a unit at all."""
    return any(canonical(unit) in table for table in FACTORS.values())


_BRACKET: Final = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*$")
_SUFFIX: Final = re.compile(
    r"^(?P<name>.+?)[_ ](?P<unit>nm|n|mm|m|rad|deg|ms|us|ns|s|kgf|lbf|rad_s|deg_s)$", re.IGNORECASE
)


def split_unit(column: str) -> tuple[str, str]:
    """Name and unit of a heading such as "Fx [N]", "Tz (N mm)", "q1_deg"; the unit empty where it says none.

    "q[0]" is no unit.
    """
    found = _BRACKET.match(column)
    if found and any_unit(found["unit"]) and canonical(found["unit"]) not in ("", "1"):
        return found["name"].strip(), found["unit"].strip()
    found = _SUFFIX.match(column.strip())
    if found:
        return found["name"], found["unit"].replace("_s", "/s") if "_" in found["unit"] else found["unit"]
    return column.strip(), ""
