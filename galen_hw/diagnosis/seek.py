"""Looks into a residual for what belongs to one recording: glitches, steps, contacts, shared drifts, spectral lines, ripple."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct, fft, idct
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from galen_hw.diagnosis.noise import Noise
from galen_hw.diagnosis.rows import Mask
from galen_hw.physics.effect import Effect
from galen_hw.physics.event_effects import Contact, Step, Vibration
from galen_hw.physics.joint_effects import TorqueRipple
from galen_hw.physics.scene import Scene
from galen_hw.physics.sensor_effects import Drift, Saturation
from galen_hw.physics.smoothing import isolated
from galen_hw.physics.time_effects import joint_of
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Sought:
    """Something found by looking, and at how many places was looked."""

    effect: Effect
    looked: int


FEW_ROWS = 40
"""Rows too few to look for a moment or a movement in."""
SHARED = 0.1
"""Share of the strongest channel's gain from which another channel is in it too."""
MOMENTS = 400
"""Moments at which something carried may have slipped."""
FEW_CLIPPED = 5
"""Rows beyond a limit that are too few to show that it is one."""
FEWEST = 1e-3
"""And the share of all rows."""


def spikes(residual: Array, segments: tuple[slice, ...]) -> Mask:
    """(N, C) isolated samples, see `smoothing.isolated`; a channel with more than 3 % of them has another kind of noise."""
    out = np.zeros(residual.shape, dtype=bool)
    for part in segments:
        for c in range(residual.shape[1]):
            out[part, c] = isolated(residual[part, c])
    out[:, out.mean(axis=0) > 0.03] = False
    return out


def steps(scene: Scene, rest: Array, noise: Noise | None = None) -> list[Sought]:
    """The moment at which a jump takes most out of the rest (M, C), channel by channel and over all together.

    Where the noise is known to have a memory its slow wander is told from a jump.
    """
    N, C = rest.shape
    if N < FEW_ROWS:
        return []
    plain = noise is None or not len(noise.edges) or len(noise.rows.runs) > 1
    gain = _white_jumps(rest) if noise is None or plain else _jumps(rest, noise)
    margin = max(N // 60, 3)
    gain[:margin], gain[-margin:] = 0.0, 0.0
    names = scene.channels
    found = [Sought(Step((names[c],), _at(scene, int(np.argmax(gain[:, c])) + 1, N)), N // 4) for c in range(C)]
    if C > 1:
        row = int(np.argmax(gain.sum(axis=1)))
        found.append(Sought(Step(tuple(names), _at(scene, row + 1, N)), N // 4))
        some = tuple(n for n, g in zip(names, gain[row], strict=True) if g > SHARED * gain[row].max())
        if 1 < len(some) < C:
            found.append(Sought(Step(some, _at(scene, row + 1, N)), N // 4))
    return found


def slips(scene: Scene, rest: Array, average: Callable[[Array], Array]) -> list[Sought]:
    """For all that the arm carries the moment at which a slip of it takes most out of the rest (M, C).

    With A the answer to a slip and b its product with the rest, both summed over the rows behind a moment, and S of all rows
    what constants of the baseline take of it, the gain is b (A - A S^-1 A)^-1 b.

    Args:
        average: rows (N, ...) to (M, ...).
    """
    M = len(rest)
    if M < FEW_ROWS:
        return []
    margin, out = max(M // 60, 3), []
    sigma = np.maximum(_slow_spread(rest), 1e-300)
    for one in scene.slipping():
        own = list(one.channels)
        X, r = average(one.values) / sigma[own, None], (rest - rest.mean(axis=0))[:, own] / sigma[own]
        # Moves in metres and in radians, made comparable.
        X = X / np.maximum(np.sqrt(np.mean(X**2, axis=(0, 1))), 1e-300)
        behind = [
            np.cumsum(each[::-1], axis=0)[::-1]
            for each in (np.einsum("mck,mcl->mkl", X, X), np.einsum("mck,mc->mk", X, r))
        ]
        moments = np.unique(np.linspace(margin, M - margin - 1, MOMENTS).astype(int))
        A, b = behind[0][moments], behind[1][moments]
        free = A - A @ np.linalg.pinv(behind[0][0], rcond=1e-9, hermitian=True) @ A
        gain = np.einsum("mk,mkl,ml->m", b, np.linalg.pinv(free, rcond=1e-6, hermitian=True), b)
        moment = _at(scene, int(moments[int(np.argmax(gain))]), M)
        names = tuple(scene.channels[c] for c in own)
        out.append(Sought(Step(names, moment, one.name), M // 4))
    return out


def _white_jumps(rest: Array) -> Array:
    """(M - 1, C) how much a jump before each row but the first takes out of a rest with white noise."""
    N = len(rest)
    z = (rest - rest.mean(axis=0)) / np.maximum(_slow_spread(rest), 1e-300)
    k = np.arange(1, N)[:, None]
    return np.asarray(np.cumsum(z, axis=0)[:-1] ** 2 / (k * (N - k) / N))


def _jumps(rest: Array, noise: Noise) -> Array:
    """The same by generalised least squares, all moments at once: in cosine lines the noise's covariance is diagonal.

    Line j of a jump before row k of N is -sqrt(2 / N) sin(pi j k / N) / (2 sin(pi j / (2 N))).
    """
    N = len(rest)
    lines = np.arange(1, N)[:, None]
    level = noise.spectrum(lines[:, 0] / (2.0 * N))
    weighed = np.zeros_like(rest)
    weighed[1:] = dct(rest, axis=0, norm="ortho")[1:] / level
    inner = np.cumsum(idct(weighed, axis=0, norm="ortho"), axis=0)[:-1]
    power = np.zeros_like(rest)
    power[1:] = 1.0 / (2.0 * N * np.sin(np.pi * lines / (2.0 * N)) ** 2 * level)
    square = 0.5 * (power.sum(axis=0) - fft(power, axis=0).real[1:])
    return np.asarray(inner**2 / square)


def _slow_spread(x: Array) -> Array:
    return np.asarray(np.std(np.diff(x, axis=0), axis=0) / np.sqrt(2.0) + 0.05 * np.std(x, axis=0))


def _at(scene: Scene, row: int, rows: int) -> float:
    """Time of a row of the averaged rest."""
    place = min(round(row * len(scene) / rows), len(scene) - 1)
    return float(scene.time[place])


def drifts(scene: Scene, rest: Array, time: Array) -> list[Sought]:
    """Slow movement that several channels share: of each form the one that takes most, in the channels that it is in.

    Args:
        rest: (M, C); time: (M,) of its rows, s.
    """
    if len(scene.channels) < 2 or len(rest) < FEW_ROWS:
        return []
    z = (rest - rest.mean(axis=0)) / np.maximum(_slow_spread(rest), 1e-300)
    best: dict[str, tuple[float, Drift]] = {}
    proposed = {(d.form, d.constant): d for d in Drift.propose(scene)}
    for one in proposed.values():
        shapes = one.shapes(time)
        gain = np.sum((np.linalg.qr(shapes - shapes.mean(axis=0))[0].T @ z) ** 2, axis=0)
        names = tuple(n for n, g in zip(scene.channels, gain, strict=True) if g > SHARED * gain.max())
        if len(names) > 1 and gain.sum() > best.get(one.form, (0.0, one))[0]:
            best[one.form] = float(gain.sum()), replace(one, channel="", channels=names)
    return [Sought(effect, len(scene.channels)) for _, effect in best.values()]


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


def contacts(scene: Scene, rest: Array) -> list[Sought]:
    """Episodes in which the rest stays far above its usual level: at most a third of the time, rest before and after each.

    Running means over three lengths, all channels together, in units of their own robust spread (so slow noise counts as
    noise). An episode that begins with the recording or ends with it is a step.
    """
    N, C = rest.shape
    if not scene.clock or N < 200:
        return []
    away = rest - np.median(rest, axis=0)
    level = np.maximum(1.4826 * np.median(np.abs(away), axis=0), 1e-300)
    out: dict[Effect, Sought] = {}
    for share in (0.004, 0.01, 0.02):
        length = max(int(share * N), 5)
        z = uniform_filter1d(away / level, length, axis=0)
        spread = 1.4826 * np.median(np.abs(z), axis=0)
        # A channel that hardly ever differs shows no touch by that.
        z = np.where(spread > 0.0, z / np.where(spread > 0.0, spread, 1.0), 0.0)
        loud = np.sum(z**2, axis=1) > chi2.isf(1e-3 * length / N, C)
        for found in _contact(scene, loud, length, away, z):
            out.setdefault(found.effect, found)
    return list(out.values())


FELT = 3.0
"""Mean square of running means during the episodes, noise alone being one, from which a channel feels them."""


def _contact(scene: Scene, loud: Mask, length: int, away: Array, z: Array) -> list[Sought]:
    """In the channels whose sample shows it, and in those of which only the mean `z` (N, C) of many does."""
    N = len(loud)
    episodes = [(a, b) for a, b in _episodes(loud, length) if a > 0 and b < N]
    covered = sum(b - a for a, b in episodes) / N
    if not episodes or covered > 0.35 or len(episodes) > 12:
        return []
    inside = np.zeros(N, dtype=bool)
    for a, b in episodes:
        inside[a:b] = True
    share = np.sum(away[inside] ** 2, axis=0) / np.sum(away**2, axis=0)
    times = tuple((_at(scene, a, N), _at(scene, b - 1, N)) for a, b in episodes)
    ways = (share > 1.2 * covered + 0.02, np.mean(z[inside] ** 2, axis=0) > FELT)
    channels = [tuple(n for n, there in zip(scene.channels, way, strict=True) if there) for way in ways]
    return [Sought(Contact(names, times), N // length) for names in channels if names]


def _episodes(loud: Mask, length: int) -> list[tuple[int, int]]:
    """Runs of loud rows, joined over short gaps, shorter ones left out, ends opened a little."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(int)))
    out: list[list[int]] = []
    for a, b in edges.reshape(-1, 2):
        if out and a - out[-1][1] < 3 * length:
            out[-1][1] = int(b)
        else:
            out.append([int(a), int(b)])
    return [(max(a - length // 2, 0), min(b + length // 2, len(loud))) for a, b in out if b - a >= length]
