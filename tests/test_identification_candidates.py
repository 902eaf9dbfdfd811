"""The table of candidates recommends what the data hold, and only that."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from calibration_sim import BIAS, body, sweep

from galen_hw.identification.candidates import compare
from galen_hw.identification.fit import fit
from galen_hw.identification.model import Unknowns

DRIFT = [0.05, 0.0, 0.03, 0.0, 0.0, 0.0]


def recommended(**case):
    return compare(sweep(np.random.default_rng(case.pop("seed", 0)), **case))


def test_clean_sweeps_get_no_extra_unknown():
    """In 20 clean sweeps at most one is given a drift or a tilt by chance."""
    keys = [recommended(seed=seed).recommended for seed in range(20)]

    assert keys.count("robust") >= 19


@pytest.mark.parametrize(
    ("case", "key"),
    [
        ({"drift": DRIFT}, "drift"),
        ({"tilt": (0.01, -0.005, 0.0)}, "tilt"),
        ({"drift": DRIFT, "tilt": (0.01, -0.005, 0.0)}, "both"),
        ({"touched": 5}, "robust"),
    ],
    ids=str,
)
def test_what_is_there_is_recommended(case, key):
    """A drift of 2 sigma of a sample, a base tilted by half a degree, both, or touches: each gets its fit."""
    found = recommended(**case)

    assert found.recommended == key
    mass = found.best.estimate
    assert abs(mass["mass"] - body().mass) < 5.0 * mass.std[0]


def test_a_drift_is_not_fitted_without_returns_home():
    """Without homes nothing separates a drift from the order of the poses: the candidate is not offered."""
    found = recommended(home_every=1000, drift=DRIFT, bare=0)

    assert "drift2" not in [c.key for c in found.candidates]


def test_left_out_errors_are_those_of_fitting_without_the_pose():
    """The closed form (1 - H)^-1 r equals refitting for plain least squares with the same weights."""
    poses = sweep(np.random.default_rng(2), bare=0).fit
    row = next(c for c in compare(poses).candidates if c.key == "joint")
    for i in (0, 17, 40):
        others = np.arange(len(poses)) != i
        refitted = fit(poses.select(others), Unknowns(), robust=False)
        one = type(refitted.model)(poses.select(~others), Unknowns(), (0.0, 1.0))
        error = poses.wrench[i] - one.evaluate(refitted.theta)[0][0]
        assert row.left_out[i] == pytest.approx(error, rel=0.05, abs=2e-5)


def test_the_reports_two_steps_are_worse_where_the_sensor_has_an_offset():
    """An offset of 20 mN leaves the report's fit five times worse on unseen poses; the joint fit does not mind."""
    rows = {c.key: c for c in recommended(offset=[0.02, 0.0, 0.02, 0.0, 0.0, 0.0]).candidates}

    assert rows["report"].left_out_rms[0] > 5.0 * rows["robust"].left_out_rms[0]


def test_without_bare_poses_the_zeroing_tells_tool_from_bias_body():
    """Tool poses only: the tool's own mass within its (wider) interval, and a body of 85 g beside it."""
    found = recommended(bare=0)
    what = found.best.estimate

    assert found.recommended == "zeroing"
    assert abs(what.mass - body().mass) < what.t95 * what.std[0] < 0.01
    assert what.bias_body.mass == pytest.approx(BIAS.mass, abs=0.01)
    assert np.all(np.abs(what.com - body().com) < what.t95 * what.std[1:4])


def test_the_zeroing_is_not_trusted_where_the_offset_cannot_come_from_it():
    """Half a newton across gravity is no bias body's: the payload as a whole is fitted then."""
    found = recommended(bare=0, offset=[0.5, 0.3, 0.0, 0.0, 0.0, 0.0])

    assert found.recommended == "robust"
    assert found.best.mass == pytest.approx(body().mass + BIAS.mass, abs=1e-3)
