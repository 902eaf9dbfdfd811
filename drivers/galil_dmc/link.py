"""One command at a time on a Galil's line: terminators counted, records by length, echoes and side talk kept apart.

Pure: bytes and times in, answers out. Rules of the line: an answer ends with one `:` or `?` for each `;`-separated
command; nothing is sent before the answer of the previous line is complete; after a time-out the line is drained, so
that no late `:` shifts the answers that follow.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Final

from galen_hw.drivers.galil_dmc.codec import HEADER_BYTES, DataRecord, axis_mask, parse_record, record_size

_TERMINATORS: Final = {ord(":"): False, ord("?"): True}
_LINE_ENDS: Final = frozenset(b"\r\n")
_MAX_TEXT: Final = 4096
_SIDE_TALK: Final = 0x80
_LONGEST_DRAIN: Final = 20


@dataclass(frozen=True, slots=True)
class Exchange:
    """A line to send and the shape of its answer.

    Args:
        line: without the closing CR, at most 80 characters.
        record: axis letters that the binary record in the answer must hold; empty for text.
        answers: terminators of the answer, where that is not one for each command (a download).
    """

    line: str
    record: str = ""
    answers: int = 0

    @property
    def wire(self) -> bytes:
        """The bytes to send."""
        return self.line.encode("ascii") + b"\r"

    @property
    def commands(self) -> list[str]:
        """The commands of the line, each of which answers with a terminator of its own."""
        return self.line.split(";")

    @property
    def terminators(self) -> int:
        """How many `:` or `?` end the answer."""
        return self.answers or len(self.commands)


@dataclass(frozen=True, slots=True)
class Answer:
    """A complete answer.

    Args:
        parts: text of each command, without line ends.
        refused: which of them ended with `?`.
        record: the data record, if one was asked for and came whole.
        sent_ns, t_ns: when the line was sent, when the first byte of the answer was read.
    """

    exchange: Exchange
    parts: tuple[str, ...]
    refused: tuple[bool, ...]
    record: DataRecord | None
    sent_ns: int
    t_ns: int


@dataclass(slots=True)
class _Waiting:
    exchange: Exchange
    sent_ns: int
    deadline_ns: int
    echo: bytes


class GalilLink:
    """The line's state: what is awaited, or a drain in progress.

    Args:
        timeout_ns: longest wait for a complete answer.
        quiet_ns: a drain ends when nothing has come for so long.
    """

    def __init__(self, timeout_ns: int, quiet_ns: int) -> None:
        self._timeout_ns, self._quiet_ns = timeout_ns, quiet_ns
        self.counters: Counter[str] = Counter(short=0, foreign=0, drained=0, refused=0, side_talk=0)
        self.reset()

    def reset(self) -> None:
        """Forget the peer; the counters stay."""
        self._buffer = bytearray()
        self._waiting: _Waiting | None = None
        self._quiet_from_ns: int | None = None
        self._drain_end_ns = 0
        self._parts: list[str] = []
        self._refused: list[bool] = []
        self._text = bytearray()
        self._first_ns = 0
        self._side = bytearray()
        self._said: list[str] = []
        self._broken = False

    @property
    def idle(self) -> bool:
        """A line may be sent."""
        return not self._waiting and self._quiet_from_ns is None

    @property
    def deadline_ns(self) -> int | None:
        """When `expired` or `settled` may change, None while idle."""
        if self._quiet_from_ns is not None:
            return min(self._quiet_from_ns + self._quiet_ns, self._drain_end_ns)
        return self._waiting.deadline_ns if self._waiting else None

    def send(self, exchange: Exchange, now_ns: int) -> bytes:
        """Await the answer to `exchange`; the line must be idle."""
        self._waiting = _Waiting(exchange, now_ns, now_ns + self._timeout_ns, exchange.wire)
        return exchange.wire

    def expired(self, now_ns: int) -> bool:
        """An answer is overdue, or came in a shape that cannot be trusted."""
        return self._broken or bool(self._waiting and now_ns >= self._waiting.deadline_ns)

    def drain(self, now_ns: int) -> bytes:
        """Give up what is awaited; the CR to send for it."""
        self.counters["drained"] += len(self._buffer)
        self._waiting = None
        self._clear_answer()
        self._buffer.clear()
        self._broken = False
        self._quiet_from_ns = now_ns
        self._drain_end_ns = now_ns + _LONGEST_DRAIN * self._quiet_ns
        return b"\r"

    def settled(self, now_ns: int) -> bool:
        """Return whether a drain has ended by `now_ns` (once true, the line is idle); false when there is none.

        A line that never falls quiet is given up after twenty times the quiet.
        """
        if self._quiet_from_ns is None or now_ns < min(self._quiet_from_ns + self._quiet_ns, self._drain_end_ns):
            return False
        self._quiet_from_ns = None
        return True

    def said(self) -> list[str]:
        """Unsolicited lines since the last call."""
        said, self._said = self._said, []
        return said

    def feed(self, data: bytes, t_ns: int) -> list[Answer]:
        """Take bytes read at `t_ns`; the answers that they complete."""
        if self._quiet_from_ns is not None:
            self._quiet_from_ns = max(self._quiet_from_ns, t_ns)
            self.counters["drained"] += len(data)
            return []
        answers: list[Answer] = []
        self._buffer += data
        while self._buffer and not self._broken:
            if self._waiting is None:
                self._stray(self._buffer.pop(0))
                continue
            used = len(self._buffer)
            answer = self._step(self._waiting, t_ns)
            if answer is not None:
                answers.append(answer)
            elif len(self._buffer) == used:
                break
        return answers

    def _step(self, waiting: _Waiting, t_ns: int) -> Answer | None:
        """Use some of the buffer, or nothing when more is needed."""
        if waiting.echo and self._echo(waiting):
            return None
        if waiting.exchange.record:
            return self._record(waiting, t_ns)
        return self._character(waiting, t_ns)

    def _echo(self, waiting: _Waiting) -> bool:
        """Return whether the buffer may (still) be the echo of the line sent; a whole echo is dropped."""
        if self._buffer[0] >= _SIDE_TALK and not waiting.exchange.record:
            self._stray(self._buffer.pop(0))
            return True
        head = bytes(self._buffer[: len(waiting.echo)])
        if head != waiting.echo:
            if not waiting.echo.startswith(head):
                waiting.echo = b""
            return bool(waiting.echo)
        del self._buffer[: len(head)]
        waiting.echo = b""
        return True

    def _character(self, waiting: _Waiting, t_ns: int) -> Answer | None:
        byte = self._buffer.pop(0)
        if byte >= _SIDE_TALK:
            self._stray(byte)
            return None
        if not self._text and not self._parts:
            self._first_ns = t_ns
        if byte not in _TERMINATORS:
            self._text.append(byte)
            self._broken = len(self._text) > _MAX_TEXT
            return None
        self._parts.append(self._text.decode("ascii").strip())
        self._refused.append(_TERMINATORS[byte])
        self.counters["refused"] += _TERMINATORS[byte]
        self._text.clear()
        return self._complete(waiting, None) if len(self._parts) == waiting.exchange.terminators else None

    def _record(self, waiting: _Waiting, t_ns: int) -> Answer | None:
        first = self._buffer[0]
        if first & 0xF8 != 0x80:
            self._before_record(first)
            return self._complete(waiting, None) if self._refused else None
        self._first_ns = self._first_ns or t_ns
        if len(self._buffer) < HEADER_BYTES:
            return None
        size = record_size(bytes(self._buffer[:HEADER_BYTES]))
        wanted = axis_mask(waiting.exchange.record)
        if size is None or self._buffer[1] & wanted != wanted:
            self._stray(self._buffer.pop(0))
            self._first_ns = 0
            return None
        return self._close_record(waiting, size)

    def _before_record(self, byte: int) -> None:
        """What stands where a record should begin: a refusal, unsolicited text, or the rest of something else.

        A `?` amid the rest of something else is not a refusal.
        """
        del self._buffer[0]
        if byte == ord("?") and not self._text:
            self._parts.append("")
            self._refused.append(True)
            self.counters["refused"] += 1
        elif byte not in _LINE_ENDS:
            self._stray(byte)
            if byte < _SIDE_TALK and byte != ord(":"):
                self._text.append(byte)

    def _close_record(self, waiting: _Waiting, size: int) -> Answer | None:
        """The record, if the `:` that proves that no byte was lost follows it; unsolicited text may come first."""
        while len(self._buffer) > size:
            byte = self._buffer.pop(size)
            if byte == ord(":"):
                data = bytes(self._buffer[:size])
                del self._buffer[:size]
                self._parts, self._refused = [""], [False]
                return self._complete(waiting, parse_record(data))
            if byte < _SIDE_TALK:
                self.counters["short"] += 1
                self._broken = True
                return None
            self._stray(byte)
        return None

    def _complete(self, waiting: _Waiting, record: DataRecord | None) -> Answer:
        self._waiting = None
        answer = Answer(
            waiting.exchange, tuple(self._parts), tuple(self._refused), record, waiting.sent_ns, self._first_ns
        )
        self._clear_answer()
        return answer

    def _clear_answer(self) -> None:
        self._parts, self._refused, self._first_ns = [], [], 0
        self._text.clear()

    def _stray(self, byte: int) -> None:
        """A byte that is no part of an answer: unsolicited (MSB set, CW 1) or foreign."""
        if byte < _SIDE_TALK:
            self.counters["foreign"] += 1
            return
        if byte - _SIDE_TALK not in _LINE_ENDS:
            self._side.append(byte - _SIDE_TALK)
        if self._side and (byte - _SIDE_TALK in _LINE_ENDS or len(self._side) >= _MAX_TEXT):
            self.counters["side_talk"] += 1
            self._said.append(self._side.decode("ascii").strip())
            self._side.clear()
