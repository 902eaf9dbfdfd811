"""Remaining structure that matters, and the verdict that follows."""

import math
from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.structure_test import Structure
from galen_hw.diagnosis.preprocessing.checks import Screening
from galen_hw.diagnosis.result import Finding, Verdict
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.validation.judgement import ELSEWHERE, Judged, touched
from galen_hw.spatial import Array

NOTHING_RECORDED = "nothing that was recorded"
NOTHING_ELSEWHERE = "nothing that holds elsewhere"
FEW_SAMPLES = "few samples"
COMES_AND_GOES = "comes and goes"
"""Words for structure that no function caught."""


def tolerated(judged: Judged) -> Array:
    """Return the model discrepancy that is tolerated, mean square (C,)."""
    return np.asarray(CRITERIA.least_share * np.maximum(judged.before - judged.floor, 0.0))


def above_noise(judged: Judged, model: Model, *, outside_contacts: bool = False) -> list[Structure]:
    """Return channels whose held-out error exceeds noise and tolerated discrepancy; z is the ratio of mean squares.

    `outside_contacts`: contacts are taken as real, and their own residual follows no law.
    """
    bench = model.bench
    after = judged.outside_contacts if outside_contacts and judged.outside_contacts is not None else judged.after
    # A recording contains more low-frequency noise than a single sample's variance shows.
    ratio = after / judged.floor / bench.noise.slow_power_ratio
    believed = np.maximum(after - tolerated(judged), judged.floor) / judged.floor / bench.noise.slow_power_ratio
    rows = int(bench.judged.sum() or bench.train.sum())
    # Slow noise has few independent values.
    luck = CRITERIA.standard_errors(bench.width) * np.sqrt(2.0 / bench.noise.independent(rows))
    # The noise level is an estimate too, with an error as large as that of the mean square.
    enough = np.maximum(CRITERIA.beyond_noise, 1.0 + 2.0 * luck)
    none = np.zeros((len(bench.rows), 0))
    return [
        Structure(
            int(c),
            NOTHING_RECORDED,
            float(ratio[c]),
            float(1.0 - 1.0 / ratio[c]),
            float(np.sqrt(after[c] - judged.floor[c])),
            none,
        )
        for c in np.argsort(-ratio)
        if believed[c] > enough[c]
    ]


def contradicted(judged: Judged, model: Model) -> list[Structure]:
    """Return the same of the recording itself where another one was judged: what explained it may not hold there."""
    if judged.name != ELSEWHERE:
        return []
    bench = model.bench
    free = bench.train & ~touched(model)
    after = np.mean(model.residual()[free if free.any() else bench.train] ** 2, axis=0)
    here = replace(judged, after=after, floor=bench.noise.sigma**2, outside_contacts=None)
    return [replace(one, kind=NOTHING_ELSEWHERE) for one in above_noise(here, model)]


FAR_OFF = 8.0
"""Robust standard deviations from which a sample is far."""
FEW = 0.05
"""Share of the samples that few are at most."""


def outlying(model: Model) -> list[Structure]:
    """Return channels in which few samples hold most of the residual where nothing was found: knocks pass for loud noise.

    z is the mean square over that of a usual sample. Of noise with heavy tails (Student's t of three degrees of freedom) samples
    so far off hold a quarter.
    """
    out, none = [], np.zeros((len(model.bench.rows), 0))
    residual = model.residual()[~model.bench.excluded_rows]
    away = np.abs(residual - np.median(residual, axis=0))
    usual = 1.4826 * np.median(away, axis=0)
    for c in np.flatnonzero(usual > 0.0).tolist():
        far, square = away[:, c] > FAR_OFF * usual[c], away[:, c] ** 2
        share = float(np.sum(square[far]) / np.sum(square))
        if share > 0.5 and np.mean(far) < FEW:
            ratio = float(np.mean(square) / usual[c] ** 2)
            out.append(Structure(c, FEW_SAMPLES, ratio, share, float(np.sqrt(np.mean(square))), none))
    return sorted(out, key=lambda one: -one.z)


SPELLS, OUTER = 20, 4
"""Of a recording, and of these so many at either end of the order by size."""


def unsteady(model: Model, at_once: int = 100) -> list[Structure]:
    """Return channels of a machine at rest whose error comes and goes as no steady noise does.

    Nothing that is simulated moves, so no function of it can show that; but stationary noise has one size. z is the ratio of mean
    squares, about each piece's mean, of the loudest fifth of the pieces over the quietest; in none of so many recordings drawn
    from the noise's own spectrum that all channels together call noise unsteady by `Criteria.chance` is it as large (Besag and
    Clifford 1991: drawing ends with the first that is). Share: of the mean square, what is above the quietest.

    Args:
        at_once: recordings that are drawn at a time; one of the first settles it where there is nothing.
    """
    bench = model.bench
    if bench.scene.moved or np.any(np.ptp(bench.scene.simulated, axis=0) > 0.0) or len(bench.rows) < 8 * SPELLS:
        return []
    rng, out, none = np.random.default_rng(bench.seed), [], np.zeros((len(bench.rows), 0))
    residual, good = model.residual(), ~bench.excluded_rows
    for c in range(bench.width):
        least = bench.steps[c] ** 2 / 12.0 + 1e-6 * bench.noise.sigma[c] ** 2
        found = float(_loudest(residual[good, c, None], float(least))[0])
        draws = (
            bench.noise.colour(rng.standard_normal((len(residual), at_once)), c)[good]
            for _ in range(math.ceil(bench.width / CRITERIA.chance / at_once))
        )
        if all(np.max(_loudest(drawn, float(least))) < found for drawn in draws):
            size = float(np.std(residual[good, c]))
            out.append(Structure(c, COMES_AND_GOES, found, 1.0 - 1.0 / found, size, none))
    return sorted(out, key=lambda one: -one.z)


def _loudest(x: Array, least: float) -> Array:
    """Return the ratio (k,) of the mean squares of the loudest pieces of x (n, k) over the quietest, each of `least` more."""
    square = np.sort([np.var(piece, axis=0) + least for piece in np.array_split(x, SPELLS)], axis=0)
    return np.asarray(square[-OUTER:].mean(axis=0) / square[:OUTER].mean(axis=0))


def telling(structures: list[Structure]) -> list[Structure]:
    """Return the structures that explain a share of what is left, whitened, that a law would have to explain."""
    return [one for one in structures if one.share >= CRITERIA.least_share]


def strong(structures: list[Structure], judged: Judged, bench: Bench) -> list[Structure]:
    """Return the structures that are large beside the first error, the noise and the rounding."""
    out, rounding = [], bench.noise.followed_rounding
    for one in structures:
        noise = float(bench.noise.sigma[one.channel] ** 2)
        before = max(float(judged.before[one.channel]) - noise, noise)
        if one.size**2 > max(CRITERIA.least_share * before, float(rounding[one.channel])):
            out.append(one)
    return out


def verdict_of(findings: list[Finding], residual: list[Structure], screening: Screening) -> Verdict:
    """Return the verdict from findings and remaining structure."""
    named = [f for f in findings if f.named]
    if screening.wrong:
        return "unexplained"
    if not named:
        return "unexplained" if residual else "agrees"
    return "partly_explained" if residual else "explained"
