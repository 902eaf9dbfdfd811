"""Generic functions of the known inputs and their past, for structure without a name."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.signal import lfilter

from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.lazy import cached_property
from galen_hw.physics.covariates import covariates
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.wrench import WrenchScene
from galen_hw.spatial import Array

POSITION = "the joint positions, finely"
"""What quick waves over all positions at once are functions of, and trees on the positions."""
WARM = (
    "the joint positions times the temperatures",
    "the simulated channels times the temperatures",
    "speeds times the temperatures",
)
"""Families where a temperature was recorded: what it changes in what motion and load do."""
PLAIN = (
    "products of joint positions",
    "products of the simulated channels",
    "the simulated channels times the joint positions",
    "cubes of the simulated channels",
    "speeds and accelerations",
    "products of speeds",
    "positions times speeds",
    "the simulated channels times speeds",
    *WARM,
)
"""Families of low powers of the inputs at the moment: what they say of one motion holds of another."""


@dataclass(frozen=True)
class Scale:
    """Columns made comparable: constant ones left out, zero mean and unit variance in the first recording."""

    kept: Mask
    centre: Array
    spread: Array

    @classmethod
    def of(cls, x: Array) -> Self:
        """Return the scale of columns (M, k)."""
        spread = x.std(axis=0)
        kept = np.asarray(spread > 1e-9 * np.maximum(np.abs(x).max(axis=0, initial=0.0), 1e-12))
        return cls(kept, x[:, kept].mean(axis=0), spread[kept])

    def __call__(self, x: Array) -> Array:
        """Return columns (M, k) scaled, (M, kept)."""
        return np.asarray((x[:, self.kept] - self.centre) / self.spread)


@dataclass(frozen=True)
class Inputs:
    """Known inputs of a recording, on averaged rows, in the units of the recording that is learnt from.

    Args:
        position: (M, p) joint positions that move, the axes of a sensor of which no joints are known, or the simulated channels;
            applied forces.
        load: (M, c) simulated channels; rate, second: (M, p) of the positions, by the row; empty without a clock.
        reach: (p,) of the positions.
        warmth: (M, w) thermometers that move; beside: (M, b) covariates that do, where nothing else moves.
        lags: rows by which the past is taken; runs: of successive rows, which have no past before them.
        scales: of position, load, rate, second, warmth and covariates; joints, forces: which columns the positions are; places:
            of warmth; covariates: of `beside`.
        period: s a row.
        same: the simulated channels are positions themselves; turns: the positions are the sensor's axes.
    """

    position: Array
    load: Array
    rate: Array
    second: Array
    reach: Array
    warmth: Array
    beside: Array
    lags: tuple[int, ...]
    runs: tuple[slice, ...]
    scales: tuple[Scale, Scale, Scale, Scale, Scale, Scale]
    joints: tuple[str, ...]
    forces: tuple[str, ...]
    places: tuple[str, ...]
    covariates: tuple[str, ...]
    period: float
    same: bool
    turns: bool

    @classmethod
    def of(cls, scene: Scene, rows: Rows, like: "Inputs | None" = None) -> Self:
        """Return the inputs of a scene; `like`: in the units of those of another recording.

        Raises:
            KeyError: it does not have the other's inputs.
        """
        given = scene.observations.columns
        joints = scene.moved if like is None else like.joints
        forces = tuple(n for n in given if n.startswith("applied.force")) if like is None else like.forces
        load = rows.average(np.nan_to_num(scene.simulated))
        if joints:
            raw = [rows.average(scene.q[:, [scene.joint_index(j) for j in joints]])]
        elif isinstance(scene, WrenchScene):
            # A wrench may depend on the heading too (a cable, a magnet), which gravity in the sensor does not show.
            raw = [rows.average(scene.R.reshape(len(scene), 9))]
        else:
            raw = [load]
        raw += [rows.average(np.nan_to_num(given[name]))[:, None] for name in forces]
        places = tuple(n for n in given if n.startswith("temperature.")) if like is None else like.places
        warm = [rows.average(np.nan_to_num(given[name]))[:, None] for name in places]
        # In a motion a covariate may be a consequence, as a clamp's force is.
        moves = bool(Scale.of(np.concatenate(raw, axis=1)).kept.any())
        others = (() if moves else covariates(given)) if like is None else like.covariates
        beside = [rows.average(np.asarray(given[name], dtype=float))[:, None] for name in others]
        named = joints, forces, places, others
        still = np.zeros((len(rows), 0))
        warmth, recorded = (np.concatenate([still, *columns], axis=1) for columns in (warm, beside))
        return cls._scaled(scene, rows, np.concatenate(raw, axis=1), load, warmth, recorded, like, named)

    @classmethod
    def _scaled(
        cls,
        scene: Scene,
        rows: Rows,
        raw: Array,
        load: Array,
        warm: Array,
        recorded: Array,
        like: "Inputs | None",
        named: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], tuple[str, ...]],
        *,
        lags: tuple[int, ...] = (2, 5, 12, 30, 80, 200),
    ) -> Self:
        """Return inputs from raw ones, see `of`; `lags`: rows by which inputs are taken from the past."""
        scale = Scale.of(raw) if like is None else like.scales[0]
        position = scale(raw)
        weight = Scale.of(load) if like is None else like.scales[1]
        still = np.zeros((len(rows), 0))
        rate = rows.differences(position) if scene.clock else still
        speed = Scale.of(rate) if like is None else like.scales[2]
        second = rows.differences(speed(rate)) if scene.clock else still
        bend = Scale.of(second) if like is None else like.scales[3]
        reach = np.maximum(np.ptp(position, axis=0), 1e-9) if like is None else like.reach
        period = float(np.median(np.diff(rows.average(scene.time)))) if scene.clock and len(rows) > 1 else 0.0
        lags = tuple(k for k in lags if k < len(rows) // 4) if like is None else like.lags
        heat = Scale.of(warm) if like is None else like.scales[4]
        others = Scale.of(recorded) if like is None else like.scales[5]
        scales = (scale, weight, speed, bend, heat, others)
        return cls(
            position,
            weight(load),
            speed(rate),
            bend(second),
            reach,
            heat(warm),
            others(recorded),
            lags,
            rows.runs,
            scales,
            *named,
            period,
            scene.observations.predict == "position",
            not named[0] and isinstance(scene, WrenchScene),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names (p,) of the columns of the positions, in words."""
        count = len(self.scales[0].kept) - len(self.forces)
        axes = tuple(f"the sensor's {a} axis along base {b}" for b in "xyz" for a in "xyz")
        simulated = tuple(f"simulated channel {k + 1}" for k in range(count))
        own = self.joints or (axes if self.turns else simulated)
        return tuple(itertools.compress((*own, *self.forces), self.scales[0].kept))

    @cached_property
    def past(self) -> Array:
        """Changes (M, lags p) of the positions since some rows ago, or since the run's first row."""
        z, row = self.position, np.arange(len(self.position))
        first = np.concatenate([np.full(run.stop - run.start, run.start) for run in self.runs])
        each = [z[np.maximum(row - k, first)] - z for k in self.lags]
        return np.concatenate(each, axis=1) if each else z[:, :0]

    @property
    def seen(self) -> Array:
        """All inputs (M, k) as columns, for trees."""
        every = [self.position, self.rate, self.second, self.load, self.warmth, self.beside, self.past]
        return np.concatenate(every, axis=1)

    def comparable(self, other: "Inputs") -> bool:
        """Return whether both have the same period and enough rows for the lags."""
        same = abs(self.period - other.period) <= 0.01 * self.period
        return same and len(other.position) > max(self.lags, default=1)


def dictionaries(inputs: Inputs) -> Iterator[tuple[str, Array]]:
    """Yield generic functions (M, k) of the known inputs, family by family, with what they depend on; simple ones first."""
    yield from broad(inputs)
    yield from local(inputs)


def broad(inputs: Inputs) -> Iterator[tuple[str, Array]]:
    """Yield functions that are large over most of the motion."""
    z, load, rate, second = inputs.position, inputs.load, inputs.rate, inputs.second
    yield from _recorded(inputs)
    if not z.size:
        return
    for scale, name in ((0.7, "the joint positions"), (2.0, POSITION)):
        yield name, _waves(z, scale)
    yield "products of joint positions", _products(z, z)
    for j in range(min(z.shape[1], 8)):
        numbers = np.arange(1, 31) * 2.0 * np.pi / inputs.reach[j] / 1.3
        waves = [f(np.outer(z[:, j], numbers)) for f in (np.sin, np.cos)]
        yield f"periodic in input {j + 1}", np.concatenate(waves, axis=1)
    if load.shape[1] and not inputs.same:
        yield "products of the simulated channels", _products(load, load)
        yield "the simulated channels times the joint positions", _products(load, z)
        yield "cubes of the simulated channels", np.concatenate([load**2, load**3, np.abs(load)], axis=1)
    yield from _warm(inputs)
    if rate.shape[1]:
        speeds = [rate, np.abs(rate), np.tanh(4.0 * rate), second, rate * np.abs(rate)]
        yield "speeds and accelerations", np.concatenate(speeds, axis=1)
        yield "products of speeds", np.concatenate([_products(rate, rate), _products(rate, np.abs(rate))], axis=1)
        yield "positions times speeds", _products(z, rate)
        yield "positions and speeds together", _waves(np.concatenate([z, rate], axis=1), 0.7)
        if load.shape[1]:
            yield "the simulated channels times speeds", _products(load, rate)
        for low in (0.004, 0.012, 0.035, 0.1):
            yield "a resonance that motion excites", _resonators(second, low, inputs.runs)
        if inputs.lags:
            yield "the past of the inputs", inputs.past


def factors(inputs: Inputs) -> dict[str, Array]:
    """Return the factors (M, k) of the products of some families, by family.

    What a model's own effects have explained of a product is linear in them. None is sought by itself: it has a name.
    """
    z, load, rate = inputs.position, inputs.load, inputs.rate
    return {
        "products of joint positions": z,
        "products of the simulated channels": load,
        "the simulated channels times the joint positions": np.concatenate([load, z], axis=1),
        "cubes of the simulated channels": load,
        "products of speeds": rate,
        "positions times speeds": rate,
        "the simulated channels times speeds": rate,
    }


def _warm(inputs: Inputs) -> Iterator[tuple[str, Array]]:
    """Yield products of motion and load with temperatures; a temperature alone is too slow to be told from noise."""
    z, load, rate, warmth = inputs.position, inputs.load, inputs.rate, inputs.warmth
    if not warmth.shape[1]:
        return
    positions, channels, of_speeds = WARM
    yield positions, _products(z, warmth)
    if load.shape[1] and not inputs.same:
        yield channels, _products(load, warmth)
    if rate.shape[1]:
        speeds = np.concatenate([rate, np.tanh(4.0 * rate)], axis=1)
        yield of_speeds, _products(speeds, warmth)


def _recorded(inputs: Inputs) -> Iterator[tuple[str, Array]]:
    """Yield functions of each covariate by itself."""
    for name, z in zip(itertools.compress(inputs.covariates, inputs.scales[5].kept), inputs.beside.T, strict=True):
        yield name, np.stack([z, np.abs(z), z**2, np.tanh(4.0 * z)], axis=-1)


def _products(a: Array, b: Array, *, most: int = 40) -> Array:
    """Return products (M, k) of columns, each pair once.

    Args:
        most: products.
    """
    pairs = [(i, j) for i in range(a.shape[1]) for j in range(b.shape[1]) if a is not b or j >= i]
    return np.stack([a[:, i] * b[:, j] for i, j in pairs[:most]], axis=-1) if pairs else a[:, :0]


def local(inputs: Inputs) -> Iterator[tuple[str, Array]]:
    """Yield functions of two inputs each, large in one corner of their plane alone."""
    z, rate = inputs.position, inputs.rate
    yield from _planes("input {} and input {} together", z, z)
    yield from _planes("input {} and the speed of input {}", z, rate)
    yield from _planes("the speeds of input {} and input {}", rate, rate)


def _planes(
    name: str,
    a: Array,
    b: Array,
    *,
    most: int = 25,
    places: tuple[float, ...] = (-1.5, -0.5, 0.5, 1.5),
    width: float = 0.8,
) -> Iterator[tuple[str, Array]]:
    """Yield bumps (M, 16) over the plane of each pair of columns.

    Args:
        most: pairs.
        places, width: of the bumps along one column, in its standard deviations.
    """
    every = itertools.product(range(a.shape[1]), range(b.shape[1]))
    for i, j in itertools.islice((pair for pair in every if a is not b or pair[0] < pair[1]), most):
        first, second = (np.exp(-0.5 * ((x[:, None] - np.array(places)) / width) ** 2) for x in (a[:, i], b[:, j]))
        yield name.format(i + 1, j + 1), (first[:, :, None] * second[:, None, :]).reshape(len(a), -1)


def _waves(z: Array, scale: float) -> Array:
    """Return random Fourier features (Rahimi and Recht 2007): smooth functions of all inputs together."""
    rng = np.random.default_rng(7)
    w, phase = rng.normal(size=(z.shape[1], 24)) * scale, rng.uniform(0, 2 * np.pi, 24)
    return np.asarray(np.cos(z @ w + phase))


def _resonators(x: Array, frequency: float, runs: Sequence[slice]) -> Array:
    """Return two-pole resonances (M, n k) of inputs (M, n) around a frequency (cycles a row), at rest before each run."""
    out = []
    for f in frequency * np.array([1.0, 1.3, 1.7, 2.2]):
        if f > 0.45:
            continue
        r = np.exp(-2.0 * np.pi * f * 0.05)
        a = [1.0, -2.0 * r * np.cos(2.0 * np.pi * f), r * r]
        out += [np.concatenate([lfilter(b, a, x[run], axis=0) for run in runs]) for b in ([1.0], [1.0, -1.0])]
    return np.concatenate(out, axis=1) if out else x[:, :0]
