"""Application of a model to another recording, and structure in its residual there."""

from dataclasses import replace

import numpy as np

from galen_hw.diagnosis.detection import outliers, steps
from galen_hw.diagnosis.detection.contacts import contacts
from galen_hw.diagnosis.detection.stuck_samples import repeated
from galen_hw.diagnosis.estimation import signal_chain
from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.linearisation import tangent
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.sampling import Mask, Rows
from galen_hw.diagnosis.validation.judgement import Judged, touched
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.initial_state import fading
from galen_hw.spatial import Array


def structures_elsewhere(model: Model, scene: Scene, judged: Judged) -> list[structure_test.Structure]:
    """Return the structure in a model's residual of another recording, strongest first, by the noise of the first.

    For models with flexible effects: these may fit one motion by what the next one does not have, and there generic functions
    find the rest. Of other models it would mostly show effects too weak to be seen at first, which matters only where the model
    is far off. What the model's own parameters, fitted again, would explain is no structure but their error. Nothing is tested
    where momentary effects are fitted to each recording anew: their residual proves nothing. The rows of contacts are left out.
    """
    effects = [(h, h.effect) for h in model.effects if h.effect is not None]
    ratio, excess = judged.after / judged.floor, judged.before - judged.floor
    if ratio.max() <= CRITERIA.noise_alone or any(_anew(effect) for _, effect in effects):
        return []
    here = _bench(model, scene, judged)
    if here is None:
        return []
    residual = apply(model, scene, judged.good)
    # The second recording's noise may be larger or smaller, of the same colour.
    white = here.whitened(residual) * model.bench.noise.sigma / np.sqrt(judged.floor)
    own = [here.hypothesis_of(None, columns).white for columns in here.constants()]
    for h, effect in effects:
        if effect.touches:
            continue
        again = here.hypothesis(effect)
        own.append((again if h.theta is None else tangent(here, again, h.theta)).white)
    (structures,) = structure_test.leftovers(
        here, structure_test.families(here), [structure_test.Fitted(own, residual, white)]
    )
    return [
        replace(one, elsewhere=True)
        for one in structures
        if ratio[one.channel] > CRITERIA.noise_alone and one.size**2 > CRITERIA.least_share * excess[one.channel]
    ]


def _anew(effect: Effect) -> bool:
    """Return whether an effect belongs to moments, and these are not left out of what is judged."""
    return not effect.lasting() and not effect.touches


def _bench(model: Model, scene: Scene, judged: Judged) -> Bench | None:
    """Return a bench for the other recording with rows as long, the first one's noise and timing; None where impossible."""
    first = model.bench
    here = Bench(scene, held_share=0.0, most=max(-(-len(scene) // first.rows.stride), 1))
    if here.rows.stride != first.rows.stride:
        return None
    if judged.good is not None:
        here.invalid_rows = here.excluded_rows = ~judged.good
    here.noise = replace(first.noise, rows=here.rows, cache={})
    here.update_state(timing=first.timing)
    return here


def noise_ratio(model: Model, residual: Array) -> Array:
    """Return the noise (C,) of another recording over that of the first, from second differences, without most motion.

    Of readings that are rounded to steps above their noise at least 1: where the value is between two steps, rounding hides the
    noise, and not its own error. Rows of contacts, whose edges are not smooth, are left out.
    """
    good = ~model.bench.excluded_rows
    free = good & ~touched(model)
    own = model.residual()[free if free.any() else good]
    here, there = (np.mean(np.diff(x, n=2, axis=0) ** 2, axis=0) for x in (own, residual))
    known = model.bench.scene.clock & (here > 0.0) & (there > 0.0)
    ratio = np.where(known, there / np.where(known, here, 1.0), 1.0)
    return np.where(model.bench.steps > model.bench.noise.sigma, np.maximum(ratio, 1.0), ratio)


def undisturbed(model: Model, scene: Scene) -> tuple[Mask, tuple[tuple[float, float], ...]]:
    """Return the rows (M,) of another recording without momentary effects, and the times (s) of its contacts.

    Only what was found in the recording itself is looked for: isolated samples, and outside forces. These are sought again once
    the constants no longer give way to them.
    """
    rows = model.bench.rows.of(scene.segments)
    whole = ~rows.spread(scene.ends | scene.unanswered)
    if model.bench.outlier_rows.any():
        spoilt = outliers.spikes(scene.raw_residual, tuple(scene.segments))
        whole &= ~rows.spread(np.asarray((spoilt | repeated(scene)).any(axis=1)))
    good, episodes, time = whole, tuple[tuple[float, float], ...](), rows.average(scene.time)
    if not any(h.effect is not None and h.effect.touches for h in model.effects):
        return good, episodes
    for _ in range(2):
        found = [one.effect.touches for one in contacts(scene, apply(model, scene, good), rows)]
        episodes = max(found, key=lambda each: sum(end - start for start, end in each), default=())
        good = whole.copy()
        for start, end in episodes:
            good &= (time < start) | (time > end)
    return good, episodes


def apply(model: Model, scene: Scene, good: Mask | None = None, besides: Array | None = None) -> Array:
    """Return the residual (M, C) of another recording with the lasting effects as learnt, all else fitted anew.

    Nuisances, drifts, lines and jumps recur with another start, another phase or at another moment, and are fitted anew.

    Args:
        good: (M,) rows to fit these on, None: all; besides: (M, C) something else that is taken off.
    """
    bench = model.bench
    rows = bench.rows.of(scene.segments)
    seen = np.ones(len(rows), dtype=bool) if good is None else good
    refit = [h for h in model.parts if h.effect is None]
    lasting = [(effect, theta) for effect, theta in model.placed() if not effect.EPISODIC]
    residual = rows.average(scene.residual - signal_chain.added(scene, lasting, bench.timing))
    residual = residual - (0.0 if besides is None else besides)
    columns = [_nuisances(refit, scene, rows, bench)] if refit else []
    found = [h.effect for h in model.parts if h.effect is not None]
    start, length = float(scene.time[0]), max(float(np.ptp(scene.time)), 1e-9)
    for effect in found:
        columns += [_full(other, scene, rows, bench.width) for other in effect.again(start, length)]
    refitted = _residual_after(residual, columns, seen)
    for effect in found:
        if effect.jump is not None:
            jumps = [_full(effect.jumping(t), scene, rows, bench.width) for t in _moments(scene, refitted, rows)]
            columns.append(
                min(jumps, key=lambda jump: float(np.sum(_residual_after(refitted, [jump], seen)[seen] ** 2)))
            )
            refitted = _residual_after(residual, columns, seen)
    return refitted


def _moments(scene: Scene, residual: Array, rows: Rows) -> list[float]:
    """Return times of possible jumps in a recording; its start where there are none."""
    jumps = steps.steps(scene, residual, rows) + steps.slips(scene, residual, rows)
    jumps += steps.loads(scene, residual, rows)
    found = [s.effect.jump for s in jumps if s.effect.jump is not None]
    return sorted(set(found)) or [float(scene.time[0])]


def _full(effect: Effect, scene: Scene, rows: Rows, width: int) -> Array:
    """Return columns (M, C, k) of an effect in all channels, on averaged rows."""
    return rows.average(effect.columns(scene).full(width))


def _residual_after(residual: Array, columns: list[Array], seen: Mask) -> Array:
    """Return the residual (M, C) of a least-squares fit of columns (M, C, k) on the rows seen (M,)."""
    if not columns:
        return residual
    stacked = np.concatenate(columns, axis=2)
    X, y = stacked[seen].reshape(-1, stacked.shape[2]), residual[seen].reshape(-1)
    return np.asarray(residual - stacked @ np.linalg.lstsq(X, y, rcond=1e-9)[0])


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
