"""Gauges and calibrations of a transducer such as the virtual ATI sensor has one.

Three beams at 120 degrees bear two gauges each. Even gauges feel a beam bend (Fz, Tx, Ty), odd ones feel it twist
sideways (Fx, Fy, Tz); three per cent of everything leaks into everything, as in real calibration matrices. The
sensitivities suit a nano-class sensor of 40 N, 60 N along z and 1.5 N m: at full scale of all axes a gauge comes near
the end of its 16 bits, and one count is about a tenth of the noise.
"""

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.spatial import Array
from galen_hw.units import FORCE_TO_NEWTON, TORQUE_TO_NEWTON_METRE

FORCE_UNIT_CODES: Final = {1: "lbf", 2: "N", 3: "klbf", 4: "kN", 5: "kgf", 6: "gf"}
TORQUE_UNIT_CODES: Final = {1: "lbf-in", 2: "lbf-ft", 3: "N-m", 4: "N-mm", 5: "kgf-cm", 6: "kN-m"}
"""Unit codes of ATI-1030 table 4.2."""

_BEND_PER_N, _BEND_PER_NM = 110.0, 12_000.0
_TWIST_PER_N, _TWIST_PER_NM = 200.0, 10_500.0
_LEAK = 0.03


def gauge_matrix(seed: int) -> Array:
    """(6, 6) counts per N and N m of a transducer made with `seed`."""
    rng = np.random.default_rng(seed)
    out = np.zeros((6, 6))
    for beam, angle in enumerate((0.0, 2.0 * np.pi / 3.0, 4.0 * np.pi / 3.0)):
        s, c = np.sin(angle), np.cos(angle)
        out[2 * beam] = (0.0, 0.0, _BEND_PER_N, _BEND_PER_NM * s, -_BEND_PER_NM * c, 0.0)
        out[2 * beam + 1] = (-_TWIST_PER_N * s, _TWIST_PER_N * c, 0.0, 0.0, 0.0, _TWIST_PER_NM)
    scale = np.array([_TWIST_PER_N, _TWIST_PER_N, _BEND_PER_N, _BEND_PER_NM, _BEND_PER_NM, _TWIST_PER_NM])
    return np.asarray(out + _LEAK * scale * rng.uniform(-1.0, 1.0, (6, 6)))


def gauge_offsets(seed: int) -> Array:
    """(6,) counts that the gauges read with nothing on the sensor: thousands, as published logs show."""
    rng = np.random.default_rng(seed + 1)
    return np.asarray(rng.choice([-1.0, 1.0], 6) * rng.uniform(1500.0, 6500.0, 6))


@dataclass(frozen=True, slots=True)
class Calibration:
    """One of the sixteen slots of the EEPROM.

    Args:
        matrix: (6, 6) as the board sends it: float32 rows Fx Fy Fz Tx Ty Tz.
        counts_per_force, counts_per_torque: divisors of the host.
        force_unit, torque_unit: unit codes.
    """

    matrix: Array
    counts_per_force: int
    counts_per_torque: int
    force_unit: int
    torque_unit: int

    def row(self, axis: int) -> bytes:
        """24 bytes, six big-endian float32."""
        return struct.pack(">6f", *self.matrix[axis])


def calibration(gauges: Array, force_unit: int, torque_unit: int, counts: tuple[int, int]) -> Calibration:
    """The slot that turns the counts of `gauges` (6, 6: counts per N, N m) into the given units."""
    to_unit = np.repeat(
        [
            counts[0] / FORCE_TO_NEWTON[FORCE_UNIT_CODES[force_unit]],
            counts[1] / TORQUE_TO_NEWTON_METRE[TORQUE_UNIT_CODES[torque_unit]],
        ],
        3,
    )
    matrix = (to_unit[:, None] * np.linalg.inv(gauges)).astype(np.float32).astype(float)
    return Calibration(matrix, *counts, force_unit, torque_unit)


def quantisation_sigma(gauges: Array) -> Array:
    """(6,) one sigma that rounding to whole counts adds to a wrench, N and N m."""
    return np.asarray(np.linalg.norm(np.linalg.inv(gauges), axis=1) / np.sqrt(12.0))
