"""Simulated calibrations for the fits: the nominal sweep with noise, offsets, drift, touches and wrong premises."""

import numpy as np

from galen_hw.drivers.virtual.truth import BIAS_BODY, NOISE_SIGMA, TOOLS
from galen_hw.identification.poses import Poses
from galen_hw.physics.rigid import Body, predicted_wrench
from galen_hw.spatial import rotation_about, rotation_exp

SIGMA = np.array(NOISE_SIGMA)
BIAS = Body(BIAS_BODY.mass, np.array(BIAS_BODY.com))


def body(tool="retractor"):
    return Body(TOOLS[tool].mass, np.array(TOOLS[tool].com))


def sweep(
    rng,
    *,
    tool="retractor",
    bare=6,
    samples=300,
    noise=1.0,
    drift=None,
    touched=0,
    offset=None,
    tilt=(0.0, 0.0, 0.0),
    mount=(0.0, 0.0, 0.0),
    span=(0.6, 0.9),
    home_every=10,
):
    """Poses as the sweep service measures them: bare ones, the shuffled grid with homes, 8 held out.

    `drift` is the change over the sweep, `tilt` and `mount` are rotation vectors of gravity and sensor.
    """
    grid = np.array([(t, r) for t in np.linspace(-1, 1, 7) * span[0] for r in np.linspace(-1, 1, 8) * span[1]])
    rows = [(0.0, 0.0, 0, 1, 0)] if bare else []
    phases = np.linspace(0.0, 2 * np.pi, bare, endpoint=False) + 0.7
    rows += [(span[0] * np.sin(phase), span[1] * np.cos(phase), 0, 0, 0) for phase in phases]
    for i, (t, r) in enumerate(grid[rng.permutation(len(grid))]):
        rows += [(0.0, 0.0, 1, 1, 0)] if i % home_every == 0 else []
        rows.append((t, r, 1, 0, 0))
    rows.append((0.0, 0.0, 1, 1, 0))
    rows += [(*(rng.uniform(-1, 1, 2) * span), 1, 0, 1) for _ in range(8)]
    tilts, rolls, on, home, verify = np.array(rows).T
    R = rotation_about(0, rolls) @ rotation_about(1, tilts)
    gravity = rotation_exp(tilt) @ np.array([0.0, 0.0, -9.80665])
    wrench = _readings(R @ rotation_exp(mount), on > 0, body(tool), rotation_exp(mount), gravity)
    time = 1.3 * np.arange(len(R))
    if noise:
        # The noise of the zeroing's own average stays in every reading.
        wrench = wrench + noise * SIGMA * (rng.normal(size=6) / np.sqrt(1000.0))
        wrench = wrench + noise * SIGMA / np.sqrt(samples) * rng.normal(size=wrench.shape)
    wrench = wrench + (0.0 if offset is None else np.asarray(offset))
    if drift is not None:
        wrench = wrench + (time / time[-1])[:, None] * np.asarray(drift)
    for i in rng.choice(np.flatnonzero((on > 0) & (verify < 1)), touched, replace=False):
        wrench[i] += rng.normal(size=6) * [1.0, 1.0, 1.0, 0.05, 0.05, 0.05]
    variance = np.broadcast_to((max(noise, 1e-9) * SIGMA) ** 2 / samples, wrench.shape)
    variance = variance * rng.chisquare(samples - 1, size=wrench.shape) / (samples - 1)
    return Poses(R, wrench, variance, time, on > 0, verify > 0, home > 0, noise=noise * SIGMA, zero=np.eye(3))


def _readings(R, on, tool, zero, gravity):
    known = {"bias_body": BIAS, "zeroed_rotation": zero, "gravity": gravity}
    return np.where(on[:, None], predicted_wrench(R, tool, **known), predicted_wrench(R, Body(), **known))
