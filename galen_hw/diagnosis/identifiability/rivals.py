"""Effects that this recording cannot tell apart: by likelihood, by angles between their signals, and by structure.

Everything is read off the inner products of whitened columns. With the rest of the model (nuisances and the other effects)
projected out, a found effect has the columns A with parameters t and a rival the columns B. The rival can make the share R^2 =
|P_B A t|^2 / |A t|^2 of the found signal; its angle is arccos R. The smallest principal angle between the spans of A and B
(Bjoerck and Golub 1973) says whether any signal of one could be any of the other. The likelihood decides, angles say why.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import subspace_angles
from scipy.optimize import minimize_scalar

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.linearisation import nonlinear_restored
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.estimation.normal_equations import Projected, Scorer
from galen_hw.diagnosis.findings.wording import structural, why
from galen_hw.diagnosis.result import Confusion, Finding
from galen_hw.diagnosis.selection.comparison import at_nonlinear_optimum, vuong_statistic, without_timing
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.linear_algebra import WEAK, orthonormal, pinned_at, scaled, solve_sym
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import effect_class
from galen_hw.spatial import Array

CLOSE = 7.0
"""Twice a log likelihood below which two effects count as equal: odds of about thirty to one."""
NEAR = 40.0
"""Degrees: a rival further away will not be alike."""


@dataclass(frozen=True)
class Rival:
    """An effect in the place of a found one.

    Args:
        place: of the rival in the scorer's library; instead: of the found one.
        key: of the rival.
        lead: twice the log likelihood by which the found one is better, penalties paid.
        angle: deg between the found signal and what the rival can make of it.
        nearest: deg, smallest principal angle between the two spans.
        theta: (k,) the rival's parameters in the found one's place; own: the found one's.
        effect: the rival, its searched value where it is most like the found one.
        agreed: the lead in standard errors over the blocks of the recording; infinite where they were not asked.
    """

    place: int
    instead: int
    key: str
    lead: float
    angle: float
    nearest: float
    theta: Array
    own: Array
    effect: Effect
    agreed: float = np.inf

    def undecided(self, *, clear: float = 2.0) -> bool:
        """Return whether the blocks of the recording do not agree on its lead.

        Args:
            clear: standard errors over the blocks below which a lead is none, whatever the likelihood says of it.
        """
        return self.agreed < clear


@dataclass(frozen=True)
class Own:
    """A found effect in its place.

    Args:
        i: place in the scorer's library; chosen: the model it belongs to.
        gain: fall of the whitened sum of squares by it; theta: (k,) its parameters.
        linear: (k,) parameters of its best linear approximation; theta, where it is linear.
    """

    i: int
    chosen: tuple[int, ...]
    gain: float
    theta: Array
    linear: Array


def confusions(model: Model, selection: Selection, finding: Finding, *, most: int = 5) -> list[Confusion]:
    """Return other effects that would explain as much in the finding's place, and those that are structurally the same.

    Args:
        most: effects, and joints of the same effect.
    """
    out = {rival.key: Confusion(rival.key, _why(finding.effect, rival)) for rival in rivals(selection, finding)}
    for key in structural(finding.effect, model.bench.scene, finding.parameters):
        out.setdefault(key, Confusion(key, why(finding.effect, key)))
    return [*list(out.values())[:most], *_in_other_joints(selection, finding, most)]


def _in_other_joints(selection: Selection, finding: Finding, most: int) -> list[Confusion]:
    """Return the same effect in other joints that explains as much: joints about parallel axes turn gravity alike."""
    scorer, out = selection.scorer, []
    for i in _places(selection, finding):
        effect = scorer.library[i].effect
        if effect is None or not effect.joints:
            continue
        own, best = _own(scorer, selection.chosen, i), dict[tuple[str, ...], Rival]()
        with nonlinear_restored(scorer, i), without_timing(scorer, i):
            for rival in sorted(_in_place(scorer, own, own_key=True), key=lambda r: -r.angle):
                if rival.angle < NEAR and rival.effect.joints not in ((), effect.joints):
                    best[rival.effect.joints] = rival
            near = [_at_its_best(scorer, own, rival) for rival in list(best.values())[-most:]]
        alike = [r for r in near if r.lead < CLOSE and _is_what_it_is_called(scorer, r)]
        others = " or ".join(", ".join(r.effect.joints) for r in sorted(alike, key=lambda r: r.lead))
        if others:
            why_not = f"in {others} instead of {', '.join(effect.joints)} it makes the same signal in this recording"
            out.append(Confusion(finding.effect, f"{why_not}, to within its noise"))
    return out


def rivals(
    selection: Selection, finding: Finding, *, everyone: bool = False, asked: float = 60.0, sharpened: int = 2
) -> list[Rival]:
    """Return the best rival of every other kind that ties with the finding (or `everyone` at all near), nearest first.

    Args:
        asked: twice the log likelihood, above what ties, from which the blocks need not be asked: they would have
            to disagree four times over.
        sharpened: number of rivals of each effect that are optimised between the points of their grids.
    """
    scorer = selection.scorer
    found: dict[str, Rival] = {}
    misfit = scorer.misfit(selection.chosen)
    for i in _places(selection, finding):
        own = _own(scorer, selection.chosen, i)
        # Where physics is missing, differences of a few hundredths are model discrepancy.
        margin = CLOSE + 0.05 * min(1.0, misfit - 1.0) * own.gain
        best: dict[str, Rival] = {}
        with nonlinear_restored(scorer, i), without_timing(scorer, i):
            for rival in _in_place(scorer, own):
                if rival.key != finding.effect and rival.lead < best.get(rival.key, rival).lead + 1e-9:
                    best[rival.key] = rival
            near = sorted(best.values(), key=lambda rival: rival.angle)
            # Where the searched value is the size, a point of the grid says nothing of the rival.
            coarse = [
                (_coarse(r) and k < sharpened) or r.effect.pinned(scorer.bench.scene) is not None
                for k, r in enumerate(near)
            ]
            sharp = Sharpener(scorer, own) if any(coarse) else None
            for k, rival in enumerate(near):
                one = sharp.sharpened(rival) if sharp and coarse[k] else rival
                one = _at_its_best(scorer, own, one) if k < sharpened else one
                if margin <= one.lead < margin + asked and one.angle < NEAR:
                    one = replace(one, agreed=_agreed(scorer, own, one))
                alike = (one.lead < margin or one.undecided()) and _is_what_it_is_called(scorer, one)
                if (everyone or alike) and one.lead < found.get(one.key, one).lead + 1e-9:
                    found[one.key] = one
    return sorted(found.values(), key=lambda rival: rival.lead)


def _at_its_best(scorer: Scorer, own: Own, rival: Rival) -> Rival:
    """Return a rival scored at its nonlinear optimum instead of by its slope at zero."""
    bench, h = scorer.bench, scorer.library[rival.place]
    if h.effect is None or not h.effect.bends(bench.scene, np.zeros(h.count)):
        return rival
    others = [j for j in own.chosen if j != own.i]
    score = scorer.scores(others, [rival.place])[0].get(rival.place)
    if score is None:
        return rival
    return replace(
        rival, lead=rival.lead + score.gain - at_nonlinear_optimum(bench, scorer, others, rival.place, score).gain
    )


def _is_what_it_is_called(scorer: Scorer, rival: Rival, *, unsure: float = 0.2) -> bool:
    """Return whether a rival's parameters fit its name: a play with a share of a thousandth is a scale.

    Args:
        unsure: standard deviation that a rival's share is allowed: its searched value stands where it is most
            like the found signal.
    """
    parameters = rival.effect.parameters(scorer.bench.scene)
    near = all(p.near(float(value), unsure) for p, value in zip(parameters, rival.theta, strict=True))
    return near and rival.effect.at_work(scorer.bench.scene)


def _agreed(scorer: Scorer, own: Own, rival: Rival) -> float:
    """Return the lead over a rival in standard errors over blocks: imperfect whitening makes likelihoods too sure."""
    others = [j for j in own.chosen if j != own.i]
    with scorer.trying([scorer.bench.hypothesis(rival.effect, scorer.library[rival.place].trials)]):
        return vuong_statistic(scorer.bench, scorer, others, own.i, len(scorer.library) - 1)


def _coarse(rival: Rival, *, already: float = 0.5) -> bool:
    """Return whether a searched value between the points of its grid could make a near rival nearer.

    Args:
        already: degrees; a nearer rival needs no sharpening.
    """
    return len(rival.effect.searched()) == 1 and already < rival.angle < NEAR


class Sharpener:
    """Rivals of one chosen effect between the points of their grids: the library's grid must not decide what is alike.

    Args:
        scorer: with `nonlinear_restored`; own: the effect in whose place the rivals are.
    """

    def __init__(self, scorer: Scorer, own: Own) -> None:
        self.scorer, self.i, self.gain = scorer, own.i, own.gain
        i = own.i
        present = [j for j in [*range(len(scorer.base)), *own.chosen] if j != i]
        nothing = self._rows(scorer.library[i])[:, :0]  # a model without nuisances has nothing else in it
        others = [self._rows(scorer.library[j]) for j in present]
        self.base = orthonormal(scaled(np.concatenate([nothing, *others], axis=1)))
        self.own = self._projected(self._rows(scorer.library[i]))
        self.signal = self.own @ own.theta
        nonlinear = scorer.library[i].nonlinear
        if nonlinear is not None:
            self.signal = (
                self.signal + self._projected(scorer.bench.whitened(nonlinear)[scorer.bench.train].reshape(-1, 1))[:, 0]
            )
        self.white = self._projected(scorer.white[scorer.bench.train].reshape(-1, 1))[:, 0]

    def _rows(self, h: Hypothesis) -> Array:
        """Return whitened columns (n C, k) on the training rows."""
        bench = self.scorer.bench
        full = h.white.full(bench.width)[bench.train]
        return full.reshape(full.shape[0] * full.shape[1], h.count)

    def _projected(self, X: Array) -> Array:
        return np.asarray(X - self.base @ (self.base.T @ X))

    def sharpened(self, rival: Rival, *, reach: float = 8.0) -> Rival:
        """Return the rival with its searched values, one after the other, where it makes most of the found signal.

        Args:
            reach: factor up and down within which a searched value is sought.
        """
        effect = rival.effect.unlimited()
        pinned = effect.pinned(self.scorer.bench.scene)
        # Where the size is not free, the searched value is the size: without its limit it may lie far below the grid.
        down = 1.0 / reach if pinned is None or effect == rival.effect else 0.0
        for name, value in rival.effect.searched().items():
            effect = self._along(effect, name, (down * value, reach * value), finely=pinned is not None)
        residual, X = self._residual_of(effect)
        share = max(1.0 - residual / float(self.signal @ self.signal), 0.0)
        if pinned is None and _angle(np.sqrt(share)) >= rival.angle:
            return rival
        A, r, library = X.T @ X, X.T @ self.white, self.scorer.library
        if not A.any():  # Where it comes nearest it does nothing.
            return rival
        theta = solve_sym(A, r[:, None])[:, 0] if pinned is None else pinned_at(pinned, A, r)
        worth = float(2.0 * theta @ r - theta @ A @ theta)
        paid = akaike_penalty(library[rival.place]) - akaike_penalty(library[self.i])
        nearest = float(np.degrees(np.min(subspace_angles(self.own, X))))
        angle = _angle(np.sqrt(share))
        return replace(rival, lead=self.gain - worth + paid, angle=angle, nearest=nearest, theta=theta, effect=effect)

    def _along(self, effect: Effect, name: str, within: tuple[float, float], *, finely: bool) -> Effect:
        bound = effect.SEARCHED[name]
        low, high = np.log(max(within[0], bound.low)), np.log(min(within[1], bound.high))

        def misfit(at: float) -> float:
            return self._residual_of(effect.with_searched({name: float(np.exp(at))}))[0]

        # Where the size is not free, the searched value is the size.
        options = {"xatol": 1e-3, "maxiter": 30} if finely else {"xatol": 0.02, "maxiter": 14}
        best = minimize_scalar(misfit, bounds=(low, high), method="bounded", options=options)
        return effect.with_searched({name: float(np.exp(best.x))})

    def _residual_of(self, effect: Effect) -> tuple[float, Array]:
        """Return the squares of the found signal that an effect does not make, and its projected columns."""
        X = self._projected(self._rows(self.scorer.bench.hypothesis(effect)))
        pinned = effect.pinned(self.scorer.bench.scene)
        A, r = X.T @ X, X.T @ self.signal
        theta = solve_sym(A, r[:, None])[:, 0] if pinned is None else pinned_at(pinned, A, r)
        answer = X @ theta
        return float(np.sum((self.signal - answer) ** 2)), X


def _places(selection: Selection, finding: Finding) -> list[int]:
    """Return the numbers of the finding's hypotheses: among the chosen, or as a constant that is always fitted."""
    scorer = selection.scorer
    chosen = [(i, scorer.library[i].effect) for i in selection.chosen]
    mine = [i for i, effect in chosen if effect is not None and finding.effect == effect.KEY]
    if mine or not effect_class(finding.effect).always_fitted(scorer.bench.scene.observations.predict):
        return mine
    names = scorer.bench.scene.channels
    constant = [i for i, h in enumerate(scorer.base) if len(h.raw.channels) == 1]
    return [i for i in constant if names[scorer.base[i].raw.channels[0]] in finding.channels]


def _others(scorer: Scorer, chosen: list[int], i: int) -> Projected:
    """Return the projected normal equations of the model without hypothesis i, which may be one of the constants."""
    at, b, total = scorer.projected([j for j in chosen if j != i])
    return Projected(at[~scorer.mask_of(at, i)], b, total)


def _own(scorer: Scorer, chosen: list[int], i: int) -> Own:
    """Return the gain and parameters of hypothesis i in the model."""
    theta, every, residual = scorer.solve(chosen)
    mine = scorer.mask_of(every, i)
    with nonlinear_restored(scorer, i):
        linear = scorer.solve(chosen)[0]
        at, b, total = _others(scorer, chosen, i)
        alone = solve_sym(scorer.products.between(at, at), b[at][:, None])[:, 0]
        without = total - float(alone @ b[at])
    return Own(i, tuple(chosen), without - residual, theta[mine], linear[mine])


def _in_place(scorer: Scorer, found: Own, *, own_key: bool = False) -> list[Rival]:
    """Return every hypothesis of another kind (or of its `own_key`) that can make at least half of the found signal."""
    i, gain, theta = found.i, found.gain, found.linear
    at, b, _ = _others(scorer, list(found.chosen), i)
    own = scorer.places[i]
    columns = np.arange(len(b))
    every, mine_with = scorer.products.between(at, columns), scorer.products.between(columns[own], columns)
    P = solve_sym(every[:, at], np.column_stack([every, b[at]]))
    A = mine_with[:, own] - mine_with[:, at] @ P[:, own]
    signal = float(theta @ A @ theta)
    mine, out = scorer.library[i].effect, []
    for j, h in enumerate(scorer.library):
        same = h.effect is not None and mine is not None and h.effect.KEY == mine.KEY
        if h.effect is None or same != own_key or j in found.chosen or not h.count or signal <= 0.0:
            continue
        s = scorer.places[j]
        (block,) = scorer.products.within(columns[s][:1])
        B = block - every[:, s].T @ P[:, s]
        W = _whitening(B, np.diagonal(block))
        cross = mine_with[:, s].T - every[:, s].T @ P[:, own]
        share = float(np.sum((W.T @ (cross @ theta)) ** 2)) / signal
        if not W.shape[1] or share < 0.5:
            continue
        r = b[s] - every[:, s].T @ P[:, -1]
        worth = float(np.sum((W.T @ r) ** 2))
        lead = (gain - akaike_penalty(scorer.library[i])) - (worth - akaike_penalty(h))
        U = _whitening(A, np.diagonal(mine_with[:, own]))
        nearest = float(np.linalg.norm(W.T @ cross @ U, 2)) if U.shape[1] else 0.0
        out.append(
            Rival(
                j, i, h.effect.KEY, lead, _angle(np.sqrt(share)), _angle(nearest), W @ (W.T @ r), found.theta, h.effect
            )
        )
    return out


def _whitening(A: Array, before: Array) -> Array:
    """Return W (k, r) with W W' = A^-1 on the directions of which enough is left given the model."""
    size = np.sqrt(np.maximum(before, 1e-300))
    value, vector = np.linalg.eigh(A / np.outer(size, size))
    good = value > WEAK
    return np.asarray((vector[:, good] / np.sqrt(value[good])) / size[:, None])


def akaike_penalty(h: Hypothesis) -> float:
    """Return the AIC penalty of the parameters (Akaike 1974) and twice the log of the number of trials.

    Prior odds do not enter: an effect with one parameter more is not ruled out by having it.
    """
    if h.effect is None:
        return 1.0
    return float(h.effective_parameters() + 2.0 * math.log(h.trials))


def _angle(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0))))


def _why(found: str, rival: Rival) -> str:
    """Return the reason with its numbers, in words."""
    odds = float(np.exp(np.clip(0.5 * rival.lead, -50.0, 50.0)))
    likely = f"it is {odds:.2g} times less likely" if odds >= 1.5 else "it is as likely"
    if odds < 0.67:
        likely = (
            f"by likelihood alone it would do better ({1.0 / odds:.2g} times), held-out data and form speak against it"
        )
    if rival.lead >= CLOSE and rival.undecided():
        likely += f", but the blocks of the recording do not agree on that ({rival.agreed:.1f} standard errors)"
    return f"{why(found, rival.key)}: the two signals are {rival.angle:.1f} deg apart beside the rest, and {likely}"
