"""Broken gauges of virtual sensors, met by the real drivers over frames, in simulated time."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from conformance.peer import virtual_run

from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.gauge_watch import GaugeWatch, most_of, noise_of
from galen_hw.drivers.robotous_rft import RobotousRft
from galen_hw.drivers.virtual.ati_netcanoem import AtiSettings, VirtualAtiNetcanoem
from galen_hw.drivers.virtual.robotous_rft import RftSettings, VirtualRobotousRft
from galen_hw.drivers.virtual.world import World
from galen_hw.messages import Request

SENSORS = {
    "ati": (AtiNetcanoem, lambda world: VirtualAtiNetcanoem(AtiSettings(), world)),
    "rft": (RobotousRft, lambda world: VirtualRobotousRft(RftSettings(), world)),
}


def zeroed(kind, **settings):
    """A run whose sensor has been zeroed; what it said until then is forgotten."""
    cls, make = SENSORS[kind]
    world = World(seed=1)
    run = virtual_run(cls, make(world), world, **settings).seconds(1.5)
    run.outputs += run.device.request(Request(id="z", target="ft", name="zero", args={"samples": 100}), run.now_ns)
    run.seconds(2.0)
    assert run.replies[-1].error is None
    run.outputs.clear()
    return run


def first_invalid_s(run, begun_ns):
    return next((w.t_ns - begun_ns) / 1e9 for w in run.messages("wrench/raw") if not w.valid)


@pytest.mark.parametrize(
    ("kind", "fault", "name", "what"),
    [
        *[("ati", f"ft.stuck_gauge.{k}", f"strain gauge {k}", "is stuck") for k in range(6)],
        ("ati", "ft.noise.360", "strain gauge", "times its own noise"),
        *[("rft", f"ft.stuck_axis.{k}", f"axis {axis}", "is stuck") for k, axis in enumerate(("Fx", "Fy", "Fz"))],
        ("rft", "ft.noise.75", "axis", "times its own noise"),
        ("rft", "ft.stuck", "the sensor", "hangs"),
    ],
)
def test_a_broken_gauge_is_a_fault_within_half_a_second(kind, fault, name, what):
    """Stuck, a hundred times as loud, or hanging: not valid, a fault and a status that name it; well again, it ends."""
    run = zeroed(kind)
    begun_ns = run.now_ns
    run.peer.world.faults.add(fault)
    run.seconds(1.6)
    assert first_invalid_s(run, begun_ns) < 0.5
    assert not any(w.valid for w in run.messages("wrench/raw") if w.t_ns > begun_ns + 0.5e9)
    assert name in run.messages("fault")[0].what
    assert what in run.messages("fault")[0].what
    status = run.messages("status")[-1]
    assert status.state == "fault"
    assert name in status.detail
    assert status.todo == run.messages("fault")[0].todo
    run.peer.world.faults.clear()
    run.seconds(2.0)
    assert run.messages("wrench/raw")[-1].valid
    assert run.messages("status")[-1].state == "ready"


@pytest.mark.parametrize("kind", SENSORS)
def test_a_broken_sensor_cannot_be_zeroed(kind):
    """Its noise would become the measure of itself."""
    run = zeroed(kind)
    run.peer.world.faults.add("ft.noise.300")
    run.seconds(0.5)
    run.outputs += run.device.request(Request(id="y", target="ft", name="zero", args={"samples": 100}), run.now_ns)
    run.seconds(1.0)
    assert "times its own noise" in run.replies[-1].error.what


@pytest.mark.parametrize(("kind", "settings"), [("ati", {}), ("rft", {}), ("rft", {"rate_hz": 1000, "filter_hz": 10})])
def test_pushes_knocks_and_loads_are_no_faults(kind, settings):
    """An operator pushes quickly and slowly, knocks, changes the tool: every sample stays valid, and nothing is said."""
    run = zeroed(kind, **settings)
    world = run.peer.world
    for force, seconds, rise_s in ((10, 0.2, 0.1), (25, 0.5, 0.3), (15, 0.01, 0.0), (8, 0.05, 0.02), (20, 1.0, 0.5)):
        world.advance(run.now_ns)
        world.push(force=(force, -force / 2, force / 3), seconds=seconds, rise_s=rise_s)
        run.seconds(seconds + 2 * rise_s + 0.1)
    world.attach("pointer")
    run.seconds(1.0)
    assert all(w.valid for w in run.messages("wrench/raw"))
    assert run.messages("fault") == []


@pytest.mark.parametrize("kind", SENSORS)
@pytest.mark.parametrize("fault", ["ft.lost_first", "ft.lost_second"])
def test_half_samples_alone_are_a_fault(kind, fault):
    """Every first (or second) frame is lost: a fault that says so, never ready; whole again, samples flow."""
    run = zeroed(kind)
    run.peer.world.faults.add(fault)
    run.seconds(8.0)
    assert run.messages("wrench/raw") == []
    assert not run.device.ready
    assert any("whole" in f.what for f in run.messages("fault"))
    assert {s.state for s in run.messages("status")[2:]} <= {"fault", "starting"}
    run.peer.world.faults.clear()
    run.seconds(3.0)
    assert run.device.ready
    assert run.messages("status")[-1].state == "ready"


def watch_of(rng, sigma, rate_hz=1000.0, mean=0.3):
    watch = GaugeWatch(rate_hz)
    for row in np.rint(mean + sigma * rng.standard_normal((300, 6))).tolist():
        watch.take(tuple(row))
    watch.learn()
    return watch


@pytest.mark.parametrize("quiet", [0.0, 0.05, 0.1, 0.2, 0.3])
def test_a_gauge_quieter_than_its_rounding_may_repeat(quiet):
    """It toggles between two counts when it is zeroed, and rests on one under another load: no fault, whatever its fellows."""
    rng = np.random.default_rng(7)
    sigma = np.array([quiet, 0.8, 0.8, 0.9, 0.7, 0.8])
    watch = watch_of(rng, sigma, mean=np.array([0.5, 0.3, 0.1, 0.2, 0.4, 0.7]))
    for row in np.rint(sigma * rng.standard_normal((20_000, 6))).tolist():
        if watch.take(tuple(row)):
            watch.judge()
        assert watch.broken == ()


def test_a_sensor_that_is_slower_than_it_is_read_repeats_whole_samples():
    """Each sample comes four times: that is its way, and no fault."""
    rng = np.random.default_rng(3)
    watch = GaugeWatch(1000.0)
    rows = np.repeat(np.rint(4.0 * rng.standard_normal((3000, 6))), 4, axis=0).tolist()
    for row in rows[:1000]:
        watch.take(tuple(row))
    watch.learn()
    for row in rows[1000:]:
        if watch.take(tuple(row)):
            watch.judge()
        assert watch.broken == ()


def test_the_level_is_what_it_says():
    """The binomial's tail: exact at small numbers, and never above the level."""
    assert most_of(2, 0.5, 0.25) == 2
    assert most_of(2, 0.5, 0.2) == 3
    assert most_of(2, 0.5, 0.75) == 1
    for n, p in ((12, 0.05), (99, 0.0455), (99, 0.38)):
        k = most_of(n, p, 1e-6)
        draws = np.random.default_rng(1).binomial(n, p, 400_000)
        assert np.count_nonzero(draws >= k) <= 3


def test_noise_is_measured_beside_a_load():
    """A push of 5000 counts in a second and a knock leave the noise's measure alone to a tenth."""
    rng = np.random.default_rng(5)
    t = np.arange(1000)[:, None] / 1000.0
    counts = 5000.0 * np.sin(np.pi * t) + 4.0 * rng.standard_normal((1000, 6))
    counts[500:505] += 3000.0
    np.testing.assert_allclose(noise_of(np.rint(counts)), 4.0, rtol=0.15)


def test_no_sample_waits_for_the_gauges_to_be_judged():
    """Judging takes as long as a sample's whole way: it comes with the next request, after the sample has left."""
    run = zeroed("ati")
    device = run.device
    judged_in_feed, feed, judge = [], device.feed, device._judge_gauges
    inside = False

    def watched_feed(wire, t_ns):
        nonlocal inside
        inside = True
        found = feed(wire, t_ns)
        inside = False
        return found

    device.feed = watched_feed
    device._judge_gauges = lambda now_ns: (judged_in_feed.append(inside), judge(now_ns))
    run.seconds(1.0)
    assert len(judged_in_feed) >= 19
    assert not any(judged_in_feed)
