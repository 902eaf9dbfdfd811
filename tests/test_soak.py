"""The long run: what counts as lost, what counts as flat, and that it runs at all, for some seconds."""

import math

import pytest

from galen_hw.tools import soak


def test_memory_is_flat_or_not_by_its_second_half() -> None:
    """What grows at the start and then stays is flat; 3 MB an hour is not."""
    settled = [(float(t), 1e8 + min(t, 100) * 1e5) for t in range(0, 600, 5)]
    grows = [(float(t), 1e8 + t * 3e6 / 3600) for t in range(0, 600, 5)]

    assert soak.slope(settled)[0] == pytest.approx(0.0, abs=1e3)
    assert soak.slope(grows)[0] == pytest.approx(3e6, rel=1e-3)
    assert math.isnan(soak.slope([(0.0, math.nan)] * 9)[0])
    story = soak.Story(memory={"core": settled})
    assert soak.report(story, 3600.0)[1]
    story.memory["health"] = grows
    text, good = soak.report(story, 3600.0)
    assert not good
    assert "+3.00 +- 0.00 MB/h" in text


def test_a_short_run_says_that_it_was_short() -> None:
    """Five minutes are no hour, and tell nothing of an hour's growth."""
    grows = [(float(t), 1e8 + t * 3e7 / 3600) for t in range(0, 300, 5)]
    text, good = soak.report(soak.Story(memory={"core": grows}, load=[9.0], stalls=[0.03, 0.4]), 300.0)

    assert good
    assert text.startswith("5 minutes (not the 60 that are asked for) at 1 kHz")
    assert "load average 9.0; the machine kept a sleeping program waiting 2 times for 20 ms or more, 0.40 s" in text
    assert "too short a run to tell a slope" in text
    assert "(not the" not in soak.report(soak.Story(), 3600.0)[0]


def test_what_the_machine_loses_is_told_apart() -> None:
    """A sample that the driver did not get while no program ran is no promise broken; any other is."""
    text, good = soak.report(soak.Story(wire=6, stalled=6), 60.0)
    assert good
    assert "kept its programs waiting | - | 6 |" in text
    assert not soak.report(soak.Story(wire=7, stalled=6), 60.0)[1]


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
