"""The Galil driver against a scripted controller on a simulated clock."""

import contextlib
import math
import socket
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from galil_parts import MS, Bench, GalilPeer, ready

from galen_hw.bus import command_error, command_exception
from galen_hw.clock import TimeBase
from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.serial_transport import SerialTransport
from galen_hw.errors import EXIT_REFUSED, EXIT_USAGE, CommandRejectedError
from galen_hw.messages import Reply, Request


def test_connects_with_echo_on_and_reads_joint_states():
    """Echo off first, side talk marked, model, record layout, limits; then states in SI by joint name."""
    peer = GalilPeer(echo=True)
    peer.axes["A"] |= {"position": 100_000, "velocity_64": 64 * 2500, "status": 0x8001, "torque": 16384}
    peer.axes["E"] |= {"position": -20861}
    bench = Bench(peer).start()
    assert peer.lines[:4] == ["EO 0", "CW 1;CF S;LZ 1;PF 10.0", "\x12\x16", "QZ"]
    assert "FL 263000,241000,254000,65503,40053;BL -233000,-272000,-237000,-65503,-43391" in peer.lines
    assert bench.device.ready
    joints = bench.messages("joints/state")[0]
    assert joints.valid
    assert list(joints.position) == ["carriage1", "carriage2", "carriage3", "roll", "tilt"]
    assert joints.position["carriage1"] == pytest.approx(0.1)
    assert joints.position["tilt"] == pytest.approx(-0.5, abs=1e-4)
    assert joints.velocity["carriage1"] == pytest.approx(2500e-6)
    assert math.isnan(joints.effort["carriage1"])
    assert not bench.faults


def test_axis_at_rest_before_anyone_commands():
    """A robot that moves when the driver connects is stopped: nobody has watched over that motion."""
    peer = GalilPeer()
    for axis in peer.axes.values():
        axis["status"] = 0x8000
    Bench(peer).start()
    assert "ST ABCDE" in peer.lines


def test_counts_to_si_with_sign_offset_and_effort():
    """counts = offset + sign * scale * position; velocities and efforts follow the sign; ends swap."""
    axis = {
        "axis": "A", "joint": "j", "counts_per_unit": 1000.0, "offset_counts": 500, "sign": -1, "lower": -1.0,
        "upper": 2.0, "velocity": 1.0, "max_velocity": 1.0, "acceleration": 5.0, "max_acceleration": 5.0,
        "effort_per_volt": 2.0,
    }  # fmt: skip
    bench = Bench(settings={"axes": [axis]})
    bench.peer.axes["A"] |= {"position": 1500, "velocity_64": 6400, "torque": 32767, "switches": 0x04}
    bench.start()
    joints = bench.joints
    assert joints.position["j"] == pytest.approx(-1.0)
    assert joints.velocity["j"] == pytest.approx(-0.1)
    assert joints.effort["j"] == pytest.approx(-2.0 * 9.9982)
    assert joints.at_lower["j"]
    assert not joints.at_upper["j"]
    assert "FL 1500;BL -1500" in bench.peer.lines


@pytest.mark.parametrize(("level", "switches"), [(0, 0x04), (1, 0x08)])
def test_limit_polarity_is_a_setting(level, switches):
    """The forward switch is active at the configured level, and only that one."""
    bench = Bench(settings={"limit_active_level": level})
    for axis in bench.peer.axes.values():
        axis["switches"] = 0x0C if level == 0 else 0
    bench.peer.axes["D"]["switches"] = switches
    joints = bench.start().joints
    assert [name for name, at in joints.at_upper.items() if at] == ["roll"]
    assert not any(joints.at_lower.values())


def test_move_begins_only_when_all_is_accepted():
    """PA, SP even, AC and DC in steps of 1024 (at least one), BG on a line of its own; then the reply."""
    bench = ready()
    reply = bench.ask("move_jp", position={"carriage1": 0.05, "roll": -0.5}, velocity={"roll": 0.1},
                      acceleration={"roll": 0.01})  # fmt: skip
    assert reply.error is None
    sent = [line for line in bench.peer.lines if not line.startswith(("QR", "MG", "gh="))]
    assert sent == ["PA 50000,,,-20861;SP 50000,,,4172;AC 249856,,,1024;DC 499712,,,82944", "BG AD"]
    assert bench.joints.moving["roll"]
    assert not bench.joints.moving["tilt"]


def test_a_refused_target_begins_nothing():
    """'?' to PA: the code is fetched and told, BG is never sent."""
    bench = ready()
    bench.peer.refuse = {"PA": 6}
    reply = bench.ask("move_jp", position={"carriage1": 0.05})
    assert reply.error.kind == "rejected"
    assert "error 6: number out of range" in reply.error.what
    assert not any(line.startswith("BG") for line in bench.peer.lines)


@pytest.mark.parametrize(("code", "words"), [(7, "running"), (20, "motor off"), (21, "running"), (22, "limit switch")])
def test_begin_refused_tells_the_code(code, words):
    """The codes of the manual, in words, with what to do."""
    bench = ready()
    bench.peer.refuse = {"BG": code}
    reply = bench.ask("move_jp", position={"roll": 0.2})
    assert reply.error.kind == "rejected"
    assert f"error {code}" in reply.error.what
    assert words in reply.error.what
    assert reply.error.todo


@pytest.mark.parametrize(
    ("name", "args", "words"),
    [
        ("move_jp", {"position": {"carriage1": 0.3}}, r"carriage1: position 0.3 m is beyond the upper limit 0.263 m"),
        ("move_jp", {"position": {"tilt": -1.2}}, r"tilt: position -1.2 rad is beyond the lower limit -1.04 rad"),
        ("move_jp", {"position": {"roll": math.nan}}, "roll: position nan is not a finite number"),
        ("move_jp", {"position": {"roll": True}}, "not a finite number"),
        ("move_jp", {"position": {"roll": "17lb"}}, "'17lb' is not a finite number; give a number in rad, or .*deg"),
        ("servo_jv", {"velocity": {"carriage1": "1kn"}}, "give a number in m/s, or with its unit: m/s, mm/s"),
        ("move_jp", {"position": {"roll": 0.1}, "acceleration": {"roll": "a"}}, "give a number in rad/s.2"),
        ("move_jp", {"position": {"elbow": 0.0}}, "no joint 'elbow'"),
        ("move_jp", {"position": 3}, "position is not a table"),
        ("move_jp", {}, "names no position"),
        ("move_jp", {"position": {"roll": 0.1}, "velocity": {"roll": 9.0}}, "roll: velocity 9 is outside 0 to 2"),
        ("move_jp", {"position": {"roll": 0.1}, "velocity": {"roll": 0}}, "roll: velocity 0 is outside"),
        ("move_jp", {"position": {"roll": 0.1}, "acceleration": {"roll": 99}}, "roll: acceleration 99"),
        ("move_jp", {"position": {"roll": 0.1}, "velocity": {"tilt": 0.1}}, "tilt: velocity or acceleration without"),
        ("move_jp", {"positions": {}}, "takes no positions"),
        ("servo_jv", {"velocity": {"carriage1": -0.3}}, r"velocity -0.3 m/s is above the limit 0.25 m/s"),
        ("servo_jv", {}, "names no velocity"),
        ("dance", {}, "no command 'dance'"),
    ],
)
def test_wrong_requests_are_rejected_before_anything_is_sent(name, args, words):
    """The message names joint, value and limit; the line stays silent. What there is not is wrong use, a limit refuses."""
    bench = ready()
    with pytest.raises(CommandRejectedError, match=words) as caught:
        bench.ask(name, **args)
    beyond = any(word in words for word in ("limit", "outside", "acceleration 99"))
    assert command_error(caught.value).kind == ("rejected" if beyond else "invalid")
    assert command_exception(command_error(caught.value)).exit_code == (EXIT_REFUSED if beyond else EXIT_USAGE)
    bench.run(0.05)
    assert all(line.startswith(("QR", "MG", "gh=")) for line in bench.peer.lines)


def test_what_the_state_forbids_is_rejected():
    """Not connected, motors off, moving already, emergency stop: each with what to do."""
    with pytest.raises(CommandRejectedError, match="not connected yet"):
        Bench().ask("move_jp", position={"roll": 0.1})
    bench = Bench().start()
    with pytest.raises(CommandRejectedError, match="motors are off; enable first"):
        bench.ask("move_jp", position={"roll": 0.1})
    bench = ready()
    bench.ask("move_jp", position={"roll": 0.1})
    with pytest.raises(CommandRejectedError, match="roll is still moving"):
        bench.ask("move_jp", position={"roll": 0.2})
    with pytest.raises(CommandRejectedError, match="roll is moving to a position"):
        bench.ask("servo_jv", velocity={"roll": 0.2})
    with pytest.raises(CommandRejectedError, match="the robot is moving"):
        bench.ask("enable")


def test_servo_begins_once_and_then_only_changes_speed():
    """AC, DC and BG for the first jog; after that JG alone; a joint that stands still is not begun."""
    bench = ready()
    bench.ask("servo_jv", 0.1, velocity={"roll": 0.1, "tilt": 0.0})
    bench.ask("servo_jv", 0.1, velocity={"roll": -0.05, "tilt": 0.1})
    bench.ask("servo_jv", 0.1, velocity={"roll": 0.0, "tilt": 0.1})
    sent = [line for line in bench.peer.lines if not line.startswith(("QR", "MG", "gh="))]
    assert sent == [
        "AC ,,,82944;DC ,,,416768;JG ,,,4172",
        "BG D",
        "AC ,,,,82944;DC ,,,,416768;JG ,,,-2086,4172",
        "BG E",
        "JG ,,,0,4172",
    ]


def test_servo_without_refresh_is_stopped():
    """The watchdog stops the axes after the configured time, once, and says so."""
    bench = ready(servo_timeout_s=0.2)
    bench.ask("servo_jv", 0.19, velocity={"roll": 0.1})
    assert "ST ABCDE" not in bench.peer.lines
    bench.ask("servo_jv", 0.19, velocity={"roll": 0.1})
    assert "ST ABCDE" not in bench.peer.lines
    bench.run(0.5)
    assert bench.peer.lines.count("ST ABCDE") == 1
    assert any("servo_jv was not refreshed for 0.2 s" in what for what in bench.faults)
    assert bench.device.counters["watchdog_stops"] == 1


def test_servo_that_ended_at_zero_is_stopped_without_a_fault():
    """A client that asked for rest and fell silent did nothing wrong; the axes leave the jog mode."""
    bench = ready()
    bench.ask("servo_jv", 0.1, velocity={"roll": 0.1})
    bench.ask("servo_jv", 0.5, velocity={"roll": 0.0})
    assert bench.peer.lines.count("ST ABCDE") == 1
    assert not bench.faults


def test_servo_faster_than_the_line_keeps_the_newest():
    """Requests that the line cannot carry give way to newer ones, and joint states keep flowing."""
    bench = ready()
    bench.latency_ns = 15 * MS
    states = len(bench.messages("joints/state"))
    for step in range(100):
        bench.ask("servo_jv", 0.005, velocity={"roll": 0.1 + 0.001 * step})
    bench.run(0.05)
    jogs = [line for line in bench.peer.lines if line.startswith("JG")]
    assert jogs[-1] == "JG ,,,8302"
    assert len(jogs) < 30
    assert len(bench.messages("joints/state")) - states > 10


def test_servo_off_a_limit_only_the_other_way():
    """At a limit switch a velocity that leads on is rejected, one that leads back is carried out."""
    bench = ready()
    bench.peer.axes["D"]["switches"] = 0x04
    bench.run(0.1)
    with pytest.raises(CommandRejectedError, match=r"roll: velocity 0\.1 leads beyond the upper limit"):
        bench.ask("servo_jv", velocity={"roll": 0.1})
    assert bench.ask("servo_jv", velocity={"roll": -0.1}).error is None


def test_stop_goes_first_and_cancels_what_waits():
    """A stop that arrives while a move is being prepared: no BG, the move is answered as cancelled."""
    bench = ready()
    bench.ask("move_jp", 0.0, position={"roll": 0.5})
    while not any(line.startswith("PA") for line in bench.peer.lines):
        bench.run(0.001)
    reply = bench.ask("stop")
    assert reply.error is None
    assert "ST ABCDE" in bench.peer.lines
    assert not any(line.startswith("BG") for line in bench.peer.lines)
    cancelled = [output for output in bench.outputs if getattr(output, "id", "") == "move_jp"]
    assert cancelled[-1].error.what == "move_jp: cancelled by a stop"


def test_abort_is_ab_1():
    """abort ends the motion without deceleration, and nothing else."""
    bench = ready()
    assert bench.ask("abort").error is None
    assert "AB 1" in bench.peer.lines


def test_disable_stops_first_when_moving_and_waits():
    """MO follows ST only when a record has shown all axes at rest; at rest there is no ST."""
    bench = ready()
    assert bench.ask("disable").error is None
    assert [line for line in bench.peer.lines if line[:2] in {"ST", "MO"}] == ["MO ABCDE"]
    bench = ready()
    bench.ask("move_jp", position={"roll": 0.5})
    assert bench.ask("disable").error is None
    acts = [line for line in bench.peer.lines if line[:2] in {"ST", "MO", "QR"}]
    assert acts.index("ST ABCDE") + 2 <= acts.index("MO ABCDE")
    assert not any(bench.joints.enabled.values())


def test_time_of_a_joint_state_lies_between_request_and_answer():
    """Read time of the first byte less the record's age, never before the request, and always growing."""
    bench = ready()
    bench.latency_ns = 5 * MS
    bench.chunk = 7
    before = len(bench.messages("joints/state"))
    bench.run(0.3)
    times = [message.t_ns for message in bench.messages("joints/state")[before:]]
    assert all(b > a for a, b in pairwise(times))
    assert all((t + 600_000 - 10**9) % MS == 0 for t in times[1:])


def test_rate_follows_the_setting_and_the_line():
    """The setting bounds the rate; a slower line sets the pace, and no request overtakes an answer.

    The controller's own time-out costs 20 short lines a second.
    """
    fast, slow = round(10e9 / 115200), round(10e9 / 38400)
    for byte_ns, watchdog_s, expected in (
        (0, 0.25, 100),
        (fast, 0, 54),
        (fast, 0.25, 51.5),
        (slow, 0, 18),
        (slow, 0.25, 15.5),
    ):
        bench = ready(status_interval_s=0.2, watchdog_s=watchdog_s)
        bench.latency_ns, bench.byte_ns = MS // 2, byte_ns
        before = len(bench.messages("joints/state"))
        bench.run(2.0)
        rate = (len(bench.messages("joints/state")) - before) / 2.0
        assert rate == pytest.approx(expected, rel=0.05)


def test_the_same_driver_over_a_socket():
    """Identified, enabled and moved over real TCP through `socket://`."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = SerialTransport(SerialTransport.Settings(url=f"socket://127.0.0.1:{server.getsockname()[1]}"))
        transport.open()
        controller, _ = server.accept()
        controller.setblocking(False)
        device, peer = GalilDmc("motors", GalilDmc.Settings(quiet_s=0.002), TimeBase.now()), GalilPeer(echo=True)
        device.start(time.monotonic_ns())
        outputs, todo = [], [("enable", {}), ("move_jp", {"position": {"tilt": 0.25}})]
        end = time.monotonic() + 10.0
        while time.monotonic() < end and len([o for o in outputs if isinstance(o, Reply)]) < 2:
            wires, more = device.poll(time.monotonic_ns())
            transport.send(wires)
            outputs += more
            with contextlib.suppress(BlockingIOError):
                for line in controller.recv(4096).split(b"\r")[:-1]:
                    controller.sendall(peer.answer(line + b"\r"))
            for data, t_ns in transport.receive(0.001):
                outputs += device.feed(data, t_ns)
            if device.ready and todo:
                with contextlib.suppress(CommandRejectedError):  # motors off until a record says otherwise
                    name, args = todo[0]
                    outputs += device.request(Request(id=name, target="m", name=name, args=args), time.monotonic_ns())
                    todo.pop(0)
        transport.close()
        controller.close()
    assert [o.error for o in outputs if isinstance(o, Reply)] == [None, None]
    assert "PA ,,,,10430;SP ,,,,20860;AC ,,,,82944;DC ,,,,207872" in peer.lines
    assert "BG E" in peer.lines


def test_stop_of_the_device_sends_one_line_even_while_an_answer_is_pending():
    """The shell's stop: ST at once and the controller's program ended, the waiting request answered, then silence."""
    bench = ready()
    bench.latency_ns = 10**9
    bench.ask("move_jp", 0.001, position={"roll": 0.1})
    assert bench.device.stop(bench.now_ns) == [b"ST ABCDE\r", b"HX 7\r"]
    bench.line.clear()
    sent = len(bench.sent)
    bench.run(2.0)
    assert len(bench.sent) == sent
    assert any(getattr(output, "id", "") == "move_jp" and output.error for output in bench.outputs)
    assert bench.messages("status")[-1].state == "stopped"
