"""Hand-over-hand control: with the compensation the tool stands still where it is let go, without it it drifts."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.config.tool_file import BiasBody, ToolFile
from galen_hw.errors import CommandRejectedError
from galen_hw.messages import CompensationState, JointsState, Request, Vector3, WrenchCompensated
from galen_hw.services.admittance import AdmittanceService, AdmittanceSettings
from galen_hw.services.joint_rates import JointRates
from galen_hw.services.service import ServiceContext
from galen_hw.tools.figure_drift import draw_drift, measure_drift, turn_and_let_go
from galen_hw.tools.hand_over_hand import HandOverHand
from tests.compensation_parts import BASE, ROBOT, tool_file

ON = Request(id="on", target="admittance", name="set_enabled", args={"enabled": True})


def calibrated(**changes: object) -> ToolFile:
    """What a good calibration of the virtual robot's retractor finds."""
    numbers = {
        "mass": 0.287,
        "com": (0.031, 0.004, -0.063),
        "bias": (0.0,) * 6,
        "bias_body": BiasBody(mass=0.085, com=(0.002, -0.001, 0.011)),
        "zeroed_at": dict.fromkeys(ROBOT.joint_names, 0.0),
    }
    return tool_file(**(numbers | changes))


def following(**settings: float) -> HandOverHand:
    """A robot with the control switched on and the tool compensated, at rest."""
    robot = HandOverHand(calibrated(), admittance=AdmittanceSettings(**settings))
    robot.run(0.5)
    robot.ask("admittance", "set_enabled", enabled=True)
    robot.begin_trace()
    return robot


def test_the_tool_drifts_without_compensation_and_stands_still_with_it() -> None:
    """The report's main result: turned by hand and let go, centimetres against less than a tenth of a millimetre."""
    drift = measure_drift(calibrated())
    assert drift.speed_off > 0.02
    assert drift.drift_off > 0.08
    assert drift.drift_on < 1e-4
    turned = drift.on.joints[-1, 3:]
    assert turned == pytest.approx([0.66, 0.41], abs=0.05), "the hand really turned it"


def test_a_wrong_mass_is_seen_as_drift() -> None:
    """The test above can fail: with half of the mass forgotten the tool does not stand still."""
    trace = turn_and_let_go(calibrated(mass=0.15), compensated=True)
    assert trace.after(4.2).travel[-1] > 0.02


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    """The one that the demonstration shows."""
    drift = draw_drift(tmp_path / "drift.png", calibrated())
    assert (tmp_path / "drift.png").stat().st_size > 20_000
    assert drift.drift_off > 100 * drift.drift_on


@pytest.mark.parametrize("direction", [(3.0, 0.0, 0.0), (0.0, -2.0, 0.0), (1.0, 1.0, -2.0)])
def test_the_tool_goes_where_it_is_pushed_and_as_fast_as_that(direction: tuple[float, float, float]) -> None:
    """A push at the contact point moves it along the force, at gain times what is beyond the dead band, unturned."""
    robot, force = following(), np.array(direction)
    robot.world.push(force, seconds=2.0)
    robot.run(2.0)
    trace = robot.trace()
    rows = trace.after(1.0)
    velocity = (rows.tip[-1] - rows.tip[0]) / (rows.time[-1] - rows.time[0])
    expected = force * 0.01 * (1.0 - 0.3 / np.linalg.norm(force))
    assert velocity == pytest.approx(expected, abs=0.03 * float(np.linalg.norm(expected)))
    assert np.abs(rows.joints[-1, 3:]).max() < 0.02
    robot.run(1.0)
    after = robot.trace().after(2.5)
    assert after.travel[-1] < 1e-4, "and it stops when the push ends"


def test_after_a_stop_no_velocity_is_sent_before_the_axes_stand() -> None:
    """The sensor drops out for a moment in full motion: an axis that still slows down would refuse a velocity."""
    import msgspec

    robot = following(force_gain=0.05)
    robot.acceleration *= 0.3
    robot.world.push((3.0, 0.0, 0.0), seconds=100.0)
    sound = robot.spoil
    for _ in range(4):
        robot.run(0.6)
        assert np.abs(robot.dq).max() > 0.03
        robot.spoil = lambda message: msgspec.structs.replace(message, saturated=True)
        robot.run(0.1)
        assert np.abs(robot.dq).max() > 0.005, "it is slowing down still"
        robot.spoil = sound
    assert sum(r.name == "stop" for r in robot.requests) == 4
    assert not [m for topic, m in robot.log if topic == "fault"]


def test_a_push_means_the_same_direction_when_the_tool_is_turned() -> None:
    """The wrench is in the sensor's axes, the motion in the base's: turned by 45 degrees, up is still up."""
    robot = following()
    robot.world.guide(turn=(0.7, 0.45, 0.0), move_s=1.5, seconds=3.0)
    robot.run(3.5)
    assert robot.q[3:] == pytest.approx([0.65, 0.4], abs=0.05)
    robot.begin_trace()
    robot.world.push((0.0, 0.0, 3.0), seconds=1.5)
    robot.run(1.5)
    moved = robot.trace().tip[-1] - robot.trace().tip[0]
    assert moved[2] > 0.03
    assert np.abs(moved[:2]).max() < 0.03 * moved[2]


def test_speed_and_acceleration_are_bounded() -> None:
    """However hard the push."""
    robot = following(max_speed=0.05, max_acceleration=0.2)
    robot.world.push((40.0, 0.0, 0.0), seconds=1.0)
    robot.run(1.0)
    trace = robot.trace()
    speed = np.linalg.norm(np.diff(trace.tip[::25], axis=0), axis=1) / np.diff(trace.time[::25])
    assert 0.045 < speed.max() < 0.052
    assert np.diff(speed).max() / 0.05 < 0.45, "twice the bound at most, for joint states come every 24 ms"


def test_a_joint_at_its_limit_stops_and_the_others_go_on() -> None:
    """Pushed down for long, the carriages end before their limits; a sideways push still moves the tool then."""
    robot = following(force_gain=0.1, max_speed=0.25)
    robot.world.push((0.0, 0.0, -20.0), seconds=5.0)
    robot.run(4.0)
    end = robot.trace().joints[-1]
    assert (end > ROBOT.lower).all()
    assert (end[:3] < ROBOT.lower[:3] + 0.08).any()
    assert np.abs(robot.dq).max() < 1e-3
    assert np.abs(end[3:]).max() < 0.02, "the tool has not tipped over"
    robot.world.hand.pushes.clear()
    robot.begin_trace()
    robot.world.push((0.0, 10.0, 0.0), seconds=1.0)
    robot.run(1.0)
    assert robot.trace().travel[-1] > 0.02
    assert (robot.q > ROBOT.lower).all()


@pytest.mark.parametrize("gone", ["ft", "motors"])
def test_it_rests_when_nothing_comes_any_more_and_goes_on_when_it_does(gone: str) -> None:
    """Stale wrenches or stale joints end the motion within a quarter of a second."""
    robot = following()
    robot.world.push((3.0, 0.0, 0.0), seconds=10.0)
    robot.run(0.5)
    assert np.abs(robot.dq).max() > 0.01
    robot.silent.add(gone)
    robot.run(0.3)
    assert np.abs(robot.dq).max() == 0.0
    assert robot.requests[-1].name == "stop"
    robot.silent.clear()
    robot.run(0.3)
    assert np.abs(robot.dq).max() > 0.01


def test_a_wrench_that_is_not_valid_moves_nothing() -> None:
    """A saturated sensor under a strong push: rest."""
    import msgspec

    robot = following()
    robot.spoil = lambda message: msgspec.structs.replace(message, saturated=True)
    robot.world.push((30.0, 0.0, 0.0), seconds=10.0)
    robot.run(0.5)
    assert robot.trace().travel[-1] < 2e-3
    assert np.abs(robot.dq).max() == 0.0


@pytest.mark.parametrize("trouble", ["estop", "refusal"])
def test_trouble_with_the_motors_ends_it_until_it_is_switched_on_again(trouble: str) -> None:
    """An emergency stop or a refused velocity: a fault that says why, and no motion by itself afterwards."""
    robot = following()
    robot.world.push((3.0, 0.0, 0.0), seconds=10.0)
    robot.run(0.3)
    robot.estop, robot.refuse = trouble == "estop", "tilt is at its limit switch" if trouble == "refusal" else ""
    robot.run(0.2)
    faults = [m for topic, m in robot.log if topic == "fault"]
    assert len(faults) == 1
    assert ("emergency stop" if trouble == "estop" else "limit switch") in faults[0].what  # type: ignore[attr-defined]
    robot.estop, robot.refuse = False, ""
    robot.run(0.3)
    assert np.abs(robot.dq).max() == 0.0
    robot.ask("admittance", "set_enabled", enabled=True)
    robot.run(0.3)
    assert np.abs(robot.dq).max() > 0.01


def service(folder: Path, *, virtual: bool = True) -> AdmittanceService:
    """The service alone."""
    return AdmittanceService(
        "admittance", AdmittanceSettings(), ServiceContext(ROBOT, BASE, folder, identity="x", virtual=virtual)
    )


def state(t_ns: int, **changes: object) -> JointsState:
    """Joints at rest at home."""
    zero = dict.fromkeys(ROBOT.joint_names, 0.0)
    base = {"timestamp": 0.0, "t_ns": t_ns, "seq": 0, "valid": True, "position": zero, "velocity": zero, "effort": {}}
    return JointsState(**(base | {"enabled": dict.fromkeys(ROBOT.joint_names, True)} | changes))  # type: ignore[arg-type]


def test_it_refuses_to_run_on_a_real_robot(tmp_path: Path) -> None:
    """And without joints, or with the motors off."""
    real = service(tmp_path, virtual=False)
    with pytest.raises(CommandRejectedError, match="virtual robot only"):
        real.request(ON, 0)
    alone = service(tmp_path)
    with pytest.raises(CommandRejectedError, match="no fresh joint state"):
        alone.request(ON, 0)
    alone.handle("joints/state", state(0, enabled=dict.fromkeys(ROBOT.joint_names, False)), 0)
    with pytest.raises(CommandRejectedError, match="motors are off"):
        alone.request(ON, 0)
    with pytest.raises(CommandRejectedError, match="not a command"):
        alone.request(Request(id="1", target="admittance", name="dance"), 0)
    alone.handle("joints/state", state(1), 1)
    assert alone.request(ON, 1)


def test_a_busy_line_gets_no_second_velocity(tmp_path: Path) -> None:
    """The next velocity waits for the motors' answer to the last one."""
    control = service(tmp_path)
    control.handle("joints/state", state(0), 0)
    control.request(ON, 0)
    contact = CompensationState(timestamp=0.0, t_ns=0, seq=0, valid=True)
    control.handle("compensation/state", contact, 0)
    sent = []
    for i in range(1, 6):
        wrench = WrenchCompensated(
            timestamp=0.0, t_ns=i * 25_000_000, seq=i, valid=True, force=Vector3(5.0), torque=Vector3()
        )
        control.handle("wrench/contact", wrench, i * 25_000_000)
        sent += control.handle("joints/state", state(i * 25_000_000), i * 25_000_000)
    assert [r.name for r in sent if isinstance(r, Request)] == ["servo_jv"]


@given(
    st.lists(st.floats(-0.9, 0.9), min_size=2, max_size=2),
    st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=3),
    st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3),
    st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=2),
)
def test_joint_rates_give_the_contact_point_its_twist(
    turned: list[float], linear: list[float], contact: list[float], turning: list[float]
) -> None:
    """Any velocity, and any turn about the two axes that the robot has, within one per cent."""
    rates = JointRates(ROBOT, max_speed=10.0, margin=0.0)
    q, point = np.array([0, 0, 0, *turned]), np.array(contact)
    J = rates.contact_jacobian(q, point)
    twist = np.concatenate([linear, J[3:, 3:] @ turning])
    found = J @ rates.solve(q, point, twist, {}, {})
    assert np.abs(found - twist).max() <= 0.01 * np.abs(twist).max() + 1e-9


@given(
    st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5),
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.lists(st.booleans(), min_size=10, max_size=10),
)
def test_joint_rates_never_lead_beyond_a_limit(share: list[float], twist: list[float], switches: list[bool]) -> None:
    """Neither a software limit within the horizon nor further into a limit switch, and never too fast."""
    rates = JointRates(ROBOT, max_speed=0.6, margin=0.01)
    q = ROBOT.lower * 0.6 + np.array(share) * (ROBOT.upper * 0.6 - ROBOT.lower * 0.6)
    q[3:] = (ROBOT.lower + np.array(share) * (ROBOT.upper - ROBOT.lower))[3:]
    lower = dict(zip(ROBOT.joint_names, switches[:5], strict=True))
    upper = dict(zip(ROBOT.joint_names, switches[5:], strict=True))
    dq = rates.solve(q, np.array([0.045, 0.0, -0.14]), np.array(twist), lower, upper)
    assert np.abs(dq).max() <= 0.6 + 1e-12
    inside = q + 0.15 * dq
    assert (
        (inside >= np.minimum(q, ROBOT.lower + 0.01) - 1e-9) & (inside <= np.maximum(q, ROBOT.upper - 0.01) + 1e-9)
    ).all()
    for i, name in enumerate(ROBOT.joint_names):
        assert not (lower[name] and dq[i] < 0.0)
        assert not (upper[name] and dq[i] > 0.0)


numbers = st.floats(allow_nan=True, allow_infinity=True)
vectors = st.builds(Vector3, numbers, numbers, numbers)
head = {"timestamp": st.just(0.0), "t_ns": st.integers(-(10**11), 10**11), "seq": st.just(0), "valid": st.booleans()}
positions = st.dictionaries(st.sampled_from([*ROBOT.joint_names, "other"]), numbers)
streams = st.lists(
    st.one_of(
        st.tuples(st.just("wrench/contact"), st.builds(WrenchCompensated, **head, force=vectors, torque=vectors)),
        st.tuples(st.just("compensation/state"), st.builds(CompensationState, **head, contact=vectors)),
        st.tuples(
            st.just("joints/state"),
            st.builds(JointsState, **head, position=positions, velocity=positions, effort=positions),
        ),
    ),
    max_size=20,
)


@settings(max_examples=60)
@given(stream=streams)
def test_it_survives_any_message_and_never_commands_a_number_that_is_none(
    tmp_path_factory: pytest.TempPathFactory, stream: list[tuple[str, object]]
) -> None:
    """Whatever comes, velocities are finite."""
    control = service(tmp_path_factory.mktemp("s"))
    control.handle("joints/state", state(0), 0)
    control.request(ON, 0)
    for topic, message in stream:
        outputs = control.handle(topic, message, message.t_ns)  # type: ignore[arg-type, attr-defined]
        outputs += control.tick(message.t_ns)  # type: ignore[attr-defined]
        for output in outputs:
            if isinstance(output, Request) and output.name == "servo_jv":
                assert np.isfinite(list(output.args["velocity"].values())).all()


def test_the_same_run_is_the_same_to_the_last_bit() -> None:
    """Simulated time, a seeded world: a trace can be compared."""
    first, second = (turn_and_let_go(calibrated(), compensated=True, end_s=1.0) for _ in range(2))
    assert np.array_equal(first.contact, second.contact)
    assert first.time[-1] == pytest.approx(1.0, abs=3e-3)
