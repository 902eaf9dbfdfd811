"""A recording as a ROS 2 bag (MCAP storage): standard messages on usual topics, a URDF as /robot_description.

recording.json is in the custom data of its metadata.yaml.

Stamps are the time of the recording, on its epoch where that is known, else from 0. A sample that was not measured is no message.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.formats.contents import needed
from galen_hw.recording import Recording
from galen_hw.recording.info import INFO
from galen_hw.recording.recording import JOINT_KINDS, POSE, SENSOR_ORIENTATION, WRENCH, group_of

Sample = tuple[str, str, int, Any]
"""Topic, type, time in ns, message."""
VECTORS: Final = "geometry_msgs/msg/"


def write(recording: Recording, path: Path) -> list[str]:
    """Write the folder; what there is no message for, by column.

    Raises:
        UsageError: there is no clock, or rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise needed("rosbags", "a ROS 2 bag")(error) from None
    if recording.time is None:
        todo = "export it as csv, parquet or mat"
        raise UsageError("it has no time, and messages need one", where=str(recording.path), todo=todo)
    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = _Messages(recording, store.types)
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        bag.set_custom_data(INFO, recording.info.to_json())
        connections: dict[str, Any] = {}
        for topic, kind, ns, message in sorted(messages, key=lambda sample: sample[2]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, store.serialize_cdr(message, kind))
    return messages.left


class _Messages:
    """The messages of a recording, topic by topic."""

    def __init__(self, recording: Recording, types: dict[str, Any]) -> None:
        self._recording, self._types = recording, types
        assert recording.time is not None, "asked before"
        epoch_ns = 0 if recording.epoch is None else round(recording.epoch * NS_PER_S)
        self._ns = (np.round(recording.time * NS_PER_S).astype(np.int64) + epoch_ns).tolist()
        used = {*WRENCH, *POSE, *SENSOR_ORIENTATION, "time"}
        joints = [n for n in recording.columns if group_of(n) in ("position", "velocity", "effort")]
        targets = [n for n in recording.columns if group_of(n) == "targets"]
        rest = [n for n in recording.columns if n not in used and n not in joints and n not in targets]
        self.left = [f"no message holds {', '.join(rest)}: left out"] if rest else []
        self._targets = sorted({n.split(".")[1] for n in targets})

    def __iter__(self) -> Iterator[Sample]:
        recording, info = self._recording, self._recording.info
        sensor, base = info.sensor_link or "sensor", info.base_link or "base"
        if text := recording.urdf_text:
            yield "/robot_description", "std_msgs/msg/String", self._ns[0], self._types["std_msgs/msg/String"](text)
        if recording.has(*WRENCH):
            yield from self._stamped("/ft/wrench", "WrenchStamped", sensor, WRENCH, self._wrench)
        if recording.has(*SENSOR_ORIENTATION):
            yield from self._stamped("/sensor/orientation", "QuaternionStamped", base, SENSOR_ORIENTATION, self._turn)
        if recording.has(*POSE[:3]):
            names = POSE if recording.has(*POSE) else POSE[:3]
            yield from self._stamped("/tool/pose", "PoseStamped", base, names, self._pose)
        for number in self._targets:
            names = tuple(f"target.{number}.position.{a}" for a in "xyz")
            yield from self._stamped(f"/target/{number}", "PointStamped", "tracker", names, self._point)
        if recording.joint_names:
            yield from self._joints()

    def _make(self, kind: str, *parts: Any) -> Any:
        return self._types[kind if "/" in kind else VECTORS + kind](*parts)

    def _header(self, row: int, frame: str) -> Any:
        seconds, rest = divmod(self._ns[row], NS_PER_S)
        return self._make("std_msgs/msg/Header", self._make("builtin_interfaces/msg/Time", seconds, rest), frame)

    def _stamped(self, topic: str, kind: str, frame: str, names: tuple[str, ...], inner: Any) -> Iterator[Sample]:
        values = self._recording.matrix(*names)
        there = np.isfinite(values).all(axis=1)
        if not there.all():
            self.left.append(f"{topic}: {int((~there).sum())} rows that were not measured are no messages")
        for row in np.flatnonzero(there).tolist():
            message = self._make(kind, self._header(row, frame), inner(values[row].tolist()))
            yield topic, VECTORS + kind, self._ns[row], message

    def _wrench(self, v: list[float]) -> Any:
        return self._make("Wrench", self._make("Vector3", *v[:3]), self._make("Vector3", *v[3:]))

    def _turn(self, v: list[float]) -> Any:
        return self._make("Quaternion", *v)

    def _point(self, v: list[float]) -> Any:
        return self._make("Point", *v)

    def _pose(self, v: list[float]) -> Any:
        return self._make("Pose", self._point(v[:3]), self._turn(v[3:] or [0.0, 0.0, 0.0, 1.0]))

    def _joints(self) -> Iterator[Sample]:
        """One message a row; what a joint lacks is NaN, a kind that no joint has is empty, as the message's text says."""
        recording, names = self._recording, list(self._recording.joint_names)
        kinds = []
        for kind in JOINT_KINDS[:3]:
            values = recording.joints(kind)
            kinds.append(values if np.isfinite(values).any() else np.empty((len(recording), 0)))
        if any("command" in (group_of(n) or "") for n in recording.columns):
            self.left.append("JointState holds no commands: left out")
        for row, ns in enumerate(self._ns):
            parts = [np.ascontiguousarray(values[row]) for values in kinds]
            message = self._make("sensor_msgs/msg/JointState", self._header(row, ""), names, *parts)
            yield "/joint_states", "sensor_msgs/msg/JointState", ns, message
