"""Publishing by rclpy, with the message packages of the ROS 2 that is sourced."""

import importlib
from typing import Any


class Rclpy:
    """A node of its own.

    Args:
        namespace: of its topics.
    """

    name = "rclpy"

    def __init__(self, namespace: str) -> None:
        import rclpy

        self._rclpy = rclpy
        rclpy.init()
        self._node = rclpy.create_node("galen_hw_bridge", namespace=f"/{namespace}")
        self._publishers: dict[str, tuple[Any, Any]] = {}

    def publish(self, name: str, kind: str, fields: dict[str, Any]) -> None:
        """Publish the fields of a message; `kind` as "geometry_msgs/WrenchStamped"."""
        if name not in self._publishers:
            package, _, message = kind.partition("/")
            made = getattr(importlib.import_module(f"{package}.msg"), message)
            self._publishers[name] = made, self._node.create_publisher(made, name, 10)
        made, publisher = self._publishers[name]
        publisher.publish(_filled(made(), fields))

    def close(self) -> None:
        """End the node."""
        self._node.destroy_node()
        self._rclpy.shutdown()


def _filled(message: Any, fields: dict[str, Any]) -> Any:
    for key, value in fields.items():
        if isinstance(value, dict):
            _filled(getattr(message, key), value)
        else:
            setattr(message, key, value)
    return message
