"""The sweep in simulated time: what it does, and what makes it stop."""

import json
import os
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zmq
from rich.console import Console

sys.path.insert(0, str(Path(__file__).parent))

from calibration_plant import Plant

from galen_hw.bus import command_error
from galen_hw.config.paths import Addresses
from galen_hw.decoding import decode_request
from galen_hw.drivers.virtual.truth import BIAS_BODY, TOOLS
from galen_hw.errors import CommandRejectedError, UsageError
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import JointsState, Reply, Request, Vector3, WrenchRaw, encode
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.recording import read_recording
from galen_hw.services.calibration.plan import make_plan
from galen_hw.services.calibration.settings import AxisSettings, CalibrationSettings
from galen_hw.tools.calibration.poses import poses_of
from galen_hw.tools.calibration.result import analyse
from galen_hw.tools.calibration.sweep import Operator, run_check, run_sweep

FEW = CalibrationSettings(
    axes={"tilt": AxisSettings(low=-0.6, high=0.6, count=3), "roll": AxisSettings(low=-0.9, high=0.9, count=4)},
    samples=60,
    zero_samples=100,
    bare_poses=4,
    verify_poses=3,
)


@pytest.fixture
def plant(tmp_path):
    return Plant(tmp_path, FEW)


def folder(plant):
    (found,) = (plant.state_dir / "sweeps").iterdir()
    return found


def story(plant):
    return json.loads((folder(plant) / "sweep.json").read_text())


@pytest.mark.parametrize("tool", ["pointer", "retractor"])
def test_a_sweep_finds_the_tool_and_the_bias_body(tmp_path, tool):
    """56 poses with the tool and 8 without: mass and centre of mass of both bodies within their 99.9 % intervals."""
    plant = Plant(tmp_path, CalibrationSettings(samples=100, zero_samples=100))
    assert plant.sweep(tool).state == "done"

    result = analyse(tool, poses_of(read_recording(folder(plant))).poses, "sweep")
    for body, prefix in ((TOOLS[tool], ""), (BIAS_BODY, "bias_body.")):
        for name, true in zip(("mass", "com.x", "com.y", "com.z"), (body.mass, *body.com), strict=True):
            i = result.estimate.names.index(prefix + name)
            assert abs(result.estimate.values[i] - true) < 4.0 * result.estimate.std[i]
    assert len(result.poses.held_out) == 8
    assert np.all(result.verification.rms < 1.8 * result.verification.expected)


def test_the_raw_sweep_says_what_it_belongs_to(plant):
    """The folder is a table recording with the zeroing pose, and beside it serial number, settings and state."""
    plant.sweep()
    recording = read_recording(folder(plant))

    assert recording.info.robot == "galen"
    assert recording.info.zeroed_at == dict.fromkeys(GalenRobot().joint_names, 0.0)
    assert (story(plant)["sensor_serial"], story(plant)["state"]) == ("FT12345", "done")
    assert len(recording) == story(plant)["poses"] == plant.progress[-1].poses


def test_the_table_is_whole_after_every_pose(plant):
    """At any moment of the sweep the folder can be read, and nothing half-written lies beside it."""
    seen = []

    def look(plant):
        sweeps = list((plant.state_dir / "sweeps").glob("*/recording.csv"))
        if sweeps and plant.count % 100 == 0:
            seen.append(len(read_recording(sweeps[0].parent)))
            names = sorted(p.name for p in sweeps[0].parent.iterdir())
            assert names == ["recording.csv", "recording.json", "sweep.json"]

    plant.hooks.append(look)
    plant.sweep()

    assert len(set(seen)) > 10


def test_progress_counts_poses_and_time_left_falls_to_zero(plant):
    """The time left starts near what the sweep takes and its error shrinks with the pace that is learnt."""
    plant.sweep()
    shown = [m for m in plant.progress if m.state in ("moving", "settling", "averaging") and m.pose > 0]
    ends = 1e-9 * plant.now
    half = shown[len(shown) // 2]
    assert half.remaining_s == pytest.approx(ends - 1e-9 * half.t_ns, rel=0.25)
    assert plant.progress[-1].remaining_s == 0.0
    assert [m.pose for m in shown] == sorted(m.pose for m in shown)


def test_the_order_keeps_gravity_apart_from_time():
    """Gravity in the sensor correlates with time and its square by less than 0.12, with home often between."""
    robot = GalenRobot()
    for seed in range(5):
        plan = make_plan(CalibrationSettings(seed=seed), robot)
        q = np.array([[step.target[name] for name in robot.joint_names] for step in plan.tool if step.kind == "fit"])
        s = gravity_in_sensor(robot.sensor_pose(q)[:, :3, :3])
        t = np.arange(len(s), dtype=float)
        for clock in (t, (t - t.mean()) ** 2):
            assert np.abs(np.corrcoef(np.column_stack([clock, s]).T)[0, 1:]).max() < 0.12
        homes = [i for i, step in enumerate(plan.tool) if step.kind == "home"]
        assert len(q) == 56
        assert max(np.diff(homes)) <= 11


def test_a_pose_beyond_the_limits_is_refused_before_anything_moves(plant):
    """The refusal names joint and limit."""
    with pytest.raises(CommandRejectedError, match=r"tilt = 1\.5.* beyond the limits"):
        plant.begin(axes={"tilt": {"low": -0.5, "high": 1.5, "count": 3}})
    assert plant.moves == []


@pytest.mark.parametrize(
    ("args", "what"),
    [
        ({"samples": 1}, "samples"),
        ({"smaples": 5}, "smaples"),
        ({"tool": "../x"}, "not a sweep"),
        ({"kind": "x"}, "not"),
    ],
)
def test_impossible_arguments_are_refused(plant, args, what):
    """They are named, and no sweep begins."""
    with pytest.raises(CommandRejectedError if {"tool", "kind"} & args.keys() else UsageError, match=what):
        plant.begin(**args)
    assert plant.progress == []


def test_a_loaded_sensor_at_zeroing_is_noticed(plant):
    """With a tool on from the beginning the second pose shows it, whatever the zero: refused, robot at rest."""
    plant.world.attach("pointer")
    plant.begin()
    message = plant.until("waiting", "stopped")

    assert message.state == "stopped"
    assert "0.237 kg hang on the sensor" in message.detail
    assert "take the tool off" in message.detail
    assert plant.stopped == 1
    assert message.pose <= 3


def test_a_tool_that_was_on_or_is_missing_when_asked_for_is_noticed(plant):
    """Nothing changes when the tool is said to be on: the sensor was loaded, or there is no tool."""
    plant.begin()
    plant.until("waiting")
    plant.ask("resume")
    message = plant.until("stopped", "moving")

    assert message.state == "stopped"
    assert "changed the reading by 0.0" in message.detail


def _averaging_with_tool(plant):
    plant.begin()
    plant.until("waiting")
    plant.world.attach("retractor")
    plant.ask("resume")
    for _ in range(9):
        plant.until("moving")
        plant.until("averaging")


DISTURBANCES = {
    "touch": (lambda p: p.world.push(force=[0.0, 2.5, 0.0], seconds=30.0), "touched"),
    "overload": (lambda p: p.world.push(force=[60.0, 0.0, 0.0], seconds=30.0), "overload"),
    "no sensor": (lambda p: p.silent.add("ft"), "no samples from ft"),
    "no joints": (lambda p: p.silent.add("motors"), "no samples from motors"),
    "emergency stop": (lambda p: setattr(p, "estop", True), "emergency stop"),
    "client gone": (lambda p: setattr(p, "heartbeats", False), "client that started the sweep is gone"),
    "Ctrl-C": (lambda p: p.ask("stop"), "stopped by request"),
}


@pytest.mark.parametrize("case", DISTURBANCES)
def test_a_disturbance_stops_the_robot_and_keeps_the_poses(plant, case):
    """Touch, overload, stale data, e-stop, lost client, Ctrl-C: motors stop, the reason is said, the poses are kept."""
    _averaging_with_tool(plant)
    disturb, reason = DISTURBANCES[case]
    disturb(plant)
    plant.run_for(3.5)
    assert plant.stopped >= 1
    plant.run_for(8.5)
    message = plant.progress[-1]
    assert message.state == "stopped"
    assert reason in message.detail
    assert reason in plant.faults[-1].what
    kept = read_recording(folder(plant))
    assert f"{len(kept)} poses kept" in message.detail
    assert (story(plant)["state"], story(plant)["poses"]) == ("stopped", len(kept))
    assert len(kept) >= 10


def test_a_disk_that_takes_nothing_more_stops_the_motors_and_is_said(plant):
    """Pose and state cannot be written: the motors stop, the reason names the file, and the service goes on."""
    _averaging_with_tool(plant)
    kept = folder(plant)
    kept.rename(kept.with_name("away"))
    kept.write_text("a file where the folder was: nothing can be written below it")
    message = plant.until("stopped", "done", seconds=30.0)

    assert message.state == "stopped"
    assert plant.stopped == 1
    assert "recording.csv: cannot be written" in message.detail
    assert "poses kept" in message.detail
    assert plant.faults[-1].what in message.detail
    plant.world.attach(None)
    kept.unlink()
    assert plant.sweep().state == "done"


def test_after_an_emergency_stop_the_way_back_can_be_typed(plant):
    """The advice names the commands as they are typed, for the configured name of the motors."""
    _averaging_with_tool(plant)
    plant.estop = True
    message = plant.until("stopped")
    words = "release it, then galen-hw command motors clear_fault, galen-hw command motors enable, and calibrate again"
    assert message.detail.endswith(words)


@pytest.mark.parametrize("device", ["ft", "motors"])
def test_a_device_that_comes_back_is_waited_for_at_rest(plant, device):
    """Silent for two seconds: the robot is stopped, the pose begins anew, and the sweep ends as if nothing had been."""
    _averaging_with_tool(plant)
    plant.until("moving")
    plant.silent.add(device)
    assert f"no samples from {device}" in plant.until("paused", seconds=3.0).detail
    assert plant.stopped == 1
    plant.run_for(1.0)
    plant.silent.clear()
    assert plant.until("done", "stopped").state == "done"

    result = analyse("retractor", poses_of(read_recording(folder(plant))).poses, "sweep")
    assert result.estimate.mass == pytest.approx(TOOLS["retractor"].mass, abs=1e-3)


def test_a_touch_that_stays_from_pose_to_pose_is_noticed(plant):
    """A cable that rests on the tool from before a hold is not a jump, but the pose does not fit the others."""
    _averaging_with_tool(plant)
    plant.until("moving")
    plant.world.push(force=[0.0, 0.0, 3.0], seconds=60.0)
    message = plant.until("stopped", "averaging", seconds=5.0)
    message = message if message.state == "stopped" else plant.until("stopped", seconds=5.0)

    assert "off what the other poses say" in message.detail


def test_a_stopped_sweep_can_begin_again(plant):
    """After a stop a new sweep runs to its end, in a folder of its own."""
    _averaging_with_tool(plant)
    plant.ask("stop")
    plant.world.attach(None)

    assert plant.sweep().state == "done"
    assert len(list((plant.state_dir / "sweeps").iterdir())) == 2


def test_a_restless_wrench_times_out_with_its_reason(tmp_path):
    """A wrench that never comes to rest ends the wait, and the channel is named."""
    plant = Plant(tmp_path, FEW.model_copy(update={"pose_timeout_s": 3.0}))
    _averaging_with_tool(plant)
    plant.hooks.append(lambda p: setattr(p, "zero", p.zero + np.array([0, 0, 0.002, 0, 0, 0])))
    message = plant.until("stopped", seconds=60.0)

    assert "Fz" in message.detail


def test_the_check_moves_slowly_and_writes_nothing(plant):
    """The check of the compensation crosses the range at its own speed and leaves no sweep."""
    plant.begin(kind="check")
    assert plant.until("done", "stopped").state == "done"

    speeds = [max(move["velocity"].values()) for move in plant.moves]
    assert speeds == [1.0, 0.11, 0.11, 1.0]
    assert not (plant.state_dir / "sweeps").exists()


def test_a_sweep_repeats_bit_for_bit(tmp_path):
    """The same messages give the same file."""
    files = []
    for name in ("a", "b"):
        plant = Plant(tmp_path / name, FEW)
        plant.sweep()
        files.append((folder(plant) / "recording.csv").read_bytes())

    assert files[0] == files[1]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300])
def test_any_number_in_a_message_is_survived(plant, value):
    """NaN and infinities, and time that goes back, and 1e300 N neither raise nor count as samples."""
    plant.begin()
    for state in ("moving", "averaging"):
        if plant.until(state, "stopped").state == "stopped":
            break
        for t_ns in (0, plant.now):
            wrench = WrenchRaw(timestamp=0, t_ns=t_ns, seq=0, valid=True, force=Vector3(value), torque=Vector3(value))
            joints = JointsState(timestamp=0, t_ns=0, seq=0, position={}, velocity={"roll": value}, effort={})
            plant.take(plant.service.handle("wrench/raw", wrench, plant.now))
            plant.take(plant.service.handle("joints/state", joints, plant.now))
            plant.take(plant.service.tick(plant.now))

    stopped = plant.progress[-1].state == "stopped"
    assert stopped is False


def test_requests_that_make_no_sense_are_refused(plant):
    """Resume when nothing waits, a second start, an unknown name: refused, and the sweep goes on."""
    with pytest.raises(CommandRejectedError, match="nothing waits"):
        plant.ask("resume")
    with pytest.raises(CommandRejectedError, match="no samples"):
        plant.service.request(Request(id="1", target="calibration", name="start", args={"tool": "x"}), plant.now)
    plant.begin()
    for name in ("start", "dance"):
        with pytest.raises(CommandRejectedError):
            plant.ask(name, tool="retractor")
    assert plant.until("waiting", "stopped").state == "waiting"


def _start_without_wrenches(plant):
    """A start while joints are known and wrenches are not."""
    plant.silent.add("ft")
    plant.hooks.append(lambda p: p.ask("heartbeat", owner="me"))
    plant.run_for(0.2)
    assert plant.service.wants == ("joints/state",)
    assert plant.ask("start", tool="retractor", owner="me") is None
    assert "wrench/raw" in plant.service.wants


def test_wrenches_are_asked_for_by_a_sweep_only(plant):
    """An idle service leaves them on the bus; a start waits for the first, and nothing has moved before its answer."""
    _start_without_wrenches(plant)
    plant.run_for(0.2)
    assert (plant.progress, plant.moves, plant.enabled) == ([], [], False)
    with pytest.raises(CommandRejectedError, match="a start runs already"):
        plant.service.request(Request(id="2", target="calibration", name="start", args={"tool": "x"}), plant.now)
    plant.silent.clear()
    plant.run_for(0.1)

    assert plant.replies["client-start"].error is None
    assert plant.replies["client-start"].result["poses"] > 0
    plant.until("waiting")
    plant.ask("stop")
    assert plant.service.wants == ("joints/state",)


def test_a_start_without_wrenches_is_refused_in_the_end(plant):
    """After `stale_s`, not sooner, and the service is as it was."""
    _start_without_wrenches(plant)
    plant.run_for(0.9 * plant.settings.stale_s)
    assert "client-start" not in plant.replies
    plant.run_for(0.2 * plant.settings.stale_s)

    error = plant.replies["client-start"].error
    assert (error.kind, error.what) == ("rejected", "no samples from ft")
    assert plant.service.wants == ("joints/state",)
    plant.silent.clear()
    plant.run_for(0.2)
    assert (plant.progress, plant.moves) == ([], [])
    assert plant.sweep().state == "done"


@pytest.mark.parametrize("end", ["stop", "daemon"])
def test_a_start_that_waits_can_be_stopped(plant, end):
    """By its owner or by anybody without a name, not by another owner; the end of the daemon answers it too."""
    _start_without_wrenches(plant)
    assert plant.ask("stop", owner="another").result == {"running": False}
    assert "client-start" not in plant.replies
    if end == "stop":
        plant.ask("stop")
    else:
        plant.take(plant.service.end(plant.now))
    assert plant.replies["client-start"].error.kind == "rejected"
    plant.silent.clear()
    plant.run_for(0.5)

    assert (plant.progress, plant.moves) == ([], [])


@contextmanager
def _served(plant, runtime):
    """The plant's service at a command socket of its own; its addresses and what was asked."""
    addresses, asked, ended = Addresses(runtime), [], threading.Event()
    runtime.mkdir()
    socket = zmq.Context.instance().socket(zmq.ROUTER)
    socket.bind(addresses.command)

    def serve():
        while not ended.is_set():
            if not socket.poll(20):
                continue
            *frames, payload = socket.recv_multipart()
            request = decode_request(payload)
            asked.append(request)
            try:
                outputs = plant.service.request(request, plant.now)
            except CommandRejectedError as error:
                outputs = [Reply(id=request.id, error=command_error(error))]
            replies = [o for o in outputs if isinstance(o, Reply) and o.id == request.id]
            plant.take([o for o in outputs if o not in replies])
            for reply in replies:
                socket.send_multipart([*frames, encode(reply)])

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield addresses, asked
    finally:
        ended.set()
        thread.join()
        socket.close()


def test_a_second_client_is_refused_and_the_first_sweep_goes_on(plant, tmp_path):
    """Neither its sweep nor its check stops the sweep that runs, and nobody is asked to touch the sensor for it."""
    plant.begin(owner="first")
    plant.heartbeats = False
    touched = []
    nobody = Operator(lambda: touched.append("bare"), lambda: touched.append("tool"))
    with _served(plant, tmp_path / "run") as (addresses, asked):
        with pytest.raises(CommandRejectedError, match="a sweep runs already"):
            run_sweep(addresses, "pointer", {}, nobody, Console(quiet=True))
        with pytest.raises(CommandRejectedError, match="a sweep runs already"):
            run_check(addresses, "pointer", Console(quiet=True))

    assert {request.name for request in asked} >= {"start", "stop"}
    assert touched == []
    assert plant.stopped == 0
    plant.hooks.append(lambda p: p.ask("heartbeat", owner="first"))
    assert plant.until("waiting", "stopped").state == "waiting"


def test_another_clients_heartbeat_keeps_no_sweep_alive(plant):
    """Only the heartbeat of whoever started it counts; an ownerless stop, and the owner's own, are always obeyed."""
    plant.begin(owner="first")
    plant.heartbeats = False
    plant.hooks.append(lambda p: p.ask("heartbeat", owner="second"))
    message = plant.until("stopped", seconds=6.0)
    assert "client that started the sweep is gone" in message.detail

    plant.hooks[-1] = lambda p: p.ask("heartbeat", owner="first")
    for owner in ({}, {"owner": "first"}):
        plant.begin(owner="first")
        assert plant.ask("stop", owner="second").result == {"running": False}
        assert plant.ask("stop", **owner).result == {"running": True}
        assert "stopped by request" in plant.progress[-1].detail


def test_a_held_sweep_moves_nothing_before_it_is_released(plant):
    """Accepted, it waits for the bare sensor however saturated that is on the way; then it goes its way."""
    plant.begin(hold=True)
    plant.world.push(force=[900.0, 0.0, 0.0], seconds=1.0)
    plant.run_for(2.0)
    assert (plant.moves, plant.enabled, plant.progress[-1].state) == ([], False, "checking")
    plant.ask("resume")
    assert plant.until("waiting", "stopped").state == "waiting"


@pytest.mark.parametrize("names", [("tilt", "roll"), ("roll", "carriage1")])
def test_counts_leave_the_configured_ranges_as_they_are(tmp_path, names):
    """`counts` change how many poses there are, never how far the robot goes nor which joints it moves."""
    ranges = (AxisSettings(low=-0.1, high=0.12, count=9), AxisSettings(low=0.0, high=0.2, count=2))
    axes = dict(zip(names, ranges, strict=True))
    plant = Plant(tmp_path, FEW.model_copy(update={"axes": axes}))
    plant.begin(counts=[2, 3])
    assert plant.until("waiting", "stopped").state == "waiting"
    goals = {name: [m["position"][name] for m in plant.moves if name in m["position"]] for name in names}

    about = plant.service._run.settings.axes
    assert {name: (axis.low, axis.high, axis.count) for name, axis in about.items()} == {
        names[0]: (-0.1, 0.12, 2),
        names[1]: (0.0, 0.2, 3),
    }
    assert all(axes[n].low - 1e-9 <= x <= axes[n].high + 1e-9 for n in names for x in goals[n])


@pytest.mark.parametrize("counts", [[3], [3, 4, 5], "3x4", [0, 4], [3, 99]])
def test_counts_that_do_not_fit_the_axes_are_refused(plant, counts):
    """As many as there are axes, each possible."""
    with pytest.raises(UsageError, match="counts: "):
        plant.begin(counts=counts)
    assert plant.moves == []


def test_a_disk_that_takes_its_time_holds_up_nothing(plant, monkeypatch):
    """While not one file reaches the disk the sweep goes on, pose by pose; it is done when all of it is there."""
    free, sync = threading.Event(), os.fsync
    monkeypatch.setattr("galen_hw.config.tool_store.os.fsync", lambda fd: (free.wait(60.0), sync(fd)))
    plant.patient = False
    plant.begin()
    plant.until("waiting")
    plant.world.attach("retractor")
    plant.ask("resume")
    poses = plant.progress[-1].poses
    plant.until("averaging")
    while plant.progress[-1].pose < poses:
        plant.run_for(0.5)
    assert not list(plant.state_dir.glob("sweeps/*/recording.csv"))
    free.set()
    plant.patient = True
    assert plant.until("done", "stopped").state == "done"
    assert len(read_recording(folder(plant))) == poses


def test_a_sweep_beyond_all_bounds_is_refused_at_once(plant):
    """Axes that are legal each, and more poses than anybody waits for: one line, and nothing has begun."""
    axes = {name: {"low": -0.05, "high": 0.05, "count": 50} for name in ("carriage1", "carriage2", "roll", "tilt")}
    begun = time.process_time()
    with pytest.raises(UsageError, match="6250000 poses are more than 1000: lower the counts of the axes"):
        plant.begin(axes=axes)
    with pytest.raises(UsageError, match="samples"):
        plant.ask("start", tool="retractor", samples=100_000)
    assert time.process_time() - begun < 1.0
    assert plant.progress == []


def test_the_largest_sweep_is_planned_while_the_loop_can_wait():
    """A thousand poses cost less than the shortest time-out of the motors."""
    most = FEW.model_copy(
        update={"axes": {n: AxisSettings(low=-0.5, high=0.5, count=k) for n, k in (("tilt", 20), ("roll", 50))}}
    )
    begun = time.thread_time()
    plan = make_plan(most, GalenRobot())
    assert time.thread_time() - begun < 0.25
    assert sum(step.kind == "fit" for step in plan.tool) == 1000


def test_the_end_of_the_daemon_is_the_end_of_the_sweep(plant):
    """The service is told that the process ends: the motors stop, and the client hears why."""
    _averaging_with_tool(plant)
    plant.take(plant.service.end(plant.now))
    assert plant.stopped == 1
    assert plant.progress[-1].state == "stopped"
    assert plant.progress[-1].detail.startswith("the daemon ends")
    plant.service.close()
    assert story(plant)["state"] == "stopped"
