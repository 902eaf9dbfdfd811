"""The long run: what counts as lost, what counts as flat, and that it runs at all, for some seconds."""

import math

import pytest

from galen_hw.tools import soak


def test_memory_is_flat_or_not_by_its_second_half() -> None:
    """What grows at the start and then stays is flat; 3 MB an hour is not."""
    settled = [(float(t), 1e8 + min(t, 100) * 1e5) for t in range(0, 600, 5)]
    grows = [(float(t), 1e8 + t * 3e6 / 3600) for t in range(0, 600, 5)]

    assert soak.slope(settled) == pytest.approx(0.0, abs=1e3)
    assert soak.slope(grows) == pytest.approx(3e6, rel=1e-3)
    assert math.isnan(soak.slope([(0.0, math.nan)] * 9))
    story = soak.Story(memory={"core": settled})
    assert soak.report(story, 600.0)[1]
    story.memory["health"] = grows
    text, good = soak.report(story, 600.0)
    assert not good
    assert "+3.00 MB/h" in text


def test_a_loss_within_a_fault_and_shortly_after_is_the_faults() -> None:
    """One at another time is not, and the report says so."""
    story = soak.Story()
    assert not story.excused(1.0)
    story.faulty = True
    assert story.excused(1.0)
    story.faulty, story.faulty_until = False, 10.0
    assert story.excused(9.0)
    assert not story.excused(11.0)
    assert not soak.report(soak.Story(lost=1), 60.0)[1]
    assert not soak.report(soak.Story(wire=1), 60.0)[1]


@pytest.mark.live
@pytest.mark.slow
@pytest.mark.timeout(400)
def test_some_seconds_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight listeners hear a thousand samples a second each, two are stuck, a fault has come and gone."""
    monkeypatch.setattr(soak, "BETWEEN_S", (1.0, 2.0))
    monkeypatch.setattr(soak, "LOOK_S", 0.5)
    story = soak.run(8.0, seed=1)

    assert story.samples > 8 * 8 * 300  # of a machine that tests beside it
    assert story.faults
    assert {"core", "motion", "health"} <= story.memory.keys()
