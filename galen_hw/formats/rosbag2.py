"""ROS 2 bags: a folder with MCAP or sqlite3 files, with or without its metadata.yaml, compressed or not, or one such file.

rosbags reads what its metadata describes. A bag whose metadata is missing or wrong is read file by file: nothing but the
metadata is then lost, and that is said.
"""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from galen_hw.formats import mcap_any
from galen_hw.formats.contents import Contents, Head, needed, unreadable
from galen_hw.formats.ros_streams import Topics, long_name, type_definitions
from galen_hw.recording.info import INFO

SQLITE: Final = b"SQLite format 3\0"
FILES: Final = ("*.db3", "*.mcap")
Message = tuple[str, str, int, bytes]


def sniff(head: Head) -> bool:
    """A folder with storage files or a metadata.yaml, or a sqlite3 file with the tables of a bag."""
    if head.path.is_dir():
        return (head.path / "metadata.yaml").is_file() or any(next(head.path.glob(p), None) for p in FILES)
    return head.data.startswith(SQLITE) and b"topics" in head.data and b"messages" in head.data


def read(path: Path) -> Contents:
    """The topics.

    Raises:
        UsageError: it cannot be read, or rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import Reader, ReaderError
    except ImportError as error:
        raise needed("rosbags", "a ROS 2 bag")(error) from None
    notes: list[str] = []
    if path.is_dir():
        try:
            with Reader(path) as reader:
                return _by_rosbags(reader)
        except (ReaderError, OSError) as error:
            notes.append(f"its metadata.yaml is of no use ({_short(error)}); its files are read one by one")
        except Exception as error:  # noqa: BLE001 - damaged storage makes the reader raise anything
            notes.append(f"not whole ({_short(error)}); its files are read one by one as far as they go")
    files = sorted(f for p in FILES for f in path.glob(p)) if path.is_dir() else [path]
    if not files:
        raise unreadable(
            path, notes[-1] if notes else "there is no storage file", "its .db3 or .mcap files are missing"
        )
    contents = merged([_one_file(file) for file in files])
    contents.notes = [*notes, *contents.notes]
    return contents


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120]


def _by_rosbags(reader: Any) -> Contents:
    texts = {
        c.msgtype: (c.msgdef.data, "ros2idl" if "IDL" in c.msgdef.format.name else "ros2msg")
        for c in reader.connections
        if c.msgdef.data
    }
    topics = Topics(type_definitions(texts), cdr=True)
    kinds = {c.id: (c.topic, c.msgtype) for c in reader.connections}
    count = 0
    for connection, log_ns, raw in reader.messages():
        topic, kind = kinds[connection.id]
        topics.add(topic, kind, raw, log_ns)
        count += 1
    contents = topics.finish()
    if text := (reader.storage.metadata.custom or {}).get(INFO):
        contents.texts[INFO] = text
    if count != reader.message_count:
        contents.notes.append(f"{count} messages are there of {reader.message_count} that its metadata counts")
    return contents


def _one_file(file: Path) -> Contents:
    if file.suffix == ".mcap":
        return mcap_any.read(file)
    notes: list[str] = []
    try:
        with sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True) as database:
            topics = Topics(type_definitions(_definitions(database)), cdr=True)
            for topic, kind, log_ns, raw in _rows(database, file, notes):
                topics.add(topic, kind, raw, log_ns)
    except sqlite3.Error as error:
        raise unreadable(file, error, "is it a bag, and whole?") from None
    contents = topics.finish()
    contents.notes += notes
    return contents


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, str]]:
    """Definitions in the file itself: since the fourth version of the storage."""
    try:
        found = database.execute(
            "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
        ).fetchall()
    except sqlite3.Error:
        return {}
    return {kind: (text, language) for kind, text, language in found if text}


def _rows(database: sqlite3.Connection, file: Path, notes: list[str]) -> Iterator[Message]:
    kinds = {i: (name, long_name(kind)) for i, name, kind in database.execute("SELECT id, name, type FROM topics")}
    count = 0
    # By rowid and not by time: a damaged index or page then costs only what lies behind it.
    cursor = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY rowid")
    while True:
        try:
            row = cursor.fetchone()
        except sqlite3.Error as error:
            notes.append(f"{file.name} is damaged after {count} messages ({_short(error)}); all before that was read")
            return
        if row is None:
            return
        count += 1
        if row[0] in kinds:
            yield (*kinds[row[0]], row[1], bytes(row[2]))


def merged(parts: list[Contents]) -> Contents:
    """Files of one recording that was split: topics of one name follow one another."""
    import numpy as np

    out = Contents()
    for part in parts:
        out.passed += part.passed
        out.notes += part.notes
        out.texts |= part.texts
        for stream in part.streams:
            before = next((s for s in out.streams if s.name == stream.name and s.kind == stream.kind), None)
            if before is None:
                out.streams.append(stream)
                continue
            shift = ((stream.origin_ns or 0) - (before.origin_ns or 0)) / 1e9
            lengths = len(before), len(stream)
            for name in dict.fromkeys([*before.columns, *stream.columns]):
                pieces = [
                    s.columns.get(name, np.full(n, np.nan)) for s, n in zip((before, stream), lengths, strict=True)
                ]
                before.columns[name] = np.concatenate(pieces)
            if before.time is not None and stream.time is not None:
                before.time = np.concatenate([before.time, stream.time + shift])
            if before.logged is not None and stream.logged is not None:
                before.logged = np.concatenate([before.logged, stream.logged + shift])
            for why, count in stream.lost.items():
                before.lost[why] = before.lost.get(why, 0) + count
    return out
