"""Simulation of a recipe: its scenes, and the effects there in units of this recording's noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.identifiability.motions import MEANS, Part, Recipe
from galen_hw.diagnosis.stats.linear_algebra import solve_sym
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Stage:
    """A recipe with its scenes, one for each part.

    Args:
        start, end: of the clock over all parts.
    """

    recipe: Recipe
    scenes: tuple[Scene, ...]
    start: float
    end: float

    def columns(self, effect: Effect, width: int) -> Array | None:
        """Return columns (N, width, k) of an effect over all parts; None where it cannot act there."""
        out = []
        for scene, part in zip(self.scenes, self.recipe.parts, strict=True):
            try:
                columns = effect.staged(self.start, self.length).columns(scene).full(width)
            except (AssertionError, KeyError, ValueError, StopIteration, IndexError, AttributeError):
                return None  # the effect has no port in this scene
            out.append(columns * (effect.KEY not in part.without))
        whole = np.concatenate(out)
        return whole if np.isfinite(whole).all() else None

    @property
    def length(self) -> float:
        """Length of the clock, s."""
        return max(self.end - self.start, 1e-9)

    def scale(self, effect: Effect) -> float:
        """Return the factor by which the parameters are larger here than in the recording."""
        return effect.growth(self.end - self.start)


def stage(scene: Scene, recipe: Recipe) -> Stage:
    """Return the scenes of a recipe.

    Raises:
        ValueError: a new motion cannot be simulated from what the recording says.
    """
    scenes = tuple(_scene(scene, part) for part in recipe.parts)
    return Stage(recipe, scenes, float(recipe.parts[0].time[0]), float(recipe.parts[-1].time[-1]))


def _scene(scene: Scene, part: Part) -> Scene:
    old, group = scene.observations, scene.observations.predict
    if group == "targets":
        raise ValueError("the places of the targets on the body are not known beforehand")
    n = len(part.time)
    columns: dict[str, Array] = {"time": part.time} if scene.clock else {}
    columns |= {f"joint.{name}.position": part.q[:, i] for i, name in enumerate(scene.joint_names)}
    columns |= {name: np.zeros(n) for name in scene.channels if name not in columns}
    columns |= {name: np.full(n, 0.5) for name in old.columns if name.startswith("pose.orientation.")}
    if any(name.startswith("applied.force.") for name in old.columns) or part.force is not None:
        force = np.zeros((n, 3)) if part.force is None else part.force
        columns |= {f"applied.force.{a}": force[:, i] for i, a in enumerate("xyz")}
    warm = np.zeros(n) if part.warmth is None else MEANS.warming * part.warmth
    columns |= {name: warm for name in old.columns if name.startswith("temperature.")} | {"temperature.sensor": warm}
    rates = _rates(part, clock=scene.clock)
    belief = old.belief if part.tool is None else replace(old.belief, tool=part.tool)
    simulation = _simulation(scene, part, rates)
    return scene_of(Observations(group, columns, simulation, belief), rates=rates)


def _rates(part: Part, *, clock: bool) -> tuple[Array, Array]:
    if not clock:
        return np.zeros_like(part.q), np.zeros_like(part.q)
    dq = np.gradient(part.q, part.time, axis=0)
    return dq, np.gradient(dq, part.time, axis=0)


def _simulation(scene: Scene, part: Part, rates: tuple[Array, Array]) -> dict[str, Array] | None:
    """Return the simulated channels: of positions the command, else the given simulation as a function of the motion.

    Raises:
        ValueError: that function is not known.
    """
    if scene.observations.predict == "position":
        return {name: part.q[:, scene.joint_index(name.split(".", 1)[1].rsplit(".", 1)[0])] for name in scene.channels}
    if scene.observations.simulation is None:
        return None

    def features(q: Array, dq: Array, ddq: Array) -> Array:
        return np.concatenate([np.ones((len(q), 1)), q, dq, ddq], axis=1)

    rows = np.unique(np.linspace(0, len(scene) - 1, min(len(scene), 4000)).astype(int))
    X, y = features(scene.q[rows], scene.rates[0][rows], scene.rates[1][rows]), scene.simulated[rows]
    scale = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    weights = np.linalg.lstsq(X / scale, y, rcond=1e-9)[0] / scale[:, None]
    unexplained = np.sum((y - X @ weights) ** 2) / max(float(np.sum((y - y.mean(axis=0)) ** 2)), 1e-300)
    if not unexplained < 0.1:
        raise ValueError("the given simulation is not a plain function of the motion")
    values = features(part.q, *rates) @ weights
    return {name: values[:, c] for c, name in enumerate(scene.channels)}


class NoiseMetric:
    """Whiten signals of a simulated recipe by the noise of the recording.

    Args:
        bench: of the recording; staged: where its noise is asked.
    """

    def __init__(self, bench: Bench, staged: Stage) -> None:
        self.bench = bench
        time = np.concatenate([part.time for part in staged.recipe.parts])
        # One row of the stage counts as the number of recorded rows between two of its rows.
        self.ratio = max(float(np.median(np.diff(time))) / max(bench.period, 1e-12), 1e-12)
        frequency = np.fft.rfftfreq(len(time))
        self.level = bench.noise.spectrum(np.minimum(frequency / self.ratio, 0.5))

    def whiten(self, X: Array) -> Array:
        """Return columns (N, C, k) in units of the noise, stacked to (N C, k); their squares count as log likelihood."""
        n = len(X)
        spectrum = np.fft.rfft(X, axis=0) / np.sqrt(self.level)[:, :, None]
        out = np.fft.irfft(spectrum, n, axis=0) * np.sqrt(self.ratio)
        return np.asarray(out.reshape(X.shape[0] * X.shape[1], X.shape[2]))


def projected_out(X: Array, others: Array) -> Array:
    """Return columns less their projection onto others (N, m)."""
    if not others.shape[1]:
        return X
    return np.asarray(X - others @ solve_sym(others.T @ others, others.T @ X))


def stacked(parts: Sequence[Any], rows: int, width: int) -> Array:
    """Return columns (rows, width, k) next to each other."""
    return np.concatenate([np.zeros((rows, width, 0)), *parts], axis=2)
