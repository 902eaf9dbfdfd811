"""Propose contacts: episodes in which a residual stays away from its usual level."""

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from galen_hw.diagnosis.detection.proposal import FEW_ROWS, Sought, moment
from galen_hw.diagnosis.stats.sampling import Mask, Rows, true_runs
from galen_hw.physics.effects.events import Contact
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

Episode = tuple[int, int]


def contacts(
    scene: Scene,
    residual: Array,
    rows: Rows,
    *,
    shares: tuple[float, ...] = (0.004, 0.01, 0.02),
    most: int = 12,
    covered: float = 0.35,
    poses: int = 200,
    knock: int = 4,
) -> list[Sought]:
    """Return contacts: episodes in which the residual (M, C) stays far above its usual level.

    They cover a third of the time at most, with quiet rows before and after. Running means over three lengths, all channels
    together, are taken in units of their own robust spread, so that slow noise counts as noise. A mean is wider than a knock, or
    than a contact in a sweep of few poses: these are also proposed as narrow as their level is. An episode that begins or ends
    with the recording is a step. Without a clock the row is the time.

    Args:
        shares: of the rows that running means are wide, the narrowest first.
        most: episodes; more are no contacts.
        covered: share of the rows that the episodes may cover.
        poses: rows below which a running mean of five is wider than many a contact.
        knock: times the width of a mean that an episode may be for a knock: a mean opens what it is as wide as to
            three times that.
    """
    N, C = residual.shape
    # A pose tracked statically shows a push by the arm's compliance alone, and nobody leans on one pose after another.
    if N < FEW_ROWS or (not scene.clock and scene.observations.predict in ("pose", "targets")):
        return []
    away = residual - np.median(residual, axis=0)
    usual = 1.4826 * np.median(np.abs(away), axis=0)
    # A rounded reading that stands most of the time has no usual level.
    usual = np.where(usual > 0.0, usual, np.std(away, axis=0))
    away = away / np.where(usual > 0.0, usual, np.inf)
    out: dict[Contact, Sought] = {}
    for share in shares:
        length = max(int(share * N), 5)
        z = uniform_filter1d(away, length, axis=0)
        spread = 1.4826 * np.median(np.abs(z), axis=0)
        # A channel without spread shows no contact.
        z = np.where(spread > 0.0, z / np.where(spread > 0.0, spread, 1.0), 0.0)
        loud = np.sum(z**2, axis=1) > chi2.isf(1e-3 * length / N, C)
        wide = [(a, b) for a, b in _episodes(loud, length) if a > 0 and b < N]
        if not wide or sum(b - a for a, b in wide) > covered * N or len(wide) > most:
            continue
        narrow = []
        if poses > N or (share == shares[0] and max(b - a for a, b in wide) <= knock * length):
            own = [_level(away, *one) for one in wide]
            # A mean as wide as the episode needs no narrower one.
            narrow = [own] if poses > N or max(b - a for a, b in own) <= length else []
        for own in (wide, *narrow):
            for names in _channels_of(scene, own, away, z):
                times = tuple((moment(scene, rows, a), moment(scene, rows, b - 1)) for a, b in own)
                contact = Contact(names, times)
                out.setdefault(contact, Sought(contact, N // length))
    return list(out.values())


def _episodes(loud: Mask, length: int) -> list[Episode]:
    """Return runs of loud rows: joined over short gaps, without shorter ones, their ends extended a little."""
    out: list[list[int]] = []
    for a, b in true_runs(loud):
        if out and a - out[-1][1] < 3 * length:
            out[-1][1] = b
        else:
            out.append([a, b])
    return [(max(a - length // 2, 0), min(b + length // 2, len(loud))) for a, b in out if b - a >= length]


def _level(away: Array, start: int, end: int) -> Episode:
    """Return the part of an episode whose constant mean explains most of the scaled residual (N, C)."""
    total = np.cumsum(np.concatenate([np.zeros((1, away.shape[1])), away[start:end]]), axis=0)
    first, last = np.triu_indices(len(total), 1)
    best = int(np.argmax(np.sum((total[last] - total[first]) ** 2, axis=1) / (last - first)))
    return start + int(first[best]), start + int(last[best])


def _channels_of(
    scene: Scene, episodes: list[Episode], away: Array, z: Array, *, least: float = 3.0
) -> list[tuple[str, ...]]:
    """Return the channels whose single samples show the episodes, and those of which only running means `z` (N, C) do.

    Args:
        least: mean square of running means during the episodes, noise alone being one, from which a channel feels
            them.
    """
    inside = np.zeros(len(away), dtype=bool)
    for a, b in episodes:
        inside[a:b] = True
    share = np.sum(away[inside] ** 2, axis=0) / np.maximum(np.sum(away**2, axis=0), 1e-300)
    criteria = (share > 1.2 * inside.mean() + 0.02, np.mean(z[inside] ** 2, axis=0) > least)
    channels = [tuple(n for n, there in zip(scene.channels, criterion, strict=True) if there) for criterion in criteria]
    return [names for names in channels if names]
