"""The live bus for Foxglove and ROS 2, heard by clients that are not ours."""

import asyncio
import json
import struct
import threading
import time
import warnings
from argparse import Namespace
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from galen_hw.messages import Message, Pose, Quaternion, Vector3
from galen_hw.tools.bridge import foxglove_server, ros2_publisher
from tests.compensation_parts import MS, joints, raw

WRENCH = raw(1700 * MS, [1.0, -2.0, 3.0, 0.1, 0.2, 0.3])
JOINTS = joints(1700 * MS, np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
POSE = Pose(
    timestamp=1.7,
    t_ns=1700 * MS,
    seq=1,
    source="x",
    valid=True,
    position=Vector3(0.1, 0.2, 0.3),
    orientation=Quaternion(0, 0, 0, 1),
)
STREAM: list[tuple[str, Message]] = [("wrench/raw", WRENCH), ("joints/state", JOINTS), ("pose/corrected", POSE)]


def publishing(take: Callable[[str, Message], None], over: threading.Event) -> threading.Thread:
    """Sends the stream again and again, as the bus does."""

    def send() -> None:
        while not over.wait(0.01):
            for topic, message in STREAM:
                take(topic, message)

    thread = threading.Thread(target=send)
    thread.start()
    return thread


async def _heard(port: int, wanted: set[str]) -> dict[str, tuple[dict[str, Any], bytes]]:
    """Channel and first message of each topic, by Foxglove's WebSocket protocol."""
    from websockets.asyncio.client import connect

    advertised: dict[int, dict[str, Any]] = {}
    heard: dict[str, tuple[dict[str, Any], bytes]] = {}
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:  # type: ignore[list-item]
        while set(heard) < wanted:
            frame = await asyncio.wait_for(socket.recv(), 20.0)
            if isinstance(frame, str):
                told = json.loads(frame)
                if told.get("op") == "advertise":
                    advertised |= {channel["id"]: channel for channel in told["channels"]}
                # A channel that is opened while a client connects can be advertised before it may be subscribed to; the
                # server (SDK 0.30) then says so in a status, and it is asked for again.
                asked = [i for i, channel in advertised.items() if channel["topic"] not in heard]
                subscriptions = [{"id": i, "channelId": i} for i in asked]
                await socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            elif frame[0] == 1:
                number, _ = struct.unpack_from("<IQ", frame, 1)
                heard.setdefault(advertised[number]["topic"], (advertised[number], frame[13:]))
    return heard


def test_foxglove_hears_the_bus() -> None:
    """Every topic as JSON with its schema; joints and poses in Foxglove's own messages; NaN is null."""
    pytest.importorskip("foxglove")
    wanted = {"/wrench/raw", "/joints/state", "/joint_states", "/pose/corrected", "/pose/corrected/in_frame"}
    over = threading.Event()
    with foxglove_server.opened(Namespace(host="127.0.0.1", port=0)) as (take, line):
        thread = publishing(take, over)
        try:
            heard = asyncio.run(_heard(int(line.rsplit(":", 1)[1].split()[0]), wanted))
        finally:
            over.set()
            thread.join()
    channel, data = heard["/wrench/raw"]
    assert json.loads(data)["force"] == {"x": 1.0, "y": -2.0, "z": 3.0}
    assert channel["encoding"] == "json"
    assert json.loads(channel["schema"])["properties"]["force"]["properties"]["x"]["type"] == "number"
    assert heard["/joint_states"][0]["schemaName"] == "foxglove.JointStates"
    assert heard["/pose/corrected/in_frame"][0]["schemaName"] == "foxglove.PoseInFrame"


def test_ros_fields_are_those_of_ros() -> None:
    """rosbags' definitions take them field by field; what is not valid is not passed on."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    sent: list[tuple[str, str, dict[str, Any]]] = []

    class Backend:
        def publish(self, *message: Any) -> None:
            sent.append(message)

    args = Namespace(sensor_frame="ft", base_frame="base")
    take = ros2_publisher._sink(Backend(), args)
    for topic, message in STREAM:
        take(topic, message)
    take("wrench/raw", raw(1, [0.0] * 6, valid=False))
    assert [name for name, _, _ in sent] == ["ft/raw", "joint_states", "pose/corrected"]
    for _, kind, fields in sent:
        long = kind.replace("/", "/msg/")
        made = _made(store, long, fields)
        assert store.deserialize_cdr(store.serialize_cdr(made, long), long).header.stamp.nanosec == 700_000_000


def _made(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    parts = {}
    for name, (node, inner) in store.fielddefs[kind][1]:
        value = fields[name]
        if int(node) == 2:
            value = _made(store, inner, value)
        elif int(node) == 4 and name != "name":
            value = np.array(value, dtype=float)
        parts[name] = value
    assert set(fields) == set(parts)
    return store.types[kind](**parts)


def test_dds_carries_them_as_ros_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over the real Cyclone DDS, topic and type names as ROS 2 mangles them; another participant hears every field."""
    pytest.importorskip("cyclonedds")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        from galen_hw.tools.bridge.ros2_dds import QOS, JointState_, WrenchStamped_

    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    listener = DomainParticipant(77)
    kinds = {"ft/raw": WrenchStamped_, "joint_states": JointState_}
    topics = {name: Topic(listener, f"rt/galen/{name}", kind, qos=QOS) for name, kind in kinds.items()}
    readers = {name: DataReader(listener, topic, qos=QOS) for name, topic in topics.items()}
    args = Namespace(namespace="/galen/", sensor_frame="ft", base_frame="base")
    heard: dict[str, Any] = {}
    with ros2_publisher.opened(args) as (take, line):
        assert "Cyclone DDS" in line
        end = time.monotonic() + 20.0
        while len(heard) < len(readers) and time.monotonic() < end:
            for topic, message in STREAM:
                take(topic, message)
            heard |= {name: found[0] for name, reader in readers.items() if (found := reader.take(N=1))}
    assert heard["ft/raw"].wrench.force.y == -2.0
    assert heard["ft/raw"].header.frame_id == "ft"
    assert heard["joint_states"].name == list(JOINTS.position)
    assert heard["joint_states"].position == list(JOINTS.position.values())
    assert topics["ft/raw"].typename == "geometry_msgs::msg::dds_::WrenchStamped_"
