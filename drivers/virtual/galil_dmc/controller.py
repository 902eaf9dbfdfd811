"""What the virtual controller knows besides its axes, and how its time goes on."""

import math
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.axis import Axis
from galen_hw.drivers.virtual.galil_dmc.format import Rejected, message_numbers, positions
from galen_hw.drivers.virtual.galil_dmc.grammar import number
from galen_hw.drivers.virtual.galil_dmc.parts import TICKS_PER_S, Plant, Stop
from galen_hw.drivers.virtual.galil_dmc.program import Program

AMPLIFIER_ELO: Final = 1 << 24
_ELO_INPUT: Final = 7


@dataclass(slots=True)
class Format:
    """LZ, PF and VF as they are at power-up, and CW, CF, EO."""

    suppress_zeros: bool = True
    position: tuple[int, int] = (10, 0)
    variable: tuple[int, int] = (10, 4)
    mark_unsolicited: bool = False
    unsolicited_here: bool = True
    echo: bool = True


@dataclass(slots=True)
class Inputs:
    """Levels of the inputs that faults of the world pull."""

    elo: bool = False
    abort: bool = False


@dataclass(frozen=True, slots=True)
class Model:
    """What the controller says of itself."""

    name: str = "DMC4153"
    revision: str = "1.3a"
    serial_number: int = 12345
    switch_one_is_clear: bool = True


@dataclass(slots=True)
class Controller:
    """Axes, registers and time.

    Args:
        plants: the mechanics, one an axis.
        starts: where the motors stand at power-up, counts from the axes' zeros.
        model: of the controller.
        format: power-up values of the formats.
    """

    plants: list[Plant]
    starts: list[float]
    model: Model = field(default_factory=Model)
    format: Format = field(default_factory=Format)
    axes: list[Axis] = field(init=False)
    program: Program = field(default_factory=Program)
    inputs: Inputs = field(default_factory=Inputs)
    variables: dict[str, float] = field(default_factory=dict)
    polarity: list[int] = field(default_factory=lambda: [-1, -1, -1, 0, 0])
    outputs: int = 0
    error_code: int = 0
    t: float = 0.0
    tick: int = 0
    downloading: bool = False
    reset_requested: bool = False
    unsolicited: list[str] = field(default_factory=list)
    evaluate: Callable[[str], float] = number
    burned: Format = field(init=False)

    def __post_init__(self) -> None:
        self.axes = [Axis(plant, start) for plant, start in zip(self.plants, self.starts, strict=True)]
        self.burned = replace(self.format)

    def keep(self) -> None:
        """BN: the formats survive a reset from now on."""
        self.burned = replace(self.format)

    def reset(self) -> None:
        """RS: as after power-up, with what was burned; motors off, the shafts stay where they are."""
        stands = [axis.physical(self.t).p for axis in self.axes]
        self.axes = [Axis(plant, stand) for plant, stand in zip(self.plants, stands, strict=True)]
        self.format, self.polarity = replace(self.burned), [-1, -1, -1, 0, 0]
        self.variables, self.error_code, self.outputs = {}, 0, 0
        self.program.halt()
        self.downloading, self.reset_requested = False, False

    def value(self, text: str) -> float:
        """An argument: a number, an operand or a variable.

        Raises:
            Rejected: none of them.
        """
        return self.evaluate(text)

    @property
    def next_tick(self) -> float:
        """Time of the tick at which what is commanded now begins."""
        return (math.floor(self.t * TICKS_PER_S) + 1) / TICKS_PER_S

    @property
    def tick_time(self) -> float:
        """Time of the last tick: what the controller reports is of then."""
        return self.tick / TICKS_PER_S

    @property
    def moving(self) -> bool:
        """Something moves, or still settles."""
        return not all(axis.settled(self.t) for axis in self.axes)

    @property
    def busy(self) -> bool:
        """Ticks must be looked at one by one."""
        return self.program.running or self.moving

    def advance(self, t: float) -> None:
        """Let the controller's ticks up to `t` (s since power-up) happen; at rest only the last one counts."""
        last = math.floor(t * TICKS_PER_S)
        while self.tick < last:
            self.tick = self.tick + 1 if self.busy else last
            self.t = self.tick_time
            self._step()
        self.t = max(self.t, t)

    def _step(self) -> None:
        t, upcoming = self.tick_time, (self.tick + 1) / TICKS_PER_S
        for axis in self.axes:
            if self.inputs.elo and axis.motor_on:
                axis.off(t, Stop.AMPLIFIER)
            if self.inputs.abort and axis.moving:
                axis.abort(t, Stop.ABORT_INPUT)
                if int(axis.registers.OE) & 1:
                    axis.off(t, Stop.ABORT_INPUT)
            axis.step(t, upcoming)
        self.program.step(self)

    def take_faults(self, faults: AbstractSet[str], joints: list[str]) -> None:
        """Read the world's faults: `elo`, `abort_input`, `motors.blocked.JOINT`."""
        self.inputs.elo, self.inputs.abort = "elo" in faults, "abort_input" in faults
        for axis, joint in zip(self.axes, joints, strict=True):
            axis.block(self.t, blocked=f"motors.blocked.{joint}" in faults)

    def input_level(self, number: int) -> int:
        """@IN[n]: high unless pulled; input 7 is wired to the ELO circuit."""
        if not 1 <= number <= 16:
            raise Rejected(57)
        return int(not (number == _ELO_INPUT and self.inputs.elo))

    @property
    def amplifier_status(self) -> int:
        """The amplifier word of the data record: ELO of axes A-D and E-H."""
        if not self.inputs.elo:
            return 0
        return AMPLIFIER_ELO | (AMPLIFIER_ELO << 1 if len(self.axes) > 4 else 0)

    def tell(self, values: list[float]) -> str:
        """Values as TP and its like write them (PF, LZ)."""
        whole, fraction = self.format.position
        return positions(values, whole, fraction, leading_zeros=not self.format.suppress_zeros)

    def tell_variables(self, values: list[float]) -> str:
        """Values as MG writes them (VF, LZ)."""
        whole, fraction = self.format.variable
        return message_numbers(values, whole, fraction, leading_zeros=not self.format.suppress_zeros)

    def say(self, text: str) -> None:
        """An unsolicited line, where CF sends it."""
        if self.format.unsolicited_here:
            self.unsolicited.append(text)

    def switches(self, axis: Axis) -> int:
        """Switches byte of an axis as QR has it, polarity as the unit at hand has it."""
        forward, reverse = (axis.switch_level(self.tick_time, d) for d in (1, -1))
        if not self.model.switch_one_is_clear:
            forward, reverse = 1 - forward, 1 - reverse
        return forward << 3 | reverse << 2 | axis.home_level(self.tick_time) << 1

    def tell_switches(self, axis: Axis) -> int:
        """TS: moving, error exceeded, motor off, limits inactive, home."""
        t = self.tick_time
        exceeded = abs(axis.error(t)) > axis.registers.ER
        high = axis.moving << 7 | exceeded << 6 | (not axis.motor_on) << 5
        return high | axis.switch_level(t, 1) << 3 | axis.switch_level(t, -1) << 2 | axis.home_level(t) << 1

    def torque(self, axis: Axis) -> float:
        """TT, volts: friction and what the loop asks for, within TL."""
        if not axis.motor_on:
            return 0.0
        now = axis.actual(self.tick_time)
        friction = math.copysign(0.25, now.v) if now.v else 0.0
        volts = friction + 0.002 * axis.error(self.tick_time) + 1e-6 * now.a
        return max(-axis.registers.TL, min(axis.registers.TL, volts))
