"""Which effects: forward by likelihood with a held-out guard, then drop-one and swaps; searched values polished."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from galen_hw.diagnosis import seek
from galen_hw.diagnosis.algebra import solve_sym
from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.rows import Chosen
from galen_hw.diagnosis.score import Score, Scorer, threshold
from galen_hw.physics.effect import Columns, Effect
from galen_hw.physics.table import EFFECTS, effect_class
from galen_hw.physics.time_effects import Timing
from galen_hw.spatial import Array

CHANCE = 0.002
TRIES = 8
"""Hypotheses that may fail the guard before a turn of the search gives up."""
PIECES = 400
"""Of so many pieces of a recording every fifth is left out to judge what belongs to moments."""
MOST = 16
WORTH = 0.25
"""An effect must take at least this share of the excess that is left in some channel, on data it did not learn from."""


@dataclass
class Selection:
    """The chosen model and how it came about.

    Args:
        chosen: places in the scorer's library.
        evidence: score of each when all others are in.
        first: score of every hypothesis before any was chosen, best of its family.
        needed: surprise that chance reaches.
        refused: effects that looked significant but did not pass the guard.
        start: (C,) mean squared error on blocks left out before anything was chosen.
    """

    scorer: Scorer
    chosen: list[int] = field(default_factory=list)
    evidence: dict[int, Score] = field(default_factory=dict)
    first: dict[int, Score] = field(default_factory=dict)
    needed: float = 0.0
    refused: list[tuple[Effect, float]] = field(default_factory=list)
    start: Array = field(default_factory=lambda: np.empty(0))

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """The chosen ones."""
        return [self.scorer.library[i] for i in self.chosen]


MATTERS = 0.03
"""Where the best model still misses much (real machines), an effect must take this share of the whole excess as well."""


LOUD = 400.0
"""Mean square over noise from which a recording is so loud that a hundredth of it is no matter."""


PROVED = 1.25
"""Whitened mean square below which a model leaves hardly more than noise."""


def library(bench: Bench) -> list[Effect]:
    """Every hypothesis that the scene allows; offsets are always in the model and judged at the end."""
    constant = {"bias"} | ({"joint_offset"} if bench.scene.observations.predict == "position" else set())
    return [e for key in EFFECTS if key not in constant for e in effect_class(key).propose(bench.scene)]


def sought(bench: Bench, scorer: Scorer, chosen: list[int]) -> list[seek.Sought]:
    """What the rest of the present model shows by itself."""
    rest, _ = rests(bench, scorer, chosen)
    found = seek.steps(bench.scene, rest) + seek.contacts(bench.scene, rest)
    return found + seek.lines(bench.scene, rest, bench.rows.runs) + seek.ripples(bench.scene, rest)


def at_first_sight(bench: Bench) -> list[seek.Sought]:
    """What belongs to moments and shows in the residual itself: it must not pass for noise."""
    rest = bench.whole - np.median(bench.whole, axis=0)
    found = seek.contacts(bench.scene, rest) + seek.lines(bench.scene, rest, bench.rows.runs)
    return found + seek.steps(bench.scene, rest)[:-1]


def rests(bench: Bench, scorer: Scorer, chosen: list[int]) -> tuple[Array, Array]:
    """(M, C) rest of a model, raw and whitened."""
    theta = scorer.solve(chosen)[0]
    rest, white, done = bench.y.copy(), scorer.white.copy(), 0
    for i in [*range(len(scorer.base)), *chosen]:
        h = scorer.library[i]
        t = theta[done : done + h.count]
        done += h.count
        rest[:, list(h.raw.channels)] -= h.raw.values @ t
        white[:, list(h.white.channels)] -= h.white.values @ t
    return rest, white


def select(bench: Bench, scorer: Scorer) -> Selection:
    """Forward, backward and swap until nothing changes."""
    out = Selection(scorer)
    refused: set[int] = set()
    for turn in range(MOST):
        scorer.append([bench.add(s.effect, s.looked) for s in sought(bench, scorer, out.chosen)])
        scores, highest = scorer.scores(out.chosen)
        out.needed = max(out.needed, threshold(highest, CHANCE))
        if turn == 0:
            out.first = scores
        best = _best(bench, scorer, out, scores, refused)
        if best is None:
            break
        out.chosen.append(best)
        settle(bench, scorer, out.chosen)
        _drop(scorer, out)
        if _swap(scorer, out, refused):
            settle(bench, scorer, out.chosen)
        if _enrich(bench, scorer, out):
            settle(bench, scorer, out.chosen)
        retime(bench, scorer, out.chosen)
        refused.clear()
    for i in out.chosen:
        # What the others can do as well has no score of its own.
        score = scorer.scores([j for j in out.chosen if j != i], [i])[0].get(i)
        if score is not None:
            out.evidence[i] = score
    return out


def _best(bench: Bench, scorer: Scorer, out: Selection, scores: dict[int, Score], refused: set[int]) -> int | None:
    """The best hypothesis that chance does not explain and that pays on blocks left out; None when there is none."""
    taken = {place_of(scorer.library[i].effect) for i in out.chosen}
    able = [i for i, s in scores.items() if s.surprise > out.needed and s.rank > 0.0 and i not in refused]
    able = [i for i in able if place_of(scorer.library[i].effect) not in taken]
    able.sort(key=lambda i: -scores[i].rank)
    if not able:
        return None
    able = sharpened(bench, scorer, out.chosen, scores, able)
    misfit = scorer.misfit([*out.chosen, able[0]])
    able.insert(0, plainest(scorer, scores, able, misfit))
    tries = 0
    for i in dict.fromkeys(able):
        if i in refused:
            continue
        if tries == TRIES:
            break
        tries += 1
        better, (paid, whole) = i, worth(bench, scorer, out, i)
        if paid >= 0.5 * WORTH:
            better = polished(bench, scorer, out.chosen, i)
            paid, whole = worth(bench, scorer, out, better) if better != i else (paid, whole)
        price, least = _price(scorer.library[i].effect, misfit), _least(bench, out, misfit)
        if paid >= price and whole >= least:
            if plausible(bench, scorer, out.chosen, better):
                return better
            # At the optimum it is not what it is called; beside it, where other physics is still missing, it may be.
            near = _plausible_kin(bench, scorer, out.chosen, scores, i)
            if near is not None:
                paid, whole = worth(bench, scorer, out, near)
                if paid >= price and whole >= least:
                    return near
        refused.update(_kin(scorer, i))
        effect = scorer.library[better].effect
        if effect is not None:
            out.refused.append((effect, paid))
    return None


def _plausible_kin(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], i: int) -> int | None:
    """The best of the same hypothesis at other searched values whose parameters can be what it is called."""
    kin = sorted((j for j in _kin(scorer, i) if j in scores), key=lambda j: -scores[j].rank)
    return next((j for j in kin if scores[j].rank > 0.0 and plausible(bench, scorer, chosen, j)), None)


def sharpened(bench: Bench, scorer: Scorer, chosen: list[int], scores: dict[int, Score], able: list[int]) -> list[int]:
    """The able ones ranked again after the leaders of up to four kinds were polished: a coarse grid must not decide."""
    leaders: dict[str, int] = {}
    for i in able:
        effect = scorer.library[i].effect
        if effect is not None and scores[i].rank > 0.75 * scores[able[0]].rank:
            leaders.setdefault(effect.KEY, i)
    fresh = []
    for i in list(leaders.values())[:4]:
        effect = scorer.library[i].effect
        if effect is not None and effect.exact(bench.scene, np.zeros(scorer.library[i].count)) is not None:
            scores[i] = bent(bench, scorer, chosen, i, scores[i])
        elif effect is not None and effect.searched() and len(leaders) > 1:
            better = polished(bench, scorer, chosen, i)
            if better != i:
                scores.update(scorer.scores(chosen, [better])[0])
                fresh.append(better)
    return sorted([*able, *(i for i in fresh if i in scores)], key=lambda i: -scores[i].rank)


def bent(bench: Bench, scorer: Scorer, chosen: list[int], i: int, score: Score) -> Score:
    """The score of a nonlinear effect at its own optimum (Gauss and Newton) instead of by its slope at zero."""
    h, y, theta = scorer.library[i], bench.y, scorer.solve([*chosen, i])[0][-scorer.library[i].count :]
    base = [scorer.library[j] for j in [*range(len(scorer.base)), *chosen]]
    rows = np.flatnonzero(bench.train)
    _, white = rests(bench, scorer, chosen)
    before, best = float(np.sum(white[rows] ** 2)), score.gain
    for _ in range(2):
        new, offset = tangent(bench, h, theta)
        target = bench.whitened(y - offset)
        model = [*base, new]
        solved = fit(model, target, rows, bench.width)
        rest, done = target[rows].copy(), 0
        for part in model:
            rest[:, list(part.white.channels)] -= part.white.values[rows] @ solved[done : done + part.count]
            done += part.count
        theta = solved[-h.count :]
        best = max(best, before - float(np.sum(rest**2)))
    return replace(score, gain=best, rank=score.rank + best - score.gain)


SLACK = 0.25
PLAIN = {
    "time_delay": 0,
    "bias": 0,
    "joint_offset": 0,
    "gain": 1,
    "payload": 1,
    "base_tilt": 1,
    "friction": 1,
    "backlash": 1,
    "lag": 2,
}
"""Of look-alikes that do nearly as well while the model still misses much, the plainer goes first."""


TIE = 2.0
"""Difference of rank within which two hypotheses count as equal."""


def plainest(scorer: Scorer, scores: dict[int, Score], able: list[int], misfit: float) -> int:
    """The plainest hypothesis that reaches nearly the gain of the best: the margin grows with what the model misses.

    Where only noise is left (misfit 1) the likelihood decides, but for ties; where physics is missing, small differences of
    likelihood between look-alikes are that physics, not evidence.
    """
    best = able[0]
    share = SLACK * min(1.0, misfit - 1.0)
    slack = share * scores[best].gain
    slack = slack if slack > 6.0 else TIE

    def cost(i: int) -> tuple[int, int, float]:
        effect = scorer.library[i].effect
        key = "" if effect is None else effect.KEY
        return (PLAIN.get(key, 3), scores[i].count, -scores[i].rank)

    close = [i for i in able if scores[i].rank >= scores[best].rank - slack]
    return min(close, key=cost)


def place_of(effect: Effect | None) -> tuple[str, ...]:
    """Where an effect sits: one hypothesis of a kind a place; those of moments may stand side by side."""
    if effect is None or effect.KEY in ("step", "vibration", "torque_ripple", "contact"):
        return (str(id(effect)),)
    names = ("joint", "channel", "driver", "source", "place", "part", "axis")
    place = [str(getattr(effect, name, "")) for name in names]
    errors = getattr(effect, "errors", ())
    form = getattr(effect, "form", "") if effect.KEY in ("compliance", "cable_drag") else ""
    return (effect.KEY, *place, *map(str, errors), form)


def _price(effect: Effect | None, misfit: float) -> float:
    """The share of the excess that an effect must take; what belongs to moments fits nearly anything and pays more."""
    episodic = effect is not None and effect.EPISODIC
    return WORTH * (1.0 + min(1.0, misfit - 1.0) * episodic)


def settle(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """Nonlinear effects are linearised anew where they stand; what they do beyond their slope is taken off the residual."""
    for _ in range(3):
        theta = scorer.solve(chosen)[0]
        done = sum(h.count for h in scorer.base)
        beyond, fresh, moved = np.zeros_like(bench.y), [], False
        for place, i in enumerate(chosen):
            h = scorer.library[i]
            t, done = theta[done : done + h.count], done + h.count
            if h.effect is None or h.effect.exact(bench.scene, t) is None:
                continue
            new, offset = tangent(bench, h, t)
            beyond += offset
            moved = moved or h.theta is None or bool(np.max(np.abs(h.theta - t)) > 1e-3 * np.max(np.abs(t)))
            fresh.append((place, new))
        if not fresh or not moved:
            return
        bench.y = bench.whole - beyond
        scorer.append([h for _, h in fresh])
        for k, (place, _) in enumerate(fresh):
            chosen[place] = len(scorer.library) - len(fresh) + k
        scorer.retarget(bench.y)


LATER = 0.1
"""A delay or lag that moves by more than this share makes all other effects' columns anew."""


def retime(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """What a late or lagging stream delivers of the other effects is late too: a delayed play is not a delay plus a play."""
    for _ in range(2):
        theta, now = scorer.solve(chosen)[0], list[tuple[Timing, Array]]()
        done = sum(h.count for h in scorer.base)
        for i in chosen:
            h = scorer.library[i]
            t, done = theta[done : done + h.count], done + h.count
            if isinstance(h.effect, Timing):
                now.append((h.effect, t))
        if _same_timing(bench.timing, now):
            return
        bench.timing = now
        scorer.retime()
        settle(bench, scorer, chosen)


def _same_timing(old: list[tuple[Timing, Array]], new: list[tuple[Timing, Array]]) -> bool:
    return len(old) == len(new) and all(
        a == b and bool(np.max(np.abs(s - t)) <= LATER * np.max(np.abs(t)))
        for (a, s), (b, t) in zip(old, new, strict=True)
    )


def tangent(bench: Bench, h: Hypothesis, theta: Array) -> tuple[Hypothesis, Array]:
    """The hypothesis linearised at theta, and (M, C) what it predicts there beyond slope times theta."""
    effect, scene = h.effect, bench.scene
    assert effect is not None, "nuisances are linear"
    here = effect.change(scene, theta)
    slopes = []
    for k in range(h.count):
        step = np.zeros(h.count)
        step[k] = 1e-4 * max(float(np.max(np.abs(theta))), 1e-6)
        slopes.append((effect.change(scene, theta + step) - effect.change(scene, theta - step)) / (2.0 * step[k]))
    raw = bench.averaged(Columns(tuple(range(bench.width)), np.stack(slopes, axis=-1)), timed=False)
    out = bench.made(effect, raw, h.looked)
    out.theta = theta
    return out, bench.rows.average(here) - raw.values @ theta


def _kin(scorer: Scorer, i: int) -> list[int]:
    effect = scorer.library[i].effect
    assert effect is not None, "nuisances are never candidates"
    return [j for j, h in enumerate(scorer.library) if h.effect is not None and h.effect.family == effect.family]


def _drop(scorer: Scorer, out: Selection) -> None:
    """Backward: what no longer stands beside the others goes."""
    while len(out.chosen) > 1:
        alone = {i: scorer.scores([j for j in out.chosen if j != i], [i])[0].get(i) for i in out.chosen}
        worst = min(out.chosen, key=lambda i: -np.inf if alone[i] is None else alone[i].rank)  # type: ignore[union-attr]
        score = alone[worst]
        if score is not None and score.rank > 0.0 and score.surprise > 0.7 * out.needed:
            return
        out.chosen.remove(worst)


def _swap(scorer: Scorer, out: Selection, refused: set[int]) -> bool:
    """Each chosen effect against every rival in its place; whether any was exchanged."""
    before = list(out.chosen)
    for i in list(out.chosen):
        others = [j for j in out.chosen if j != i]
        scores, _ = scorer.scores(others)
        rivals = {j: s for j, s in scores.items() if j not in refused}
        if i not in rivals:
            continue
        best = max(rivals, key=lambda j: rivals[j].rank)
        misfit = scorer.misfit([*others, best])
        margin = 6.0 + SLACK * min(1.0, misfit - 1.0) * rivals[i].gain
        if best != i and rivals[best].rank > rivals[i].rank + margin:
            out.chosen[out.chosen.index(i)] = best
    return out.chosen != before


RICHER = 0.1


def _enrich(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """A richer form of a chosen effect (friction with a viscous part, by direction) takes its place where it pays.

    Nested forms of one kind in one joint are judged by increment alone: likelihood beyond the price of the added
    parameters, and a tenth of the excess that is left in some channel on blocks left out.
    """
    changed = False
    for place, i in enumerate(list(out.chosen)):
        effect = scorer.library[i].effect
        if effect is None or effect.EPISODIC or not effect.joints:
            continue
        scores, _ = scorer.scores([j for j in out.chosen if j != i])
        kin = [j for j in scores if i in scores and _same_kind(scorer.library[j].effect, effect) and j != i]
        kin = [j for j in kin if scores[j].rank > scores[i].rank + 6.0]
        for j in sorted(kin, key=lambda j: -scores[j].rank)[:2]:
            trial = [*out.chosen[:place], j, *out.chosen[place + 1 :]]
            before, after = crossed(bench, scorer, out.chosen), crossed(bench, scorer, trial)
            floor = bench.noise.sigma**2
            richer = float(np.max((before - after) / np.maximum(before - floor, 0.02 * floor)))
            if richer >= RICHER and plausible(bench, scorer, trial[:place] + trial[place + 1 :], j):
                out.chosen, changed = trial, True
                break
    return changed


def _same_kind(other: Effect | None, effect: Effect) -> bool:
    return other is not None and other.KEY == effect.KEY and other.joints == effect.joints


def polished(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> int:
    """The same effect with its searched values at the optimum: a new place in the library, or the old one."""
    hypothesis = scorer.library[i]
    effect = hypothesis.effect
    if effect is None or not effect.searched():
        return i
    for name, value in effect.searched().items():
        effect = _along(bench, scorer, chosen, effect, name, value)
    scorer.append([bench.add(effect, hypothesis.looked)])
    last = len(scorer.library) - 1
    pair, _ = scorer.scores(chosen, [i, last])
    return last if last in pair and (i not in pair or pair[last].gain > pair[i].gain) else i


def _along(bench: Bench, scorer: Scorer, chosen: list[int], effect: Effect, name: str, value: float) -> Effect:
    bound = effect.SEARCHED[name]
    _, white = rests(bench, scorer, chosen)
    at = [scorer.library[i] for i in [*range(len(scorer.base)), *chosen]]
    rows = bench.train
    wide = 1.02 if name in {"frequency", "wave_number"} else 2.2

    def cost(log_value: float) -> float:
        h = bench.add(effect.with_searched({name: float(np.exp(log_value))}))
        return -_gain(h, at, white, rows)

    low, high = max(np.log(value / wide), np.log(bound.low)), min(np.log(value * wide), np.log(bound.high))
    if not high > low:
        return effect
    tolerance = 1e-5 if wide < 1.1 else 3e-3
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": tolerance, "maxiter": 12})
    return effect.with_searched({name: float(np.exp(found.x))}) if found.fun < cost(np.log(value)) else effect


def _gain(h: Hypothesis, base: list[Hypothesis], white: Array, rows: Chosen) -> float:
    """Fall of the whitened sum of squares of a rest when one hypothesis joins those that made it."""
    channels = h.white.channels
    X = h.white.values[rows].reshape(-1, h.count)
    r = white[rows][:, list(channels)].reshape(-1)
    parts = [b for b in base if set(b.white.channels) & set(channels)]
    inside = [_on(b.white, channels)[rows].reshape(len(X), -1) for b in parts]
    B = np.concatenate([np.empty((len(X), 0)), *inside], axis=1)
    B = B / np.maximum(np.linalg.norm(B, axis=0), 1e-300)
    X = X - B @ np.linalg.lstsq(B, X, rcond=1e-9)[0]
    theta = np.linalg.lstsq(X, r, rcond=1e-9)[0]
    return float(2.0 * theta @ (X.T @ r) - np.sum((X @ theta) ** 2))


def _on(columns: Columns, channels: tuple[int, ...]) -> Array:
    """(M, len(channels), k) of columns on some channels, zero where they do not act."""
    out = np.zeros((len(columns.values), len(channels), columns.count))
    for i, c in enumerate(channels):
        if c in columns.channels:
            out[:, i] = columns.values[:, columns.channels.index(c)]
    return out


def worth(bench: Bench, scorer: Scorer, out: Selection, i: int) -> tuple[float, float]:
    """What the hypothesis takes on blocks it did not learn from: share of the excess left, and of that at the start.

    The best channel counts. Five folds of contiguous blocks inside the training rows, errors in raw units, excess over the
    noise of the rich fit.
    """
    effect = scorer.library[i].effect
    # A contact of three seconds lies in one block: only pieces shorter than it can say whether it is there.
    fine = effect is not None and effect.EPISODIC
    before = crossed(bench, scorer, out.chosen, fine=fine)
    after = crossed(bench, scorer, [*out.chosen, i], fine=fine)
    floor = bench.noise.sigma**2
    if not len(out.start):
        out.start = crossed(bench, scorer, out.chosen)
    weight = _where_it_acts(scorer, out.chosen, i, bench)
    left = (before - after) / np.maximum(before - floor, 0.02 * floor)
    whole = (before - after) / np.maximum(out.start - floor, 0.02 * floor)
    return float(weight @ left), float(weight @ whole)


def _where_it_acts(scorer: Scorer, chosen: list[int], i: int, bench: Bench) -> Array:
    """(C,) shares of the energy, in units of the noise, that the hypothesis predicts in each channel."""
    h = scorer.library[i]
    theta = scorer.solve([*chosen, i])[0][-h.count :]
    energy = np.zeros(bench.width)
    size = np.mean((h.raw.values @ theta) ** 2, axis=0)
    energy[list(h.raw.channels)] = size / bench.noise.sigma[list(h.raw.channels)] ** 2
    return np.asarray(energy / max(float(energy.sum()), 1e-300))


def _least(bench: Bench, out: Selection, misfit: float) -> float:
    """Share of the whole excess that must be taken: nothing where noise is all that is left and the excess was small."""
    loud = float(np.max(out.start / bench.noise.sigma**2)) > LOUD
    return MATTERS * max(min(1.0, misfit - 1.0), 0.3 * loud)


def plausible(bench: Bench, scorer: Scorer, chosen: list[int], i: int) -> bool:
    """Whether the parameters can be what the effect is called."""
    h = scorer.library[i]
    assert h.effect is not None, "nuisances are never candidates"
    theta, at, _ = scorer.solve([*chosen, i])
    misfit = scorer.misfit([*chosen, i])
    spread = scorer.spread(at)[-h.count :] * np.sqrt(misfit)
    named = list(zip(h.effect.parameters(bench.scene), theta[-h.count :], spread, strict=True))
    # A lag of a twentieth is no lag. Bounds matter where physics is missing: else the shape has proved it, whatever its size.
    return all(p.near(t, s) and (misfit < PROVED or p.plausible(t, s)) for p, t, s in named)


def crossed(bench: Bench, scorer: Scorer, chosen: list[int], *, fine: bool = False) -> Array:
    """(C,) mean squared error of a model on training blocks left out in turn, see `left_out`."""
    return left_out(bench, [scorer.library[i] for i in [*range(len(scorer.base)), *chosen]], scorer.white, fine=fine)


def left_out(bench: Bench, model: list[Hypothesis], white: Array, *, folds: int = 5, fine: bool = False) -> Array:
    """(C,) mean squared error, raw, on training blocks left out in turn; `fine`: on short pieces left out in turn."""
    train = np.flatnonzero(bench.train)
    if fine:
        fold = train // max(len(bench.rows) // PIECES, 8) % folds
    else:
        fold = np.unique(bench.block[train], return_inverse=True)[1] % folds
    total = np.zeros(bench.width)
    for k in range(folds):
        learn, judge = train[fold != k], train[fold == k]
        if not len(judge) or not len(learn):
            continue
        theta = fit(model, white, learn, bench.width)
        error = bench.y[judge] - predicted(model, theta, judge, bench.width)
        total += np.sum(error**2, axis=0)
    return total / len(train)


def fit(model: list[Hypothesis], white: Array, rows: Chosen, width: int) -> Array:
    """Generalised least squares of a model on some rows."""
    size = sum(h.count for h in model)
    G, b = np.zeros((size, size)), np.zeros(size)
    starts = np.cumsum([0, *(h.count for h in model)])
    for c in range(width):
        mine = [(h, s) for h, s in zip(model, starts, strict=False) if c in h.white.channels]
        if not mine:
            continue
        at = np.concatenate([np.arange(s, s + h.count) for h, s in mine])
        X = np.concatenate([h.white.values[:, h.white.channels.index(c)] for h, _ in mine], axis=1)[rows]
        G[np.ix_(at, at)] += X.T @ X
        b[at] += X.T @ white[rows, c]
    return solve_sym(G, b[:, None])[:, 0]


def predicted(model: list[Hypothesis], theta: Array, rows: Chosen, width: int) -> Array:
    """(len(rows), C) of a model in raw units."""
    out, done = np.zeros((len(rows), width)), 0
    for h in model:
        out[:, list(h.raw.channels)] += h.raw.values[rows] @ theta[done : done + h.count]
        done += h.count
    return out
