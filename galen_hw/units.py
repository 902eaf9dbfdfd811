"""Units at the border: factors to SI, and how numbers are shown to people."""

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable
from typing import Final

STANDARD_GRAVITY: Final = 9.80665
"""m/s^2, the nominal magnitude of gravity (ISO 80000-3)."""

FORCE_TO_NEWTON: Final = {
    "N": 1.0,
    "kN": 1e3,
    "lbf": 4.4482216152605,
    "klbf": 4448.2216152605,
    "kgf": STANDARD_GRAVITY,
    "gf": STANDARD_GRAVITY * 1e-3,
}
"""Factor from a unit of force to N."""

TORQUE_TO_NEWTON_METRE: Final = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 4.4482216152605 * 0.0254,
    "lbf-ft": 4.4482216152605 * 0.3048,
    "kgf-cm": STANDARD_GRAVITY * 1e-2,
}
"""Factor from a unit of torque to N m."""

SI: Final[dict[str, tuple[str, float]]] = {
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180.0),
    "°": ("rad", math.pi / 180.0),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "Nm": ("N m", 1.0),
    "mNm": ("N m", 1e-3),
    "Nmm": ("N m", 1e-3),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "Hz": ("Hz", 1.0),
    "kHz": ("Hz", 1e3),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
}
"""Units that may follow a number on the command line: the SI unit, and the factor to it."""
_QUANTITY: Final = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z°/]+)")


def quantity(text: str) -> tuple[float, str] | None:
    """Return the SI value and SI unit of a number with its unit (`17deg`, `5 mm`); None where the text is not one."""
    found = _QUANTITY.fullmatch(text.strip())
    if found is None or found[2] not in SI:
        return None
    unit, factor = SI[found[2]]
    return float(found[1]) * factor, unit


def number_in(unit: str) -> Callable[[str], float]:
    """Return what reads an option in an SI unit: a bare number is in it, and another unit of the same kind may follow.

    Raises:
        ArgumentTypeError: (when it reads) no number, or a unit of another kind; the text says which are right.
    """

    def read(text: str) -> float:
        found = quantity(text)
        if found is not None and found[1] == unit:
            return found[0]
        try:
            return float(text)
        except ValueError:
            known = ", ".join(name for name, (si, _) in SI.items() if si == unit)
            raise ArgumentTypeError(f"{text!r} is no number in {unit}, nor one with its unit ({known})") from None

    return read
