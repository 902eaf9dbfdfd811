"""PlotJuggler's rules, played on the real bytes of the bus.

The rules are those of its ZeroMQ subscriber and its msgpack parser (`datastream_zmq.cpp`, `nlohmann_parsers.cpp`): two
frames are topic and payload, nested maps flatten to `topic/a/b`, arrays to `a[0]`, strings are ignored, and the time
field must be a number at the top of *every* message or that parser drops it for good.
"""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from galen_hw.bus import Publisher
from galen_hw.messages import (
    TOPICS,
    CalibrationProgress,
    Fault,
    JointsState,
    Message,
    Pose,
    Quaternion,
    Status,
    TrackedPose,
    Vector3,
    WrenchCompensated,
    WrenchRaw,
    encode,
)

LAYOUT = Path(__file__).parents[1] / "config" / "plotjuggler-layout.xml"
HEAD: dict[str, Any] = {"timestamp": 1.7e9 + 0.25, "t_ns": 12, "seq": 3, "valid": True, "source": "ft"}
ONE = Vector3(x=1.0, y=-2.0, z=math.nan)
BY_JOINT = {"roll": 0.1, "tilt": math.nan}
SAMPLES: dict[type[Message], Message] = {
    WrenchRaw: WrenchRaw(**HEAD, force=ONE, torque=ONE),
    WrenchCompensated: WrenchCompensated(**HEAD, force=ONE, torque=ONE),
    JointsState: JointsState(**HEAD, position=BY_JOINT, velocity=BY_JOINT, effort=BY_JOINT, moving={"roll": True}),
    Pose: Pose(**HEAD, position=ONE, orientation=Quaternion(), covariance=[1.0, 2.0]),
    TrackedPose: TrackedPose(**HEAD, handle="0A", frame=7, position=ONE, orientation=Quaternion()),
    Status: Status(**HEAD, state="ready", gauges={"rate_hz": 999.0}),
    Fault: Fault(**HEAD, what="x"),
    CalibrationProgress: CalibrationProgress(**HEAD, state="moving", pose=3, poses=56),
}


class PlotJuggler:
    """What the viewer keeps of what it receives."""

    def __init__(self, time_field: str = "timestamp") -> None:
        self.series: dict[str, list[tuple[float, float]]] = {}
        self._time_field = time_field
        self._time_field_lost: set[str] = set()

    def receive(self, frames: list[bytes], received_at: float) -> None:
        if len(frames) != 2:
            raise AssertionError(f"{len(frames)} frames: the viewer would misread them")
        topic, payload = frames[0].decode(), frames[1]
        content = msgpack.unpackb(payload, strict_map_key=True)
        assert isinstance(content, dict)
        time = content.get(self._time_field)
        if topic in self._time_field_lost or not isinstance(time, int | float) or isinstance(time, bool):
            self._time_field_lost.add(topic)
            time = received_at
        self._flatten(topic, content, float(time))

    def _flatten(self, name: str, value: object, time: float) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                self._flatten(f"{name}/{key}", inner, time)
        elif isinstance(value, list):
            for index, inner in enumerate(value):
                self._flatten(f"{name}[{index}]", inner, time)
        elif isinstance(value, bool | int | float):
            self.series.setdefault(name, []).append((time, float(value)))


@pytest.fixture
def viewer(tmp_path: Path) -> PlotJuggler:
    """A viewer that has subscribed as PlotJuggler does and received one message of every topic."""
    juggler = PlotJuggler()
    context: zmq.Context[Any] = zmq.Context.instance()
    with Publisher("tcp://127.0.0.1:*") as publisher, context.socket(zmq.SUB) as subscriber:
        subscriber.setsockopt(zmq.LINGER, 0)
        subscriber.setsockopt(zmq.SUBSCRIBE, b"")
        subscriber.connect(publisher.socket.getsockopt(zmq.LAST_ENDPOINT).decode())
        for _ in range(200):
            publisher.publish_bytes(b"begin", b"")
            if subscriber.poll(50):
                break
        for name, topic in TOPICS.items():
            publisher.publish(name, sample(topic.message))
        publisher.publish_bytes(b"end", b"")
        while (frames := subscriber.recv_multipart())[0] != b"end":
            if frames[0] != b"begin":
                juggler.receive(frames, received_at=1.0)
    return juggler


def sample(kind: type[Message]) -> Message:
    """A message of the kind; of a kind that is not known here, its fields without defaults are zero vectors."""
    if kind in SAMPLES:
        return SAMPLES[kind]
    return kind(**HEAD)


@pytest.mark.parametrize("name", [n for n, t in TOPICS.items() if t.message in (WrenchRaw, WrenchCompensated)])
def test_wrench_becomes_six_curves_at_its_own_time(viewer: PlotJuggler, name: str) -> None:
    """Each axis is a curve `topic/force/x`, timed by the message and not by its arrival."""
    curves = [f"{name}/{kind}/{axis}" for kind in ("force", "torque") for axis in "xyz"]

    assert set(curves) <= viewer.series.keys()
    assert viewer.series[curves[0]] == [(HEAD["timestamp"], 1.0)]
    assert math.isnan(viewer.series[curves[2]][0][1])


def test_every_topic_gives_curves_at_its_own_time(viewer: PlotJuggler) -> None:
    """No topic loses the time field, and every one has at least its seq."""
    for name in TOPICS:
        assert viewer.series[f"{name}/seq"] == [(HEAD["timestamp"], 3.0)], name


def test_joints_are_curves_by_name(viewer: PlotJuggler) -> None:
    """Joint tables flatten to names, booleans to 0 and 1."""
    assert viewer.series["joints/state/position/roll"] == [(HEAD["timestamp"], 0.1)]
    assert viewer.series["joints/state/moving/roll"] == [(HEAD["timestamp"], 1.0)]


def test_keys_are_the_same_in_every_message() -> None:
    """Defaults are sent too: a curve never has holes because a field had its default."""
    for kind, message in SAMPLES.items():
        keys = list(msgpack.unpackb(encode(message)))
        assert keys == list(kind.__struct_fields__), kind
        assert keys[0] == "timestamp"


def test_layout_shows_curves_that_exist(viewer: PlotJuggler) -> None:
    """The layout file that is shipped names only curves that the bus has."""
    curves = {curve.attrib["name"] for curve in ET.parse(LAYOUT).iter("curve")}

    assert curves
    assert curves <= viewer.series.keys()
