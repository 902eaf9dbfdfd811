"""Zeroing a Robotous sensor: its own bias command has no response, so the samples after it must show that it took."""

from dataclasses import dataclass, field

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame, Output
from galen_hw.drivers.paired_sensor import told
from galen_hw.drivers.reporting import FAR_NS
from galen_hw.drivers.robotous_rft.codec import Command, command
from galen_hw.drivers.robotous_rft.start import RobotousSettings
from galen_hw.errors import CommandRejectedError, WrongCommandError
from galen_hw.messages import CommandError, Reply, Request

SETTLE_NS = NS_PER_S // 20
"""Samples that were on their way, or in the sensor's filter, when the command was sent."""


@dataclass(slots=True)
class DeviceBias:
    """Carries out `zero` {samples} and `unzero`.

    Args:
        where: the device, for error messages.
        settings: of the device.
        zeroings: which zeroing made the bias that it has, counted from 1; 0: none since its driver knows it.
    """

    where: str
    settings: RobotousSettings
    zeroings: int = 0
    active: bool = False
    deadline_ns: int = FAR_NS
    _request_id: str = ""
    _wanted: int = 0
    _tries: int = 0
    _from_ns: int = 0
    _samples: list[tuple[float, ...]] = field(default_factory=list)
    _done: int = 0

    def zero(self, request: Request, now_ns: int, *, ready: bool) -> list[CanFrame]:
        """What to send; the reply comes from `add`.

        Raises:
            CommandRejectedError: no samples, or already under way. WrongCommandError: wrong arguments.
        """
        samples = request.args.get("samples", self.settings.zero_samples)
        if set(request.args) - {"samples"} or type(samples) is not int or not 1 <= samples <= 1_000_000:
            todo = "zero takes samples, a whole number from 1 to 1000000"
            raise WrongCommandError(f"wrong arguments {request.args}", where=self.where, todo=todo)
        self._refuse(ready=ready)
        self.active, self._request_id, self._wanted, self._tries = True, request.id, samples, 0
        patience_s = 1.0 + self.settings.tries * (0.1 + 2.0 * samples / self.settings.rate_hz)
        self.deadline_ns = now_ns + round(patience_s * NS_PER_S)
        return self._send(now_ns)

    def unzero(self, request: Request, *, ready: bool) -> tuple[list[CanFrame], list[Output]]:
        """What to send, and the reply.

        Raises:
            CommandRejectedError: no samples, or zeroing is under way.
        """
        request.require_only()
        self._refuse(ready=ready)
        self.zeroings = 0
        return [command(self.settings.receiver_id, Command.SET_BIAS, 0)], [Reply(id=request.id)]

    def add(self, wrench: tuple[float, ...], t_ns: int) -> tuple[list[CanFrame], list[Output]]:
        """Take a sample while active: what to send again, and the reply once it is known how it went."""
        if t_ns < self._from_ns:
            return [], []
        self._samples.append(wrench)
        if len(self._samples) < self._wanted:
            return [], []
        samples = np.array(self._samples)
        mean = samples.mean(axis=0)
        force, torque = float(np.linalg.norm(mean[:3])), float(np.linalg.norm(mean[3:]))
        if force <= self.settings.zero_force_n and torque <= self.settings.zero_torque_nm:
            self._done += 1
            self.active, self.zeroings, self.deadline_ns = False, self._done, FAR_NS
            return [], [Reply(id=self._request_id, result=told(samples))]
        if self._tries < self.settings.tries:
            return self._send(t_ns), []
        return [], self.give_up("fault", f"{force:.2f} N and {torque:.3f} N m remain: it is touched, or does not obey")

    def expire(self) -> list[Output]:
        """The samples did not come in time."""
        return self.give_up("timeout", "too few samples came in time")

    def give_up(self, kind: str, what: str) -> list[Output]:
        """End a zeroing that cannot succeed."""
        if not self.active:
            return []
        self.active, self.deadline_ns = False, FAR_NS
        error = CommandError(kind=kind, what=f"not zeroed: {what}", where=self.where, todo="zero it again")
        return [Reply(id=self._request_id, error=error)]

    def _send(self, now_ns: int) -> list[CanFrame]:
        self._tries += 1
        self._samples, self._from_ns = [], now_ns + SETTLE_NS
        return [command(self.settings.receiver_id, Command.SET_BIAS, 1)]

    def _refuse(self, *, ready: bool) -> None:
        if not ready:
            raise CommandRejectedError("the sensor is not ready", where=self.where, todo="wait until its samples flow")
        if self.active:
            raise CommandRejectedError("it is being zeroed", where=self.where, todo="wait for the answer")
