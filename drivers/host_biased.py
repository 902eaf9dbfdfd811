"""Zero force/torque sensors whose bias the host subtracts: `zero`, `unzero`, and a bias that outlives a restart."""

from abc import abstractmethod
from typing import Any

from galen_hw.clock import TimeBase
from galen_hw.drivers.device import Output, Wire
from galen_hw.drivers.host_bias import HostBias
from galen_hw.drivers.wrench_sensor import Found, WrenchSensor
from galen_hw.messages import Request


class HostBiasedSensor(WrenchSensor[Wire, Found]):
    """A `WrenchSensor` with a `HostBias`.

    Args:
        bias: of the device; the other arguments are those of `WrenchSensor`.
    """

    def __init__(self, name: str, where: str, time_base: TimeBase, *, bias: HostBias, **sensor: Any) -> None:
        super().__init__(name, where, time_base, zeroing=bias, **sensor)
        self._bias = bias
        self._zeroed_serial = ""

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """Return the bias, of a sensor that has a number; see `Device.snapshot`."""
        serial = "" if self._identity is None else self._identity.serial_number
        values = [] if self._bias.offset is None else self._bias.offset.tolist()
        return self._kept_zero.record(serial, self._bias.zeroings if serial else 0, values, now_ns, seen=self.ready)

    def _zero(self, request: Request, now_ns: int) -> list[Output]:
        self._bias.zero(request, now_ns, ready=self.ready)
        return []

    def _unzero(self, request: Request, now_ns: int) -> list[Output]:
        replies = self._bias.unzero(request)
        self._use_bias()
        return replies

    def _bias_for(self, identity: Found, count: int, now_ns: int) -> None:
        """Keep the bias if the same sensor answers, lose it if another does, take up that of an earlier process.

        Args:
            count: of the values that a bias has.
        """
        serial = identity.serial_number
        if self._bias.offset is not None and serial != self._zeroed_serial:
            self._bias.lose()
            self._gauges.forget()
            what = f"another sensor ({serial or 'of unknown number'}) answers: the zero is lost"
            self._outbox += self._reporter.fault(now_ns, "another sensor", what, "zero the sensor")
        if (kept := self._zero_to_restore(identity, count, now_ns)) is not None:
            self._bias.take_up(kept.values, kept.zeroings)
        self._zeroed_serial = serial
        self._use_bias()

    @abstractmethod
    def _use_bias(self) -> None:
        """Prepare what each sample subtracts, after the bias has changed."""

    @property
    def _zeroed(self) -> str:
        """Return whether it is zeroed and since when, for people."""
        zeroed = "not zeroed" if self._bias.offset is None else "zeroed"
        story = self._kept_zero.story(self._bias.zeroings)
        return f"{zeroed} ({story})" if story else zeroed
