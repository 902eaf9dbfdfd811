"""Reading MCAP record by record from the front: a file that was cut off gives every whole chunk that it holds."""

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from math import nan
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Statistics
from mcap.records import Message as Record
from mcap.stream_reader import breakup_chunk

from galen_hw.errors import UsageError
from galen_hw.messages import TOPICS, Message

MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQI")
_CHECKSUM_BYTES: Final = 4


@dataclass(frozen=True, slots=True)
class Logged:
    """One recorded message: its topic, when it was recorded (ns since the epoch), and itself.

    `message` is a struct of the topic table, or a plain value for a channel that is not in it.
    """

    topic: str
    log_ns: int
    message: Any


@dataclass
class McapFile:
    """An MCAP file; iterate over it for its messages in the order in which they were recorded.

    Args:
        path: of the file.
        topics: to read; all if None.

    After iterating, `attachments`, `metadata` and `warnings` are complete.
    """

    path: Path
    topics: frozenset[str] | None = None
    attachments: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _channels: dict[int, tuple[str, Callable[[bytes], Any]]] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Logged]:
        unreadable = 0
        self._read_summary()
        for record in self._records():
            found = self._channels.get(record.channel_id)
            if found is None:
                continue
            try:
                message = found[1](record.data)
            except msgspec.MsgspecError:
                unreadable += 1
                continue
            yield Logged(found[0], record.log_time, message)
        if unreadable:
            self.warnings.append(f"{unreadable} messages could not be read and are left out")

    def read(self) -> list[Logged]:
        """All messages."""
        return list(self)

    def _records(self) -> Iterator[Record]:
        seen = 0
        for opcode, body in self._blocks():
            try:
                inner = self._take(opcode, body)
            except Exception as error:  # noqa: BLE001 - damaged bytes make foreign decoders raise anything
                self.warnings.append(f"a damaged part of {len(body)} bytes is left out ({error})")
                continue
            for record in inner:
                if isinstance(record, Channel):
                    self._add_channel(record)
                elif isinstance(record, Record):
                    seen += 1
                    yield record
                elif isinstance(record, Statistics) and record.message_count != seen:
                    self.warnings.append(f"{seen} messages are there of {record.message_count} that were recorded")

    def _read_summary(self) -> None:
        """Learn the channels from the index at the end, in case the chunk that first names them is damaged."""
        with self._open() as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - _FOOTER.size - len(MAGIC)))
            tail = file.read(_FOOTER.size)
            if len(tail) < _FOOTER.size:
                return
            opcode, _, start, _, checksum = _FOOTER.unpack(tail)
            if opcode != Opcode.FOOTER or not 0 < start < size:
                return
            file.seek(start)
            rest = file.read()
        # Its checksum ends before itself; 0: none was written. A damaged name would make messages of one topic another's.
        if checksum and checksum != crc32(rest[: -len(MAGIC) - _CHECKSUM_BYTES]):
            return
        place = 0
        while place + _HEAD.size <= len(rest):
            opcode, length = _HEAD.unpack_from(rest, place)
            body = rest[place + _HEAD.size : place + _HEAD.size + length]
            if opcode == Opcode.CHANNEL and len(body) == length:
                with suppress(Exception):  # damaged: the chunks may still say it
                    self._add_channel(Channel.read(ReadDataStream(BytesIO(body))))
            place += _HEAD.size + length

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """(opcode, content) of every whole record of the data section."""
        with self._open() as file:
            size = file.seek(0, 2)
            file.seek(0)
            if file.read(8) != MAGIC:
                raise UsageError("not an MCAP file", where=str(self.path), todo="give a recording of galen-hw record")
            place = 8
            while place + 9 <= size:
                opcode, length = _HEAD.unpack(file.read(9))
                if place + 9 + length > size:
                    break
                yield opcode, file.read(length)
                place += 9 + length
                if opcode == Opcode.FOOTER:
                    return
            rest = f"the last {size - place} bytes are not whole" if place < size else "it has no end"
            self.warnings.append(f"cut off: {rest}; all before that was read")

    def _open(self) -> Any:
        try:
            return self.path.open("rb")
        except OSError as error:
            raise UsageError(f"cannot be read ({error.strerror})", where=str(self.path)) from error

    def _take(self, opcode: int, body: bytes) -> list[Any]:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            return breakup_chunk(Chunk.read(stream), validate_crc=True)
        if opcode == Opcode.CHANNEL:
            return [Channel.read(stream)]
        if opcode == Opcode.MESSAGE:
            return [Record.read(stream, len(body))]
        if opcode == Opcode.STATISTICS:
            return [Statistics.read(stream)]
        if opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            self.attachments[attachment.name] = attachment.data.decode()
        if opcode == Opcode.METADATA:
            self.metadata.update(Metadata.read(stream).metadata)
        return []

    def _add_channel(self, channel: Channel) -> None:
        wanted = self.topics is None or channel.topic in self.topics
        if not wanted or channel.id in self._channels:
            return
        decoder = _decoder(channel.topic, channel.message_encoding)
        if decoder is None:
            self.warnings.append(f"channel {channel.topic!r} has encoding {channel.message_encoding!r} and is left out")
            return
        self._channels[channel.id] = (channel.topic, decoder)


def _decoder(topic: str, encoding: str) -> Callable[[bytes], Any] | None:
    kind = TOPICS[topic].message if topic in TOPICS else Any
    if encoding == "msgpack":
        return msgspec.msgpack.Decoder(kind).decode
    return _json_decoder(kind) if encoding == "json" else None


def _json_decoder(kind: type[Message] | Any) -> Callable[[bytes], Any]:
    strict = msgspec.json.Decoder(kind)

    def decode(data: bytes) -> Any:
        try:
            return strict.decode(data)
        except msgspec.ValidationError:
            # JSON has no NaN: it was written as null.
            return msgspec.convert(_nan_for_null(json.loads(data)), kind)

    return decode


def _nan_for_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _nan_for_null(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_nan_for_null(item) for item in value]
    return nan if value is None else value
