"""What is known of a Galil's axes: joint states from data records, faults from what has changed since the last one."""

from typing import TYPE_CHECKING

from galen_hw.drivers.galil_dmc.axes import Axes
from galen_hw.drivers.galil_dmc.codec import (
    ELO_A_D,
    ELO_E_H,
    LIMIT_STOPS,
    STOP_CODES,
    DataRecord,
    letters,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

_GROUP = "ABCD"
_AMPLIFIER_FAULTS = ("over-current", "over-voltage", "over-temperature", "under-voltage")


class GalilState:
    """The latest record and what it means.

    Args:
        axes: the configuration.
        arming: the controller's own time-out has run out and is set up anew.
        status_due: an axis was stopped by a fault, so `take_status` is wanted at once.
        limit_active: what a limit switch's bit is while the axis stands on it.
    """

    def __init__(self, axes: Axes, limit_active: int) -> None:
        self._axes, self._limit_active = axes, limit_active
        self.latched: dict[str, str] = {}
        self.arming = False
        self.reset()

    def reset(self) -> None:
        """Forget the controller, not what it did: latched faults stay until they are cleared."""
        self.record: DataRecord | None = None
        self.disabled_limits: Mapping[str, int] = {}
        self.amplifier_status = 0
        self.abort_input = False
        self.status_due = False
        self._stop_codes: dict[str, int] = {}

    @property
    def estop(self) -> bool:
        """Emergency stop (ELO) of a group of axes in use, or the abort input, is engaged."""
        axes = self._axes.letters
        elo = bool(self.amplifier_status & ELO_A_D) and any(a in _GROUP for a in axes)
        elo |= bool(self.amplifier_status & ELO_E_H) and any(a not in _GROUP for a in axes)
        return elo or self.abort_input

    @property
    def moving(self) -> bool:
        """Any axis moves."""
        return self.record is not None and any(self.record.axes[a].moving for a in self._axes.letters)

    @property
    def moving_joints(self) -> set[str]:
        """The joints that move."""
        if self.record is None:
            return set()
        return {joint for joint, axis in self._axes.by_joint.items() if self.record.axes[axis.axis].moving}

    @property
    def enabled(self) -> bool:
        """All motors are on."""
        return self.record is not None and all(self.record.axes[a].motor_on for a in self._axes.letters)

    @property
    def powered(self) -> bool:
        """Any motor is on."""
        return self.record is not None and any(self.record.axes[a].motor_on for a in self._axes.letters)

    @property
    def disagreeing(self) -> bool:
        """Some motors are on and some are off."""
        return self.record is not None and len({self.record.axes[a].motor_on for a in self._axes.letters}) > 1

    @property
    def todo(self) -> str:
        """Return what an operator does about what is latched; empty where nothing is."""
        if self.estop:
            return f"release it, then {self._axes.again}"
        return f"remove the cause, then {self._axes.again}" if self.latched else ""

    def at_limits(self, joint: str) -> tuple[bool, bool]:
        """At the lower and at the upper end."""
        axis = self._axes.by_joint[joint]
        if self.record is None:
            return False, False
        block = self.record.axes[axis.axis]
        return axis.at_limits(block, self._limit_active, self.disabled_limits.get(axis.axis, 0))

    def take_status(self, *, amplifier_status: int, abort_input: bool) -> list[tuple[str, str]]:
        """Take what the general block and `MG _AB` say; faults (what, todo) that are new."""
        before = self.estop
        raised = amplifier_status & ~self.amplifier_status
        self.amplifier_status, self.abort_input = amplifier_status, abort_input
        self.status_due = False
        faults = [
            (f"amplifier {'E-H' if bit & 4 else 'A-D'}: {_AMPLIFIER_FAULTS[bit & 3]}", "look at the amplifier")
            for bit in range(8)
            if raised >> bit & 1
        ]
        halls = letters(raised >> 8 & 0xFF)
        faults += [(f"axis {letter}: hall error", "look at the cable") for letter in halls]
        if faults:
            self.latched["amplifier"] = ", ".join(what for what, _ in faults)
        if self.estop and not before:
            self.latched["estop"] = "emergency stop or abort input engaged"
            faults.append((self.latched["estop"], f"release it, then {self._axes.again}"))
        return faults

    def take_record(self, record: DataRecord) -> list[tuple[str, str]]:
        """Take a record; faults (what, todo) that are new."""
        first, self.record = self.record is None, record
        faults = []
        for joint, axis in self._axes.by_joint.items():
            code = record.axes[axis.axis].stop_code
            before = self._stop_codes.get(joint, code)
            self._stop_codes[joint] = code
            text, is_fault = STOP_CODES.get(code, (f"stopped with the unknown code {code}", True))
            if first or code == before or not is_fault:
                continue
            if code not in LIMIT_STOPS:
                self.status_due = True  # an emergency stop may be behind it
                self.latched[f"stop code {joint}"] = f"{joint}: {text}"
            todo = "move it the other way" if code in LIMIT_STOPS else f"remove the cause, then {self._axes.again}"
            faults.append((f"{joint}: {text}", todo))
        return faults

    def joints(self) -> dict[str, dict[str, float] | dict[str, bool] | dict[str, int]]:
        """The tables of a `JointsState` (SI) from the latest record."""
        record = self.record
        if record is None:
            return {"position": {}, "velocity": {}, "effort": {}}
        pairs = [(joint, axis, record.axes[axis.axis]) for joint, axis in self._axes.by_joint.items()]
        limits = {joint: self.at_limits(joint) for joint, _, _ in pairs}
        return {
            "position": {j: a.position(b.position) for j, a, b in pairs},
            "velocity": {j: a.velocity_of(b) for j, a, b in pairs},
            "effort": {j: a.effort_of(b) for j, a, b in pairs},
            "moving": {j: b.moving for j, _, b in pairs},
            "enabled": {j: b.motor_on for j, _, b in pairs},
            "stop_code": {j: b.stop_code for j, _, b in pairs},
            "at_lower": {j: lower for j, (lower, _) in limits.items()},
            "at_upper": {j: upper for j, (_, upper) in limits.items()},
        }
