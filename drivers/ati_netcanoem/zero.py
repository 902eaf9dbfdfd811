"""The host's bias of the ATI board, which has no zero of its own: mean gauge counts, subtracted before the matrix."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.ati_netcanoem.codec import ABNORMAL_NOISE_COUNTS, GAUGES, WIRE_ORDER
from galen_hw.drivers.device import Output
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.errors import CommandRejectedError
from galen_hw.messages import CommandError, Reply, Request


@dataclass(slots=True)
class HostBias:
    """Carries out `zero` {samples} and `unzero`; gauges are in the order of the wire.

    Args:
        where: the device, for error messages.
        default_samples: averaged when the request does not say; rate_hz: of the device.
        counts: (6,) what is subtracted, None: nothing; zeroings: which zeroing made it, counted from 1, 0: none.
    """

    where: str
    default_samples: int
    rate_hz: float
    counts: npt.NDArray[np.float64] | None = None
    zeroings: int = 0
    active: bool = False
    deadline_ns: int = FAR_NS
    _request_id: str = ""
    _wanted: int = 0
    _samples: list[tuple[int, ...]] = field(default_factory=list)
    _done: int = 0

    def zero(self, request: Request, now_ns: int, *, ready: bool) -> None:
        """Begin to average.

        Raises:
            CommandRejectedError: wrong arguments, no samples, or already under way.
        """
        samples = request.args.get("samples", self.default_samples)
        if set(request.args) - {"samples"} or type(samples) is not int or not 1 <= samples <= 1_000_000:
            todo = "zero takes samples, a whole number from 1 to 1000000"
            raise CommandRejectedError(f"wrong arguments {request.args}", where=self.where, todo=todo)
        if not ready:
            raise CommandRejectedError("the sensor is not ready", where=self.where, todo="wait until its samples flow")
        self._refuse_if_active()
        self.active, self._request_id, self._wanted, self._samples = True, request.id, samples, []
        # A wire or a computer at a tenth of its pace still gets there: a slow zero is no worse than a quick one.
        self.deadline_ns = now_ns + round((2.0 + 12.0 * samples / self.rate_hz) * NS_PER_S)

    def unzero(self, request: Request) -> list[Output]:
        """Forget the bias.

        Raises:
            CommandRejectedError: zeroing is under way.
        """
        request.require_only()
        self._refuse_if_active()
        self.lose()
        return [Reply(id=request.id)]

    def lose(self) -> None:
        """There is no bias any more: it was given up, or belonged to another sensor."""
        self.counts, self.zeroings = None, 0

    def take_up(self, counts: list[float], zeroings: int) -> None:
        """Go on with the bias of an earlier process."""
        self.counts, self.zeroings = np.array(counts), zeroings
        self._done = max(self._done, zeroings)

    def add(self, gauges: tuple[int, ...]) -> list[Output]:
        """Take a good sample; the reply once there are enough."""
        self._samples.append(gauges)
        if len(self._samples) < self._wanted:
            return []
        counts = np.array(self._samples, dtype=float)
        self.counts = np.asarray(counts.mean(axis=0))
        self._done += 1
        self.zeroings = self._done
        self.active, self.deadline_ns = False, FAR_NS
        return [Reply(id=self._request_id, result=_result(counts))]

    def expire(self) -> list[Output]:
        """The samples did not come in time."""
        return self.give_up("timeout", f"only {len(self._samples)} of {self._wanted} samples came in time")

    def give_up(self, kind: str, what: str) -> list[Output]:
        """End an averaging that cannot succeed; the bias stays what it was."""
        if not self.active:
            return []
        self.active, self.deadline_ns = False, FAR_NS
        error = CommandError(kind=kind, what=f"not zeroed: {what}", where=self.where, todo="zero it again")
        return [Reply(id=self._request_id, error=error)]

    def _refuse_if_active(self) -> None:
        if self.active:
            raise CommandRejectedError("it is being zeroed", where=self.where, todo="wait for the answer")


def _result(counts: npt.NDArray[np.float64]) -> dict[str, Any]:
    """For gauges 0 to 5: bias and scatter, and whether the gauges were as quiet as the manual wants."""
    in_order = counts[:, [WIRE_ORDER.index(gauge) for gauge in range(GAUGES)]]
    spread = np.ptp(in_order, axis=0)
    return {
        "samples": len(in_order),
        "bias_counts": in_order.mean(axis=0).tolist(),
        "std_counts": in_order.std(axis=0).tolist(),
        "peak_to_peak_counts": spread.tolist(),
        "quiet": bool((spread <= ABNORMAL_NOISE_COUNTS).all()),
    }
