"""Mark isolated samples before any fit, and confirm those that the final model does not explain."""

from typing import Final

import numpy as np
from scipy.stats import norm

from galen_hw.diagnosis.detection.stuck_samples import repeated
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.physics.effects.events import Glitches
from galen_hw.physics.signals.differentiation import isolated
from galen_hw.spatial import Array

FEWEST: Final = 2
"""Isolated samples that are a finding."""
FAR: Final = 6.0
"""Standard deviations by which a glitch must differ from the model, not only from its neighbours."""
NEAR: Final = 3.5
MOST_SPOILT = 0.03
"""Share of a channel's samples: more isolated ones are another kind of noise."""


def marked(bench: Bench) -> list[Glitches]:
    """Mark isolated and repeated samples, and leave them out of everything."""
    spiky = spikes(bench.scene.raw_residual, tuple(bench.scene.segments))
    spiky |= repeated(bench.scene)
    spoilt = np.asarray(spiky.any(axis=1))
    rows = np.flatnonzero(spoilt)
    if len(rows) < FEWEST:
        return []
    bench.leave_out(spoilt)
    names = tuple(n for n, m in zip(bench.scene.channels, np.asarray(spiky.any(axis=0)), strict=True) if m)
    return [Glitches(names, tuple(int(r) for r in rows))]


def sample_residual(model: Model) -> Array:
    """Return the residual of every single sample (N, C)."""
    bench = model.bench
    place = np.searchsorted(bench.rows.starts, np.arange(len(bench.scene)), side="right") - 1
    return np.asarray(bench.scene.raw_residual - (bench.whole - model.residual())[place])


def deviations(bench: Bench, residual: Array) -> Array:
    """Return residuals of samples (N, C) in standard deviations of one sample; 0 where nothing was recorded."""
    return np.asarray(np.nan_to_num(np.abs(residual) / (np.sqrt(bench.rows.stride) * bench.noise.sigma)))


def confirmed(glitch: list[Glitches], model: Model) -> list[Glitches]:
    """Return the isolated samples that the model does not explain: a cusp of physics looks isolated until it is modelled.

    Repeated samples are all kept once some of them are far from the model's prediction: a stale value need not be wrong.
    """
    if not glitch:
        return []
    bench, out = model.bench, []
    z, again = deviations(bench, sample_residual(model)), repeated(bench.scene)
    single = np.where(again, 0.0, z)
    for one in glitch:
        rows = np.array(one.rows)
        channels = [bench.scene.channels.index(name) for name in one.channels]
        alone, old = z[rows] > FAR, again[rows]
        alone &= old | ~_heavy_tailed(single, (single[rows] > FAR).sum(axis=0))
        kept = alone[:, channels].any(axis=1)
        names = tuple(bench.scene.channels[c] for c in channels if alone[kept, c].any())
        hung = old.any(axis=1)
        kept |= hung & (np.sum(kept & hung) >= FEWEST)
        if kept.sum() >= FEWEST:
            out.append(Glitches(names, tuple(int(r) for r in rows[kept])))
    return out


def _heavy_tailed(z: Array, far: Array) -> Mask:
    """Return in which channels (C,) the far samples (C,) are the end of a heavy tail of deviations (N, C).

    Of noise with heavy tails more samples lie between `NEAR` and `FAR` than beyond: with Student's t of three degrees of freedom
    four times as many, of two still twice; outliers of a uniform size have hardly any there.
    """
    between = np.sum((z > NEAR) & (z <= FAR), axis=0)
    usual = 2.0 * len(z) * float(norm.sf(NEAR))
    return np.asarray(between - 2.0 * usual > far)


def spikes(residual: Array, segments: tuple[slice, ...], *, handful: int = 4) -> Mask:
    """Return isolated samples (N, C), see `differentiation.isolated`; none of a channel in which they are too many.

    More than 3 % of a channel's samples are another kind of noise; of a sweep of few poses a handful is more than that.

    Args:
        handful: isolated samples of one channel that are always reported.
    """
    out = np.zeros(residual.shape, dtype=bool)
    for part in segments:
        for c in range(residual.shape[1]):
            out[part, c] = isolated(residual[part, c])
    out[:, out.sum(axis=0) > max(MOST_SPOILT * len(out), handful)] = False
    return out
