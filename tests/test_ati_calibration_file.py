"""ATI's own conversion of a .cal file, through atiiaftt, beside our matrix: the same wrench in every unit and about any point.

The file is made here, with the numbers of our vectors: ATI gives one with each sensor, and none to pass on.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from galen_hw.drivers.ati_netcanoem import codec
from galen_hw.spatial import Array
from galen_hw.units import FORCE_TO_NEWTON, TORQUE_TO_NEWTON_METRE

atiiaftt = pytest.importorskip("atiiaftt", reason="ATI's own conversion is not installed: pip install 'galen-hw[ati]'")

RNG = np.random.default_rng(0)
ROWS = RNG.normal(size=(6, 6)) * np.array([[30.0]] * 3 + [[0.9]] * 3)
GAUGES = RNG.normal(size=(20, 6))
ZERO = RNG.normal(size=6) * 0.1
FORCES = {"N": "FORCE_N", "lbf": "FORCE_LB", "kN": "FORCE_KN", "kgf": "FORCE_KG"}
TORQUES = {"N-m": "TORQUE_N_M", "N-mm": "TORQUE_N_MM", "lbf-in": "TORQUE_IN_LB", "lbf-ft": "TORQUE_FT_LB"}


@pytest.fixture
def sensor(tmp_path: Path) -> Any:
    """ATI's library with a calibration of which we know the matrix, zeroed as ours is."""
    axes = "".join(
        f'<Axis Name="{name}" values="{" ".join(f"{x:.9f}" for x in row)}" max="100" scale="1"/>'
        for name, row in zip(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), ROWS, strict=True)
    )
    path = tmp_path / "FT0.cal"
    path.write_text(
        '<?xml version="1.0" encoding="utf-8"?><FTSensor Serial="FT0" BodyStyle="Mini40" Family="DAQ" NumGages="6" '
        'CalFileVersion="1.0"><Calibration PartNumber="SI-40-2" CalDate="1/1/2026" ForceUnits="N" TorqueUnits="N-m" '
        'DistUnits="m" OutputMode="Differential" OutputRange="20" HWTempComp="True" GainMultiplier="1" '
        'CableLossDetection="False" OutputBipolar="True">'
        f'{axes}<BasicTransform Dx="0" Dy="0" Dz="0" Rx="0" Ry="0" Rz="0"/></Calibration></FTSensor>'
    )
    found = atiiaftt.FTSensor(str(path), 1)
    found.bias([*ZERO, 0.0])
    return found


def converted(sensor: Any) -> Array:
    """(20, 6) force and torque of the gauges, in the units that ATI's library was set to."""
    out = []
    for gauges in GAUGES:
        sensor.convertToFt([*gauges, 0.0])
        out.append(list(sensor.ft_vector))
    return np.array(out)


@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("torque", TORQUES)
def test_our_matrix_gives_atis_wrench(sensor: Any, force: str, torque: str) -> None:
    """In the units that a sensor may be set to: what ATI's library gives, times our factors, is what our matrix gives."""
    sensor.setForceUnits(getattr(atiiaftt.FTUnit, FORCES[force]))
    sensor.setTorqueUnits(getattr(atiiaftt.FTUnit, TORQUES[torque]))
    theirs = converted(sensor)
    to_si = FORCE_TO_NEWTON[force], TORQUE_TO_NEWTON_METRE[torque]
    matrix = codec.si_matrix(ROWS, (1.0, 1.0), (1.0, 1.0))
    ours = (GAUGES - ZERO) @ matrix.T
    # Their numbers are single, and a pound is 4.44822 N there.
    assert_allclose(theirs * np.repeat(to_si, 3), ours, rtol=2e-5, atol=2e-4)


def test_counts_of_a_unit_are_divided(sensor: Any) -> None:
    """Rows in counts a unit, as the board sends them."""
    theirs = converted(sensor)
    matrix = codec.si_matrix(ROWS * np.repeat([1e6, 1e3], 3)[:, None], (1e6, 1e3), (1.0, 1.0))
    assert_allclose((GAUGES - ZERO) @ matrix.T, theirs, rtol=1e-5, atol=1e-4)


def test_a_wrench_about_another_point_is_atis(sensor: Any) -> None:
    """ATI's tool transform is ours: force as it is, torque less what the force makes of the way there."""
    offset = np.array([0.01, -0.02, 0.15])
    plain = converted(sensor)
    sensor.setToolTransform([*offset, 0.0, 0.0, 0.0], atiiaftt.FTUnit.DIST_M, atiiaftt.FTUnit.ANGLE_RAD)
    moved = converted(sensor)
    assert_allclose(moved[:, :3], plain[:, :3], atol=1e-4)
    assert_allclose(moved[:, 3:], plain[:, 3:] - np.cross(offset, plain[:, :3]), rtol=1e-4, atol=1e-4)
