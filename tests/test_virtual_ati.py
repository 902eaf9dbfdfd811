"""The virtual NETCANOEM board against ATI manual 9610-05-1030: decoded here by hand, not by the driver."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.virtual.ati_calibration import gauge_matrix, quantisation_sigma
from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.truth import NOISE_SIGMA
from galen_hw.drivers.virtual.world import World

T0 = NS_PER_S
MS = 1_000_000
VECTORS = json.loads((Path(__file__).parent / "vectors" / "ati_netcanoem.json").read_text())["frames"]


def board(**settings):
    world = World(seed=1)
    world.noise_scale = 0.0
    world.attach("retractor")
    return VirtualAtiNetcanoem(AtiSettings(**settings), world), world


def ask(device, op, data=b"", t=T0, base=0x20):
    device.feed(CanFrame(base << 4 | op, data), t)
    return [(f.arbitration_id, f.data) for f in device.poll(t)]


def sample(device, t=T0):
    """(status, six gauges) of one request, from manual table 4.2."""
    (_, a), (_, b) = ask(device, 0, t=t)
    status, g0, g2, g4 = struct.unpack(">Hhhh", a)
    g1, g3, g5 = struct.unpack(">hhh", b)
    return status, np.array([g0, g1, g2, g3, g4, g5], dtype=float)


def matrix(device):
    rows = []
    for axis in range(6):
        frames = ask(device, 2, bytes([axis]))
        assert [i for i, _ in frames] == [0x202, 0x203, 0x204]
        rows.append(struct.unpack(">6f", b"".join(d for _, d in frames)))
    return np.array(rows)


def test_a_hosts_arithmetic_recovers_the_true_wrench():
    """Bias with nothing on the sensor, then matrix x counts / counts per unit is the tool's wrench to half a count."""
    device, world = board()
    rows = matrix(device)
    cpf, cpt = struct.unpack(">II", ask(device, 7)[0][1])
    scale = np.repeat([cpf, cpt], 3)[:, None]
    world.attach(None)
    empty, bias = world.load(T0), sample(device)[1]
    world.attach("retractor")
    measured = rows @ (sample(device)[1] - bias) / scale[:, 0]
    worst = np.abs(rows / scale).sum(axis=1)  # Half a count off in each of two samples.
    assert (np.abs(measured - (world.load(T0) - empty)) <= worst).all()
    assert np.abs(measured).max() > 2.0


def test_gauges_have_offsets_of_thousands_of_counts():
    """As real transducers have: a host that forgets its bias is far off."""
    device, world = board()
    world.attach({"mass": 0.0, "com": [0, 0, 0]})
    assert np.abs(sample(device)[1]).min() > 1000


@pytest.mark.parametrize("seed", [28417, 1, 2, 3])
def test_rounding_to_counts_is_far_below_the_noise(seed):
    """Quantisation adds less than 0.5 % to the noise of every axis, and the matrix is well conditioned."""
    gauges = gauge_matrix(seed)
    assert (quantisation_sigma(gauges) < 0.1 * np.array(NOISE_SIGMA)).all()
    scaled = gauges @ np.diag([40, 40, 60, 1.5, 1.5, 1.5])
    assert np.linalg.cond(scaled) < 6
    assert (np.abs(scaled) < 32767 - 6500).all()


def test_noise_of_decoded_samples_is_the_worlds():
    """Through counts and back, one sigma per axis stays within 4 % of the nominal noise."""
    device, world = board()
    world.noise_scale = 1.0
    rows = matrix(device) / 1e6
    samples = np.array([rows @ sample(device, T0 + k)[1] for k in range(4000)])
    np.testing.assert_allclose(samples.std(axis=0), NOISE_SIGMA, rtol=0.04)


def test_frames_of_the_data_sheet_are_answered_and_produced():
    """Every request of the vector table is understood, every published sample frame is what this board would send."""
    for vector in VECTORS:
        device, _ = board(base_id=vector["base_id"])
        frames = [CanFrame(int(f["id"], 16), bytes.fromhex(f["data"])) for f in vector["frames"]]
        if vector["to"] == "device":
            device.feed(frames[0], T0)
            assert device.counters["requests"] == 1, vector["what"]
            assert device.poll(T0) or vector["op"] == "RESET"
        elif "gauges" in vector:
            assert list(device._sample(vector["gauges"], vector["status"])) == frames


def test_settings_appear_on_the_wire_as_in_the_vector_table():
    """Serial number, counts, unit codes and firmware, byte for byte."""
    device, _ = board(serial_number="FT01234", counts=(1_000_000, 1_000_000_000), firmware=(3, 7, 258))
    assert ask(device, 0x5) == [(0x205, bytes.fromhex("4654303132333400"))]
    assert ask(device, 0x7) == [(0x207, bytes.fromhex("000F42403B9ACA00"))]
    assert ask(device, 0x8) == [(0x208, bytes.fromhex("0203"))]
    assert ask(device, 0xF) == [(0x20F, bytes.fromhex("03070102"))]


def test_slots_differ_in_units_and_empty_ones_are_flagged():
    """Slot 1 is lbf and lbf in of the same gauges; slot 9 is empty: status bits 6 and 15."""
    device, _ = board()
    newtons = matrix(device)
    assert ask(device, 6, b"\x01") == [(0x206, b"\x01")]
    assert ask(device, 8) == [(0x208, b"\x01\x01")]
    np.testing.assert_allclose(newtons[0] / matrix(device)[0], 4.4482216152605, rtol=1e-6)
    np.testing.assert_allclose(newtons[4] / matrix(device)[4], 4.4482216152605 * 0.0254, rtol=1e-6)
    assert sample(device)[0] == 0
    ask(device, 6, b"\x09")
    assert sample(device)[0] == 0x8040
    assert not matrix(device).any()


def test_reset_answers_nothing_takes_time_and_drops_the_slot():
    """Opcode 0xC: no reply, deaf while it wakes, slot 0 again."""
    device, _ = board(reset_s=0.005)
    ask(device, 6, b"\x09")
    assert ask(device, 0xC) == []
    assert ask(device, 0, t=T0 + 4 * MS) == []
    assert sample(device, T0 + 5 * MS)[0] == 0


def test_firmware_gates_opcodes():
    """Counts and units from 3.7 on, diagnostics from 3.8 on, silence before."""
    answered = {}
    for firmware in ((3, 6, 9), (3, 7, 0), (3, 8, 0)):
        device, _ = board(firmware=firmware)
        answered[firmware] = [bool(ask(device, 7)), bool(ask(device, 8)), bool(ask(device, 9, b"\x02"))]
    assert list(answered.values()) == [[False, False, False], [True, True, False], [True, True, True]]


def test_the_thermistor_follows_the_worlds_temperature():
    """Diagnostic 2 changes when the sensor warms up; 6 does not exist."""
    device, world = board()
    cold = ask(device, 9, b"\x02")
    world.thermal = type(world.thermal)(start_c=30.0)
    assert ask(device, 9, b"\x02") != cold
    assert ask(device, 9, b"\x06") == []


def test_base_id_and_bit_rate_wait_for_the_next_power_up():
    """Both are acknowledged at once on the old identifier and hold after a power cycle, not after a reset."""
    device, _ = board()
    assert ask(device, 0xD, b"\x7f") == [(0x20D, b"")]
    assert ask(device, 0xE, b"\x07") == [(0x20E, b"")]
    ask(device, 0xC)
    later = T0 + NS_PER_S
    assert len(ask(device, 0, t=later)) == 2
    assert device.bit_rate == 1_000_000
    device.power_cycle(later)
    assert device.bit_rate == 250_000
    assert ask(device, 0, t=later + NS_PER_S) == []
    assert len(ask(device, 0, t=later + NS_PER_S, base=0x7F)) == 2


@pytest.mark.parametrize(
    ("op", "data"),
    [(0, b"\x00"), (1, b""), (2, b""), (2, b"\x06"), (2, b"\x00\x00"), (6, b"\x10"), (0xA, b""), (0xB, b""),
     (0xD, b"\x80"), (5, b"x"), (0xF, b"\x00")],
)  # fmt: skip
def test_what_the_manual_does_not_define_is_met_with_silence(op, data):
    """Wrong length, index out of range, undefined opcode, another base identifier."""
    device, _ = board()
    assert ask(device, op, data) == []
    assert ask(device, 0, base=0x21) == []
    assert len(ask(device, 0)) == 2


def test_malformed_requests_may_be_answered_instead():
    """The other choice of the settings: surplus bytes ignored, undefined opcodes echoed."""
    device, _ = board(malformed="answer")
    assert len(ask(device, 0, b"\x00")) == 2
    assert ask(device, 0xA) == [(0x20A, b"")]
    assert ask(device, 2) == []


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30))
def test_no_frame_upsets_the_board(frames):
    """Any traffic: no exception, and a sample afterwards (a second later, on the identifier in force)."""
    device, _ = board()
    for k, (identifier, data) in enumerate(frames):
        device.feed(CanFrame(identifier, data), T0 + k)
        device.poll(T0 + k)
    assert len(ask(device, 0, t=T0 + NS_PER_S)) == 2


def test_turnaround_delays_the_answer():
    """Nothing before the time to an answer has passed; `wakeup_ns` says when."""
    device, _ = board(turnaround_s=0.0002)
    assert ask(device, 0) == []
    assert device.wakeup_ns == T0 + 200_000
    assert device.poll(T0 + 199_999) == []
    assert len(device.poll(T0 + 200_000)) == 2


@pytest.mark.parametrize(
    ("fault", "status"),
    [("ft.status.6", 0x8040), ("ft.status.11", 0x8800), ("ft.sticky_can_error", 0x4000), ("ft.status.14", 0xC000)],
)
def test_status_faults_show_in_the_status_word_alone(fault, status):
    """The bit with the summary, or the quirk of a published log without it; the gauges stay good."""
    device, world = board()
    good = sample(device)[1]
    world.faults.add(fault)
    now, gauges = sample(device)
    assert now == status
    assert (gauges == good).all()
    world.faults.clear()
    assert sample(device)[0] == 0


def test_a_gauge_sticks_saturates_or_becomes_noisy():
    """A stuck gauge keeps the value of that moment, a saturated one reads an end, noise spreads all of them."""
    device, world = board()
    world.faults |= {"ft.stuck_gauge.1", "ft.saturated.3", "ft.saturated_low.5"}
    before = sample(device)[1]
    world.attach(None)
    after = sample(device)[1]
    assert before[1] == after[1]
    assert before[0] != after[0]
    assert (after[[3, 5]] == [32767, -32768]).all()
    world.faults = {"ft.noise.200"}
    assert np.std([sample(device)[1] for _ in range(300)], axis=0) == pytest.approx(np.full(6, 200), rel=0.2)


def test_a_load_beyond_the_range_clips_at_sixteen_bits():
    """A push of 400 N drives gauges to their ends, never past them."""
    device, world = board()
    world.advance(T0)
    world.push([400.0, 0, 0])
    assert np.abs(sample(device)[1]).max() == 32767 or np.min(sample(device)[1]) == -32768


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("ft.lost_first", [(0x201, 6)]),
        ("ft.lost_second", [(0x200, 8)]),
        ("ft.short", [(0x200, 8), (0x201, 4)]),
        ("ft.doubled", [(0x200, 8), (0x201, 6), (0x200, 8), (0x201, 6)]),
        ("ft.foreign", [(0x080, 0), (0x200, 8), (0x201, 6), (0x701, 1)]),
        ("ft.silent", []),
        ("ft.late", []),
    ],
)
def test_faults_of_the_wire(fault, expected):
    """Frames lost, short, doubled, foreign, or none; configuration requests are spared except by silence."""
    device, world = board()
    world.faults.add(fault)
    assert [(i, len(d)) for i, d in ask(device, 0)] == expected
    assert bool(ask(device, 5)) == (fault != "ft.silent")


def test_a_late_answer_comes_after_the_next_one():
    """30 ms late on every second sample: the host meets it among the answers to later requests."""
    device, world = board()
    world.faults.add("ft.late@2")
    assert len(ask(device, 0)) == 2
    assert ask(device, 0, t=T0 + MS) == []
    assert len(ask(device, 0, t=T0 + 2 * MS)) == 2
    assert device.wakeup_ns == T0 + 31 * MS
    assert len(device.poll(T0 + 31 * MS)) == 2


def test_a_watchdog_reset_happens_once_and_shows_in_bit_0():
    """The board restarts at the next request: slot 0, status bit 0 with the summary, and goes on."""
    device, world = board()
    ask(device, 6, b"\x09")
    world.faults.add("ft.reset")
    assert ask(device, 0) == []
    assert [sample(device, T0 + k * NS_PER_S)[0] for k in (1, 2)] == [0x8001, 0x8001]


def test_faults_that_are_not_known_here_change_nothing():
    """A motor fault does not touch the sensor."""
    device, world = board()
    good = sample(device)
    world.faults |= {"elo", "blocked:roll"}
    assert sample(device)[0] == good[0]
    assert (sample(device)[1] == good[1]).all()
