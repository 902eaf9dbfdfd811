"""Routing inside one process, and a device on its wire, with a clock that is turned by hand."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from galen_hw.clock import NS_PER_S, SimulatedClock, TimeBase
from galen_hw.daemon.host import REPLY_WITHIN_NS, Host
from galen_hw.daemon.keep import Keeper
from galen_hw.daemon.layout import CORE, Share, lay_out
from galen_hw.daemon.links import not_older
from galen_hw.daemon.port import Port, Waker
from galen_hw.decoding import decode_message
from galen_hw.drivers.transport import Transport
from galen_hw.errors import CommandRejectedError, HardwareError
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import (
    MAX_AGE_NS,
    JointsState,
    Message,
    Reply,
    Request,
    Status,
    Vector3,
    WrenchRaw,
    encode,
)
from galen_hw.services.service import Service, ServiceContext
from tests.daemon_parts import Calibration, Compensation, LineSensor

CONTEXT = ServiceContext(GalenRobot(), TimeBase(), Path("/nowhere"))


@dataclass
class Outside:
    """The world outside the process, written down."""

    published: list[tuple[str, Message]] = field(default_factory=list)
    requests: list[Request] = field(default_factory=list)
    replies: list[Reply] = field(default_factory=list)

    def publish(self, topic: str, message: Message) -> None:
        self.published.append((topic, message))

    def request(self, request: Request) -> None:
        self.requests.append(request)

    def reply(self, reply: Reply) -> None:
        self.replies.append(reply)


class MemoryWire(Transport[bytes]):
    """A wire that is a list; each attempt to open takes the next outcome."""

    def __init__(self, outcomes: list[HardwareError | None]) -> None:
        self.address = "memory"
        self.arrived: list[tuple[bytes, int]] = []
        self.sent: list[bytes] = []
        self.gone = False
        self._outcomes = outcomes

    def open(self) -> None:
        outcome = self._outcomes.pop(0)
        self.gone = False
        if outcome is not None:
            raise outcome

    def send(self, wires: list[bytes]) -> None:
        if self.gone:
            raise HardwareError("gone", where=self.address)
        self.sent += wires

    def receive(self, timeout_s: float) -> list[tuple[bytes, int]]:
        if self.gone:
            raise HardwareError("gone", where=self.address)
        arrived, self.arrived = self.arrived, []
        return arrived

    def close(self) -> None:
        self.gone = True

    def fileno(self) -> int | None:
        return 0

    @property
    def counters(self) -> dict[str, int]:
        return {}


def raw(seq: int = 1, source: str = "ft") -> WrenchRaw:
    return WrenchRaw(
        timestamp=0.0, t_ns=NS_PER_S, seq=seq, valid=True, source=source, force=Vector3(z=5.0), torque=Vector3()
    )


def joints(roll: float, source: str = "motors", *, moving: bool = False) -> JointsState:
    state: dict[str, Any] = {"position": {"roll": roll}, "velocity": {}, "effort": {}, "moving": {"roll": moving}}
    return JointsState(timestamp=0.0, t_ns=NS_PER_S, seq=1, valid=True, source=source, **state)


def make(*services: Service, ports: dict[str, Port] | None = None) -> tuple[Host, Outside, SimulatedClock]:
    outside, clock = Outside(), SimulatedClock(NS_PER_S)
    host = Host("here", ports or {}, {s.name: s for s in services}, outside, clock=clock.monotonic_ns)
    return host, outside, clock


def compensation() -> Compensation:
    return Compensation("compensation", Compensation.Settings(), CONTEXT)


def calibration() -> Calibration:
    return Calibration("calibration", Calibration.Settings(), CONTEXT)


def test_compensated_leaves_before_raw() -> None:
    """Both are published, the one that is waited for first."""
    host, outside, _ = make(compensation())
    host.take([("wrench/raw", raw())])

    assert [topic for topic, _ in outside.published] == ["wrench/compensated", "wrench/raw"]
    assert host.published == {"wrench/compensated": 1, "wrench/raw": 1}


def test_message_from_the_bus_reaches_services_and_is_not_published_again() -> None:
    """Joints of another process change the output; they are that process' to publish."""
    host, outside, _ = make(compensation())
    host.from_bus("joints/state", joints(2.0))
    host.take([("wrench/raw", raw())])

    assert "joints/state" not in [topic for topic, _ in outside.published]
    assert outside.published[0][1].force == Vector3(z=3.0)


def test_what_is_too_old_when_it_is_published_is_not_valid() -> None:
    """A sample that waited beyond its topic's limit goes out, and what was made of it, but nobody vouches for it."""
    host, outside, clock = make(compensation())
    clock.now_ns += MAX_AGE_NS["wrench/raw"]
    host.take([("wrench/raw", raw())])
    assert [message.valid for _, message in outside.published] == [True, True]
    clock.now_ns += 1
    host.take([("wrench/raw", raw(2))])

    assert [(topic, message.valid) for topic, message in outside.published[2:]] == [
        ("wrench/compensated", False),
        ("wrench/raw", False),
    ]
    assert host.old["wrench/raw"] == 1


def test_what_is_too_old_is_handed_to_a_recorder_alone() -> None:
    """Joints of two seconds ago do not move the compensation; a recorder, which only writes, is given them."""
    host, outside, clock = make(compensation())
    clock.now_ns += 2 * NS_PER_S
    assert not host.from_bus("joints/state", joints(2.0))
    fresh = replace(raw(), t_ns=clock.now_ns)
    host.take([("wrench/raw", fresh)])
    assert outside.published[0][1].force == Vector3(z=5.0)
    assert host.old == {"joints/state": 1}

    class Writer(Compensation):
        takes_old = True

    host, outside, clock = make(Writer("compensation", Compensation.Settings(), CONTEXT))
    clock.now_ns += 2 * NS_PER_S
    assert host.from_bus("joints/state", joints(2.0))
    host.take([("wrench/raw", replace(raw(), t_ns=clock.now_ns))])
    assert outside.published[0][1].force == Vector3(z=3.0)


def test_core_passes_on_what_waited_too_long_as_not_valid() -> None:
    """Only `valid` changes; what is new enough or cannot be read passes as it is."""
    old, status = encode(joints(0.5)), encode(Status(timestamp=0.0, t_ns=1, seq=1, valid=True, state="ready"))
    late = NS_PER_S + MAX_AGE_NS["joints/state"] + 1
    passed = not_older(b"joints/state", old, late)

    assert decode_message(b"joints/state", passed)[1] == replace(joints(0.5), valid=False)
    assert not_older(b"joints/state", old, late - 1) is old
    assert not_older(b"status", status, 2 * NS_PER_S + 1) is status
    assert not_older(b"status", status, 2 * NS_PER_S + 2) is not status
    assert not_older(b"joints/state", b"\xc1", late) == b"\xc1"


def test_own_message_that_comes_back_over_the_bus_is_not_taken_twice() -> None:
    """What a service or device here has said is known here already."""
    host, outside, _ = make(compensation())
    host.from_bus("wrench/raw", raw(source="compensation"))

    assert outside.published == []


def test_reply_finds_its_way_through_a_service() -> None:
    """Outside asks the service, which asks outside, whose reply it turns into its own."""
    host, outside, _ = make(calibration())
    host.from_outside(Request(id="a", target="calibration", name="zero"))
    [asked] = outside.requests
    assert outside.replies == []
    host.reply_from_outside(Reply(id=asked.id, result={"x": 1}))

    assert outside.replies == [Reply(id="a", result={"x": 1})]


def test_reply_that_never_comes_is_a_timeout_and_a_late_one_is_dropped() -> None:
    """The service is told after the time limit, once."""
    host, outside, clock = make(calibration())
    host.from_outside(Request(id="a", target="calibration", name="zero"))
    host.tick(clock.monotonic_ns())
    assert outside.replies == []
    clock.now_ns += REPLY_WITHIN_NS + 1
    host.tick(clock.monotonic_ns())
    host.reply_from_outside(Reply(id=outside.requests[0].id))

    assert [(r.id, r.error.kind if r.error else "") for r in outside.replies] == [("a", "timeout")]


def test_two_requests_of_one_service_keep_their_ids_apart() -> None:
    """The ids on the way out are the host's own; each reply goes to its own request."""
    host, outside, _ = make(calibration())
    host.from_outside(Request(id="a", target="calibration", name="zero"))
    host.from_outside(Request(id="b", target="calibration", name="zero"))

    assert len({request.id for request in outside.requests}) == 2


@pytest.mark.parametrize(
    ("target", "name", "kind"),
    [("compensation", "nothing", "rejected"), ("compensation", "fail", "fault"), ("else", "x", "unknown")],
)
def test_failed_requests_are_answered_by_kind(target: str, name: str, kind: str) -> None:
    """Refused, broken, not here."""
    host, outside, _ = make(compensation())
    host.from_outside(Request(id="a", target=target, name=name))

    assert [r.error.kind for r in outside.replies if r.error] == [kind]


def test_host_knows_whether_the_robot_moves() -> None:
    """The last joint state of a device here says so."""
    host, _, _ = make()
    host.take([("joints/state", joints(0.0, moving=True))])
    assert host.moving
    host.take([("joints/state", joints(0.0))])

    assert not host.moving


def drive(port: Port, until: Callable[[], bool], waker: Waker) -> list[Any]:
    """Step a port until something is so; opening happens in a thread that wakes us."""
    import select

    outputs: list[Any] = []
    for _ in range(200):
        outputs += port.step(readable=True)
        if until():
            return outputs
        select.select([waker.fd], [], [], 0.05)
        waker.clear()
    raise AssertionError("it never came to be")


def test_wire_that_fails_is_tried_again_later_and_later() -> None:
    """Two refusals, then open; between them the waits double; a loss later starts at the shortest again."""
    clock, waker = SimulatedClock(NS_PER_S), Waker()
    wire = MemoryWire([HardwareError("busy"), HardwareError("busy"), None, None])
    sensor = LineSensor("ft", LineSensor.Settings(), TimeBase())
    port = Port(sensor, lambda: wire, clock.monotonic_ns, waker.wake)
    waits = []
    for attempt in (1, 2):
        drive(port, lambda n=attempt: port.attempts == n and port.state == "failed", waker)
        waits.append(port.wakeup_ns - clock.now_ns)
        with pytest.raises(CommandRejectedError, match="not connected"):
            port.request(Request(id="1", target="ft", name="say"), clock.now_ns)
        clock.now_ns = port.wakeup_ns
    drive(port, lambda: port.state == "open", waker)
    assert wire.sent == [b"HELLO\n"]
    wire.gone = True
    port.step(readable=True)
    assert port.state == "failed"
    waits.append(port.wakeup_ns - clock.now_ns)
    clock.now_ns = port.wakeup_ns
    drive(port, lambda: port.state == "open", waker)

    assert waits == [NS_PER_S // 2, NS_PER_S, NS_PER_S // 2]
    assert wire.sent == [b"HELLO\n", b"HELLO\n"]
    port.rest()
    assert wire.sent[-1] == b"REST\n"
    port.close()
    assert wire.gone
    waker.close()


def test_a_sample_is_handed_on_before_the_device_has_its_turn() -> None:
    """What is due to be sent, and a wire that wants to be looked after, come when the sample is on its way."""
    clock, waker = SimulatedClock(NS_PER_S), Waker()
    wire = MemoryWire([None])
    sensor = LineSensor("ft", LineSensor.Settings(), TimeBase())
    port = Port(sensor, lambda: wire, clock.monotonic_ns, waker.wake)
    assert port.receive() == []
    drive(port, lambda: port.state == "open", waker)
    port.request(Request(id="1", target="ft", name="say", args={"text": "hi"}), clock.now_ns)
    wire.sent.clear()
    wire.arrived = [(b"1.5\n", clock.now_ns)]
    outputs = port.receive()

    assert outputs[0][1].force.z == 1.5
    assert wire.sent == []
    assert port.tend() == []
    assert wire.sent == [b"hi\n"]
    port.close()
    waker.close()


def test_port_closed_while_it_opens_leaves_nothing_open() -> None:
    """The end of the daemon does not wait for an adapter, and what it opens then is closed."""
    import threading

    begin, begun = threading.Event(), threading.Event()

    class SlowWire(MemoryWire):
        def open(self) -> None:
            begun.set()
            assert begin.wait(10.0)

    clock, waker = SimulatedClock(NS_PER_S), Waker()
    wire = SlowWire([])
    port = Port(LineSensor("ft", LineSensor.Settings(), TimeBase()), lambda: wire, clock.monotonic_ns, waker.wake)
    port.step(readable=False)
    assert begun.wait(10.0)
    port.close()
    begin.set()
    for thread in threading.enumerate():
        if thread.name == "opening":
            thread.join(10.0)

    assert wire.gone
    waker.close()


def test_snapshots_are_written_whole_and_only_when_they_changed(tmp_path: Path) -> None:
    """What is kept is read back; the same again is not written again; nothing else is left in the folder."""
    keeper = Keeper(tmp_path)
    keeper.keep("a", {"x": 1})
    keeper.close()
    first = (tmp_path / "a.json").stat().st_mtime_ns
    keeper.keep("a", {"x": 1})
    keeper.close()

    assert Keeper(tmp_path).read("a") == {"x": 1}
    assert (tmp_path / "a.json").stat().st_mtime_ns == first
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_folder_that_cannot_be_written_loses_the_snapshot_not_the_daemon(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is said in the log, with the reason."""
    (tmp_path / "services").write_text("a file where the folder should be")
    keeper = Keeper(tmp_path / "services")
    keeper.keep("a", {"x": 1})
    keeper.close()

    assert "is not kept" in caplog.text


def test_layout_gives_every_part_one_process() -> None:
    """Sensor and compensation share the core, motors and calibration the next; strangers have one each."""

    class Given:
        speed = 1.0
        devices = dict.fromkeys(("ft", "motors", "tracker", "scale"))
        services = dict.fromkeys(("compensation", "calibration", "deflection", "recorder"))

    assert lay_out(Given()) == {  # type: ignore[arg-type]
        CORE: Share(("ft",), ("compensation",)),
        "motion": Share(("motors",), ("calibration",)),
        "tracking": Share(("tracker",), ("deflection",)),
        "scale": Share(("scale",), ()),
        "recorder": Share((), ("recorder",)),
    }


def test_status_of_another_process_is_no_reason_to_fall() -> None:
    """A topic that nobody here takes passes by."""
    host, outside, _ = make(compensation())
    host.from_bus("status", Status(timestamp=0.0, t_ns=0, seq=0, source="x", state="ready"))

    assert outside.published == []
