"""A start-up conversation with a CAN device, written as a generator: yield a question, get the bytes of its answer.

    def identify() -> Generator[Query, bytes, Identity]:
        firmware = decode_firmware((yield Query("the firmware version", request, (Expect(0x20F, 4),))))

`Dialogue` asks, waits, asks again and gives up; it has no clock of its own. What makes repeating safe where replies
carry no number is the fence (see `Fence`).
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from galen_hw.drivers.device import CanFrame

Result = TypeVar("Result")


class DialogueError(Exception):
    """The device answered something that cannot be used, or nothing: what, and what to do about it."""

    def __init__(self, what: str, todo: str) -> None:
        super().__init__(what, todo)
        self.what, self.todo = what, todo


@dataclass(frozen=True, slots=True)
class Expect:
    """One frame of an answer: its identifier, its length, and how its data begin."""

    arbitration_id: int
    length: int
    prefix: bytes = b""

    def fits(self, frame: CanFrame) -> bool:
        """Return whether `frame` can be this frame."""
        return (
            frame.arbitration_id == self.arbitration_id
            and len(frame.data) == self.length
            and frame.data.startswith(self.prefix)
        )


@dataclass(frozen=True, slots=True)
class Query:
    """One question.

    Args:
        name: for people: "it did not answer to NAME".
        request: the frame that asks.
        answer: the frames of the answer, in order; empty when there is none.
        wait_ns: after an unanswered request, the time to leave it in peace.
        numbered: the answer tells itself from that of another query; otherwise a repeat needs a fence.
        unlike: an answer equal to this is taken for a doubled earlier one, until a fence has shown that it is not.
    """

    name: str
    request: CanFrame
    answer: tuple[Expect, ...] = ()
    wait_ns: int = 0
    numbered: bool = True
    unlike: bytes = b""


@dataclass(slots=True)
class Fence:
    """Proves that no answer to an earlier request is still under way, without sequence numbers or a time limit.

    A device answers in the order it is asked and the wire keeps that order, so the answer to a fence comes after every
    answer to what was sent before it. Two kinds of fence take turns: a late answer to the last one cannot pass for this
    one's, and this one's answer proves that none of the last kind is left. Repeating a fence within its turn is safe.
    """

    queries: tuple[Query, Query]
    _turn: int = 0

    def next(self) -> Query:
        """The query of a new turn."""
        self._turn ^= 1
        return self.queries[self._turn]

    @property
    def query(self) -> Query:
        """The query of this turn."""
        return self.queries[self._turn]


@dataclass(slots=True)
class Dialogue(Generic[Result]):
    """Drives a conversation.

    Args:
        conversation: the generator; its return value becomes `result`.
        timeout_ns: how long to wait for an answer.
        tries: how often a question is asked before `failure` is set.
        fence: see there; needed when a query is not `numbered`.
    """

    conversation: Generator[Query, bytes, Result]
    timeout_ns: int
    tries: int
    fence: Fence | None = None
    result: Result | None = None
    failure: DialogueError | None = None
    due_ns: int = 0
    timeouts: int = 0
    _query: Query | None = None
    _fencing: Query | None = None
    _asked: int = 0
    _sent: bool = False
    _answer: list[CanFrame] = field(default_factory=list)

    def poll(self, now_ns: int) -> list[CanFrame]:
        """What to send now; sets `due_ns`. Once `result` or `failure` is set (by this or `feed`) it is over."""
        if self._query is None and self.result is None and self.failure is None:
            self._step(None)
        if self._query is None or now_ns < self.due_ns:
            return []
        if self._sent:
            self._expire()
        return self._ask(now_ns)

    def feed(self, frame: CanFrame, t_ns: int) -> bool:
        """Take a frame; false when it is no part of the answer that is waited for."""
        asking = self._fencing or self._query
        if asking is None or not self._sent:
            return False
        place = len(self._answer)
        if place < len(asking.answer) and asking.answer[place].fits(frame):
            self._answer.append(frame)
            if len(self._answer) == len(asking.answer):
                self._answered(t_ns)
            return True
        if any(expect.arbitration_id == frame.arbitration_id for expect in asking.answer):
            if frame not in self._answer and place:
                self.due_ns = t_ns  # a frame of the answer is missing: no use in waiting for the rest
            return frame in self._answer
        return False

    def _answered(self, t_ns: int) -> None:
        data = b"".join(frame.data for frame in self._answer)
        self._answer = []
        if self._fencing is None and self._query is not None and self._asked == 1 and data == self._query.unlike:
            return
        self._sent, self.due_ns = False, t_ns
        if self._fencing is not None:
            self._fencing = None
            return
        self._step(data)

    def _step(self, data: bytes | None) -> None:
        self._asked, self._sent, self._query = 0, False, None
        try:
            self._query = next(self.conversation) if data is None else self.conversation.send(data)
        except StopIteration as end:
            self.result = end.value
        except DialogueError as error:
            self.failure = error

    def _expire(self) -> None:
        """After the wait: go on after a request without an answer; repeat one whose answer is missing, or give up."""
        assert self._query is not None
        if not (self._fencing or self._query).answer:
            self._step(b"")
            return
        self.timeouts += 1
        if self._asked >= self.tries:
            self.failure = DialogueError(f"no answer to {self._query.name}, asked {self.tries} times", "")
            self._query = None
        elif self._fencing is None and not self._query.numbered and self.fence is not None:
            self._fencing = self.fence.next()

    def _ask(self, now_ns: int) -> list[CanFrame]:
        query = self._fencing or self._query
        if query is None or self.failure is not None:
            return []
        self._asked, self._sent, self._answer = self._asked + 1, True, []
        self.due_ns = now_ns + (self.timeout_ns if query.answer else query.wait_ns)
        return [query.request]
