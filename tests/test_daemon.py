"""The daemon's process tree, end to end: real processes, real ptys, real ZeroMQ."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.errors import CommandRejectedError, HardwareError, UsageError
from galen_hw.messages import MAX_AGE_NS, JointsState, Status, WrenchCompensated, WrenchRaw
from tests.daemon_tree import Systemd, Tree, Wire, alive, daemon_tree, within


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    """A daemon that stays up for the tests that only look and ask."""
    with daemon_tree(tmp_path_factory.mktemp("d")) as tree:
        tree.write_config("command_timeout_s = 1.0")
        config = tree.folder / "galen.toml"
        config.write_text(config.read_text().replace('viewers = ""', 'viewers = "tcp://127.0.0.1:0"'))
        tree.start_ready()
        tree.viewers = str(tree.call("daemon", "info")["viewers"])
        yield tree


@pytest.fixture
def tree(tmp_path: Path) -> Iterator[Tree]:
    """A daemon of the test's own, not started yet."""
    with daemon_tree(tmp_path) as own:
        own.write_config()
        yield own


def test_compensated_follows_raw_and_joints_without_a_gap(running: Tree) -> None:
    """Raw and joints come from two processes; every raw sample gives one compensated sample made of both."""
    with running.subscriber("wrench/") as subscriber:
        messages = [subscriber.receive(5.0) for _ in range(100)]
        assert subscriber.lost == {}
    raw: dict[int, list[float]] = {}  # lines that are read at once have one time
    for m in messages:
        if m and isinstance(m[1], WrenchRaw):
            raw.setdefault(m[1].t_ns, []).append(m[1].force.z)
    compensated = [m[1] for m in messages if m and isinstance(m[1], WrenchCompensated)]
    whole = [m for m in compensated if m.t_ns in list(raw)[1:]]  # of the first time, some may have come before

    assert len(whole) > 20
    for message in whole:
        assert any(message.force.z == pytest.approx(z - 0.5) for z in raw[message.t_ns])


def test_publications_of_other_processes_are_on_the_bus(running: Tree) -> None:
    """The motors' process publishes through the core, in order."""
    with running.subscriber("joints/state") as subscriber:
        states = [m[1] for _ in range(20) if (m := subscriber.receive(5.0))]
        assert subscriber.lost == {}

    assert [s.position["roll"] for s in states if isinstance(s, JointsState)] == [0.5] * 20


def test_viewers_read_a_copy_on_tcp(running: Tree) -> None:
    """What PlotJuggler connects to carries the same messages."""
    with Subscriber(running.viewers, ["wrench/compensated"]) as viewer:
        received = viewer.receive(5.0)

    assert received is not None
    assert received[0] == "wrench/compensated"


def test_each_process_says_how_it_is(running: Tree) -> None:
    """Statuses of both processes come within two seconds, with the wire's counters."""
    heard: dict[str, dict[str, int]] = {}
    with running.subscriber("status") as subscriber:
        until = time.monotonic() + 5.0
        while len(heard) < 2 and time.monotonic() < until:
            if received := subscriber.receive(1.0):
                heard[received[1].source] = received[1].counters

    assert heard["daemon.core"]["ft wire bytes_in"] > 0
    assert heard["daemon.motion"]["motors wire bytes_in"] > 0


def test_request_goes_to_the_owner_and_through_a_service_to_another_process(running: Tree) -> None:
    """A client asks a service, which asks the sensor of another process, whose answer finds its way back."""
    result = running.call("calibration", "zero")

    assert running.sensor.hear(b"ZERO")
    assert float(result["line"]) > 0


def test_service_of_another_process_hears_the_core(running: Tree) -> None:
    """The calibration takes the raw wrench off the bus."""
    assert within(5.0, lambda: running.call("calibration", "heard")["heard"] > 10)


@pytest.mark.parametrize(
    ("target", "name", "error", "text"),
    [
        ("motorz", "stop", UsageError, "no target 'motorz'; did you mean motors"),
        ("ft", "fly", CommandRejectedError, "no command 'fly'; one of: say"),
        ("compensation", "fail", HardwareError, "a bug"),
        ("ft", "silence", HardwareError, "no answer within 1 s"),
        ("daemon", "fly", UsageError, "one of: info"),
    ],
)
def test_every_failure_of_a_command_is_typed(
    running: Tree, target: str, name: str, error: type[Exception], text: str
) -> None:
    """Unknown, refused, failed and never answered: each with its own error, and the daemon goes on."""
    with pytest.raises(error, match=text):
        running.call(target, name)

    assert running.call("daemon", "info")["ready"]


def test_garbage_on_the_command_socket_is_answered(running: Tree) -> None:
    """Bytes that are no request get a typed error back."""
    with CommandClient(running.addresses.command) as client:
        client.socket.send_multipart([b"", b"\xc1garbage"])
        assert client.socket.poll(5000)
        assert b"not a request" in client.socket.recv_multipart()[-1]
        client.socket.send_multipart([b""])
        client.socket.send_multipart([b"a", b"b", b"c", b"", b"\x80"])
        assert client.call("daemon", "info")["ready"]


def test_second_daemon_in_the_directory_is_refused(running: Tree) -> None:
    """One line, exit status 2, and the first goes on."""
    import subprocess

    command = running.command("run", "--config", str(running.folder / "galen.toml"))
    second = subprocess.run(command, env=running.environ, capture_output=True, text=True, timeout=30, check=False)

    assert second.returncode == 2
    assert "a daemon runs here already" in second.stderr
    assert len(second.stderr.splitlines()) == 1
    assert running.call("daemon", "info")["ready"]


def test_second_daemon_elsewhere_has_viewers_at_a_free_port(running: Tree, tree: Tree) -> None:
    """Another robot's viewers hold the port: a free one is taken, said, told in `info`, and both can be looked at."""
    config = tree.folder / "galen.toml"
    config.write_text(config.read_text().replace('viewers = ""', f'viewers = "{running.viewers}"'))
    tree.start_ready()
    own = str(tree.call("daemon", "info")["viewers"])
    with Subscriber(own, ["wrench/"]) as second, Subscriber(running.viewers, ["wrench/"]) as first:
        assert second.receive(10.0) is not None
        assert first.receive(10.0) is not None
    status, stderr = tree.end()

    assert own.startswith("tcp://127.0.0.1:")
    assert own != running.viewers
    assert status == 0
    assert (
        f"viewers: {running.viewers}: Address already in use (another daemon's?); this daemon's are at {own}" in stderr
    )


def test_sigterm_rests_the_robot_first_and_leaves_nothing(tree: Tree) -> None:
    """The core lives until the motors have come to rest; then all end, with status 0."""
    process = tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    tree.motors.hush()
    tree.motors.chatter("moving", every_s=0.02)
    with tree.subscriber("joints/state") as subscriber:
        assert within(5.0, lambda: bool((m := subscriber.receive(1.0)) and m[1].moving["roll"]))
    process.send_signal(signal.SIGTERM)

    assert tree.motors.hear(b"REST")
    assert alive(pids["core"])
    tree.motors.hush()
    tree.motors.chatter("0.5", every_s=0.02)
    assert process.wait(timeout=20) == 0
    assert tree.sensor.hear(b"REST")
    assert not any(alive(pid) for pid in pids.values())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_end_of_the_parent_ends_the_daemon_with_the_robot_at_rest(tree: Tree, number: signal.Signals) -> None:
    """However the process named with --parent-pid ends, the daemon ends in order, with status 0."""
    parent = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    process = tree.start_ready("--parent-pid", str(parent.pid))
    pids = tree.call("daemon", "info")["processes"].values()
    parent.send_signal(number)
    parent.communicate()

    assert process.wait(timeout=15) == 0
    assert tree.motors.hear(b"REST")
    assert not any(alive(pid) for pid in pids)


def test_sighup_ends_the_daemon_as_sigterm_does(tree: Tree) -> None:
    """A terminal that is closed sends it to the whole tree: the robot is at rest, status 0."""
    process = tree.start_ready()
    for pid in (*tree.call("daemon", "info")["processes"].values(), process.pid):
        os.kill(pid, signal.SIGHUP)

    assert process.wait(timeout=15) == 0
    assert tree.motors.hear(b"REST")


def test_supervisor_killed_leaves_no_orphans_and_a_robot_at_rest(tree: Tree) -> None:
    """SIGKILL gives no chance to clean up: the others notice and end by themselves, motors resting."""
    process = tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    process.kill()

    assert tree.motors.hear(b"REST")
    assert within(10.0, lambda: not any(alive(pid) for pid in pids.values()))


@pytest.mark.parametrize("victim", ["core", "motion"])
def test_process_that_dies_is_started_again(tree: Tree, victim: str) -> None:
    """After SIGKILL of either process the flow comes back; if the core died, the motors are told to stop."""
    tree.start_ready()
    with tree.subscriber("wrench/compensated", "joints/state") as subscriber:
        before = tree.call("daemon", "info")["processes"][victim]
        os.kill(before, signal.SIGKILL)
        assert within(15.0, lambda: tree.call("daemon", "info")["processes"][victim] not in (0, before))
        topic = "wrench/compensated" if victim == "core" else "joints/state"
        begun = time.monotonic_ns()
        assert within(10.0, lambda: bool((m := subscriber.receive(1.0)) and m[0] == topic and m[1].t_ns > begun))
    if victim == "core":
        assert tree.motors.hear(b"STOP")


def test_what_waited_for_a_stopped_process_is_not_valid_and_not_worked_off(tree: Tree) -> None:
    """After a stop of the core the joints that waited for it are published as not valid; after one of the motors'
    process, its service goes on with what is new and the process says so."""
    tree.start_ready()
    pids = tree.call("daemon", "info")["processes"]
    limit_ns = MAX_AGE_NS["joints/state"]
    with tree.subscriber("joints/state") as subscriber:
        assert subscriber.receive(5.0)
        begun, ended = stopped(pids["core"], 3 * limit_ns)
        waited: list[JointsState] = []
        while not waited or waited[-1].t_ns < ended:
            topic, message = subscriber.receive(5.0) or ("", None)
            assert isinstance(message, JointsState), topic
            waited.append(message)
    late = [m for m in waited if begun < m.t_ns < ended - limit_ns]
    assert len(late) > 5
    assert not any(m.valid for m in late)

    with tree.subscriber("status") as subscriber:
        before = tree.call("calibration", "heard")["heard"]
        begun, ended = stopped(pids["motion"], 4 * limit_ns)
        published = (ended - begun) / 1e7  # one each 10 ms
        said: dict[str, Status] = {}

        def told() -> bool:
            if (received := subscriber.receive(1.0)) and isinstance(received[1], Status):
                said[received[1].source] = received[1]
            return "too old wrench/raw" in getattr(said.get("daemon.motion"), "counters", {})

        assert within(10.0, told), said
    counters = said["daemon.motion"].counters
    assert counters["too old wrench/raw"] + counters["passed over"] > 0.5 * published
    assert said["daemon.motion"].state == "degraded"
    assert "too busy" in said["daemon.motion"].detail
    assert within(5.0, lambda: tree.call("calibration", "heard")["heard"] > before + 10)


def stopped(pid: int, for_ns: int) -> tuple[int, int]:
    """Stop a process for so long; when it began and ended, monotonic ns."""
    os.kill(pid, signal.SIGSTOP)
    begun = time.monotonic_ns()
    within(for_ns / 1e9, lambda: False)
    ended = time.monotonic_ns()
    os.kill(pid, signal.SIGCONT)
    return begun, ended


def test_wire_that_vanishes_is_opened_again(tree: Tree) -> None:
    """The adapter is unplugged and plugged in again: the same daemon goes on."""
    link = tree.folder / "ft"
    link.symlink_to(tree.sensor.path)
    tree.write_config(ft=str(link))
    tree.start_ready()
    tree.sensor.close()
    link.unlink()
    with tree.subscriber("status") as subscriber:
        assert within(
            5.0,
            lambda: bool(
                (m := subscriber.receive(2.0))
                and m[1].source == "daemon.core"
                and m[1].state == "degraded"
                and m[1].detail
                and m[1].todo == "plug it in"
            ),
        )
    tree.sensor = Wire()
    link.symlink_to(tree.sensor.path)
    tree.sensor.chatter("7")
    with tree.subscriber("wrench/compensated") as subscriber:
        assert within(10.0, lambda: bool((m := subscriber.receive(1.0)) and m[1].force.z == pytest.approx(6.5)))


def said_at_the_end(stderr: str) -> list[str]:
    """The lines of a daemon beside those of what it waited for."""
    return [line for line in stderr.splitlines() if not line.startswith("waiting for ")]


def test_ports_that_cannot_be_opened_are_all_named(tree: Tree) -> None:
    """Both devices in one go, a line each, exit status 3."""
    tree.write_config(ft="/dev/serial/by-id/none", motors="/nowhere/either")
    process = tree.start()
    _, stderr = process.communicate(timeout=30)

    assert process.returncode == 3
    assert said_at_the_end(stderr) == [
        "galen-hw run: devices.ft (/dev/serial/by-id/none): No such file or directory; plug it in",
        "galen-hw run: devices.motors (/nowhere/either): No such file or directory; plug it in",
    ]


def test_device_that_never_answers_is_named(tree: Tree) -> None:
    """The port opens, but the motors say nothing: one line, exit status 3, and what did start is at rest."""
    tree.write_config("start_timeout_s = 2.0")
    tree.sensor.chatter("1")
    process = tree.start()
    _, stderr = process.communicate(timeout=30)

    assert process.returncode == 3
    assert said_at_the_end(stderr) == [
        "galen-hw run: devices.motors: does not answer; is it switched on, and the right device?"
    ]
    assert tree.motors.hear(b"REST")


def test_nothing_is_left_that_a_client_could_take_for_a_daemon(tree: Tree) -> None:
    """After the end there is no socket, so that a command says at once that no daemon runs."""
    tree.start_ready()
    assert tree.end()[0] == 0
    assert [path.name for path in (tree.folder / "run").iterdir()] == ["lock"]
    with pytest.raises(HardwareError, match="no daemon runs here"):
        tree.addresses.require_daemon()


def test_what_a_service_has_learnt_outlives_the_daemon(tree: Tree) -> None:
    """Kept at once, read at the next start; a damaged file is said and passed over."""
    tree.start_ready()
    tree.call("compensation", "offset", value=100.0)
    kept = tree.folder / "state" / "services" / "compensation.json"
    assert within(5.0, kept.exists)
    assert tree.end()[0] == 0
    tree.sensor.hush()
    tree.motors.hush()
    tree.start_ready()
    with tree.subscriber("wrench/") as subscriber:
        raw, compensated = 0.0, 0.0
        while not (raw and compensated):
            topic, message = subscriber.receive(5.0) or ("", None)
            raw = message.force.z if topic == "wrench/raw" else raw
            compensated = message.force.z if topic == "wrench/compensated" else compensated
    assert compensated < raw - 50.0
    assert tree.end()[0] == 0
    kept.write_text("{ half")
    tree.sensor.hush()
    tree.motors.hush()
    tree.start_ready()
    status, stderr = tree.end()

    assert status == 0
    assert "cannot be read" in stderr


def test_systemd_hears_ready_when_samples_flow_and_the_watchdog_only_while_they_do(tree: Tree) -> None:
    """READY waits for the first compensated sample; WATCHDOG ends with the samples; STOPPING at the end."""
    systemd = Systemd(tree.folder)
    try:
        tree.motors.chatter("0.5", every_s=0.02)
        tree.start(environ={"NOTIFY_SOCKET": systemd.path, "WATCHDOG_USEC": "2000000"})
        assert within(10.0, tree.addresses.lock.exists)
        assert not systemd.hears("READY=1", seconds=1.5)
        tree.sensor.chatter("1")
        assert systemd.hears("READY=1")
        systemd.heard.clear()
        assert systemd.hears("WATCHDOG=1")
        tree.sensor.hush()

        def quiet() -> bool:
            systemd.heard.clear()
            for _ in range(8):
                systemd.listen()
            return "WATCHDOG=1" not in systemd.heard

        assert within(5.0, quiet)
        status, _ = tree.end()
        while "STOPPING=1" not in systemd.heard:
            systemd.listen()
        assert status == 0
    finally:
        systemd.close()
