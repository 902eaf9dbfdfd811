"""A small socketcand server for one virtual node: raw mode, one client at a time, on the loopback interface.

Protocol: `doc/protocol.md` of linux-can/socketcand. A frame without data needs two spaces before `>`, or python-can
loses it. TCP is a stream: an answer and what the node sends at once leave in one segment, as a busy server's do.
"""

import re
import select
import socket
import time
from typing import Final

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ports import Port, VirtualCanDevice
from galen_hw.errors import HardwareError

_LONGEST: Final = 200
_ANSWERS: Final = {"open": "< ok >", "rawmode": "< ok >", "echo": "< echo >"}
_SEND: Final = re.compile(r"send ([0-7][0-9A-Fa-f]{2}) ([0-8])((?: [0-9A-Fa-f]{1,2}){0,8})")


class SocketcandPort(Port):
    """The server.

    Args:
        channel: "PORT" or "HOST:PORT"; port 0 or nothing takes a free one.
        device: the node.

    Raises:
        HardwareError: the port is taken.
    """

    def __init__(self, channel: str, device: VirtualCanDevice) -> None:
        host, _, port = channel.rpartition(":")
        host = host or "127.0.0.1"
        self._device = device
        try:
            self._listener = socket.create_server((host, int(port or 0)), backlog=1)
        except (OSError, ValueError, OverflowError) as error:
            raise HardwareError(
                f"cannot listen ({error})", where=f"socketcand {channel}", todo="another port"
            ) from error
        self._listener.setblocking(False)
        self._epoll = select.epoll()
        self._epoll.register(self._listener, select.EPOLLIN)
        self._client: socket.socket | None = None
        self._buffer, self._raw, self._out = "", False, ""
        self._counters = {"clients": 0, "frames_in": 0, "frames_out": 0, "refused": 0}
        number = int(self._listener.getsockname()[1])
        self.address = {"interface": "socketcand", "host": host, "port": number, "channel": "can0"}

    def fileno(self) -> int:
        """An epoll descriptor over listener and client."""
        return self._epoll.fileno()

    @property
    def wakeup_ns(self) -> int:
        """The device's."""
        return self._device.wakeup_ns

    @property
    def counters(self) -> dict[str, int]:
        """Clients, frames each way, words that were not understood."""
        return self._counters

    def read(self, now_ns: int) -> None:
        """New clients, their words, and the answers."""
        for descriptor, _ in self._epoll.poll(0):
            if descriptor == self._listener.fileno():
                self._accept()
            else:
                self._receive(now_ns)
        self.write(now_ns)

    def write(self, now_ns: int) -> None:
        """What the node sends; to nobody if nobody listens."""
        frames = self._device.poll(now_ns)
        if frames and self._raw:
            self._counters["frames_out"] += len(frames)
            stamp = f"{time.time():.6f}"
            self._out += "".join(f"< frame {f.arbitration_id:03X} {stamp} {f.data.hex().upper()} >" for f in frames)
        self._flush()

    def close(self) -> None:
        """Close client and listener."""
        self._drop()
        self._epoll.close()
        self._listener.close()

    def _accept(self) -> None:
        self._drop()  # The newest client is served; an old one that broke off need not be noticed first.
        self._client, _ = self._listener.accept()
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client.setblocking(False)
        self._epoll.register(self._client, select.EPOLLIN)
        self._counters["clients"] += 1
        self._out = "< hi >"

    def _drop(self) -> None:
        if self._client is not None:
            self._epoll.unregister(self._client)
            self._client.close()
        self._client, self._buffer, self._raw, self._out = None, "", False, ""

    def _receive(self, now_ns: int) -> None:
        assert self._client is not None
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop()
            return
        *words, self._buffer = (self._buffer + data.decode("ascii", "replace")).split(">")
        self._buffer = self._buffer[-_LONGEST:]
        for word in words:
            self._obey(" ".join(word.strip(" <").split()), now_ns)

    def _obey(self, word: str, now_ns: int) -> None:
        kind = word.partition(" ")[0]
        answer = _ANSWERS.get(kind)
        if answer is not None:
            self._raw = self._raw or kind == "rawmode"
            self._out += answer
            return
        found = _SEND.fullmatch(word)
        data = bytes(int(digits, 16) for digits in found[3].split()) if found else b""
        if found is None or len(data) != int(found[2]):
            self._counters["refused"] += 1
            return
        self._counters["frames_in"] += 1
        self._device.feed(CanFrame(int(found[1], 16), data), now_ns)

    def _flush(self) -> None:
        text, self._out = self._out, ""
        if self._client is None or not text:
            return
        try:
            self._client.sendall(text.encode("ascii"))
        except OSError:  # Gone, or it does not read: its connection ends.
            self._drop()
