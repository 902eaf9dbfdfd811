"""The Galil driver when things go wrong: trips, emergency stops, silence, wrong devices."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from galil_parts import MS, Bench, GalilPeer, ready

from galen_hw.errors import CommandRejectedError


def test_motors_that_disagree_are_all_switched_off():
    """One motor off among motors on: ST if moving, MO for all, a fault that stays until it is cleared."""
    bench = ready()
    bench.peer.axes["B"]["status"] = 0x0001
    bench.run(0.3)
    assert "MO ABCDE" in bench.peer.lines
    assert any("all are switched off" in what for what in bench.faults)
    with pytest.raises(CommandRejectedError, match="clear_fault"):
        bench.ask("enable")
    assert bench.ask("clear_fault").result["cleared"]
    assert bench.ask("enable").error is None


@pytest.mark.parametrize("how", [{"amplifier": 1 << 24}, {"amplifier": 1 << 25}, {"abort": 0}])
def test_emergency_stop_is_seen_and_must_be_cleared(how):
    """ELO of either group or the abort input: estop in the joint state within the status interval, motion rejected."""
    bench = ready()
    for key, value in how.items():
        setattr(bench.peer, key, value)
    bench.run(0.15)
    assert bench.joints.estop
    bench.run(1.1)
    assert (bench.status.state, bench.status.todo.split(",")[0]) == ("fault", "release it")
    with pytest.raises(CommandRejectedError, match="emergency stop or abort input is engaged"):
        bench.ask("move_jp", position={"roll": 0.1})
    assert bench.ask("clear_fault").error.what == "emergency stop or abort input is still engaged"
    bench.peer.amplifier, bench.peer.abort = 0, 1
    bench.run(0.15)
    assert not bench.joints.estop
    typed = "galen-hw command motors clear_fault and galen-hw command motors enable"
    with pytest.raises(CommandRejectedError, match=typed):
        bench.ask("move_jp", position={"roll": 0.1})
    bench.run(1.1)
    assert (bench.status.state, typed in bench.status.todo) == ("fault", True)
    assert bench.ask("clear_fault").error is None
    assert bench.ask("move_jp", position={"roll": 0.1}).error is None
    bench.run(1.1)
    assert (bench.status.state, bench.status.todo) == ("ready", "")


@pytest.mark.parametrize("code", [6, 15])
def test_a_fault_of_an_axis_asks_for_the_state_at_once(code):
    """A stop by the abort input or an amplifier does not wait for the next status interval."""
    bench = ready(status_interval_s=60.0)
    bench.peer.abort = 0
    bench.peer.axes["A"]["stop_code"] = code
    bench.run(0.1)
    assert bench.joints.estop


@pytest.mark.parametrize(("code", "latched"), [(2, False), (3, False), (8, True), (12, True), (15, True), (77, True)])
def test_stop_codes_that_are_faults(code, latched):
    """Limits are told; trips of the drive are told and latched; an unknown code is a fault too."""
    bench = ready()
    bench.peer.axes["D"]["stop_code"] = code
    bench.run(0.1)
    assert any(what.startswith("roll: ") for what in bench.faults)
    assert bench.joints.stop_code["roll"] == code
    if latched:
        with pytest.raises(CommandRejectedError, match="clear_fault"):
            bench.ask("move_jp", position={"roll": 0.1})
    else:
        assert bench.ask("move_jp", position={"roll": 0.1}).error is None


def test_a_motion_command_without_answer_is_answered_and_stopped():
    """BG times out: it may have begun, so the reply says so and a stop follows; the line is drained before."""
    bench = ready()
    bench.peer.silent = {"BG"}
    reply = bench.ask("move_jp", 1.0, position={"roll": 0.1})
    assert reply.error.kind == "timeout"
    assert "may have been carried out" in reply.error.what
    at = bench.sent.index(b"BG D\r")
    assert bench.sent[at + 1] == b"\r"
    assert b"ST ABCDE\r" in bench.sent[at:]
    assert bench.device.ready


def test_late_answers_do_not_shift_what_follows():
    """Answers that come after the time-out are drained; the next commands get their own."""
    bench = ready(reply_timeout_s=0.05)
    bench.latency_ns = 70 * MS
    bench.run(0.06)
    bench.latency_ns = MS
    bench.run(0.5)
    assert bench.device.counters["timeouts"] >= 1
    assert bench.device.counters["drained"] >= 185
    bench.peer.refuse = {"PA": 6}
    assert bench.ask("move_jp", position={"roll": 0.1}).error.what.startswith(
        "move_jp: controller refused 'PA ,,,4172'"
    )


def test_a_dead_line_is_told_and_comes_back_by_itself():
    """Fault, an invalid joint state, requests rejected; reconnects when the controller answers again."""
    bench = ready()
    bench.peer.dead = True
    bench.ask("move_jp", 1.0, position={"roll": 0.1})
    assert not bench.joints.valid
    assert not bench.device.ready
    assert any("does not answer" in what for what in bench.faults)
    assert bench.status.state == "fault"
    assert bench.status.todo.startswith("check power, cable")
    with pytest.raises(CommandRejectedError, match=r"does not answer|no answer"):
        bench.ask("enable")
    bench.peer.dead = False
    bench.run(3.0)
    assert bench.device.ready
    assert bench.joints.valid


def test_restart_answers_what_waited():
    """start() after a lost wire: the pending request is answered, the controller identified anew."""
    bench = ready()
    bench.peer.dead = True
    bench.ask("move_jp", 0.0, position={"roll": 0.1})
    bench.peer.dead = False
    bench.peer.lines.clear()
    bench.line.clear()
    bench.start()
    replies = [output for output in bench.outputs if getattr(output, "id", "") == "move_jp"]
    assert replies[-1].error.kind == "timeout"
    assert bench.peer.lines[0] == "EO 0"
    assert bench.device.ready


@pytest.mark.parametrize(
    ("peer", "words"),
    [
        (GalilPeer(model="POLARIS VEGA"), "not a Galil DMC, it calls itself 'POLARIS VEGA'"),
        (GalilPeer(sizes="5, 40, 0, 28"), "laid out as '5, 40, 0, 28'"),
        (GalilPeer(sizes="4, 52, 26, 36"), "has 4 axes, the configuration names axis E"),
        (GalilPeer(dead=True), "no answer from the controller"),
    ],
)
def test_a_wrong_device_is_named(peer, words):
    """One clear fault, never ready, no command of motion."""
    bench = Bench(peer).start(2.0)
    assert not bench.device.ready
    assert any(words in what for what in bench.faults)
    assert not any(line[:2] in {"SH", "BG", "PA", "FL"} for line in peer.lines)


def test_side_talk_becomes_a_fault():
    """Unsolicited text, marked by CW 1, is told to people and changes nothing."""
    bench = ready()
    bench.feed(bytes(c | 0x80 for c in b"CMDERR 12\r\n"))
    bench.run(0.1)
    assert any("CMDERR 12" in what for what in bench.faults)
    assert bench.device.counters["timeouts"] == 0
