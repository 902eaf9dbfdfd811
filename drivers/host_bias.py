"""The host's bias of a sensor that has no zero of its own, or none that can be used while it streams: a mean, subtracted."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import Output
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import CommandError, Reply, Request

Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(slots=True)
class HostBias:
    """Carries out `zero` {samples} and `unzero`.

    Args:
        where: the device, for error messages.
        default_samples: averaged when the request does not say; rate_hz: of the device.
        told: what the reply tells of the samples (n, 6) that were averaged.
        offset: (6,) what is subtracted, None: nothing; zeroings: which zeroing made it, counted from 1, 0: none.
    """

    where: str
    default_samples: int
    rate_hz: float
    told: Callable[[Floats], dict[str, Any]]
    offset: Floats | None = None
    zeroings: int = 0
    active: bool = False
    deadline_ns: int = FAR_NS
    _request_id: str = ""
    _wanted: int = 0
    _samples: list[tuple[float, ...]] = field(default_factory=list)
    _done: int = 0

    def zero(self, request: Request, now_ns: int, *, ready: bool) -> None:
        """Begin to average.

        Raises:
            CommandRejectedError: no samples, or already under way. WrongCommandError: wrong arguments.
        """
        samples = request.args.get("samples", self.default_samples)
        if set(request.args) - {"samples"} or type(samples) is not int or not 1 <= samples <= 1_000_000:
            todo = "zero takes samples, a whole number from 1 to 1000000"
            raise WrongCommandError(f"wrong arguments {request.args}", where=self.where, todo=todo)
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
        self.offset, self.zeroings = None, 0

    def take_up(self, offset: list[float], zeroings: int) -> None:
        """Go on with the bias of an earlier process."""
        self.offset, self.zeroings = np.array(offset), zeroings
        self._done = max(self._done, zeroings)

    def add(self, sample: tuple[float, ...]) -> list[Output]:
        """Take a good sample (6,); the reply once there are enough."""
        self._samples.append(sample)
        if len(self._samples) < self._wanted:
            return []
        samples = np.array(self._samples, dtype=float)
        self.offset = np.asarray(samples.mean(axis=0))
        self._done += 1
        self.zeroings = self._done
        self.active, self.deadline_ns = False, FAR_NS
        return [Reply(id=self._request_id, result=self.told(samples))]

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
