"""What joints of real machines do and plain models lack: presliding, a scale that follows a thermometer, links that sag."""

import numpy as np
import pytest

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.kinematics import UrdfRobot
from galen_hw.kinematics.delta import LinearDelta
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.effects.terms import why_not_live
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.scenes.regressed_jacobian import jacobian
from tests.diagnosis_cases import Beam, Bench, played, sines

CHAIN = """<robot name="chain"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="6"/>
<inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.2 0 0"/><mass value="4"/>
<inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="200" velocity="2"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="200" velocity="2"/></joint></robot>"""
"""Two links of 6 and 4 kg, 0.4 m long, that turn about level axes."""


def bristles(
    t: np.ndarray, v: np.ndarray, coulomb: float, stiction: float, slow: float, stiffness: float
) -> np.ndarray:
    """(N,) force of LuGre's bristles, dz/dt = v - stiffness |v| z / g, exactly for a speed that is even between the rows."""
    force, out = 0.0, np.zeros_like(v)
    for i in range(1, len(t)):
        mean = 0.5 * (v[i] + v[i - 1])
        most = coulomb + stiction * np.exp(-((mean / slow) ** 2))
        steady = most * np.sign(mean)
        force = steady + (force - steady) * np.exp(-stiffness * abs(mean) * (t[i] - t[i - 1]) / most)
        out[i] = force
    return out


def test_friction_that_is_built_up_over_some_way_is_friction() -> None:
    """As of a function of speed alone the jumps at the reversals are too sharp, and what that leaves passes for slow noise."""
    beam = Beam(3, rows=6000, rate=100.0)
    beam.effort = beam.effort + bristles(beam.t, beam.dq, 0.6, 0.25, 0.05, 60.0) + 0.3 * beam.dq
    work = diagnose(scene_of(beam.observations()))
    (found,) = work.diagnosis.findings
    assert found.effect == "friction"
    assert found.parameters["coulomb"].value == pytest.approx(0.6, rel=0.1)
    assert found.parameters["viscous"].value == pytest.approx(0.3, rel=0.3)
    assert work.diagnosis.verdict == "explained"


def test_a_screw_that_grows_is_longer_where_more_of_it_is_used() -> None:
    """Ten kelvin on 0.5 m of steel from a bearing 0.2 m off; a zero that follows the thermometer leaves half of it."""
    rng = np.random.default_rng(5)
    t = np.arange(4000) / 10.0
    command = 0.25 + sines(rng, t, 0.25, 0.02, 0.1)
    warmth = 10.0 * (1.0 - np.exp(-t / 150.0))
    position = command + 1.15e-5 * warmth * (command + 0.2) + 1e-6 * rng.normal(size=len(t))
    columns = {"time": t, "joint.x.position": position, "joint.x.command": command, "temperature.screw": 21.0 + warmth}
    work = diagnose(scene_of(Observations("position", columns, {"joint.x.position": command}, Belief(bias_free=True))))
    (found,) = work.diagnosis.findings
    assert found.effect == "temperature"
    assert found.parameters["span"].value == pytest.approx(1.15e-5, rel=0.05)
    assert found.parameters["coefficient"].value == pytest.approx(0.2 * 1.15e-5, rel=0.1)


def test_joints_give_under_the_weight_of_the_arm_s_own_links() -> None:
    """Nothing hangs on the arm and nobody pulls: the links of the URDF are all the load that there is."""
    rng = np.random.default_rng(2)
    robot, rows = UrdfRobot(CHAIN), 60
    q = np.stack([rng.uniform(-1.4, 1.4, rows), rng.uniform(-2.0, 2.0, rows)], axis=1)
    holding = robot.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))
    give = np.array([4e-4, 7e-4])
    tip = np.array([0.4, 0.0, 0.0])

    def at(angles: np.ndarray) -> np.ndarray:
        T = robot.sensor_pose(angles)
        return np.asarray(T[:, :3, 3] + T[:, :3, :3] @ tip)

    seen = at(q - give * holding) + 1e-4 * rng.normal(size=(rows, 3))
    columns = {f"joint.{name}.position": q[:, i] for i, name in enumerate(("shoulder", "elbow"))}
    columns |= dict(zip([f"pose.position.{a}" for a in "xyz"], seen.T, strict=True))
    work = diagnose(scene_of(Observations("pose", columns, None, Belief(robot=robot, tip=tip, bias_free=True))))
    assert {f.effect for f in work.diagnosis.findings} == {"compliance"}
    told = {h.effect.joint: float(work.model.final[s][0]) for h, s in _effects(work)}
    assert told == pytest.approx(dict(zip(("shoulder", "elbow"), give, strict=True)), rel=0.1)


def _effects(work):
    return [(h, s) for h, s in zip(work.model.parts, work.model.slices(), strict=True) if h.effect is not None]


def test_the_jacobian_of_a_simulation_is_that_of_the_machine() -> None:
    """A polynomial through smooth kinematics has their slopes; of what is no function of the joints there are none."""
    rng = np.random.default_rng(0)
    delta = LinearDelta()
    q = rng.uniform(-0.06, 0.06, (2000, 3))
    p, step = delta.platform(q), 1e-6
    true = np.stack(
        [(delta.platform(q + step * e) - delta.platform(q - step * e)) / (2.0 * step) for e in np.eye(3)], axis=-1
    )
    within = np.full(3, 1e-5)
    found = jacobian(q, p, within)
    assert found is not None
    np.testing.assert_allclose(found, true, atol=5e-2, err_msg="of slopes up to 1.5")
    assert jacobian(q, p + 0.01 * rng.normal(size=p.shape), within) is None
    assert jacobian(q[:30], p[:30], within) is None, "more terms than rows"
    assert jacobian(np.zeros_like(q), p, within) is None, "a joint that stands tells nothing"


def test_play_of_a_machine_whose_kinematics_nobody_gave() -> None:
    """A delta robot: its motors' angles and the simulated place of the platform are all that is known of it."""
    rng = np.random.default_rng(8)
    t = np.arange(3000) / 100.0
    delta = LinearDelta()
    q = np.stack([sines(rng, t, 0.05, 0.1, 1.0) for _ in range(3)], axis=1)
    behind = q.copy()
    behind[:, 1] = played(q[:, 1], 3e-4)
    names = [f"pose.position.{axis}" for axis in "xyz"]
    columns = {"time": t} | {f"joint.motor{i}.position": q[:, i] for i in range(3)}
    columns |= dict(zip(names, (delta.platform(behind) + 3e-5 * rng.normal(size=(len(t), 3))).T, strict=True))
    simulation = {"time": t} | dict(zip(names, delta.platform(q).T, strict=True))
    work = diagnose(scene_of(Observations("pose", columns, simulation, Belief(bias_free=True))))
    (found,) = work.diagnosis.findings
    assert (found.effect, found.joints) == ("backlash", ["motor1"])
    assert found.parameters["half_width"].value == pytest.approx(3e-4, rel=0.1)


def two_links(
    seed: int, *, rows: int = 4000, rate: float = 50.0
) -> tuple[UrdfRobot, dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """The chain in motion: robot, columns without efforts, its accelerations and efforts (N, 2) with noise of 0.05 N m."""
    rng = np.random.default_rng(seed)
    t, robot, each = np.arange(rows) / rate, UrdfRobot(CHAIN), []
    for _ in range(2):
        w, phase = 2.0 * np.pi * rng.uniform(0.05, 0.6, 4)[:, None], rng.uniform(0.0, 6.3, 4)[:, None]
        angle = w * t + phase
        each.append(0.35 * np.array([np.sin(angle), w * np.cos(angle), -w * w * np.sin(angle)]).sum(axis=1))
    q, dq, ddq = np.moveaxis(each, 0, -1)
    columns = {"time": t}
    for i, joint in enumerate(("shoulder", "elbow")):
        columns |= {f"joint.{joint}.position": q[:, i], f"joint.{joint}.velocity": dq[:, i]}
    return robot, columns, ddq, robot.inverse_dynamics(q, dq, ddq) + 0.05 * rng.normal(size=q.shape)


def found_in(robot: UrdfRobot, columns: dict[str, np.ndarray], efforts: np.ndarray):
    """Diagnose what the two joints needed."""
    own = {f"joint.{joint}.effort": efforts[:, i] for i, joint in enumerate(("shoulder", "elbow"))}
    return diagnose(scene_of(Observations("effort", columns | own, None, Belief(robot=robot, bias_free=True))))


def test_rotors_behind_gears_are_inertia_of_each_joint() -> None:
    """In proportion to the joint's own acceleration, whatever the rest of the arm does; a load moves all joints at once."""
    robot, columns, ddq, efforts = two_links(1)
    work = found_in(robot, columns, efforts + ddq * [0.3, 0.12])
    assert {f.effect for f in work.diagnosis.findings} == {"inertial"}
    told = {h.effect.joint: float(work.model.final[s][0]) for h, s in _effects(work)}
    assert told == pytest.approx({"shoulder": 0.3, "elbow": 0.12}, rel=0.1)


def test_a_box_on_a_link_in_the_middle_of_an_arm_is_told_there() -> None:
    """A kilogram on the upper arm moves the shoulder alone, and no load at the hand does."""
    robot, columns, ddq, efforts = two_links(2)
    q = columns["joint.shoulder.position"]
    efforts[:, 0] += 1.0 * (0.2**2 * ddq[:, 0] - 9.80665 * 0.2 * np.cos(q))
    work = found_in(robot, columns, efforts)
    (found,) = work.diagnosis.findings
    assert (found.effect, found.joints) == ("payload", ["shoulder"])
    assert found.parameters["mass"].value == pytest.approx(1.0, rel=0.05)


def test_a_joint_whose_grease_is_cold_at_first() -> None:
    """Twice the friction in the first minute of five; a constant friction leaves a quarter of it."""
    robot, columns, _, efforts = two_links(3, rows=6000, rate=25.0)
    v, warm = columns["joint.elbow.velocity"], np.exp(-columns["time"] / 50.0)
    efforts[:, 1] += 0.4 * np.tanh(v / 0.02) * (1.0 + warm) + 0.8 * v * (1.0 + 2.0 * warm)
    work = found_in(robot, columns, efforts)
    (found,) = work.diagnosis.findings
    assert found.effect == "friction"
    assert found.parameters["warming"].value == pytest.approx(50.0, rel=0.2)
    assert found.parameters["cold_viscous"].value == pytest.approx(1.6, rel=0.2)


def test_a_table_that_gives_under_the_moment_of_the_arm_tilts_the_base() -> None:
    """Where the arm reaches out it leans that way: an arm that pans shows that it is not the shoulder that gives."""
    rng = np.random.default_rng(3)
    pan = '<joint name="pan" type="revolute"><parent link="foot"/><child link="base"/><axis xyz="0 0 1"/><limit lower="-3" '
    pan += 'upper="3" effort="200" velocity="2"/></joint><link name="foot"/>'
    robot, rows = UrdfRobot(CHAIN.replace("</robot>", pan + "</robot>"), base_link="foot"), 80
    q = np.stack([rng.uniform(-2.5, 2.5, rows), rng.uniform(-1.4, 0.4, rows), rng.uniform(-2.0, 2.0, rows)], axis=1)
    tip, give = np.array([0.4, 0.0, 0.0]), np.array([6e-6, 4e-6, 0.0])
    T = robot.sensor_pose(q)
    place = T[:, :3, 3] + T[:, :3, :3] @ tip
    moment = np.zeros((rows, 3))
    for joint, mass in (("shoulder", 6.0), ("elbow", 4.0)):
        link = robot.link_pose(q, joint)
        moment += np.cross(link[:, :3, 3] + link[:, :3, 0] * 0.2, [0.0, 0.0, -9.80665 * mass])
    seen = place + np.cross(give * moment, place) + 2e-5 * rng.normal(size=(rows, 3))
    columns = {f"joint.{name}.position": x for name, x in zip(robot.joint_names, q.T, strict=True)}
    columns |= {f"pose.position.{a}": seen[:, k] for k, a in enumerate("xyz")}
    work = diagnose(scene_of(Observations("pose", columns, None, Belief(robot=robot, tip=tip, bias_free=True))))
    (found,) = work.diagnosis.findings
    assert found.effect == "compliance"
    told = [found.parameters[f"compliance_base_{a}"].value for a in "xy"]
    assert told == pytest.approx(give[:2], rel=0.15)


def test_a_jaw_that_opens_moves_the_centre_of_mass_with_it() -> None:
    """0.12 kg go to the side by the opening, which is recorded; a constant payload or steps of it leave the rest."""
    case = Bench(7, rows=3000)
    opening = 0.03 * (1.0 + np.sin(0.23 * case.t)) * (np.sin(0.05 * case.t) > -0.3)
    weight = 0.12 * opening[:, None] * np.einsum("nji,j->ni", case.R, [0.0, 0.0, -9.80665])
    case.wrench[:, 3:] += np.cross(np.tile([0.0, 1.0, 0.0], (len(case.t), 1)), weight)
    case.columns["covariate.gripper_opening"] = opening
    work = diagnose(scene_of(case.observations()))
    (found,) = work.diagnosis.findings
    assert found.effect == "payload"
    value = found.parameters["moment_y"]
    assert value.value == pytest.approx(0.12, rel=0.05)
    assert value.unit == "kg m a unit of gripper_opening"
    (term,) = work.diagnosis.terms
    assert "not read live" in why_not_live(term)
