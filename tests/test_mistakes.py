"""The maker and the judge of ordinary mistakes: what each kind does to a right recording, what counts as an answer to it."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from galen_hw.kinematics import UrdfRobot
from galen_hw.recording import read_recording

pytest.importorskip("mujoco", reason="the generator needs MuJoCo: pip install mujoco")

from galen_hw.tools.blind_proof import seal, sections
from galen_hw.tools.blind_proof.mistakes import build, given, origins, report, turns
from galen_hw.tools.blind_proof.mistakes.case import Mistake
from galen_hw.tools.blind_proof.mistakes.kinds import KINDS
from galen_hw.tools.blind_proof.mistakes.kinds.cells import BAD_FLOAT
from galen_hw.tools.blind_proof.mistakes.origins import arm6
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, POINT, SENSOR, TORQUE, TURN, Load, Recording
from galen_hw.tools.blind_proof.mistakes.score import lines_said, score

UNCHANGED = {"raw_rows"}
"""Right as they are: the mistake would be to take each row for a pose."""


@cache
def start(family: str, needs: frozenset[str]) -> Recording:
    """A right recording of a family, made once."""
    return origins.make(family, np.random.default_rng(7), needs | {"nothing"})


def spoiled(key: str, seed: int = 0) -> tuple[Recording, Recording]:
    """A right recording and the same with a mistake of a kind, in the first family that needs no real data."""
    kind = KINDS[key]
    family = next(f for f in kind.families if f not in origins.REAL)
    right = start(family, kind.needs)
    asked = right.copy()
    made = kind.apply(asked, np.random.default_rng(seed))
    assert made.says
    return right, asked


@pytest.mark.parametrize("key", KINDS)
def test_every_kind_changes_a_right_recording_that_is_still_a_table(key: str, tmp_path: Path) -> None:
    """Columns, recording.json or a file differ, all columns stay equally long, and the folder can be written."""
    right, asked = spoiled(key)
    assert len({len(v) for v in asked.columns.values()}) == 1
    right.write(tmp_path / "right")
    asked.write(tmp_path / "asked")
    text = [
        {str(p.relative_to(tmp_path / d)): p.read_text() for p in (tmp_path / d).rglob("*") if p.is_file()}
        for d in ("right", "asked")
    ]
    assert text[0]
    assert (text[0] == text[1]) == (key in UNCHANGED)


@pytest.mark.parametrize(
    "family", ["static", "arm6-wrench", "arm6-effort", "arm6-pose", "arm6-targets", "proof-wrench", "proof-effort"]
)
def test_right_recordings_are_read_by_the_program(family: str, tmp_path: Path) -> None:
    """What a mistake is made in is a recording of the format."""
    rec = start(family, frozenset())
    assert read_recording(rec.write(tmp_path / "right")).info.predict == rec.info["predict"]


def test_the_six_joint_arm_is_the_urdf_beside_it() -> None:
    """Its efforts without friction are the inverse dynamics of the URDF that is written."""
    arm = arm6.draw(np.random.default_rng(3))
    p = arm6.path(np.random.default_rng(4), 40, 40.0)
    robot = UrdfRobot(arm6.urdf(arm))
    assert_allclose(arm6.efforts(arm, p), robot.inverse_dynamics(p.q, p.dq, p.ddq), atol=1e-6)


def test_static_poses_hold_the_load_that_is_the_truth() -> None:
    """Mass and centre of mass by plain least squares of this test."""
    rec = start("static", frozenset({"quaternion", "averages"}))
    assert rec.load is not None
    down = np.einsum("nji,j->ni", turns.from_quat(rec.get(SENSOR)), np.array([0.0, 0.0, -9.80665]))
    force = rec.get(FORCE)
    rows = np.vstack(
        [np.column_stack([down[:, k], *(np.full(len(rec), float(k == i)) for i in range(3))]) for k in range(3)]
    )
    mass = np.linalg.lstsq(rows, force.T.ravel(), rcond=None)[0][0]
    assert mass == pytest.approx(rec.load.mass, rel=0.01)
    x, y, z = (rec.load.mass * down).T
    zero, one = np.zeros(len(rec)), np.ones(len(rec))
    torque = [[zero, z, -y], [-z, zero, x], [y, -x, zero]]
    rows = np.vstack([np.column_stack([*t, *(one * (k == i) for i in range(3))]) for k, t in enumerate(torque)])
    com = np.linalg.lstsq(rows, rec.get(TORQUE).T.ravel(), rcond=None)[0][:3]
    assert_allclose(com, rec.load.com, atol=1e-3)


def test_kinds_do_what_they_say() -> None:
    """A few of each part, by their numbers."""
    right, asked = spoiled("quaternion_w_first")
    assert_allclose(asked.get(SENSOR), right.get(SENSOR)[:, [3, 0, 1, 2]])
    right, asked = spoiled("reaction_force_static")
    assert_allclose(asked.get(FORCE), -right.get(FORCE))
    assert_allclose(asked.get(TORQUE), right.get(TORQUE))
    right, asked = spoiled("mirrored")
    m = np.linalg.lstsq(right.get(FORCE), asked.get(FORCE), rcond=None)[0]
    assert np.linalg.det(m) == pytest.approx(-1)
    right, asked = spoiled("base_axes_static")
    assert_allclose(np.linalg.norm(asked.get(FORCE), axis=1), np.linalg.norm(right.get(FORCE), axis=1), rtol=1e-6)
    right, asked = spoiled("clock_back")
    assert (np.diff(asked.columns["time"]) < 0).sum() == 1
    right, asked = spoiled("ndi_bad_float")
    lost = asked.columns[POINT[0]] == BAD_FLOAT
    assert 0.01 < lost.mean() < 0.2
    assert_allclose(asked.get(TURN)[~lost], right.get(TURN)[~lost])
    right, asked = spoiled("joints_in_degrees_static")
    assert_allclose(asked.get(asked.joints()), np.degrees(right.get(right.joints())))
    right, asked = spoiled("outer_join")
    alone = np.isfinite(asked.get(asked.compared)).all(axis=1) & np.isfinite(asked.get(asked.joints())).all(axis=1)
    assert not alone.any()


@pytest.mark.parametrize("seed", range(4))
def test_a_turned_flange_is_turned_by_its_angle(seed: int) -> None:
    """The stated angle is that of the best rotation between the two wrenches (Kabsch)."""
    kind = KINDS["flange_turned"]
    right = start("arm6-wrench", frozenset())
    asked = right.copy()
    made = kind.apply(asked, np.random.default_rng(seed))
    m = np.linalg.lstsq(right.get(FORCE), asked.get(FORCE), rcond=None)[0].T
    assert np.linalg.det(m) == pytest.approx(1)
    assert made.numbers["sensor_mounting"] == pytest.approx(turns.angle(m))


def test_a_left_handed_tracker_gives_turns() -> None:
    """Its orientations are proper, of the mirrored motion: the mirrored point of a body lies where the tracker sees it."""
    right, asked = spoiled("tracker_left_handed")
    old, new = turns.from_quat(right.get(TURN)), turns.from_quat(asked.get(TURN))
    m = np.linalg.lstsq(right.get(POINT), asked.get(POINT), rcond=None)[0].T
    assert_allclose(new, np.einsum("ij,njk,lk->nil", m, old, m), atol=1e-6)


def truth(kind: str, family: str = "arm6-wrench", **more: Any) -> dict[str, Any]:
    """An unsealed case."""
    return Mistake("mistake-0000", [1, 0], kind, family, KINDS[kind].command, **more).as_dict()


def diagnosis(
    verdict: str, *found: dict[str, Any], premises: tuple[dict[str, Any], ...] = (), floor: float = 1.0
) -> dict[str, Any]:
    """An answer of `diagnose`."""
    given_json = {
        "verdict": verdict,
        "findings": list(found),
        "premises": list(premises),
        "fit": {"noise_floor": {"x": floor}},
    }
    return {"exit": 0 if verdict == "agrees" else 1, "out": "", "err": "", "seconds": 1.0, "json": given_json}


def refusal(line: str) -> dict[str, Any]:
    """An answer that is a line alone."""
    return {"exit": 2, "out": "", "err": f"galen-hw diagnose: {line}\n", "seconds": 1.0, "json": None}


def finding(effect: str, unit: str = "rad", value: float = 0.1, *others: str) -> dict[str, Any]:
    """A finding with one number."""
    confused = [{"effect": o, "why": ""} for o in others]
    return {"effect": effect, "parameters": {"p": {"value": value, "unit": unit}}, "confounded_with": confused}


def premise(what: str, action: str = "repaired") -> dict[str, Any]:
    """An entry of the JSON's premises."""
    return {"premise": "frames", "action": action, "what": what, "todo": "", "columns": []}


AGREES = diagnosis("agrees")


def test_a_refusal_that_names_the_cause_is_right_and_another_is_not() -> None:
    """Words of the cause; a consequence is not named by them."""
    case = truth("mirrored")
    right = score(case, {"asked": refusal("x of the wrench is mirrored: give it the other sign"), "control": AGREES})
    assert right.named
    assert not right.wrong
    other = score(case, {"asked": refusal("com.z is only known to 0.014 m; more poses"), "control": AGREES})
    assert not other.named
    assert not other.wrong


def test_a_crash_names_nothing() -> None:
    """Even if a trace has the words."""
    crash = refusal("Traceback (most recent call last): mirrored")
    assert not score(truth("mirrored"), {"asked": crash, "control": AGREES}).named


def test_a_name_for_what_is_not_there_is_wrong_even_beside_the_cause() -> None:
    """A payload on a mirrored wrench; unless it says that it may be what is there; `unknown` is no name."""
    case, said = truth("mirrored", effects=["gain"]), premise("y of the wrench is mirrored")
    answers = {
        "payload": diagnosis("explained", finding("payload", "kg"), premises=(said,)),
        "or gain": diagnosis("explained", finding("payload", "kg", 0.1, "gain"), premises=(said,)),
        "unknown": diagnosis("unexplained", finding("unknown"), premises=(said,)),
        "gain": diagnosis("explained", finding("gain"), premises=(said,)),
    }
    judged = {name: score(case, {"asked": answer, "control": AGREES}) for name, answer in answers.items()}
    assert all(one.named for one in judged.values())
    assert [name for name, one in judged.items() if one.wrong] == ["payload"]


def test_a_mounting_has_to_have_the_angle() -> None:
    """Named by the finding; 45 degrees for 45, and not 20."""
    case = truth("flange_turned", numbers={"sensor_mounting": 0.785})
    good = score(case, {"asked": diagnosis("explained", finding("sensor_mounting", value=-0.79)), "control": AGREES})
    assert good.right
    bad = score(case, {"asked": diagnosis("explained", finding("sensor_mounting", value=0.35)), "control": AGREES})
    assert bad.wrong == ["sensor_mounting 0.350 rad for 0.785"]


def test_what_is_said_without_the_mistake_too_is_no_answer_to_it() -> None:
    """A standing remark with other numbers."""
    asked = diagnosis("agrees", premises=(premise("Fx has the other sign by 0.2 %", "note"),))
    control = diagnosis("agrees", premises=(premise("Fx has the other sign by 0.1 %", "note"),))
    assert not score(truth("reaction"), {"asked": asked, "control": control}).named
    assert score(truth("reaction"), {"asked": asked, "control": AGREES}).named


def test_silence_is_right_only_where_the_answer_is() -> None:
    """A clock set back: agreeing is right, not so with a floor that swallows everything, nor with a name."""
    case = truth("clock_back")
    assert score(case, {"asked": AGREES, "control": AGREES}).right
    assert not score(case, {"asked": diagnosis("agrees", floor=9.0), "control": AGREES}).named
    assert not score(case, {"asked": diagnosis("explained", finding("glitches")), "control": AGREES}).right
    assert not score(truth("mirrored"), {"asked": AGREES, "control": AGREES}).named


def calibration(
    mass: float, com: tuple[float, ...], *remarks: str, premises: tuple[dict[str, Any], ...] = ()
) -> dict[str, Any]:
    """An answer of `calibrate --json` that was accepted."""
    told = {
        "accepted": True,
        "tool": {"mass": mass, "com": list(com)},
        "remarks": list(remarks),
        "premises": list(premises),
    }
    return {"exit": 0, "out": json.dumps(told), "err": "", "seconds": 1.0, "json": told}


def test_an_accepted_mass_has_to_be_true() -> None:
    """A kgf's mass is wrong without a word, a remark with one; a repair has to be right."""
    load = {"mass": 0.85, "com": [0.012, -0.004, 0.061]}
    case = truth("wrench_unit_static", "static", load=load)
    control = calibration(0.8502, (0.012, -0.004, 0.061))

    def judged(answer: dict[str, Any]) -> tuple[bool, bool]:
        one = score(case, {"asked": answer, "control": control})
        return one.named, bool(one.wrong)

    com = (0.012, -0.004, 0.061)
    assert judged(calibration(0.0867, com)) == (False, True)
    assert judged(calibration(0.0867, com, "1/9.81 of the named mass: is it in kgf?")) == (True, False)
    assert judged(calibration(0.85, com, premises=(premise("the wrench is in kgf"),))) == (True, False)
    assert judged(calibration(0.95, com, premises=(premise("the wrench is in kgf"),))) == (True, True)
    assert judged(calibration(0.85, (0.012, -0.004, -0.06))) == (False, True)


def test_a_deflection_model_must_not_miss_more_than_without_the_mistake() -> None:
    """Recommended with a thousand times the error; a remark that names the cause makes it no claim."""

    def fitted(error: float, *doubts: str) -> dict[str, Any]:
        told = {"recommended": "m", "models": {"m": {"rmse_m": {"new configuration": error}}}, "doubts": list(doubts)}
        return {"exit": 0, "out": "", "err": "", "seconds": 1.0, "json": told}

    case = truth("deflection_pose_unit", "pushed")
    silent = score(case, {"asked": fitted(0.12), "control": fitted(1.2e-4)})
    assert silent.wrong == ["recommended with 120 mm for 0.12"]
    assert score(case, {"asked": fitted(0.12, "the pose is in mm"), "control": fitted(1.2e-4)}).right


def test_a_table_on_the_screen_is_no_remark() -> None:
    """Candidates of a fit bear the names of causes; a remark begins as one."""
    answer = calibration(0.85, (0.012, -0.004, 0.061)) | {
        "err": "    + sensor mounting   13  849.9\n > + tilt of gravity\n"
    }
    assert lines_said(answer) == []
    assert lines_said(answer | {"err": " ! the wrench is mirrored\n"}) == ["! the wrench is mirrored"]
    warned = answer | {"err": "/x/y.py:4: RuntimeWarning: overflow\n  note = a / b\n"}
    assert score(truth("mirrored"), {"asked": warned, "control": AGREES}).warned
    assert lines_said(warned) == []


def test_a_premise_that_speaks_of_nothing_is_counted() -> None:
    """Repaired or refused without a mistake; a note is free."""
    control = diagnosis("agrees", premises=(premise("stamps are late", "note"),))
    assert not score(truth("mirrored"), {"asked": AGREES, "control": control}).spoken
    for bad in (refusal("the clock steps back"), diagnosis("agrees", premises=(premise("y is mirrored"),))):
        assert score(truth("mirrored"), {"asked": AGREES, "control": bad}).spoken


def test_the_truth_is_sealed_until_every_answer_is_there(tmp_path: Path) -> None:
    """Beside the data lies a digest alone; no truth without the answers, none that was changed."""
    case = build.plan(5, 1, "quaternion_w_first")[0]
    case.family = "static"
    made = build.build(case, tmp_path / case.name)
    text = seal.seal([made], tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [case.name, "truth.sha256"]
    assert not any("w first" in p.read_text() for p in tmp_path.rglob("*") if p.is_file())
    answer = tmp_path / "answer.json"
    with pytest.raises(RuntimeError, match="stays sealed"):
        seal.unseal(text, tmp_path, [answer])
    answer.write_text("{}")
    with pytest.raises(RuntimeError, match="not the one"):
        seal.unseal(text.replace("w first", "w last"), tmp_path, [answer])
    assert seal.unseal(text, tmp_path, [answer])[0]["says"] == "w first"


def test_a_plan_takes_every_kind_in_turn_and_is_the_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """All kinds before any repeats; the same seed the same plan; without real recordings none of them."""
    monkeypatch.setattr(origins.real, "data_folder", lambda: None)
    cases = build.plan(11, 2 * len(KINDS))
    assert {c.kind for c in cases[: len(KINDS)]} == set(KINDS)
    assert [c.as_dict() for c in cases] == [c.as_dict() for c in build.plan(11, 2 * len(KINDS))]
    assert not {c.family for c in cases} & origins.REAL
    with pytest.raises(ValueError, match="no kind is called nonsense"):
        build.plan(11, 3, "nonsense")


def test_the_report_keeps_what_other_commands_wrote(tmp_path: Path) -> None:
    """The section is replaced between its marks; failures stand before the kinds."""
    path = tmp_path / "proof.md"
    path.write_text("# The blind proof\n\nfigures\n")
    case = truth("mirrored", says="x y z are -x y z")
    judged = [score(case, {"asked": diagnosis("explained", finding("payload", "kg")), "control": AGREES})]
    sections.replace(path, sections.MISTAKES, report.section(judged, 1, "abc"))
    sections.replace(path, sections.MISTAKES, report.section(judged, 2, "abc"))
    text = path.read_text()
    assert text.startswith("# The blind proof\n\nfigures\n")
    assert text.count("## Ordinary mistakes") == 1
    assert "seed 2" in text
    assert text.index("**wrong: payload is not there**") < text.index("### Kinds")
    assert sections.kept(path, sections.MISTAKES).strip() in text


def test_handed_over_recordings_are_judged_by_their_readme() -> None:
    """Right and wrong answers to some of the sixteen."""
    right = given.GIVEN
    mount = diagnosis("explained", finding("sensor_mounting", value=0.785))
    assert right["mount45_moving"].right(mount)
    assert not right["mount45_moving"].right(diagnosis("explained", finding("cross_talk", "1", 3.45)))
    com = (0.012, -0.004, 0.061)
    assert right["raw_rows_no_time"].right(
        calibration(0.8501, com) | {"json": calibration(0.8501, com)["json"] | {"recommended": "robust"}}
    )
    assert not right["raw_rows_no_time"].right(calibration(0.8501, com, "the sensor drifts: Ty by 2.80 N mm"))
    assert right["kgf_tool_named"].right(calibration(0.0867, com, "1/9.81 of the named mass, is it in kgf?"))
    assert not right["left_handed_wrench"].right(calibration(0.85, (0.012, -0.004, -0.0603)))


def test_a_load_with_a_part_is_their_common_mass() -> None:
    """Mass and centre of mass of two bodies."""
    both = Load(1.0, (0.0, 0.0, 0.1)).with_part(Load(1.0, (0.0, 0.02, 0.3)))
    assert both.mass == 2.0
    assert_allclose(both.com, (0.0, 0.01, 0.2))
