"""The next experiment: every recipe is simulated with both rivals, and the quickest one is recommended.

T-optimality (Atkinson and Fedorov 1975): a recipe is worth D = min over the rival's parameters of the whitened squared distance
between the found effect's signal and the rival's, given nuisances and the other effects; D is the expected fall of twice the log
likelihood when the wrong one is believed. Both are taken for the truth in turn and the smaller D counts. The best recipe is the
one that reaches odds of a thousand to one soonest.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.findings.quantities import SIGNAL
from galen_hw.diagnosis.findings.wording import settled_by
from galen_hw.diagnosis.identifiability.motions import MEANS, Recipe, recipes
from galen_hw.diagnosis.identifiability.rivals import Rival, rivals
from galen_hw.diagnosis.identifiability.simulate import NoiseMetric, Stage, projected_out, stacked, stage
from galen_hw.diagnosis.lack_of_fit.structure_test import Structure
from galen_hw.diagnosis.result import Finding
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import effect_class
from galen_hw.spatial import Array

SETTLED = 2.0 * np.log(1000.0)
"""Twice the log of odds of a thousand to one."""
WIDE = 15.0
"""Degrees between two effects from which no small error of the model makes one look like the other."""


@dataclass(frozen=True)
class Advice:
    """A recipe with what it would give.

    Args:
        distance: D of one run; minutes: until the odds are a thousand to one, repeats included; angle: deg between the rivals.
    """

    recipe: Recipe
    distance: float
    minutes: float
    angle: float


@dataclass(frozen=True)
class Pair:
    """Two effects of which one is to be believed.

    Args:
        found, rival: with theta: their parameters in this recording; kin: the rival's other searched values.
        now: deg between the two in this recording, NaN where only structure says that they are alike.
    """

    found: Effect
    theta: Array
    rival: Effect
    rival_theta: Array
    kin: tuple[Effect, ...]
    now: float


def next_experiment(model: Model, selection: Selection, findings: list[Finding], structures: list[Structure]) -> str:
    """Return one or two sentences: what to record next, and what that would show."""
    if any(not f.named and not f.parameters["share_left"].value for f in findings):
        return "First put right what is said of the recording itself; nothing else is worth an experiment before."
    said = [_settled(model, selection, f) for f in findings if f.rivals][:1]
    if structures:
        said.append(_unexplained(model, structures))
    if not said:
        said.append(_sharper(model, findings) if findings else _smaller(model))
    return " ".join(said)


def _settled(model: Model, selection: Selection, finding: Finding) -> str:
    rival = finding.rivals[0].effect
    pair = pair_of(selection, finding, rival, model)
    advice = None if pair is None else best_of(model, pair)
    if pair is not None and advice is not None:
        return _settling(pair, advice)
    return f"To tell {_plain(finding.effect)} from {_plain(rival)}: {settled_by(finding.effect, rival)}."


def pair_of(selection: Selection, finding: Finding, rival: str, model: Model) -> Pair | None:
    """Return the finding and its rival with parameters; None where the rival has no hypothesis to simulate."""
    scorer = selection.scorer
    near: list[Rival] = [r for r in rivals(selection, finding, everyone=True) if rival == r.key]
    part = next((h for h in model.effects if h.effect is not None and finding.effect == h.effect.KEY), None)
    if part is None or part.effect is None:
        return None
    if near:
        one = near[0]
        # A constant that is always fitted has no name on the bench; the model gives it one.
        found = scorer.library[one.instead].effect or part.effect
        effects = (h.effect for h in scorer.library if h.effect is not None)
        kin = tuple(effect for effect in effects if effect.family == one.effect.family)
        mine = _linearised(model, part) if found.curved else (found, one.own)
        return Pair(*mine, one.effect, one.theta, kin[:8], one.angle)
    supposed = effect_class(rival).supposed(model.bench.scene.channels[part.raw.channels[0]])
    if supposed is None:
        return None
    # The rival's input was not recorded: it is assumed to explain as much within the supposed range.
    other, span = supposed
    theta = _linearised(model, part)[1]
    size = float(np.ptp(part.contribution(theta)[:, 0])) / span
    return Pair(part.effect, theta, other, np.array([size]), (other,), float("nan"))


def _linearised(model: Model, h: Hypothesis) -> tuple[Effect, Array]:
    """Return an effect that has columns, with its parameters (k,): of a nonlinear one its linear relaxation."""
    theta = model.final[model.slice_of(h)]
    assert h.effect is not None, "effects, not nuisances"
    if not h.effect.curved:
        return h.effect, theta
    X = model.bench.raw(h.effect.relaxed).full(model.bench.width).reshape(h.contribution(theta).size, -1)
    return h.effect.relaxed, np.asarray(
        np.linalg.lstsq(X, h.contribution(theta).reshape(-1), rcond=1e-9)[0], dtype=float
    )


def best_of(model: Model, pair: Pair) -> Advice | None:
    """Return the recipe that settles the pair soonest; None where no recipe can."""
    able = [a for a in _advised(model, pair) if a.distance > 0.05 * SETTLED]
    # Where the two stay close, small model errors decide: a wide angle comes first.
    wide = [a for a in able if a.angle >= WIDE]
    return min(wide or able, key=lambda a: a.minutes, default=None)


def options_of(model: Model, selection: Selection, findings: list[Finding]) -> list[Advice]:
    """Return all recipes for the first open question, quickest first; none where nothing is open."""
    for finding in findings:
        if finding.rivals:
            pair = pair_of(selection, finding, finding.rivals[0].effect, model)
            return sorted([] if pair is None else _advised(model, pair), key=lambda a: (a.angle < WIDE, a.minutes))
    return []


def _advised(model: Model, pair: Pair) -> Iterator[Advice]:
    bench, joints = model.bench, tuple(dict.fromkeys((*pair.found.joints, *pair.rival.joints)))
    keys = {pair.found.KEY, pair.rival.KEY}
    others = [h for h in model.effects if h.effect is not None and h.effect.KEY not in keys]
    for recipe in recipes(bench.scene, model.bench.period, joints):
        if recipe.keys and not recipe.keys & keys:
            continue
        try:
            staged = stage(bench.scene, recipe)
        except ValueError:
            return
        advice = _distance(model, staged, pair, others)
        if advice is not None and advice.minutes < MEANS.longest:
            yield advice


def _distance(model: Model, staged: Stage, pair: Pair, others: list[Hypothesis]) -> Advice | None:
    bench, width = model.bench, model.bench.width
    found, rival = staged.columns(pair.found, width), staged.columns(pair.rival, width)
    if found is None or rival is None:
        return None
    if found.shape[2] != pair.theta.size or rival.shape[2] != pair.rival_theta.size:
        return None  # what belongs to the recording's own moments has no counterpart in another
    metric = NoiseMetric(bench, staged)
    nuisance = _nuisances(staged, others, width, constants=not (pair.found.CONSTANT or pair.rival.CONSTANT))
    white = projected_out(metric.whiten(np.concatenate([found, rival], axis=2)), N := metric.whiten(nuisance))
    F, R = white[:, : found.shape[2]], white[:, found.shape[2] :]
    signal = F @ (staged.scale(pair.found) * pair.theta)
    answer = R @ (staged.scale(pair.rival) * pair.rival_theta)
    kin = [R]
    for effect in pair.kin:
        columns = staged.columns(effect, width)
        if columns is not None:
            kin.append(projected_out(metric.whiten(columns), N))
    apart = [float(np.sum(_residual(signal, X) ** 2)) for X in kin]
    back = float(np.sum(_residual(answer, F) ** 2))
    distance = min(*apart, back)
    size = float(signal @ signal)
    angle = float(np.degrees(np.arcsin(np.sqrt(np.clip(min(apart) / size, 0.0, 1.0))))) if size > 0.0 else 0.0
    runs = max(1.0, np.ceil(SETTLED / max(distance, 1e-9))) if staged.recipe.again else 1.0
    return Advice(staged.recipe, distance, float(staged.recipe.minutes * runs), angle)


def _nuisances(staged: Stage, others: list[Hypothesis], width: int, *, constants: bool = True, most: int = 6) -> Array:
    """Return columns of all channels' constants and of the other effects (at most so many), over all parts."""
    rows = sum(len(scene) for scene in staged.scenes)
    known = [np.tile(np.eye(width), (rows, 1, 1))] if constants else []
    more = [staged.columns(h.effect, width) for h in others[:most] if h.effect is not None]
    return stacked([*known, *(c for c in more if c is not None)], rows, width)


def _residual(y: Array, X: Array) -> Array:
    return projected_out(y[:, None], X)[:, 0]


def _settling(pair: Pair, advice: Advice, *, most_odds: float = 1e6) -> str:
    """Return the recipe for two rivals and what it would show, in words.

    Args:
        most_odds: that are reported as a number: the noise model holds no further.
    """
    names = f"{_plain(pair.found.KEY)} from {_plain(pair.rival.KEY)}"
    runs = round(advice.minutes / advice.recipe.minutes)
    often = f", {runs} times" if runs > 1 else ""
    odds = np.exp(min(0.5 * advice.distance * runs, 60.0))
    likely = "more than a million to one" if odds > most_odds else f"about {_round(odds)} to one"
    if np.isfinite(pair.now) and advice.angle < pair.now + 3.0:
        seen = f"The two stay {advice.angle:.0f} deg apart there, but the odds between them would be {likely}."
    else:
        now = f"{pair.now:.2g} deg apart in this recording" if np.isfinite(pair.now) else "the same in this recording"
        seen = f"The two, {now}, would be {advice.angle:.0f} deg apart there, and the odds between them {likely}."
    return f"To tell {names}: {advice.recipe.says}{often} ({_minutes(advice.minutes)}). {seen}"


def _minutes(minutes: float) -> str:
    return f"{60.0 * minutes:.0f} s" if minutes < 1.5 else f"{minutes:.0f} min"


def _round(x: float) -> str:
    return f"{float(f'{x:.2g}'):,.0f}".replace(",", " ")


def _plain(key: str) -> str:
    return key.replace("_", " ")


def _unexplained(model: Model, structures: list[Structure]) -> str:
    """Return what to record where structure has no name: whether it depends on place, time or speed."""
    place, kind = f" in {model.bench.scene.channels[structures[0].channel]}", structures[0].kind
    if kind.startswith("covariate."):
        return (
            f"Something is left{place} that no name fits and that {kind} goes with: run once with that held constant, "
            "and once with it alone moved, up and down again, with pauses. What stays after a pause is friction or play, what "
            "goes back with it is give."
        )
    if not model.bench.scene.clock:
        return (
            f"Something is left{place} that no name fits: repeat the same poses in another order, each of them twice."
        )
    return (
        f"Something is left{place} that no name fits: run the same motion three times, the third at half speed. "
        "What repeats at the same places belongs to the arm, what repeats at the same times to the clock, and what "
        "changes with speed to the motion."
    )


def _sharper(model: Model, findings: list[Finding], *, loose_error: float = 0.05) -> str:
    """Return the recipe that halves the relative error of the least certain effect soonest, in words.

    Args:
        loose_error: relative standard error from which a parameter is worth another recording.
    """
    if all(effect_class(f.effect).EPISODIC for f in findings):
        first = findings[0].effect
        how = effect_class(first).CONFIRMED_BY or "repeat the recording"
        return f"Nothing is left to tell apart. To confirm the {_plain(first)}: {how}."
    loose = sorted(findings, key=lambda f: -_error(f))
    part = next((h for h in model.effects if h.effect is not None and loose[0].effect == h.effect.KEY), None)
    if part is None or part.effect is None or _error(loose[0]) < loose_error or part.effect.EPISODIC:
        return "Nothing is left to tell apart: save the model, record another motion with it, and it should agree."
    advice = _halving(model, part, _error(loose[0]))
    place = f" of {', '.join(part.effect.joints)}" if part.effect.joints else ""
    least = f"the size of the {_plain(loose[0].effect)}{place} ({100 * _error(loose[0]):.0f} %)"
    what = f"Nothing is left to tell apart. Least certain is {least}"
    if advice is None:
        return f"{what}: {part.effect.CONFIRMED_BY or 'record it twice as long'}."
    return f"{what}: {advice.recipe.says} ({_minutes(advice.minutes)}) to halve that."


def _error(finding: Finding) -> float:
    """Return the relative standard error of a finding's size."""
    size = finding.parameters.get(SIGNAL)
    return size.std / size.value if size is not None and size.value > 0.0 else 0.0


def _halving(model: Model, h: Hypothesis, error: float) -> Advice | None:
    """Return the recipe whose information on an effect's size reaches three times the present one soonest."""
    assert h.effect is not None, "effects, not nuisances"
    effect, theta = _linearised(model, h)
    others = [o for o in model.effects if o is not h]
    out = []
    for recipe in recipes(model.bench.scene, model.bench.period, effect.joints):
        try:
            staged = stage(model.bench.scene, recipe)
        except ValueError:
            return None
        columns = None if recipe.keys else staged.columns(effect, model.bench.width)
        if columns is None:
            continue
        metric = NoiseMetric(model.bench, staged)
        X = projected_out(metric.whiten(columns), metric.whiten(_nuisances(staged, others, model.bench.width)))
        signal = X @ theta
        runs = max(1.0, np.ceil(3.0 / max(error**2 * float(signal @ signal), 1e-9)))
        out.append(Advice(recipe, float(signal @ signal), float(recipe.minutes * runs), 90.0))
    able = [a for a in out if a.minutes < MEANS.longest]
    return min(able, key=lambda a: a.minutes, default=None)


def _smaller(model: Model) -> str:
    """Return the smallest effect that would have been detected, and how to detect smaller ones, in words."""
    bench = model.bench
    least = bench.detectable
    # Of channels in different units, the one with the largest limit relative to its simulated range.
    reach = np.ptp(bench.simulated, axis=0)
    c = int(np.argmax(np.where(bench.without_data, -np.inf, least / np.maximum(reach, least))))
    unit, name = bench.scene.units[c], bench.scene.channels[c]
    return (
        f"Nothing is open: an effect of {least[c]:.2g} {unit} rms in {name} alone would have been seen. "
        "A recording four times as long shows effects half as large."
    )
