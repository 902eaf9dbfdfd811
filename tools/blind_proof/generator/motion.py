"""Trajectories: sums of sines, pose-to-pose sweeps with dwells and home returns, pushes. All C2-smooth."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class Path:
    """A joint path: `t` (N,) s; `q`, `dq`, `ddq` (N, n)."""

    t: Array
    q: Array
    dq: Array
    ddq: Array


def sines(
    rng: np.random.Generator, t: Array, amplitude: Array, *, slow_hz: float = 0.03, fast_hz: float = 0.45
) -> Path:
    """A sum of five incommensurable sines a joint, within `amplitude` (n,), starting anywhere."""
    n = len(amplitude)
    hz = np.exp(rng.uniform(np.log(slow_hz), np.log(fast_hz), (5, n)))
    weight = rng.dirichlet(np.ones(5), size=n).T * amplitude
    phase = rng.uniform(0, 2 * np.pi, (5, n))
    arg = 2 * np.pi * hz[None] * t[:, None, None] + phase
    omega = 2 * np.pi * hz
    q = np.sum(weight * np.sin(arg), axis=1)
    dq = np.sum(weight * omega * np.cos(arg), axis=1)
    ddq = -np.sum(weight * omega**2 * np.sin(arg), axis=1)
    return Path(t, q, dq, ddq)


def between(t: Array, targets: Array, *, move_s: float, dwell_s: float) -> Path:
    """From target to target (m, n) in fifth-order steps of `move_s`, resting `dwell_s` at each."""
    period = move_s + dwell_s
    index = np.minimum((t // period).astype(int), len(targets) - 2)
    u = np.clip((t - index * period - dwell_s) / move_s, 0.0, 1.0)
    shape = u**3 * (10 - 15 * u + 6 * u**2)
    rate = 30 * u**2 * (1 - u) ** 2 / move_s
    bend = 60 * u * (1 - u) * (1 - 2 * u) / move_s**2
    step = targets[index + 1] - targets[index]
    return Path(t, targets[index] + shape[:, None] * step, rate[:, None] * step, bend[:, None] * step)


def sweep_targets(rng: np.random.Generator, count: int, *, ordered: bool) -> Array:
    """Platform, roll and tilt targets (count, 5): a grid, at random with home every eighth, or sorted."""
    tilts, rolls = np.meshgrid(np.linspace(-0.6, 0.6, 7), np.linspace(-0.9, 0.9, 8), indexing="ij")
    grid = np.stack([rolls.ravel(), tilts.ravel()], axis=1)
    if not ordered:
        grid = grid[rng.permutation(len(grid))]
    grid = np.resize(grid, (count, 2))
    if not ordered:
        grid[::8] = 0.0
    return np.hstack([rng.uniform(-0.03, 0.03, (count, 3)) * (not ordered), grid])


def pushes(rng: np.random.Generator, t: Array, *, newtons: float, period_s: float) -> Array:
    """Forces (N, 3) that rise, cross zero and come back, each period in a new direction and size."""
    out = np.zeros((len(t), 3))
    for k in range(int(t[-1] // period_s) + 1):
        inside = (t >= k * period_s) & (t < (k + 1) * period_s)
        u = (t[inside] - k * period_s) / period_s
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        size = newtons * rng.uniform(0.3, 1.0)
        # Up, through zero, down, home, with a hold at each end: hysteresis needs reversals, creep needs holds.
        knots = [0.0, 0.12, 0.33, 0.45, 0.55, 0.76, 0.9, 1.0]
        level = np.interp(u, knots, [0.0, 1.0, 1.0, 0.0, -1.0, -1.0, 0.0, 0.0])
        out[inside] = size * level[:, None] * direction
    return out


def episodes(
    rng: np.random.Generator, duration: float, *, count: int, length_s: tuple[float, float]
) -> list[tuple[float, float]]:
    """Disjoint intervals away from the ends."""
    slots = np.linspace(0.06 * duration, 0.94 * duration, count + 1)
    out = []
    for lo, hi in pairwise(slots):
        length = min(rng.uniform(*length_s), 0.6 * (hi - lo))
        start = rng.uniform(lo, hi - length)
        out.append((float(start), float(start + length)))
    return out
