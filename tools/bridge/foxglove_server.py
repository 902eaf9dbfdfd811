"""The bus for Foxglove, by its SDK: every topic as JSON with its schema, and joints and poses in Foxglove's own messages."""

import argparse
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from galen_hw.clock import NS_PER_S
from galen_hw.errors import HardwareError, UsageError
from galen_hw.messages import TOPICS, JointsState, Message, Pose
from galen_hw.recording.mcap_writer import json_bytes, message_schema

if TYPE_CHECKING:
    from galen_hw.tools.bridge.command import Sink

PORT: Final = 8765
"""Where Foxglove looks."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this bridge."""
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at; 0.0.0.0 for the whole network")
    parser.add_argument("--port", type=int, default=PORT, help="0: any free one")


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[tuple["Sink", str]]:
    """The server.

    Raises:
        UsageError: the SDK is not installed. HardwareError: the port is taken.
    """
    try:
        import foxglove
    except ImportError:
        raise UsageError(
            "Foxglove's bridge needs the package foxglove-sdk", todo="pip install 'galen-hw[foxglove]'"
        ) from None
    logging.getLogger("foxglove").setLevel(logging.ERROR)
    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="galen-hw", host=args.host, port=args.port, context=context)
    except (OSError, RuntimeError) as error:
        where = f"{args.host}:{args.port}"
        raise HardwareError(f"cannot listen ({error})", where=where, todo="give another --port, or 0") from None
    try:
        yield _Channels(context).take, f"ready: open ws://{args.host}:{server.port} in Foxglove"
    finally:
        server.stop()


class _Channels:
    """The channels of the server, made when their topic is first heard."""

    def __init__(self, context: Any) -> None:
        from foxglove import channels, messages

        self._context, self._kinds, self._messages = context, channels, messages
        self._open: dict[str, Any] = {}

    def take(self, topic: str, message: Message) -> None:
        """Send a message on."""
        import foxglove

        ns = max(0, round(message.timestamp * NS_PER_S))
        if topic not in self._open:
            schema = message_schema(TOPICS[topic].message)
            self._open[topic] = foxglove.Channel(
                f"/{topic}", schema=schema, message_encoding="json", context=self._context
            )
        self._open[topic].log(json_bytes(message), log_time=ns)
        if isinstance(message, JointsState) and message.valid:
            self._typed("/joint_states", self._kinds.JointStatesChannel).log(self._joints(message, ns), log_time=ns)
        if isinstance(message, Pose) and message.valid:
            self._typed(f"/{topic}/in_frame", self._kinds.PoseInFrameChannel).log(self._pose(message, ns), log_time=ns)

    def _typed(self, topic: str, kind: Any) -> Any:
        if topic not in self._open:
            self._open[topic] = kind(topic, context=self._context)
        return self._open[topic]

    def _stamp(self, ns: int) -> Any:
        return self._messages.Timestamp(sec=ns // NS_PER_S, nsec=ns % NS_PER_S)

    def _joints(self, message: JointsState, ns: int) -> Any:
        kinds = {"position": message.position, "velocity": message.velocity, "effort": message.effort}
        found = [
            self._messages.JointState(
                name=name, **{k: v[name] for k, v in kinds.items() if isfinite(v.get(name, float("nan")))}
            )
            for name in message.position
        ]
        return self._messages.JointStates(timestamp=self._stamp(ns), joints=found)

    def _pose(self, message: Pose, ns: int) -> Any:
        p, q = message.position, message.orientation
        place = self._messages.Vector3(x=p.x, y=p.y, z=p.z)
        turn = self._messages.Quaternion(x=q.x, y=q.y, z=q.z, w=q.w)
        pose = self._messages.Pose(position=place, orientation=turn)
        return self._messages.PoseInFrame(timestamp=self._stamp(ns), frame_id="base", pose=pose)
