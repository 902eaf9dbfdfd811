"""A fitted model: nuisances and effects with parameters, their errors, and the residual."""

import itertools
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from galen_hw.diagnosis.estimation import signal_chain
from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.least_squares import fit, predicted
from galen_hw.diagnosis.estimation.linearisation import contribution
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.stats.linear_algebra import solve_sym
from galen_hw.diagnosis.stats.sampling import Chosen
from galen_hw.lazy import cached_property
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.spatial import Array


@dataclass(frozen=True)
class ParameterErrors:
    """Joint covariance of linear parameters and searched values.

    Args:
        covariance: (k, k) of the linear parameters, whatever the searched ones are.
        searched: standard deviation of every searched value, by the place of its effect in the model and its name.
    """

    covariance: Array
    searched: dict[tuple[int, str], float]


@dataclass(frozen=True, eq=False)
class Model:
    """Hold nuisances and effects with fitted parameters: a value, of which others are made and which none changes.

    Args:
        bench: on which it was fitted.
        nuisances: terms of the baseline; effects: what was found.
        white: whitened residual less the nonlinear remainders and interactions (y: the same, not whitened).
        unweighted: plain least squares, for a model whose residual contains physics.
        theta: parameters fitted on the training rows (momentary effects: on all), nuisances first; final: on all rows.
    """

    bench: Bench
    nuisances: list[Hypothesis]
    effects: list[Hypothesis]
    white: Array
    unweighted: bool = False
    y: Array = field(init=False)
    theta: Array = field(init=False)
    final: Array = field(init=False)

    def __post_init__(self) -> None:
        """Fit the parameters on the training rows and on all rows."""
        # Derived once, as `field(init=False)`; nothing sets them later.
        object.__setattr__(self, "y", self.bench.whole - _nonlinear_contribution(self.effects, self.bench.whole))
        train, everything = np.flatnonzero(self.bench.train), np.flatnonzero(~self.bench.excluded_rows)
        parts, y = self.unweighted_parts() if self.unweighted else (self.parts, self.white)
        object.__setattr__(self, "final", self._fitted(parts, y, everything))
        # Momentary effects can be fitted on their own rows alone; the others are fitted given these.
        moments = np.full(len(self.final), np.nan)
        for h, s in zip(self.parts, self.slices(), strict=True):
            if h.effect is not None and h.effect.EPISODIC:
                moments[s] = self.final[s]
        object.__setattr__(self, "theta", self._fitted(parts, y, train, moments))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (k, k) of the parameters fitted on all rows."""
        parts, y = self.unweighted_parts() if self.unweighted else (self.parts, self.white)
        return self._covariance(parts, y, np.flatnonzero(~self.bench.excluded_rows))

    @cached_property
    def parameter_errors(self) -> ParameterErrors:
        """Errors of all parameters with the searched values as unknowns too.

        The model is linearised in the searched values (Gauss-Newton). A searched value that is collinear with the other
        parameters is not known at all.
        """
        slopes: dict[tuple[int, str], Hypothesis] = {}
        lost: dict[tuple[int, str], float] = {}
        for k, h in enumerate(self.effects):
            for name, value in (h.effect.searched() if h.effect is not None else {}).items():
                slope = self._searched_slope(k, name)
                if slope is None:
                    lost[k, name] = abs(value)
                else:
                    slopes[k, name] = slope
        if not slopes:
            return ParameterErrors(self.covariance, lost)
        parts, y = self.unweighted_parts() if self.unweighted else (self.parts, self.white)
        more = [self._plain(slope) for slope in slopes.values()] if self.unweighted else list(slopes.values())
        whole, size = self._covariance(parts, y, np.flatnonzero(~self.bench.excluded_rows), more), len(self.final)
        spread = np.sqrt(np.maximum(np.diag(whole)[size:], 0.0)).tolist()
        return ParameterErrors(whole[:size, :size], lost | dict(zip(slopes, spread, strict=True)))

    def _searched_slope(self, k: int, name: str, *, share: float = 0.02, never: float = 1e-9) -> Hypothesis | None:
        """Return the derivative with respect to a searched value as a column, or None where it is collinear with the model.

        Args:
            share: step of the numerical derivative, of the logarithm of the factor within which the value is sought.
            never: share of the squared derivative below which it is collinear with the effect's own columns.
        """
        h, s = self.effects[k], self.slices()[len(self.nuisances) + k]
        assert h.effect is not None, "effects, not nuisances"
        value, channels = h.effect.searched()[name], list(h.raw.channels)
        step = share * float(np.log(h.effect.doubt(self.bench.scene))) * value
        up, down = (self.bench.raw(h.effect.with_searched({name: value + sign * step})) for sign in (1.0, -1.0))
        slope = (up.values - down.values) @ self.final[s] / (2.0 * step)
        column = self.bench.hypothesis_of(None, Columns(h.raw.channels, slope[:, :, None]))
        ones = np.eye(len(channels))[np.tile(np.arange(len(channels)), len(slope))]
        X = np.concatenate([h.white.values.reshape(-1, h.count), ones], axis=1)
        X, y = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300), column.white.values.reshape(-1)
        residual = y - X @ np.linalg.lstsq(X, y, rcond=1e-9)[0]
        return column if float(residual @ residual) > never * float(y @ y) else None

    @cached_property
    def variance(self) -> Array:
        """Variance (k,) of the parameters, with the spread between equivalent conventions that fit as well.

        What settles after a load is more in the end, or was less at first; a wrong scale of the load is the difference.
        """
        out = np.maximum(np.diag(self.parameter_errors.covariance), 0.0)
        for h in self.effects:
            other = None if h.effect is None else h.effect.otherwise()
            if other is None or len(self.effects) < 2:
                continue
            rival = self.replacing(
                h, replace(self.bench.hypothesis(other, h.trials), interaction=h.interaction)
            ).with_updated_laws()
            own, its = (float(np.sum(m.residual(white=True)[self.bench.train] ** 2)) for m in (self, rival))
            if abs(its - own) < CRITERIA.log_odds:
                out = out + (rival.final - self.final) ** 2
        return out

    @property
    def free_constants(self) -> Array:
        """Return 1 for channels (C,) with a constant offset in the baseline, which is no part of an effect's size, else 0."""
        out = np.zeros(self.bench.width)
        for h in self.nuisances:
            if len(h.raw.channels) == 1:
                out[h.raw.channels[0]] = 1.0
        return out

    def signal_of(self, h: Hypothesis) -> tuple[Array, Array]:
        """Return mean square and variance of the rms of an effect in each of its channels, to first order in the parameters."""
        s, free = self.slice_of(h), self.free_constants[list(h.raw.channels)]
        contribution = h.contribution(self.final[s])
        centred = h.raw.values - free[:, None] * h.raw.values.mean(axis=0)
        signal = contribution - free * contribution.mean(axis=0)
        power = np.maximum(np.mean(signal**2, axis=0), 1e-300)
        slope = np.einsum("nc,nck->ck", signal, centred) / (len(signal) * np.sqrt(power)[:, None])
        return power, np.asarray(np.einsum("ck,kl,cl->c", slope, self.parameter_errors.covariance[s, s], slope))

    def clearness(self, h: Hypothesis) -> float:
        """Return the rms of an effect over its standard error, in the channel where it is strongest beside the noise.

        What its parameters leave open to any size, for others do the same, has no size that could be told. The part of a rounding
        error that follows the signal is subtracted first: no average removes it where the machine stands.
        """
        power, variance = self.signal_of(h)
        places = list(h.raw.channels)
        strongest = int(np.argmax(power / self.bench.noise.sigma[places] ** 2))
        beyond = max(float(power[strongest] - self.bench.noise.blurred_rounding[places[strongest]]), 0.0)
        return float(np.sqrt(beyond / max(variance[strongest], 1e-300)))

    def with_updated_laws(self) -> "Model":
        """Return the model with bound parameters re-evaluated at the estimates: a small body at its present place."""
        effects = list(self.effects)
        for k, (h, s) in enumerate(zip(self.effects, self.slices()[len(self.nuisances) :], strict=True)):
            bound = h.effect.told_by(self.final[s]) if h.effect is not None and h.effect.bound else None
            if bound is not None:
                effects[k] = replace(self.bench.hypothesis(bound, h.trials), interaction=h.interaction)
        return self if effects == self.effects else replace(self, effects=effects)

    def replacing(self, old: Hypothesis, new: Hypothesis) -> "Model":
        """Return the same with another linear term in the place of one, fitted again."""
        return replace(self, effects=[new if h is old else h for h in self.effects])

    def _fitted(self, parts: list[Hypothesis], y: Array, rows: Chosen, known: Array | None = None) -> Array:
        """Return parameters fitted on some rows; a nonlinear effect keeps its values where its tangent does not reach so far.

        Args:
            parts, y: model and target; rows: to fit on; known: (k,) fixed parameters, NaN for free ones.
        """
        held = np.full(sum(h.count for h in parts), np.nan) if known is None else known.copy()
        theta = fit(parts, y, rows, self.bench.width, held)
        far = False
        for h, s in zip(parts, self.slices(), strict=True):
            if h.theta is not None and h.effect is not None and h.effect.curved and not self._reaches(h, theta[s]):
                held[s], far = h.theta, True
        return fit(parts, y, rows, self.bench.width, held) if far else theta

    def _reaches(self, h: Hypothesis, theta: Array, *, nothing: float = 1e-3) -> bool:
        """Return whether the linearisation of an effect holds at theta (k,), by the noise.

        Args:
            nothing: mean square, over the noise's, that is negligible.
        """
        assert h.effect is not None, "nuisances are linear"
        assert h.nonlinear is not None, "a tangent has one"
        off = contribution(self.bench, h.effect, theta) - h.nonlinear - h.raw.values @ theta
        return bool(np.max(np.mean(off**2, axis=0) / self.bench.noise.sigma**2) < nothing)

    @property
    def parts(self) -> list[Hypothesis]:
        """Nuisances, then effects."""
        return [*self.nuisances, *self.effects]

    def slices(self) -> list[slice]:
        """Return the slice of each part's parameters."""
        ends = np.cumsum([0, *(h.count for h in self.parts)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]

    def slice_of(self, part: Hypothesis) -> slice:
        """Return the slice of the parameters of one part."""
        return next(s for h, s in zip(self.parts, self.slices(), strict=True) if h is part)

    def placed(self) -> list[tuple[Effect, Array]]:
        """Return the effects with their parameters (k,)."""
        parts = zip(self.parts, self.slices(), strict=True)
        return [(h.effect, self.final[s]) for h, s in parts if h.effect is not None]

    def without(self, out: list[Hypothesis]) -> "Model":
        """Return the model without some effects, fitted again; without a limit the others' columns are no longer clipped."""
        kept, limits = (
            [h for h in self.effects if h not in out],
            [h.effect for h in out if h.effect is not None and h.effect.clips],
        )
        if not limits:
            nonlinear = any(h.nonlinear is not None or h.interaction is not None for h in out)
            white = self.bench.whitened(self.y + _nonlinear_contribution(out, self.y)) if nonlinear else self.white
            return replace(self, effects=kept, white=white)
        bench = copy(self.bench)
        bench.update_state(timing=[(effect, theta) for effect, theta in bench.timing if effect not in limits])
        whole = [
            h
            if h.effect is None or h.theta is not None
            else replace(bench.hypothesis(h.effect, h.trials), interaction=h.interaction)
            for h in kept
        ]
        return replace(self, bench=bench, effects=whole)

    def unweighted_parts(self) -> tuple[list[Hypothesis], Array]:
        """Return parts and residual with all frequencies weighted alike."""
        return [self._plain(h) for h in self.parts], self.y / self.bench.noise.sigma

    def _plain(self, h: Hypothesis) -> Hypothesis:
        values = h.raw.values / self.bench.noise.sigma[list(h.raw.channels)][:, None]
        return replace(h, whitened=Columns(h.raw.channels, values))

    def residual(self, *, white: bool = False) -> Array:
        """Return the residual (M, C) of the model fitted on the training rows."""
        if not white:
            rows = np.arange(len(self.y))
            return self.y - predicted(self.parts, self.theta, rows, self.bench.width)
        out = self.white.copy()
        for h, s in zip(self.parts, self.slices(), strict=True):
            out[:, list(h.white.channels)] -= h.white.values @ self.theta[s]
        return out

    def penalised_gain(self, *, predictive: bool = False) -> float:
        """Return the fall of the whitened sum of squares on the training rows less the penalty of the parameters.

        Args:
            predictive: lasting effects pay the Akaike penalty (prediction; Akaike 1974) instead of the BIC's (Schwarz 1978):
                for a comparison with what was itself judged on held-out blocks.
        """
        train, penalty = self.bench.train, 0.0
        for h in self.effects:
            lasting = h.effect is not None and not h.effect.EPISODIC
            penalty += h.effective_parameters(whole=True) * (2.0 if predictive and lasting else h.penalty(self.bench))
        fall = np.sum(self.bench.whitened(self.bench.whole)[train] ** 2) - np.sum(self.residual(white=True)[train] ** 2)
        return float(fall - penalty)

    def _covariance(
        self, parts: list[Hypothesis], white: Array, rows: Chosen, more: Sequence[Hypothesis] = ()
    ) -> Array:
        """Return the sandwich covariance over contiguous blocks: valid for imperfect whitening, never below the classical one.

        Nor below what it would be if the noise had no more scatter from band to band than its spectrum shows with certainty.
        `more`: single columns with unknown factors, behind the parameters.
        """
        size = len(self.final) + len(more)
        G, even = np.zeros((size, size)), np.zeros((size, size))
        scores = np.zeros((int(self.bench.block.max()) + 1, size))
        residual = white.copy()
        for h, s in zip(parts, self.slices(), strict=True):
            residual[:, list(h.white.channels)] -= h.white.values @ self.final[s]
        total = 0.0
        behind = [slice(len(self.final) + k, len(self.final) + k + 1) for k in range(len(more))]
        placed = list(zip([*parts, *more], [*self.slices(), *behind], strict=True))
        for c in range(self.bench.width):
            mine = [(h, s) for h, s in placed if c in h.white.channels]
            if not mine:
                continue
            at = np.concatenate([np.arange(s.start, s.stop) for _, s in mine])
            X = np.concatenate([h.white.values[:, h.white.channels.index(c)] for h, _ in mine], axis=1)[rows]
            e = residual[rows, c]
            total += float(e @ e)
            G[np.ix_(at, at)] += X.T @ X
            if not self.unweighted:
                even_out = [
                    self.bench.noise.as_smooth(h.white.values[:, h.white.channels.index(c)], c) for h, _ in mine
                ]
                S = np.concatenate(even_out, axis=1)[rows]
                even[np.ix_(at, at)] += S.T @ S
            np.add.at(scores, (self.bench.block[rows][:, None], at[None, :]), X * e[:, None])
        bread = solve_sym(G, np.eye(size))
        blocks = max(len(np.unique(self.bench.block[rows])), 2)
        meat = scores.T @ scores * blocks / max(blocks - 1, 1)
        variance = max(1.0, total / max(len(rows) * self.bench.live_channels - size, 1))
        robust, plain = bread @ meat @ bread, bread * variance
        ratio = np.sqrt(np.maximum(np.diag(robust), 0.0) / np.maximum(np.diag(plain), 1e-300))
        smooth = np.diag(bread @ even @ bread) / np.maximum(np.diag(bread), 1e-300)
        factor = np.maximum(ratio, np.sqrt(np.maximum(smooth, 1.0)))
        return np.asarray(plain * np.outer(factor, factor))


def _nonlinear_contribution(effects: list[Hypothesis], like: Array) -> Array:
    """Return the contribution (M, C) of effects beyond slope times parameters."""
    return sum((x for h in effects for x in (h.nonlinear, h.interaction) if x is not None), np.zeros_like(like))


def with_interactions(model: Model, *, stays: float = 1e-2) -> Model:
    """Return the model with the interactions of its effects, fitted again until these converge: a gain scales a new load too.

    Where they diverge, the effects are left without interactions.

    Args:
        stays: change, over the noise of one row, below which the interactions have converged.
    """
    bench, alone, last = model.bench, model, np.inf
    kinds = [(k, h.effect) for k, h in enumerate(model.effects) if h.effect is not None]
    before = [np.zeros_like(bench.whole) for _ in kinds]
    for _ in range(BUDGET.rounds):
        slices = model.slices()[len(model.nuisances) :]
        placed = [(effect, model.final[slices[k]]) for k, effect in kinds]
        now = [bench.rows.average(x) for x in signal_chain.interaction_terms(bench.scene, placed, bench.timing)]
        moved = max(
            (float(np.max(np.abs(a - b) / bench.noise.sigma)) for a, b in zip(now, before, strict=False)), default=0.0
        )
        if moved < stays:
            break
        if not moved < last:
            return alone
        before, last, effects = now, moved, list(model.effects)
        for (k, _), x in zip(kinds, now, strict=True):
            effects[k] = replace(effects[k], interaction=x if x.any() else None)
        white = alone.white - bench.whitened(sum(now, np.zeros_like(bench.whole)))
        model = replace(model, effects=effects, white=white)
    return model
