"""Isolated samples: marked before anything is fitted, believed once the physics does not explain them either."""

from typing import Final

import numpy as np
from scipy.stats import norm

from galen_hw.diagnosis import seek
from galen_hw.diagnosis.bench import Bench
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.rows import Mask
from galen_hw.physics.event_effects import Glitches
from galen_hw.spatial import Array

FEWEST: Final = 2
"""Isolated samples that are a finding."""
FAR: Final = 6.0
"""Standard deviations by which a glitch must stand off what the model says, not only off its neighbours."""
NEAR: Final = 3.5
TAIL: Final = 3.0
"""Noise with heavy tails: so many times more samples between so many standard deviations and `FAR` than beyond it."""


def marked(bench: Bench) -> list[Glitches]:
    """Marks isolated samples and leaves them out of everything."""
    spiky = seek.spikes(bench.scene.raw_residual, tuple(bench.scene.segments))
    spoilt = np.asarray(spiky.any(axis=1))
    rows = np.flatnonzero(spoilt)
    if len(rows) < FEWEST:
        return []
    bench.leave_out(spoilt)
    names = tuple(n for n, m in zip(bench.scene.channels, np.asarray(spiky.any(axis=0)), strict=True) if m)
    return [Glitches(names, tuple(int(r) for r in rows))]


def confirmed(glitch: list[Glitches], model: Model) -> list[Glitches]:
    """Isolated samples that the model does not explain either: a cusp of physics looks isolated until it is modelled."""
    bench = model.bench
    place = np.searchsorted(bench.rows.starts, np.arange(len(bench.scene)), side="right") - 1
    explained = bench.whole - model.rest()
    out = []
    for one in glitch:
        rows = np.array(one.rows)
        channels = [bench.scene.channels.index(name) for name in one.channels]
        rest = bench.scene.raw_residual[rows] - explained[place[rows]]
        far = np.abs(rest) > FAR * np.sqrt(bench.rows.stride) * bench.noise.sigma
        far &= ~_heavy_tailed(bench.scene.raw_residual - explained[place], bench, far.sum(axis=0))
        kept = far[:, channels].any(axis=1)
        names = tuple(bench.scene.channels[c] for c in channels if far[kept, c].any())
        if kept.sum() >= FEWEST:
            out.append(Glitches(names, tuple(int(r) for r in rows[kept])))
    return out


def _heavy_tailed(rest: Array, bench: Bench, far: Array) -> Mask:
    """(C,) whether a channel's far samples (C,) are but the end of a tail that thins out towards them (N, C)."""
    z = np.abs(rest) / (np.sqrt(bench.rows.stride) * bench.noise.sigma)
    between = np.sum((z > NEAR) & (z <= FAR), axis=0)
    usual = 2.0 * len(z) * float(norm.sf(NEAR))
    return np.asarray(between - 2.0 * usual > TAIL * far)
