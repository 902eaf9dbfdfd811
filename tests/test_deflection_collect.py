"""Collecting: the plan covers what the fit needs, a set that cannot be used is refused with what to do."""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from galen_hw.clock import TimeBase
from galen_hw.errors import UsageError
from galen_hw.identification.deflection.registration import MarkerWatch
from galen_hw.kinematics import GalenRobot
from galen_hw.messages import Message, Quaternion, TrackedPose, Vector3, WrenchRaw
from galen_hw.tools.collect import command
from galen_hw.tools.collect.command import sparkline
from galen_hw.tools.collect.plan import PLAN, Plan, make_steps
from galen_hw.tools.collect.rows import Rows
from galen_hw.tools.collect.session import CollectSession

ROBOT = GalenRobot()
BASE = TimeBase(0)
FRAME_NS = 16_666_667


def plan_in(folder: Path) -> Plan:
    return Plan(folder, "galen", "pointer", "2026-01-02", make_steps(ROBOT, 4, 12.0))


def test_a_plan_has_two_sets_a_place_between_two_calibrations_and_pushes_along_all_axes() -> None:
    """The report's eight sets and two; every axis, one askew, levels that differ; all within the joints' limits."""
    steps = make_steps(ROBOT, 4, 12.0)
    assert [s.purpose for s in steps] == ["calibration", *["pushes"] * 8, "calibration"]
    sets = steps[1:-1]
    assert [s.name for s in sets] == [f"place{k}-{turn}" for turn in (1, 2) for k in (1, 2, 3, 4)]
    for step in sets:
        pushes = np.array(step.pushes)
        assert sorted(np.argmax(np.abs(pushes[:3]), axis=1)) == [0, 1, 2]
        assert (np.linalg.norm(pushes, axis=1) <= 12.0 + 1e-9).all()
        assert np.ptp(np.linalg.norm(pushes, axis=1)) > 0.1
        assert (np.abs(pushes[3]) > 0.0).all()
    places = np.array([p for s in steps for p in s.places])
    assert ((places > ROBOT.lower) & (places < ROBOT.upper)).all()
    assert len(np.unique(np.round([s.places[0] for s in sets], 6), axis=0)) == 4


def test_a_begun_session_is_taken_up_where_it_stopped_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    """What has a recording is not asked for again; a broken plan is one line with the file's name."""
    plan = plan_in(tmp_path)
    plan.dwell_s = 3.5
    plan.save()
    (tmp_path / "calibration-1").mkdir()
    (tmp_path / "calibration-1" / "recording.json").write_text("{}")
    again = Plan.load(tmp_path)
    assert again is not None
    assert (again.dwell_s, again.steps, len(again.left)) == (3.5, plan.steps, 9)
    assert Plan.load(tmp_path / "elsewhere") is None
    (tmp_path / PLAN).write_text('{"steps": 3')
    with pytest.raises(UsageError, match=PLAN) as error:
        Plan.load(tmp_path)
    assert "\n" not in str(error.value)


def frames(rows: Rows, count: int, *, hidden: int = 0, step: int = 1) -> None:
    """Both markers in some frames, the tool hidden in the last of them; one in `step` comes."""
    rng = np.random.default_rng(0)
    for k in range(0, count, step):
        t_ns = 10**9 + k * FRAME_NS
        for topic in ("tracker/reference", "tracker/tool"):
            missing = topic == "tracker/tool" and k >= count - hidden
            head = {"timestamp": BASE.timestamp(t_ns), "t_ns": t_ns, "seq": k, "source": "tracker", "handle": "01"}
            where = Vector3(*(7e-5 * rng.normal(size=3)).tolist())
            turn = Quaternion(0.0, 0.0, 0.0, 1.0)
            message = TrackedPose(**head, valid=not missing, frame=k, position=where, orientation=turn, missing=missing)
            rows.take(topic, message)


def wrench(rows: Rows, count: int, *, saturated: int = 0) -> None:
    """Samples, some at the sensor's limit."""
    for k in range(count):
        head = {"timestamp": 0.0, "t_ns": 10**9 + k * 1_000_000, "seq": k, "source": "ft", "valid": k >= saturated}
        zero = Vector3(0.0, 0.0, 0.0)
        rows.take("wrench/raw", WrenchRaw(**head, force=zero, torque=zero, saturated=k < saturated))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ({}, ""),
        ({"hidden": 200}, "seen in 33% of the frames: turn the markers to the tracker"),
        ({"step": 3}, "frames were lost or repeated: look after the tracker's line"),
        ({"saturated": 4}, "at its limit in 4 samples: push less"),
        ({"silent": 1}, "no force was heard: galen-hw check"),
    ],
)
def test_a_set_that_cannot_be_used_says_why_and_what_to_do(spoil: dict[str, int], words: str) -> None:
    """Hidden tool, lost frames, saturated force, no force: one line each; a good set: none."""
    rows = Rows(ROBOT, MarkerWatch())
    frames(rows, 300, hidden=spoil.get("hidden", 0), step=spoil.get("step", 1))
    wrench(rows, 0 if spoil.get("silent") else 1000, saturated=spoil.get("saturated", 0))
    rows.look()
    assert len(rows.spoiled) == bool(words)
    assert words in "".join(rows.spoiled)


class Ahead:
    """A bus of a simulated robot whose clock is an hour ahead: wrenches and poses in turn, as fast as they are taken."""

    def __init__(self) -> None:
        self.count = 0

    def receive(self, seconds: float) -> tuple[str, Message]:
        """Return the next one, a millisecond after the last."""
        self.count += 1
        t_ns = time.monotonic_ns() + 3_600 * 10**9 if self.count == 1 else self.t_ns + 10**6
        self.t_ns, head = t_ns, {"timestamp": 0.0, "t_ns": t_ns, "seq": self.count, "valid": True}
        zero = Vector3(0.0, 0.0, 0.0)
        if self.count % 2:
            return "wrench/raw", WrenchRaw(**head, source="ft", force=zero, torque=zero)
        pose = {
            "handle": "01",
            "frame": self.count // 4,
            "position": zero,
            "orientation": Quaternion(0.0, 0.0, 0.0, 1.0),
        }
        return ("tracker/tool", "tracker/reference")[self.count // 2 % 2], TrackedPose(**head, source="tracker", **pose)


def test_a_robot_in_simulated_time_is_listened_to_by_its_own_clock(tmp_path: Path) -> None:
    """From the first message on: its clock, ahead of this machine's, had ended the first look after one, with no tracker."""
    bus = Ahead()
    nobody: Any = None
    session = CollectSession(plan_in(tmp_path), ROBOT, nobody, bus, nobody, nobody, print, simulated=True)  # type: ignore[arg-type]
    session._listen(1.0)
    assert bus.count == pytest.approx(1001, abs=2)


def test_a_trace_has_zero_in_the_middle() -> None:
    """A pull is low, a push is high; noise below the least scale stays flat."""
    line = sparkline(np.array([-10.0, 0.0, 10.0]))
    assert line == " ▄█"
    assert sparkline(np.array([0.0, 0.05, -0.05])) == "▄▄▄"


def arguments(*words: str) -> tuple[argparse.Namespace, dict[str, float]]:
    """Of the command, and the numbers among them that were given."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    args = parser.parse_args(["deflection", *words])
    return args, command._complete(args)


def test_a_begun_session_says_which_numbers_it_does_not_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those that differ from what it was begun with, one line each; defaults and equal ones are not spoken of."""
    folder = str(tmp_path / "s")
    args, given = arguments("-o", folder, "--configurations", "3", "--rounds", "1", "--dwell", "0.5")
    begun = command._plan(args, GalenRobot(), "pointer", given)
    assert (len(begun.steps), begun.dwell_s, begun.rest_s) == (5, 0.5, 2.0)
    capsys.readouterr()
    args, given = arguments("-o", folder, "--configurations", "2", "--dwell", "0.5", "--max-force", "5")
    assert len(command._plan(args, GalenRobot(), "pointer", given).steps) == 5
    _, *lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "--configurations 2 is ignored: the session was begun with 3; give a new folder",
        "--max-force 5 is ignored: the session was begun; give a new folder",
    ]
    args, given = arguments("-o", folder)
    command._plan(args, GalenRobot(), "pointer", given)
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_the_advice_to_go_on_keeps_the_virtual_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was begun with --virtual is gone on with --virtual."""
    plan = Plan(tmp_path, "galen", "pointer", "2026-01-01", make_steps(GalenRobot(), 2, 10.0))
    for virtual, words in ((True, "collect deflection --virtual -o "), (False, "collect deflection -o ")):
        command._left(plan, virtual=virtual)
        assert f"go on with: galen-hw {words}{tmp_path}" in capsys.readouterr().out
