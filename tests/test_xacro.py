"""Robots as xacro files: expanded by xacrodoc where a person names one, and nowhere else."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from galen_hw.cli import main
from galen_hw.errors import UsageError
from galen_hw.extras import MissingExtraError
from galen_hw.kinematics.xacro import robot_file
from tests import import_files as made
from tests.test_robot_models import RTB, TOLERANCE, loaded, mujocos, pinocchios

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("xacrodoc") is None, reason="xacrodoc is not installed: pip install 'galen-hw[xacro]'"
)
NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
TROSSEN = ("px100", "px150", "rx150", "rx200", "vx250", "vx300", "vx300s", "wx200", "wx250", "wx250s")
XACROS = () if RTB is None or RTB.origin is None else tuple(sorted(Path(RTB.origin).parent.rglob("*.xacro")))
ARMS = {p.name.partition(".")[0]: p for p in XACROS if p.name.partition(".")[0] in (*TROSSEN, "xarm6")}
"""Arms of the Robotics Toolbox that are whole there; the others lack a ROS package."""


def in_parts(folder: Path) -> Path:
    """The arm of the tests as a xacro: one link's mass an argument, the links in a file of their own beside it."""
    inside = made.arm().partition(">")[2].removesuffix("</robot>")
    assert inside.count('value="3.1"') == 1
    inside = inside.replace('value="3.1"', 'value="${2 * half}"')
    (folder / "parts").mkdir()
    (folder / "parts" / "links.xacro").write_text(
        f'<robot {NAMESPACE}><xacro:macro name="arm" params="half">{inside}</xacro:macro></robot>'
    )
    file = folder / "arm.urdf.xacro"
    file.write_text(
        f'<robot {NAMESPACE} name="arm"><xacro:include filename="parts/links.xacro"/>'
        '<xacro:arg name="half" default="1.55"/><xacro:arm half="$(arg half)"/></robot>'
    )
    return file


@pytest.fixture
def franka(tmp_path: Path) -> tuple[str, Path]:
    """A libfranka log of an arm that bears 0.5 kg, without a URDF beside it; and the arm as a xacro in another folder."""
    (tmp_path / "log").mkdir()
    log = made.libfranka(tmp_path / "log")
    (tmp_path / "log" / "arm.urdf").unlink()
    (tmp_path / "robot").mkdir()
    return str(log), in_parts(tmp_path / "robot")


@pytest.mark.skipif(not ARMS, reason="rtb-data is not installed: pip install 'galen-hw[dev]'")
@pytest.mark.parametrize("name", ARMS)
def test_arms_of_their_makers_agree_with_pinocchio_and_mujoco(name: str, tmp_path: Path) -> None:
    """Gravity and Jacobian of what the xacro expands to, to 1e-9."""
    file = tmp_path / "arm.urdf"
    file.write_text(robot_file(ARMS[name]).text)
    robot, q = loaded(file)
    torque = robot.inverse_dynamics(q[None], 0.0 * q[None], 0.0 * q[None])[0]
    jacobian = robot.sensor_jacobian(q)[0]
    # MuJoCo refuses the xArm: its second link has an inertia that no body has.
    others = [pinocchios, *([mujocos] if name in TROSSEN and importlib.util.find_spec("mujoco") else [])]
    for other in others:
        gravity, J = other(file, robot, q)
        assert_allclose(torque, gravity, atol=TOLERANCE, err_msg=other.__name__)
        assert_allclose(jacobian, J, atol=TOLERANCE, err_msg=other.__name__)


def test_the_table_of_arms_is_whole() -> None:
    assert not XACROS or set(ARMS) == {*TROSSEN, "xarm6"}


def test_check_diagnose_and_import_take_a_xacro(franka: tuple[str, Path], tmp_path: Path) -> None:
    """Its includes are found beside it, whatever the working directory; the load that nobody told of is named."""
    log, xacro = franka
    answer = tmp_path / "answer.json"
    assert main(["check", log, "--robot", str(xacro)]) == 0
    assert main(["import", log, "-o", str(tmp_path / "run"), "--robot", str(xacro)]) == 0
    assert json.loads((tmp_path / "run" / "recording.json").read_text())["robot"] == "arm.urdf"
    assert "<xacro" not in (tmp_path / "run" / "arm.urdf").read_text()
    assert main(["diagnose", log, "--robot", str(xacro), "-o", str(answer)]) == 1
    first = json.loads(answer.read_text())["findings"][0]
    assert first["effect"] == "payload"
    assert abs(first["parameters"]["mass"]["value"] - made.MASS) < 0.03


def test_an_argument_changes_the_robot(franka: tuple[str, Path], tmp_path: Path) -> None:
    """Also of a recording of our own, in place of the robot that it names."""
    log, xacro = franka
    assert main(["import", log, "-o", str(tmp_path / "run"), "--robot", str(xacro)]) == 0
    words = ["--robot", str(xacro), "--xacro-arg", "half:=2.0"]
    assert main(["import", str(tmp_path / "run"), "-o", str(tmp_path / "heavy"), *words]) == 0
    assert 'value="4.0"' in (tmp_path / "heavy" / "arm.urdf").read_text()
    assert 'value="3.1"' in (tmp_path / "run" / "arm.urdf").read_text()


def test_a_map_names_no_xacro(franka: tuple[str, Path], tmp_path: Path) -> None:
    """A URDF is written into it with its whole path; a xacro is named again each time."""
    log, xacro = franka
    (tmp_path / "robot" / "plain.urdf").write_text(made.arm())
    for robot, said in ((xacro, ""), (tmp_path / "robot" / "plain.urdf", "plain.urdf")):
        file = tmp_path / f"{robot.stem}.toml"
        assert main(["import", log, "--write-map", str(file), "--robot", str(robot)]) == 0
        named = [line for line in file.read_text().splitlines() if "robot" in line.partition("=")[0]]
        assert [str(robot)] * bool(said) == [json.loads(line.partition("=")[2]) for line in named]


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        ('<xacro:arg name="n" default="1"/><link name="$(arg m)"/>', [], "argument m has no value; --xacro-arg m:="),
        ('<link name="${1/0}"/>', [], "xacrodoc cannot expand it (division by zero"),
        ('<xacro:include filename="$(find no_such_pkg)/a.xacro"/>', [], "there is no ROS package no_such_pkg"),
        ('<xacro:include filename="none.xacro"/>', [], "No such file or directory"),
        ('<xacro:macro name="a"><xacro:a/></xacro:macro><xacro:a/>', [], "xacrodoc cannot expand it"),
        ("<link", [], "xacrodoc cannot expand it"),
        ("", ["--xacro-arg", "half=1"], "--xacro-arg half=1: not KEY:=VALUE"),
    ],
    ids=["argument", "division", "package", "include", "endless", "xml", "word"],
)
def test_what_cannot_be_expanded_is_one_line(
    text: str, words: list[str], said: str, franka: tuple[str, Path], capfd: pytest.CaptureFixture[str]
) -> None:
    log, xacro = franka
    xacro.write_text(f'<robot {NAMESPACE} name="arm">{text}</robot>')
    assert main(["check", log, "--robot", str(xacro), *words]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert said in line


def test_nothing_that_a_recording_names_is_run(
    franka: tuple[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A xacro runs Python: of a folder that came from elsewhere it is refused, with the word that takes it."""
    log, xacro = franka
    assert main(["import", log, "-o", str(tmp_path / "run"), "--robot", str(xacro)]) == 0
    info = tmp_path / "run" / "recording.json"
    info.write_text(info.read_text().replace("arm.urdf", "arm.urdf.xacro"))
    (tmp_path / "run" / "arm.urdf.xacro").write_text(xacro.read_text())
    capsys.readouterr()
    assert main(["check", str(tmp_path / "run")]) in (1, 2)
    said = capsys.readouterr()
    assert "a xacro file, which is no URDF yet" in said.out + said.err
    assert "--robot FILE.xacro" in said.out + said.err


def test_without_xacrodoc_it_is_said_what_to_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = in_parts(tmp_path)
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(MissingExtraError, match=r"xacrodoc is not installed; pip install 'galen-hw\[xacro\]'"):
        robot_file(file)


def test_words_that_go_with_no_robot_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Arguments without a xacro; a robot for the set-up, whose robot is in the settings; a file that is not there."""
    plain = tmp_path / "a.urdf"
    plain.write_text(made.arm())
    with pytest.raises(UsageError, match="it is no xacro file"):
        robot_file(plain, ["a:=1"])
    with pytest.raises(UsageError, match="no such file"):
        robot_file(tmp_path / "none.xacro")
    assert main(["check", "--robot", str(plain)]) == 2
    assert "of which recording?" in capsys.readouterr().err
    assert main(["diagnose", str(tmp_path), "--xacro-arg", "a:=1"]) == 2
    assert "of which robot?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"# Arm\n\nA paragraph.\n" * 400, "not a URDF; give a URDF or a xacro file"),
        (b"\x7fELF\x02\x01\x01\x00" * 400, "not a URDF; give a URDF or a xacro file"),
        (b'robot = "arm.urdf"\n', "not a URDF; give a URDF or a xacro file"),
        (b"<robot", "not a readable URDF (unclosed token"),
        (b"<robot/>", "not one tree of links"),
    ],
    ids=["text", "binary", "map", "cut off", "empty"],
)
@pytest.mark.parametrize("command", ["check", "diagnose"])
def test_a_file_that_is_no_robot_is_named_and_not_printed(
    command: str, content: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its content had been taken for a path where it does not begin as XML does."""
    file = tmp_path / "README.md"
    file.write_bytes(content)
    assert main([command, str(tmp_path), "--robot", str(file)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"galen-hw {command}: {file}: {said}")


def test_a_urdf_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(made.arm(), encoding="utf-8-sig")
    assert robot_file(file).text == made.arm()
