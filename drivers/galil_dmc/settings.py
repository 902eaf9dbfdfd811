"""Settings of a Galil DMC and of its axes: the only place where counts and SI meet."""

import math
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from galen_hw.drivers.galil_dmc.codec import VELOCITY_SCALE, VOLTS_PER_TORQUE_COUNT, AxisBlock

COUNTS_MAX: Final = 2**31 - 1
"""Counts are 32-bit signed; as a software limit this means "off"."""
PER: Final = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
"""What follows an axis's own unit in the numbers of a request."""


class AxisSettings(BaseModel):
    """One axis; lengths in m or angles in rad as `unit` says, and their derivatives per second.

    Args:
        axis: the controller's letter; joint: its name on the bus.
        counts_per_unit, offset_counts, sign: counts = offset + sign * counts_per_unit * position.
        lower, upper: limits of the position, also written to the controller as FL and BL.
        velocity, acceleration: of moves that do not say their own; max_velocity, max_acceleration: the most allowed.
        effort_per_volt: N or N m for one volt of the motor command; None: effort is not known (NaN).
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    axis: Literal["A", "B", "C", "D", "E", "F", "G", "H"]
    joint: str = Field(min_length=1)
    unit: Literal["m", "rad"] = "rad"
    counts_per_unit: float = Field(gt=0)
    offset_counts: int = 0
    sign: Literal[-1, 1] = 1
    lower: float
    upper: float
    velocity: float = Field(gt=0)
    max_velocity: float = Field(gt=0)
    acceleration: float = Field(gt=0)
    max_acceleration: float = Field(gt=0)
    effort_per_volt: float | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "AxisSettings":
        if not self.lower < self.upper:
            raise ValueError(f"lower {self.lower} is not below upper {self.upper}")
        if self.velocity > self.max_velocity or self.acceleration > self.max_acceleration:
            raise ValueError("velocity or acceleration is above its own maximum")
        if max(abs(self.counts(self.lower)), abs(self.counts(self.upper))) >= COUNTS_MAX:
            raise ValueError("the limits do not fit the controller's 32-bit counts")
        return self

    def counts(self, position: float) -> int:
        """Controller counts of a position."""
        return self.offset_counts + self.sign * round(position * self.counts_per_unit)

    def position(self, counts: int) -> float:
        """Position of controller counts."""
        return self.sign * (counts - self.offset_counts) / self.counts_per_unit

    def velocity_of(self, block: AxisBlock) -> float:
        """Velocity in a data record."""
        return self.sign * block.velocity_64 / (VELOCITY_SCALE * self.counts_per_unit)

    def effort_of(self, block: AxisBlock) -> float:
        """Effort in a data record, NaN where no scale is configured."""
        if self.effort_per_volt is None:
            return math.nan
        return self.sign * block.torque * VOLTS_PER_TORQUE_COUNT * self.effort_per_volt

    @property
    def software_limits(self) -> tuple[int, int]:
        """FL and BL in counts."""
        ends = self.counts(self.lower), self.counts(self.upper)
        return max(ends), min(ends)

    def at_limits(self, block: AxisBlock, active: int, disabled: int) -> tuple[bool, bool]:
        """At the lower and at the upper end: limit switch active, or position at the software limit.

        Args:
            active: what a switch's bit is while the axis stands on it.
            disabled: LD, 1 forward off, 2 reverse off, 3 both off.
        """
        forward_end, reverse_end = self.software_limits
        forward = block.position >= forward_end or (block.forward_bit == active and not disabled & 1)
        reverse = block.position <= reverse_end or (block.reverse_bit == active and not disabled & 2)
        return (reverse, forward) if self.sign > 0 else (forward, reverse)


def _galen_axes() -> list[AxisSettings]:
    """The Galen's joints on axes A to E: linear axes of 1 um a count, revolute axes of 2^18 / 2 pi counts a radian."""
    carriage = {"unit": "m", "counts_per_unit": 1_000_000.0}
    carriage |= {"velocity": 0.05, "max_velocity": 0.25, "acceleration": 0.25, "max_acceleration": 1.0}
    turn = {"unit": "rad", "counts_per_unit": 41721.64}
    turn |= {"velocity": 0.5, "max_velocity": 2.0, "acceleration": 2.0, "max_acceleration": 10.0}
    rows = [
        ("A", "carriage1", -0.233, 0.263, carriage),
        ("B", "carriage2", -0.272, 0.241, carriage),
        ("C", "carriage3", -0.237, 0.254, carriage),
        ("D", "roll", -1.57, 1.57, turn),
        ("E", "tilt", -1.04, 0.96, turn),
    ]
    return [
        AxisSettings.model_validate({"axis": axis, "joint": joint, "lower": lower, "upper": upper, **rest})
        for axis, joint, lower, upper, rest in rows
    ]


class GalilSettings(BaseModel):
    """Settings of a Galil DMC.

    Args:
        axes: one entry an axis, in the order of the joints on the bus; default: the Galen's five.
        rate_hz: most joint states a second; a slower line sets its own pace (115200 baud, five axes: 55).
        status_interval_s: how often emergency stop, abort input and amplifiers are read besides.
        reply_timeout_s: longest wait for a complete answer.
        quiet_s: the line counts as drained after so long a silence.
        reconnect_s: pause between attempts to reach a silent controller.
        servo_timeout_s: jogging axes are stopped when servo_jv is not refreshed for so long.
        watchdog_s: the controller stops the axes by itself when it hears nothing for so long; 0: no program is loaded.
        stop_s: a stop from a move's own speed takes no longer, as far as `max_acceleration` allows.
        record_age_s: age of a data record when its first byte is read (half a controller sample and a byte's time).
        limit_active_level: value of a limit switch's bit in the record while the axis stands on it (CN -1: 0).
        write_limits: write the axes' limits to the controller as FL and BL.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    axes: Annotated[list[AxisSettings], Field(default_factory=_galen_axes, min_length=1, max_length=8)]
    rate_hz: float = Field(default=100.0, gt=0, le=1000)
    status_interval_s: float = Field(default=0.1, gt=0)
    reply_timeout_s: float = Field(default=0.3, gt=0)
    quiet_s: float = Field(default=0.05, gt=0)
    reconnect_s: float = Field(default=1.0, gt=0)
    servo_timeout_s: float = Field(default=0.25, gt=0)
    watchdog_s: float = Field(default=0.25, ge=0, le=10)
    stop_s: float = Field(default=0.1, gt=0, le=10)
    record_age_s: float = Field(default=0.0006, ge=0)
    limit_active_level: Literal[0, 1] = 0
    write_limits: bool = True

    @property
    def units(self) -> dict[str, str]:
        """SI units of a request's numbers, by their key: a joint that turns takes no millimetres."""
        return {f"{kind}.{axis.joint}": axis.unit + per for axis in self.axes for kind, per in PER.items()}

    @model_validator(mode="after")
    def _long_enough(self) -> "GalilSettings":
        if 0 < self.watchdog_s < 0.1:
            raise ValueError("watchdog_s is less than 0.1 s, which a line cannot keep; 0 for none")
        return self

    @model_validator(mode="after")
    def _distinct(self) -> "GalilSettings":
        for what in ("axis", "joint"):
            names = [getattr(axis, what) for axis in self.axes]
            if len(set(names)) != len(names):
                raise ValueError(f"{what} named twice: {', '.join(names)}")
        return self
