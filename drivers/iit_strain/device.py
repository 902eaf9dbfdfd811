"""Read an IIT F/T sensor with a STRAIN or STRAIN2 board, streaming over CAN; sources in `codec.py`.

- A sample is certain if its force and torque are a pair (`drivers/pairing.py`): the protocol numbers nothing.
- It is valid unless a channel of the converter is at its limit: such frames repeat the last good numbers, and have a byte more.
- `zero` is the host's bias, in N and N m. The board has one of its own, which is lost with the power and is not used.
- When the board restarts its stream ends; it is asked and started anew, and the host's zero stays if it is the same sensor.

Positive is what the part on the thin cover's side (+z) does to the other side, as the maker calibrates it: the tool goes there.
"""

from collections.abc import Generator
from typing import Final

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.dialogue import Query
from galen_hw.drivers.host_bias import HostBias
from galen_hw.drivers.host_biased import HostBiasedSensor
from galen_hw.drivers.iit_strain import codec
from galen_hw.drivers.iit_strain.codec import Command
from galen_hw.drivers.iit_strain.start import MS_PER_S, IitStrainIdentity, IitStrainSettings, identify
from galen_hw.drivers.paired_sensor import AXES, PairedSensor, Reading, Traffic, told


class IitStrain(PairedSensor[IitStrainIdentity], HostBiasedSensor[CanFrame, IitStrainIdentity]):
    """Publish `wrench/raw` in the sensor frame about its origin, N and N m, stamped when its torque was read.

    Requests: `zero` {samples}: average and subtract from now on; `unzero`; `restart`.
    """

    Settings = IitStrainSettings

    def __init__(self, name: str, settings: IitStrainSettings, time_base: TimeBase) -> None:
        self._settings = settings
        address, rate_hz = settings.address, MS_PER_S / settings.period_ms
        super().__init__(
            name,
            f"{name} (IIT STRAIN, CAN address {address})",
            time_base,
            settings=settings,
            traffic=Traffic(
                codec.layout(address),
                codec.command_id(address),
                frozenset({codec.answer_id(address)}),
                begin=codec.command(address, Command.SET_TRANSMISSION, codec.TRANSMIT_CALIBRATED),
                end=codec.command(address, Command.SET_TRANSMISSION, codec.TRANSMIT_NOTHING),
            ),
            asked_rate_hz=rate_hz,
            silent_todo=_TODO_SILENT,
            bias=HostBias(name, settings.zero_samples, rate_hz, told),
            zero_kept_s=settings.zero_kept_s,
        )

    def _questions(self, now_ns: int) -> Generator[Query, bytes, IitStrainIdentity]:
        return identify(self._settings)

    def _take_up(self, identity: IitStrainIdentity, now_ns: int) -> list[float]:
        self._bias_for(identity, len(AXES), now_ns)
        return [scale / codec.ZERO for scale in identity.full_scales]

    def _decode(self, pair: bytes) -> Reading:
        half = len(pair) // 2
        force, force_limits = codec.decode_vector(pair[:half])
        torque, torque_limits = codec.decode_vector(pair[half:])
        limited = half == max(codec.LENGTHS)
        return Reading((*force, *torque), torque_limits << 8 | force_limits, limited, limited)

    def _tell_limit(self, status: int, t_ns: int) -> str:
        channels = codec.limited(status & 0xFF) + [f"{3 + int(n[0])}{n[1:]}" for n in codec.limited(status >> 8)]
        what = f"{_LIMIT} (channel {', '.join(channels) or 'not said'})"
        todo = "take the load off; if it stays, the sensor is broken"
        self._outbox += self._reporter.fault(t_ns, "saturated", what, todo)
        return _LIMIT

    def _add_to_zero(self, wrench: tuple[float, ...], t_ns: int) -> None:
        replies = self._bias.add(wrench)
        self._outbox += replies
        if replies:
            self._use_bias()
            self._gauges.learn()

    def _use_bias(self) -> None:
        self._offset = [0.0] * 6 if self._bias.offset is None else self._bias.offset.tolist()

    def _running(self, identity: IitStrainIdentity, now_ns: int) -> tuple[str, str, str]:
        return "ready", f"{identity.described}, {self._zeroed}", ""


_LIMIT: Final = "the converter is at its limit"
_TODO_SILENT: Final = "check its power, CAN wiring and termination, its address and the bit rate (1 Mbit/s)"
