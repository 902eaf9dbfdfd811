"""A search that is stopped: the best model so far is judged, and the answer says that it was stopped."""

from itertools import count
from pathlib import Path

import numpy as np
import pytest

from galen_hw.cli import main
from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.stats import deadline
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations


def two_errors() -> Observations:
    """Two joints' positions, one 30 ms late and one 2 % off in scale."""
    t = np.arange(3000) / 100.0
    rng = np.random.default_rng(5)
    said = {f"joint.{n}.position": np.sin((0.7 + 0.3 * k) * t + k) for k, n in enumerate(("pan", "tilt"))}
    read = {
        "joint.pan.position": np.sin(0.7 * (t - 0.03)) + 2e-4 * rng.normal(size=len(t)),
        "joint.tilt.position": 1.02 * said["joint.tilt.position"] + 2e-4 * rng.normal(size=len(t)),
    }
    return Observations("position", {"time": t} | read, {"time": t} | said, Belief(bias_free=True))


def test_a_search_that_ends_by_itself_says_nothing_of_time() -> None:
    found = diagnose(scene_of(two_errors())).diagnosis
    assert found.findings
    assert not any("stopped" in note for note in found.notes)


def test_a_search_that_is_stopped_at_once_claims_nothing_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = count()
    monkeypatch.setattr(deadline, "monotonic", lambda: float(next(seconds)))
    found = diagnose(scene_of(two_errors()), time_limit=1e-6).diagnosis
    assert not [f for f in found.findings if f.named]
    assert found.verdict == "unexplained"
    assert "stopped" in found.notes[0]
    assert "--time-limit" in found.notes[0]


def test_a_search_that_is_stopped_between_judges_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time goes on by a second whenever somebody asks for it: the same asks on any machine."""
    seconds = count()
    monkeypatch.setattr(deadline, "monotonic", lambda: float(next(seconds)))
    found = diagnose(scene_of(two_errors()), time_limit=20.0).diagnosis
    assert "stopped" in found.notes[0]
    assert found.verdict != "agrees"
    for name in found.fit["rmse_before"]:
        assert found.fit["rmse_after"][name] <= found.fit["rmse_before"][name]


@pytest.mark.parametrize(("given", "told"), [("-3", "not a time"), ("soon", "is no number in s")])
def test_a_time_limit_that_is_none_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], given: str, told: str
) -> None:
    try:
        status = main(["diagnose", str(tmp_path / "no.mcap"), "--time-limit", given])
    except SystemExit as ended:  # by argparse
        status = ended.code  # type: ignore[assignment]
    assert status == 2
    assert told in capsys.readouterr().err
