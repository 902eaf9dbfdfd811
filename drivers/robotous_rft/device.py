"""Read a Robotous RFT force/torque sensor, streaming over CAN; RFT series manual, revision 1.7.

Frames are in `codec.py`, the questions of the start in `start.py`; `drivers/pairing.py` says why no sample is a wrong one. The
zero is the sensor's own (`zero.py`).
"""

from collections.abc import Generator
from typing import Any, Final

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import Output
from galen_hw.drivers.dialogue import Query
from galen_hw.drivers.paired_sensor import PairedSensor, Reading, Traffic
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import OVERLOAD_MASK, Command
from galen_hw.drivers.robotous_rft.start import RobotousIdentity, RobotousSettings, identify
from galen_hw.drivers.robotous_rft.zero import DeviceBias
from galen_hw.messages import Reply, Request


class RobotousRft(PairedSensor[RobotousIdentity]):
    """Publish `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its second frame was read.

    Requests: `zero` {samples}: the sensor's own bias, then `samples` samples that must show it; `unzero`; `restart`.
    """

    Settings = RobotousSettings

    def __init__(self, name: str, settings: RobotousSettings, time_base: TimeBase) -> None:
        self._settings = settings
        self._bias = DeviceBias(name, settings)
        receiver, first, second = settings.receiver_id, settings.transmitter1_id, settings.transmitter2_id
        super().__init__(
            name,
            f"{name} (Robotous RFT, CAN ids {receiver:#x}, {first:#x}, {second:#x})",
            time_base,
            settings=settings,
            traffic=Traffic(
                codec.layout(first, second),
                receiver,
                frozenset(),
                begin=codec.command(receiver, Command.START_OUTPUT),
                end=codec.command(receiver, Command.STOP_OUTPUT),
            ),
            asked_rate_hz=float(settings.rate_hz),
            silent_todo=_TODO_SILENT,
            zeroing=self._bias,
            zero_kept_s=0.0,
        )

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """That it was zeroed, to say that it is not known any more: the bias is the sensor's own, and has no read-out."""
        serial = "" if self._identity is None else self._identity.serial_number
        return self._kept_zero.record(serial, self._bias.zeroings, [], now_ns, seen=self.ready)

    def restore(self, state: dict[str, Any], obstacle: str) -> None:
        """See `Device.restore`: never used, since a sensor that was off meanwhile looks the same."""
        unknown = "the sensor holds it and cannot be asked whether it still does"
        super().restore(state, obstacle or unknown)

    def _zero(self, request: Request, now_ns: int) -> list[Output]:
        self._wires += self._bias.zero(request, now_ns, ready=self.ready)
        return []

    def _unzero(self, request: Request, now_ns: int) -> list[Output]:
        wires, replies = self._bias.unzero(request, ready=self.ready)
        self._wires += wires
        return replies

    def _questions(self, now_ns: int) -> Generator[Query, bytes, RobotousIdentity]:
        if self._bias.zeroings:
            self._bias.zeroings = 0
            self._outbox += self._reporter.fault(now_ns, "zero", "the sensor's zero is lost", "zero the sensor again")
        return identify(self._settings)

    def _take_up(self, identity: RobotousIdentity, now_ns: int) -> list[float]:
        self._zero_to_restore(identity, 0, now_ns)
        return [identity.newton] * 3 + [identity.newton_metre] * 3

    def _decode(self, pair: bytes) -> Reading:
        axes, flags = codec.decode_data(pair)
        return Reading(axes, flags, saturated=bool(flags & OVERLOAD_MASK))

    def _tell_limit(self, status: int, t_ns: int) -> str:
        what = f"overload in {', '.join(codec.overloaded_axes(status))} (more than 20 % over the rating)"
        self._outbox += self._reporter.fault(t_ns, "overload", what, "take the load off")
        return "an axis is overloaded"

    def _add_to_zero(self, wrench: tuple[float, ...], t_ns: int) -> None:
        wires, replies = self._bias.add(wrench, t_ns)
        self._wires += wires
        self._outbox += replies
        if any(isinstance(reply, Reply) and reply.error is None for reply in replies):
            self._gauges.learn()

    def _running(self, identity: RobotousIdentity, now_ns: int) -> tuple[str, str, str]:
        return "ready", f"{identity.described}, {'zeroed' if self._bias.zeroings else 'not zeroed'}", ""


_TODO_SILENT: Final = "check its power, CAN wiring and termination, identifiers and the bit rate (1 Mbit/s)"
