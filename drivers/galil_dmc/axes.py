"""The axes of a Galil DMC: counts to SI by settings, limits, and the motion commands that a request becomes."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

from galen_hw.drivers.galil_dmc.codec import per_axis
from galen_hw.drivers.galil_dmc.settings import PER, AxisSettings
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.units import SI

_ACCELERATION_STEP: Final = 1024
_SPEED_STEP: Final = 2


class Axes:
    """All axes of a controller, by joint name, and the requests' numbers checked against their limits.

    Args:
        axes: in the order of the joints on the bus.
        where: the device's name, for errors.
        stop_s: how long a stop may take, as far as an axis's `max_acceleration` allows.
    """

    def __init__(self, axes: Iterable[AxisSettings], where: str, stop_s: float) -> None:
        self._stop_s = stop_s
        self.by_joint: dict[str, AxisSettings] = {axis.joint: axis for axis in axes}
        self.where = where
        self.letters = "".join(sorted(axis.axis for axis in self.by_joint.values()))

    def table(self, args: Mapping[str, Any], key: str) -> dict[str, float]:
        """The finite numbers by joint under `key` of a request, empty if it is not there.

        Raises:
            WrongCommandError: not a table, an unknown joint, not a finite number.
        """
        table = args.get(key, {})
        if not isinstance(table, Mapping):
            raise self.wrong(f"{key} is not a table of joints", "write {joint: number}")
        for joint, value in table.items():
            if joint not in self.by_joint:
                raise self.wrong(f"no joint {joint!r}", f"the joints are {', '.join(self.by_joint)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                unit = self.by_joint[joint].unit + PER[key]
                known = [name for name, (si, _) in SI.items() if si == unit] or [unit]
                what = f"{joint}: {key} {value!r} is not a finite number"
                raise self.wrong(what, f"give a number in {unit}, or with its unit: {', '.join(known)}")
        return {joint: float(value) for joint, value in table.items()}

    @property
    def again(self) -> str:
        """What clears a fault and switches the motors on again, as it is typed."""
        return f"galen-hw command {self.where} clear_fault and galen-hw command {self.where} enable"

    def rejected(self, what: str, todo: str) -> CommandRejectedError:
        """The error of a request that is not carried out."""
        return CommandRejectedError(what, where=self.where, todo=todo)

    def wrong(self, what: str, todo: str) -> WrongCommandError:
        """The error of a request that there is not."""
        return WrongCommandError(what, where=self.where, todo=todo)

    def move(self, args: Mapping[str, Any]) -> list[str]:
        """The commands that prepare a move to the request's positions; BG comes after they are accepted.

        Raises:
            CommandRejectedError: a joint, value or limit is wrong; the message names them.
        """
        goal = self.table(args, "position")
        velocity, acceleration = self.table(args, "velocity"), self.table(args, "acceleration")
        if not goal:
            raise self.wrong("move_jp names no position", "give position: {joint: value}")
        for extra in (velocity.keys() | acceleration.keys()) - goal.keys():
            raise self.wrong(f"{extra}: velocity or acceleration without a position", "")
        for joint, value in goal.items():
            self._within(joint, value)
        speeds = self.pick(goal, velocity, "velocity")
        rates = self.pick(goal, acceleration, "acceleration")
        targets: dict[str, int] = {
            self.by_joint[joint].axis: self.by_joint[joint].counts(value) for joint, value in goal.items()
        }
        return [
            *per_axis("PA", targets),
            *per_axis("SP", self._steps(speeds, _SPEED_STEP)),
            *self.ramps(rates, speeds),
        ]

    def ramps(self, rates: Mapping[str, float], speeds: Mapping[str, float]) -> list[str]:
        """AC and DC for accelerations and speeds by joint.

        DC is what a stop decelerates with (it cannot be changed while an axis moves to a position), so it is never less
        than the axis's own acceleration, nor than what ends the motion within `stop_s`.
        """
        brakes = {}
        for joint, rate in rates.items():
            axis = self.by_joint[joint]
            soon = min(speeds[joint] / self._stop_s, axis.max_acceleration)
            brakes[joint] = max(rate, axis.acceleration, soon)
        up, down = self._steps(rates, _ACCELERATION_STEP), self._steps(brakes, _ACCELERATION_STEP)
        return [*per_axis("AC", up), *per_axis("DC", down)]

    def jog(self, velocity: Mapping[str, float]) -> list[str]:
        """JG for velocities by joint.

        Raises:
            CommandRejectedError: faster than allowed.
        """
        for joint, value in velocity.items():
            axis = self.by_joint[joint]
            if abs(value) > axis.max_velocity:
                raise self.rejected(
                    f"{joint}: velocity {value:g} {axis.unit}/s is above the limit {axis.max_velocity:g} {axis.unit}/s",
                    "ask for less",
                )
        speeds: dict[str, int] = {}
        for joint, value in velocity.items():
            axis = self.by_joint[joint]
            speeds[axis.axis] = axis.sign * _SPEED_STEP * round(value * axis.counts_per_unit / _SPEED_STEP)
        return per_axis("JG", speeds)

    def pick(self, joints: Iterable[str], asked: Mapping[str, float], what: str) -> dict[str, float]:
        """What was asked, or the axis's own default, for each of `joints`.

        Raises:
            CommandRejectedError: not above zero, or above the maximum.
        """
        picked = {}
        for joint in joints:
            axis = self.by_joint[joint]
            value = asked.get(joint, getattr(axis, what))
            most: float = getattr(axis, f"max_{what}")
            if not 0 < value <= most:
                raise self.rejected(
                    f"{joint}: {what} {value:g} is outside 0 to {most:g}", f"the limit is max_{what} of the axis"
                )
            picked[joint] = value
        return picked

    def letters_of(self, joints: Iterable[str]) -> str:
        """The axis letters of some joints, in the controller's order."""
        return "".join(sorted(self.by_joint[joint].axis for joint in joints))

    def limit_commands(self) -> list[str]:
        """FL and BL for all axes."""
        ends: dict[str, tuple[int, int]] = {axis.axis: axis.software_limits for axis in self.by_joint.values()}
        forward, reverse = ({letter: end[side] for letter, end in ends.items()} for side in (0, 1))
        return [*per_axis("FL", forward), *per_axis("BL", reverse)]

    def _within(self, joint: str, value: float) -> None:
        axis = self.by_joint[joint]
        for beyond, side, limit in (
            (value > axis.upper, "upper", axis.upper),
            (value < axis.lower, "lower", axis.lower),
        ):
            if beyond:
                raise self.rejected(
                    f"{joint}: position {value:g} {axis.unit} is beyond the {side} limit {limit:g} {axis.unit}",
                    "ask for a position inside the limits",
                )

    def _steps(self, values: Mapping[str, float], step: int) -> dict[str, int]:
        """Values by joint in whole steps of the controller, by axis letter: one or more, never above what was asked."""
        axes = {joint: self.by_joint[joint] for joint in values}
        return {axes[j].axis: max(1, int(v * axes[j].counts_per_unit / step)) * step for j, v in values.items()}
