"""When the ATI board is asked for samples, and which frames are one sample.

The board numbers neither requests nor replies. That a pair of frames answers the last request is made certain thus:

- one request is out at a time; its reply is opcode 0, then opcode 1, both of the right length, before the deadline;
- whenever that fails (time-out, a half missing or followed by another, a frame nobody asked for) nothing is asked or
  accepted until a fence has been answered (`dialogue.Fence`): then no older reply can still be on its way;
- a pair equal to the last one bit by bit may be its double: a fence then tells, at the price of one more exchange.

This rests on one thing only: the board answers in order and the wire keeps the order (CAN, slcan, TCP do; udp_multicast
promises nothing). No bound on how late a reply may come is assumed. More requests out at once would be faster on slow
transports, but then one lost frame would shift every later sample by one without a trace: it is not done.
"""

from dataclasses import dataclass
from enum import Enum, auto
from typing import TypeAlias

from galen_hw.drivers.ati_netcanoem.codec import FIRST, SECOND
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.dialogue import Fence
from galen_hw.drivers.reporting import FAR_NS

Pair: TypeAlias = tuple[bytes, bytes, int]
"""Data of the two frames, and when the second was read, ns."""


class Phase(Enum):
    """What is waited for."""

    OFF = auto()
    IDLE = auto()  # the next slot of the schedule
    FIRST = auto()  # opcode 0
    SECOND = auto()  # opcode 1
    FENCE = auto()  # the answer to a fence, everything else is dropped
    REPEAT = auto()  # the answer to a fence, or a second pair before it


@dataclass(slots=True)
class Sampler:
    """The exchange with an identified board.

    Args:
        ask: the sample request.
        fence: see `dialogue.Fence`; `answers`: what the board answers to each of its queries, by opcode.
        period_ns: of the schedule; `timeout_ns`: how long an answer is waited for.
        barren: the board answers fences, and no sample was whole for `silent_ns`.
        silent_ns: the board is taken for gone once it has let answers be waited for so long without a break. Only time
            in which it was listened to counts, `timeout_ns` for each time-out: a program that was itself held up for
            seconds by a busy machine has learnt nothing about the board.
        verify_repeats: hold a repeated pair until it is known not to be a double.
        counters: of the device; counts lost, late, doubled, short, missed, timeouts, repeated.
    """

    ask: CanFrame
    fence: Fence
    answers: dict[int, bytes]
    period_ns: int
    timeout_ns: int
    silent_ns: int
    verify_repeats: bool
    counters: dict[str, int]
    due_ns: int = FAR_NS
    gone: bool = False
    barren: bool = False
    replaced: bool = False
    _phase: Phase = Phase.OFF
    _slot_ns: int = 0
    _first: bytes = b""
    _last: tuple[bytes, bytes] = (b"", b"")
    _held: Pair = (b"", b"", 0)
    _fence_sent: bool = False
    _silent_ns: int = 0
    _lost_ns: int = 0
    _asked_ns: int = 0

    def start(self, now_ns: int) -> None:
        """Begin the schedule now."""
        self._phase, self._slot_ns, self.due_ns = Phase.IDLE, now_ns, now_ns

    def poll(self, now_ns: int) -> list[CanFrame]:
        """What to send now; sets `due_ns`, and `gone` when the board has been silent for too long."""
        if now_ns < self.due_ns or self._phase is Phase.OFF:
            return []
        if self._phase is Phase.IDLE:
            missed = (now_ns - self._slot_ns) // self.period_ns
            self.counters["missed"] += missed  # asking for them now would be a burst
            self._slot_ns += (missed + 1) * self.period_ns
            self._phase, self.due_ns, self._asked_ns = Phase.FIRST, now_ns + self.timeout_ns, now_ns
            return [self.ask]
        if self._fence_sent or self._phase in (Phase.FIRST, Phase.SECOND):
            self._expire(now_ns)
        self._fence_sent, self.due_ns = True, now_ns + self.timeout_ns
        return [] if self.gone else [self.fence.query.request]

    def feed(self, opcode: int, data: bytes, t_ns: int) -> Pair | None:
        """Take a frame of the board that carries data; a sample's pair of frames once it is complete and certain."""
        phase = self._phase
        if opcode == 0 and phase is Phase.FIRST and len(data) == FIRST.size:
            self._first, self._phase = data, Phase.SECOND
            return None
        if opcode == 1 and phase is Phase.SECOND and len(data) == SECOND.size and t_ns <= self.due_ns:
            return self._complete(self._first, data, t_ns)
        if opcode > 1:
            return self._feed_answer(opcode, data, t_ns)
        if len(data) != (FIRST, SECOND)[opcode].size:
            self.counters["short"] += 1
            if phase is not Phase.IDLE:
                self._lose(t_ns)
        elif phase is Phase.REPEAT:
            self._feed_repeat(opcode, data, t_ns)
        elif phase in (Phase.OFF, Phase.FENCE):
            self.counters["late"] += 1
        else:
            self._feed_odd(opcode, data, t_ns)
        return None

    def _complete(self, first: bytes, second: bytes, t_ns: int) -> Pair | None:
        if self.verify_repeats and (first, second) == self._last:
            self.counters["repeated"] += 1
            self._held, self._first = (first, second, t_ns), b""
            self._open_fence(t_ns, Phase.REPEAT)
            return None
        return self._accept((first, second, t_ns))

    def _accept(self, pair: Pair) -> Pair:
        self._last, self._lost_ns, self.barren = pair[:2], 0, False
        self._phase, self.due_ns, self._silent_ns = Phase.IDLE, self._slot_ns, 0
        return pair

    def _feed_odd(self, opcode: int, data: bytes, t_ns: int) -> None:
        """A sample frame out of turn: a double of what was just accepted, or a sign that replies are out of step."""
        in_second = self._phase is Phase.SECOND
        if data == (self._first if in_second and opcode == 0 else self._last[opcode]) and not (
            in_second and opcode == 1
        ):
            self.counters["doubled"] += 1
            return
        if self._phase is Phase.IDLE or opcode == 0 or in_second:
            self.counters["late"] += 1
        self._lose(t_ns)

    def _feed_repeat(self, opcode: int, data: bytes, t_ns: int) -> None:
        """While a repeat is held: a pair before the fence's answer is the reply, and what was held was a double."""
        if opcode == 0 and not self._first:
            self._first = data
        elif opcode == 1 and self._first:
            self._held, self._first = (self._first, data, t_ns), b""
            self.counters["doubled"] += 2
        elif data in (self._first, self._held[opcode]):
            self.counters["doubled"] += 1
        else:
            self._lose(t_ns)

    def _feed_answer(self, opcode: int, data: bytes, t_ns: int) -> Pair | None:
        """The answer to a fence, or one nobody waits for."""
        query = self.fence.query
        if (
            self._phase not in (Phase.FENCE, Phase.REPEAT)
            or not self._fence_sent
            or opcode != query.answer[0].arbitration_id & 0xF
        ):
            self.counters["late"] += 1
            return None
        if len(data) != query.answer[0].length:
            self.counters["short"] += 1
            return None
        self.replaced = data != self.answers[opcode]
        repeat, self._phase = self._phase is Phase.REPEAT, Phase.IDLE
        self.due_ns, self._silent_ns = self._slot_ns, 0
        # What an exchange in vain took, a period at least, and no more than a time-out: a held-up program learns nothing.
        self._lost_ns += max(self.period_ns, min(t_ns - self._asked_ns, self.timeout_ns))
        self.barren = self._lost_ns >= self.silent_ns
        if not repeat or self.replaced:
            return None
        if self._first:  # the second half of the reply is missing
            self.counters["lost"] += 1
            return None
        return self._accept(self._held)

    def _expire(self, now_ns: int) -> None:
        self.counters["timeouts"] += 1
        self._silent_ns += self.timeout_ns
        self.gone = self._silent_ns >= self.silent_ns
        if self._phase in (Phase.FIRST, Phase.SECOND):
            self._lose(now_ns)
        elif self._phase is Phase.REPEAT:
            self._phase = Phase.FENCE
            self.counters["lost"] += 1

    def _lose(self, t_ns: int) -> None:
        """Give the sample that is waited for up, and ask nothing until a fence is answered."""
        if self._phase in (Phase.FIRST, Phase.SECOND, Phase.REPEAT):
            self.counters["lost"] += 1
        if self._phase is Phase.REPEAT:
            self._phase = Phase.FENCE  # its fence serves
        elif self._phase is not Phase.FENCE:
            self._open_fence(t_ns, Phase.FENCE)

    def _open_fence(self, t_ns: int, phase: Phase) -> None:
        self._phase, self._fence_sent, self.due_ns = phase, False, t_ns
        self.fence.next()
