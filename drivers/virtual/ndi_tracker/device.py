"""A virtual NDI tracker (Polaris family) at the other end of a serial line, written from the Combined API's facts.

Two markers: the first handle that is asked for sees the one on the tool, the second the one on the base.
"""

from typing import ClassVar, Final

from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.faults import parse_fault
from galen_hw.drivers.virtual.ndi_tracker.definition import DEFINITIONS
from galen_hw.drivers.virtual.ndi_tracker.ports import Ports
from galen_hw.drivers.virtual.ndi_tracker.scene import Scene, SceneSettings, SceneWorld
from galen_hw.drivers.virtual.ndi_tracker.session import Identity, Session
from galen_hw.drivers.virtual.ndi_tracker.wire import CommandReader, LineSettings, NdiError, garble, parse, text_reply
from galen_hw.drivers.virtual.paced_line import PacedLine

_IDLE_NS: Final = 50_000_000
_BREAK_AFTER_NS: Final = 2_000_000_000
_SYSTEM_BITS: Final = {"tracker.interference": 1, "tracker.recoverable": 3, "tracker.hardware": 4}


class VirtualNdiTracker:
    """The measurement system and its line.

    Args:
        settings: see `Settings`.
        world: whose tip it follows, and whose faults it suffers, see `FAULTS`.

    `host_baud_rate` is what the port knows of the host's side (a pty's slave keeps it): at another speed than the
    tracker's, what goes either way is garbled. None: not known, both always understand each other.
    """

    class Settings(BaseModel):
        """The unit, its scene and its line."""

        model_config = ConfigDict(extra="forbid")
        scene: SceneSettings = Field(default_factory=SceneSettings)
        model: str = "Polaris Spectra"
        revision: str = "010"
        serial_number: str = "P6-00123"
        paced: bool = True
        announce: bool = Field(default=True, description="say RESET at power-up")
        reply_time_s: float = Field(default=0.001, ge=0.0)

    FAULTS: ClassVar[dict[str, str]] = {
        **Scene.FAULTS,
        "tracker.silent": "the tracker answers nothing",
        "tracker.bad_crc": "replies carry a wrong CRC: each, or @N",
        "tracker.restart": "the tracker restarts once: RESET, everything forgotten",
        "tracker.frames_restart": "the frame counter starts again at 0, once",
        "tracker.interference": "too much external infrared (system status bit 1)",
        "tracker.recoverable": "recoverable error (system status bit 3)",
        "tracker.hardware": "hardware failure (system status bit 4)",
        "tracker.status": "system status bit, e.g. tracker.status.5",
    }

    def __init__(self, settings: Settings, world: SceneWorld) -> None:
        self.settings, self.world = settings, world
        identity = Identity(settings.model, settings.revision, settings.serial_number)
        self.session = Session(Scene(settings.scene, world), identity, ports=Ports())
        self.host_baud_rate: int | None = None
        self._reader = CommandReader()
        self._rx, self._tx = PacedLine(0), PacedLine(0)
        self._now_ns = 0
        self._powered = False
        self._struck: set[str] = set()
        self._replies = 0
        self._switched_ns, self._baud_rate = 0, LineSettings().baud_rate

    @property
    def files(self) -> dict[str, bytes]:
        """What comes in the box: the tool definitions of the two marker bodies, by file name."""
        return dict(DEFINITIONS)

    @property
    def line(self) -> LineSettings:
        """What the host must set its side to."""
        return self.session.line

    def power_cycle(self, now_ns: int, *, announce: bool = True) -> None:
        """Off and on: says RESET at 9600 baud."""
        self._powered = True
        self._now_ns = max(self._now_ns, now_ns)
        self._reader.clear()
        self._rx.clear()
        self._tx.clear()
        self.session.power_up(self._now_ns)
        self._set_speed()
        if announce:
            self._send(text_reply("RESET"))

    def feed(self, data: bytes, t_ns: int) -> None:
        """Bytes that the host began to send at `t_ns`."""
        self._run(t_ns)
        if self._mismatched and self.host_baud_rate == LineSettings().baud_rate:
            self._take_for_break(t_ns)
        self._rx.put(garble(data) if self._mismatched else data, t_ns)
        self._run(t_ns)

    def poll(self, now_ns: int) -> list[bytes]:
        """What has left the line by `now_ns`."""
        self._run(now_ns)
        out = self._tx.take(self._now_ns)
        return [out] if out else []

    @property
    def wakeup_ns(self) -> int:
        """When to poll next."""
        lines = (self._rx.next_ns(self._now_ns), self._tx.next_ns(self._now_ns))
        return min([self._now_ns + _IDLE_NS, *(t for t in lines if t is not None)])

    @property
    def _mismatched(self) -> bool:
        return self.host_baud_rate is not None and self.host_baud_rate != self._baud_rate

    def _take_for_break(self, t_ns: int) -> None:
        """A host that speaks at 9600 again after a while has sent a break before, which a pty cannot show."""
        if t_ns - self._switched_ns > _BREAK_AFTER_NS:
            self.power_cycle(t_ns, announce=False)

    def _run(self, now_ns: int) -> None:
        if not self._powered:
            self.power_cycle(now_ns, announce=self.settings.announce)
        self._strike(max(now_ns, self._now_ns))
        while (item := self._rx.pop(now_ns)) is not None:
            self._now_ns = max(self._now_ns, item[0])
            line = self._reader.feed(item[1])
            if line is not None:
                self._answer(line)
        self._now_ns = max(self._now_ns, now_ns)

    def _strike(self, now_ns: int) -> None:
        """Faults that happen once when they are switched on, and the system status of the others."""
        faults = {parse_fault(text)[:2] for text in self.world.faults}
        names = {name for name, _ in faults}
        begun, self._struck = names - self._struck, names
        bits = {_SYSTEM_BITS[name] for name in names & _SYSTEM_BITS.keys()}
        bits |= {number for name, number in faults if name == "tracker.status" and number is not None}
        self.session.system_status = sum(1 << bit for bit in bits) & 0xFFFF
        if "tracker.frames_restart" in begun:
            self.session.scene.origin_ns = now_ns
        if "tracker.restart" in begun:
            self.power_cycle(now_ns)

    def _answer(self, line: bytes) -> None:
        if not line:
            return
        before = self.line
        try:
            command = parse(line)
            if command.name == "RESET":
                self.power_cycle(self._now_ns)
                return
            reply = self.session.carry_out(command, self._now_ns)
        except NdiError as error:
            reply = text_reply(f"ERROR{error.code:02X}")
        self._send(self._broken(reply))
        if self.line != before:
            self._set_speed()  # The answer still leaves at the old speed.

    def _broken(self, reply: bytes) -> bytes:
        self._replies += 1
        for text in self.world.faults:
            name, _, every = parse_fault(text)
            if name == "tracker.bad_crc" and self._replies % every == 0:
                return bytes([reply[0] ^ 0x01]) + reply[1:]
        return reply

    def _send(self, data: bytes) -> None:
        if "tracker.silent" in self.world.faults:
            return
        at = self._now_ns + round(self.settings.reply_time_s * NS_PER_S)
        self._tx.put(garble(data) if self._mismatched else data, at)

    def _set_speed(self) -> None:
        self._switched_ns, self._baud_rate = self._now_ns, self.line.baud_rate
        speed = self.line.baud_rate if self.settings.paced else 0
        self._rx.set_baud_rate(speed)
        self._tx.set_baud_rate(speed)
