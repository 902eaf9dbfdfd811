"""The model on data that it did not learn from."""

from dataclasses import dataclass, field, replace

import numpy as np

from galen_hw.diagnosis.detection import spectral_lines, steps
from galen_hw.diagnosis.detection.contacts import contacts
from galen_hw.diagnosis.detection.stuck_samples import repeated
from galen_hw.diagnosis.estimation import signal_chain
from galen_hw.diagnosis.estimation.dataset import Bench, Hypothesis
from galen_hw.diagnosis.estimation.least_squares import predicted, white_left_out
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.residual_model import Remainder
from galen_hw.diagnosis.lack_of_fit.structure_test import Left
from galen_hw.diagnosis.stats.paired_test import Gain, paired
from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.diagnosis.validation.support import LEAST_SUPPORT, Guard, poor, support, sure
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.cable import CableDrag
from galen_hw.physics.effects.events import Contact, Step, Vibration
from galen_hw.physics.effects.registry import effect_class
from galen_hw.physics.effects.sensor import Drift
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import fading
from galen_hw.spatial import Array

ELSEWHERE = "another recording"


@dataclass
class Judged:
    """Mean squared errors on held-out rows, (C,).

    Args:
        name: of what was held out.
        before: of the baseline; after: with all effects; without: per effect's key, with that one left out.
        floor: of the noise.
        support: per effect's key, the share of the held-out excess that would be left without it, in the channels where it
            acts, that it takes.
        sure: per effect's key, by how many standard errors held-out rows want it, see `wanted.sure`.
        refused: keys of which held-out rows, that it would show in, hold the contrary.
        untouched: `after` on the rows of no contact that the model believes in, None: there is none or no such row; how a touch
            swells and lets go is no law of the arm, and fitted no better than its few shapes allow.
        gains: per effect's key, what falls of the held-out excess with it. Of what belongs to moments, which are no other data's,
            on all rows of its own recording, less what its parameters take of noise.
        at_home: keys of effects that another recording hardly rouses: support, sure and gains are told by blocks left out of
            their own.
        unnamed: with what generic functions predict besides, without a name, where that earns its place; None: it does not.
        places: where a key stands more than once, per number in the model's effects: the same of that one alone.
        episodes: times (s) of contacts in another recording; good: (M,) its rows that are judged on, all others left out of
            these errors; None: not another recording.
    """

    name: str
    before: Array
    after: Array
    without: dict[str, Array]
    floor: Array
    support: dict[str, float] = field(default_factory=dict)
    sure: dict[str, float] = field(default_factory=dict)
    refused: set[str] = field(default_factory=set)
    places: dict[int, tuple[float, float]] = field(default_factory=dict)
    gains: dict[str, Gain] = field(default_factory=dict)
    at_home: set[str] = field(default_factory=set)
    episodes: tuple[tuple[float, float], ...] = ()
    good: Mask | None = None
    untouched: Array | None = None
    unnamed: Array | None = None

    @property
    def apart(self) -> float:
        """Share of another recording's rows that is left out."""
        return 0.0 if self.good is None else float(1.0 - self.good.mean())

    @property
    def reached(self) -> Array:
        """(C,) mean squared errors with all that can be predicted, named or not."""
        return self.after if self.unnamed is None else self.unnamed

    def gain(self, key: str) -> float:
        """Share of the excess, channels weighed by their noise, that an effect removes."""
        return self.gains[key].share

    @property
    def rough(self) -> float:
        """Share of the excess that no exact law explains: a rough one does, or nothing that has a name."""
        exact = [
            g.share for key, g in self.gains.items() if not (effect_class(key).ROUGH or effect_class(key).THROUGHOUT)
        ]
        return float(np.clip(1.0 - sum(exact), 0.0, 1.0))

    def unnamed_gain(self) -> float:
        """The same of what is predicted without a name."""
        return 0.0 if self.unnamed is None else self.share(self.after - self.unnamed)

    def share(self, lost: Array) -> float:
        """Return the share of the held-out excess, channels weighed by their noise, that mean squares (C,) are."""
        excess = float(np.sum(np.maximum(self.before - self.floor, 0.0) / self.floor))
        return float(np.clip(np.sum(lost / self.floor) / excess, -1.0, 1.0)) if excess > 0 else 0.0

    def fit(self, bench: Bench, left: list[Left]) -> dict[str, dict[str, float]]:
        """The `fit` part of the answer."""
        names = bench.scene.channels
        better = np.zeros(bench.width)
        for one in left:
            better[one.channel] = max(better[one.channel], one.share)
        after = self.reached
        hoped = np.maximum(self.after * (1.0 - np.clip(better, 0.0, 1.0)), np.minimum(self.floor, self.after))
        values = {
            "rmse_before": np.sqrt(self.before),
            "rmse_after": np.sqrt(after),
            "noise_floor": np.sqrt(self.floor),
            "ceiling": np.sqrt(np.minimum(hoped, after)),
        }
        return {k: {n: float(x) for n, x in zip(names, v, strict=True)} for k, v in values.items()}


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
    floor = bench.noise.sigma**2
    rest: Array
    if holdout is None:
        rows = bench.judged if bench.judged.any() else bench.train
        name = "contiguous blocks set aside" if bench.judged.any() else "the recording itself"
        before = np.asarray(np.mean((bench.whole - predict(baseline))[rows] ** 2, axis=0))
        judged = Judged(name, before, np.mean(model.rest()[rows] ** 2, axis=0), {}, floor)
        free = rows & ~touched(model)
        if 0 < free.sum() < rows.sum():
            judged.untouched = np.asarray(np.mean(model.rest()[free] ** 2, axis=0))
        guard = Guard(floor, lambda part: part.rest()[rows], lambda part: part.rest(white=True)[rows], model)
    else:
        if first is None or first.good is None:
            good, episodes = _undisturbed(model, holdout)
        else:
            good, episodes = first.good, first.episodes
        rest = apply(model, holdout, good)
        before = np.mean(apply(baseline, holdout, good)[good] ** 2, axis=0)
        floor = floor * _noisier(model, rest[good])
        judged = Judged(ELSEWHERE, before, np.mean(rest[good] ** 2, axis=0), {}, floor, episodes=episodes, good=good)
        noise = replace(bench.noise, rows=Rows(tuple(holdout.segments), bench.rows.stride), kept={})
        guard = Guard(
            floor,
            lambda part: apply(part, holdout, good)[good],
            lambda part: noise.bridged(apply(part, holdout, good), good)[good],
            model,
        )
    for key, part in smaller.items():
        judged.without[key] = np.mean(guard.raw(part) ** 2, axis=0)
        judged.gains[key] = (
            guard.gain(part, before) if effect_class(key).lasting() else _at_moments(model, part, baseline)
        )
        judged.support[key], judged.sure[key] = guard.of(part, _channels(model, key))
        # In another recording what belongs to moments is not there: then these rows speak of the others' sizes alone.
        if holdout is None and judged.sure[key] < 0.0 and guard.could_tell(part):
            judged.refused.add(key)
        if holdout is not None and effect_class(key).lasting() and not guard.could_tell(part):
            judged.support[key], judged.sure[key], judged.gains[key] = _at_home(model, part, key)
            judged.at_home.add(key)
    judged.places = _places(model, guard)
    return judged


def _at_moments(model: Model, part: Model, baseline: Model) -> Gain:
    """What falls with what a smaller model has left out on the rows that it was learnt on, which alone hold its moments."""
    good, sigma = ~model.bench.dropped, model.bench.noise.sigma
    rest, without, before = (one.rest()[good] / sigma for one in (model, part, baseline))
    learnt = sum(h.owed(whole=True) for h in model.effects) - sum(h.owed(whole=True) for h in part.effects)
    return paired(without, rest, np.mean(before**2, axis=0) - 1.0, parameters=learnt)


def _at_home(model: Model, part: Model, key: str) -> tuple[float, float, Gain]:
    """Support and `sure` of what a smaller model has left out, and what falls with it, on blocks left out of its own data.

    A temperature that stays where it is, or a joint that rests, says nothing for an effect and nothing against it.
    """
    each = (model, part, model.without(model.effects))
    rest, without, before = (white_left_out(model.bench, one.parts, one.white) for one in each)
    own = _channels(model, key)
    gain = paired(without, rest, np.mean(before**2, axis=0) - 1.0)
    return support(without[:, own], rest[:, own]), sure(rest, without), gain


def judge_remainder(model: Model, holdout: Scene | None, judged: Judged, remainder: Remainder | None) -> Judged:
    """The same with what a remainder predicts on the same rows, in the channels where it earns its place as an effect does."""
    bench = model.bench
    if remainder is None:
        return judged
    if holdout is None:
        rows = bench.judged if bench.judged.any() else bench.train
        rest = model.rest()[rows]
        fuller = rest - remainder.own(bench.width)[rows]
    else:
        said = remainder.predict(holdout, Rows(tuple(holdout.segments), bench.rows.stride), bench.width)
        if said is None:
            return judged
        good = np.ones(len(said), dtype=bool) if judged.good is None else judged.good
        rest, fuller = (apply(model, holdout, good, besides)[good] for besides in (None, said))
    unnamed = judged.after.copy()
    for c in remainder.parts:
        better = float(np.mean(fuller[:, c] ** 2))
        with_it, without = (x[:, [c]] / np.sqrt(judged.floor[c]) for x in (fuller, rest))
        if better < judged.after[c] and not poor(support(without, with_it), sure(with_it, without), alone=True):
            unnamed[c] = better
    return replace(judged, unnamed=unnamed) if np.any(unnamed != judged.after) else judged


def _channels(model: Model, key: str) -> list[int]:
    return sorted({c for h in model.effects if h.effect is not None and key == h.effect.KEY for c in h.raw.channels})


def _places(model: Model, guard: Guard) -> dict[int, tuple[float, float]]:
    """Support and `sure` of each lasting effect whose kind stands in several places, where these rows could tell."""
    keys = [h.effect.KEY for h in model.effects if h.effect is not None]
    out: dict[int, tuple[float, float]] = {}
    for k, h in enumerate(model.effects):
        if h.effect is None or not h.effect.lasting() or keys.count(h.effect.KEY) < 2:
            continue
        part = model.without([h])
        if guard.could_tell(part):
            out[k] = guard.of(part, list(h.raw.channels))
    return out


def _noisier(model: Model, rest: Array) -> Array:
    """(C,) noise of another recording over that of the first, from second differences: they hold hardly any motion.

    Of rounded readings no less: where what is read stands between two steps, rounding hides the noise, and not its own error.
    Outside touches, whose edges no smooth shape follows.
    """
    good = ~model.bench.dropped
    free = good & ~touched(model)
    own = model.rest()[free if free.any() else good]
    here, there = (np.mean(np.diff(x, n=2, axis=0) ** 2, axis=0) for x in (own, rest))
    told = model.bench.scene.clock & (here > 0.0) & (there > 0.0)
    ratio = np.where(told, there / np.where(told, here, 1.0), 1.0)
    return np.where(model.bench.steps > 0.0, np.maximum(ratio, 1.0), ratio)


def _undisturbed(model: Model, scene: Scene) -> tuple[Mask, tuple[tuple[float, float], ...]]:
    """Rows (M,) of another recording that nothing of a moment spoils, and the times (s) of its contacts.

    Only what was found in the recording itself is looked for: isolated samples, and outside forces. These are sought again
    once the constants no longer give way to them.
    """
    rows = Rows(tuple(scene.segments), model.bench.rows.stride)
    whole = ~rows.spread(scene.ends | scene.unanswered)
    if model.bench.spoilt.any():
        spoilt = spectral_lines.spikes(scene.raw_residual, tuple(scene.segments))
        whole &= ~rows.spread(np.asarray((spoilt | repeated(scene)).any(axis=1)))
    good, episodes, time = whole, tuple[tuple[float, float], ...](), rows.average(scene.time)
    if not any(isinstance(h.effect, Contact) for h in model.effects):
        return good, episodes
    for _ in range(2):
        found = [
            one.effect.episodes for one in contacts(scene, apply(model, scene, good)) if isinstance(one.effect, Contact)
        ]
        episodes = max(found, key=lambda each: sum(end - start for start, end in each), default=())
        good = whole.copy()
        for start, end in episodes:
            good &= (time < start) | (time > end)
    return good, episodes


def touched(model: Model) -> Mask:
    """(M,) rows of its own bench during the contacts that a model believes in."""
    out = np.zeros(len(model.bench.rows), dtype=bool)
    for h in model.effects:
        if isinstance(h.effect, Contact):
            out |= h.raw.values.any(axis=(1, 2))
    return out


def predict(model: Model) -> Array:
    """(M, C) of the model on its own bench."""
    return predicted(model.parts, model.theta, np.arange(len(model.bench.y)), model.bench.width)


def apply(model: Model, scene: Scene, good: Mask | None = None, besides: Array | None = None) -> Array:
    """(M, C) rest of another recording after the effects as learnt; nuisances, and what belongs to moments, are fitted anew.

    What drifts, hums or jumped once does so in another recording too, from another start, with another phase or at another
    moment.

    Args:
        good: (M,) rows to fit these on, None: all; besides: (M, C) something else that is taken off.
    """
    bench = model.bench
    rows = Rows(tuple(scene.segments), bench.rows.stride)
    seen = np.ones(len(rows), dtype=bool) if good is None else good
    refit = [h for h in model.parts if h.effect is None]
    lasting = [
        (h.effect, model.final[s])
        for h, s in zip(model.parts, model.slices(), strict=True)
        if h.effect is not None and not h.effect.EPISODIC
    ]
    rest = rows.average(scene.residual - signal_chain.added(scene, lasting, bench.timing))
    rest = rest - (0.0 if besides is None else besides)
    columns = [_nuisances(refit, scene, rows, bench)] if refit else []
    found = [h.effect for h in model.parts if h.effect is not None]
    for effect in found:
        if isinstance(effect, Drift | Vibration):
            columns += [_full(other, scene, rows, bench.width) for other in _again(effect, scene)]
    left = _less(rest, columns, seen)
    for effect in found:
        if isinstance(effect, Step):
            jumps = [_full(replace(effect, moment=t), scene, rows, bench.width) for t in _moments(scene, left, rows)]
            columns.append(min(jumps, key=lambda jump: float(np.sum(_less(left, [jump], seen)[seen] ** 2))))
            left = _less(rest, columns, seen)
    return left


def _again(effect: Drift | Vibration, scene: Scene) -> list[Drift | Vibration]:
    """The same kind of thing in another recording: a drift begins anew, and may wander as well."""
    if isinstance(effect, Vibration):
        return [effect]
    begun = replace(effect, start=float(scene.time[0]), length=max(float(np.ptp(scene.time)), 1e-9))
    return [begun] if begun.form == "wander" else [begun, replace(begun, form="wander", constant=None)]


def _moments(scene: Scene, rest: Array, rows: Rows) -> list[float]:
    """Times at which something may have jumped in a recording; its start where nothing did."""
    jumps = steps.steps(scene, rest) + steps.slips(scene, rest, rows.average)
    found = [s.effect.moment for s in jumps if isinstance(s.effect, Step)]
    return sorted(set(found)) or [float(scene.time[0])]


def _full(effect: Effect, scene: Scene, rows: Rows, width: int) -> Array:
    """(M, C, k) columns of an effect in all channels, on averaged rows."""
    full = effect.columns(scene).full(width)
    return np.stack([rows.average(full[:, :, i]) for i in range(full.shape[2])], axis=-1)


def _less(rest: Array, columns: list[Array], seen: Mask) -> Array:
    """(M, C) of a rest without what columns (M, C, k) do in it, by plain least squares on the rows seen (M,)."""
    if not columns:
        return rest
    stacked = np.concatenate(columns, axis=2)
    X, y = stacked[seen].reshape(-1, stacked.shape[2]), rest[seen].reshape(-1)
    return np.asarray(rest - stacked @ np.linalg.lstsq(X, y, rcond=1e-9)[0])


def _nuisances(refit: list[Hypothesis], scene: Scene, rows: Rows, bench: Bench) -> Array:
    constants = [h for h in refit if len(h.raw.channels) == 1 and np.all(h.raw.values == 1.0)]
    out = []
    for h in constants:
        column = np.zeros((len(rows), bench.width))
        column[:, h.raw.channels[0]] = 1.0
        out.append(column)
    own = scene.nuisances() if len(constants) < len(refit) else []
    out += [rows.average(column) for column in own]
    for channels, fades in fading(scene):
        column = np.zeros((len(rows), bench.width))
        column[:, list(channels)] = rows.average(fades)
        out.append(column)
    return np.stack(out, axis=-1)


def earned(model: Model, holdout: Scene | None, judged: Judged | None = None) -> tuple[Model, Judged]:
    """The model without what held-out data do not support, the least supported first.

    What belongs to moments shows nowhere else, and need not be wanted there; it only must not make worse what it touches.
    What drifts or hums is there all through its own recording, and takes its share of what is set aside of that. Where a
    kind stands in several places (friction in five joints), each place has to earn its own. What fits with parameters that
    are not known at all has the shape of its name and no more. One at a time, and what is left fitted again: of two that do the
    same one stays, and of two that need each other both do.

    Args:
        judged: of a larger model, whose rows are judged on again.
    """
    while True:
        judged = judge(model, holdout, judged)
        lasting = [k for k in judged.without if effect_class(k).lasting()]
        # A hum is fitted on these rows too: how surely they want it says nothing, but what it takes of them does.
        fitted = [k for k in judged.without if effect_class(k).THROUGHOUT and holdout is None]
        sole = len(judged.without) == 1
        weak = [
            (judged.support[key], judged.sure[key], key)
            for key in judged.without
            if key in judged.refused
            or (key in lasting and poor(judged.support[key], judged.sure[key], alone=sole))
            or (key in fitted and judged.support[key] < LEAST_SUPPORT)
            or (key in judged.gains and not judged.gains[key].credible(rough=judged.rough))
        ]
        places = [(support, k) for k, (support, sure) in judged.places.items() if poor(support, sure, alone=False)]
        vague = _vague(model)
        if vague:
            out = vague
        elif places:
            # One place first: the kind may earn its name without it.
            out = [model.effects[min(places)[1]]]
        elif weak:
            out = [h for h in model.effects if h.effect is not None and min(weak)[-1] == h.effect.KEY]
        else:
            return model, judged
        model = model.without(out)


def _vague(model: Model) -> list[Hypothesis]:
    """Cables whose parameters do not say that they are cables, and those that patch what another one misses."""
    cables = [
        (h, h.effect, s) for h, s in zip(model.parts, model.slices(), strict=True) if isinstance(h.effect, CableDrag)
    ]
    if not cables:
        return []
    spread, every = np.sqrt(model.variance), [e for _, e, _ in cables]
    return [h for h, e, s in cables if e.patches(every) or not e.known(model.final[s], spread[s])]
