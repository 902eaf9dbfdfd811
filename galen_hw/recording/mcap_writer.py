"""Writing MCAP: every channel with a JSON schema, whole chunks on the disk at each flush.

Messages are JSON by default: of the encodings that keep every bit of a number it is the one that Foxglove, Lichtblick
and PlotJuggler all open (PlotJuggler passes over channels without a schema, Foxglove does not read msgpack). NaN is
written as null.
"""

import json
import os
from contextlib import suppress
from typing import IO, Any, Final, Literal

import msgspec
from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from galen_hw.messages import TOPICS, Message, encode
from galen_hw.version import VERSION

LIBRARY: Final = f"galen-hw {VERSION}"
CHUNK_BYTES: Final = 256 * 1024
METADATA: Final = "galen-hw"
Encoding = Literal["json", "msgpack"]


class McapWriter:
    """An MCAP file that is being written.

    Args:
        stream: where to, binary; it stays open at the end.
        encoding: of the messages.
        metadata: known from the start (software is added).
    """

    def __init__(
        self, stream: IO[bytes], *, encoding: Encoding = "json", metadata: dict[str, str] | None = None
    ) -> None:
        self._stream, self._encoding = stream, encoding
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=LIBRARY)
        self._whole_bytes = 0
        self._channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}
        self.metadata({"software": LIBRARY} | (metadata or {}))

    def message(self, topic: str, message: Message, log_ns: int) -> None:
        """Add a message of the topic table; `log_ns` is when it was recorded, ns since the epoch."""
        if topic not in self._channels:
            kind = TOPICS[topic].message
            self._channel(topic, kind.__name__, message_schema(kind), self._encoding)
        data = json_bytes(message) if self._encoding == "json" else encode(message)
        self._add(topic, data, (log_ns, round(message.timestamp * 1e9)), message.seq)

    def record(self, topic: str, schema: dict[str, Any], value: dict[str, Any], log_ns: int, sequence: int) -> None:
        """Add a message of a channel of its own; always JSON."""
        if topic not in self._channels:
            self._channel(topic, topic, schema, "json")
        self._add(topic, msgspec.json.encode(value), (log_ns, log_ns), sequence)

    def attach(self, name: str, text: str, log_ns: int = 0, media_type: str = "application/json") -> None:
        """Attach a file."""
        self._writer.add_attachment(log_ns, log_ns, name, media_type, text.encode())

    def metadata(self, values: dict[str, str]) -> None:
        """Add to what is known about the whole file; a reader takes the last value of each key."""
        self._writer.add_metadata(METADATA, values)

    def flush(self) -> None:
        """Put everything so far on the disk as whole chunks."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        try:
            descriptor = self._stream.fileno()
        except OSError:
            return  # a stream in memory
        os.fsync(descriptor)
        self._whole_bytes = self._stream.tell()

    def abandon(self) -> None:
        """End a file on the disk that cannot be written any further, at the last `flush`; the stream is closed.

        What the disk took of later chunks is taken back, which makes room for the end mark; without that too the file
        is one that was cut off, and every reader that reads from the front has all of it.
        """
        builder = RecordBuilder()
        DataEnd(data_section_crc=0).write(builder)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
        end: bytes = builder.end()  # type: ignore[no-untyped-call]
        descriptor = self._stream.fileno()
        with suppress(OSError):
            os.ftruncate(descriptor, self._whole_bytes)
            if self._whole_bytes:
                os.pwrite(descriptor, end + MCAP0_MAGIC, self._whole_bytes)
            os.fsync(descriptor)
        # Closed below its buffer, whose rest must not come after the end.
        getattr(self._stream, "raw", self._stream).close()

    def finish(self) -> None:
        """Write the index; nothing can be added afterwards."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()

    def _channel(self, topic: str, name: str, schema: dict[str, Any], encoding: str) -> None:
        schema_id = self._writer.register_schema(f"galen_hw.{name}", "jsonschema", json.dumps(schema).encode())
        self._channels[topic] = self._writer.register_channel(topic, encoding, schema_id)
        self.counts[topic] = 0

    def _add(self, topic: str, data: bytes, times_ns: tuple[int, int], sequence: int) -> None:
        """Add a message with its log and publish times."""
        log_ns, publish_ns = (max(0, t) for t in times_ns)
        self._writer.add_message(self._channels[topic], log_ns, data, publish_ns, sequence & 0xFFFFFFFF)
        self.counts[topic] += 1


_JSON: Final = msgspec.json.Encoder()


def json_bytes(message: Message) -> bytes:
    """JSON text of a message; NaN and infinities are null."""
    return _JSON.encode(message)


def message_schema(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """JSON schema of a struct, an object at the top with nothing referred to: viewers differ in what they resolve."""
    (schema,), parts = msgspec.json.schema_components([kind])
    inlined: dict[str, Any] = _inline(schema, parts)
    return inlined


def _inline(node: Any, parts: dict[str, Any]) -> Any:
    if isinstance(node, list):
        return [_inline(item, parts) for item in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _inline(parts[node["$ref"].rsplit("/", 1)[-1]], parts)
    return {key: _inline(value, parts) for key, value in node.items()}
