"""Repeats the compensation of a recording, sample by sample and bit by bit.

The order in which joint states, samples and changes reached the live service is not that of the recorder's file: they
came from different processes. But every compensated wrench says how old the newest joint state was, and every
`compensation/state` after which sample it holds, so that the order can be restored exactly.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import isnan
from pathlib import Path
from typing import Any, Final

from msgspec.structs import replace
from pydantic import ValidationError

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.config.tool_file import parse_tool
from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot
from galen_hw.messages import CompensationState, JointsState, Message, WrenchCompensated, WrenchRaw, encode
from galen_hw.services.compensation.service import CompensationService
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.service import ServiceContext

TOOL_FILE: Final = "compensation/state: tool_file"
_OF_GEOMETRY: Final = ("joint_offset", "joint_scale", "link_geometry", "sensor_mounting")
MEMORYLESS: Final = frozenset(("bias", "step", "drift", "gain", "cross_talk", "payload", "base_tilt", *_OF_GEOMETRY))
"""Effects that depend on the sample alone; what others add differs once samples before it are missing."""


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

    def skip(self, why: str, samples: int = 1) -> None:
        """Count samples that cannot be compared."""
        self.skipped[why] = self.skipped.get(why, 0) + samples


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
        """As they were when it was recorded; the defaults if it says nothing.

        Raises:
            UsageError: what it says are no settings.
        """
        text = self.states[0].settings if self.states else ""
        try:
            return CompensationSettings.model_validate_json(text) if text else CompensationSettings()
        except ValidationError as error:
            first = error.errors()[0]
            where = f"compensation/state: settings.{'.'.join(map(str, first['loc']))}"
            raise UsageError(str(first["msg"]), where=where, todo="record it again") from None


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
        raw, why = recorded.raw.get(message.t_ns), feeder.prepare(message)
        if missing := feeder.missing:
            verdict.skip("they are missing from the recording", missing)
        if raw is None or why:
            verdict.skip("their raw wrench was not recorded" if raw is None else why)
            feeder.leave_out(message)
            continue
        outputs = service.compensate(raw)
        computed = next(o[1] for o in outputs if isinstance(o, tuple) and o[0] == "wrench/compensated")
        # Which robot it was, the daemon wrote where it was published.
        computed = replace(computed, robot=message.robot, virtual=message.virtual)
        if encode(computed) != encode(message):
            difference = _first_difference(message, computed)
            if feeder.forgot and feeder.remembers and difference.field in ("force", "torque"):
                verdict.skip("the tool's effects remember samples that were not recorded")
                continue
            verdict.compared += 1
            verdict.difference = difference
            return verdict
        verdict.compared += 1
    return verdict


class _Feeder:
    """Gives the service what it had seen when it made a certain message, and knows what the recorder lost on the way.

    Every topic counts its messages: a number that is missing is a message that was lost, not one that came out otherwise.
    """

    def __init__(self, recorded: Recorded, service: CompensationService) -> None:
        self._service = service
        self._joints = sorted({m.t_ns: m for m in recorded.joints}.values(), key=lambda m: m.t_ns)
        self._states = recorded.states
        self._next_joints = self._next_state = 0
        settings = recorded.settings()
        from_start = bool(recorded.states) and recorded.states[0].samples == 0
        self._needed = 0 if from_start or not settings.dynamic else settings.dynamic_window
        self._window = settings.dynamic_window if settings.dynamic else 1
        self._between = settings.alignment == "interpolate"
        self._state_lost = False
        self.missing = 0
        """Samples between the last message and this one of which nothing was recorded."""
        self.remembers = False
        """The tool in hand has effects that remember earlier samples."""
        self.forgot = not from_start
        """The live service has seen samples that this one has not: what effects remember may differ."""

    def prepare(self, message: WrenchCompensated) -> str:
        """Feed what came before it; why it cannot be computed, empty if it can."""
        self._take_states(message)
        if self._next_state == 0:
            return "the compensation's state was not recorded yet"
        self.missing = self._service.pass_over(message.seq)
        if self.missing:
            self.forgot = True
            self._state_lost = self._is_state_lost()
        if self._state_lost:
            return "a change of the compensation may have been lost before it"
        if isnan(message.joints_age_s):
            return "" if self._next_joints == 0 else "joint states are missing"
        if not self._take_joints(message.t_ns, round(message.joints_age_s * NS_PER_S)):
            return "its joint state was not recorded"
        if self._next_joints < self._needed:
            return "joint states before the recording are missing"
        return "joint states before it were not recorded" if self._are_joints_lost() else ""

    def leave_out(self, message: WrenchCompensated) -> None:
        """This message is not computed again."""
        self._service.pass_over(message.seq + 1)
        self.forgot = True

    def _take_states(self, message: WrenchCompensated) -> None:
        while self._next_state < len(self._states) and self._states[self._next_state].samples <= message.seq:
            state = self._states[self._next_state]
            self._service.adopt(state)
            self.remembers = any(t not in MEMORYLESS for t in _effects(state))
            self._next_state, self._state_lost = self._next_state + 1, False

    def _is_state_lost(self) -> bool:
        """Return whether a state may be missing after the last one that was taken: the next one's number tells."""
        if self._next_state == len(self._states):
            return True
        last, following = self._states[self._next_state - 1], self._states[self._next_state]
        return following.seq > last.seq + 1

    def _are_joints_lost(self) -> bool:
        """Return whether one is missing among the last joint states that this sample depends on."""
        newest = self._joints[self._next_joints - 1]
        # Between two of them, and where rates are not measured, it takes the one before.
        two = self._between or any(map(isnan, newest.velocity.values()))
        last = self._joints[: self._next_joints][-max(self._window, 2 if two else 1) :]
        return any(b.seq > a.seq + 1 for a, b in pairwise(last))

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


def _effects(state: CompensationState) -> list[str]:
    """Of the tool's file in hand.

    Raises:
        UsageError: it is none.
    """
    return [term.effect for term in parse_tool(state.tool_file, TOOL_FILE).terms] if state.tool_file else []


def _first_difference(recorded: WrenchCompensated, computed: Message) -> Difference:
    for name in recorded.__struct_fields__:
        was, is_ = getattr(recorded, name), getattr(computed, name)
        if repr(was) != repr(is_):
            return Difference(recorded.t_ns, recorded.seq, name, was, is_)
    return Difference(recorded.t_ns, recorded.seq, "encoding", encode(recorded), encode(computed))
