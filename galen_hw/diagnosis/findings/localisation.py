"""Localisation of the mismatch: channels, times, and regions of joint space, speed, load and temperature.

Regions are found on training rows and kept only if held-out rows agree.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.findings.variables import Variable, variables
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.physics.effects.events import Glitches
from galen_hw.spatial import Array


def channels_of(bench: Bench, judged: Judged) -> list[dict[str, Any]]:
    """Return every channel with its share of the excess in units of its noise, most first; last those without data."""
    floor = judged.floor
    excess = np.maximum(judged.before / floor - 1.0 - 3.0 * np.sqrt(2.0 / max(len(bench.rows), 1)), 0.0)
    share = excess / max(float(excess.sum()), 1e-300)
    return [
        {
            "channel": bench.scene.channels[c],
            "excess_share": float(share[c]),
            "rmse": float(np.sqrt(judged.before[c])),
            "noise_floor": 0.0 if bench.without_data[c] else float(np.sqrt(floor[c])),
        }
        for c in np.lexsort((-share, bench.without_data))
    ]


@dataclass(frozen=True)
class Region:
    """A range of a variable, or two at once, that holds more of the excess than of the rows.

    Args:
        parts: variables with their ranges.
        share, rows: of the excess and of the rows, on rows that the region was not found on.
        mask: (M,) rows inside.
    """

    parts: tuple[tuple[Variable, float, float], ...]
    share: float
    rows: float
    mask: Mask

    @property
    def concentration(self) -> float:
        """Share of the excess beyond the share of the rows."""
        return self.share - self.rows


def where_of(model: Model, *, least: float = 0.5) -> list[dict[str, Any]]:
    """Return regions that hold much more of the excess than of the rows, then variables that explain the excess.

    Args:
        least: share of the held-out excess from which a variable is said to organise it.
    """
    bench = model.bench
    residual = baseline_residual(model)
    known = variables(bench)
    energy = np.sum((residual**2 / bench.noise.sigma**2 - 1.0)[:, ~bench.without_data], axis=1)
    found = regions(bench, known, energy)
    out = [_region_entry(one) for one in found]
    named = {one.parts[0][0].name for one in found}
    for variable, share, channel in organised(bench, known, residual)[:2]:
        if share > least and variable.name not in named:
            low, high = float(variable.values.min()), float(variable.values.max())
            says = f"{100 * share:.0f} % of the unexplained error of {channel} is one function of {variable.name}"
            out.append({"variable": variable.name, "range": [low, high], "excess_share": share, "says": says})
    return out


def baseline_residual(model: Model) -> Array:
    """Return the residual (M, C) of the baseline, its nuisances fitted by least squares on the training rows.

    Rows that no fit uses have the nuisances of the next that one does: what fades at a beginning grows without bound before it.
    """
    bench, parts = model.bench, model.nuisances
    if not parts:
        return bench.whole
    columns = np.concatenate([h.raw.full(bench.width) for h in parts], axis=2)
    X = columns[bench.train].reshape(-1, columns.shape[2])
    fitted = columns @ np.linalg.lstsq(X, bench.whole[bench.train].reshape(-1), rcond=1e-9)[0]
    used = np.flatnonzero(~bench.excluded_rows)
    following = np.minimum(np.searchsorted(used, np.arange(len(fitted))), len(used) - 1)
    return np.asarray(bench.whole - fitted[used[following]])


def regions(bench: Bench, known: list[Variable], energy: Array, *, most: int = 3) -> list[Region]:
    """Return the best region of every variable, without those that overlap with a better one.

    Args:
        most: number of reported regions.
    """
    learn, check = halves(bench)
    if len(energy) < 60 or not (_significant(bench, energy, learn) and _significant(bench, energy, check)):
        return []
    everywhere = np.ones(len(energy), dtype=bool)
    single = [one for v in known if (one := _region((), everywhere, v, energy, bench, learn, check))]
    # Speeds and loads often only follow positions: they must hold clearly more to be named in their stead.
    single.sort(key=lambda one: -one.concentration - (0.08 if one.parts[0][0].name.endswith(".position") else 0.0))
    kept: list[Region] = []
    for one in single:
        if len(kept) < most and all(_overlap(one.mask, other.mask) < 0.5 for other in kept):
            kept.append(one)
    return [_narrowed(one, known, energy, bench, learn, check) for one in kept]


def halves(bench: Bench) -> tuple[Mask, Mask]:
    """Return rows to find regions on and rows to check them on: held out, or every other block without held-out rows."""
    if bench.judged.any():
        return bench.train, bench.judged
    odd = bench.block % 2 == 1
    return bench.train & ~odd, bench.train & odd


def _region(
    parts: tuple[tuple[Variable, float, float], ...],
    inside: Mask,
    variable: Variable,
    energy: Array,
    bench: Bench,
    learn: Mask,
    check: Mask,
    *,
    widest: float = 0.7,
) -> Region | None:
    """Return the range of a variable, within `inside`, with most excess beyond its rows; None if other rows disagree.

    Args:
        widest: share of the rows; what holds more of them is no region.
    """
    found = _best_range(variable.values[learn & inside], energy[learn & inside])
    if found is None:
        return None
    mask = inside & (variable.values >= found[0]) & (variable.values <= found[1])
    rows = float(mask[check].sum() / inside[check].sum())
    total = float(energy[check & inside].sum())
    if not 0.0 < rows < widest or total <= 0.0:
        return None
    # Blocks are independent: a region needs more than one block with a large excess.
    surplus = np.where(check & inside, energy * (mask - rows), 0.0)
    if not _significant(bench, surplus, check & inside):
        return None
    share = float(energy[check & mask].sum() / total)
    if share < rows + 0.15:
        return None
    whole = float(energy[check].sum())
    return Region(
        (*parts, (variable, *found)), float(energy[check & mask].sum() / whole), float(mask[check].mean()), mask
    )


def _significant(bench: Bench, surplus: Array, rows: Mask, *, needed: float = 2.5) -> bool:
    """Return whether the sum over some rows lies above zero by more than blocks of them differ.

    Args:
        needed: standard errors over blocks.
    """
    by_block = np.bincount(bench.block[rows], surplus[rows])[np.unique(bench.block[rows])]
    spread = float(np.std(by_block, ddof=1)) * np.sqrt(len(by_block)) if len(by_block) > 3 else np.inf
    return float(by_block.sum()) > needed * spread


def _best_range(values: Array, energy: Array, *, count: int = 16) -> tuple[float, float] | None:
    """Return the range of bins of equal count whose share of the energy exceeds its share of the rows most.

    Args:
        count: bins.
    """
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    if len(edges) < 5 or energy.sum() <= 0.0:
        return None
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    bins = len(edges) - 1
    share = np.bincount(place, energy, bins) / energy.sum() - np.bincount(place, minlength=bins) / len(values)
    best, start, run, found = 0.0, 0, 0.0, (0, 0)
    for b in range(bins):
        if run <= 0.0:
            start, run = b, 0.0
        run += float(share[b])
        if run > best:
            best, found = run, (start, b)
    return (float(edges[found[0]]), float(edges[found[1] + 1])) if best > 0.1 else None


def _narrowed(one: Region, known: list[Variable], energy: Array, bench: Bench, learn: Mask, check: Mask) -> Region:
    """Return the region restricted by a second variable, where that holds clearly more of the excess per row."""
    parts, inside = one.parts, one.mask
    own = one.parts[0][0]
    found = [
        two
        for v in known
        if v is not own and v.about != own.about and (two := _region(parts, inside, v, energy, bench, learn, check))
    ]
    best = max(found, key=lambda two: two.concentration, default=one)
    return best if best.concentration > one.concentration + 0.02 and best.share > 0.5 * one.share else one


def _overlap(a: Mask, b: Mask) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def _region_entry(one: Region) -> dict[str, Any]:
    variable, low, high = one.parts[0]
    place = " while ".join(v.span(a, b) for v, a, b in one.parts)
    says = f"{100 * one.share:.0f} % of the unexplained error in {100 * one.rows:.0f} % of the rows: {place}"
    return {"variable": variable.name, "range": [low, high], "excess_share": one.share, "says": says}


def organised(
    bench: Bench, known: list[Variable], residual: Array, bins: int = 20
) -> list[tuple[Variable, float, str]]:
    """Return for every variable the share of its best channel's excess that is a function of it, on held-out rows.

    The function is the mean in bins of equal count, learnt on the other rows; most first.
    """
    learn, check = halves(bench)
    floor, names = bench.noise.sigma**2, bench.scene.channels
    excess = np.mean(residual[check] ** 2, axis=0) - floor
    able = np.flatnonzero(excess / floor > 0.05 * max(float(np.max(excess / floor)), 1e-300))
    out = []
    for v in known:
        edges = np.unique(np.quantile(v.values[learn], np.linspace(0.0, 1.0, bins + 1)))
        if len(edges) < 5 or not able.size:
            continue
        place = np.clip(np.searchsorted(edges, v.values, side="right") - 1, 0, len(edges) - 2)
        count = np.maximum(np.bincount(place[learn], minlength=len(edges) - 1), 1)
        mean = [np.bincount(place[learn], residual[learn, c], len(edges) - 1) / count for c in able]
        after = [float(np.mean((residual[check, c] - m[place[check]]) ** 2)) for c, m in zip(able, mean, strict=True)]
        share = [(np.mean(residual[check, c] ** 2) - a) / excess[c] for c, a in zip(able, after, strict=True)]
        best = int(np.argmax(share * excess[able] / floor[able]))
        out.append((v, float(np.clip(share[best], 0.0, 1.0)), names[able[best]]))
    return sorted(out, key=lambda one: -one[1])


def episodes_of(model: Model, glitch: list[Glitches]) -> list[list[float]]:
    """Return times of events: contacts, after steps, around glitches; without events, times of large excess."""
    scene, end = model.bench.scene, float(model.bench.scene.time[-1])
    out: list[list[float]] = []
    steps: list[float] = []
    for h in model.effects:
        if h.effect is None:
            continue
        out += [list(e) for e in h.effect.touches]
        if h.effect.jump is not None:
            steps.append(float(h.effect.jump))
    for one in glitch:
        out += [[float(scene.time[r]), float(scene.time[r])] for r in one.rows[:50]]
    # A step holds until the next one, the last until the end.
    out += [[a, b] for a, b in itertools.pairwise([*sorted(set(steps)), end])]
    return sorted(out) or _loud(model)


def _loud(model: Model) -> list[list[float]]:
    """Return stretches of the recording whose energy is more than twice the mean."""
    bench = model.bench
    energy = np.sum(baseline_residual(model) ** 2 / bench.noise.sigma**2, axis=1)
    count = min(60, len(energy) // 8)
    if count < 8:
        return []
    pieces = np.array_split(np.arange(len(energy)), count)
    mean = np.array([energy[p].mean() for p in pieces])
    loud = mean > 2.0 * energy.mean()
    at = bench.rows.starts
    out: list[list[float]] = []
    for k in np.flatnonzero(loud):
        start, end = (float(bench.scene.time[at[pieces[k][i]]]) for i in (0, -1))
        if out and k > 0 and loud[k - 1]:
            out[-1][1] = end
        else:
            out.append([start, end])
    return out
