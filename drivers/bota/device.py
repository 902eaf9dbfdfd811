"""Bota Systems force/torque sensor through the vendor's package (`bota-driver`, extra `bota`), without I/O.

The package owns the wire and blocks whoever reads from it, the interpreter's lock in hand, so it runs in a process of its own
(`process`), and the wire of this device (`bota_transport`) is the lines of that process (`codec`). `stream` says which frame is
a sample, `zero` why the bias is the host's.

A sample is valid unless a status bit speaks against it: beyond the range, invalid, raw, or a bit that nobody has told us of.
A throttled sensor gives right samples, only fewer: they stay valid, and the status says `degraded`. Gauges are not watched
(`gauge_watch`): the package gives N and N m through the sensor's own matrix, and rounding steps of the gauges, which the watch
needs, are not to be had from these. A restart of the daemon or of the stream loses no zero; another sensor does.
"""

from typing import ClassVar, Final, Literal

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.bota import codec
from galen_hw.drivers.bota.codec import OVERRANGE, START, STOP, THROTTLED, Frame, status_texts
from galen_hw.drivers.bota.start import BotaIdentity, BotaSettings, Question
from galen_hw.drivers.bota.stream import Sieve
from galen_hw.drivers.bota.zero import told
from galen_hw.drivers.device import Output
from galen_hw.drivers.dialogue import DialogueError
from galen_hw.drivers.host_bias import HostBias
from galen_hw.drivers.host_biased import HostBiasedSensor
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.drivers.wrench_sensor import Phase
from galen_hw.messages import Vector3, WrenchRaw

COUNTERS: Final = (
    "samples",  # published
    "lost",  # frames that lack between two stamps of the package
    "doubled",  # frames that equal the one before
    "late",  # frames that had piled up, or that nobody waited for
    "malformed",  # lines that are none of the process'
    "timeouts",
    "saturated",  # samples beyond the sensor's range
    "unusable",  # samples with a status bit that makes them not valid
    "throttled",  # samples of a sensor that puts out fewer than it was asked for
    "restarts",
)
ZERO_CELSIUS_K: Final = 273.15


class Bota(HostBiasedSensor[bytes, BotaIdentity]):
    """Publishes `wrench/raw` in the sensor frame about its origin, N and N m, stamped when the package handed it over.

    Requests: `zero` {samples}: average and subtract from now on; `unzero`; `restart`: stop, identify and stream anew.
    """

    Settings = BotaSettings

    wire: ClassVar[Literal["can", "serial", "bota"]] = "bota"

    def __init__(self, name: str, settings: BotaSettings, time_base: TimeBase) -> None:
        self._settings = settings
        super().__init__(
            name,
            f"{name} (Bota Systems)",
            time_base,
            asked_rate_hz=settings.rate_hz,
            retry_s=settings.retry_s,
            counters=COUNTERS,
            silent_todo=_TODO_SILENT,
            bias=HostBias(name, settings.zero_samples, settings.rate_hz, told),
            zero_kept_s=settings.zero_kept_s,
        )
        self._line = b""
        self._wires: list[bytes] = []
        self._silent_ns = FAR_NS
        self._sieve = self._new_sieve()
        self._off = (0.0,) * 6
        self._word, self._unusable = 0, ""

    # ------------------------------------------------------------ the interface of every device

    def poll(self, now_ns: int) -> tuple[list[bytes], list[Output]]:
        """The question of the start, a stream that went silent, and the status once a second."""
        wires: list[bytes] = []
        if self._phase is Phase.RUNNING and now_ns >= self._silent_ns:
            self._counters["timeouts"] += 1
            self._fail(now_ns, DialogueError("no samples come", ""))
        elif self._phase in (Phase.STARTING, Phase.FAILED):
            wires = self._converse(now_ns)
        if now_ns >= self._bias.deadline_ns:
            self._outbox += self._bias.expire()
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: bytes, t_ns: int) -> list[Output]:
        """Take what was read; a sample comes out with the end of its line."""
        *lines, rest = (self._line + wire).split(b"\n")
        # Of a line without an end only so much is kept that it is still seen to be too long.
        self._line = rest[: codec.LONGEST + 1]
        outputs: list[Output] = []
        for line in lines:
            outputs += self._take(line, t_ns)
        return outputs

    def stop(self, now_ns: int) -> list[bytes]:
        """End the stream."""
        was_on, self._line = self._phase is not Phase.OFF, b""
        self._switch_off()
        return [STOP] if was_on else []

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        due = self._silent_ns if self._phase is Phase.RUNNING else self._start_due_ns
        return min(due, self._reporter.status_due_ns, self._bias.deadline_ns)

    # ------------------------------------------------------------ start

    def _new_dialogue(self, now_ns: int) -> Question:
        self._line = b""
        return Question(self._settings, now_ns)

    def _new_sieve(self) -> Sieve:
        period_ns = round(NS_PER_S / self._settings.rate_hz)
        return Sieve(period_ns, round(self._settings.stall_s * NS_PER_S), self._counters)

    def _identified(self, identity: BotaIdentity, now_ns: int) -> list[bytes]:
        self._bias_for(identity, 6, now_ns)
        self._sieve = self._new_sieve()
        self._silent_ns = now_ns + round(self._settings.start_timeout_s * NS_PER_S)
        return [START]

    # ------------------------------------------------------------ samples

    def _take(self, line: bytes, t_ns: int) -> list[Output]:
        """Take one line."""
        said = codec.decode(line)
        if said is None:
            self._counters["malformed"] += 1
        elif isinstance(said, Frame) and self._phase is Phase.RUNNING:
            if self._sieve.take(said, t_ns):
                return self._sample(said, t_ns)
        elif self._phase is not Phase.STARTING or self._dialogue is None or not self._dialogue.feed(line, t_ns):
            self._counters["late"] += 1
        return self._take_outbox() if self._outbox else []

    def _sample(self, frame: Frame, t_ns: int) -> list[Output]:
        self._counters["samples"] += 1
        self._flowing = True
        self._silent_ns = t_ns + round((self._settings.sample_timeout_s + 2.0 / self._settings.rate_hz) * NS_PER_S)
        if frame.celsius is not None:
            self._measured["temperature_k"] = frame.celsius + ZERO_CELSIUS_K
        if frame.status != self._word:
            self._word = frame.status
            self._unusable = "; ".join(status_texts(frame.status & ~THROTTLED))
        if frame.status or self._bias.active or self._restart_id is not None:
            self._beside_sample(frame, t_ns)
        wrench = (*frame.force, *frame.torque)
        fx, fy, fz, tx, ty, tz = [value - off for value, off in zip(wrench, self._off, strict=True)]
        message = WrenchRaw(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._reporter.next_seq("wrench/raw"),
            valid=not self._unusable,
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            status=frame.status,
            saturated=bool(frame.status & OVERRANGE),
            serial_number=self._identity.serial_number if self._identity is not None else "",
            zeroings=self._bias.zeroings,
        )
        return [("wrench/raw", message), *self._take_outbox()] if self._outbox else [("wrench/raw", message)]

    def _beside_sample(self, frame: Frame, t_ns: int) -> None:
        """What is rare: a status bit, the answer to `restart`, zeroing."""
        self._counters["throttled"] += bool(frame.status & THROTTLED)
        self._counters["saturated"] += bool(frame.status & OVERRANGE)
        if self._unusable:
            self._counters["unusable"] += 1
            self._outbox += self._reporter.fault(t_ns, self._unusable, self._unusable, _unusable_todo(frame.status))
            self._outbox += self._bias.give_up("fault", self._unusable)
        self._answer_restart()
        if self._bias.active:
            self._outbox += self._bias.add((*frame.force, *frame.torque))
            self._use_bias()

    def _use_bias(self) -> None:
        """In plain floats: numpy's way to a difference of six numbers is several times as long."""
        self._off = (0.0,) * 6 if self._bias.offset is None else tuple(self._bias.offset.tolist())

    def _gauge_name(self, gauge: int) -> str:
        raise NotImplementedError("its gauges are not watched")

    def _running(self, identity: BotaIdentity, now_ns: int) -> tuple[str, str, str]:
        detail = "; ".join((*status_texts(self._word), identity.described, self._zeroed))
        if self._unusable:
            return "fault", detail, _unusable_todo(self._word)
        return ("degraded", detail, _TODO_THROTTLED) if self._word & THROTTLED else ("ready", detail, "")


def _unusable_todo(word: int) -> str:
    return _TODO_OVERRANGE if word & OVERRANGE else _TODO_STATUS


_TODO_SILENT: Final = "check its power and cable, and interface and address of its transport"
_TODO_OVERRANGE: Final = "take the load off; if it stays, the sensor is overloaded"
_TODO_THROTTLED: Final = "lower the asked rate, or look at what the sensor is connected through"
_TODO_STATUS: Final = "do not use the wrench; see the status word in the sensor's manual"
