"""Robotous RFT force/torque sensor, streaming over CAN; RFT series manual, revision 1.7.

Frames are in `robotous_codec`, the questions of the start in `robotous_start`; `robotous_stream` says why no sample is
a wrong one.
"""

from typing import Any, Final

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.drivers.device import CanFrame, Output
from galen_hw.drivers.dialogue import Dialogue, DialogueError
from galen_hw.drivers.pairing import Pairer
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import DATA, OVERLOAD_MASK, Command
from galen_hw.drivers.robotous_rft.start import AXES, RobotousIdentity, RobotousSettings, identify
from galen_hw.drivers.robotous_rft.stream import pairer
from galen_hw.drivers.robotous_rft.zero import DeviceBias
from galen_hw.drivers.wrench_sensor import Phase, WrenchSensor
from galen_hw.errors import CommandRejectedError
from galen_hw.messages import Reply, Request, Vector3, WrenchRaw

COUNTERS: Final = (
    "samples",  # published
    "lost",  # of which a frame is missing
    "timeouts",
    "late",  # frames nobody waited for, or that had piled up
    "doubled",  # frames that came twice
    "short",  # frames of a wrong length
    "foreign",  # frames of another device
    "echoes",  # commands, ours or another host's, shown to us by the wire
    "saturated",  # samples with an axis more than 20 % over its rating
    "restarts",
)


class RobotousRft(WrenchSensor[CanFrame, RobotousIdentity]):
    """Publishes `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its second frame was read.

    Requests: `zero` {samples}: the sensor's own bias, then `samples` samples that must show it; `unzero`; `restart`.
    """

    Settings = RobotousSettings

    def __init__(self, name: str, settings: RobotousSettings, time_base: TimeBase) -> None:
        self._settings = settings
        self._bias = DeviceBias(name, settings)
        ids = f"{settings.receiver_id:#x}, {settings.transmitter1_id:#x}, {settings.transmitter2_id:#x}"
        super().__init__(
            name,
            f"{name} (Robotous RFT, CAN ids {ids})",
            time_base,
            asked_rate_hz=float(settings.rate_hz),
            retry_s=settings.retry_s,
            counters=COUNTERS,
            silent_todo=_TODO_SILENT,
            zeroing=self._bias,
            zero_kept_s=0.0,
        )
        self._wires: list[CanFrame] = []
        self._silent_ns, self._lost_before = FAR_NS, 0
        self._pairer = self._new_pairer()
        self._newton = self._newton_metre = 0.0

    # ------------------------------------------------------------ the interface of every device

    def poll(self, now_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """The conversation of the start, a stream that went silent, and the status once a second."""
        wires, self._wires = self._wires, []
        if self._phase is Phase.RUNNING and now_ns >= self._silent_ns:
            self._counters["timeouts"] += 1
            halves = self._counters["lost"] - self._lost_before > 1
            what = "no whole samples come: one of their two frames is missing" if halves else "no samples come"
            self._fail(now_ns, DialogueError(what, ""))
        elif self._phase in (Phase.STARTING, Phase.FAILED):
            wires += self._converse(now_ns)
        if now_ns >= self._bias.deadline_ns:
            self._outbox += self._bias.give_up("timeout", "too few samples came in time")
        if now_ns >= self._reporter.status_due_ns:
            self._outbox.append(self._report(now_ns))
        return wires, self._take_outbox()

    def feed(self, wire: CanFrame, t_ns: int) -> list[Output]:
        """Take one frame; a sample comes out with the second frame of its pair."""
        if wire.arbitration_id == self._settings.transmitter2_id:
            response = self._pairer.second(wire.data, t_ns) if self._running_or_late(wire, t_ns) else None
            if response is not None:
                return self._sample(response, t_ns)
        elif wire.arbitration_id == self._settings.transmitter1_id:
            if self._running_or_late(wire, t_ns):
                self._pairer.first(wire.data, t_ns)
        elif wire.arbitration_id == self._settings.receiver_id:
            self._counters["echoes"] += 1
        else:
            self._counters["foreign"] += 1
        return self._take_outbox() if self._outbox else []

    def request(self, request: Request, now_ns: int) -> list[Output]:
        """`zero` {samples}, `unzero`, `restart`; see `Device.request`."""
        if request.name == "zero":
            self._wires += self._bias.zero(request, now_ns, ready=self.ready)
            return []
        if request.name == "unzero":
            wires, replies = self._bias.unzero(request, ready=self.ready)
            self._wires += wires
            return replies
        if request.name == "restart":
            return self._restart(request, now_ns)
        todo = "it knows zero, unzero, restart"
        raise CommandRejectedError(f"unknown request {request.name!r}", where=self.name, todo=todo)

    def stop(self, now_ns: int) -> list[CanFrame]:
        """End the stream."""
        was_on, self._wires = self._phase is not Phase.OFF, []
        self._switch_off()
        return [codec.command(self._settings.receiver_id, Command.STOP_OUTPUT)] if was_on else []

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """That it was zeroed, to say that it is not known any more: the bias is the sensor's own, and has no read-out."""
        serial = "" if self._identity is None else self._identity.serial_number
        return self._kept_zero.record(serial, self._bias.zeroings, [], now_ns, seen=self.ready)

    def restore(self, state: dict[str, Any], obstacle: str) -> None:
        """See `Device.restore`: never used, since a sensor that was off meanwhile looks the same."""
        unknown = "the sensor holds it and cannot be asked whether it still does"
        super().restore(state, obstacle or unknown)

    @property
    def wakeup_ns(self) -> int:
        """When `poll` wants to be called next."""
        if self._wires:
            return 0
        due = self._silent_ns if self._phase is Phase.RUNNING else self._start_due_ns
        return min(due, self._reporter.status_due_ns, self._bias.deadline_ns)

    # ------------------------------------------------------------ start

    def _new_pairer(self) -> Pairer:
        period_ns = NS_PER_S // self._settings.rate_hz
        window_ns = min(round(self._settings.pair_window_s * NS_PER_S), period_ns // 2)
        return pairer(period_ns, window_ns, round(self._settings.stall_s * NS_PER_S), self._counters)

    def _new_dialogue(self, now_ns: int) -> Dialogue[RobotousIdentity]:
        if self._bias.zeroings:
            self._bias.zeroings = 0
            self._outbox += self._reporter.fault(now_ns, "zero", "the sensor's zero is lost", "zero the sensor again")
        timeout_ns = round(self._settings.reply_timeout_s * NS_PER_S)
        return Dialogue(identify(self._settings), timeout_ns, self._settings.tries, due_ns=now_ns)

    def _identified(self, identity: RobotousIdentity, now_ns: int) -> list[CanFrame]:
        self._zero_to_restore(identity, 0, now_ns)
        self._newton, self._newton_metre = identity.newton, identity.newton_metre
        self._pairer = self._new_pairer()
        self._silent_ns, self._lost_before = now_ns + self._patience_ns, self._counters["lost"]
        return [codec.command(self._settings.receiver_id, Command.START_OUTPUT)]

    @property
    def _patience_ns(self) -> int:
        return round((self._settings.sample_timeout_s + 2.0 / self._settings.rate_hz) * NS_PER_S)

    def _running_or_late(self, wire: CanFrame, t_ns: int) -> bool:
        """True when the frame is the stream's business; else it is the start's, or nobody's."""
        if self._phase is Phase.RUNNING:
            return True
        if self._phase is Phase.STARTING and self._dialogue is not None and self._dialogue.feed(wire, t_ns):
            return False
        self._counters["short" if len(wire.data) != codec.LENGTH else "late"] += 1
        return False

    # ------------------------------------------------------------ samples

    def _sample(self, response: bytes, t_ns: int) -> list[Output]:
        *axes, flags = DATA.unpack(response)
        overloaded = bool(flags & OVERLOAD_MASK)
        newton, newton_metre = self._newton, self._newton_metre
        fx, fy, fz = axes[0] * newton, axes[1] * newton, axes[2] * newton
        tx, ty, tz = axes[3] * newton_metre, axes[4] * newton_metre, axes[5] * newton_metre
        self._counters["samples"] += 1
        self._lost_before = self._counters["lost"]
        self._flowing, self._silent_ns = True, t_ns + self._patience_ns
        if self._gauges.take(tuple(axes)):
            self._judge_gauges(t_ns)
        if overloaded or self._bias.active or self._restart_id is not None:
            self._beside_sample(flags, (fx, fy, fz, tx, ty, tz), t_ns)
        message = WrenchRaw(
            timestamp=self._time_base.timestamp(t_ns),
            t_ns=t_ns,
            seq=self._reporter.next_seq("wrench/raw"),
            valid=not overloaded and not self._broken,
            source=self.name,
            force=Vector3(fx, fy, fz),
            torque=Vector3(tx, ty, tz),
            status=flags,
            saturated=overloaded,
            serial_number=self._identity.serial_number if self._identity is not None else "",
            zeroings=self._bias.zeroings,
        )
        return [("wrench/raw", message), *self._take_outbox()] if self._outbox else [("wrench/raw", message)]

    def _beside_sample(self, flags: int, wrench: tuple[float, ...], t_ns: int) -> None:
        """What is rare: overload, the answer to `restart`, zeroing."""
        if flags & OVERLOAD_MASK:
            self._counters["saturated"] += 1
            what = f"overload in {', '.join(codec.overloaded_axes(flags))} (more than 20 % over the rating)"
            self._outbox += self._reporter.fault(t_ns, "overload", what, "take the load off")
        self._answer_restart()
        if self._bias.active and flags & OVERLOAD_MASK:
            self._outbox += self._bias.give_up("fault", "an axis is overloaded")
        elif self._bias.active:
            wires, replies = self._bias.add(wrench, t_ns)
            self._wires += wires
            self._outbox += replies
            if any(isinstance(reply, Reply) and reply.error is None for reply in replies):
                self._gauges.learn()

    def _gauge_name(self, gauge: int) -> str:
        return f"axis {AXES[gauge]}"

    def _running(self, identity: RobotousIdentity, now_ns: int) -> tuple[str, str]:
        del now_ns
        return "ready", f"{identity.described}, {'zeroed' if self._bias.zeroings else 'not zeroed'}"


_TODO_SILENT: Final = "check its power, CAN wiring and termination, identifiers and the bit rate (1 Mbit/s)"
