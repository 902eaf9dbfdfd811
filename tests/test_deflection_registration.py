"""Registration of the tracker and what is noticed while recording: the real driver against the virtual tracker."""

from typing import Any

import numpy as np
import pytest

from galen_hw.drivers.ndi_tracker import NdiTracker
from galen_hw.drivers.virtual.ndi_tracker import VirtualNdiTracker
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import UsageError
from galen_hw.identification.deflection.registration import MarkerWatch, register, register_both, true_tip
from galen_hw.kinematics import GalenRobot
from galen_hw.spatial import Array, rotation_exp, transform
from galen_hw.tools.collect.rows import Rows
from tests.ndi_parts import MARKERS
from tests.serial_pair import TIME_BASE, Pair

ROBOT = GalenRobot()
MOVED = "the reference marker or the tracker was moved"


def poses(rng: np.random.Generator, count: int, metres: float = 1.0, radians: float = 1.0) -> Array:
    """(count, 4, 4) poses, spread so far."""
    turns = rotation_exp(radians * rng.normal(size=(count, 3)))
    return transform(turns, metres * rng.normal(size=(count, 3)))


def test_markers_whose_places_nobody_knows_are_found_from_poses_without_force() -> None:
    """Robot-world and hand-eye at once, exact on exact data; poses that all turn about one axis are refused."""
    rng = np.random.default_rng(0)
    X, Z, B = poses(rng, 1)[0], poses(rng, 1)[0], poses(rng, 8)
    found = register_both(X @ B @ Z, B)
    assert np.abs(found.T_marker_base - X).max() < 1e-9
    assert np.abs(found.T_tip_tool - Z).max() < 1e-9
    flat = transform(rotation_exp(np.outer(rng.normal(size=8), [0.0, 0.0, 1.0])), rng.normal(size=(8, 3)))
    with pytest.raises(UsageError, match="do not tell"):
        register_both(X @ flat @ Z, flat)
    with pytest.raises(UsageError, match="3 configurations do not tell"):
        register_both(X @ B[:3] @ Z, B[:3])


def test_the_uncertainty_of_the_registration_is_that_of_repeated_ones() -> None:
    """One sigma by the jackknife against the scatter over 200 registrations of noisy poses: within a half."""
    rng = np.random.default_rng(1)
    X, Z, B = poses(rng, 1)[0], poses(rng, 1, 0.1)[0], poses(rng, 8, 0.1, 0.6)
    found = []
    for _ in range(200):
        noise = transform(rotation_exp(1e-4 * rng.normal(size=(8, 3))), 7e-5 * rng.normal(size=(8, 3)))
        found.append(register_both(X @ B @ Z @ noise, B))
    scatter = np.std([f.T_marker_base[:3, 3] for f in found], axis=0)
    said = np.sqrt(np.mean([f.position_std**2 for f in found], axis=0))
    np.testing.assert_allclose(said, scatter, rtol=0.5)
    assert np.mean([f.scatter_m for f in found]) == pytest.approx(7e-5 * np.sqrt(3), rel=0.4)
    assert np.isnan(register_both(X @ B[:4] @ Z, B[:4]).position_std).all(), "four places are too few to tell"


def test_equations_13_and_14_give_the_base_and_the_true_tip_back() -> None:
    """Over many configurations without force, with outliers and hidden markers; the mean is as sure as it says."""
    rng = np.random.default_rng(2)
    X, count = poses(rng, 1)[0], 400
    B, F = poses(rng, count, 0.1, 0.5), np.repeat(poses(rng, 1), count, axis=0)
    noise = transform(rotation_exp(3e-4 * rng.normal(size=(count, 3))), 7e-5 * rng.normal(size=(count, 3)))
    T = F @ X @ B @ noise
    T[::50, :3, 3] += 0.02
    T[7] = np.nan
    found = register(F, T, B)
    assert not found.used[7]
    assert not found.used[::50].any()
    off = np.abs(found.T_marker_base - X)[:3, 3]
    assert (off < 4.0 * found.position_std + 1e-5).all()
    tip = true_tip(found, F[1:7], T[1:7])
    assert np.linalg.norm((tip - B[1:7])[:, :3, 3], axis=1).max() < 5e-4
    with pytest.raises(UsageError, match="seen in 5 moments only"):
        register(F[:5], T[1:6], B[1:6])


class Tracked:
    """Rows of a collection that listen to a real driver on a virtual tracker, in simulated time."""

    def __init__(self) -> None:
        self.world = World()
        self.world.attach("pointer")
        driver = NdiTracker("tracker", NdiTracker.Settings(markers=MARKERS), TIME_BASE)
        self.pair = Pair(driver, VirtualNdiTracker(VirtualNdiTracker.Settings(), self.world))
        assert self.pair.run(15.0, lambda: driver.ready)
        self.rows = Rows(ROBOT, MarkerWatch())
        self.heard = len(self.pair.said)

    def listen(self, seconds: float = 1.0, fault: str = "") -> list[str]:
        """What is said while time passes, with a fault that strikes for so long."""
        if fault:
            self.world.faults.add(fault)
        lines: list[str] = []
        for _ in range(round(seconds / 0.1)):
            self.pair.run(0.1)
            new: list[Any] = self.pair.said[self.heard :]
            self.heard = len(self.pair.said)
            for topic, message in new:
                if topic.startswith("tracker/"):
                    self.rows.take(topic, message)
            lines += self.rows.look()
        self.world.faults.discard(fault)
        return lines


@pytest.fixture
def tracked() -> Tracked:
    """A second of undisturbed frames has been heard: nothing to say."""
    made = Tracked()
    assert made.listen() == []
    return made


def test_ten_undisturbed_minutes_say_nothing() -> None:
    """Noise alone moves no marker: 36000 frames of the tracker's own noise, not one line."""
    rng, watch = np.random.default_rng(3), MarkerWatch()
    home = transform(np.eye(3), [0.0, 0.0, -1.5])
    count = 36_000
    noise = transform(rotation_exp(3e-4 * rng.normal(size=(count, 3))), 7e-5 * rng.normal(size=(count, 3)))
    lines = [line for k, T in enumerate(home @ noise) for line in watch.look(k, k / 60.0, T, home @ T)]
    assert lines == []


@pytest.mark.parametrize("fault", ["tracker.moved_reference", "tracker.moved_camera"])
def test_a_moved_base_or_tracker_is_noticed_within_half_a_second(tracked: Tracked, fault: str) -> None:
    """A reference marker that is elsewhere is said while it is recorded; put back, nothing more is said."""
    lines = tracked.listen(0.5, fault)
    assert lines
    assert all(line.startswith(MOVED) for line in lines)
    tracked.listen(0.2)
    assert tracked.listen(0.5) == []


def test_swapped_handles_are_noticed(tracked: Tracked) -> None:
    """The tool where the reference was: named as what it is."""
    assert set(tracked.listen(0.5, "tracker.swapped")) == {
        "tool and reference marker have changed places: the handles are swapped"
    }


def test_dropped_frames_are_counted_and_stay_empty(tracked: Tracked) -> None:
    """Every fourth frame is not taken: each loss is counted, the rest goes on in time."""
    before = len(tracked.rows.arrays()["time"])
    lines = tracked.listen(2.0, "tracker.dropped@4")
    assert len(lines) == pytest.approx(30, abs=2)
    assert tracked.rows.warnings["frames lost"] == len(lines)
    time = tracked.rows.arrays()["time"][before:]
    assert len(time) == pytest.approx(90, abs=3)
    assert time[-1] - time[0] == pytest.approx(2.0, abs=0.1)


def test_repeated_frames_are_noticed_and_not_used(tracked: Tracked) -> None:
    """A new number with the poses of the frame before: said, counted, and the row is empty."""
    before = len(tracked.rows.arrays()["time"])
    lines = tracked.listen(1.0, "tracker.repeated@5")
    assert len(lines) == pytest.approx(12, abs=1)
    assert tracked.rows.warnings["frames repeated"] == len(lines)
    seen = np.isfinite(tracked.rows.arrays()["M"][before:, 0, 0])
    assert np.count_nonzero(~seen) == len(lines)


def test_a_restarted_tracker_is_noticed(tracked: Tracked) -> None:
    """The frame number begins again: said at once."""
    lines = tracked.listen(1.0, "tracker.frames_restart")
    assert any("the tracker was restarted" in line for line in lines)


def test_a_jump_in_time_is_noticed(tracked: Tracked) -> None:
    """The frame number goes on by one while the clock has gone on by a second."""
    watch, T = tracked.rows.watch, np.full((4, 4), np.nan)
    frame, time_s = 10_000, 500.0
    watch.look(frame, time_s, T, T)
    assert watch.look(frame + 1, time_s + 1.0, T, T) == ["the clock jumped by +0.98 s, record this set again"]
    assert watch.look(frame + 2, time_s + 1.0 + 1.0 / 60.0, T, T) == []


def test_a_marker_that_slips_on_the_tool_is_off_from_the_registration(tracked: Tracked) -> None:
    """Registered over places, the tool's marker is where it should be; slipped, it is beyond the limits."""
    places = [ROBOT.sensor_pose(q)[0] for q in np.random.default_rng(4).uniform(-0.1, 0.1, (6, 5)) * [1, 1, 1, 6, 6]]
    settings = VirtualNdiTracker.Settings().scene
    X, Z = np.linalg.inv(settings.reference_marker.matrix), settings.tool_marker.matrix
    B = np.array(places)
    noise = poses(np.random.default_rng(5), 6, 1e-5, 5e-5)
    found = register_both(X @ B @ Z @ noise, B)
    limits = found.limits
    assert all(a <= b for a, b in zip(found.off((X @ B @ Z)[0], B[0]), limits, strict=True))
    slipped = (X @ B @ Z)[0] @ settings.moved_by.matrix
    assert found.off(slipped, B[0])[0] > limits[0]
