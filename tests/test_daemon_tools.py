"""What people and scripts meet: monitor, command, check, the pages that tell how to subscribe, the unit file."""

import configparser
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.messages import TOPICS
from galen_hw.tools.command import parse_arguments
from galen_hw.tools.monitor.screen import BAR_WIDTH, bar
from tests.daemon_tree import Tree, daemon_tree

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    """A daemon that stays up."""
    with daemon_tree(tmp_path_factory.mktemp("d")) as tree:
        tree.write_config()
        tree.start_ready()
        yield tree


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))


def directory(tree: Tree) -> list[str]:
    return ["--dir", str(tree.addresses.runtime)]


def test_monitor_once_as_json_has_rates_ages_losses_and_the_last_message(
    running: Tree, capsys: pytest.CaptureFixture[str]
) -> None:
    """A script gets every topic with numbers; NaN becomes null."""
    assert main(["monitor", "--once", "--json", "--seconds", "2.5", *directory(running)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found)[:3] == ["schema", "software", "date"]
    wrench = found["topics"]["wrench/compensated"]

    assert wrench["rate_hz"] > 10
    assert wrench["lost"] == 0
    assert 0.0 <= wrench["age_s"] < 2.0
    assert wrench["valid_share"] == 1.0
    assert {"x", "y", "z"} == wrench["last"]["force"].keys()
    assert "daemon.core" in found["status"]


def test_monitor_once_for_people_shows_topics_bars_and_states(
    running: Tree, capsys: pytest.CaptureFixture[str]
) -> None:
    """One table with the topics, one with the wrench, one with the states."""
    assert main(["monitor", "--once", *directory(running)]) == 0
    text = capsys.readouterr().out

    for word in ("wrench/compensated", "joints/state", "force z", "N m", "daemon.motion", "ready"):
        assert word in text


def test_monitor_in_a_pipe_writes_one_screen_after_the_other(running: Tree) -> None:
    """Whole lines as they come, the wrench in each screen; Ctrl-C ends it with status 130 and one line."""
    command = running.command("monitor", *directory(running))
    with subprocess.Popen(
        command, env=running.environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        seen = 0
        for line in process.stdout:
            seen += "force z" in line
            if seen == 2:
                break
        process.send_signal(signal.SIGINT)
        left, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert not left or left.endswith("\n")
    assert said.splitlines() == ["galen-hw monitor: interrupted"]


@pytest.mark.parametrize("command", [["monitor", "--once"], ["command", "motors", "stop"]])
def test_without_a_daemon_one_line_says_how_to_start_one(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit status 3 and the two ways to start."""
    assert main(command) == 3
    error = capsys.readouterr().err

    assert len(error.splitlines()) == 1
    assert "galen-hw run --virtual" in error


def test_command_prints_the_result_for_people_and_for_scripts(
    running: Tree, capsys: pytest.CaptureFixture[str]
) -> None:
    """`key: value` lines, or JSON."""
    assert main(["command", "ft", "say", "text=hello", *directory(running)]) == 0
    assert capsys.readouterr().out.startswith("line: ")
    assert main(["command", "daemon", "info", "--json", *directory(running)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert list(said)[:3] == ["schema", "software", "date"]
    assert said["ready"] is True
    assert running.sensor.hear(b"hello")


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["ft", "fly"], 4, "galen-hw command: ft: no command 'fly'; one of: say"),
        (["fit", "say"], 2, "galen-hw command: daemon: no target 'fit'; did you mean ft?"),
        (["ft", "say", "text"], 2, "galen-hw command: 'text': not of the form key=value; e.g. tool=retractor"),
        (["ft", "say", "--timeout", "0"], 2, "galen-hw command: --timeout: must be a number of seconds above 0"),
    ],
)
def test_command_failures_are_one_line_with_their_status(
    running: Tree, words: list[str], status: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused 4, wrong use 2."""
    assert main(["command", *words, *directory(running)]) == status
    assert capsys.readouterr().err.startswith(text)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["tool=retractor"], {"tool": "retractor"}),
        (["position.roll=0.3", "position.tilt=-1e-2"], {"position": {"roll": 0.3, "tilt": -0.01}}),
        (["enabled=true", "tool=null", "x=1"], {"enabled": True, "tool": None, "x": 1}),
        (["force=[1, 2, 3]", 'm={"a": 1}', "text=a=b"], {"force": [1, 2, 3], "m": {"a": 1}, "text": "a=b"}),
    ],
)
def test_arguments_of_a_command(words: list[str], expected: dict[str, object]) -> None:
    """Words, numbers, JSON, and maps by dots."""
    assert parse_arguments(words) == expected


@pytest.mark.parametrize(
    "words",
    [
        ["x"],
        ["=1"],
        ["x=1", "x=2"],
        ["a=1", "a.b=2"],
        ["a.b=1", "a=2"],
        ["x=NaN"],
        ["a..b=1"],
        ["x=1e999"],
        ["x=" + "[" * 5000],
    ],
)
def test_impossible_arguments_are_refused(words: list[str]) -> None:
    """Nothing is guessed, and no command carries NaN."""
    with pytest.raises(UsageError):
        parse_arguments(words)


def test_bars_grow_from_the_middle() -> None:
    """Negative to the left, positive to the right, never wider than the table, NaN empty."""
    assert bar(5.0, 10.0) == " " * 10 + "│" + "█" * 5 + " " * 5
    assert bar(2.5, 10.0) == " " * 10 + "│" + "██▌" + " " * 7
    assert bar(-0.5, 10.0) == " " * 9 + "▐│" + " " * 10
    assert bar(-99.0, 10.0) == "█" * 10 + "│" + " " * 10
    assert bar(float("nan"), 10.0).strip() == "│"
    assert all(len(bar(v, 1.0)) == BAR_WIDTH for v in (-2.0, -0.3, 0.0, 0.3, 2.0))


NOWHERE = {"ft": "/dev/none", "motors": "/dev/none"}
"""Wires that cannot be opened: nobody waits for an answer."""


def check(tree: Tree, *words: str) -> tuple[int, dict[str, dict[str, object]]]:
    """Status of `galen-hw check --json` and its findings by path."""
    command = tree.command("check", "--json", "--config", str(tree.folder / "galen.toml"), *words)
    done = subprocess.run(command, env=tree.environ, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout, done.stderr
    found = {}

    def walk(finding: dict[str, object], path: str) -> None:
        found[path] = finding
        for below in finding["below"]:  # type: ignore[attr-defined]
            walk(below, f"{path}/{below['name']}".strip("/"))

    said = json.loads(done.stdout)
    assert list(said)[:3] == ["schema", "software", "date"]
    walk(said, "")
    return done.returncode, found


def test_check_looks_through_a_running_daemon(running: Tree) -> None:
    """Ports stay the daemon's: the devices are seen on the bus; a slow sensor is a problem with its rate."""
    status, found = check(running)

    assert status == 1
    assert found["devices/ft/port"]["state"] == "ok"
    assert found["devices/ft/wrench/raw"]["state"] == "problem"
    assert "nominal 1000 Hz" in str(found["devices/ft/wrench/raw"]["text"])
    assert found["devices/motors/answer"]["state"] == "ok"
    assert {"machine/disk", "machine/clock", "tools/selected", "tools/retractor"} <= found.keys()


def test_check_waits_for_every_device_of_a_virtual_robot(tmp_path: Path) -> None:
    """The tracker too, which has just been switched on."""
    command = [sys.executable, "-m", "galen_hw.cli", "check", "--virtual", "--json", "--dir", str(tmp_path)]
    environ = os.environ | {"GALEN_HW_STATE": str(tmp_path / "state")}
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=60, check=False)
    (devices,) = (one for one in json.loads(done.stdout)["below"] if one["name"] == "devices")
    answers = {d["name"]: [f["state"] for f in d["below"] if f["name"] == "answer"] for d in devices["below"]}
    assert answers == {"ft": ["ok"], "motors": ["ok"], "tracker": ["ok"]}


def test_check_names_everything_at_once(tmp_path: Path) -> None:
    """A typing error, a missing port, a silent device, a damaged tool: all in one run; settings decide the status."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config("start_timeoutt_s = 1\n[devices.other]\ndriver = 'motors'\ntransport.url = '/dev/none'")
        damaged = tree.folder / "state" / "tools" / "retractor"
        damaged.mkdir(parents=True)
        (damaged / "0001.json").write_text("{")
        (damaged / "active.json").write_text('{"generation": 1}')
        tree.sensor.chatter("1", every_s=0.0005)
        status, found = check(tree)

    problems = {path for path, finding in found.items() if finding["state"] == "problem"}
    assert status == 2
    assert any("start_timeoutt_s" in str(found[p]["text"]) for p in problems)
    assert {"devices/other/port", "devices/motors/answer", "tools/retractor"} <= problems
    assert found["devices/ft/answer"]["state"] == "ok"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[robot]\nurdf = '/nowhere/robot.urdf'", "/nowhere/robot.urdf: no such file"),
        ("[robot]\nurdf = 'ROBOT'\nsensor_link = 'sensr'", "no link 'sensr'"),
    ],
)
def test_check_builds_the_robot(tmp_path: Path, text: str, said: str) -> None:
    """A URDF that is not there, or a link that is not in it, is a problem of the settings; a good robot is shown."""
    urdf = tmp_path / "robot.urdf"
    urdf.write_text('<robot name="r"><link name="base"/></robot>')
    with daemon_tree(tmp_path) as tree:
        tree.write_config(text.replace("ROBOT", str(urdf)), **NOWHERE)
        status, found = check(tree)
        assert status == 2
        assert found["robot"]["state"] == "problem"
        assert said in str(found["robot"]["text"])
        tree.write_config(**NOWHERE)
        _, found = check(tree)
        assert found["robot"]["state"] == "ok"
        assert "roll, tilt" in str(found["robot"]["text"])


ELSEWHERE = """<robot name="arm"><link name="base"/><link name="upper"/><link name="sensor"/>
<joint name="shoulder_pan" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<joint name="mount" type="fixed"><parent link="upper"/><child link="sensor"/></joint></robot>"""


def test_joints_that_no_motor_has_are_said_by_check_and_by_the_daemon(tmp_path: Path) -> None:
    """The motors' joints are the Galen's, the URDF's are others: nothing could be compensated, and nothing is started."""
    (tmp_path / "robot.urdf").write_text(ELSEWHERE)
    (tmp_path / "galen.toml").write_text(
        f'robot = {{ urdf = "{tmp_path}/robot.urdf", sensor_link = "sensor" }}\n'
        '[devices.motors]\ndriver = "galil_dmc"\ntransport = { url = "/dev/serial/by-id/none" }\n'
    )
    environ = os.environ | {"GALEN_HW_STATE": str(tmp_path / "state")}

    def cli(*words: str) -> "subprocess.CompletedProcess[str]":
        more = ["--config", str(tmp_path / "galen.toml"), "--dir", str(tmp_path / "run")]
        command = [sys.executable, "-m", "galen_hw.cli", *words, *more]
        return subprocess.run(command, env=environ, capture_output=True, text=True, timeout=60, check=False)

    said = "no motor has the joint shoulder_pan; name them alike: there are some for carriage1, carriage2"
    looked = cli("check")
    assert looked.returncode == 2
    assert f"problem joints: {said}" in looked.stdout
    assert "note model: " in looked.stdout
    assert "no mass" in looked.stdout
    ended = cli("run")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert f"robot galen: {said}" in ended.stderr


def test_check_names_a_device_that_nothing_uses_and_a_state_that_cannot_be_kept(tmp_path: Path) -> None:
    """`motorz` is noted with what was meant; a file where the state's folder or one below it should be is a problem."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config("[devices.motorz]\ndriver = 'motors'\ntransport.url = '/dev/none'", **NOWHERE)
        (tree.folder / "state").mkdir()
        (tree.folder / "state" / "sweeps").write_text("not a folder")
        _, found = check(tree)
        assert found["devices/motorz"]["state"] in ("ok", "note")
        notes = [f for f in found["devices"]["below"] if f["name"] == "motorz"]  # type: ignore[attr-defined]
        assert ("note", "did you mean motors?") in [(f["state"], f["todo"]) for f in notes]
        assert found["machine/disk"]["state"] == "problem"
        assert "state/sweeps cannot be written (Not a directory)" in str(found["machine/disk"]["text"])
        (tree.folder / "state" / "sweeps").unlink()
        (tree.folder / "state").rmdir()
        (tree.folder / "state").write_text("not a folder")
        _, found = check(tree)
        assert "state cannot be written" in str(found["machine/disk"]["text"])


def snippets(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.DOTALL)


def test_five_lines_of_python_read_the_wrench(running: Tree) -> None:
    """The first example of docs/subscribe.md runs as it stands and prints a sample."""
    code = snippets("subscribe.md", "python")[0]
    assert len(code.strip().splitlines()) == 5

    reader = subprocess.Popen([sys.executable, "-u", "-c", code], env=running.environ, stdout=subprocess.PIPE)
    try:
        assert reader.stdout is not None
        assert select.select([reader.stdout], [], [], 20.0)[0]
        seq, valid, unzeroed, *force = reader.stdout.readline().decode().split()
    finally:
        reader.kill()
        reader.communicate()

    assert int(seq) > 0
    assert (valid, unzeroed) == ("True", "False")
    assert len(force) == 3


def test_the_examples_look_at_what_makes_a_sample_usable() -> None:
    """Each of the three reads `valid` and `unzeroed`, and the page says how to zero."""
    page = (ROOT / "docs" / "subscribe.md").read_text(encoding="utf-8")
    examples = [*snippets("subscribe.md", "python"), *snippets("subscribe.md", "cpp")]
    assert len(examples) == 3
    assert all("valid" in code and "unzeroed" in code for code in examples)
    assert "galen-hw command ft zero" in page


def test_cpp_example_reads_the_wrench(running: Tree, tmp_path: Path) -> None:
    """The C++ example of docs/subscribe.md, built as the page says and pointed at this daemon, prints samples."""
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler")
    build = ["g++", "-std=c++17", "-DMSGPACK_NO_BOOST", "-x", "c++", "-", "-lzmq", "-o", str(tmp_path / "read")]
    headers = "#include <msgpack.hpp>\n#include <zmq.h>\nint main() { return zmq_ctx_new() == nullptr; }\n"
    if subprocess.run(build, input=headers, text=True, capture_output=True, timeout=110, check=False).returncode:
        pytest.skip("no libzmq3-dev and libmsgpack-cxx-dev")
    source = snippets("subscribe.md", "cpp")[0].replace("tcp://127.0.0.1:9872", running.addresses.bus)
    done = subprocess.run(build, input=source, text=True, capture_output=True, timeout=110, check=False)
    assert done.returncode == 0, done.stderr

    reader = subprocess.Popen([tmp_path / "read"], stdout=subprocess.PIPE, text=True)
    try:
        assert reader.stdout is not None
        assert select.select([reader.stdout], [], [], 20.0)[0]
        seq, *force = reader.stdout.readline().split()
    finally:
        reader.kill()
        reader.communicate()

    assert int(seq) > 0
    assert len([float(axis) for axis in force]) == 3


def test_topic_page_is_the_topic_table() -> None:
    """docs/topics.md has a row for every topic, with its message, rate, age limit, CRTK name and meaning, and no other."""
    page = (ROOT / "docs" / "topics.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if re.match(r"\| `[a-z]+(/[a-z]+)?` \| [A-Z]", line)]
    expected = []
    for name, topic in TOPICS.items():
        rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz else "event"
        crtk = f"`{topic.crtk}`" if topic.crtk else ""
        age = f"{topic.max_age_s:g} s"
        expected.append(f"| `{name}` | {topic.message.__name__} | {rate} | {age} | {crtk} | {topic.doc} |")

    assert rows == expected


def test_unit_file_asks_systemd_for_what_the_daemon_does() -> None:
    """Type, watchdog, directories and stop order are those that the code relies on."""
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(ROOT / "config" / "galen-hw.service")
    service = dict(unit["Service"])

    assert service["Type"] == "notify"
    assert service["WatchdogSignal"] == "SIGTERM"
    assert service["KillMode"] == "mixed"
    assert (service["RuntimeDirectory"], service["StateDirectory"]) == ("galen-hw", "galen-hw")
    assert service["RestartPreventExitStatus"] == "2"
    # One process that is out of memory is ended alone: the supervisor starts it again.
    assert (service["LimitNOFILE"], service["MemoryMax"], service["OOMPolicy"]) == ("4096", "2G", "continue")
    assert {"AF_UNIX", "AF_INET", "AF_CAN"} <= set(service["RestrictAddressFamilies"].split())


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_reads_the_unit_file(tmp_path: Path) -> None:
    """No directive is unknown or misspelt, and what systemd rates as exposed stays low."""
    unit = tmp_path / "galen-hw.service"
    text = (ROOT / "config" / "galen-hw.service").read_text(encoding="utf-8")
    unit.write_text(text.replace("/opt/galen-hw/bin/galen-hw", "/bin/true"))
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    verified = subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=False, env=os.environ | {"LC_ALL": "C"}
    )

    assert "galen-hw" not in verified.stderr
