"""Which frames of a Bota sensor are samples, and how many are missing: what had waited, stalls, clocks, rounded stamps."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from bota_parts import Process, rounded, run_of, wrenches

from galen_hw.drivers.bota.codec import Frame, Sensor
from galen_hw.drivers.bota.stream import Sieve, missing

COUNTED = ("late", "lost", "doubled")


def fed(sieve, ages_ms, begin_ms=0.0):
    """Which frames of a stream at 1 kHz, each read so many ms after it was measured, are samples."""
    found, t_ms = [], 0.0
    for number, age_ms in enumerate(ages_ms):
        t_ms = max(t_ms, begin_ms + number + age_ms)
        frame = Frame(rounded(round(1000 * (begin_ms + number))), 0, (float(number), 2.0, 3.0), (0.1, 0.2, 0.3))
        found.append(sieve.take(frame, round(1e6 * t_ms)))
    return found


@pytest.mark.parametrize("pause", [0, 1, 15, 25, 90, 200])
def test_what_had_piled_up_in_the_package_is_no_sample(pause):
    """Half a second's frames that are read in one go at the start, or in two with a pause between: none passes for prompt."""
    backlog = [500 - n for n in range(200)] + [500 + pause - n for n in range(200, 500 + pause)]
    counters = dict.fromkeys(COUNTED, 0)
    found = fed(Sieve(1_000_000, 20_000_000, counters), backlog + [0] * 300)
    assert not any(found[: len(backlog)])
    assert all(found[-150:])
    assert counters["late"] == found.count(False)


def test_a_stall_costs_only_what_had_waited():
    """Of what piled up in 200 ms the last 20 are young enough; all before and after are samples."""
    ages = [0] * 500 + [200 - n for n in range(200)] + [0] * 500
    found = fed(Sieve(1_000_000, 20_000_000, dict.fromkeys(COUNTED, 0)), ages, begin_ms=4_000_000.0)
    assert all(found[110:500])
    assert not any(found[500:675])
    assert all(found[685:])


def test_frames_in_bunches_are_samples():
    """An adapter that gives 16 frames at once every 16 ms: none waited longer than it may."""
    found = fed(Sieve(1_000_000, 20_000_000, dict.fromkeys(COUNTED, 0)), [15 - n % 16 for n in range(1000)])
    assert all(found[150:])


def test_a_sensor_whose_clock_is_half_a_percent_slow_or_fast_goes_on():
    """The least difference of the clocks follows."""
    for pace_ns in (995_000, 1_005_000):
        counters = dict.fromkeys(COUNTED, 0)
        sieve = Sieve(1_000_000, 20_000_000, counters)
        for number in range(20_000):
            sieve.take(Frame(rounded(1000 * number), 0, (float(number), 0.0, 0.0), (0.0, 0.0, 0.0)), number * pace_ns)
        assert counters["late"] < 120
        assert counters["lost"] == 0


def test_an_interface_without_a_stamp_gives_samples():
    """Late only at the start and after a silence."""
    counters = dict.fromkeys(COUNTED, 0)
    sieve = Sieve(1_000_000, 20_000_000, counters)
    found = [sieve.take(Frame(0, 0, (float(n), 0.0, 0.0), (0.0, 0.0, 0.0)), n * 1_000_000) for n in range(500)]
    assert all(found[101:])
    assert not sieve.take(Frame(0, 0, (-1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 600_000_000)


@pytest.mark.parametrize("seed", range(20))
def test_no_sample_is_at_a_wrong_time_or_twice_whatever_happens(seed):
    """Loss, doubling and a reader that stands still: each published sample is one that was measured, at its time, once."""
    process = Process(lose=0.02, double=0.05, stall=0.005, seed=seed)
    run = run_of(process).seconds(4.0)
    samples = wrenches(run)
    assert len(samples) > 500
    numbers = [int(sample.force.x) for sample in samples]
    assert numbers == sorted(set(numbers))
    # 20 ms is what `stall_s` lets pass; 1 % of the longest stall comes on top.
    assert all(0 <= sample.t_ns - process.measured_ns[int(sample.force.x)] <= 21_200_000 for sample in samples)
    assert [sample.t_ns for sample in samples] == sorted(sample.t_ns for sample in samples)
    counters = run.device.counters
    assert counters["doubled"] > 0
    assert counters["late"] > 0
    assert abs(counters["lost"] - process.lost) <= 2  # at either end of the run none follows that would show it


@pytest.mark.parametrize(
    ("begin_s", "period_us"), [(1, 1000), (17, 500), (2200, 1000), (4200, 1000), (4293, 1000), (4200, 520)]
)
def test_losses_are_counted_exactly_where_the_rounded_stamp_allows(begin_s, period_us):
    """From the first seconds to the last before 2^32 us, and over the turn: one in fifty is lost, each is counted."""
    sensor = Sensor("", "", "", period_us)
    process = Process(sensor, begin_us=begin_s * 1_000_000, lose=0.02, seed=3)
    run = run_of(process).seconds(4.0)
    assert process.lost > 50
    assert abs(run.device.counters["lost"] - process.lost) <= 2


@pytest.mark.parametrize("period_us", [250, 333])
def test_where_the_stamp_is_too_coarse_no_loss_is_made_up(period_us):
    """At 3 and 4 kHz after 70 minutes equal stamps are no doubled frames, and nothing counts as lost that was not."""
    process = Process(Sensor("", "", "", period_us), begin_us=4200 * 1_000_000)
    run = run_of(process).seconds(1.0)
    assert {run.device.counters[name] for name in ("lost", "doubled")} == {0}
    assert run.device.counters["samples"] > 870_000 / period_us


@pytest.mark.parametrize(
    ("before", "after", "lost"),
    [
        (1000, 2000, 0),
        (1000, 4000, 2),
        (4000, 1000, 0),  # backwards
        ((1 << 32) - 1024, 1976, 2),  # over the turn
        (rounded(3_000_000_000), rounded(3_000_002_000), 1),
        (rounded(3_000_000_000), rounded(3_000_001_000), 0),
    ],
)
def test_missing_frames_between_two_stamps(before, after, lost):
    """At 1 kHz."""
    assert missing(before, after, 1000.0) == lost


def test_a_clock_that_was_set_is_no_loss():
    """A leap of the stamp of ten minutes within a second of ours has no room for that many frames."""
    counters = dict.fromkeys(COUNTED, 0)
    sieve = Sieve(1_000_000, 20_000_000, counters)
    for number in range(1000):
        stamp = 1000 * number + (600_000_000 if number > 500 else 0)
        sieve.take(Frame(stamp, 0, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)), 1_000_000 * number)
    assert counters == {"late": 200, "lost": 0, "doubled": 0}  # 100 ms after each beginning
