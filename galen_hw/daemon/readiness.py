"""When the daemon may say that it is ready, and when it must say why it cannot be: a judgement without I/O or clock."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from galen_hw.daemon.links import DeviceState

INTERPRETERS_WITHIN_S: Final = 60.0
SILENT: Final = DeviceState(wire="closed", ready=False, optional=False)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known: `ready`; or `refused`, with the devices that are to blame (none: no samples flow)."""

    ready: bool = False
    refused: bool = False
    devices: Mapping[str, DeviceState] = field(default_factory=dict)


WAIT: Final = Verdict()


@dataclass(slots=True)
class Readiness:
    """Ready means: every process runs, every required device answers, samples flow, and what is optional has spoken.

    An optional device never keeps the robot from starting, but "ready" waits `optional_wait_s` for it, so that a tracker
    that is there is there from the first sample on and not at some time later.

    Args:
        optional: whether the device is optional, by name.
        start_timeout_s: the devices' time, from when all processes run (an interpreter's start is no fault of theirs).
        optional_wait_s: the optional devices' time, from when all else is in order.
        begun_s: when the daemon was started, on the clock that `judge` is told.
    """

    optional: Mapping[str, bool]
    start_timeout_s: float
    optional_wait_s: float
    begun_s: float
    _all_up_s: float | None = None
    _complete_s: float | None = None

    def judge(self, now_s: float, states: Mapping[str, DeviceState], *, all_up: bool, flows: bool) -> Verdict:
        """The verdict now.

        Args:
            states: of the devices that are known yet; all_up: every process has spoken; flows: samples flow.
        """
        if all_up and self._all_up_s is None:
            self._all_up_s = now_s
        required = {n: states.get(n, SILENT) for n, optional in self.optional.items() if not optional}
        if all(s.attempts and s.wire != "opening" for s in required.values()):
            failed = {n: s for n, s in required.items() if s.wire == "failed"}
            if failed:
                return Verdict(refused=True, devices=failed)
        if all_up and flows and all(s.ready for s in required.values()):
            self._complete_s = now_s if self._complete_s is None else self._complete_s
            spoken = all(_spoken(states.get(n)) for n, optional in self.optional.items() if optional)
            return Verdict(ready=True) if spoken or now_s - self._complete_s > self.optional_wait_s else WAIT
        self._complete_s = None
        since = self.begun_s + INTERPRETERS_WITHIN_S if self._all_up_s is None else self._all_up_s
        if now_s - since > self.start_timeout_s:
            return Verdict(refused=True, devices={n: s for n, s in required.items() if not s.ready})
        return WAIT


def waits_for(states: Mapping[str, DeviceState], missing: Sequence[str], *, flows: bool) -> str:
    """Return what a start still waits for, in words.

    Args:
        states: of all devices; missing: processes that have not spoken; flows: samples flow.
    """
    if missing:
        of = "process" if len(missing) == 1 else "processes"
        return f"{of} {', '.join(missing)} to start"
    silent = [f"{n}{' (optional)' if s.optional else ''}" for n, s in states.items() if not s.ready]
    return f"an answer of {', '.join(silent)}" if silent else "samples to flow" if not flows else ""


def _spoken(state: DeviceState | None) -> bool:
    """An optional device that is ready, or of which it is known that it is not going to be."""
    return state is not None and (state.ready or state.wire == "failed" or state.problem is not None)
