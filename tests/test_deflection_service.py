"""The deflection service: right where it can be, silent or not valid where it cannot, and quick."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import CommandRejectedError, UsageError
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.elastic_terms import Weight
from galen_hw.messages import CompensationState, Fault, Message, Pose, Request, Vector3, WrenchCompensated
from galen_hw.services.deflection.service import DeflectionService
from galen_hw.services.deflection.settings import DeflectionSettings
from galen_hw.services.deflection.store import DeflectionFile, DeflectionStore
from galen_hw.services.service import Output, ServiceContext
from galen_hw.tools.benchmarks.sample import SPRINGS, arm_of_all, spent_us
from galen_hw.tools.deflection.figures import units
from tests.compensation_parts import BASE, MS, RETRACTOR, ROBOT, joints, tool_file

TIP = RETRACTOR["tip"]
Q = np.array([0.02, -0.01, 0.03, 0.4, -0.3])


def arm(**changes: Any) -> ElasticArm:
    """With every kind of term."""
    return replace(arm_of_all(), **changes)


def service_at(folder: Path, **file: Any) -> DeflectionService:
    """A service on a fresh store with the retractor in hand and a served model."""
    tools = ToolStore(folder)
    tools.save(tool_file())
    tools.select("retractor")
    about = {"name": "arm", "robot": "galen", "tool": "retractor", "tip": TIP, "model": "elastic arm"}
    DeflectionStore(folder).save(DeflectionFile(**(about | {"values": arm().to_json()} | file)))
    return plain(folder)


def plain(folder: Path) -> DeflectionService:
    """A service on whatever is in the store."""
    return DeflectionService("deflection", DeflectionSettings(), ServiceContext(ROBOT, BASE, folder))


def wrench(t_ns: int, force: tuple[float, float, float], **more: Any) -> WrenchCompensated:
    """A push (N, sensor axes) at the tip."""
    torque = np.cross(TIP, force).tolist()
    head = {
        "timestamp": BASE.timestamp(t_ns),
        "t_ns": t_ns,
        "seq": 0,
        "valid": True,
        "tool": "retractor",
        "enabled": True,
    }
    return WrenchCompensated(**(head | {"force": Vector3(*force), "torque": Vector3(*torque)} | more))


def feed(service: DeflectionService, message: Message) -> list[Output]:
    topic = "wrench/compensated" if isinstance(message, WrenchCompensated) else "joints/state"
    return service.handle(topic, message, message.t_ns)


def poses(outputs: list[Output], topic: str) -> list[Pose]:
    return [o[1] for o in outputs if isinstance(o, tuple) and o[0] == topic and isinstance(o[1], Pose)]


def corrected(service: DeflectionService, t_ns: int, force: tuple[float, float, float], **more: Any) -> Pose:
    (pose,) = poses(feed(service, wrench(t_ns, force, **more)), "pose/corrected")
    return pose


def place(pose: Pose) -> np.ndarray:
    return np.array([pose.position.x, pose.position.y, pose.position.z])


def rigid(q: np.ndarray = Q) -> np.ndarray:
    T = ROBOT.sensor_pose(q)[0]
    return np.asarray(T[:3, :3] @ TIP + T[:3, 3])


def test_the_reported_pose_is_rigid_kinematics_and_needs_no_model(tmp_path: Path) -> None:
    """Every joint state makes one, with the tool's tip; without a model nothing is corrected."""
    ToolStore(tmp_path).save(tool_file())
    ToolStore(tmp_path).select("retractor")
    service = plain(tmp_path)
    (pose,) = poses(feed(service, joints(MS, Q, np.zeros(5))), "pose/reported")
    assert place(pose) == pytest.approx(rigid(), abs=1e-12)
    assert (pose.valid, pose.tool, pose.model) == (True, "retractor", "")
    assert feed(service, wrench(2 * MS, (1.0, 2.0, 3.0))) == []


def test_without_a_model_no_wrench_is_asked_for_and_the_tool_in_hand_is_known_all_the_same(tmp_path: Path) -> None:
    """At 1 kHz the wrenches would cost a wake-up each; which tool is in hand `compensation/state` says too."""
    ToolStore(tmp_path).save(tool_file())
    service = plain(tmp_path)
    assert service.wants == ("compensation/state", "joints/state")
    state = CompensationState(timestamp=BASE.timestamp(MS), t_ns=MS, seq=0, valid=True, tool="retractor", enabled=True)
    service.handle("compensation/state", state, MS)
    (pose,) = poses(feed(service, joints(2 * MS, Q, np.zeros(5))), "pose/reported")
    assert (pose.tool, place(pose)) == ("retractor", pytest.approx(rigid(), abs=1e-12))
    serving = service_at(tmp_path / "serving")
    assert "wrench/compensated" in serving.wants
    serving.request(Request(id="1", target="deflection", name="set_enabled", args={"enabled": False}), 0)
    assert serving.wants == service.wants


def test_a_push_moves_the_corrected_tip_by_the_springs(tmp_path: Path) -> None:
    """Springs alone and a small force: J C J^T f of the textbook."""
    small = (0.01, 0.02, -0.015)
    made = arm()
    springs = replace(made, terms=made.terms[:3], values=made.values[:3], covariance=made.covariance[:3, :3], slips={})
    service = service_at(tmp_path, values=replace(springs, weight=Weight()).to_json())
    feed(service, joints(MS, Q, np.zeros(5)))
    pose = corrected(service, 2 * MS, small)
    R, J = ROBOT.sensor_pose(Q)[0, :3, :3], ROBOT.sensor_jacobian(Q)[0]
    at_tip = J[:3] + np.cross(J[3:], R @ TIP, axis=0)
    C = sum(SPRINGS[n] * np.outer(at_tip[:, i], at_tip[:, i]) for n, i in (("roll", 3), ("tilt", 4)))
    C[2, 2] += SPRINGS["structure.z"]
    assert place(pose) - rigid() == pytest.approx(C @ R @ small, rel=1e-3, abs=1e-10)
    assert pose.valid
    assert np.linalg.eigvalsh(np.reshape(pose.covariance, (6, 6))).min() > -1e-18
    assert pose.model == "arm/0001"


def test_what_is_left_after_a_release_is_remembered_over_a_restart(tmp_path: Path) -> None:
    """Friction holds the tip off; a snapshot carries that on, less surely."""
    service = service_at(tmp_path)
    feed(service, joints(MS, Q, np.zeros(5)))
    before = place(corrected(service, 2 * MS, (0.0, 0.0, 0.0)))
    for k in range(200):
        corrected(service, (3 + k) * MS, (8.0 * np.sin(np.pi * k / 200), 0.0, 4.0 * np.sin(np.pi * k / 200)))
    after = corrected(service, 204 * MS, (0.0, 0.0, 0.0))
    assert np.linalg.norm(place(after) - before) > 2e-5
    again = plain(tmp_path)
    assert again.restore(service.snapshot())
    feed(again, joints(205 * MS, Q, np.zeros(5)))
    later = corrected(again, 206 * MS, (0.0, 0.0, 0.0))
    assert place(later) == pytest.approx(place(after), abs=2e-7)
    assert sum(later.covariance[::7]) > 1.05 * sum(after.covariance[::7])


def test_a_gap_grows_the_covariance_and_another_clock_resets(tmp_path: Path) -> None:
    """Ten missed seconds keep the memory; a second back starts afresh, unsure; a late sample alone is not valid."""
    service = service_at(tmp_path)
    for t_ms in (1000, 11_000):
        feed(service, joints(t_ms * MS, Q, np.zeros(5)))
        if t_ms == 1000:
            begun = corrected(service, t_ms * MS, (5.0, 0.0, 0.0))
            for k in range(1, 60):
                size = 9.0 * np.cos(np.pi * k / 10) if k < 50 else 5.0
                sure = corrected(service, (t_ms + k) * MS, (size, size, size) if k < 50 else (5.0, 0.0, 0.0))
    unsure = corrected(service, 11_001 * MS, (5.0, 0.0, 0.0))
    assert unsure.valid
    assert sum(unsure.covariance[::7]) > 1.05 * sum(sure.covariance[::7])
    assert not corrected(service, 11_000 * MS, (9.0, 9.0, 9.0)).valid, "a sample that comes late"
    assert place(corrected(service, 11_002 * MS, (5.0, 0.0, 0.0))) == pytest.approx(place(unsure), abs=1e-6)
    feed(service, joints(100 * MS, Q, np.zeros(5)))
    fresh = corrected(service, 101 * MS, (5.0, 0.0, 0.0))
    assert fresh.valid
    assert sum(fresh.covariance[::7]) == pytest.approx(sum(begun.covariance[::7]), rel=0.05)


@pytest.mark.parametrize(
    ("file", "word", "todo"),
    [
        ({"robot": "other"}, "robot", "galen-hw deflection"),
        ({"virtual": True}, "virtual robot", "galen-hw deflection"),
        ({"tool": "pointer"}, "tool", "galen-hw calibrate --tool pointer, then galen-hw tool select pointer"),
        ({"tip": (0.0, 0.0, -0.2)}, "tip", "galen-hw deflection"),
        ({"robot": "other", "tool": "pointer"}, "robot", "galen-hw deflection"),
    ],
)
def test_a_model_of_another_robot_or_tool_is_refused(
    tmp_path: Path, file: dict[str, Any], word: str, todo: str
) -> None:
    """A fault says what, where and what to do, and no corrected pose is valid."""
    service = service_at(tmp_path, **file)
    feed(service, joints(MS, Q, np.zeros(5)))
    assert not corrected(service, 2 * MS, (1.0, 0.0, 0.0)).valid
    (fault,) = [o[1] for o in service.tick(3 * MS) if isinstance(o, tuple) and isinstance(o[1], Fault)]
    assert word in fault.what
    assert fault.where == "deflection"
    assert fault.todo.startswith(todo)


def test_with_no_tool_in_hand_the_missing_command_is_named(tmp_path: Path) -> None:
    """Calibrated and not selected: one command; selected and yet not compensated: the compensation's switch."""
    service = service_at(tmp_path)
    feed(service, joints(MS, Q, np.zeros(5)))
    for selected, todo in ((None, "galen-hw tool select retractor"), ("retractor", "set_enabled enabled=true")):
        ToolStore(tmp_path).select(selected)
        feed(service, wrench(2 * MS, (1.0, 0.0, 0.0), tool="retractor"))
        feed(service, wrench(3 * MS, (1.0, 0.0, 0.0), tool=""))
        found = [o[1] for o in service.tick(4_000_000_000 * (1 + bool(selected))) if isinstance(o, tuple)]
        (fault,) = [m for m in found if isinstance(m, Fault)]
        assert "in hand is 'no tool'" in fault.what
        assert todo in fault.todo


def test_the_toggle_stops_it_and_reload_takes_a_new_generation(tmp_path: Path) -> None:
    """Off: the reported pose alone; on again: as before; a newly saved model after reload."""
    service = service_at(tmp_path)
    feed(service, joints(MS, Q, np.zeros(5)))
    service.request(Request(id="1", target="deflection", name="set_enabled", args={"enabled": False}), 0)
    assert feed(service, wrench(2 * MS, (1.0, 0.0, 0.0))) == []
    service.request(Request(id="2", target="deflection", name="set_enabled", args={"enabled": True}), 0)
    assert corrected(service, 3 * MS, (1.0, 0.0, 0.0)).valid
    store = DeflectionStore(tmp_path)
    store.save(store.load("arm"))
    service.request(Request(id="3", target="deflection", name="reload"), 0)
    feed(service, joints(4 * MS, Q, np.zeros(5)))
    assert corrected(service, 5 * MS, (1.0, 0.0, 0.0)).model == "arm/0002"
    assert store.rollback("arm").id == "arm/0001"
    with pytest.raises(CommandRejectedError):
        service.request(Request(id="4", target="deflection", name="set_enabled", args={"enabled": 1}), 0)
    with pytest.raises(UsageError, match="no earlier generation"):
        store.rollback("arm")


def test_a_refused_reload_leaves_the_model_in_use(tmp_path: Path) -> None:
    """A damaged file: said, and the pose goes on being corrected with what was read before."""
    service = service_at(tmp_path)
    feed(service, joints(MS, Q, np.zeros(5)))
    first = corrected(service, 2 * MS, (3.0, 0.0, 0.0))
    (DeflectionStore(tmp_path).folder / "arm.json").write_text("{", encoding="utf-8")
    with pytest.raises(UsageError):
        service.request(Request(id="1", target="deflection", name="reload"), 0)
    again = corrected(service, 3 * MS, (3.0, 0.0, 0.0))

    assert again.valid
    assert again.model == first.model


@pytest.mark.parametrize("more", [{"valid": False}, {"enabled": False}, {"torque": Vector3(float("nan"), 0.0, 0.0)}])
def test_an_unusable_wrench_leaves_the_memory_alone(tmp_path: Path, more: dict[str, Any]) -> None:
    """Not valid, not compensated or not a number: not valid, and the next good sample is as if it had not been."""
    service = service_at(tmp_path)
    feed(service, joints(MS, Q, np.zeros(5)))
    first = corrected(service, 2 * MS, (3.0, 0.0, 0.0))
    assert not corrected(service, 3 * MS, (9.0, 9.0, 9.0), **more).valid
    assert place(corrected(service, 4 * MS, (3.0, 0.0, 0.0))) == pytest.approx(place(first), abs=1e-7)


def test_old_joints_make_it_not_valid_and_moving_ones_carry_it_on(tmp_path: Path) -> None:
    """Between joint states the tip moves with the joints' rates; later than the bound it is held and not valid."""
    service = service_at(tmp_path)
    rate = np.array([0.0, 0.0, 0.0, 0.2, -0.1])
    feed(service, joints(100 * MS, Q, rate))
    still = place(corrected(service, 100 * MS, (0.0, 0.0, 0.0)))
    moved = corrected(service, 120 * MS, (0.0, 0.0, 0.0))
    assert place(moved) - still == pytest.approx(rigid(Q + 0.02 * rate) - rigid(), abs=3e-6)
    assert moved.valid
    assert not corrected(service, 190 * MS, (0.0, 0.0, 0.0)).valid


@pytest.mark.slow
def test_a_sample_costs_little() -> None:
    """CPU time of nine samples of ten within 300 us in the quietest of ten stretches: other tests take caches and cycles away.

    The p99 of a machine of its own is what `make bench` measures.
    """
    assert np.quantile(np.reshape(spent_us(5000), (10, -1)), 0.9, axis=1).min() < 300.0


def test_parameters_of_the_page_have_their_units() -> None:
    """Joints that turn in rad under N m, structure in m under N; hardening by its power, play without a load."""
    assert units(arm(), ROBOT) == [
        "rad/(N m)",
        "rad/(N m)",
        "m/N",
        "rad/(N m)",
        "rad/(N m)",
        "rad/(N m)^2",
        "rad",
    ]
