"""Likelihood ratios of all hypotheses given a model, from inner products alone."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.inner_products import Group, InnerProducts
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.diagnosis.stats.linear_algebra import log_tail, pinned_at, quadratic, solve_sym
from galen_hw.diagnosis.stats.sampling import Index, Mask
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Score:
    """How much one hypothesis adds to a model.

    Args:
        gain: fall of the whitened sum of squares.
        count: number of identifiable parameters.
        surprise: minus log of the probability of such a gain under noise, trials included.
        rank: gain less the penalty of its parameters (k log n) and trials, in units of twice the log likelihood.
        beyond: possible further gain between the points of its grid, where its searched value is its size.
    """

    gain: float
    count: int
    surprise: float
    rank: float
    beyond: float = 0.0


class Projected(NamedTuple):
    """Normal equations with a model's fixed parameters projected out.

    Args:
        at: column numbers of the free parameters; b: (K,) products of all columns with the residual; total: its sum of squares.
    """

    at: Index
    b: Array
    total: float


class Scorer:
    """Scores hypotheses on the training rows.

    Args:
        bench: with noise.
        library: hypotheses in a fixed order; more may be appended.
        free: constant offsets are always in the model; else only what the baseline itself fits.
    """

    def __init__(self, bench: Bench, library: list[Hypothesis], *, free: bool = True) -> None:
        self.bench, self.free = bench, free
        self.library: list[Hypothesis] = []
        own = bench.constants() if free else bench.constants()[0 if bench.scene.belief.bias_free else bench.width :]
        self.base = [bench.hypothesis_of(None, columns, name="constant") for columns in own]
        self.white = bench.whitened(bench.y)
        self.fake = bench.surrogates()
        self._train = bench.train
        self._fake_rows = [self.fake[self._train, c] for c in range(bench.width)]
        self._occam = _occam(library)
        self.b, self.fakes = np.empty(0), np.empty((0, self.fake.shape[2]))
        self.places: list[slice] = []
        self.families = Counter[object]()
        self.products = InnerProducts(bench.width)
        self.append([*self.base, *library])

    def append(self, new: list[Hypothesis]) -> None:
        """Take more hypotheses, with their inner products."""
        first = old = len(self.b)
        for h in new:
            self.places.append(slice(first, first + h.count))
            first += h.count
        self.library += new
        self.families.update(h.family for h in new)
        self.products.append([self._group(h) for h in new])
        self.b = np.concatenate([self.b, self.products.with_targets(self._white_rows, old)[:, 0]])
        self.fakes = np.concatenate([self.fakes, self.products.with_targets(self._fake_rows, old)])

    def forget(self, gone: Mask) -> list[int]:
        """Take hypotheses (m,) out of the library.

        Returns:
            The number of each among those that are left; -1: gone.
        """
        columns = self.products.forget(gone)
        self.b, self.fakes = self.b[columns], self.fakes[columns]
        self.families.subtract(h.family for h, out in zip(self.library, gone, strict=True) if out)
        self.library = [h for h, out in zip(self.library, gone, strict=True) if not out]
        ends = np.cumsum([h.count for h in self.library]).tolist()
        self.places = [slice(end - h.count, end) for h, end in zip(self.library, ends, strict=True)]
        return [int(number) for number in np.where(gone, -1, np.cumsum(~gone) - 1)]

    def rename(self, i: int, effect: Effect) -> None:
        """Let a hypothesis of the library be of another effect with the same columns."""
        h = self.library[i]
        self.library[i] = replace(h, effect=effect)
        self.families.subtract([h.family])
        self.families.update([self.library[i].family])

    def _group(self, h: Hypothesis) -> Group:
        """Return its whitened columns on the training rows."""
        own = {c: h.nonzero_columns(c) for c in h.raw.channels} if h.count else {}
        return Group(h.count, {c: (at, X[self._train]) for c, (at, X) in own.items() if len(at)})

    def retime(self) -> None:
        """Pass all columns through the present output stage; whiten a part of the library at a time."""
        library, self.library, self.places = self.library, [], []
        self.families.clear()
        self.products = InnerProducts(self.bench.width)
        self.b, self.fakes = np.empty(0), np.empty((0, self.fake.shape[2]))
        for start in range(0, len(library), BUDGET.at_once):
            old = library[start : start + BUDGET.at_once]
            new = [self.retimed(h) for h in old]
            self.append(new)
            for h in set(new) - set(old):
                h.release()

    def retimed(self, h: Hypothesis) -> Hypothesis:
        """Return a hypothesis with columns made again, unless it is momentary, part of the output stage, or at its optimum."""
        if (
            h.effect is None
            or h.theta is not None
            or h.effect.EPISODIC
            or (h.effect.DOWNSTREAM and not h.effect.BEHIND and not h.effect.BRIEF)
        ):
            return h
        return self.bench.hypothesis_of(h.effect, self.bench.raw(h.effect), h.trials, h.name)

    def retarget(self, y: Array) -> None:
        """Use another residual (M, C) for the same columns, less the nonlinear remainders."""
        self.white = self.bench.whitened(y)
        self.b = self.products.with_targets(self._white_rows, 0)[:, 0]

    @property
    def _white_rows(self) -> list[Array]:
        """Whitened residual on the training rows, (n, 1) of each channel."""
        return [self.white[self._train, c, None] for c in range(self.bench.width)]

    @contextmanager
    def against(self, y: Array) -> Iterator[None]:
        """Use another residual (M, C) while the context lasts."""
        bench, y_before, before = self.bench, self.bench.y, (self.white, self.b)
        bench.update_state(y=y)
        self.retarget(y)
        try:
            yield
        finally:
            grown = len(self.b) > len(before[1])
            bench.update_state(y=y_before)
            self.white, self.b = before
            if grown:
                self.retarget(bench.y)

    @contextmanager
    def trying(self, new: list[Hypothesis]) -> Iterator[None]:
        """Add hypotheses while the context lasts; whatever joins meanwhile leaves with them."""
        kept, families = (self.library, self.places, self.b, self.fakes), self.families.copy()
        self.library, self.places = list(kept[0]), list(kept[1])
        with self.products.fewer_again():
            try:
                self.append(new)
                yield
            finally:
                self.library, self.places, self.b, self.fakes = kept
                self.families = families

    @property
    def total(self) -> float:
        """Whitened sum of squares of the residual."""
        return float(np.sum(self.white[self._train] ** 2))

    def parts(self, chosen: Iterable[int]) -> list[Hypothesis]:
        """Return the constants and the chosen hypotheses, in the order of their parameters."""
        return [*self.library[: len(self.base)], *(self.library[i] for i in chosen)]

    def base_with(self, chosen: list[int]) -> Index:
        """Return the column numbers of the constants and the chosen hypotheses."""
        return self._columns_of([*range(len(self.base)), *chosen])

    def mask_of(self, at: Index, i: int) -> Mask:
        """Return which of the column numbers `at` (k,) belong to hypothesis i."""
        return np.asarray((at >= self.places[i].start) & (at < self.places[i].stop))

    def _columns_of(self, which: list[int]) -> Index:
        parts = [np.arange(self.places[i].start, self.places[i].stop) for i in which]
        return np.concatenate([np.empty(0, dtype=np.intp), *parts])

    def solve(self, chosen: list[int], *, freed: int | None = None) -> tuple[Array, Index, float]:
        """Return parameters, column numbers and whitened sum of squares; fixed parameters of hypothesis `freed` are fitted."""
        at = self.base_with(chosen)
        fixed = self._fixed(chosen)
        if freed is not None:
            fixed[self.mask_of(at, freed)] = np.nan
        G, b = self.products.between(at, at), self.b[at]
        theta = pinned_at(fixed, G, b)
        return theta, at, self.total - float(2.0 * theta @ b - theta @ G @ theta)

    def projected(self, chosen: list[int]) -> Projected:
        """Project out the model's fixed parameters."""
        at, values = self.base_with(chosen), self._fixed(chosen)
        fixed = ~np.isnan(values)
        value, own = values[fixed], at[fixed]
        off = value @ self.products.between(own, np.arange(len(self.products)))
        return Projected(at[~fixed], self.b - off, self.total - float(value @ (2.0 * self.b[own] - off[own])))

    def _fixed(self, chosen: list[int]) -> Array:
        return np.concatenate([np.empty(0), *(self.library[i].fixed for i in [*range(len(self.base)), *chosen])])

    def scores(
        self, chosen: list[int], which: list[int] | None = None, *, surrogates: bool = False
    ) -> tuple[dict[int, Score], Array]:
        """Return scores of hypotheses given the chosen ones, and the largest surprise of each surrogate, if wanted."""
        every = self.fakes if surrogates else self.fakes[:, :0]
        asked = list(range(len(self.base), len(self.library))) if which is None else which
        at, b, _ = self.projected(chosen)
        # Only columns of the hypotheses in question: most calls compare two, not all.
        own = self._columns_of(asked)
        starts = dict(zip(asked, np.cumsum([0, *(self.library[i].count for i in asked)]).tolist(), strict=False))
        GS, cross, K = self.products.between(at, at), self.products.between(at, own), len(own)
        P = solve_sym(GS, np.concatenate([cross, b[at][:, None], every[at]], axis=1))
        residual_b = b[own] - cross.T @ P[:, K]
        residual_f = every[own] - cross.T @ P[:, K + 1 :]
        out: dict[int, Score] = {}
        highest = np.zeros(every.shape[1])
        by_count: dict[int, list[int]] = {}
        for i in asked:
            if i not in chosen and self.library[i].count:
                by_count.setdefault(self.library[i].count, []).append(i)
        for count, group in by_count.items():
            rows = np.array([starts[i] for i in group])[:, None] + np.arange(count)
            G = self.products.within(np.array([self.places[i].start for i in group]))
            A = G - np.einsum("smk,sml->mkl", cross[:, rows], P[:, rows])
            squares = np.diagonal(G, axis1=1, axis2=2)
            gains, fakes, counts = quadratic(A, squares, residual_b[rows], residual_f[rows])
            free = gains.copy()
            for m, i in enumerate(group):
                pinned = self.library[i].pinned_gain(self.bench.scene, A[m], residual_b[rows[m]])
                gains[m] = gains[m] if pinned is None else pinned
            trials = np.array([self.library[i].log_trials(self._train) + np.log(self._forms(i)) for i in group])
            surprise = self._surprise(gains, counts) - trials
            # Proposals from the residual have no counterpart in the surrogates: their trials are penalised instead.
            mirrored = (counts > 0) & (np.array([self.library[i].trials for i in group]) == 1)
            if surrogates and mirrored.any():
                reached = self._surprise(fakes[mirrored], counts[mirrored, None]) - trials[mirrored, None]
                highest = np.maximum(highest, reached.max(axis=0))
            for m, i in enumerate(group):
                if counts[m]:
                    out[i] = self._score(
                        i, float(gains[m]), int(counts[m]), float(surprise[m]), beyond=float(free[m] - gains[m])
                    )
        # In the order of the library: of equals the first is taken.
        return {i: out[i] for i in asked if i in out}, highest

    def _score(self, i: int, gain: float, count: int, surprise: float, *, beyond: float) -> Score:
        h = self.library[i]
        penalty = h.effective_parameters(max(count - h.unobserved(self._train), 0)) * h.penalty(self.bench)
        # Proposals from the residual pay for their trials.
        places = 2.0 * h.log_trials(self._train) if h.trials > 1 else self._occam.get(self._key(i), 0.0)
        return Score(gain, count, surprise, float(gain - penalty - places), beyond)

    def in_full(self, i: int, score: Score) -> Score:
        """Return a score with the penalty of all parameters of a relaxed hypothesis; of another the same."""
        h = self.library[i]
        owed = h.effective_parameters(score.count, whole=True) - h.effective_parameters(score.count)
        return replace(score, rank=score.rank - owed * h.penalty(self.bench))

    def covariance(self, at: Index) -> Array:
        """Return the covariance of the parameters of the columns `at` for unit noise."""
        return solve_sym(self.products.between(at, at), np.eye(len(at)))

    def spread(self, at: Index) -> Array:
        """Return the standard deviations of the parameters of the columns `at` for unit noise."""
        return np.sqrt(np.maximum(np.diag(self.covariance(at)), 0.0))

    def misfit(self, chosen: list[int]) -> float:
        """Return the reduced chi square of a model's whitened residual, at least 1: above where physics is missing."""
        _, at, residual = self.solve(chosen)
        return max(1.0, residual / max(int(self._train.sum()) * self.bench.live_channels - len(at), 1))

    def _key(self, i: int) -> str:
        effect = self.library[i].effect
        return "" if effect is None else effect.KEY

    def _forms(self, i: int) -> int:
        """Return how many hypotheses differ from one by their searched values alone, eight at most: neighbours are alike."""
        family = self.library[i].family
        return 1 if family is None else min(self.families[family], 8)

    def _surprise(self, gain: Array, count: Index) -> Array:
        """Return minus log p; by F where the noise estimate has few degrees of freedom."""
        return -log_tail(gain, np.maximum(count, 1), self.bench.noise.degrees)


def _occam(library: list[Hypothesis]) -> dict[str, float]:
    """Return per kind twice the log of the number of its hypotheses, searched values apart.

    Kinds have equal prior odds, and so have the places and forms of one: the best of thirty must be better than the only one by
    as much as the number of trials makes it (MacKay 1992, Occam's factor).
    """
    families = {h.effect.family for h in library if h.effect is not None}
    return {key: 2.0 * float(np.log(n)) for key, n in Counter(family[0] for family in families).items()}


def threshold(highest: Array, chance: float) -> float:
    """Return the Gumbel quantile of the surrogates' maxima at false-alarm probability `chance`, unit scale or wider."""
    if not len(highest):
        return float(-np.log(chance))
    scale = max(1.0, float(np.std(highest)) * np.sqrt(6.0) / np.pi)
    place = float(np.mean(highest)) - 0.5772 * scale
    return float(place - scale * np.log(-np.log1p(-chance)))
