"""The bus for ROS 2: by rclpy where a ROS 2 is sourced, else by Cyclone DDS, which ROS 2 nodes hear as one of their own.

Only valid samples are passed on: ROS messages have no place to say that one is not.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import nan
from typing import TYPE_CHECKING, Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.messages import JointsState, Message, Pose, WrenchCompensated, WrenchRaw

if TYPE_CHECKING:
    from galen_hw.tools.bridge.command import Sink

NAMES: Final = {
    "wrench/raw": ("ft/raw", "geometry_msgs/WrenchStamped"),
    "wrench/compensated": ("ft/compensated", "geometry_msgs/WrenchStamped"),
    "wrench/contact": ("ft/contact", "geometry_msgs/WrenchStamped"),
    "joints/state": ("joint_states", "sensor_msgs/JointState"),
    "pose/reported": ("pose/reported", "geometry_msgs/PoseStamped"),
    "pose/corrected": ("pose/corrected", "geometry_msgs/PoseStamped"),
}
"""Topic of the bus: topic of ROS below the namespace, and its type."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this bridge."""
    parser.add_argument("--namespace", default="galen", help="of the topics")
    parser.add_argument("--sensor-frame", default="ft_sensor", help="frame_id of the wrenches")
    parser.add_argument("--base-frame", default="base", help="frame_id of the poses")


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[tuple["Sink", str]]:
    """The publishers.

    Raises:
        UsageError: no middleware of ROS 2 is installed.
    """
    backend = _backend(args.namespace.strip("/"))
    try:
        yield _sink(backend, args), f"ready: ROS 2 topics below /{args.namespace.strip('/')} by {backend.name}"
    finally:
        backend.close()


def _backend(namespace: str) -> Any:
    try:
        import rclpy  # noqa: F401

        from galen_hw.tools.bridge.ros2_rclpy import Rclpy

        return Rclpy(namespace)
    except ImportError:
        pass
    try:
        import cyclonedds  # noqa: F401
    except ImportError:
        todo = "source ROS 2's setup file, or pip install 'galen-hw[ros2]'"
        raise UsageError("neither rclpy nor cyclonedds is installed", todo=todo) from None
    from galen_hw.tools.bridge.ros2_dds import Dds

    return Dds(namespace)


def _sink(backend: Any, args: argparse.Namespace) -> "Sink":
    def take(topic: str, message: Message) -> None:
        if topic in NAMES and message.valid:
            name, kind = NAMES[topic]
            backend.publish(name, kind, fields(message, args.sensor_frame, args.base_frame))

    return take


def fields(message: Message, sensor: str, base: str) -> dict[str, Any]:
    """A message as the fields of its ROS message, by name.

    Args:
        message: of a topic in `NAMES`; sensor, base: frames of wrenches and of poses.
    """
    seconds, rest = divmod(max(0, round(message.timestamp * NS_PER_S)), NS_PER_S)

    def header(frame: str) -> dict[str, Any]:
        return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame}

    def vector(v: Any, axes: str = "xyz") -> dict[str, float]:
        return {a: getattr(v, a) for a in axes}

    if isinstance(message, WrenchRaw | WrenchCompensated):
        wrench = {"force": vector(message.force), "torque": vector(message.torque)}
        return {"header": header(sensor), "wrench": wrench}
    if isinstance(message, Pose):
        pose = {"position": vector(message.position), "orientation": vector(message.orientation, "xyzw")}
        return {"header": header(base), "pose": pose}
    assert isinstance(message, JointsState), "the table names no others"
    names = list(message.position)
    values = {
        kind: [getattr(message, kind).get(name, nan) for name in names] if getattr(message, kind) else []
        for kind in ("position", "velocity", "effort")
    }
    return {"header": header(""), "name": names, **values}


Publish = Callable[[str, str, dict[str, Any]], None]
