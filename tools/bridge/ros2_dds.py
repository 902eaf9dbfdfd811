"""Publishing by Cyclone DDS as ROS 2 does it: topics "rt/NAME", types "PACKAGE::msg::dds_::TYPE_", CDR, keep last.

ROS_DOMAIN_ID chooses the domain, as for any node. (ROS 2 design, "Topic and Service name mapping to DDS".)
"""

import os
from dataclasses import dataclass, is_dataclass
from typing import Any, Final, get_type_hints

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# ruff: noqa: D101, N801 - names and fields are those of the ROS messages


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header_(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time_
    frame_id: str


@dataclass
class Vector3_(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Point_(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion_(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Wrench_(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector3_
    torque: Vector3_


@dataclass
class Pose_(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point_
    orientation: Quaternion_


@dataclass
class WrenchStamped_(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header_
    wrench: Wrench_


@dataclass
class PoseStamped_(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header_
    pose: Pose_


@dataclass
class JointState_(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header_
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


TYPES: Final[dict[str, Any]] = {
    "geometry_msgs/WrenchStamped": WrenchStamped_,
    "geometry_msgs/PoseStamped": PoseStamped_,
    "sensor_msgs/JointState": JointState_,
}
QOS: Final = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10), Policy.Durability.Volatile
)
"""ROS 2's own default for publishers."""


class Dds:
    """A participant with a writer a topic.

    Args:
        namespace: of the topics.
    """

    name = "Cyclone DDS"

    def __init__(self, namespace: str) -> None:
        self._participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self._namespace = namespace
        self._writers: dict[str, Any] = {}

    def publish(self, name: str, kind: str, fields: dict[str, Any]) -> None:
        """Publish the fields of a message; `kind` as "geometry_msgs/WrenchStamped"."""
        if name not in self._writers:
            topic = Topic(self._participant, f"rt/{self._namespace}/{name}", TYPES[kind], qos=QOS)
            self._writers[name] = DataWriter(self._participant, topic, qos=QOS)
        self._writers[name].write(filled(TYPES[kind], fields))

    def close(self) -> None:
        """Leave the domain."""
        self._writers.clear()


def filled(kind: Any, fields: dict[str, Any]) -> Any:
    """A struct with these fields, nested ones too."""
    hints = get_type_hints(kind)
    values = {
        k: filled(hints[k], v) if is_dataclass(hints[k]) and isinstance(v, dict) else v for k, v in fields.items()
    }
    return kind(**values)
