"""One command at a time on a tracker's line: text replies to their CR, binary ones by length, both checked by CRC."""

from collections import Counter
from dataclasses import dataclass
from typing import Final

from galen_hw.drivers.ndi_tracker.codec import (
    HEADER_BYTES,
    START_WORD,
    BadReplyError,
    binary_body,
    binary_size,
    command,
    reply_text,
)

_CR: Final = 0x0D
_MAX_TEXT: Final = 8192


@dataclass(frozen=True, slots=True)
class NdiReply:
    """A whole reply: `text`, or `body` of a binary one; `error` when its CRC or shape is wrong."""

    text: str
    body: bytes
    error: str
    t_ns: int


class NdiLink:
    """The line's state. Time enters with the bytes; deadlines are the caller's to keep."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter(bad_crc=0, foreign=0, drained=0)
        self.reset()

    def reset(self) -> None:
        """Forget what came; the counters stay."""
        self._buffer = bytearray()
        self._first_ns = 0
        self.asked = False
        self.deadline_ns = 0
        self.draining = False

    @property
    def busy(self) -> bool:
        """A reply is awaited, or a drain goes on."""
        return self.asked or self.draining

    def send(self, text: str, now_ns: int, timeout_ns: int) -> bytes:
        """The bytes of a command; its reply is due after `timeout_ns`."""
        self.listen(now_ns, timeout_ns)
        return command(text)

    def listen(self, now_ns: int, timeout_ns: int) -> None:
        """Await a line that comes by itself (RESET)."""
        self.asked, self.deadline_ns, self.draining = True, now_ns + timeout_ns, False

    def drain(self, until_ns: int) -> None:
        """Throw away what comes until then; each arrival calls for a later end (see `feed`)."""
        self.counters["drained"] += len(self._buffer)
        self._buffer.clear()
        self.asked, self.draining, self.deadline_ns = False, True, until_ns

    def feed(self, data: bytes, t_ns: int, quiet_ns: int) -> list[NdiReply]:
        """Take bytes read at `t_ns`; the reply they complete, if one is awaited; a bad one begins a drain."""
        if self.draining:
            self.counters["drained"] += len(data)
            self.deadline_ns = max(self.deadline_ns, t_ns + quiet_ns)
            return []
        if not self._buffer:
            self._first_ns = t_ns
        self._buffer += data
        replies: list[NdiReply] = []
        while self._buffer and self.asked:
            reply = self._take()
            if reply is None:
                return replies
            self.asked = False
            replies.append(reply)
            if reply.error:
                self.drain(t_ns + quiet_ns)
        self.counters["foreign"] += len(self._buffer)
        self._buffer.clear()
        return replies

    def _take(self) -> NdiReply | None:
        """One reply from the buffer, None when more is needed."""
        try:
            if self._buffer[0] == START_WORD[0]:
                return self._take_binary()
            return self._take_text()
        except BadReplyError as error:
            self.counters["bad_crc"] += 1
            return NdiReply("", b"", str(error), self._first_ns)

    def _take_binary(self) -> NdiReply | None:
        if len(self._buffer) < HEADER_BYTES:
            return None
        size = binary_size(bytes(self._buffer[:HEADER_BYTES]))
        if len(self._buffer) < size:
            return None
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        return NdiReply("", binary_body(data), "", self._first_ns)

    def _take_text(self) -> NdiReply | None:
        end = self._buffer.find(_CR)
        if end < 0:
            if len(self._buffer) > _MAX_TEXT:
                raise BadReplyError("a reply without an end")
            return None
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        return NdiReply(reply_text(line), b"", "", self._first_ns)
