"""The model on data that it did not learn from."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from galen_hw.diagnosis import seek
from galen_hw.diagnosis.adequacy import Left
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.linear import predicted
from galen_hw.diagnosis.rows import Mask, Rows
from galen_hw.physics.effect import Columns
from galen_hw.physics.event_effects import Contact
from galen_hw.physics.scene import Scene
from galen_hw.spatial import Array

ELSEWHERE = "another recording"


@dataclass
class Judged:
    """Mean squared errors on held-out rows, (C,).

    Args:
        name: of what was held out.
        before: of the baseline; after: with all effects; without: per effect's key, with that one left out.
        floor: of the noise.
        own: per effect's key, the channels in which it acts by itself.
        sure: per effect's key, gain on the held-out rows in units of its own error, see `_sure`.
        places: where a key stands more than once, per number in the model's effects: support and `sure` of that one alone.
        episodes: times (s) of contacts in another recording; good: (M,) its rows that are judged on, all others left out of
            these errors; None: not another recording.
    """

    name: str
    before: Array
    after: Array
    without: dict[str, Array]
    floor: Array
    own: dict[str, list[int]]
    sure: dict[str, float] = field(default_factory=dict)
    places: dict[int, tuple[float, float]] = field(default_factory=dict)
    episodes: tuple[tuple[float, float], ...] = ()
    good: Mask | None = None

    @property
    def apart(self) -> float:
        """Share of another recording's rows that is left out."""
        return 0.0 if self.good is None else float(1.0 - self.good.mean())

    def gain(self, key: str) -> float:
        """Share of the held-out excess, channels weighed by their noise, that an effect removes."""
        excess = float(np.sum(np.maximum(self.before - self.floor, 0.0) / self.floor))
        lost = float(np.sum((self.without[key] - self.after) / self.floor))
        return float(np.clip(lost / excess, -1.0, 1.0)) if excess > 0 else 0.0

    def support(self, key: str) -> float:
        """Share of the held-out excess that would be left without an effect, in the channels where it acts, that it takes."""
        own = self.own[key]
        return _support(self.without[key][own], self.after[own], self.floor[own])

    def fit(self, bench: Bench, left: list[Left]) -> dict[str, dict[str, float]]:
        """The `fit` part of the answer."""
        names = bench.scene.channels
        better = np.zeros(bench.width)
        for one in left:
            better[one.channel] = max(better[one.channel], one.share)
        ceiling = np.sqrt(
            np.maximum(self.after * (1.0 - np.clip(better, 0.0, 1.0)), np.minimum(self.floor, self.after))
        )
        values = {
            "rmse_before": np.sqrt(self.before),
            "rmse_after": np.sqrt(self.after),
            "noise_floor": np.sqrt(self.floor),
            "ceiling": ceiling,
        }
        return {k: {n: float(x) for n, x in zip(names, v, strict=True)} for k, v in values.items()}


def _support(without: Array, after: Array, floor: Array) -> float:
    lost = float(np.sum((without - after) / floor))
    rest = float(np.sum(np.maximum(without - floor, 0.0) / floor))
    return lost / rest if rest > 0.0 else float(np.sign(lost))


def judge(model: Model, holdout: Scene | None, first: Judged | None = None) -> Judged:
    """Errors before and after on the rows set aside, or on another recording.

    `first` is what was judged before: smaller models are judged on the same rows as the largest, or a poor one would call
    what it misses a contact and be judged on the rest.
    """
    bench = model.bench
    keys = list(dict.fromkeys(h.effect.KEY for h in model.effects if h.effect is not None))
    # The baseline fits its constants as anybody would, by plain least squares.
    baseline = Model(bench, [Hypothesis(None, h.raw, h.raw) for h in model.nuisances], [], bench.whole)
    smaller = {
        key: model.without([h for h in model.effects if h.effect is not None and key == h.effect.KEY]) for key in keys
    }
    own = {key: _channels(model, key) for key in keys}
    floor = bench.noise.sigma**2
    if holdout is None:
        rows = bench.judged if bench.judged.any() else bench.train
        whole = bench.whole - predict(baseline)
        before = np.asarray(np.mean(whole[rows] ** 2, axis=0))
        rest, others = model.rest()[rows], {key: part.rest()[rows] for key, part in smaller.items()}
        name = "contiguous blocks set aside" if bench.judged.any() else "the recording itself"
        without = {key: np.mean(other**2, axis=0) for key, other in others.items()}
        sure = {key: _sure(rest, other, floor) for key, other in others.items()}
        places = _places(model, rest, floor, lambda part: part.rest()[rows])
        return Judged(name, before, np.mean(rest**2, axis=0), without, floor, own, sure, places)
    rest = apply(model, holdout)
    if first is None or first.good is None:
        good, episodes = _undisturbed(model, holdout, rest)
    else:
        good, episodes = first.good, first.episodes
    after = np.mean(rest[good] ** 2, axis=0)
    others = {key: apply(part, holdout)[good] for key, part in smaller.items()}
    without = {key: np.mean(other**2, axis=0) for key, other in others.items()}
    before = np.mean(apply(baseline, holdout)[good] ** 2, axis=0)
    floor = floor * _noisier(model, rest[good])
    sure = {key: _sure(rest[good], other, floor) for key, other in others.items()}
    places = _places(model, rest[good], floor, lambda part: apply(part, holdout)[good])
    return Judged(ELSEWHERE, before, after, without, floor, own, sure, places, episodes, good)


def _channels(model: Model, key: str) -> list[int]:
    return sorted({c for h in model.effects if h.effect is not None and key == h.effect.KEY for c in h.raw.channels})


def _places(
    model: Model, rest: Array, floor: Array, rest_of: Callable[[Model], Array]
) -> dict[int, tuple[float, float]]:
    """Support, in its own channels, and `sure` of each lasting effect whose kind stands in several places."""
    keys = [h.effect.KEY for h in model.effects if h.effect is not None]
    out: dict[int, tuple[float, float]] = {}
    for k, h in enumerate(model.effects):
        if h.effect is None or h.effect.EPISODIC or h.effect.BRIEF or keys.count(h.effect.KEY) < 2:
            continue
        own, other = list(h.raw.channels), rest_of(model.without([h]))
        without, after = np.mean(other[:, own] ** 2, axis=0), np.mean(rest[:, own] ** 2, axis=0)
        out[k] = _support(without, after, floor[own]), _sure(rest, other, floor)
    return out


PIECES = 40
"""Pieces of held-out rows, each one value for the error of a gain."""


def _sure(rest: Array, without: Array, floor: Array) -> float:
    """Gain over its standard error, a sum over neighbouring rows being one value (slow noise is one piece of luck).

    With d the effect and r the rest, the gain is d^2 + 2 r d. Luck is in r d alone: that an effect acts in few pieces, as a
    delay does where all but a few moves are rests, makes it no less sure. Where physics is missing r d is large, but a gain in
    nearly every piece is no luck either: the larger of the two counts.
    """
    effect = without - rest
    luck = np.sum(2.0 * rest * effect / floor, axis=1)
    gain = np.sum(effect**2 / floor, axis=1) + luck
    count = min(PIECES, len(gain))
    each, lucky = (np.array([piece.sum() for piece in np.array_split(x, count)]) for x in (gain, luck))
    spread = float(np.std(each, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
    return float(each.sum()) / max(min(float(np.sqrt(np.sum(lucky**2))), spread), 1e-300)


def _noisier(model: Model, rest: Array) -> Array:
    """(C,) noise of another recording over that of the first, from second differences: they hold hardly any motion."""
    here, there = (np.mean(np.diff(x, n=2, axis=0) ** 2, axis=0) for x in (model.rest()[~model.bench.dropped], rest))
    good = model.bench.scene.clock & (here > 0.0) & (there > 0.0)
    return np.where(good, there / np.where(good, here, 1.0), 1.0)


def _undisturbed(model: Model, scene: Scene, rest: Array) -> tuple[Mask, tuple[tuple[float, float], ...]]:
    """Rows (M,) of another recording that nothing of a moment spoils, and the times (s) of its contacts.

    Only what was found in the recording itself is looked for: isolated samples, and outside forces.
    """
    rows = Rows(tuple(scene.segments), model.bench.rows.stride)
    good = ~rows.spread(scene.ends)
    if model.bench.spoilt.any():
        spoilt = seek.spikes(scene.raw_residual, tuple(scene.segments))
        good &= ~rows.spread(np.asarray(spoilt.any(axis=1)))
    episodes: tuple[tuple[float, float], ...] = ()
    if any(isinstance(h.effect, Contact) for h in model.effects):
        for found in seek.contacts(scene, rest):
            assert isinstance(found.effect, Contact), "contacts are sought"
            episodes = found.effect.episodes
        time = rows.average(scene.time)
        for start, end in episodes:
            good &= (time < start) | (time > end)
    return good, episodes


def predict(model: Model) -> Array:
    """(M, C) of the model on its own bench."""
    return predicted(model.parts, model.theta, np.arange(len(model.bench.y)), model.bench.width)


def apply(model: Model, scene: Scene) -> Array:
    """(M, C) rest of another recording after the effects as learnt; what belongs to moments or nuisances is fitted anew."""
    bench = model.bench
    rows = Rows(tuple(scene.segments), bench.rows.stride)
    rest = scene.residual.copy()
    refit: list[Hypothesis] = []
    for h, s in zip(model.parts, model.slices(), strict=True):
        if h.effect is None:
            refit.append(h)
        elif not h.effect.EPISODIC:
            change = Columns(tuple(range(bench.width)), h.effect.change(scene, model.final[s])[:, :, None])
            for late, theta in bench.through(h.effect):
                change = late.delivered(scene, change, theta)
            rest -= change.values[:, :, 0]
    rest = rows.average(rest)
    if refit:
        columns = _nuisances(refit, scene, rows, bench)
        stacked, y = columns.reshape(-1, columns.shape[2]), rest.reshape(-1)
        rest = (y - stacked @ np.linalg.lstsq(stacked, y, rcond=1e-9)[0]).reshape(rest.shape)
    return rest


def _nuisances(refit: list[Hypothesis], scene: Scene, rows: Rows, bench: Bench) -> Array:
    constants = [h for h in refit if len(h.raw.channels) == 1]
    out = []
    for h in constants:
        column = np.zeros((len(rows), bench.width))
        column[:, h.raw.channels[0]] = 1.0
        out.append(column)
    out += [rows.average(column) for column in scene.nuisances()] if len(constants) < len(refit) else []
    return np.stack(out, axis=-1)
