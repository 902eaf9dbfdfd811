"""Reading MCAP record by record from the front: a file that was cut off gives every whole chunk that it holds."""

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice
from math import nan
from pathlib import Path
from typing import Any, Final, NoReturn
from zlib import crc32

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
from mcap.records import Message as Record

from galen_hw.documents import load_json
from galen_hw.errors import UsageError
from galen_hw.messages import TOPICS
from galen_hw.recording.mcap_unpack import MAX_RECORD_BYTES, unpacked

MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQI")
_CHECKSUM_BYTES: Final = 4
ENCODINGS: Final = ("json", "msgpack")
SHOWN: Final = 5
"""Topics or reasons that are listed of many."""


@dataclass(frozen=True, slots=True)
class Logged:
    """One recorded message: its topic, when it was recorded (ns since the epoch), and itself.

    `message` is a struct of the topic table, or a plain value for a channel that is not in it.
    """

    topic: str
    log_ns: int
    message: Any


@dataclass(frozen=True, slots=True)
class Held:
    """What the file says of one of its channels: the name of its schema and how its messages are encoded.

    Also its topic, and the schema itself with the language that it is written in.
    """

    schema: str
    encoding: str
    topic: str = ""
    text: bytes = b""
    language: str = ""


@dataclass
class McapFile:
    """An MCAP file; iterate over it for its messages by the time of their record (`log_time`).

    The format promises no order in the file; of equal times the file's own is kept.

    Args:
        path: of the file.
        topics: to read; all if None.
        kinds: structs of topics beside those of the bus.

    After iterating, `attachments`, `metadata`, `warnings`, `profile`, `held` (every channel of the file, by topic) and
    `channels` (the same by number) are complete.
    """

    path: Path
    topics: frozenset[str] | None = None
    kinds: Mapping[str, type[msgspec.Struct]] = field(default_factory=dict)
    attachments: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    held: dict[str, Held] = field(default_factory=dict)
    profile: str = ""
    channels: dict[int, Held] = field(default_factory=dict)
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, tuple[str, Callable[[bytes], Any]]] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Logged]:
        return iter(sorted(self._messages(), key=lambda logged: logged.log_ns))

    def _messages(self) -> Iterator[Logged]:
        """In the order of the file."""
        unreadable = 0
        self._read_summary()
        for record in self._records():
            found = self._channels.get(record.channel_id)
            if found is None:
                continue
            try:
                message = found[1](record.data)
            except (msgspec.MsgspecError, ValueError, RecursionError):
                unreadable += 1
                continue
            yield Logged(found[0], record.log_time, message)
        if unreadable:
            self.warnings.append(f"{unreadable} messages could not be read and are left out")

    def raw(self) -> Iterator[tuple[int, Record]]:
        """Every message of every channel as it is, by the number of its channel, in the order of the file."""
        self._read_summary()
        for record in self._records():
            if record.channel_id in self.channels:
                yield record.channel_id, record

    def read(self) -> list[Logged]:
        """All messages."""
        return list(self)

    def refuse_nothing(self, wanted: str) -> NoReturn:
        """Say that what is wanted is not in the file, and what is there instead; the file has been read.

        Args:
            wanted: a clause, as in "holds no raw wrench".

        Raises:
            UsageError: always.
        """
        foreign = [f"{topic} ({_kind(held)})" for topic, held in self.held.items() if topic not in TOPICS]
        foreign += [f"{t} ({_kind(h)})" for t, h in self.held.items() if t in TOPICS and h.encoding not in ENCODINGS]
        there = f"its topics are {_listed(foreign)}" if foreign else ""
        ros = "ROS 2" if self.profile == "ros2" or any(h.encoding == "cdr" for h in self.held.values()) else ""
        ros = ros or ("ROS 1" if self.profile == "ros1" else "")
        note = f"; {ros} messages are not read" if ros else ""
        reasons = [text for text in self.warnings if not text.startswith("channel ")]
        because = f" ({_listed(reasons)})" if reasons else ""
        todo = "record these topics with galen-hw record"
        if foreign:
            todo = (
                "write them as a table folder (docs/recording.md, Tables) with their own reader, then galen-hw import"
            )
        raise UsageError(": ".join(filter(None, (wanted, there))) + note + because, where=str(self.path), todo=todo)

    def _records(self) -> Iterator[Record]:
        seen = 0
        for opcode, body in self._blocks():
            try:
                inner = self._take(opcode, body)
            except Exception as error:  # noqa: BLE001 - damaged bytes make foreign decoders raise anything
                self.warnings.append(f"a damaged part of {len(body)} bytes is left out ({error})")
                continue
            for record in inner:
                if isinstance(record, Schema):
                    self._schemas[record.id] = record
                elif isinstance(record, Channel):
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
            if size - start > MAX_RECORD_BYTES:
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
            with suppress(Exception):  # damaged: the chunks may still say it
                if opcode == Opcode.SCHEMA and len(body) == length:
                    schema = Schema.read(ReadDataStream(BytesIO(body)))
                    self._schemas[schema.id] = schema
                if opcode == Opcode.CHANNEL and len(body) == length:
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
                place += 9 + length
                if length > MAX_RECORD_BYTES:
                    self.warnings.append(f"a record of {length} bytes is left out; at most {MAX_RECORD_BYTES} are read")
                    file.seek(place)
                    continue
                yield opcode, file.read(length)
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
        if opcode == Opcode.CHUNK:
            return unpacked(body)
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            return [Schema.read(stream)]
        if opcode == Opcode.CHANNEL:
            return [Channel.read(stream)]
        if opcode == Opcode.HEADER:
            self.profile = Header.read(stream).profile
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
        schema = self._schemas.get(channel.schema_id) or Schema(id=0, name="", encoding="", data=b"")
        held = Held(schema.name, channel.message_encoding, channel.topic, schema.data, schema.encoding)
        self.held.setdefault(channel.topic, held)
        self.channels.setdefault(channel.id, held)
        wanted = self.topics is None or channel.topic in self.topics
        if not wanted or channel.id in self._channels:
            return
        kind = self.kinds.get(channel.topic) or (TOPICS[channel.topic].message if channel.topic in TOPICS else Any)
        decoder = _decoder(kind, channel.message_encoding)
        if decoder is None:
            text = f"channel {channel.topic!r} has encoding {channel.message_encoding!r} and is left out"
            self.warnings += [] if text in self.warnings else [text]
            return
        self._channels[channel.id] = (channel.topic, decoder)


def held_in(path: Path) -> dict[str, Held]:
    """The channels of a file by topic, from its index alone; of a file without one, from its first messages.

    Raises:
        UsageError: it cannot be read.
    """
    file = McapFile(path, frozenset())
    file._read_summary()  # noqa: SLF001
    if not file.held:
        for _ in islice(file.raw(), 1000):
            pass
    return file.held


def _kind(held: Held) -> str:
    return ", ".join(filter(None, (held.schema, held.encoding))) or "no type"


def _listed(texts: list[str]) -> str:
    more = f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else ""
    return ", ".join(texts[:SHOWN]) + more


def _decoder(kind: Any, encoding: str) -> Callable[[bytes], Any] | None:
    if encoding == "msgpack":
        return msgspec.msgpack.Decoder(kind).decode
    return _json_decoder(kind) if encoding == "json" else None


def _json_decoder(kind: Any) -> Callable[[bytes], Any]:
    strict = msgspec.json.Decoder(kind)

    def decode(data: bytes) -> Any:
        try:
            return strict.decode(data)
        except msgspec.ValidationError:
            # JSON has no NaN: it was written as null.
            return msgspec.convert(_nan_for_null(load_json(data)), kind)

    return decode


def _nan_for_null(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _nan_for_null(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_nan_for_null(item) for item in value]
    return nan if value is None else value
