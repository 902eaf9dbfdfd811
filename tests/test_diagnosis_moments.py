"""What belongs to moments is learnt where it is; the rest of the model is learnt beside it as it is."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from diagnosis_cases import SIGMA, WRENCH, Bench

from galen_hw.diagnosis.engine import diagnose
from galen_hw.diagnosis.final import Model
from galen_hw.physics.sensor_effects import Drift
from galen_hw.physics.table import scene_of


def test_offsets_are_learnt_beside_the_drift_that_is_told() -> None:
    """A line and a wander share what they do on few blocks: an offset that was learnt beside others of them fits none."""
    case = Bench(3)
    period, length = 41.0, float(case.t[-1])
    case.wrench[:, 1] += 0.015 * np.sin(2.0 * np.pi * case.t / period) + 0.02 * np.sin(0.7 * np.pi * case.t / period)
    work = diagnose(scene_of(case.observations()))
    bench, nuisances = work.bench, work.model.nuisances
    forms = [Drift(WRENCH[1], form, None, 0.0, length) for form in ("wander", "linear")]
    model = Model(bench, nuisances, [bench.add(form) for form in forms], bench.whitened(bench.whole))
    rest = model.rest()[bench.train, 1]
    assert abs(float(rest.mean())) < 4.0 * SIGMA[1] / np.sqrt(len(rest))
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is not None:
            np.testing.assert_array_equal(model.theta[s], model.final[s])
