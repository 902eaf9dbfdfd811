"""Topics of ROS messages, of bags and of MCAP, as streams."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.formats.contents import Contents, Nanoseconds, Stream, needed, relative
from galen_hw.formats.wire_layout import Gatherer
from galen_hw.spatial import Array

STRING: Final = "std_msgs/msg/String"
DESCRIPTION: Final = "robot_description"
LARGEST: Final = 64 * 1024
"""Bytes of a message with numbers of a robot; longer ones are images, clouds or maps."""
HINTS: Final = {
    "geometry_msgs/msg/TransformStamped": {
        **{f"transform.translation.{a}": f"pose.position.{a}" for a in "xyz"},
        **{f"transform.rotation.{a}": f"pose.orientation.{a}" for a in "xyzw"},
    },
    "geometry_msgs/msg/QuaternionStamped": {f"quaternion.{a}": f"sensor.orientation.{a}" for a in "xyzw"},
    "sensor_msgs/msg/Imu": {
        **{f"linear_acceleration.{a}": f"imu.acceleration.{a}" for a in "xyz"},
        **{f"angular_velocity.{a}": f"imu.angular_velocity.{a}" for a in "xyz"},
    },
}
"""What the fields of a type are, where their names do not say it."""
_TARGET: Final = re.compile(r".*/target/(\w+)")
UNNEEDED: Final = ("covariance", ".header.")


def type_definitions(texts: Mapping[str, tuple[str, str]], *, ros1: bool = False) -> dict[str, Any]:
    """Fields of every type by name: those of the standard messages, then those that the file itself defines.

    Args:
        texts: the file's definition by type, with its language: "ros2msg", "ros2idl" or "ros1msg".
        ros1: take the standard messages of ROS 1.

    Raises:
        UsageError: rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError as error:
        raise needed("rosbags", "a recording of ROS")(error) from None
    types = dict(get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST).fielddefs)
    for kind, (text, language) in texts.items():
        try:
            if language.endswith("idl"):
                bar = "=" * 80 + "\n"
                parts = text.split(bar)[1:] if text.startswith(f"{bar}IDL: ") else [text]
                for part in parts:
                    types |= get_types_from_idl(part.split("\n", 1)[1] if part.startswith("IDL: ") else part)
            elif text.strip():
                types |= get_types_from_msg(text, kind)
        except Exception:  # noqa: BLE001, S112 - a definition of anybody's; a message of it is then said to be not known
            continue
    return types


def long_name(kind: str) -> str:
    """The long form of a type: geometry_msgs/msg/Wrench for geometry_msgs/Wrench."""
    head, _, tail = kind.partition("/")
    return kind if "/msg/" in kind or not tail else f"{head}/msg/{tail}"


class Topics:
    """Gathers the messages of all topics of a file.

    Args:
        types: see `type_definitions`; cdr: of ROS 2.
    """

    def __init__(self, types: Mapping[str, Any], *, cdr: bool) -> None:
        self._types, self._cdr = types, cdr
        self._gatherers: dict[tuple[str, str], Gatherer] = {}
        self._large: dict[tuple[str, str], int] = {}
        self.contents = Contents()

    def add(self, topic: str, kind: str, raw: bytes, log_ns: int) -> None:
        """Take one message; `kind` in its long form."""
        key = (topic, kind)
        gatherer = self._gatherers.get(key)
        if gatherer is None:
            gatherer = self._gatherers[key] = Gatherer(self._types, kind, cdr=self._cdr)
        if len(raw) > LARGEST and kind != STRING:
            self._large[key] = self._large.get(key, 0) + 1
            return
        gatherer.add(raw, log_ns)

    def finish(self) -> Contents:
        """The streams; what holds no numbers is listed."""
        for topic, kind in list(self._gatherers):
            gatherer = self._gatherers.pop((topic, kind))  # whose memory goes when its columns are made
            columns, logged, stamps = gatherer.columns()
            if (logged[1:] < logged[:-1]).any():
                order = np.argsort(logged, kind="stable")
                columns, logged = {name: values[order] for name, values in columns.items()}, logged[order]
                stamps = None if stamps is None else stamps[order]
            title = f"{topic} ({kind})"
            if kind == STRING and topic.rstrip("/").endswith(DESCRIPTION):
                self.contents.texts["robot.urdf"] = gatherer.texts.get("data", "")
            elif self._large.get((topic, kind)):
                self.contents.passed.append(f"{title}: {self._large[topic, kind]} large messages, not taken")
            elif not columns and not gatherer.lost:
                self.contents.passed.append(f"{title}: {len(logged)} messages without numbers, not taken")
            elif not columns:
                why, count = next(iter(gatherer.lost.items()))
                self.contents.passed.append(f"{title}: {count} messages cannot be read: {why}")
            else:
                self.contents.streams.append(self._stream(topic, kind, columns, (logged, stamps), gatherer))
        return self.contents

    def _stream(
        self,
        topic: str,
        kind: str,
        columns: dict[str, Array],
        clocks: tuple[Nanoseconds, Nanoseconds | None],
        gatherer: Gatherer,
    ) -> Stream:
        logged, stamps = clocks
        headed = stamps is not None and bool(np.any(stamps))
        clock = stamps if headed and stamps is not None else logged
        origin, some = int(clock[0]), slice(None, None, max(1, len(clock) // 1000))
        if stamps is not None and not headed:
            self.contents.notes.append(f"{topic}: its headers bear no time; that of the log is taken")
        elif headed and abs(far := float(np.median(logged[some] - clock[some])) / NS_PER_S) > FAR_S:
            self.contents.notes.append(f"{topic}: its headers are {far:.6g} s before the log: another clock?")
        numbers = {
            n: v for n, v in columns.items() if not n.startswith(UNNEEDED[0]) and not any(u in n for u in UNNEEDED[1:])
        }
        frame = next((t for n, t in gatherer.texts.items() if n.endswith("header.frame_id")), "")
        hints = {c: t for c, t in HINTS.get(kind, {}).items() if c in numbers}
        if kind == "geometry_msgs/msg/PointStamped" and (target := _TARGET.fullmatch(topic)):
            hints = {f"point.{a}": f"target.{target[1]}.position.{a}" for a in "xyz"}
        return Stream(
            topic,
            numbers,
            kind,
            relative(clock, origin),
            origin,
            relative(logged, origin) if headed else None,
            frame=frame,
            lost=dict(gatherer.lost),
            hints=hints,
        )


FAR_S: Final = 1.0
