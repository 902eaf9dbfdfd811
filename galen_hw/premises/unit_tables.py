"""Units in which people write numbers down, each by how many of it are one of SI, and which of them a scale may be."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from galen_hw.premises.criteria import CRITERIA

TURN: Final = 2.0 * np.pi

JOINT_ANGLES: Final = {"degrees": 180.0 / np.pi, "revolutions": 1.0 / TURN, "mrad": 1e3}
JOINT_LENGTHS: Final = {"mm": 1e3, "cm": 1e2, "um": 1e6}
TRACKED_LENGTHS: Final = {"mm": 1e3, "cm": 1e2, "inches": 1.0 / 0.0254, "feet": 1.0 / 0.3048, "km": 1e-3}
ACCELERATIONS: Final = {"g": 1.0 / 9.80665, "mg": 1e3 / 9.80665, "gal": 1e2}
TURN_RATES: Final = {"degrees a second": 180.0 / np.pi, "mrad/s": 1e3, "revolutions a minute": 30.0 / np.pi}
VELOCITY_RATIOS: Final = {
    "degrees a second": 180.0 / np.pi,
    "radians, the position in degrees": np.pi / 180.0,
    "revolutions a minute": 60.0 / TURN,
    "radians, the position in revolutions": TURN,
    "mm": 1e3,
}
"""Velocity over the change of position, where they are in different units."""

FORCES: Final = {
    "N": 1.0,
    "kgf": 1.0 / 9.80665,
    "lbf": 1.0 / 4.4482216,
    "ozf": 16.0 / 4.4482216,
    "gf": 1000.0 / 9.80665,
    "mN": 1e3,
    "cN": 1e2,
    "dN": 10.0,
    "daN": 0.1,
    "kN": 1e-3,
}
TORQUES: Final = {
    "N m": 1.0,
    "N mm": 1e3,
    "N cm": 1e2,
    "mN m": 1e3,
    "kgf m": 1.0 / 9.80665,
    "kgf cm": 100.0 / 9.80665,
    "kgf mm": 1e3 / 9.80665,
    "lbf in": 1.0 / 0.112984829,
    "lbf ft": 1.0 / 1.355817948,
    "ozf in": 16.0 / 0.112984829,
    "gf cm": 1e5 / 9.80665,
    "kN m": 1e-3,
}
"""Of each unit in a newton or newton metre (NIST SP 811)."""


def unit_of(scale: float, table: Mapping[str, float]) -> str:
    """Return the first unit of a table that a positive scale against SI may be; empty: none."""
    return next((u for u, f in table.items() if abs(np.log(scale / f)) < CRITERIA.same_factor), "")


def units_of(scale: float, table: Mapping[str, float]) -> list[str]:
    """Return the units of a table that a scale against SI may be, SI itself left out."""
    return [
        u
        for u, f in table.items()
        if abs(np.log(scale / f)) < CRITERIA.same_factor and abs(np.log(f)) > CRITERIA.same_factor
    ]
