"""MCAP of any program: ROS 2 (CDR), ROS 1, JSON and Protobuf messages, by the time of their record.

Read from the front, record by record, so that a file that was cut off gives every whole chunk.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Contents, Head, Stream, needed
from galen_hw.formats.ros_streams import Topics, long_name, type_definitions
from galen_hw.recording.info import INFO, URDF
from galen_hw.recording.mcap_reader import MAGIC, Held, McapFile

MOST_ELEMENTS = 64


def sniff(head: Head) -> bool:
    """By its signature."""
    return head.data.startswith(MAGIC)


def read(path: Path) -> Contents:
    """The topics.

    Raises:
        UsageError: it cannot be read, or a package that its messages need is not installed.
    """
    file = McapFile(path)
    raw = file.raw()
    ros = {e: Topics({}, cdr=e == "cdr") for e in ("cdr", "ros1")}
    objects: dict[str, _Objects] = {}
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    ready: set[str] = set()
    for channel, record in raw:
        held = file.channels[channel]
        if held.encoding in ros:
            if held.encoding not in ready:
                ready.add(held.encoding)
                ros[held.encoding] = Topics(_types(file, held.encoding), cdr=held.encoding == "cdr")
            ros[held.encoding].add(held.topic, long_name(held.schema), record.data, record.log_time)
            continue
        if channel not in decoders:
            decoders[channel] = _decoder(held)
        decode = decoders[channel]
        stream = objects.setdefault(held.topic, _Objects(held.topic, held.schema))
        stream.add(decode, record.data, record.log_time)
    # Channels that the recorder's own reader leaves out are read here.
    contents = Contents(notes=[text for text in file.warnings if not text.startswith("channel ")])
    for encoding in ready:
        found = ros[encoding].finish()
        contents.streams += found.streams
        contents.passed += found.passed
        contents.notes += found.notes
        contents.texts |= found.texts
    for one in objects.values():
        one.finish(contents)
    texts = {name: text for name, text in file.metadata.items() if name in (INFO, URDF) and text} | file.attachments
    contents.texts |= {n: t for n, t in texts.items() if n.endswith((".urdf", INFO))}
    return contents


def _types(file: McapFile, encoding: str) -> dict[str, Any]:
    schemas = [h for h in file.channels.values() if h.encoding == encoding]
    texts = {long_name(h.schema): (h.text.decode("utf-8", "replace"), h.language) for h in schemas}
    return type_definitions(texts, ros1=encoding == "ros1")


def _decoder(held: Held) -> Callable[[bytes], Any] | None:
    if held.encoding == "json":
        return json.loads
    if held.encoding == "msgpack":
        import msgspec

        return msgspec.msgpack.decode
    if held.encoding == "protobuf":
        return _protobuf(held)
    return None


def _protobuf(held: Held) -> Callable[[bytes], Any] | None:
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    except ImportError as error:
        raise needed("protobuf", "an MCAP file with Protobuf messages")(error) from None
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(held.text)
        pool = descriptor_pool.DescriptorPool()
        for one in files.file:
            pool.Add(one)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(held.schema))
    except Exception:  # noqa: BLE001 - a schema of anybody's
        return None

    def decode(data: bytes) -> Any:
        return _plain(kind.FromString(data))

    return decode


def _plain(message: Any) -> dict[str, Any]:
    """Every field by name, those at their default too: a coordinate of 0 is not written on the wire.

    An optional number that was not set is none: nobody has measured it.
    """
    out: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not field.message_type and not message.HasField(field.name):
            continue
        value = getattr(message, field.name)
        if field.is_repeated:
            out[field.name] = [_plain(v) if field.message_type else v for v in value]
        elif field.message_type:
            out[field.name] = _plain(value)
        else:
            out[field.name] = value
    return out


class _Objects:
    """Messages that decode to mappings, as columns."""

    def __init__(self, topic: str, kind: str) -> None:
        self._topic, self._kind = topic, kind
        self._rows: list[dict[str, float]] = []
        self._logged: list[int] = []
        self._lost: dict[str, int] = {}

    def add(self, decode: Callable[[bytes], Any] | None, data: bytes, log_ns: int) -> None:
        """Take one message."""
        try:
            if decode is None:
                raise ValueError("its encoding is not known")  # noqa: TRY301
            row: dict[str, float] = {}
            _flatten("", decode(data), row)
        except Exception as error:  # noqa: BLE001 - decoders of foreign bytes raise anything
            why = str(error) if decode is None else "it cannot be decoded"
            self._lost[why] = self._lost.get(why, 0) + 1
            return
        self._rows.append(row)
        self._logged.append(log_ns)

    def finish(self, contents: Contents) -> None:
        """Add the stream, or the line that says why there is none."""
        names = list(dict.fromkeys(name for row in self._rows for name in row))
        title = f"{self._topic} ({self._kind})" if self._kind else self._topic
        if not names:
            lost = "; ".join(f"{count} cannot be read: {why}" for why, count in self._lost.items())
            contents.passed.append(f"{title}: {lost or f'{len(self._rows)} messages without numbers, not taken'}")
            return
        order = np.argsort(np.array(self._logged, dtype=np.int64), kind="stable")
        logged = np.array(self._logged, dtype=np.int64)[order]
        columns = {n: np.array([row.get(n, np.nan) for row in self._rows], dtype=float)[order] for n in names}
        stamps = _stamps(columns)
        headed = stamps is not None and bool(np.any(stamps))
        clock = stamps if headed and stamps is not None else logged
        origin = int(clock[0])
        numbers = {
            n: v for n, v in columns.items() if n.split(".")[-1] not in ("sec", "nsec", "nanosec", "seconds", "nanos")
        }
        late = (logged - origin) / NS_PER_S if headed else None
        stream = Stream(self._topic, numbers, self._kind, (clock - origin) / NS_PER_S, origin, late, lost=self._lost)
        if self._kind == "foxglove.FrameTransform":
            stream.hints = {f"rotation.{a}": f"sensor.orientation.{a}" for a in "xyzw"}
            stream.columns = {name: values for name, values in numbers.items() if name in stream.hints}
        contents.streams.append(stream)


def _flatten(place: str, value: Any, row: dict[str, float]) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{place}.{key}" if place else str(key), inner, row)
    elif isinstance(value, list):
        if len(value) <= MOST_ELEMENTS:
            for i, inner in enumerate(value):
                name = inner.get("name") if isinstance(inner, dict) else None
                _flatten(f"{place}[{name or i}]", inner, row)
    elif isinstance(value, bool | int | float):
        row[place] = float(value)
    elif value is None:
        row[place] = np.nan


def _stamps(columns: dict[str, Any]) -> "np.ndarray[Any, np.dtype[np.int64]] | None":
    """Stamps within the messages, ns: as ROS writes them, or Foxglove's timestamp."""
    for head in ("header.stamp", "timestamp", "stamp"):
        for seconds, rest in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
            found = columns.get(f"{head}.{seconds}"), columns.get(f"{head}.{rest}")
            if found[0] is not None and found[1] is not None and not np.isnan(found[0]).any():
                return np.asarray(found[0].astype(np.int64) * NS_PER_S + np.nan_to_num(found[1]).astype(np.int64))
    return None
