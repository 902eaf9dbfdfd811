"""A socketcand server over TCP, without python-can: a stream of words `< ... >`, however the network cuts it.

Protocol: doc/protocol.md of linux-can/socketcand. python-can's handshake takes whatever one `recv` returns for one
answer, so that a server that already streams (`< ok >< frame ...`) cannot be opened; see findings/.
"""

import os
import re
import select
import socket
import time
from binascii import unhexlify
from typing import Final

from galen_hw.drivers.can_errors import count_error_frame
from galen_hw.drivers.can_wire import CHUNK, CanWire
from galen_hw.drivers.device import CanFrame
from galen_hw.errors import HardwareError

CONNECT_S: Final = 2.0
_LONGEST_WORD: Final = 400
_FRAME: Final = re.compile(rb"<\s*frame\s+([0-9A-Fa-f]{1,8})\s+[0-9]+\.[0-9]+((?:\s*[0-9A-Fa-f]{2})*)\s*>")
_ERROR: Final = re.compile(rb"<\s*error\s+([0-9A-Fa-f]{1,8})\s+[0-9]+\.[0-9]+\s*>")
_STANDARD: Final = 3
"""Digits of an 11-bit identifier; 29 bits have eight."""


class SocketcandWire(CanWire):
    """A connection in raw mode.

    Args:
        channel: name of the bus on the server.
        host, port: of the server.
        counters: see `CanWire`.

    Raises:
        OSError: no connection.
        HardwareError: the server is no socketcand, has no such bus, or does not answer.
    """

    def __init__(self, channel: str, host: str, port: int, counters: dict[str, int]) -> None:
        self._channel, self._where = channel, f"socketcand:{channel} on {host}:{port}"
        self._tcp = socket.create_connection((host, port), CONNECT_S)
        super().__init__(self._tcp.fileno(), counters)
        self._rest = b""
        try:
            self._tune()
            self._shake_hands()
        except BaseException:
            self._tcp.close()
            raise

    def _tune(self) -> None:
        """No waiting for company, and a network that has gone is noticed within seconds."""
        self._tcp.setblocking(False)
        self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._tcp.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in ((socket.TCP_KEEPIDLE, 1), (socket.TCP_KEEPINTVL, 1), (socket.TCP_KEEPCNT, 2)):
            self._tcp.setsockopt(socket.IPPROTO_TCP, option, value)
        self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 2000)

    def _shake_hands(self) -> None:
        deadline = time.monotonic() + CONNECT_S
        self._await(b"hi", "to the connection", deadline)
        for request in (f"< open {self._channel} >", "< rawmode >"):
            self.write(request.encode())
            self._await(b"ok", f"to {request!r}", deadline)
        # Whole frames that came along are from before the wire was open, of no known time: only a begun one is kept.
        self._rest = self._rest.rpartition(b">")[2]

    def _await(self, wanted: bytes, to_what: str, deadline: float) -> None:
        """Read up to an answer; frames of the bus may come before and right behind it."""
        while True:
            word, mark, rest = self._rest.partition(b">")
            if mark:
                self._rest = rest
                kind = word.strip(b" <\r\n").split(b" ", 1)[0]
                if kind == wanted:
                    return
                if kind != b"frame":
                    what = f"answers {(word + mark)[:60].decode('ascii', 'replace').strip()!r} {to_what}"
                    raise HardwareError(what, where=self._where, todo=_todo(kind, self._channel))
            elif len(self._rest) > _LONGEST_WORD or (self._rest.strip() and not self._rest.lstrip().startswith(b"<")):
                what = f"answers {self._rest[:40]!r} {to_what}: no socketcand server"
                raise HardwareError(what, where=self._where, todo="check host and port")
            else:
                self._rest += self._more(to_what, deadline)

    def _more(self, to_what: str, deadline: float) -> bytes:
        if not select.select(self._readers, (), (), max(0.0, deadline - time.monotonic()))[0]:
            what = f"no answer {to_what} within {CONNECT_S:g} s"
            raise HardwareError(what, where=self._where, todo="check host and port, and that the server is not stuck")
        chunk = os.read(self.fd, CHUNK)
        if not chunk:
            what = f"the server closed the connection without an answer {to_what}"
            raise HardwareError(what, where=self._where, todo=f"does it serve {self._channel}, and is it free?")
        return chunk

    def parse(self, chunk: bytes) -> list[CanFrame]:
        """See `CanWire.parse`."""
        *words, rest = (self._rest + chunk).split(b">")
        if len(rest) > _LONGEST_WORD:
            self.counters["malformed"] += 1
            rest = b""
        self._rest = rest
        return [frame for word in words if (frame := self._frame(word.lstrip() + b">")) is not None]

    def _frame(self, word: bytes) -> CanFrame | None:
        found = _FRAME.fullmatch(word)
        if found is None:
            self._count_other(word)
            return None
        identifier, digits = found[1], b"".join(found[2].split())
        if len(identifier) != _STANDARD:
            self.counters["not_data"] += 1
            return None
        if int(identifier, 16) > 0x7FF or len(digits) > 16:
            self.counters["malformed"] += 1
            return None
        return CanFrame(int(identifier, 16), unhexlify(digits))

    def _count_other(self, word: bytes) -> None:
        error = _ERROR.fullmatch(word)
        if error is not None:
            count_error_frame(int(error[1], 16), b"", self.counters)
        elif word.strip(b" <>\r\n") not in (b"ok", b"hi", b"echo"):
            self.counters["malformed"] += 1

    def encode(self, frames: list[CanFrame]) -> bytes:
        """See `CanWire.encode`."""
        words = [f"< send {f.arbitration_id:03X} {len(f.data)} {f.data.hex(' ').upper()} >" for f in frames]
        return "".join(words).encode()

    def close(self) -> None:
        """See `CanWire.close`."""
        self._tcp.close()


def _todo(kind: bytes, channel: str) -> str:
    return f"does the server have a bus {channel}?" if kind == b"error" else "is that a socketcand server?"
