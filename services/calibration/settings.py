"""Settings of the calibration sweep; angles in rad, every other unit in the key."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from galen_hw.config.problems import Places, check
from galen_hw.errors import UsageError

MOST_POSES: Final = 1000
"""Of the grid: an hour of sweeping, and what is planned in some milliseconds."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class AxisSettings(_Section):
    """One swept joint: `count` positions from `low` to `high` (rad)."""

    low: float = Field(ge=-3.2, le=3.2)
    high: float = Field(ge=-3.2, le=3.2)
    count: int = Field(ge=1, le=50)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high and self.count > 1:
            raise ValueError("low must be below high")
        return self


class CalibrationSettings(_Section):
    """How the sweep is done.

    Args:
        axes: swept joints, the slow one first; every combination is a pose.
        home: joint positions where the sensor is zeroed (m, rad); 0 for joints that are not named.
        velocity_rad_per_s, acceleration_rad_per_s2: of moves between poses; home_velocity_m_per_s: of the carriages.
        bare_poses: without the tool, to find what else hangs on the sensor; 0 to trust the zeroing.
        verify_poses: more poses, not used in the fit; home_every: poses between two returns home; seed: of the order.
        samples: averaged per pose; zero_samples: for zeroing.
        still_velocity_rad_per_s: below which a joint rests; settle_s: it must rest so long; pose_timeout_s: longest.
        touch_force_n, touch_torque_nm: a change within a hold, or a pose off from what the others say.
        overload_force_n: stops at once; heartbeat_s: longest silence of the client.
        stale_s: silence of a device that stops the robot; recover_s: time to come back, the pose then begins anew.
        max_bare_mass_kg: more than this without a tool means that a tool is on.
        least_tool_mass_kg: less than this means that no tool is on.
        check_velocity_rad_per_s, check_acceleration_rad_per_s2: of the slow motion that checks the compensation.
    """

    axes: dict[str, AxisSettings] = {
        "tilt": AxisSettings(low=-0.6, high=0.6, count=7),
        "roll": AxisSettings(low=-0.9, high=0.9, count=8),
    }
    home: dict[str, float] = {}
    velocity_rad_per_s: float = Field(default=1.0, gt=0.0, le=2.0)
    acceleration_rad_per_s2: float = Field(default=4.0, gt=0.0, le=10.0)
    home_velocity_m_per_s: float = Field(default=0.03, gt=0.0, le=0.2)
    bare_poses: int = Field(default=6, ge=0, le=100)
    verify_poses: int = Field(default=8, ge=0, le=100)
    home_every: int = Field(default=10, ge=2, le=1000)
    seed: Annotated[int, Field(ge=0)] = 1
    samples: int = Field(default=300, ge=10, le=10_000)
    zero_samples: int = Field(default=1000, ge=10, le=100_000)
    still_velocity_rad_per_s: float = Field(default=0.01, gt=0.0, le=0.1)
    settle_s: float = Field(default=0.15, ge=0.0, le=10.0)
    pose_timeout_s: float = Field(default=15.0, gt=0.0, le=120.0)
    touch_force_n: float = Field(default=1.0, gt=0.0, le=20.0)
    touch_torque_nm: float = Field(default=0.10, gt=0.0, le=5.0)
    overload_force_n: float = Field(default=40.0, gt=0.0, le=1000.0)
    stale_s: float = Field(default=1.0, gt=0.0, le=5.0)
    recover_s: float = Field(default=6.0, ge=0.0, le=60.0)
    heartbeat_s: float = Field(default=0.7, gt=0.0, le=60.0)
    max_bare_mass_kg: float = Field(default=0.15, gt=0.0, le=5.0)
    least_tool_mass_kg: float = Field(default=0.02, gt=0.0, le=1.0)
    check_velocity_rad_per_s: float = Field(default=0.11, gt=0.0, le=1.0)
    check_acceleration_rad_per_s2: float = Field(default=0.035, gt=0.0, le=5.0)

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.poses > MOST_POSES:
            raise ValueError(f"{self.poses} poses are more than {MOST_POSES}: lower the counts of the axes")
        return self

    @property
    def poses(self) -> int:
        """Poses with the tool that are fitted, without the returns home."""
        total = 1
        for axis in self.axes.values():
            total *= axis.count
        return total


def overridden(settings: CalibrationSettings, args: Mapping[str, Any]) -> CalibrationSettings:
    """Return the settings of one sweep: what its arguments say stands in place of what is configured.

    Args:
        args: by key; `counts` are the positions of each swept axis, whose ranges stay.

    Raises:
        UsageError: an argument that is not known or not possible; `where` is its key.
    """
    given = dict(args)
    counts = given.pop("counts", None)
    made = _checked(settings.model_dump() | given)
    if counts is None:
        return made
    axes = made.model_dump()["axes"]
    if not isinstance(counts, list) or len(counts) != len(axes):
        what = f"{len(axes)} counts are asked for, one each for {', '.join(axes)}"
        raise UsageError(what, where="counts", todo=f"e.g. {'x'.join(str(axis['count']) for axis in axes.values())}")
    own = {name: axis | {"count": count} for (name, axis), count in zip(axes.items(), counts, strict=True)}
    try:
        return _checked(made.model_dump() | {"axes": own})
    except UsageError as error:
        raise UsageError(error.what, where="counts", todo=error.todo) from error


def _checked(values: dict[str, Any]) -> CalibrationSettings:
    made, problems = check(CalibrationSettings, values, (), Places("", ""))
    if made is None:
        raise UsageError(problems[0].what, where=problems[0].where.rpartition(": ")[2], todo=problems[0].todo)
    assert isinstance(made, CalibrationSettings)
    return made
