"""Finding what an arm's give consists of: effects are added and taken away by what they do on held-out sets."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from galen_hw.identification.deflection.bent import BentScene
from galen_hw.identification.deflection.blocks import Blocks, Rows, noise_of
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic_terms import (
    TRANSITIONS,
    WIDTHS,
    Columns,
    Term,
    Weight,
    amplitude,
    elastic_candidates,
    hysteresis_columns,
    knees,
    scenes,
    settled_candidates,
    zoomed,
)
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.scenes.elastic_arm import Slip
from galen_hw.spatial import Array

DELAY: Final = "delay"
STANDARD_ERRORS: Final = 1.5
LEAST_GAIN: Final = 0.004
"""Smallest fall of the held-out square, in squares of the tracker's noise, that is worth a term."""
ROUNDS: Final = 3
ZOOMS: Final = (1.6, 1.2, 1.06)


@dataclass(frozen=True)
class Decision:
    """Why a term is in or out: fall of the held-out square in noise units, its standard error."""

    kind: str
    port: str
    kept: bool
    gain: float
    error: float


@dataclass
class Search:
    """One search over the sets.

    Args:
        sets: to learn from; every configuration is held out in turn.
    """

    sets: Sequence[DeflectionSet]
    noise: Array = field(init=False)
    weight: Weight = field(init=False)
    terms: list[Term] = field(default_factory=list)
    values: dict[Term, float] = field(default_factory=dict)
    slips: dict[str, list[Slip]] = field(default_factory=dict)
    decisions: dict[tuple[str, str], Decision] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.noise, self.weight = noise_of(self.sets), Weight.of(self.sets[0])
        self._folds = _folds(self.sets)
        self._bare: list[BentScene] = []
        self._settled: list[BentScene] = []
        self._columns: Columns = {}
        self._rows: list[Rows] = []

    def run(self) -> Blocks:
        """Search; the sums for the terms found."""
        self._elastic()
        for round_number in range(ROUNDS):
            before = {(t.kind, t.port) for t in self.terms}
            self._grow()
            if {(t.kind, t.port) for t in self.terms} == before and round_number:
                break
            self._zoom()
            self._prune()
            if {(t.kind, t.port) for t in self.terms} == before:
                break
        return self._final()

    # -- stages -------------------------------------------------------------------------------------------------------

    def _elastic(self) -> None:
        """Compliances, on the rigid arm first and then on the bent one."""
        for _ in range(2):
            self._view()
            found = list(elastic_candidates(self._bare))
            blocks = self._blocks(found, delay=False)
            self.terms = []
            self._forward(blocks, found, [])
            self._take(blocks, self.terms)

    def _grow(self) -> None:
        """Memory, hardening and play, the best first; friction changes the load that the others see."""
        for _ in range(ROUNDS):
            self._view()
            ports = list(dict.fromkeys([t.port for t in self.terms if t.kind == "compliance"] + self._turning()))
            slipping = [t for p in ports for t in self._slipping(p)]
            others = list(settled_candidates(self._bare, ports))
            compliances = list(elastic_candidates(self._bare))
            blocks = self._blocks([*self.terms, *compliances, *slipping, *others])
            frictions = [t for t in self.terms if t.kind == "hysteresis"]
            self._forward(blocks, [*compliances, *slipping, *others], [DELAY])
            self._take(blocks, self.terms)
            if len([t for t in self.terms if t.kind == "hysteresis"]) == len(frictions):
                return

    def _zoom(self) -> None:
        """Searched values, finer and finer, each for itself; a single hardening of a port may level off."""
        for factor in ZOOMS:
            self._view()
            size = {t.port: amplitude(self._bare, t.port) for t in self.terms}
            nearby = {term: zoomed(term, factor, TRANSITIONS[-1] * size[term.port]) for term in self.terms}
            curved = [t for t in self.terms if t.kind == "hardening"]
            for term in curved if factor == ZOOMS[0] else []:
                if sum(t.port == term.port for t in curved) == 1:
                    nearby[term] += knees(term.port, size[term.port])
            blocks = self._blocks([*self.terms, *(t for near in nearby.values() for t in near)])
            for term, near in nearby.items():
                place = self.terms.index(term)

                def loss(candidate: Term, place: int = place, blocks: Blocks = blocks) -> float:
                    keys: list[Hashable] = [*self.terms[:place], candidate, *self.terms[place + 1 :], DELAY]
                    return float(np.average(blocks.held_out(keys), weights=blocks.rows))

                self.terms[place] = min([term, *near], key=loss)
            self._take(blocks, self.terms)

    def _prune(self) -> None:
        """Terms whose loss the held-out sets do not mind."""
        self._view()
        blocks = self._blocks(self.terms)
        while len(self.terms) > 1:
            full = blocks.held_out([*self.terms, DELAY])
            falls = {
                t: blocks.gain(blocks.held_out([*(u for u in self.terms if u != t), DELAY]), full) for t in self.terms
            }
            for t, (gain, error) in falls.items():
                self.decisions[t.kind, t.port] = Decision(t.kind, t.port, _wanted(gain, error), gain, error)
            weak = [t for t in self.terms if not _wanted(*falls[t])]
            if not weak:
                break
            self.terms.remove(min(weak, key=lambda t: falls[t][0]))
        self._take(blocks, self.terms)

    def _final(self) -> Blocks:
        self._view()
        return self._blocks(self.terms)

    # -- parts --------------------------------------------------------------------------------------------------------

    def _forward(self, blocks: Blocks, candidates: Sequence[Term], always: list[Hashable]) -> None:
        """Add the candidate that the held-out sets want most, again and again."""
        now = blocks.held_out([*self.terms, *always]) if self.terms or always else blocks.yy / blocks.rows
        while True:
            taken = {t.place for t in self.terms}
            best: tuple[float, float, Term, Array] | None = None
            for t in candidates:
                if t.place in taken:
                    continue
                loss = blocks.held_out([*self.terms, t, *always])
                gain, error = blocks.gain(now, loss)
                known = self.decisions.get((t.kind, t.port))
                if known is None or gain > known.gain:
                    self.decisions[t.kind, t.port] = Decision(t.kind, t.port, kept=False, gain=gain, error=error)
                if _wanted(gain, error) and (best is None or gain > best[0]):
                    best = (gain, error, t, loss)
            if best is None:
                return
            self.terms.append(best[2])
            now = best[3]

    def _view(self) -> None:
        """Scenes of the arm as it is known so far."""
        self._columns = {}
        views = scenes(self.sets, self.weight, self.values, self.slips, self._bare)
        self._bare, self._settled = [bare for bare, _ in views], [settled for _, settled in views]
        pairs = zip(self.sets, self._bare, strict=True)
        self._rows = self._rows or [Rows.of(s, b.tip, self.noise) for s, b in pairs]

    def _slipping(self, port: str) -> list[Term]:
        size = amplitude(self._bare, port)
        if size == 0.0:
            return []
        found = hysteresis_columns(self._bare, port, [size * w for w in WIDTHS])
        for term, columns in found.items():
            self._columns[term] = [r.free(c / self.noise) for r, c in zip(self._rows, columns, strict=True)]
        return list(found)

    def _turning(self) -> list[str]:
        """Ports that turn."""
        view = self._bare[0]
        return [p for p in view.joint_names if np.any(view.screw(p)[0, 3:])]

    def _blocks(self, terms: Sequence[Term], *, delay: bool = True) -> Blocks:
        """Sums for some terms, and for a delay of the tracker by what is found so far."""
        columns: Columns = {}
        for t in dict.fromkeys(terms):
            if t not in self._columns:
                pairs = zip(self._rows, self._bare, self._settled, strict=True)
                self._columns[t] = [r.free(t.column(b, s) / self.noise) for r, b, s in pairs]
            columns[t] = self._columns[t]
        if delay:
            columns[DELAY] = [
                r.free(np.gradient(self._known(b, z), s.time, axis=0) / self.noise)
                for r, b, z, s in zip(self._rows, self._bare, self._settled, self.sets, strict=True)
            ]
        return Blocks.of(self._rows, columns, self._folds)

    def _known(self, bare: BentScene, settled: BentScene) -> Array:
        """(N, d) give by what is found so far: friction late against the load must not pass for a late tracker."""
        columns = [value * term.column(bare, settled) for term, value in self.values.items()]
        return np.asarray(sum(columns, np.zeros((len(bare), len(bare.channels)))))

    def _take(self, blocks: Blocks, terms: Sequence[Term]) -> None:
        """What is found bends the arm; friction's share is its weight over the compliance."""
        if not terms:
            self.values, self.slips = {}, {}
            return
        keys: list[Hashable] = [*terms, *([DELAY] if DELAY in blocks.keys else [])]
        theta = dict(zip(keys, blocks.solve(keys), strict=True))
        self.values = {t: float(theta[t]) for t in terms}
        springs = {t.port: float(theta[t]) for t in terms if t.kind == "compliance"}
        self.slips = {}
        for t in terms:
            if t.kind == "hysteresis" and isinstance(t.effect, Hysteresis):
                share = float(theta[t]) / springs[t.port] if springs.get(t.port) else 0.0
                self.slips[t.port] = [(t.effect.widths[0], float(np.clip(share, 0.0, 1.0)))]


def _wanted(gain: float, error: float) -> bool:
    return gain > LEAST_GAIN and gain > STANDARD_ERRORS * error


def _folds(sets: Sequence[DeflectionSet]) -> list[int]:
    """Sets of one configuration are held out together; where there are fewer than three, each set by itself."""
    labels = [s.configuration for s in sets]
    if len(set(labels)) < 3:
        return list(range(len(sets)))
    order = list(dict.fromkeys(labels))
    return [order.index(label) for label in labels]
