"""Units at the border: factors to SI, and how numbers are shown to people."""

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
