"""Repeats the compensation of a recording, sample by sample and bit by bit.

The order in which joint states, samples and changes reached the live service is not that of the recorder's file: they
came from different processes. But every compensated wrench says how old the newest joint state was, and every
`compensation/state` after which sample it holds, so that the order can be restored exactly.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import Any

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.kinematics import Robot
from galen_hw.messages import CompensationState, JointsState, Message, WrenchCompensated, WrenchRaw, encode
from galen_hw.services.compensation.service import CompensationService
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.service import ServiceContext


@dataclass(frozen=True, slots=True)
class Difference:
    """The first thing that came out otherwise: which sample, which field, and both values."""

    t_ns: int
    seq: int
    field: str
    recorded: Any
    computed: Any

    def __str__(self) -> str:
        return f"sample {self.seq} (t_ns {self.t_ns}): {self.field} was {self.recorded!r}, is {self.computed!r}"


@dataclass
class Verdict:
    """How a recording compares with its repetition.

    Args:
        compared: samples that were computed again; difference: the first that came out otherwise.
        skipped: samples that cannot be compared, by reason.
    """

    compared: int = 0
    difference: Difference | None = None
    skipped: dict[str, int] = field(default_factory=dict)

    def skip(self, why: str) -> None:
        """Count a sample that cannot be compared."""
        self.skipped[why] = self.skipped.get(why, 0) + 1


class Recorded:
    """What a replay needs of a recording, sorted by kind.

    Args:
        messages: (topic, message) in the order of the file.
    """

    def __init__(self, messages: Iterable[tuple[str, Message]]) -> None:
        self.raw: dict[int, WrenchRaw] = {}
        self.joints: list[JointsState] = []
        self.states: list[CompensationState] = []
        self.compensated: list[WrenchCompensated] = []
        for topic, message in messages:
            if isinstance(message, WrenchRaw):
                self.raw[message.t_ns] = message
            elif isinstance(message, JointsState):
                self.joints.append(message)
            elif isinstance(message, CompensationState):
                self.states.append(message)
            elif isinstance(message, WrenchCompensated) and topic == "wrench/compensated":
                self.compensated.append(message)

    def settings(self) -> CompensationSettings:
        """As they were when it was recorded; the defaults if it says nothing."""
        text = self.states[0].settings if self.states else ""
        return CompensationSettings.model_validate_json(text) if text else CompensationSettings()


def service_for(recorded: Recorded, robot: Robot, nowhere: Path, *, name: str = "compensation") -> CompensationService:
    """A compensation as it was then; `nowhere` is a directory without tools."""
    source = recorded.states[0].source if recorded.states else name
    return CompensationService(source, recorded.settings(), ServiceContext(robot, TimeBase(), nowhere))


def again(recorded: Recorded, service: CompensationService) -> Iterator[WrenchCompensated]:
    """Compensate every raw sample with the service as it stands, in the order of time (for another tool or a table)."""
    joints = iter(sorted(recorded.joints, key=lambda m: m.t_ns))
    waiting = next(joints, None)
    for t_ns, raw in sorted(recorded.raw.items()):
        while waiting is not None and waiting.t_ns <= t_ns:
            service.handle("joints/state", waiting, t_ns)
            waiting = next(joints, None)
        for output in service.compensate(raw):
            if isinstance(output, tuple) and output[0] == "wrench/compensated":
                assert isinstance(output[1], WrenchCompensated)
                yield output[1]


def verify(recorded: Recorded, service: CompensationService) -> Verdict:
    """Compute every compensated wrench again and compare all of it, up to the first difference."""
    verdict = Verdict()
    feeder = _Feeder(recorded, service)
    for message in recorded.compensated:
        raw = recorded.raw.get(message.t_ns)
        why = "its raw wrench was not recorded" if raw is None else feeder.prepare(message)
        if raw is None or why:
            verdict.skip(why)
            service.pass_over(1)
            continue
        outputs = service.compensate(raw)
        computed = next(o[1] for o in outputs if isinstance(o, tuple) and o[0] == "wrench/compensated")
        verdict.compared += 1
        if encode(computed) != encode(message):
            verdict.difference = _first_difference(message, computed)
            return verdict
    return verdict


class _Feeder:
    """Gives the service what it had seen when it made a certain message."""

    def __init__(self, recorded: Recorded, service: CompensationService) -> None:
        self._service = service
        self._joints = sorted({m.t_ns: m for m in recorded.joints}.values(), key=lambda m: m.t_ns)
        self._states = recorded.states
        self._next_joints = self._next_state = 0
        settings = recorded.settings()
        from_start = bool(recorded.states) and recorded.states[0].samples == 0
        self._needed = 0 if from_start or not settings.dynamic else settings.dynamic_window
        self._last_ns: int | None = None

    def prepare(self, message: WrenchCompensated) -> str:
        """Feed what came before it; why it cannot be computed, empty if it can."""
        self._take_states(message)
        if self._next_state == 0:
            return "the compensation's state was not recorded yet"
        if isnan(message.joints_age_s):
            return "" if self._next_joints == 0 else "joint states are missing"
        if not self._take_joints(message.t_ns, round(message.joints_age_s * NS_PER_S)):
            return "its joint state was not recorded"
        return "" if self._next_joints >= self._needed else "joint states before the recording are missing"

    def _take_states(self, message: WrenchCompensated) -> None:
        while self._next_state < len(self._states) and self._states[self._next_state].samples <= message.seq:
            self._service.adopt(self._states[self._next_state])
            self._next_state += 1

    def _take_joints(self, t_ns: int, age_ns: int) -> bool:
        newest = t_ns - age_ns
        while self._next_joints < len(self._joints):
            following = self._joints[self._next_joints]
            reached = self._next_joints > 0 and self._joints[self._next_joints - 1].t_ns >= t_ns
            if following.t_ns > newest and (age_ns > 0 or reached):
                break
            self._service.handle("joints/state", following, following.t_ns)
            self._next_joints += 1
        last = self._joints[self._next_joints - 1].t_ns if self._next_joints else None
        return last is not None and (last == newest if age_ns > 0 else last >= t_ns)


def _first_difference(recorded: WrenchCompensated, computed: Message) -> Difference:
    for name in recorded.__struct_fields__:
        was, is_ = getattr(recorded, name), getattr(computed, name)
        if repr(was) != repr(is_):
            return Difference(recorded.t_ns, recorded.seq, name, was, is_)
    return Difference(recorded.t_ns, recorded.seq, "encoding", encode(recorded), encode(computed))
