"""Units of an inertial measurement unit, told by how the sensor turns."""

from collections.abc import Iterator
from typing import ClassVar, Final

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.imu import turn_rates
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import scaled
from galen_hw.premises.unit_tables import ACCELERATIONS, TURN_RATES, unit_of
from galen_hw.premises.wrench_reading import ORIENTATION, sensor_rotations
from galen_hw.spatial import Array

ACCELERATION: Final = tuple(f"imu.acceleration.{axis}" for axis in "xyz")
OMEGA: Final = tuple(f"imu.angular_velocity.{axis}" for axis in "xyz")


class ImuUnits:
    """Tests accelerations against gravity and rates against the change of the orientation: in m/s^2 and rad/s."""

    KEY: ClassVar[str] = "imu_units"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for each of the two."""
        time = seen.time
        if seen.predict != "wrench" or seen.belief.robot is not None or not seen.has_all(*ORIENTATION):
            return
        if not seen.has("imu.") or len(seen) < 50 or not np.isfinite(seen.matrix(*ORIENTATION)).all():
            return
        R = sensor_rotations(scene_of(seen))
        up = -np.einsum("nji,j->ni", R, seen.belief.gravity)
        turning = np.zeros((len(seen), 3))
        if time is not None:
            turning = np.einsum("nji,nj->ni", R, turn_rates(np.asarray(time), R, seen.segments)[0])
        for columns, expected, table in ((ACCELERATION, up, ACCELERATIONS), (OMEGA, turning, TURN_RATES)):
            if not seen.has_all(*columns):
                continue
            scale = _scale(expected, seen.matrix(*columns))
            unit = unit_of(scale, table) if scale else ""
            if not unit:
                continue
            seen = with_columns(seen, {name: seen.columns[name] / table[unit] for name in columns})
            what = f"{columns[0].rsplit('.', 1)[0]} is {scale:.4g} times what the orientation says: it is in {unit}"
            yield Remark(self.KEY, what, "", columns, Action.REPAIRED, seen)


def _scale(expected: Array, measured: Array) -> float:
    """Return the slope of measured (N, 3) over expected where they are one signal; 0 where they are not, or not known."""
    good = np.isfinite(measured).all(axis=1) & np.isfinite(expected).all(axis=1)
    if good.sum() < 50:
        return 0.0
    one = scaled(expected[good], measured[good])
    return one.scale if one.Q[0, 0] > 0.0 and one.unexplained < 1.0 - CRITERIA.one_signal**2 else 0.0
