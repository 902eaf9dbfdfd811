"""The tracker's driver against a scripted tracker on a simulated clock."""

import math
import sys
from itertools import pairwise
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from ndi_parts import DELAY_NS, FRAME_NS, MS, NdiBench, NdiPeer, line
from pydantic import ValidationError

from galen_hw.drivers.ndi_tracker import NdiTracker
from galen_hw.errors import CommandRejectedError
from galen_hw.messages import Reply, Request


@pytest.fixture
def roms(tmp_path):
    """Settings of two wireless bodies with definitions of their own."""
    (tmp_path / "tool.rom").write_bytes(b"NDI" + bytes([1]) * 749)
    (tmp_path / "reference.rom").write_bytes(b"NDI" + bytes([2]) * 1021)
    return {name: {"rom_file": str(tmp_path / f"{name}.rom")} for name in ("tool", "reference")}


def test_from_power_up_to_poses(roms):
    """INIT at 9600, COMM, stale handles freed, definitions written, poses in metres of the body's own topic."""
    peer = NdiPeer(ports={"07": 0x31}, stale={"07"})
    bench = NdiBench(peer, {"markers": roms}).start()
    assert bench.device.ready
    assert bench.baud == 115200
    assert not bench.breaks
    kinds = [text.partition(":")[0] for text in peer.lines]
    assert kinds[:4] == ["INIT", "COMM", "PHSR", "PHF"]
    assert kinds.count("PVWR") == 12 + 16
    assert peer.roms["01"] == b"NDI" + bytes([1]) * 749 + bytes(16)
    assert peer.roms["02"] == b"NDI" + bytes([2]) * 1021
    tool, reference = bench.messages("tracker/tool")[-1], bench.messages("tracker/reference")[-1]
    assert tool.valid
    assert (tool.handle, tool.position.x, tool.position.z) == ("01", pytest.approx(0.1), pytest.approx(-1.5))
    assert (reference.handle, reference.position.x) == ("02", pytest.approx(0.2))
    assert tool.orientation.w == 1.0
    assert tool.error_m == pytest.approx(1e-4)
    assert not bench.faults


@pytest.mark.parametrize("reply", ["BX", "TX"])
@pytest.mark.parametrize("chunk", [0, 1, 7])
def test_every_frame_once_in_any_chunks(reply, chunk):
    """60 poses a second for each body, numbers and frames without gaps, repeats counted and not published."""
    bench = NdiBench(settings={"reply": reply}, chunk=chunk).start(1.0)
    bench.outputs.clear()
    bench.run(5.0)
    for topic in ("tracker/tool", "tracker/reference"):
        poses = bench.messages(topic)
        assert len(poses) == pytest.approx(300, abs=2)
        assert all(b.frame == a.frame + 1 and b.seq == a.seq + 1 for a, b in pairwise(poses))
    assert bench.device.counters["repeated"] > 300
    assert bench.device.counters["dropped"] == 0


def test_time_is_the_frames_not_the_reads():
    """Poses are one period apart whatever the delay of the replies, and the delay that is left is the least of them."""
    bench = NdiBench(settings={"latency_s": DELAY_NS / 1e9}).start(1.0)
    bench.outputs.clear()
    for step in range(200):
        bench.latency_ns = (1 + step % 5) * MS
        bench.run(0.02)
    poses = bench.messages("tracker/tool")
    late = [pose.t_ns - pose.frame * FRAME_NS for pose in poses]
    assert max(late) - min(late) < MS
    assert 0 <= min(late) < 2 * MS


def test_an_earlier_session_at_the_final_rate():
    """A tracker left tracking at 115200 is reached there: TSTOP, INIT, no COMM, no break."""
    peer = NdiPeer(baud=115200, tracking=True)
    bench = NdiBench(peer).start(6.0)
    assert bench.device.ready
    assert not bench.breaks
    assert peer.lines[:3] == ["INIT:", "TSTOP:", "INIT:"]
    assert not any(text.startswith("COMM") for text in peer.lines)


@pytest.mark.parametrize("first", [line("RESET"), b"\xf8\xe1\xe3\xf8\x8f\xff\xf0" + line("OKAY")])
def test_a_tracker_that_was_just_switched_on_is_asked_again(first):
    """RESET, or what another rate made of it, in place of INIT's reply: once more at this rate, no break, within a second."""
    bench = NdiBench()
    answer, said = bench.peer.answer, []

    def unsettled(wire, now_ns, baud):
        said.append(wire)
        return first if len(said) == 1 else answer(wire, now_ns, baud)

    bench.peer.answer = unsettled
    bench.start(2.0)
    assert bench.device.ready
    assert not bench.breaks
    assert bench.peer.lines[:2] == ["INIT:", "COMM:50000"]


def test_a_break_resets_a_tracker_at_another_rate():
    """At 921600 from elsewhere: a break of half a second, RESET, INIT at 9600, COMM."""
    peer = NdiPeer(baud=921600)
    bench = NdiBench(peer).start(12.0)
    assert bench.device.ready
    assert len(bench.breaks) == 1
    assert peer.lines[:2] == ["INIT:", "COMM:50000"]


def test_on_a_socket_there_is_no_rate_and_no_break():
    """baud_rate 0: INIT, then handles."""
    peer = NdiPeer(baud=1)
    bench = NdiBench(peer, {"baud_rate": 0}, baud=1).start()
    assert bench.device.ready
    assert not any(text.startswith("COMM") for text in peer.lines)


def test_wired_bodies_by_serial_number_and_handle():
    """Bodies that the tracker knows by itself are chosen by what the settings name, not by order."""
    for marker in ({"serial_number": "SERIAL0B"}, {"handle": "0B"}):
        peer = NdiPeer(ports={"0A": 0x01, "0B": 0x01}, roms={"0A": b"x", "0B": b"x"})
        bench = NdiBench(peer, {"markers": {"tool": {}, "reference": marker}}).start()
        assert bench.messages("tracker/tool")[-1].handle == "0A"
        assert bench.messages("tracker/reference")[-1].handle == "0B"


def test_a_missing_body_is_published_as_missing_and_told(roms):
    """Frames go on with NaN and valid false; after missing_s a fault, and the state is degraded."""
    bench = NdiBench(settings={"markers": roms}).start()
    bench.peer.states["01"] = "missing"
    bench.run(1.0)
    pose = bench.messages("tracker/tool")[-1]
    assert pose.missing
    assert not pose.valid
    assert math.isnan(pose.position.x)
    assert bench.messages("tracker/reference")[-1].valid
    assert not bench.faults
    bench.run(3.0)
    assert "tool: the marker body is not seen" in bench.faults
    assert bench.messages("status")[-1].state == "degraded"
    assert "clear the view" in bench.messages("status")[-1].todo


@pytest.mark.parametrize(("reply", "state"), [("BX", "disabled"), ("TX", "disabled"), ("TX", "unoccupied")])
def test_a_body_that_is_gone_is_a_fault(reply, state, roms):
    """DISABLED and UNOCCUPIED bear no frame: no pose, a fault once a second."""
    bench = NdiBench(settings={"reply": reply, "markers": roms}).start()
    bench.peer.states["01"] = state
    before = len(bench.messages("tracker/tool"))
    bench.run(1.5)
    assert len(bench.messages("tracker/tool")) <= before + 1
    assert bench.faults.count(f"tool: handle 01 is {state}") == 2
    assert bench.device.counters["absent"] > 50


def test_out_of_volume_is_not_valid():
    """Bit 0x40 of the port status: published, not vouched for."""
    bench = NdiBench().start()
    bench.peer.port_status = 0x71
    bench.run(0.2)
    assert not bench.messages("tracker/tool")[-1].valid
    assert bench.messages("tracker/tool")[-1].port_status == 0x71


def test_system_status_becomes_a_fault():
    """Each bit that comes up is told in words."""
    bench = NdiBench().start()
    bench.peer.status = 0x12
    bench.run(0.2)
    assert "too much external infrared light" in bench.faults
    assert "hardware failure" in bench.faults
    assert not bench.messages("tracker/tool")[-1].valid


def test_frames_that_the_host_missed_are_counted():
    """A host that hangs for 0.3 s loses 18 frames, and the time of what follows is right."""
    bench = NdiBench().start()
    bench.now_ns += 300 * MS
    bench.run(0.5)
    assert 2 * 16 <= bench.device.counters["dropped"] <= 2 * 19
    assert not bench.faults


@pytest.mark.parametrize(("shift", "words"), [(-500, "began again"), (600, "jumped")])
def test_a_counter_that_leaps_is_noticed_at_once(shift, words):
    """A restart or a jump is a fault while it happens, and poses go on."""
    bench = NdiBench().start(12.0)
    bench.peer.frame_shift = shift
    before = len(bench.messages("tracker/tool"))
    bench.run(0.2)
    assert any(words in what for what in bench.faults)
    assert len(bench.messages("tracker/tool")) - before >= 10
    times = [pose.t_ns for pose in bench.messages("tracker/tool")]
    assert all(b > a for a, b in pairwise(times))


def test_a_bad_checksum_loses_one_reply():
    """A damaged reply is counted, drained, and the next one is taken."""
    bench = NdiBench().start()
    while not bench.line:
        bench.run(0.001)
    t_ns, data = bench.line[0]
    bench.line[0] = (t_ns, bytes([data[0], data[1], data[2] ^ 1]) + data[3:])
    before = len(bench.messages("tracker/tool"))
    bench.run(0.5)
    assert bench.device.counters["bad_crc"] == 1
    assert len(bench.messages("tracker/tool")) - before > 20
    assert bench.device.ready


def test_a_dead_line_is_told_and_comes_back():
    """Three requests without reply: a fault, not ready; it connects anew when the tracker answers."""
    bench = NdiBench().start()
    bench.peer.dead = True
    bench.run(3.0)
    assert not bench.device.ready
    assert "no readable reply from the tracker" in bench.faults
    bench.peer.dead, bench.peer.baud, bench.peer.tracking = False, 9600, False
    bench.peer.ports.clear()
    bench.run(20.0)
    assert bench.device.ready


def test_a_tracker_that_was_reset_is_set_up_again():
    """RESET out of the blue, or "not valid in the current mode": connected anew, and said."""
    bench = NdiBench().start()
    bench.peer.tracking, bench.peer.baud, bench.peer.ports = False, 9600, {}
    bench.run(15.0)
    assert bench.device.ready
    bench = NdiBench().start()
    while not bench.line:
        bench.run(0.001)
    bench.line = [(bench.now_ns, line("RESET"))]
    bench.peer.tracking, bench.peer.baud = False, 9600
    bench.run(0.1)
    assert any("reset" in what for what in bench.faults)


@pytest.mark.parametrize(
    ("peer", "words"),
    [
        (NdiPeer(dead=True), "no answer from the tracker"),
        (NdiPeer(refuse={"PINIT": 0x13}), "tool: PINIT refused with error 13: port could not be initialised"),
        (NdiPeer(refuse={"TSTART": 0x12}), "TSTART refused with error 12: tracking could not be started"),
        (NdiPeer(refuse={"PHRQ": 0x99}), "PHRQ refused with error 99: unknown"),
    ],
)
def test_what_stands_in_the_way_is_told(peer, words):
    """One clear fault with what to do; never ready."""
    bench = NdiBench(peer).start(15.0)
    assert not bench.device.ready
    assert words in bench.faults
    assert all(fault.todo for fault in bench.messages("fault"))


def test_a_named_body_that_is_not_there():
    """The fault lists what the tracker has."""
    peer = NdiPeer(ports={"0A": 0x31})
    bench = NdiBench(peer, {"markers": {"tool": {"serial_number": "X"}}}).start()
    assert "tool: no such marker body, the tracker has 0A (SERIAL0A)" in bench.faults


def test_restart_is_the_only_request():
    """restart connects anew; anything else is rejected, as is all before the start."""
    with pytest.raises(CommandRejectedError, match="not started"):
        NdiBench().device.request(Request(id="1", target="tracker", name="restart"), 0)
    bench = NdiBench().start()
    with pytest.raises(CommandRejectedError, match="no command 'move_jp'"):
        bench.device.request(Request(id="1", target="tracker", name="move_jp"), bench.now_ns)
    (reply,) = bench.device.request(Request(id="1", target="tracker", name="restart"), bench.now_ns)
    assert isinstance(reply, Reply)
    assert not bench.device.ready
    bench.run(6.0)
    assert bench.device.ready


def test_stop_ends_tracking():
    """TSTOP, then silence."""
    bench = NdiBench().start()
    assert bench.device.stop(bench.now_ns) == [line("TSTOP:")]
    count = len(bench.peer.lines)
    bench.run(2.0)
    assert len(bench.peer.lines) == count


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"markers": {"tool": {"rom_file": "/no/such.rom"}}}, "cannot be read"),
        ({"markers": {"tool": {"handle": "a"}}}, "handle"),
        ({"markers": {"elbow": {}}}, "elbow"),
        ({"markers": {}}, "markers"),
        ({"baud_rate": 1234}, "baud_rate must be 0"),
        ({"reply": "BX2"}, "BX"),
    ],
)
def test_impossible_settings_are_refused(settings, words):
    """Each mistake is named."""
    with pytest.raises(ValidationError, match=words):
        NdiTracker.Settings(**settings)


def test_a_file_that_is_no_definition_is_refused(tmp_path):
    """A text file in its place is noticed when the settings are read."""
    (tmp_path / "notes.rom").write_text("see the cupboard")
    with pytest.raises(ValidationError, match="is no tool definition"):
        NdiTracker.Settings(markers={"tool": {"rom_file": str(tmp_path / "notes.rom")}})


def test_a_wireless_body_without_a_definition_is_one_fault_and_nothing_is_asked_for():
    """No handle is taken for a body that cannot be initialised; a body that is plugged in needs none."""
    bench = NdiBench(settings={"markers": {"tool": {}}}).start()
    assert bench.faults[0] == "tool: a wireless marker body needs its tool definition (.rom)"
    assert "rom_file" in bench.messages("fault")[0].todo
    assert not any(text.startswith("PHRQ") for text in bench.peer.lines)
    plugged = NdiBench(NdiPeer(ports={"0A": 0x01}, roms={"0A": b"x"}), {"markers": {"tool": {}}}).start()
    assert plugged.device.ready


def test_an_oversized_definition_is_refused(tmp_path):
    """A definition has at most 1024 bytes."""
    (tmp_path / "big.rom").write_bytes(bytes(1025))
    with pytest.raises(ValidationError, match="has 1025 bytes"):
        NdiTracker.Settings(markers={"tool": {"rom_file": str(tmp_path / "big.rom")}})
