"""One axis of the virtual controller: profiler, servo with its following error, limits, stop codes.

The profiler's reference is a `Path`. The motor follows it a fixed time later, which makes the following error
proportional to speed, as in a real loop. Counts, counts/s, seconds since power-up.
"""

import math
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.parts import Mode, Plant, Registers, Stop
from galen_hw.drivers.virtual.galil_dmc.profile import Path, Piece, Rates, State, hold, jog, move, stop

_HOMING_SPEED: Final = 1024.0  # counts/s, of the second, slow approach to the home switch


class Axis:
    """One axis; `step` is called once a controller tick, everything else between ticks.

    Args:
        plant: the mechanics.
        position: where the motor stands at power-up, counts from the axis' zero.
    """

    def __init__(self, plant: Plant, position: float = 0.0) -> None:
        self.plant, self.registers = plant, Registers()
        self.reference = Path(position + plant.offset)
        self.motor: Path | None = None  # Without power: it runs out by itself.
        self.gap: Path | None = None  # What is left of a distance from the reference after a hold or an abort.
        self.shift = 0.0
        self.auxiliary_zero = 0.0
        self.motor_on, self.moving, self.stopping = False, False, False
        self.code: int = Stop.AT_TARGET
        self.mode, self.running_mode = Mode.ABSOLUTE, Mode.ABSOLUTE
        self.target = float(round(position + plant.offset))
        self.step_by = 0.0
        self.home_phase, self._edge_level = 0, 0
        self.blocked_at: float | None = None
        self.limit_active_high = False
        self._pending_code: int = Stop.AT_TARGET

    # Where the axis is. Reported counts are physical counts plus the encoder's offset plus what DP added.

    def actual(self, t: float) -> State:
        """State of the motor in reported counts; exact between ticks too."""
        if self.blocked_at is not None:
            return State(self.blocked_at + self.plant.offset + self.shift, 0.0, 0.0)
        state = self._free(t)
        zero = self.plant.offset + self.shift
        low = self.plant.reverse_switch - self.plant.margin + zero
        high = self.plant.forward_switch + self.plant.margin + zero
        if low <= state.p <= high:
            return state
        return State(min(max(state.p, low), high), 0.0, 0.0)

    def _free(self, t: float) -> State:
        """State of the motor if neither a hand nor a hard stop held it."""
        if self.motor is not None:
            return self.motor.at(t)
        follows = self.reference.at(t - self.plant.lag_s)
        if self.gap is None:
            return follows
        gap = self.gap.at(t)
        return State(follows.p + gap.p, follows.v + gap.v, follows.a + gap.a)

    def settled(self, t: float) -> bool:
        """Nothing moves, and nothing will by itself."""
        paths = [path for path in (self.motor, self.gap) if path is not None]
        rest = max([self.reference.end + self.plant.lag_s, *(path.end for path in paths)])
        return not self.moving and t > rest

    def physical(self, t: float) -> State:
        """State of the motor from the axis' own zero."""
        state = self.actual(t)
        return State(state.p - self.plant.offset - self.shift, state.v, state.a)

    def position(self, t: float) -> int:
        """TP."""
        return round(self.actual(t).p)

    def commanded(self, t: float) -> int:
        """RP; without power it follows the motor."""
        return round(self.reference.at(t).p) if self.motor_on else self.position(t)

    def error(self, t: float) -> int:
        """TE."""
        return self.commanded(t) - self.position(t)

    def switch_closed(self, t: float, direction: int) -> bool:
        """Return whether the motor stands on a limit switch, +1 forward, -1 reverse."""
        p = self.physical(t).p
        return p >= self.plant.forward_switch if direction > 0 else p <= self.plant.reverse_switch

    def switch_level(self, t: float, direction: int) -> int:
        """The input: 1 while the switch is not engaged (it pulls the input low)."""
        return int(not self.switch_closed(t, direction))

    def home_level(self, t: float) -> int:
        """The home input: 1 beyond the switch."""
        return int(self.physical(t).p >= self.plant.home_switch)

    def limited(self, t: float, direction: int) -> bool:
        """Return whether a switch (as CN reads it, unless LD disables it) or a software limit forbids this direction."""
        mask = 1 if direction > 0 else 2
        active = self.switch_level(t, direction) == int(self.limit_active_high)
        if active and not int(self.registers.LD) & mask:
            return True
        reference = self.reference.at(t).p
        return reference > self.registers.FL if direction > 0 else reference < self.registers.BL

    # What commands do.

    def servo_here(self, t: float) -> None:
        """SH: the reference becomes where the motor stands."""
        if not self.motor_on:
            self.target = float(self.position(t))
            self.reference, self.motor, self.motor_on = Path(self.target), None, True
            self.gap = None

    def off(self, t: float, code: int | None = None) -> None:
        """Take the power away: the motor runs out under friction, the reference is given up."""
        now = self.actual(t)
        if self.motor_on or self.motor is not None:
            self.motor = Path(now.p)
            self.motor.replace(stop(t, now, self.plant.brake), keep_after=t)
        self._rest_at(t, self.motor.at(self.motor.end).p if self.motor else now.p)
        self._finish(code)
        self.motor_on = False

    def begin(self, t: float, tick: float) -> None:
        """BG: start what PA, PR, JG, FE, FI or HM prepared, at the next tick `tick`."""
        now = self.reference.at(t)
        if self.mode is Mode.RELATIVE:
            self.target = now.p + self.step_by
        self.running_mode, self.moving, self.stopping = self.mode, True, False
        self.code, self._pending_code, self.home_phase = Stop.RUNNING, Stop.AT_TARGET, 0
        self._plan(tick)

    def direction(self, t: float) -> int:
        """Which way BG would go: +1, -1, 0."""
        if self.mode is Mode.JOG:
            way = self.registers.JG
        elif self.mode in {Mode.FIND_EDGE, Mode.HOME}:
            way = 1.0 if not self.home_level(t) else -1.0
        elif self.mode is Mode.FIND_INDEX:
            way = self.registers.JG
        else:
            way = self.step_by if self.mode is Mode.RELATIVE else self.target - self.reference.at(t).p
        return (way > 0) - (way < 0)

    def replan(self, tick: float) -> None:
        """SP, AC, DC or JG changed while moving."""
        if self.moving and not self.stopping:
            self._plan(tick)

    def stop(self, tick: float, code: int = Stop.COMMAND) -> None:
        """ST, or a limit: brake at DC. An axis at rest takes the code too."""
        if not self.moving:
            self.code = code
        elif not self.stopping:
            self.stopping, self._pending_code = True, code
            self._follow(stop(tick, self.reference.at(tick), self.registers.DC))

    def abort(self, t: float, code: int) -> None:
        """AB or the abort input: the reference stands at once; the motor overshoots and comes back."""
        if not self.moving:
            return
        now = self.actual(t)
        stand = float(round(self.reference.at(t).p))
        self.reference = Path(stand)
        self._catch_up(t, State(now.p - stand, now.v, 0.0))
        self._finish(code)

    def define_position(self, t: float, counts: float) -> None:
        """DP: this place is `counts` from now on."""
        self._rename(counts - self.position(t))

    def _rename(self, change: float) -> None:
        """Add `change` to the counts of every place."""
        self.shift += change
        self.reference.shift(change)
        if self.motor is not None:
            self.motor.shift(change)
        self.target += change

    def block(self, t: float, *, blocked: bool) -> None:
        """Something holds the axis from outside; let go, it catches up with the reference."""
        if blocked and self.blocked_at is None:
            self.blocked_at = self.physical(t).p
        elif not blocked and self.blocked_at is not None:
            now, goal = self.actual(t), self.reference.at(t - self.plant.lag_s)
            self.blocked_at = None
            if self.motor_on:
                self._catch_up(t, State(now.p - goal.p, -goal.v, 0.0))
            else:
                self.motor = Path(now.p)

    def _catch_up(self, t: float, gap: State) -> None:
        """Let the motor close its distance from the (delayed) reference as fast as it can."""
        rates = Rates(max(self.registers.SP, abs(gap.v), 1.0), self.plant.brake, self.plant.brake)
        self.gap = Path(gap.p)
        self.gap.replace(move(t, gap, 0.0, rates), keep_after=t)

    def step(self, t: float, tick: float) -> None:
        """One controller tick at `t`: trip, limits, ends of motion. `tick` is the next one."""
        if self.motor_on and abs(self.error(t)) > self.registers.ER and int(self.registers.OE) & 1:
            self.off(t, Stop.OFF_ON_ERROR)
        if not self.moving:
            return
        velocity = self.reference.at(t).v
        direction = (velocity > 0) - (velocity < 0)
        if direction and not self.stopping and self.limited(t, direction):
            code = Stop.FORWARD_LIMIT if direction > 0 else Stop.REVERSE_LIMIT
            self.stop(tick, code)
            if int(self.registers.OE) & 2:
                self.off(t, code)
        elif self.running_mode in {Mode.FIND_EDGE, Mode.FIND_INDEX, Mode.HOME} and not self.stopping:
            self._search(t, tick)
        if self.moving and self.reference.settles and t >= self.reference.end:
            self._arrive(t, tick)

    # Inside.

    def _plan(self, tick: float) -> None:
        r, now = self.registers, self.reference.at(tick)
        if self.running_mode in {Mode.ABSOLUTE, Mode.RELATIVE}:
            self._follow(move(tick, now, self.target, Rates(r.SP, r.AC, r.DC)))
        elif self.running_mode is Mode.JOG or (self.running_mode is Mode.FIND_INDEX):
            self._follow(jog(tick, now, r.JG, r.AC, r.DC))
        else:
            speed = r.SP if self.home_phase == 0 else min(r.SP, _HOMING_SPEED)
            way = 1.0 if not self.home_level(tick) else -1.0
            self._edge_level = self.home_level(tick)
            self._follow(jog(tick, now, way * speed, r.AC, r.DC))

    def _search(self, t: float, tick: float) -> None:
        """FE and HM end at the edge of the home input, FI at the next index."""
        if self.running_mode is Mode.FIND_INDEX:
            now = self.reference.at(t)
            zero = self.plant.offset + self.shift
            index = self.plant.index_spacing
            way = math.copysign(1.0, self.registers.JG)
            ahead = stop(t, now, self.registers.DC)[-1].p
            target = zero + way * math.ceil(way * (ahead - zero) / index) * index
            self.stopping, self._pending_code = True, Stop.HOME
            rates = Rates(abs(self.registers.JG), self.registers.AC, self.registers.DC)
            self._follow(move(tick, self.reference.at(tick), target, rates))
        elif self.home_level(t) != self._edge_level:
            code = Stop.FIND_EDGE if self.running_mode is Mode.FIND_EDGE else Stop.HOME
            self.stop(tick, code)

    def _arrive(self, t: float, tick: float) -> None:
        """The reference rests: done, or the next phase of homing."""
        if self.running_mode is Mode.HOME and self.stopping and self._pending_code == Stop.HOME and self.home_phase < 1:
            self.home_phase, self.stopping = 1, False
            self._plan(tick)
            return
        code = self._pending_code
        self._finish(code)
        if code == Stop.HOME:
            self._rename(-self.reference.at(t).p)  # The motor is still on its way there.

    def _finish(self, code: int | None) -> None:
        if code is not None:
            self.code = code
        self.moving, self.stopping = False, False

    def _follow(self, pieces: list[Piece]) -> None:
        self.reference.replace(pieces, keep_after=pieces[0].t - 2.0 * self.plant.lag_s - 0.01)

    def _rest_at(self, t: float, position: float) -> None:
        self._follow(hold(t, position))
