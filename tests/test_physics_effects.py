"""Every effect of the table, in every group where it can show, against the conformance checks; batch against stream."""

import dataclasses
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from conformance import check_effect
from physics_scenes import JOINTS, belief, proposals, scene

from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.compliance import Compliance
from galen_hw.physics.effects.events import Contact
from galen_hw.physics.effects.geometry import JointOffset, JointScale
from galen_hw.physics.effects.live import EffectStream, build_streams
from galen_hw.physics.effects.load import Payload
from galen_hw.physics.effects.registry import EFFECTS, effect_class, scene_of
from galen_hw.physics.rigid import predicted_wrench

GROUPS = ("wrench", "pose", "targets", "effort", "position")


@pytest.mark.parametrize("group", GROUPS)
def test_every_hypothesis_holds_to_the_contract(group):
    """Null is exactly null, columns are the slope, terms come back, in all five groups."""
    made, found = proposals(group)
    assert len(found) > 20
    for effect in found:
        for check in check_effect.CHECKS:
            check(effect, made)


def test_every_key_of_the_table_loads_and_says_what_it_is():
    """Docstrings hold equation, visibility and look-alikes; keys agree with classes."""
    for key in EFFECTS:
        assert key == effect_class(key).KEY, key
        if key != "unknown":
            check_effect.check_docstring(effect_class(key))


def test_an_unknown_key_is_one_clear_line():
    """A term of a newer version says which effects are known."""
    with pytest.raises(UsageError, match="no effect 'quantum'"):
        effect_class("quantum")


def streamable() -> list[Effect]:
    _, found = proposals("wrench")
    return [e for e in found if e.KEY not in ("temperature", "contact", "glitches", "saturation")]


@pytest.mark.parametrize("effect", streamable(), ids=lambda e: e.KEY)
def test_a_stream_gives_what_the_batch_gives(effect):
    """Sample by sample or all at once, to rounding, memory carried along."""
    made, _ = proposals("wrench")
    theta = np.full(len(effect.parameters(made)), 0.013)
    batch = effect.change(made, theta)
    stream = EffectStream([(effect, theta)], JOINTS, belief())
    rows = [
        stream.at(made.time[k], made.q[k], made.rates[0][k], made.rates[1][k], made.simulated[k])
        for k in range(len(made))
    ]
    if effect.KEY == "time_delay":
        np.testing.assert_allclose(np.array(rows), batch, atol=1e-9 * np.abs(batch).max() + 1e-12)
    else:
        np.testing.assert_allclose(np.array(rows), batch, atol=1e-11 * max(np.abs(batch).max(), 1.0))


def test_saved_terms_build_streams_and_outside_forces_do_not():
    """What cannot be predicted live is refused, never applied by half."""
    made, found = proposals("wrench")
    creep = next(e for e in found if e.KEY == "creep")
    term = creep.to_term(made, np.array([0.02]))
    streams = build_streams([term], joint_names=JOINTS, robot=GalenRobot())
    assert len(streams) == 1
    with pytest.raises(UsageError, match="cannot be predicted live"):
        build_streams([{"effect": "contact", "parameters": {}}], joint_names=JOINTS, robot=GalenRobot())
    broken = {"effect": "creep", "parameters": {k: v for k, v in term["parameters"].items() if k != "share"}}
    with pytest.raises(UsageError, match="no parameter"):
        build_streams([broken], joint_names=JOINTS, robot=GalenRobot())


@pytest.mark.parametrize("group", ["wrench", "effort"])
def test_a_point_of_mass_has_the_inertia_of_its_place(group):
    """The same as a body with any inertia whose inertia is m (c.c 1 - c c^T); told by mass and moment alone."""
    made = scene(group, np.random.default_rng(1))
    mass, c = 0.013, np.array([0.02, -0.03, -0.11])
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    body = np.concatenate([[mass], mass * c])
    whole = np.concatenate([body, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    told = Payload("full").told_by(whole)
    assert told is not None
    np.testing.assert_allclose(told.at, c)
    np.testing.assert_allclose(told.change(made, body), Payload("full").change(made, whole), atol=1e-13)
    for near in body * (1.0 + 1e-4 * (np.eye(4) - np.eye(4)[::-1])):
        moved = near[1:] / near[0]
        inertia = near[0] * (moved @ moved * np.eye(3) - np.outer(moved, moved))
        change = told.body(made, near)[4:] - told.body(made, body)[4:]
        np.testing.assert_allclose(change, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]] - whole[4:], atol=1e-11)
    assert Payload("body").told_by(np.array([0.001, 0.0, 0.0, 0.001])) is None, "a metre away is on no tool"
    assert Payload("moment").told_by(body[1:]) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_tool_and_what_was_put_on_it_are_together_a_distribution_of_mass(seed):
    """Points of mass added to the tool can be; what leaves it an axis along which its mass has no spread cannot."""
    rng = np.random.default_rng(seed)
    made = scene("wrench", rng)
    tool = made.belief.tool
    assert tool.mass > 0.0
    at, part = rng.normal(size=(3, 3)) * 0.1, 0.02
    added = [part * (c @ c * np.eye(3) - np.outer(c, c)) for c in at]
    inertia, spread = np.sum(added, axis=0), np.full(10, 1e-7)
    body = np.concatenate([[3 * part], part * at.sum(axis=0), inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    assert Payload("full").possible(made, body, spread)
    # The second moments along x, (yy + zz - xx) / 2, with the tool's own: less than none.
    own = tool.inertia + tool.mass * (tool.com @ tool.com * np.eye(3) - np.outer(tool.com, tool.com))
    short = np.zeros(10)
    spread_along = 0.5 * np.trace(own) - own[0, 0] - tool.mass * tool.com[0] ** 2
    short[[6, 9]] = -(spread_along + 1e-4)
    assert not Payload("full").possible(made, short, spread)
    assert Payload("full").possible(made, short, np.where(np.arange(10) >= 4, 5e-5, 1e-7)), (
        "within its errors it can be"
    )
    assert Payload("body").possible(made, short[:4], spread[:4])
    assert not Payload("full").possible(made, np.array([-2.0 * tool.mass, *np.zeros(9)]), spread)


def test_segments_start_afresh():
    """Memory does not leak from one run to the next."""
    made, found = proposals("wrench")
    observations = made.observations
    columns = dict(observations.columns) | {"segment": (np.arange(len(made)) >= 200).astype(float)}
    cut = scene_of(dataclasses.replace(observations, columns=columns))
    late = scene_of(observations.taken(slice(200, None)))
    effect = next(e for e in found if e.KEY == "hysteresis")
    theta = np.ones(len(effect.parameters(made)))
    np.testing.assert_allclose(effect.change(cut, theta)[200:], effect.change(late, theta), atol=1e-12)


@pytest.mark.parametrize("joint", ["roll", "tilt"])
def test_an_arm_sags_under_all_that_hangs_on_it(joint):
    """The load of a joint is how the potential energy of the tool and of the body before it falls with its angle."""
    made = scene("pose", np.random.default_rng(8), rows=30)
    believed, robot, step = made.belief, GalenRobot(), 1e-6

    def work(q):
        T = robot.sensor_pose(q)
        bodies = (believed.tool, believed.bias_body)
        return sum(b.mass * (T[:, :3, :3] @ b.com + T[:, :3, 3]) @ believed.gravity for b in bodies)

    move = step * (np.arange(5) == JOINTS.index(joint))
    np.testing.assert_allclose(
        made.weight_load(joint), (work(made.q + move) - work(made.q - move)) / (2 * step), atol=1e-6
    )
    sag, bare = (Compliance("structure", source=source).columns(made).values[:, 2, 2] for source in ("all", "applied"))
    np.testing.assert_allclose(sag - bare, (0.287 + 0.085) * believed.gravity[2])


@pytest.mark.parametrize(
    ("effect", "joints"),
    [
        (JointOffset("tilt"), lambda q, d: q + d * (np.arange(5) == 4)),
        (JointOffset("roll"), lambda q, d: q + d * (np.arange(5) == 3)),
        (JointScale("roll"), lambda q, d: q * (1.0 + d * (np.arange(5) == 3))),
    ],
)
def test_an_arm_that_is_wrong_was_wrong_when_the_sensor_was_zeroed(effect, joints):
    """The bias body was weighed away in the pose in which the arm really stood, not in the one that it reported."""
    made = scene("wrench", np.random.default_rng(5), rows=50, dynamic=False)
    zeroed, robot = np.array([0.0, 0.0, 0.0, 0.2, -0.1]), GalenRobot()
    known = dataclasses.replace(
        made.belief, zeroed_rotation=robot.sensor_pose(zeroed)[0, :3, :3], zeroed_joints=zeroed, dynamic=False
    )
    told = scene_of(dataclasses.replace(made.observations, belief=known))
    error = 0.02

    def reading(q):
        R, R0 = robot.sensor_pose(joints(q, error))[:, :3, :3], robot.sensor_pose(joints(zeroed, error))[0, :3, :3]
        return predicted_wrench(R, known.tool, bias_body=known.bias_body, zeroed_rotation=R0, gravity=known.gravity)

    expected = reading(told.q) - told.simulated
    np.testing.assert_allclose(effect.exact(told, np.array([error])), expected, atol=1e-9)
    slope = effect.columns(told).full(6)[:, :, 0]
    assert np.max(np.abs(slope * error - expected)) < 0.03 * np.max(np.abs(expected))
    # Where the joints stood is not known, the zero is taken for right.
    assert scene_of(dataclasses.replace(told.observations, belief=made.belief)).zeroing is None


def test_a_touch_of_many_half_waves_needs_no_memory_for_all_of_its_rows():
    """What is averaged is averaged shape by shape: ten touches of twenty half waves are no two hundred signals at once."""
    rows = 20_000
    made = scene("wrench", np.random.default_rng(4), rows=rows)
    touch = Contact((made.channels[0],), tuple((20.0 * k, 20.0 * k + 15.0) for k in range(10)), waves=20)
    coarse = Rows((slice(0, rows),), 20)
    tracemalloc.start()
    shapes = touch.shapes(made, coarse.average)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert shapes.shape == (1000, 210)
    assert peak < 10 * 8 * rows + 3 * shapes.nbytes
    np.testing.assert_allclose(shapes, coarse.average(touch.shapes(made, np.asarray)))
