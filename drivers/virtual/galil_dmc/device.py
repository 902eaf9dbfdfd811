"""A virtual Galil DMC-40x0 family controller at the other end of a serial line, written from the data sheets.

Bytes arrive and leave at the line's speed; the controller's own time goes on in ticks of 1/1024 s. Its motors are the
joints of the world: they are set at each call, exactly for its time.
"""

from collections.abc import Set as AbstractSet
from typing import ClassVar, Final, Literal, Protocol

from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.galil_dmc.controller import Controller, Format, Model
from galen_hw.drivers.virtual.galil_dmc.grammar import REVISION_REQUEST, Line, LineReader
from galen_hw.drivers.virtual.galil_dmc.interpreter import Interpreter
from galen_hw.drivers.virtual.galil_dmc.parts import Plant
from galen_hw.drivers.virtual.paced_line import PacedLine
from galen_hw.kinematics import GALEN_JOINTS
from galen_hw.spatial import Array

_MOTION_UPDATE_NS: Final = 2_000_000
_IDLE_NS: Final = 20_000_000
_RESET_NS: Final = 300_000_000
_LATE_NS: Final = 1_000_000_000


class MotorWorld(Protocol):
    """What the motors need of the world."""

    @property
    def faults(self) -> AbstractSet[str]:
        """Names of the faults that are on."""
        ...

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of the joints, m and rad."""
        ...

    def set_joints(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t_ns: int) -> None:
        """Move the joints."""
        ...


class AxisSettings(BaseModel):
    """One axis; units are those of the joint, m or rad. A motor mounted the other way round counts negatively."""

    model_config = ConfigDict(extra="forbid")
    joint: str
    counts_per_unit: float
    offset_counts: int = 0
    start: float = 0.0
    home_switch: float = 0.0
    hard_stop_margin: float = Field(default=0.01, ge=0.0)


Letter = Literal["A", "B", "C", "D", "E", "F", "G", "H"]


def _galen_axes() -> dict[Letter, AxisSettings]:
    scales = [1e6, 1e6, 1e6, 41721.64, 41721.64]
    letters: tuple[Letter, ...] = ("A", "B", "C", "D", "E")
    return {
        letter: AxisSettings(joint=joint, counts_per_unit=scale)
        for letter, joint, scale in zip(letters, GALEN_JOINTS, scales, strict=True)
    }


class VirtualGalilDmc:
    """The controller, its line and its motors.

    Args:
        settings: of the controller.
        world: whose joints it moves, and whose faults it suffers, see `FAULTS`.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        "elo": "the emergency stop is pressed: amplifiers off",
        "abort_input": "the controller's abort input is pulled",
        "motors.silent": "the motor controller answers nothing",
        "motors.late": "the motor controller answers a second late",
        **{f"motors.blocked.{joint}": f"something holds {joint}" for joint in GALEN_JOINTS},
    }

    class Settings(BaseModel):
        """How the virtual unit is built and wired."""

        model_config = ConfigDict(extra="forbid")
        baud_rate: int = Field(default=115_200, ge=0, description="bits/s; 0: as fast as a socket")
        axes: dict[Letter, AxisSettings] = Field(default_factory=_galen_axes)
        model: str = "DMC4153"
        revision: str = "1.3a"
        serial_number: int = 12345
        echo: bool = True
        limit_polarity: Literal["one_is_clear", "one_is_hit"] = "one_is_clear"
        following_lag_s: float = Field(default=0.002, ge=0.0)
        command_time_s: float = Field(default=0.0002, ge=0.0)

    def __init__(self, settings: Settings, world: MotorWorld) -> None:
        self.settings, self.world = settings, world
        self._axes = [settings.axes[letter] for letter in sorted(settings.axes)]
        self._joints = [axis.joint for axis in self._axes]
        self._places = [GALEN_JOINTS.index(joint) for joint in self._joints]
        self._scales = [axis.counts_per_unit for axis in self._axes]
        model = Model(
            settings.model, settings.revision, settings.serial_number, settings.limit_polarity == "one_is_clear"
        )
        starts = [axis.start * axis.counts_per_unit for axis in self._axes]
        self.controller = Controller(self._plants(), starts, model, Format(echo=settings.echo))
        self._interpreter = Interpreter(self.controller)
        self._reader = LineReader()
        self._rx, self._tx = PacedLine(settings.baud_rate), PacedLine(settings.baud_rate)
        self._origin_ns: int | None = None
        self._now_ns = 0
        self._deaf_until_ns = 0
        self._faults: set[str] = set()
        self._resting = False

    def _plants(self) -> list[Plant]:
        lower, upper = self.world.limits
        return [
            Plant(
                reverse_switch=min(float(lower[i]) * axis.counts_per_unit, float(upper[i]) * axis.counts_per_unit),
                forward_switch=max(float(lower[i]) * axis.counts_per_unit, float(upper[i]) * axis.counts_per_unit),
                home_switch=axis.home_switch * axis.counts_per_unit,
                margin=axis.hard_stop_margin * abs(axis.counts_per_unit),
                lag_s=self.settings.following_lag_s,
                brake=2.0 * abs(axis.counts_per_unit),
                offset=axis.offset_counts,
            )
            for axis in self._axes
            for i in [GALEN_JOINTS.index(axis.joint)]
        ]

    def power_cycle(self, now_ns: int) -> None:
        """Off and on: everything that was not burned is forgotten, the motors lose power."""
        self._run(now_ns)
        self.controller.reset()
        self._faults.clear()
        self._reader.clear()
        self._rx.clear()
        self._tx.clear()

    def stand(self, late_ns: int) -> None:
        """Let the controller's own time stand for so long: whoever keeps it was kept from it."""
        if self._origin_ns is not None:
            self._origin_ns += late_ns

    def feed(self, data: bytes, t_ns: int) -> None:
        """Bytes that the host began to send at `t_ns`; they take their time on the line."""
        self._rx.put(data, t_ns)
        self._run(t_ns)

    def poll(self, now_ns: int) -> list[bytes]:
        """What has left the line by `now_ns`; the joints are set for that time."""
        self._run(now_ns)
        out = self._tx.take(self._now_ns)
        return [out] if out else []

    @property
    def wakeup_ns(self) -> int:
        """When to poll next: bytes under way, motion, or a look at the faults."""
        times = [self._now_ns + (_MOTION_UPDATE_NS if self.controller.busy else _IDLE_NS)]
        times += [t for line in (self._rx, self._tx) if (t := line.next_ns(self._now_ns)) is not None]
        return min(times)

    def _run(self, now_ns: int) -> None:
        if self._origin_ns is None:
            self._origin_ns = self._now_ns = now_ns
        while (item := self._rx.pop(now_ns)) is not None:
            self._advance(item[0])
            self._byte(item[1])
        self._advance(now_ns)
        self._set_joints()

    def _advance(self, t_ns: int) -> None:
        """Let the controller's time go on, and put what it said by itself on the line."""
        assert self._origin_ns is not None
        self._now_ns = max(self._now_ns, t_ns)
        controller = self.controller
        if self.world.faults != self._faults:
            self._faults = set(self.world.faults)
            controller.take_faults(self._faults, self._joints)
        controller.advance((self._now_ns - self._origin_ns) / NS_PER_S)
        for text in controller.unsolicited:
            line = text.encode("latin-1") + b"\r\n"
            self._send(bytes(b | 0x80 for b in line) if controller.format.mark_unsolicited else line)
        controller.unsolicited.clear()

    def _byte(self, byte: int) -> None:
        if self._now_ns < self._deaf_until_ns:
            return
        if self.controller.format.echo and not self.controller.downloading:
            self._send(bytes([byte]))
        got = self._reader.feed(byte)
        if got == REVISION_REQUEST:
            model = self.controller.model
            self._send(f"{model.name} Rev {model.revision}\r\n:".encode())
        elif isinstance(got, Line):
            self._send(self._interpreter.answer(got), thinking=True)
            if self.controller.reset_requested:
                self._reset()

    def _reset(self) -> None:
        self.controller.reset()
        self._faults.clear()
        self._reader.clear()
        self._tx.clear()
        self._deaf_until_ns = self._now_ns + _RESET_NS
        self._tx.put(b":", self._deaf_until_ns)

    def _send(self, data: bytes, *, thinking: bool = False) -> None:
        if not data or "motors.silent" in self.world.faults:
            return
        delay = _LATE_NS if "motors.late" in self.world.faults else 0
        if thinking:
            delay += round(self.settings.command_time_s * NS_PER_S)
        self._tx.put(data, self._now_ns + delay)

    def _set_joints(self) -> None:
        """Tell the world; once is enough while everything rests, though a program may run on the controller."""
        rests = not self.controller.moving
        if rests and self._resting:
            return
        self._resting = rests
        t = self.controller.t
        q, dq, ddq = [[0.0] * len(GALEN_JOINTS) for _ in range(3)]
        for place, axis, scale in zip(self._places, self.controller.axes, self._scales, strict=True):
            state = axis.physical(t)
            q[place], dq[place], ddq[place] = state.p / scale, state.v / scale, state.a / scale
        self.world.set_joints(q, dq, ddq, self._now_ns)
