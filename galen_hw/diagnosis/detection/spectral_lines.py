"""Propose spectral lines of a residual, and ripple over a joint's position."""

from collections.abc import Sequence

import numpy as np

from galen_hw.diagnosis.detection.proposal import Sought
from galen_hw.diagnosis.noise.estimator import quantisation
from galen_hw.diagnosis.stats.aliasing import Aliases, folded
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.friction import TorqueRipple
from galen_hw.physics.effects.traits import Line
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


def lines(
    scene: Scene,
    residual: Array,
    rows: Rows,
    aliases: Aliases,
    known: Sequence[tuple[tuple[int, ...], Line]] = (),
    *,
    narrow: float = 0.1,
    wanders: tuple[int, ...] = (0, 5, 15, 45),
    stands_out: float = 3.0,
) -> list[Sought]:
    """Return the strongest spectral line over its neighbourhood, over all channels together and in each.

    What is left within the breadth of a known line belongs to it: two lines so near would model each other's phase noise.

    Args:
        aliases: tells which frequency of the recorded rows a line of the averaged ones has.
        known: lines with the places of their channels.
        narrow: share of its frequency that a line may reach to either side: what is broader is no narrow band (a quality
            of five).
        wanders: half cosines over the recording that the phase of a line may follow; the last where the line is broader
            than the reach of the others.
        stands_out: times the power further away that the one within reach of the widest form must have for this
            form to be proposed.
    """
    long = max(rows.runs, key=lambda r: r.stop - r.start)
    n = long.stop - long.start
    if not scene.clock or n < 256:
        return []
    x = residual[long] - residual[long].mean(axis=0)
    pad = 4 * n
    power = np.abs(np.fft.rfft(x * np.hanning(n)[:, None], pad, axis=0)) ** 2
    ground = _ground(power, 4 * 61) + 1e-300
    ratio = power / ground
    ratio[: _above_motion(scene, rows, pad, n)] = 0.0
    dt = float(np.ptp(scene.time[rows.starts[long]])) / (n - 1)
    frequency = np.arange(len(ratio)) / (pad * dt)
    for places, line in known:
        near = np.abs(frequency - folded(line.frequency, 1.0 / dt)) < line.breadth
        ratio[np.ix_(near, places)] = 0.0
    out = []
    joint = ratio.sum(axis=1)
    for score, names in [
        (joint, scene.channels),
        *((ratio[:, c], (scene.channels[c],)) for c in range(ratio.shape[1])),
    ]:
        if not score.any():  # the motion takes up the whole band
            continue
        peak, mine = _peak(score), [scene.channels.index(name) for name in names]
        f, strongest = peak / (pad * dt), mine[int(np.argmax(ratio[round(peak), mine]))]
        candidates = [Vibration(tuple(names), aliases.recorded(f, strongest), wander) for wander in wanders]
        reach, widest, away = candidates[-2].breadth(scene), candidates[-1].breadth(scene), np.abs(frequency - f)
        skirt, around = (away >= reach) & (away < widest), (away >= widest) & (away < 3.0 * widest)
        if not around.any() or np.all(
            power[np.ix_(skirt, mine)].mean(axis=0) < stands_out * power[np.ix_(around, mine)].mean(axis=0)
        ):
            candidates.pop()
        out += [Sought(hum, n // 2) for hum in candidates if hum.breadth(scene) <= narrow * hum.frequency]
    return out


def _peak(score: Array) -> float:
    """Return the fractional index of the highest value, by a parabola through the logarithms of three values."""
    k = int(np.argmax(score))
    if not 0 < k < len(score) - 1 or not np.all(score[k - 1 : k + 2] > 0.0):
        return float(k)
    before, top, after = np.log(score[k - 1 : k + 2])
    bend = before - 2.0 * top + after
    return float(k + 0.5 * (before - after) / bend) if bend < 0.0 else float(k)


def _ground(power: Array, width: int) -> Array:
    """Return the running median (F, C) over about `width` lines, from medians of half-overlapping pieces."""
    half = width // 2
    count = max(len(power) // half - 1, 1)
    middle = np.array([np.median(power[k * half : k * half + width], axis=0) for k in range(count)])
    at = half * (np.arange(count) + 1.0)
    lines = np.arange(len(power))
    return np.stack([np.interp(lines, at, middle[:, c]) for c in range(power.shape[1])], axis=-1)


def _above_motion(scene: Scene, rows: Rows, pad: int, n: int) -> int:
    """Return the first index of the padded spectrum above the band of the motion: a line below is motion."""
    least = (pad // n) * 8
    moving = [scene.joint_index(joint) for joint in scene.moved]
    # Where no joints are known, the simulation from a recorded orientation shows the motion.
    x = scene.q[rows.starts][:, moving] if moving else scene.simulated[rows.starts]
    x = x[:, np.ptp(x, axis=0) > 0.0]
    if not x.shape[1]:
        return least
    power = np.abs(np.fft.rfft((x - x.mean(axis=0)) * np.hanning(len(x))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / power.sum(axis=0)
    reach = int(np.max(np.argmax(share > 0.999, axis=0)))
    return max(least, int(2.0 * reach * pad / len(x)))


def ripples(scene: Scene, residual: Array, rows: Rows, rounding: Array) -> list[Sought]:
    """Return for every joint's own channel the wave number at which a sine of the joint's position fits best.

    A period is longer than two steps of the position's reading: finer ones are aliases of its rounding (most of all for a
    standing arm, whose joints move by a few steps). It is longer than two rows of a joint that moves, too. A sine that is no
    larger than what a rounded reading has of its own signal is none.

    Args:
        rounding: (C,) variance of a channel's rounding error that follows its signal.
    """
    if scene.observations.predict not in TorqueRipple.PREDICTS:
        return []
    out = []
    for c, name in enumerate(scene.channels):
        joint = joint_of(name)
        if joint not in scene.moved:
            continue
        position = scene.q[:, scene.joint_index(joint)]
        q = rows.average(position)
        steps = np.concatenate([np.empty(0), *(np.abs(np.diff(q[run])) for run in rows.runs)])
        steps = steps[steps > 0.0]
        if not len(steps) or not np.isfinite(q).all():
            continue  # a joint that moves between segments alone, or was not read everywhere
        coarsest = max(quantisation(position[:, None])[0], float(np.quantile(steps, 0.9, method="higher")))
        highest = np.pi / max(coarsest, float(np.ptp(q)) / len(q))
        numbers, power = _spectrum_over(q, residual[:, c] - residual[:, c].mean(), highest)
        if len(numbers):
            best = float(numbers[int(np.argmax(power))])
            if 2.0 * float(power.max()) / len(q) ** 2 <= rounding[c]:
                continue
            out.append(Sought(TorqueRipple(joint, best, scene.observations.predict), len(numbers)))
    return out


def _spectrum_over(q: Array, r: Array, highest: float, *, fewest: float = 1.25, parts: int = 5) -> tuple[Array, Array]:
    """Return wave numbers (K,) and the power (K,) of r (M,) as a function of q (M,), by a transform over fine bins of q.

    Args:
        fewest: periods within the reach of q; parts: of a period over the reach, by which two wave numbers differ.
    """
    reach = float(np.ptp(q))
    bins = int(2.0 * highest * reach) + 1
    binned = np.bincount(
        np.minimum(((q - q.min()) / reach * bins).astype(np.intp), bins - 1), weights=r, minlength=bins
    )
    power = np.abs(np.fft.rfft(binned, parts * bins)) ** 2
    numbers = 2.0 * np.pi / reach * np.arange(len(power)) / parts
    asked = (numbers >= fewest * 2.0 * np.pi / reach) & (numbers < highest)
    return numbers[asked], power[asked]
