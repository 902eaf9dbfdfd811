"""ROS 1 bags, by rosbags; one without its index (a recording that was cut off) is read chunk by chunk as far as it goes."""

import bz2
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Contents, Head, needed, unreadable
from galen_hw.formats.ros_streams import Topics, long_name, type_definitions

MAGIC: Final = b"#ROSBAG V2.0\n"
_CONNECTION, _MESSAGE, _CHUNK = 7, 2, 5
LARGEST: Final = 256 * 2**20
"""Of one record: what claims more is damage."""


def sniff(head: Head) -> bool:
    """By its first line."""
    return head.data.startswith(MAGIC)


def read(path: Path) -> Contents:
    """The topics.

    Raises:
        UsageError: it cannot be read, or rosbags is not installed.
    """
    try:
        from rosbags.rosbag1 import Reader, ReaderError
    except ImportError as error:
        raise needed("rosbags", "a ROS 1 bag")(error) from None
    try:
        with Reader(path) as reader:
            texts = {c.msgtype: (c.msgdef.data, "ros1msg") for c in reader.connections}
            topics = Topics(type_definitions(texts, ros1=True), cdr=False)
            for connection, log_ns, raw in reader.messages():
                topics.add(connection.topic, connection.msgtype, raw, log_ns)
        return topics.finish()
    except (ReaderError, OSError, ValueError, struct.error, AssertionError) as error:
        why = " ".join(str(error).split())[:100]
    contents = _salvaged(path)
    contents.notes.insert(0, f"it has no whole index ({why}); every whole chunk before the damage was read")
    return contents


def _salvaged(path: Path) -> Contents:
    data = path.read_bytes()
    found: dict[int, tuple[str, str]] = {}
    texts: dict[str, tuple[str, str]] = {}
    messages: list[tuple[int, int, bytes]] = []
    for operation, head, body in _records(data, len(MAGIC)):
        if operation == _CHUNK:
            inner = _unpacked(head.get("compression", b"none"), body)
            for op, h, b in _records(inner, 0):
                _take(op, h, b, found, texts, messages)
        else:
            _take(operation, head, body, found, texts, messages)
    if not messages:
        raise unreadable(path, "no message in it is whole", "rosbag reindex")
    topics = Topics(type_definitions(texts, ros1=True), cdr=False)
    for connection, log_ns, raw in sorted(messages, key=lambda m: m[1]):
        if connection in found:
            topics.add(*found[connection], raw, log_ns)
    return topics.finish()


def _take(
    operation: int,
    head: dict[str, bytes],
    body: bytes,
    found: dict[int, tuple[str, str]],
    texts: dict[str, tuple[str, str]],
    messages: list[tuple[int, int, bytes]],
) -> None:
    if operation == _CONNECTION and len(head.get("conn", b"")) == 4:
        about = dict(_fields(body))
        kind = long_name(about.get("type", b"").decode(errors="replace"))
        found[int.from_bytes(head["conn"], "little")] = head.get("topic", b"").decode(errors="replace"), kind
        texts[kind] = about.get("message_definition", b"").decode(errors="replace"), "ros1msg"
    elif operation == _MESSAGE and len(head.get("time", b"")) == 8 and len(head.get("conn", b"")) == 4:
        seconds, rest = struct.unpack("<II", head["time"])
        messages.append((int.from_bytes(head["conn"], "little"), seconds * NS_PER_S + rest, body))


def _records(data: bytes, place: int) -> Iterator[tuple[int, dict[str, bytes], bytes]]:
    """(operation, header fields, data) of every whole record."""
    while place + 8 <= len(data):
        (size,) = struct.unpack_from("<I", data, place)
        after = place + 4 + size
        if size > LARGEST or after + 4 > len(data):
            return
        head = dict(_fields(data[place + 4 : after]))
        (length,) = struct.unpack_from("<I", data, after)
        end = after + 4 + length
        if length > LARGEST or end > len(data):
            return
        if len(head.get("op", b"")) == 1:
            yield head["op"][0], head, data[after + 4 : end]
        place = end


def _fields(data: bytes) -> Iterator[tuple[str, bytes]]:
    place = 0
    while place + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, place)
        name, equals, value = data[place + 4 : place + 4 + size].partition(b"=")
        if not equals:
            return
        yield name.decode("ascii", "replace"), value
        place += 4 + size


def _unpacked(compression: bytes, data: bytes) -> bytes:
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=LARGEST)
        if compression == b"lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=LARGEST))
    except (OSError, ValueError, RuntimeError):
        return b""
    return data if compression == b"none" else b""
