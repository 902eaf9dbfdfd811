"""What noise does below the slowest band that a recording measures: flat below a corner, or rising as flicker noise does.

Noise with a memory (a filter, a servo, a settling converter) is flat below its corner; flicker noise goes on rising. Both are
fitted to the measured bands by their likelihood (Whittle 1953), and a corner is believed where it is the better one for certain.
"""

from typing import TYPE_CHECKING

import numpy as np

from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.rows import Index

CERTAIN = 9.0
"""Twice the log likelihood ratio, over all channels, from which a corner is believed; one of flicker noise reaches 6."""
CONTRARY = -2.0
"""Below it a channel speaks against what the others say."""
HIDDEN = 1.5
"""The same ratio from which flicker noise is there beside the corner: in doubt nothing is flat."""
LIKE_NOISE = 3.0
"""Deviance a band up to which floor and shelf are what the noise looks like: 1 for such noise; physics that is left has humps."""
WINDOWED = 1.94
"""Lines of a Hann window's spectrum that are worth one independent line."""
LEAST_BANDS = 6
CORNERS, SLOPES = 24, 15
ITERATIONS = 150


def shelves(centres: Array, levels: Array, lines: Array) -> Array:
    """(C,) level below the corner of each channel's noise, a standard error up; nan where it is not flat there for certain.

    Args:
        centres: (B,) of the bands, cycles a row; levels: (B, C); lines: (B,) of the spectrum in each band.
    """
    if len(centres) < LEAST_BANDS:
        return np.full(levels.shape[1], np.nan)
    corners = np.geomspace(1.5 * centres[0], centres[-1], CORNERS)
    bends = 1.0 / (1.0 + (centres / corners[:, None]) ** 2)
    slopes = (centres / centres[0]) ** -np.linspace(0.25, 2.0, SLOPES)[:, None]
    white, flicker = np.ones_like(centres), centres[0] / centres
    weights = np.maximum(lines, 1.0) / WINDOWED
    corner, fitted, which = _likeliest(levels, weights, [np.stack([white, bend], axis=-1) for bend in bends])
    rising, _, _ = _likeliest(levels, weights, [np.stack([white, slope], axis=-1) for slope in slopes])
    both, _, _ = _likeliest(levels, weights, [np.stack([white, bend, flicker], axis=-1) for bend in bends])
    sure, noise = rising - corner, corner < LIKE_NOISE * len(centres)
    flat = noise & (np.sum(sure[noise]) >= CERTAIN) & (sure > CONTRARY) & (corner - both < HIDDEN)
    # The shelf is known from the bands below the corner alone; in doubt slow noise is stronger.
    known = np.array([np.sum(weights[centres <= corners[k]]) for k in which])
    return np.where(flat, fitted[0] * (1.0 + 1.0 / np.sqrt(known)), np.nan)


def _likeliest(levels: Array, weights: Array, shapes: list[Array]) -> tuple[Array, Array, "Index"]:
    """The best of several sums of shapes (B, K), amplitudes >= 0: (C,) deviance, (B, C) levels, (C,) which.

    Deviance: minus twice the log likelihood over that of the levels themselves, chi square of B less what was fitted.

    Multiplicative updates for the Itakura-Saito divergence, which is this likelihood (Fevotte, Bertin and Durrieu 2009).
    """
    parts = np.stack(shapes)
    peak = np.max(levels, axis=0)
    data = levels / peak
    amplitude = np.full((len(parts), parts.shape[2], levels.shape[1]), 1.0 / parts.shape[2])
    for _ in range(ITERATIONS):
        model = np.maximum(parts @ amplitude, 1e-12)
        pull = np.swapaxes(parts, 1, 2) * weights
        amplitude *= (pull @ (data / model**2)) / (pull @ (1.0 / model))
    model = np.maximum(parts @ amplitude, 1e-12)
    cost = 2.0 * np.sum(weights[:, None] * (data / model - np.log(data / model) - 1.0), axis=1)
    best = np.argmin(cost, axis=0)
    each = np.arange(levels.shape[1])
    return np.asarray(cost[best, each]), np.asarray(model[best, :, each].T * peak), best
