"""The compensation service: exact on exact data, honest about its joints, smooth in its changes, and unbreakable."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.config.tool_file import BiasBody
from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import CommandRejectedError, UsageError
from galen_hw.kinematics import UrdfRobot
from galen_hw.messages import JointsState, Reply, Status, Vector3, WrenchRaw, encode
from galen_hw.physics.rigid import Body, inertial_wrench
from galen_hw.services.compensation.gravity_direction import GravityDirection
from galen_hw.services.compensation.service import CompensationService
from galen_hw.services.compensation.settings import CompensationSettings
from galen_hw.services.service import ServiceContext
from galen_hw.spatial import transform, wrench_adjoint
from tests.compensation_parts import (
    BASE,
    MS,
    RETRACTOR,
    ROBOT,
    ask,
    feed,
    joints,
    messages,
    raw,
    service_at,
    six,
    tool_file,
    true_wrench,
)

SKEW = """<robot name="skew"><link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="sensor"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0.6 0 0.8"/>
<origin xyz="0.1 0 0.2" rpy="0.3 -0.2 0.5"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.1" rpy="0 1.1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="two" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 -1 0"/>
<origin xyz="0 0.2 0" rpy="-0.7 0 0.2"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="mount" type="fixed"><parent link="c"/><child link="sensor"/>
<origin xyz="0 0 0.05" rpy="0.2 0.4 -1.3"/></joint>
</robot>"""

angles = st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5)
numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_the_direction_of_gravity_is_that_of_any_robot(q: list[float]) -> None:
    """The product of exponentials in plain floats gives R(q)^T g of the kinematics, with skew and sliding joints."""
    robot = UrdfRobot(SKEW, sensor_link="sensor", gravity=[1.0, -2.0, -9.0])
    direction = GravityDirection(robot)
    expected = robot.sensor_pose(q)[0, :3, :3].T @ robot.gravity
    assert direction([q[i] for i in direction.joints]) == pytest.approx(expected, abs=1e-12)
    assert direction.joints == (0, 2), "the sliding joint does not turn the sensor"


@settings(max_examples=60)
@given(
    q=angles,
    mass=st.floats(0.01, 3.0),
    com=st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    bias_mass=st.floats(0.0, 0.5),
    zeroed=st.one_of(st.none(), angles),
)
def test_exact_data_leaves_nothing(
    tmp_path_factory: pytest.TempPathFactory,
    q: list[float],
    mass: float,
    com: tuple[float, float, float],
    bias_mass: float,
    zeroed: list[float] | None,
) -> None:
    """Equations 11 and 12: at rest, in any pose, with any bodies and zeroing pose, measured minus predicted is zero."""
    at = None if zeroed is None else dict(zip(ROBOT.joint_names, zeroed, strict=True))
    tool = tool_file(mass=mass, com=com, zeroed_at=at, bias_body=BiasBody(mass=bias_mass, com=(0.01, 0.02, 0.03)))
    service = service_at(tmp_path_factory.mktemp("state"), tool)
    feed(service, joints(1 * MS, np.array(q), np.zeros(5)))
    (out,) = messages(feed(service, raw(2 * MS, true_wrench(tool, np.array(q)))))
    assert np.abs(six(out)).max() < 1e-12
    assert out.valid
    assert (out.tool, out.calibration) == ("retractor", service.request(ask("reload"), 0)[0].result["calibration"])


def test_the_contact_wrench_is_the_same_wrench_about_the_contact_point(tmp_path: Path) -> None:
    """`wrench/contact` is the adjoint of the compensated wrench; a push at that point leaves no torque there."""
    tool = tool_file()
    service = service_at(tmp_path, tool, blend_s=0.0)
    q = np.array([0.0, 0.0, 0.0, 0.4, -0.3])
    feed(service, joints(MS, q, np.zeros(5)))
    point, push = np.array(tool.tip), np.array([1.0, -2.0, 3.0])
    reading = true_wrench(tool, q) + np.concatenate([push, np.cross(point, push)])
    outputs = feed(service, raw(2 * MS, reading))
    (compensated,), (contact,) = messages(outputs), messages(outputs, "wrench/contact")
    assert six(contact) == pytest.approx([*push, 0, 0, 0], abs=1e-12)
    assert six(contact) == pytest.approx(wrench_adjoint(transform(np.eye(3), -point)) @ six(compensated), abs=1e-12)
    service.request(ask("set_contact", x=0.1, y=0.2, z=0.3), 0)
    moved = messages(feed(service, raw(3 * MS, reading)) + feed(service, raw(4 * MS, reading)), "wrench/contact")[-1]
    assert six(moved)[3:] == pytest.approx(np.cross(point - [0.1, 0.2, 0.3], push), abs=1e-12)


def test_joints_are_carried_on_by_their_velocity_and_no_further_than_the_bound(tmp_path: Path) -> None:
    """In uniform motion extrapolation is exact; beyond the bound it is held, flagged, and not valid."""
    tool, rate = tool_file(), np.array([0.0, 0.0, 0.0, 0.5, -0.4])
    service = service_at(tmp_path, tool, max_extrapolation_s=0.06)
    feed(service, joints(100 * MS, rate * 0.1, rate))
    for late in (0, 1, 25, 60):
        q = rate * (0.1 + late * 1e-3)
        (out,) = messages(feed(service, raw((100 + late) * MS, true_wrench(tool, q))))
        assert np.abs(six(out)).max() < 1e-12
        assert (out.valid, out.joints_extrapolated, out.joints_age_s) == (True, False, late * 1e-3)
    (out,) = messages(feed(service, raw(161 * MS, true_wrench(tool, rate * 0.161))))
    assert (out.valid, out.joints_extrapolated) == (False, True)


def test_the_error_of_extrapolation_is_half_the_acceleration_times_the_time_squared(tmp_path: Path) -> None:
    """2 rad/s^2 for 30 ms: 0.9 mrad, 4 mN of a weight of 3.8 N, under the sensor's noise of 15 mN."""
    tool = tool_file()
    service = service_at(tmp_path, tool)
    feed(service, joints(MS, np.zeros(5), np.zeros(5)))
    q = np.array([0, 0, 0, 0.5 * 2.0 * 0.03**2, 0])
    (out,) = messages(feed(service, raw(31 * MS, true_wrench(tool, q))))
    bound = (0.3 + 0.09) * 9.80665 * 0.5 * 2.0 * 0.03**2
    assert 0.9 * bound < np.abs(six(out)[:3]).max() <= bound
    assert bound < 0.004


def test_between_two_joint_states_positions_are_interpolated(tmp_path: Path) -> None:
    """A sample that arrives after a newer joint state uses the line between the two around it."""
    tool = tool_file()
    service = service_at(tmp_path, tool)
    first, last = np.array([0, 0, 0, 0.1, 0.2]), np.array([0, 0, 0, 0.3, -0.2])
    feed(service, joints(10 * MS, first, np.full(5, 9.0)))
    feed(service, joints(30 * MS, last, np.full(5, 9.0)))
    (out,) = messages(feed(service, raw(15 * MS, true_wrench(tool, 0.75 * first + 0.25 * last))))
    assert np.abs(six(out)).max() < 1e-12
    assert out.valid
    (early,) = messages(feed(service, raw(5 * MS, true_wrench(tool, first))))
    assert not early.valid, "before the first joint state nothing is known"


def test_without_measured_velocity_it_is_taken_from_the_positions(tmp_path: Path) -> None:
    """A controller that does not measure velocity is followed all the same."""
    tool, rate = tool_file(), np.array([0, 0, 0, 0.5, -0.4])
    service = service_at(tmp_path, tool)
    feed(service, joints(20 * MS, rate * 0.02))
    feed(service, joints(40 * MS, rate * 0.04))
    (out,) = messages(feed(service, raw(50 * MS, true_wrench(tool, rate * 0.05))))
    assert np.abs(six(out)).max() < 1e-12


def test_waiting_for_the_next_joint_state_is_exact_and_loses_nothing(tmp_path: Path) -> None:
    """Every sample once, in order, when its joints are known; not valid if they never come."""
    tool = tool_file()
    service = service_at(tmp_path, tool, alignment="interpolate", max_extrapolation_s=0.06)

    def q(t_ms: float) -> np.ndarray:
        return np.array([0, 0, 0, 0.1, 0.2]) * t_ms / 20.0

    out = []
    for t_ms in range(1, 200):
        if t_ms % 20 == 0 and t_ms <= 100:
            out += messages(feed(service, joints(t_ms * MS, q(t_ms), np.full(5, np.nan))))
        out += messages(feed(service, raw(t_ms * MS, true_wrench(tool, q(t_ms)))))
    assert [m.t_ns // MS for m in out] == list(range(1, out[-1].t_ns // MS + 1))
    known = [m for m in out if 20 <= m.t_ns // MS <= 100]
    assert np.abs([six(m) for m in known]).max() < 1e-12
    assert all(m.valid and m.joints_age_s == 0.0 for m in known)
    late = [m for m in out if m.t_ns > 160 * MS]
    assert late
    assert not any(m.valid for m in late)


@pytest.mark.parametrize("change", ["toggle", "select", "tare", "reload", "no tool"])
def test_a_change_has_neither_a_step_nor_an_end_in_the_wrong_place(tmp_path: Path, change: str) -> None:
    """Between two samples of a change the output moves by no more than its slope, and ends where it belongs."""
    tool, other = tool_file(), tool_file(name="pointer", mass=0.15, bias=(0.0,) * 6, bias_body=None, zeroed_at=None)
    service = service_at(tmp_path, tool, other, blend_s=0.2, tare_samples=10)
    q = np.array([0, 0, 0, 0.5, 0.3])
    reading = true_wrench(tool, q) + np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    requests = {
        "toggle": ask("set_enabled", enabled=False),
        "select": ask("select_tool", tool="pointer"),
        "tare": ask("tare"),
        "reload": ask("reload"),
        "no tool": ask("select_tool", tool=None),
    }
    ends = {
        "toggle": reading,
        "select": reading - true_wrench(other, q),
        "tare": np.zeros(6),
        "reload": reading - true_wrench(tool, q),
        "no tool": reading,
    }
    out = []
    for t_ms in range(1, 500):
        if t_ms % 25 == 1:
            feed(service, joints(t_ms * MS, q, np.zeros(5)))
        if t_ms == 100:
            service.request(requests[change], t_ms * MS)
        out += messages(feed(service, raw(t_ms * MS, reading)))
    values = np.array([six(m) for m in out])
    assert values[98] == pytest.approx([1, 2, 3, 0.1, 0.2, 0.3], abs=1e-12)
    assert values[-1] == pytest.approx(ends[change], abs=1e-12)
    whole = np.abs(values[-1] - values[98])
    assert (np.abs(np.diff(values, axis=0)) <= 1.5 * whole / 200 + 1e-12).all(), "3x^2 - 2x^3 is never steeper than 1.5"
    steps = np.abs(np.diff(values, axis=0))
    under_way = [i for i, m in enumerate(out) if m.blend < 1.0]
    assert under_way, "the change says that it is under way"
    assert (steps[[under_way[0], under_way[-1]]] <= 0.03 * whole / 200 + 1e-12).all(), "no kink at either end"
    assert out[-1].blend == 1.0


def test_a_change_within_a_change_goes_on_from_where_it_is(tmp_path: Path) -> None:
    """Toggled back in the middle of a blend, the output turns round without a step."""
    tool = tool_file()
    service = service_at(tmp_path, tool, blend_s=0.1)
    q = np.array([0, 0, 0, 0.5, 0.3])
    feed(service, joints(MS, q, np.zeros(5)))
    values = []
    for t_ms in range(2, 75):
        if t_ms in {10, 40}:
            service.request(ask("set_enabled", enabled=t_ms == 40), 0)
        values.append(six(messages(feed(service, raw(t_ms * MS, true_wrench(tool, q))))[0]))
    assert np.abs(np.diff(values, axis=0)).max() < 1.5 * np.abs(true_wrench(tool, q)).max() / 100
    assert np.abs(values[35]).max() > 0.1, "it was under way"


def test_a_tare_takes_the_mean_of_what_is_left_and_says_how_much(tmp_path: Path) -> None:
    """Its reply comes when it is done, with the offset and the scatter; untare takes it back."""
    tool = tool_file()
    service = service_at(tmp_path, tool, tare_samples=50, blend_s=0.0)
    q, left = np.zeros(5), np.array([0.3, -0.2, 0.1, 0.01, 0.02, 0.03])
    reading = true_wrench(tool, q) + left
    feed(service, joints(MS, q, np.zeros(5)))
    noise = np.random.default_rng(1).normal(0, 0.01, (60, 6))
    assert service.request(ask("tare"), 0) == []
    with pytest.raises(CommandRejectedError, match="under way"):
        service.request(ask("tare"), 0)
    replies = []
    for i in range(60):
        out = feed(service, raw((2 + i) * MS, reading + noise[i]))
        replies += [o for o in out if isinstance(o, Reply)]
    (reply,) = replies
    assert reply.result["tare"] == pytest.approx(left + noise[:50].mean(axis=0), abs=1e-9)
    assert reply.result["std"] == pytest.approx(noise[:50].std(axis=0), rel=1e-6)
    (out,) = messages(feed(service, raw(70 * MS, reading)))
    assert six(out) == pytest.approx(-noise[:50].mean(axis=0), abs=1e-9)
    service.request(ask("untare"), 0)
    feed(service, raw(71 * MS, reading))
    (out,) = messages(feed(service, raw(72 * MS, reading)))
    assert six(out) == pytest.approx(left, abs=1e-9)


def test_a_tare_without_samples_ends_with_a_reason(tmp_path: Path) -> None:
    """The sensor is silent: the client hears so, and nothing has changed."""
    service = service_at(tmp_path, tool_file(), tare_timeout_s=2.0)
    service.request(ask("tare"), 0)
    assert not [o for o in service.tick(1_900 * MS) if isinstance(o, Reply)]
    (reply,) = [o for o in service.tick(2_100 * MS) if isinstance(o, Reply)]
    assert reply.error is not None
    assert reply.error.kind == "timeout"
    assert "0 of 200" in reply.error.what


@pytest.mark.parametrize(
    ("request_", "error", "text"),
    [
        (ask("select_tool", tool="pointer"), CommandRejectedError, "never calibrated"),
        (ask("select_tool", tool="hammer"), UsageError, "no tool 'hammer'"),
        (ask("select_tool", tool=3), CommandRejectedError, "name or null"),
        (ask("set_enabled", enabled="yes"), CommandRejectedError, "true or false"),
        (ask("set_contact", x=0.0, y=140.0, z=0.0), CommandRejectedError, "metres"),
        (ask("set_contact", x=0.0, y=float("nan"), z=0.0), CommandRejectedError, "metres"),
        (ask("dance"), CommandRejectedError, "no command 'dance'"),
        (ask("select_tool"), CommandRejectedError, "name or null"),
        (ask("select_tool", tol=None), CommandRejectedError, "select_tool takes no tol; it takes tool"),
        (ask("untare", now=True), CommandRejectedError, "untare takes no now; it takes no arguments"),
        (ask("set_enabled", enabled=False, quickly=1), CommandRejectedError, "takes no quickly"),
    ],
)
def test_an_impossible_command_says_why_and_changes_nothing(
    tmp_path: Path, request_: object, error: type[Exception], text: str
) -> None:
    """What cannot be done is refused before anything is touched."""
    service, twin = (service_at(tmp_path / name, tool_file()) for name in ("a", "b"))
    with pytest.raises(error, match=text):
        service.request(request_, 0)  # type: ignore[arg-type]
    for each in (service, twin):
        feed(each, joints(MS, np.zeros(5), np.zeros(5)))
    assert [encode(o[1]) for o in feed(service, raw(2 * MS, np.ones(6)))] == [
        encode(o[1]) for o in feed(twin, raw(2 * MS, np.ones(6)))
    ]


@pytest.mark.parametrize("tool", [None, "retractor"])
def test_a_selection_that_cannot_be_kept_is_refused_and_changes_nothing(tmp_path: Path, tool: str | None) -> None:
    """A folder that cannot be written (here: another one has the file's place): the tool in hand and its tare stay."""
    service, twin = (service_at(tmp_path / name, tool_file()) for name in ("a", "b"))
    for each in (service, twin):
        feed(each, joints(MS, np.zeros(5), np.zeros(5)))
        each.request(ask("set_contact", x=0.1, y=0.0, z=0.0), 0)
    selected = tmp_path / "a" / "tools" / "selected.json"
    selected.unlink()
    selected.mkdir()
    with pytest.raises(UsageError, match="cannot be written"):
        service.request(ask("select_tool", tool=tool), 0)

    assert [encode(o[1]) for o in feed(service, raw(2 * MS, np.ones(6)))] == [
        encode(o[1]) for o in feed(twin, raw(2 * MS, np.ones(6)))
    ]


def test_a_virtual_calibration_is_never_served_to_a_real_sensor(tmp_path: Path) -> None:
    """Neither selected by command nor, with the pointers changed by hand, at the start; on a virtual robot it is."""
    ToolStore(tmp_path).save(tool_file(serial="FT1").on_virtual())
    with pytest.raises(CommandRejectedError, match="never calibrated"):
        service_at(tmp_path).request(ask("select_tool", tool="retractor"), 0)

    folder = tmp_path / "tools"
    (folder / "retractor" / "active-virtual.json").rename(folder / "retractor" / "active.json")
    (folder / "selected.json").write_text('{"tool": "retractor"}')
    service = service_at(tmp_path)
    with pytest.raises(CommandRejectedError, match="was calibrated on a virtual robot, this is a real one"):
        service.request(ask("select_tool", tool="retractor"), 0)
    assert not messages(feed(service, raw(MS, np.zeros(6), serial_number="FT1")))[0].valid
    assert "virtual robot" in messages(service.tick(0), "fault")[0].what

    (folder / "retractor" / "active.json").rename(folder / "retractor" / "active-virtual.json")
    virtual = CompensationService("c", CompensationSettings(), ServiceContext(ROBOT, BASE, tmp_path, virtual=True))
    assert virtual.request(ask("select_tool", tool="retractor"), 0)[0].result["tool"] == "retractor"  # type: ignore[union-attr]


def test_a_calibration_of_another_sensor_makes_nothing_valid(tmp_path: Path) -> None:
    """As soon as the serial number is read, and with a fault that says what to do."""
    service = service_at(tmp_path, tool_file(serial="FT1"))
    feed(service, joints(MS, np.zeros(5), np.zeros(5)))
    (unknown,) = messages(feed(service, raw(2 * MS, np.zeros(6))))
    (same,) = messages(feed(service, raw(3 * MS, np.zeros(6), serial_number="FT1")))
    (other,) = messages(feed(service, raw(4 * MS, np.zeros(6), serial_number="FT2")))
    assert (unknown.valid, same.valid, other.valid) == (True, True, False)
    (fault,) = messages(service.tick(10**10), "fault")
    assert "sensor FT1, this is FT2" in fault.what
    with pytest.raises(CommandRejectedError, match="sensor FT1, this is FT2"):
        service.request(ask("select_tool", tool="retractor"), 0)


@pytest.mark.parametrize("flaw", [{"valid": False}, {"saturated": True}, {"force": Vector3(float("nan"), 0, 0)}])
def test_a_bad_sample_is_passed_on_as_not_valid(tmp_path: Path, flaw: dict[str, object]) -> None:
    """Nothing is vouched for that the sensor does not vouch for."""
    service = service_at(tmp_path, tool_file())
    feed(service, joints(MS, np.zeros(5), np.zeros(5)))
    (out,) = messages(feed(service, raw(2 * MS, np.zeros(6), **flaw)))  # type: ignore[arg-type]
    assert not out.valid
    (good,) = messages(feed(service, raw(3 * MS, np.zeros(6))))
    assert good.valid


def test_a_damaged_file_of_the_selected_tool_is_a_fault_and_not_a_silence(tmp_path: Path) -> None:
    """The service starts, says what is wrong, and vouches for nothing until a tool is chosen."""
    service_at(tmp_path, tool_file())
    (tmp_path / "tools" / "retractor" / "0001.json").write_text("{")
    service = service_at(tmp_path)
    (out,) = messages(feed(service, raw(MS, np.zeros(6))))
    assert not out.valid
    assert "not JSON" in messages(service.tick(10**10), "fault")[0].what
    service.request(ask("select_tool", tool=None), 0)
    (out,) = messages(feed(service, raw(2 * MS, np.ones(6))))
    assert out.valid
    assert not out.enabled


def test_forces_of_inertia_are_predicted_if_wanted(tmp_path: Path) -> None:
    """Shaken at 1 Hz, with joint states at 40 Hz, the dynamic option takes most of the inertial wrench away."""
    tool = tool_file()
    residual = {}
    rate = 2 * np.pi
    for dynamic in (False, True):
        service = service_at(tmp_path / str(dynamic), tool, dynamic=dynamic, dynamic_window=3)
        left = []
        for t_ms in range(1, 1500):
            t = t_ms * 1e-3
            amplitude = np.array([0.02, 0.02, 0.02, 0.3, 0.3])
            q, dq = amplitude * np.sin(rate * t), amplitude * rate * np.cos(rate * t)
            if t_ms % 25 == 1:
                feed(service, joints(t_ms * MS, q, dq))
            bodies = [
                Body(0.3, np.array(RETRACTOR["com"]), np.array(RETRACTOR["inertia"])),
                Body(0.09, np.array([0.002, -0.001, 0.01])),
            ]
            moving = inertial_wrench(ROBOT.sensor_motion(q, dq, -(rate**2) * q), *bodies)[0]
            (out,) = messages(feed(service, raw(t_ms * MS, true_wrench(tool, q) + moving)))
            if t_ms > 500:
                left.append(six(out))
        residual[dynamic] = np.sqrt(np.mean(np.square(left), axis=0))
    assert (residual[True] < 0.45 * residual[False]).all(), residual


def test_a_tool_with_effects_that_this_version_cannot_apply_is_refused(tmp_path: Path) -> None:
    """Never compensated by half: the command says which effect, and what to do."""
    odd = tool_file(name="odd", terms=({"effect": "no such effect", "parameters": {}},))
    service = service_at(tmp_path, tool_file(), odd)
    with pytest.raises(UsageError, match="no such effect"):
        service.request(ask("select_tool", tool="odd"), 0)


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    """Nothing but messages enters the result."""
    rng = np.random.default_rng(0)
    out: list[list[bytes]] = []
    seeds = rng.normal(size=(200, 6))
    for name in ("a", "b"):
        service = service_at(tmp_path / name, tool_file())
        outputs = []
        for i, wrench in enumerate(seeds):
            if i % 7 == 0:
                feed(service, joints((i + 1) * MS, 0.1 * wrench[:5], wrench[1:]))
            outputs += feed(service, raw((i + 1) * MS, wrench))
        out.append([encode(o[1]) for o in outputs])
    assert out[0] == out[1]


any_raw = st.builds(
    raw,
    st.integers(-(10**12), 10**12),
    st.lists(numbers, min_size=6, max_size=6),
    valid=st.booleans(),
    saturated=st.booleans(),
    serial_number=st.sampled_from(["", "FT1"]),
)
any_joints = st.builds(
    JointsState,
    timestamp=st.just(0.0),
    t_ns=st.integers(-(10**12), 10**12),
    seq=st.just(0),
    valid=st.booleans(),
    position=st.dictionaries(st.sampled_from([*ROBOT.joint_names, "other"]), numbers),
    velocity=st.dictionaries(st.sampled_from([*ROBOT.joint_names, "other"]), numbers),
    effort=st.just({}),
)
any_request = st.sampled_from(
    [ask("tare"), ask("untare"), ask("set_enabled", enabled=False), ask("set_enabled", enabled=True), ask("reload")]
)


@settings(max_examples=80)
@given(st.lists(st.one_of(any_raw, any_joints, any_request), max_size=25), st.booleans(), st.booleans())
def test_it_survives_any_message(
    tmp_path_factory: pytest.TempPathFactory, stream: list[object], dynamic: bool, wait: bool
) -> None:
    """NaN, gaps, repeats, time going back, joints that are missing: never an exception, never a valid wrong number."""
    alignment = "interpolate" if wait else "extrapolate"
    service = service_at(
        tmp_path_factory.mktemp("s"), tool_file(), dynamic=dynamic, alignment=alignment, tare_samples=2
    )
    for item in stream:
        if isinstance(item, WrenchRaw | JointsState):
            for out in messages(feed(service, item)):
                assert not out.valid or np.isfinite(six(out)).all()
                assert out.joints_age_s >= 0.0 or np.isnan(out.joints_age_s)
        else:
            with suppress(CommandRejectedError):  # a tare that is under way
                service.request(item, 0)  # type: ignore[arg-type]
        service.tick(0)


def test_the_switch_outlives_a_restart_and_a_tare_does_not(tmp_path: Path) -> None:
    """And what was kept for other hardware is refused."""
    service = service_at(tmp_path, tool_file())
    service.request(ask("set_enabled", enabled=False), 0)
    kept = service.snapshot()
    again = service_at(tmp_path)
    assert again.restore(kept)
    (out,) = messages(feed(again, raw(MS, np.ones(6))))
    assert not out.enabled
    assert not again.restore(kept | {"identity": "another robot"})


def test_an_unzeroed_sensor_is_not_vouched_for_until_it_is_zeroed_or_tared(tmp_path: Path) -> None:
    """The sensor's own offset would pass for a push; the message says so, the status says what to do."""
    tool, q = tool_file(), np.zeros(5)
    service = service_at(tmp_path, tool, tare_samples=5, blend_s=0.0)
    offset = np.array([3.0, -1.0, -34.0, 0.2, 0.1, 0.0])
    feed(service, joints(MS, q, np.zeros(5)))
    read = true_wrench(tool, q)
    (unzeroed,) = messages(feed(service, raw(2 * MS, read + offset, zeroings=0)))
    assert (unzeroed.valid, unzeroed.unzeroed) == (False, True)
    status = next(m for _, m in service.tick(10 * MS) if isinstance(m, Status))
    assert status.state == "degraded"
    assert "zero it" in status.todo

    service.request(ask("tare"), 0)
    seen = [messages(feed(service, raw((3 + k) * MS, read + offset, zeroings=0)))[0] for k in range(6)]
    assert [m.valid for m in seen] == [False] * 5 + [True], "not while its own samples still hold the offset"
    tared = seen[-1]
    assert (tared.valid, tared.unzeroed) == (True, False)
    assert six(tared) == pytest.approx(np.zeros(6), abs=1e-9)

    (zeroed,) = messages(feed(service, raw(9 * MS, read, zeroings=1)))
    assert (zeroed.valid, zeroed.unzeroed) == (True, False)
    assert six(zeroed) == pytest.approx(np.zeros(6), abs=1e-9), "the tare went with the offset, at once"


def test_after_a_restart_the_tool_must_be_felt_on_a_sensor_that_was_zeroed_before(tmp_path: Path) -> None:
    """A restored zero may have been made with the tool on: its weight missing is not vouched for, its weight there is."""
    tool, q = tool_file(bias=(0.0,) * 6), np.full(5, 0.1)
    service = service_at(tmp_path, tool)
    feed(service, joints(MS, q, np.zeros(5)))
    (missing,) = messages(feed(service, raw(2 * MS, np.zeros(6), zeroings=1)))
    assert (missing.valid, missing.tool_unseen) == (False, True)
    (felt,) = messages(feed(service, raw(3 * MS, true_wrench(tool, q), zeroings=1)))
    assert (felt.valid, felt.tool_unseen) == (True, False)


def test_zeroed_with_the_tool_on_it_the_wrench_is_not_vouched_for(tmp_path: Path) -> None:
    """Its weight would be taken off twice and pass for a push, in every pose; a tare or a zero without the tool ends that."""
    tool, q, turned = tool_file(bias=(0.0,) * 6), np.full(5, 0.1), np.array([0.0, 0.0, 0.0, 1.2, 0.6])
    service = service_at(tmp_path, tool, tare_samples=5, blend_s=0.0)
    weight = 0.3 * 9.80665
    feed(service, joints(MS, q, np.zeros(5)))
    (before,) = messages(feed(service, raw(2 * MS, true_wrench(tool, q), zeroings=1)))
    assert (before.valid, before.tool_unseen) == (True, False), "nobody knows how it was zeroed before"

    away = true_wrench(tool, q)
    zeroed = feed(service, raw(3 * MS, np.zeros(6), zeroings=2))
    (on,) = messages(zeroed)
    assert (on.valid, on.tool_unseen) == (False, True)
    assert np.linalg.norm(six(on)[:3]) == pytest.approx(weight, rel=1e-2)
    feed(service, joints(20 * MS, turned, np.zeros(5)))
    (elsewhere,) = messages(feed(service, raw(21 * MS, true_wrench(tool, turned) - away, zeroings=2)))
    assert not elsewhere.valid, "as far off in another pose"
    status = next(m for _, m in service.tick(30 * MS) if isinstance(m, Status))
    assert status.state == "degraded"
    assert "zero without it" in status.todo

    service.request(ask("tare"), 0)
    reading = true_wrench(tool, turned) - away
    seen = [messages(feed(service, raw((22 + k) * MS, reading, zeroings=2)))[0] for k in range(6)]
    assert [m.valid for m in seen] == [False] * 5 + [True]
    assert six(seen[-1]) == pytest.approx(np.zeros(6), abs=1e-9)
    service.request(ask("untare"), 0)
    (untared,) = messages(feed(service, raw(29 * MS, reading, zeroings=2)))
    assert (untared.valid, untared.tool_unseen) == (False, True)

    bare = true_wrench(tool, turned) - true_wrench(tool_file(mass=1e-9, bias=(0.0,) * 6), turned)
    (off,) = messages(feed(service, raw(30 * MS, true_wrench(tool, turned) - bare, zeroings=3)))
    assert not off.valid, "zeroed without the tool: it is still off"
    put_on = feed(service, raw(31 * MS, true_wrench(tool, turned), zeroings=3))
    assert messages(put_on)[0].valid
    assert [s.tool_awaited for s in messages(put_on, "compensation/state")] == [False], "a replay is told where"
    (later,) = messages(feed(service, raw(32 * MS, true_wrench(tool, turned) - bare, zeroings=3)))
    assert later.valid, "felt once, what is missing later is a hand's"


def test_a_tool_that_is_hardly_felt_is_not_waited_for(tmp_path: Path) -> None:
    """Ten grams: what is missing is less than any hand-over-hand control answers."""
    tool = tool_file(mass=0.01, bias=(0.0,) * 6)
    service = service_at(tmp_path, tool, blend_s=0.0)
    feed(service, joints(MS, np.full(5, 0.1), np.zeros(5)))
    feed(service, raw(2 * MS, true_wrench(tool, np.full(5, 0.1)), zeroings=1))
    (out,) = messages(feed(service, raw(3 * MS, np.zeros(6), zeroings=2)))
    assert out.valid


def test_without_a_tool_an_unzeroed_reading_is_not_valid(tmp_path: Path) -> None:
    """Raw is raw: nothing is subtracted that could rest on a zero, and a table or another sensor does not say (-1)."""
    service = service_at(tmp_path)
    (bare,) = messages(feed(service, raw(MS, np.ones(6), zeroings=0)))
    assert (bare.valid, bare.unzeroed) == (False, True)
    (unknown,) = messages(feed(service, raw(2 * MS, np.ones(6))))
    assert (unknown.valid, unknown.unzeroed) == (True, False)


def test_a_tare_of_a_valid_wrench_is_blended_in(tmp_path: Path) -> None:
    """On a zeroed sensor the wrench was vouched for, and somebody may act on it: no step of an offset's size."""
    service = service_at(tmp_path, tare_samples=2, blend_s=0.1)
    feed(service, raw(MS, 30.0 * np.ones(6), zeroings=1))
    service.request(ask("tare"), 0)
    seen = [six(messages(feed(service, raw(t * MS, 30.0 * np.ones(6), zeroings=1)))[0])[0] for t in range(2, 120)]
    assert np.abs(np.diff(seen)).max() < 0.6
    assert seen[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_tare_under_way_ends_when_the_sensor_is_zeroed(tmp_path: Path) -> None:
    """Half of its samples would be of another zero."""
    service = service_at(tmp_path, tool_file(), tare_samples=3)
    feed(service, joints(MS, np.zeros(5), np.zeros(5)))
    feed(service, raw(2 * MS, np.zeros(6), zeroings=1))
    service.request(ask("tare"), 0)
    feed(service, raw(3 * MS, np.zeros(6), zeroings=1))
    (reply,) = [o for o in feed(service, raw(4 * MS, np.zeros(6), zeroings=2)) if isinstance(o, Reply)]
    assert reply.error is not None
    assert "zero changed" in reply.error.what
