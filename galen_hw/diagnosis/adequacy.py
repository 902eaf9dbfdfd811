"""What physics left over, and where: whether any function of the known inputs and their past explains it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from galen_hw.diagnosis.algebra import orthonormal, scaled
from galen_hw.diagnosis.bench import Bench, Hypothesis, rich_basis
from galen_hw.diagnosis.rows import Mask
from galen_hw.physics.effect import Columns
from galen_hw.spatial import Array

Z_NEEDED = 4.5
CHANCE = 2e-4


@dataclass(frozen=True)
class Left:
    """One kind of structure that is left in one channel.

    Args:
        channel: place.
        kind: what the generic functions were of.
        z: (T - k) / sqrt(2 k) on the training rows.
        share: of the rest's mean square, on rows set aside (training rows where none are).
        predicted: (M,) in raw units; basis: (M, k) the functions.
    """

    channel: int
    kind: str
    z: float
    share: float
    predicted: Array
    basis: Array


def dictionaries(bench: Bench) -> Iterator[tuple[str, Array]]:
    """Generic functions (M, k) of the known inputs, a family at a time."""
    inputs = _inputs(bench)
    if not inputs.size:
        return
    z = _standard(inputs)
    for scale, name in ((0.7, "the joint positions"), (2.0, "the joint positions, finely")):
        yield name, _waves(z, scale)
    yield "products of joint positions", _products(z, z)
    for j in range(min(z.shape[1], 8)):
        reach = max(float(np.ptp(z[:, j])), 1e-9)
        numbers = np.arange(1, 31) * 2.0 * np.pi / reach / 1.3
        yield (
            f"periodic in input {j + 1}",
            np.concatenate([f(np.outer(z[:, j], numbers)) for f in (np.sin, np.cos)], axis=1),
        )
    load = _standard(bench.rows.average(np.nan_to_num(bench.scene.simulated)))
    if bench.scene.observations.predict != "position" and load.shape[1]:
        yield "products of the simulated channels", _products(load, load)
        yield "the simulated channels times the joint positions", _products(load, z)
        yield "cubes of the simulated channels", np.concatenate([load**2, load**3, np.abs(load)], axis=1)
    if bench.scene.clock:
        rate = _standard(np.gradient(z, axis=0))
        second = _standard(np.gradient(rate, axis=0))
        yield (
            "speeds and accelerations",
            np.concatenate([rate, np.abs(rate), np.tanh(4.0 * rate), second, rate * np.abs(rate)], axis=1),
        )
        yield "products of speeds", np.concatenate([_products(rate, rate), _products(rate, np.abs(rate))], axis=1)
        yield "positions times speeds", _products(z, rate)
        yield "positions and speeds together", _waves(np.concatenate([z, rate], axis=1), 0.7)
        if load.shape[1]:
            yield "the simulated channels times speeds", _products(load, rate)
        for low in (0.004, 0.012, 0.035, 0.1):
            yield "a resonance that motion excites", _resonators(second, low)
        lagged = [
            np.concatenate([np.repeat(z[:1], k, axis=0), z[:-k]]) - z
            for k in (2, 5, 12, 30, 80, 200)
            if k < len(z) // 4
        ]
        yield "the past of the inputs", np.concatenate(lagged, axis=1)


MOST_PRODUCTS = 40


def _standard(x: Array) -> Array:
    """Columns of zero mean and unit variance; constant ones are left out."""
    spread = x.std(axis=0)
    good = spread > 1e-9 * np.maximum(np.abs(x).max(axis=0), 1e-12)
    return np.asarray((x[:, good] - x[:, good].mean(axis=0)) / spread[good])


def _products(a: Array, b: Array) -> Array:
    """(M, k) products of columns, each pair once."""
    pairs = [(i, j) for i in range(a.shape[1]) for j in range(b.shape[1]) if a is not b or j >= i]
    return np.stack([a[:, i] * b[:, j] for i, j in pairs[:MOST_PRODUCTS]], axis=-1) if pairs else a[:, :0]


def _waves(z: Array, scale: float) -> Array:
    """Random Fourier features (Rahimi and Recht 2007): smooth functions of all inputs together."""
    rng = np.random.default_rng(7)
    w, phase = rng.normal(size=(z.shape[1], 24)) * scale, rng.uniform(0, 2 * np.pi, 24)
    return np.asarray(np.cos(z @ w + phase))


def compact(bench: Bench) -> list[Columns]:
    """The leading directions of every family, in all channels: what they explain must not pass for noise."""
    if len(bench.rows) < 2000:
        return []
    out, ones = [], np.ones((len(bench.rows), 1))
    for _, X in dictionaries(bench):
        if X.shape[1]:
            values = rich_basis(ones, [X], 12 * 8)[:, 1:]
            out += [Columns((c,), values[:, None, :]) for c in range(bench.width)]
    return out


def _inputs(bench: Bench) -> Array:
    q = bench.scene.q
    moving = [j for j, name in enumerate(bench.scene.joint_names) if name in bench.scene.moved]
    parts = [bench.rows.average(q[:, moving])] if moving else []
    if not parts:
        parts = [bench.rows.average(bench.scene.simulated)]
    force = [c for n, c in bench.scene.observations.columns.items() if n.startswith("applied.force") and np.ptp(c) > 0]
    parts += [bench.rows.average(np.nan_to_num(np.stack(force, axis=-1)))] if force else []
    x = np.concatenate(parts, axis=1)
    return np.asarray(x[:, np.ptp(x, axis=0) > 1e-12])


def _resonators(x: Array, frequency: float) -> Array:
    """Two-pole resonances of (M, n) inputs around a frequency in cycles a row, in and out of phase."""
    out = []
    for f in frequency * np.array([1.0, 1.3, 1.7, 2.2]):
        if f > 0.45:
            continue
        r = np.exp(-2.0 * np.pi * f * 0.05)
        a = [1.0, -2.0 * r * np.cos(2.0 * np.pi * f), r * r]
        out += [lfilter([1.0], a, x, axis=0), lfilter([1.0, -1.0], a, x, axis=0)]
    return np.concatenate(out, axis=1) if out else x[:, :0]


def leftovers(bench: Bench, model: list[Hypothesis], rest: Array, white: Array) -> list[Left]:
    """Structure in the rest (M, C) of a model, strongest first; only what also predicts rows set aside.

    Args:
        model: nuisances and effects, so that generic functions get no credit for what these could do.
        rest, white: the model's rest, raw and whitened.
    """
    train, judged = bench.train, bench.judged
    out: list[Left] = []
    families = [
        (kind, rich_basis(np.ones((len(X), 1)), [X], 12 * min(max(int(train.sum()) // 6, 3), X.shape[1])))
        for kind, X in dictionaries(bench)
        if X.shape[1]
    ]
    for c in range(bench.width):
        own = [h.white.values[:, h.white.channels.index(c)] for h in model if c in h.white.channels and h.count]
        base = orthonormal(scaled(np.concatenate([*own, np.zeros((len(rest), 0))], axis=1)[train]), weakest=1e-12)
        for kind, X in families:
            Xw = bench.noise.whiten(X, c)
            found = _test(Xw, X, base, white[:, c], rest[:, c], train, judged)
            if found is not None:
                z, share, predicted, k = found
                needed = CHANCE / (len(families) * bench.width)
                if z > Z_NEEDED and chi2.sf(z * np.sqrt(2.0 * k) + k, k) < needed:
                    out.append(Left(c, kind, z, share, predicted, X))
    return sorted(out, key=lambda left: -left.z)


def _test(
    Xw: Array, X: Array, Q: Array, white: Array, rest: Array, train: Mask, judged: Mask
) -> tuple[float, float, Array, int] | None:
    learn = Xw[train]
    A = learn - Q @ (Q.T @ learn)
    size = np.linalg.norm(A, axis=0)
    own = size > 1e-3 * np.linalg.norm(learn, axis=0)  # not what the model itself can do
    if not own.any():
        return None
    value, vector = np.linalg.eigh((A[:, own].T @ A[:, own]) / np.outer(size[own], size[own]))
    good = value > 1e-6 * max(float(value[-1]), 1e-300)
    k = int(good.sum())
    V = np.zeros((A.shape[1], k))
    V[own] = vector[:, good] / np.sqrt(value[good]) / size[own, None]
    y = white[train] - Q @ (Q.T @ white[train])
    projected = V.T @ (A.T @ y)
    z = (float(projected @ projected) - k) / np.sqrt(2.0 * k)
    theta = V @ projected
    where = judged if judged.any() else train
    predicted_white = Xw @ theta
    gain = float(np.sum(white[where] ** 2 - (white[where] - predicted_white[where]) ** 2))
    predicted = X @ theta
    share = 1.0 - float(np.sum((rest[where] - predicted[where]) ** 2) / max(np.sum(rest[where] ** 2), 1e-300))
    return (z, share, predicted, k) if (gain > 8.0 and share > 0.0) or not judged.any() else None
