"""The virtual controller moves as a real one: trapezoids, limits, trips, stop codes, in the world's joints."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.galil_dmc.profile import Path, Rates, State, jog, move, stop
from galen_hw.drivers.virtual.world import World
from tests.galil_host import Host


def motor(**options):
    host = Host(**options)
    assert host.ask("SH") == ":"
    return host


def test_a_move_takes_the_time_of_its_trapezoid_and_ends_on_target():
    """50 mm at 25 mm/s with 0.256 m/s^2: 50/25 s plus half the ramps; stop code 1; the joint is there."""
    host = motor()
    host.ask("PA 50000;SP 25000;AC 256000;DC 256000;BGA")
    expected = 50_000 / 25_000 + 25_000 / 256_000

    assert host.until_still() == pytest.approx(expected, abs=0.02)
    assert host.numbers("TPA") == [50_000]
    assert host.numbers("SCA") == [1]
    assert host.world.joints(host.now_ns)[0][0] == pytest.approx(0.05, abs=1e-9)


def test_the_motor_follows_late_in_proportion_to_its_speed():
    """While slewing TE is speed times lag; at rest it is zero."""
    host = motor()
    host.ask("PA 50000;SP 20000;BGA", ms=500)

    assert host.numbers("TEA") == [pytest.approx(20_000 * 0.002, abs=1)]
    assert host.numbers("TVA") == [pytest.approx(20_000, abs=1)]
    host.until_still()
    host.wait(50)
    assert host.numbers("TEA") == [0]


def test_polling_late_or_often_gives_the_same_motion():
    """The joints at a time do not depend on how often the controller was looked at."""
    late, often = motor(), motor()
    for host in (late, often):
        host.ask("PA 30000,-20000,10000,8000,-6000;SP*=20000;BG")
    for _ in range(300):
        often.wait(1.7)
    late.wait(300 * 1.7)
    for a, b in zip(late.world.joints(late.now_ns), often.world.joints(often.now_ns), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    assert late.ask("TP;SC") == often.ask("TP;SC")


def test_jog_changes_speed_and_direction_without_a_new_begin():
    """JG sets the speed of an axis that jogs already; it overwrites SP; a positioning axis refuses it (13)."""
    host = motor()
    host.ask("JG 10000;BGA", ms=500)
    assert host.numbers("TVA") == [10_000]
    assert host.numbers("SP ?") == [10_000]
    assert host.ask("JG -4000", ms=500) == ":"
    assert host.numbers("TVA") == [-4000]
    assert host.ask("BGA;TC") == "?21\r\n:"
    assert host.ask("STA", ms=200) == ":"
    assert host.numbers("MG _BGA,_SCA,_TVA") == [0, 4, 0]
    host.ask("PA 90000;BGA")
    assert host.ask("JG 1000;TC") == "?13\r\n:"


def test_what_is_not_valid_while_running():
    """PA, PR, DP, SH, MO on a moving axis: code 7; SP and AC are taken and change the move."""
    host = motor()
    host.ask("PA 100000;SP 10000;BGA", ms=100)
    for command in ("PA 5", "PR 5", "DP 0", "SHA", "MOA", "MO", "HMA"):
        assert host.ask(command) == "?"
        assert host.ask("TC") == "7\r\n:"
    assert host.ask("SP 40000", ms=300) == ":"
    assert host.numbers("TVA") == [40_000]
    host.until_still()
    assert host.numbers("TPA") == [100_000]


def test_stop_brakes_and_leaves_its_code_even_on_a_standing_axis():
    """ST: code 4, also where nothing moved."""
    host = motor()
    host.ask("PR 90000;SP 20000;BGA", ms=500)
    before = host.numbers("TPA")[0]
    host.ask("STA")
    assert host.numbers("SCA") == [0]
    host.until_still()
    host.wait(20)

    run_out = host.numbers("TPA")[0] - before
    assert run_out == pytest.approx(20_000**2 / (2 * 256_000) + 20_000 * 0.004, rel=0.08)
    assert host.numbers("SCA") == [4]
    assert host.ask("STB;SCB") == ":4\r\n:"


def test_limit_switch_stops_the_axis_and_forbids_that_way_only():
    """Tilt runs into its forward switch: code 2, _LF 0, begin refused with 22 forwards and taken backwards."""
    host = motor()
    host.ask("JGE=20000;BGE", ms=5000)

    assert host.numbers("SCE") == [2]
    assert host.numbers("MG _LFE,_LRE,_BGE") == [0, 1, 0]
    assert host.world.joints(host.now_ns)[0][4] > 0.96
    assert host.ask("BGE;TC1") == "?22 Begin not possible due to Limit Switch\r\n:"
    assert host.ask("PAE=0;BGE", ms=5000) == "::"
    assert host.numbers("MG _LFE,_SCE,_TPE") == [1, 1, 0]


def test_disabled_switches_let_the_axis_reach_the_hard_stop_and_trip():
    """With LD the motor meets the hard stop; the error grows past ER and OE takes the power: code 8."""
    host = motor()
    host.ask("LDE=3;OEE=1;ERE=800;JGE=20000;BGE", ms=5000)

    assert host.numbers("MG _SCE,_MOE,_BGE") == [8, 1, 0]
    assert host.world.joints(host.now_ns)[0][4] == pytest.approx(0.96 + 0.01, abs=1e-6)


def test_software_limits_stop_with_their_codes():
    """FL gives 2, BL gives 3; the motor overruns only by its braking distance."""
    host = motor()
    host.ask("FL 20000;BL -1000;PA 50000;SP 20000;BGA", ms=3000)
    assert host.numbers("SCA") == [2]
    assert 20_000 < host.numbers("TPA")[0] < 21_000
    assert host.ask("BGA;TC") == "?22\r\n:"
    host.ask("PA -50000;BGA", ms=4000)
    assert host.numbers("SCA") == [3]


def test_abort_stands_at_once():
    """AB 1 stops motion with code 7 and keeps power where OE is 0, and takes it where OE is 1."""
    host = motor()
    host.ask("OEB=1;JG 20000,20000;BGAB", ms=500)
    before = host.numbers("RPA")[0]
    assert host.ask("AB 1") == ":"
    host.wait(200)

    assert host.numbers("TPA")[0] == pytest.approx(before, abs=200)
    assert host.numbers("MG _SCA,_SCB,_MOA,_MOB,_BGA,_BGB") == [7, 7, 0, 1, 0, 0]


def test_a_blocked_axis_trips_only_where_off_on_error_is_set():
    """Something holds carriage1: TE grows; without OE only TS tells, with OE the motor goes off with code 8."""
    host = motor()
    host.ask("OE 0;ER 1000;JG 10000;BGA", ms=200)
    host.world.faults.add("motors.blocked.carriage1")
    host.wait(300)
    assert int(host.numbers("TSA")[0]) & 0x40
    assert host.numbers("MG _MOA") == [0]
    host.ask("OE 1")
    assert host.numbers("MG _MOA,_SCA") == [1, 8]


def test_the_emergency_stop_takes_power_from_all_axes():
    """ELO: motors off, amplifier word bits 24 and 25, input 7 low; power comes back only after release and SH."""
    host = motor()
    host.ask("JG 20000;BGA", ms=300)
    host.world.faults.add("elo")
    host.wait(300)

    assert host.numbers("MG _MOA,_MOE,_BGA,@IN[7]") == [1, 1, 0, 0]
    assert host.ask("TA 3") == "3\r\n:"
    host.ask("SH", ms=5)
    assert host.numbers("MG _MOA") == [1]
    host.world.faults.discard("elo")
    host.wait(5)
    assert host.numbers("MG _MOA") == [1]
    host.ask("SH", ms=5)
    assert host.numbers("MG _MOA,@IN[7]") == [0, 1]


def test_abort_input_stops_with_code_6():
    """The abort input stops motion at once; _AB reads 0 while it is pulled."""
    host = motor()
    host.ask("JG 20000;BGA", ms=300)
    host.world.faults.add("abort_input")
    host.wait(20)

    assert host.numbers("MG _AB,_SCA,_BGA,_MOA") == [0, 6, 0, 0]


def test_motors_without_power_run_out():
    """Taking the power at speed does not stop the mass at once, and never teleports the joint."""
    host = motor()
    host.ask("OE 1;JG 40000;BGA", ms=500)
    host.ask("AB 1", ms=0.1)
    track = []
    for _ in range(60):
        host.wait(1)
        track.append(host.world.joints(host.now_ns)[0][0])
    steps = np.diff(track)

    assert steps.max() <= 0.0401 * 1e-3
    assert steps[0] > 0.03e-3
    assert steps[-1] == 0


def test_homing_finds_its_places():
    """FE ends at the edge of the home input with 9, HM there at zero with 10, FI at an index with 10."""
    axes = {"A": {"joint": "carriage1", "counts_per_unit": 1e6, "start": -0.02, "home_switch": 0.01}}
    host = motor(settings={"baud_rate": 0, "echo": False, "axes": axes})
    host.ask("FEA;BGA")
    host.until_still()
    assert host.numbers("MG _SCA") == [9]
    assert host.world.joints(host.now_ns)[0][0] == pytest.approx(0.01, abs=0.003)
    host.ask("HMA;BGA")
    host.until_still()
    assert host.numbers("MG _SCA,_TPA") == [10, 0]
    assert host.world.joints(host.now_ns)[0][0] == pytest.approx(0.01, abs=1e-4)
    host.ask("JG 5000;FIA;BGA")
    host.until_still()
    assert host.numbers("MG _SCA,_TPA") == [10, 0]


def test_limit_polarity_of_the_inputs():
    """CN 1 reads the resting inputs as active limits: no begin either way."""
    host = motor()

    assert host.ask("CN 1;PR 100;BGA;TC") == "::?22\r\n:"
    assert host.ask("CN -1;BGA") == "::"


def test_absolute_encoders_read_their_offset():
    """TP is joint position times scale plus offset, at power-up and after SH."""
    axes = {"A": {"joint": "carriage2", "counts_per_unit": 4.096e6, "offset_counts": 64_400_000, "start": 0.01}}
    host = motor(settings={"baud_rate": 0, "echo": False, "axes": axes})

    assert host.numbers("TPA") == [64_440_960]
    host.ask("PA 64400000;SP 100000;BGA", ms=3000)
    assert host.world.joints(host.now_ns)[0][1] == pytest.approx(0.0, abs=1e-9)


SPEEDS = st.floats(1.0, 1e6)


@settings(max_examples=200)
@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e5, 1e5), SPEEDS, SPEEDS, SPEEDS)
def test_every_move_is_smooth_within_its_rates_and_ends_on_target(start, target, v0, speed, ac, dc):
    """From any state: position and speed have no jumps, rates stay in bounds, the end is exact."""
    path = Path(start)
    path.replace(move(1.0, State(start, v0, 0.0), target, Rates(speed, ac, dc)), keep_after=0.0)
    pieces = path._pieces[1:]
    scale = 1.0 + abs(start) + abs(target) + v0**2 / min(ac, dc)

    assert path.at(path.end + 1.0) == State(target, 0.0, 0.0)
    for before, after in pairwise(pieces):
        left = before.at(after.t)
        assert left.p == pytest.approx(after.p, abs=1e-7 * scale + 0.6)
        assert left.v == pytest.approx(after.v, abs=1e-5 * (1 + abs(v0) + speed) + 1e-9 * (ac + dc))
    assert all(abs(p.a) <= max(ac, dc) * 1.0001 for p in pieces)
    assert all(abs(p.v) <= max(speed, abs(v0)) * 1.0001 for p in pieces)


@settings(max_examples=100)
@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), SPEEDS, SPEEDS)
def test_jog_and_stop_reach_their_speed(v0, speed, ac, dc):
    """A jog ends at its speed, a stop at rest, without a jump of the speed."""
    for pieces, wanted in (
        (jog(0.0, State(0.0, v0, 0.0), speed, ac, dc), speed),
        (stop(0.0, State(0, v0, 0), dc), 0.0),
    ):
        assert pieces[-1].v == wanted
        assert pieces[0].v == (v0 if len(pieces) > 1 else wanted)
        for before, after in pairwise(pieces):
            assert before.at(after.t).v == pytest.approx(after.v, abs=1e-6 * (1 + abs(v0)))


@settings(max_examples=15)
@given(st.lists(st.sampled_from([
    "SH", "MO", "BG", "BGA", "ST",
    "AB 1", "JG 9000,-7000", "JG -9000", "PA 5000,6000", "PR -4000", "SP 20000", "AC 60000",
    "OE 1,1", "ER 50", "DP 0", "STA", "HMA", "FEB", "FIA", "elo", "abort_input", "motors.blocked.carriage1",
]), max_size=25))  # fmt: skip
def test_no_sequence_of_commands_makes_a_joint_jump(commands):
    """Whatever is commanded or breaks, joints move no faster than the motors can."""
    host, last = motor(), np.zeros(5)
    for command in commands:
        if command[0].islower():
            host.world.faults ^= {command}
        else:
            host.ask(command, ms=0.5)
        for _ in range(30):
            host.wait(1.0)
            q = host.world.joints(host.now_ns)[0]
            assert np.abs(q - last).max() < 0.2 * 1.5e-3
            last = q


def test_line_speed_is_that_of_the_wire():
    """At 115200 8N1 a QR of five axes and its colon take 263 bytes, 22.8 ms; unpaced they are there at once."""
    world = World()
    device = VirtualGalilDmc(VirtualGalilDmc.Settings(echo=False), world)
    device.poll(0)
    device.feed(b"QR\r", 0)
    got, t = b"", 0
    while len(got) < 263:
        t = max(device.wakeup_ns, t + 1)
        got += b"".join(device.poll(t))
        if t < 20_000_000:
            assert len(got) <= t * 11.52e-6

    assert t == pytest.approx(263 / 11_520 * 1e9 + 3 / 11_520 * 1e9 + 0.2e6, rel=0.03)
    fast = Host()
    fast.wait(0)
    assert len(fast.ask_raw("QR", ms=0.3)) == 263


def test_a_silent_and_a_late_controller():
    """Faults of the line: nothing comes, or it comes a second late."""
    host = Host()
    host.world.faults.add("motors.silent")
    assert host.ask("TPA", ms=3000) == ""
    host.world.faults = {"motors.late"}
    assert host.ask("TPA", ms=900) == ""
    assert host.wait(200) == b"0\r\n:"
