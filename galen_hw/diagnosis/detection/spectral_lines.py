"""Looks into a residual for what belongs to one recording: glitches, shared drifts, spectral lines, ripple."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.sampling import Mask
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.events import Vibration
from galen_hw.physics.effects.friction import TorqueRipple
from galen_hw.physics.effects.sensor import WALK, Drift, Saturation, Temperature
from galen_hw.physics.effects.timing import joint_of
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.signals.differentiation import isolated
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Sought:
    """Something found by looking, and at how many places was looked."""

    effect: Effect
    looked: int


FEW_ROWS = 40
"""Rows too few to look for a moment or a movement in."""
MOST_SPOILT = 0.03
"""Share of a channel's samples: more isolated ones are another kind of noise."""
HANDFUL = 4
"""Isolated samples of one channel that may always be told."""
SHARED = 0.1
"""Share of the strongest channel's gain from which another channel is in it too."""
FEW_CLIPPED = 5
"""Rows beyond a limit that are too few to show that it is one."""
FEWEST = 1e-3
"""And the share of all rows."""


def spikes(residual: Array, segments: tuple[slice, ...]) -> Mask:
    """(N, C) isolated samples, see `smoothing.isolated`; a channel with more than 3 % of them has another kind of noise.

    Of a sweep of few poses a handful is more than that.
    """
    out = np.zeros(residual.shape, dtype=bool)
    for part in segments:
        for c in range(residual.shape[1]):
            out[part, c] = isolated(residual[part, c])
    out[:, out.sum(axis=0) > max(MOST_SPOILT * len(out), HANDFUL)] = False
    return out


def slow_spread(x: Array) -> Array:
    """(C,) standard deviation of a rest (M, C) by the differences of its rows, and a little of its own."""
    return np.asarray(np.std(np.diff(x, axis=0), axis=0) / np.sqrt(2.0) + 0.05 * np.std(x, axis=0))


def moment(scene: Scene, row: int, rows: int) -> float:
    """Time of a row of the averaged rest."""
    place = min(round(row * len(scene) / rows), len(scene) - 1)
    return float(scene.time[place])


def walks(scene: Scene, rest: Array, noise: Noise) -> list[Sought]:
    """A wander with every wave that is slower than noise, of each channel of which the rest (M, C) walks."""
    proposed = {d.channel: d for d in Drift.propose(scene) if d.form == "wander"}
    walking = [name for name, walks in zip(scene.channels, noise.walks(rest, WALK), strict=True) if walks]
    return [Sought(replace(proposed[name], waves=WALK), 1) for name in walking if name in proposed]


def drifts(scene: Scene, rest: Array, time: Array) -> list[Sought]:
    """Slow movement that several channels share: of each form the one that takes most, in the channels that it is in.

    Args:
        rest: (M, C); time: (M,) of its rows, s.
    """
    if len(scene.channels) < 2 or len(rest) < FEW_ROWS:
        return []
    z, best = _scaled(rest), dict[str, tuple[float, Drift]]()
    proposed = {(d.form, d.constant): d for d in Drift.propose(scene)}
    for one in proposed.values():
        names, gain = _shared(scene, z, one.shapes(time))
        if len(names) > 1 and gain > best.get(one.form, (0.0, one))[0]:
            best[one.form] = gain, replace(one, channel="", channels=names)
    return [Sought(effect, len(scene.channels)) for _, effect in best.values()]


def temperatures(scene: Scene, rest: Array, average: Callable[[Array], Array]) -> list[Sought]:
    """Every thermometer that several channels follow, in these: a drift in all of them at once would be before it in one.

    At once, and with the delay that takes most.

    Args:
        rest: (M, C); average: rows (N, ...) to (M, ...).
    """
    if len(scene.channels) < 2 or len(rest) < FEW_ROWS:
        return []
    z, best = _scaled(rest), dict[tuple[str, bool], tuple[float, Temperature]]()
    for one in {(t.place, t.constant): t for t in Temperature.propose(scene)}.values():
        kind = one.place, one.constant is None
        names, gain = _shared(scene, z, average(one.warmth(scene)[:, None]))
        if len(names) > 1 and gain > best.get(kind, (0.0, one))[0]:
            best[kind] = gain, replace(one, channel="", channels=names)
    return [Sought(effect, len(scene.channels)) for _, effect in best.values()]


def _scaled(rest: Array) -> Array:
    return np.asarray((rest - rest.mean(axis=0)) / np.maximum(slow_spread(rest), 1e-300))


def _shared(scene: Scene, z: Array, shapes: Array) -> tuple[tuple[str, ...], float]:
    """Channels of a scaled rest (M, C) that shapes (M, k) are in, and what these take of all together."""
    gain = np.sum((np.linalg.qr(shapes - shapes.mean(axis=0))[0].T @ z) ** 2, axis=0)
    return tuple(n for n, g in zip(scene.channels, gain, strict=True) if g > SHARED * gain.max()), float(gain.sum())


WANDERS = (0, 5, 15)
"""Half cosines over the recording that the phase of a hum may follow."""
WIDEST = 45
"""And where the line stands out beyond the reach of these."""
STANDS_OUT = 3.0
"""Mean of its power there over that of what lies further away."""
NARROW = 0.1
"""Share of its frequency that a line may reach to either side: what is broader is no narrow band (a quality of five)."""


def lines(
    scene: Scene, rest: Array, runs: tuple[slice, ...], known: Sequence[Vibration] = (), *, narrow: float = NARROW
) -> list[Sought]:
    """The strongest line of the spectrum over its neighbourhood, over all channels and in each.

    `narrow`: share of its frequency that it may reach to either side.

    What is left within the breadth of a known line is its own: two lines so near would be each other's wander.
    """
    long = max(runs, key=lambda r: r.stop - r.start)
    n = long.stop - long.start
    if not scene.clock or n < 256:
        return []
    span = (
        scene.time[min(len(scene) - 1, int(long.stop * len(scene) / len(rest)) - 1)]
        - scene.time[int(long.start * len(scene) / len(rest))]
    )
    x = rest[long] - rest[long].mean(axis=0)
    pad = 4 * n
    power = np.abs(np.fft.rfft(x * np.hanning(n)[:, None], pad, axis=0)) ** 2
    ground = _ground(power, 4 * 61) + 1e-300
    ratio = power / ground
    ratio[: _above_motion(scene, runs, pad, n)] = 0.0
    dt = span / max(n - 1, 1)
    frequency = np.arange(len(ratio)) / (pad * dt)
    for line in known:
        near = np.abs(frequency - line.frequency) < line.breadth(scene)
        ratio[np.ix_(near, [scene.channels.index(name) for name in line.channels])] = 0.0
    out = []
    joint = ratio.sum(axis=1)
    for score, names in [
        (joint, scene.channels),
        *((ratio[:, c], (scene.channels[c],)) for c in range(ratio.shape[1])),
    ]:
        f = _peak(score) / (pad * dt)
        hums = [Vibration(tuple(names), float(f), wander) for wander in (*WANDERS, WIDEST)]
        reach, widest, away = hums[-2].breadth(scene), hums[-1].breadth(scene), np.abs(frequency - f)
        skirt, around = (away >= reach) & (away < widest), (away >= widest) & (away < 3.0 * widest)
        mine = power[:, [scene.channels.index(name) for name in names]]
        if not around.any() or np.all(mine[skirt].mean(axis=0) < STANDS_OUT * mine[around].mean(axis=0)):
            hums.pop()
        out += [Sought(hum, n // 2) for hum in hums if hum.breadth(scene) <= narrow * hum.frequency]
    return out


def _peak(score: Array) -> float:
    """Place of the highest value, between the lines: the top of a parabola through the logarithms of three."""
    k = int(np.argmax(score))
    if not 0 < k < len(score) - 1 or not np.all(score[k - 1 : k + 2] > 0.0):
        return float(k)
    before, top, after = np.log(score[k - 1 : k + 2])
    bend = before - 2.0 * top + after
    return float(k + 0.5 * (before - after) / bend) if bend < 0.0 else float(k)


def _ground(power: Array, width: int) -> Array:
    """Running median (F, C) over about `width` lines, from medians of half-overlapping pieces."""
    half = width // 2
    count = max(len(power) // half - 1, 1)
    middle = np.array([np.median(power[k * half : k * half + width], axis=0) for k in range(count)])
    at = half * (np.arange(count) + 1.0)
    lines = np.arange(len(power))
    return np.stack([np.interp(lines, at, middle[:, c]) for c in range(power.shape[1])], axis=-1)


def _above_motion(scene: Scene, runs: tuple[slice, ...], pad: int, n: int) -> int:
    """First place of the padded spectrum that lies above what the arm itself does: a line below is motion."""
    least = (pad // n) * 8
    rows = np.linspace(0, len(scene) - 1, sum(run.stop - run.start for run in runs)).astype(int)
    moving = [scene.joint_index(joint) for joint in scene.moved]
    # Where no joints are known, what is simulated of a recorded orientation shows the motion.
    x = scene.q[rows][:, moving] if moving else scene.simulated[rows]
    x = x[:, np.ptp(x, axis=0) > 0.0]
    if not x.shape[1]:
        return least
    power = np.abs(np.fft.rfft((x - x.mean(axis=0)) * np.hanning(len(x))[:, None], axis=0)) ** 2
    share = np.cumsum(power, axis=0) / power.sum(axis=0)
    reach = int(np.max(np.argmax(share > 0.999, axis=0)))
    return max(least, int(2.0 * reach * pad / len(x)))


def ripples(scene: Scene, rest: Array) -> list[Sought]:
    """For every joint effort the wave number at which a sine of the joint's position fits best."""
    if scene.observations.predict != "effort":
        return []
    out = []
    rows = np.linspace(0, len(scene) - 1, len(rest)).astype(int)
    for c, name in enumerate(scene.channels):
        joint = joint_of(name)
        if joint not in scene.moved:
            continue
        q = scene.q[rows, scene.joint_index(joint)]
        reach = float(np.ptp(q))
        numbers = np.arange(2.5, 160.0, 0.4) * 2.0 * np.pi / reach / 2.0
        r = rest[:, c] - rest[:, c].mean()
        power = np.array([np.abs(np.mean(r * np.exp(-1j * k * q))) ** 2 for k in numbers])
        out.append(Sought(TorqueRipple(joint, float(numbers[int(np.argmax(power))])), len(numbers)))
    return out


def saturations(scene: Scene, rest: Array, simulated: Array) -> list[Sought]:
    """For each end of each channel the limit at which clipping of what is simulated (M, C) takes most out of the rest (M, C).

    Rows that no fit sees do not belong here: what is filled in there says that nothing was clipped.

    Clipping takes all that goes beyond the limit L, so that only L is free: the gain of h = max(w - L, 0) with the factor -1,
    -2 sum r h - sum h^2, for every L at once from running sums over the rows in order of w.
    """
    out = []
    for c, name in enumerate(scene.channels):
        for sign in (1.0, -1.0):
            w, r = sign * simulated[:, c], sign * (rest[:, c] - np.median(rest[:, c]))
            order = np.argsort(-w)
            w, r = w[order], r[order]
            k = np.arange(1, len(w))
            limit, s, q = w[1:], np.cumsum(w)[:-1], np.cumsum(w * w)[:-1]
            gain = -2.0 * (np.cumsum(r * w)[:-1] - limit * np.cumsum(r)[:-1]) - (q - 2.0 * limit * s + k * limit**2)
            gain[: max(int(FEWEST * len(w)), FEW_CLIPPED)] = 0.0
            gain[len(w) // 2 :] = 0.0
            if len(gain) and gain.max() > 0.0:
                out.append(Sought(Saturation(name, float(sign * limit[int(np.argmax(gain))]), sign > 0.0), len(w) // 4))
    return out
