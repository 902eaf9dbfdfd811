"""Decodes what comes in on a socket, whoever sent it: one place, with bounds, and one error for all that can be wrong.

A frame may be of any size, nested to any depth and hold any bytes. The decoder of msgspec answers some of that with
exceptions of Python's own (`UnicodeDecodeError`, `RecursionError`); none of them may reach a loop.
"""

from typing import Any, Final, Generic, TypeVar

import msgspec
import zmq

from galen_hw.errors import GalenError
from galen_hw.messages import TOPICS, CommandError, Message, Reply, Request

PROTOCOL_VERSION: Final = 1
LARGEST_REQUEST: Final = 1 << 16
"""Bytes of a request; a larger one is refused in words."""
LARGEST_MESSAGE: Final = 1 << 22
"""Bytes of anything else, and of a request's frame: ZeroMQ closes the connection of who sends more."""
DEEPEST: Final = 16
"""Maps and lists within each other in a request's arguments and in a reply's result."""
LONGEST_NAME: Final = 64
"""Letters of a target and of a command: a suggestion is sought for what is unknown, at a cost that grows with both."""

_T = TypeVar("_T")


class UnreadableError(GalenError):
    """A frame that is not what its socket takes; `what` says why."""


class Reader(Generic[_T]):
    """Reads frames of one kind.

    Args:
        kind: the struct that a frame holds, as a msgpack map.
    """

    def __init__(self, kind: type[_T]) -> None:
        self._decoder = msgspec.msgpack.Decoder(kind)

    def __call__(self, frame: bytes, largest: int = LARGEST_MESSAGE) -> _T:
        """What a frame of at most `largest` bytes holds.

        Raises:
            UnreadableError: it does not hold that.
        """
        if len(frame) > largest:
            raise UnreadableError(f"{len(frame)} bytes are more than {largest}")
        try:
            return self._decoder.decode(frame)
        except RecursionError:
            why = "nested too deep"
        except (ValueError, TypeError, ArithmeticError, MemoryError) as error:  # msgspec.DecodeError is a ValueError
            # UnicodeDecodeError before msgspec 0.23, which has a DecodeError of its own words for it.
            why = "text that is not UTF-8" if "utf-8" in str(error).lower() else str(error)
        raise UnreadableError(why)


class _Id(msgspec.Struct):
    id: str = ""


_REQUEST: Final = Reader(Request)
_REPLY: Final = Reader(Reply)
_ID: Final = Reader(_Id)
_MESSAGES: Final = {name: Reader(topic.message) for name, topic in TOPICS.items()}
_BATCH: Final = Reader(list[tuple[bytes, bytes]])
_BY_BYTES: Final = {name.encode(): (name, reader) for name, reader in _MESSAGES.items()}


def limit(socket: "zmq.Socket[Any]", largest: int = LARGEST_MESSAGE) -> None:
    """Have ZeroMQ close the connection of a peer that announces a larger frame, before it is stored."""
    socket.setsockopt(zmq.MAXMSGSIZE, largest)


def decode_message(topic: bytes, payload: bytes) -> tuple[str, Message]:
    """Topic and message of a publication.

    Raises:
        UnreadableError: no topic of the table, or not that topic's message.
    """
    row = _BY_BYTES.get(topic)
    if row is None:
        raise UnreadableError("no topic of the table", where=topic[:LONGEST_NAME].decode(errors="replace"))
    return row[0], row[1](payload)


def decode_batch(payload: bytes) -> list[tuple[bytes, bytes]]:
    """Topics and payloads of a batch (see `Batcher`), in the order in which they were published.

    Raises:
        UnreadableError: it is no batch.
    """
    return _BATCH(payload)


def decode_request(payload: bytes, largest: int = LARGEST_REQUEST) -> Request | CommandError:
    """A request, or why it is none: not a map of this protocol, too large or too deep, or another version of it."""
    todo = "send a msgpack map: id, target, name, args"
    try:
        request = _REQUEST(payload, largest)
        _require_plain(request.args, 0)
    except UnreadableError as error:
        return CommandError(kind="invalid", what=f"not a request ({error.what})", todo=todo)
    if request.version != PROTOCOL_VERSION:
        what = f"protocol version {request.version}, this daemon speaks {PROTOCOL_VERSION}"
        return CommandError(kind="invalid", what=what, todo="use the same version on both ends")
    if max(len(request.target), len(request.name)) > LONGEST_NAME:
        what = f"target or name is longer than {LONGEST_NAME} letters"
        return CommandError(kind="invalid", what=what, todo="see galen-hw command daemon info")
    return request


def id_of(payload: bytes) -> str:
    """The id of what is no request otherwise, so that its sender knows the answer; empty if that cannot be read either."""
    try:
        return _ID(payload).id[:LONGEST_NAME]
    except UnreadableError:
        return ""


def decode_reply(payload: bytes) -> Reply:
    """A reply.

    Raises:
        UnreadableError: it is none.
    """
    reply = _REPLY(payload)
    _require_plain(reply.result, 0)
    return reply


def _require_plain(value: object, depth: int) -> None:
    """Refuse what is nested too deep to be passed on, and what no command takes (binary, extension types).

    Raises:
        UnreadableError: it is such a thing.
    """
    if value is None or isinstance(value, str | int | float):
        return
    if depth >= DEEPEST:
        raise UnreadableError(f"nested deeper than {DEEPEST}")
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        for inner in value.values():
            _require_plain(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _require_plain(inner, depth + 1)
    else:
        raise UnreadableError(f"{type(value).__name__} where numbers, text, lists and maps are taken")
