"""Search for the best timing: none, a delay, a lag of first or second order, or a delay of what lags."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.levenberg_marquardt import ConditionalGain
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.clocks import BETWEEN, Filter, Shift, Timing
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.parameters import log_grid, spacing
from galen_hw.spatial import Array

CONSTANTS = 6
"""Lags between half a sample and all of what is late that are tried with the delay that suits each."""
DAMPINGS = (0.35, 0.7)
"""From which a second order is sought: of a servo that rings, and of the usual filter."""
FINE = 0.02
"""Share of what is late to which a clock is sought."""
FINEST = 2e-4
"""The same of a constant and a damping, which are not optimised again."""
STRIDE = 0.2
"""The same, of the first steps from there to the optimum."""
SHORTEST = 1.05
"""Times the shortest constant that differs from a delay, up to which a lag with a delay counts as none."""
LN2 = float(np.log(2.0))
"""Constants and bands are sought within a factor of two."""
NEAR = 10.0
"""Log likelihood by which the last steps to an optimum may still matter, at most, once a step is no more than `FINE`."""

Clocks = list[tuple[Timing, float]]
"""With their delay or constant, s."""


@dataclass
class ClockSearch:
    """Search for the best of nothing, a delay, a lag, and a delay of what lags, where `delay` acts, given other effects.

    `friction`: of servos, with the lag's constant and delay; `replacements`: the same at the best timing. `swings`: a lag of
    second order is in the model already. `speed_limit`: of the lag in the model, which the search keeps.
    """

    bench: Bench
    given: ConditionalGain
    delay: Shift
    friction: tuple[Effect, ...]
    swings: bool
    speed_limit: float | None = None

    def __post_init__(self) -> None:
        self.places = self.delay.places(self.bench.stream)
        self.simulated = self.bench.stream.simulated[:, self.places]
        self.averaged = self.bench.simulated[:, self.places]
        self.lagged: dict[object, Array] = {}
        self.replacements: dict[Effect, Effect] = {}
        self.penalty = float(np.log(self.bench.noise.effective))
        self.shortest = 0.5 * spacing(self.bench.scene)

    def best_interpolation(self) -> Clocks:
        """Return the best timing effects over the possible interpolations `BETWEEN` two rows.

        Machines are smooth; a logger that fills in rows draws straight lines; a filter of samples takes each for the time before
        it.
        """
        clocks, search = self.best(), self
        if not clocks or self.friction or self.bench.stream.commanded:
            return clocks
        for between in BETWEEN:
            if between != self.delay.between and self._differs(clocks, between) >= CRITERIA.log_odds:
                other = replace(self, delay=self.delay.interpolated(between))
                if other.penalised_gain(found := other.best()) > search.penalised_gain(clocks):
                    clocks, search = found, other
        return clocks

    def _differs(self, clocks: Clocks, between: str) -> float:
        """Return the whitened sum of squares by which another interpolation changes equally late timing effects."""
        late, constant, damping = _read(clocks)
        sooner = self.shortest if between == "steps" and constant > 0.0 else 0.0
        other = replace(self, delay=self.delay.interpolated(between))
        change = other.arriving(late + sooner, constant, 1.0, (), damping) - self.arriving(
            late, constant, 1.0, (), damping
        )
        white = self.bench.hypothesis_of(None, Columns(self.places, change[:, :, None])).white.values
        return float(np.sum(white[self.bench.train] ** 2))

    def best(self) -> Clocks:
        """Return the best timing effects for the interpolation of its `delay`."""
        step = spacing(self.bench.scene)
        reach = max(4.0 * step, 4.0 * abs(self._by_slope()))
        most, all_late = self._latest(0.0, (-reach, reach))
        candidates: list[tuple[float, Clocks]] = [
            (self._gain(0.0, 0.0), []),
            (most - self.penalty, [(self.delay, all_late)]),
        ]
        for constant in log_grid(self.shortest, 2.0 * all_late, CONSTANTS):
            lag = self._lag(constant)
            candidates.append((self._gain(0.0, constant) - self.penalty, [(lag, constant)]))
            most, late = self._latest(constant, (0.0, all_late))
            candidates.append((most - 2.0 * self.penalty - CRITERIA.log_odds, [(self.delay, late), (lag, constant)]))
        clocks = self._plainer(self._refined(max(candidates, key=lambda one: one[0])[1], all_late), all_late)
        # A response of second order looks like a delay, or a delay and a lag; friction of a servo has a lag of first order. In
        # one joint by itself two more parameters would explain what the other joints show to be something else.
        limited = self.speed_limit is not None
        if limited or self.friction or self.delay.joint or all_late <= 0.0 or not (self.swings or clocks):
            return clocks
        required = self.penalised_gain(clocks) + (0.0 if self.swings else CRITERIA.log_odds)
        swinging = self._swinging(all_late, required)
        return swinging if self.penalised_gain(swinging) > required else clocks

    def _plainer(self, clocks: Clocks, all_late: float) -> Clocks:
        """Return a lag alone for a delay of what lags, where it explains as much: on a grid it is not at its optimum."""
        if len(clocks) < 2 or self.friction:
            return clocks
        (_, late), (_, constant) = clocks
        lag = self._lag(constant + late)
        alone = self._refined([(lag, constant + late)], all_late)
        return alone if self.penalised_gain(alone) + CRITERIA.log_odds >= self.penalised_gain(clocks) else clocks

    def penalised_gain(self, clocks: Clocks) -> float:
        """Return the gain less the penalty of delay, lag or second-order response."""
        late, constant, damping = _read(clocks)
        return self._gain(late, constant, damping=damping) - self.penalty * parameter_count([end for end, _ in clocks])

    def _refined(self, clocks: Clocks, all_late: float) -> Clocks:
        """Return the same timing effects with lag, delay and bands of friction at their common optimum."""
        if not clocks or clocks[-1][0].SHIFT:
            return clocks
        delays, constant = clocks[:-1], clocks[-1][1]
        begun = np.array([0.0, *(late / all_late for _, late in delays), *(bool(self.friction) * [0.0])])
        limits = [(np.log(min(self.shortest / constant, 1.0)), LN2), *(len(delays) * [(0.0, 1.0)]), (-LN2, LN2)]

        def read(at: Array) -> tuple[float, float, float]:
            late = all_late * float(at[1]) if delays else 0.0
            return late, constant * float(np.exp(at[0])), float(np.exp(at[-1])) if self.friction else 1.0

        def missed(friction: tuple[Effect, ...], at: Array) -> float:
            return -self._gain(*read(at), friction)

        best, least = (0.0, constant, 1.0), np.inf
        for friction in dict.fromkeys((self.friction, tuple(one.stripped for one in self.friction))):
            at, cost = _lowest(partial(missed, friction), begun, limits[: len(begun)])
            if FINE**2 * -cost > NEAR:
                at, cost = _lowest(partial(missed, friction), at, limits[: len(begun)], FINEST, FINE)
            cost += self.penalty * sum(len(one.searched()) for one in friction)
            if cost < least:
                best, least = read(at), cost
                self.replacements = dict(
                    zip(self.friction, (_with_lag(one, *best[1:]) for one in friction), strict=True)
                )
        late, constant, _ = best
        if delays and not self.friction and constant <= SHORTEST * self.shortest:
            # The shortest lag is a part of the delay.
            return [(self.delay, self._latest(0.0, (0.0, 2.0 * all_late))[1])] if all_late > 0.0 else clocks[:-1]
        return [*((end, late) for end, _ in delays), (self._lag(constant), constant)]

    def _lag(self, constant: float) -> Filter:
        """Return the lag of this constant, s, no faster than that in the model."""
        return self.delay.lagging(constant, self.shortest, speed_limit=self.speed_limit)

    def _swinging(self, all_late: float, required: float) -> Clocks:
        """Return the best lag of second order; damping and constant are correlated, and optimised together.

        Only roughly where it stays far from the required gain.
        """
        bound = self.delay.lagging(all_late, self.shortest).SEARCHED["damping"]
        starts = [np.log([0.5 * all_late / damping, damping]) for damping in DAMPINGS]

        def cost(at: Array) -> float:
            constant, damping = np.exp(at).tolist()
            return -self._gain(0.0, constant, damping=damping)

        begun = min(starts, key=cost)
        limits = [
            (np.log(self.shortest), np.log(max(8.0 * all_late, 2.0 * self.shortest))),
            (np.log(bound.low), np.log(bound.high)),
        ]
        at, least = _lowest(cost, np.clip(begun, *np.transpose(limits)), limits)
        if -least - 2.0 * self.penalty > required - NEAR:
            at, _ = _lowest(cost, at, limits, FINEST, FINE)
        constant, damping = np.exp(at).tolist()
        return [(self.delay.lagging(constant, self.shortest, damping), constant)]

    def _latest(self, constant: float, bounds: tuple[float, float]) -> tuple[float, float]:
        """Return the largest gain of a delay of what lags with this constant (s), and that delay, s."""
        options = {"xatol": FINE * (bounds[1] - bounds[0])}
        found = minimize_scalar(
            lambda late: -self._gain(late, constant), bounds=bounds, method="bounded", options=options
        )
        return -float(found.fun), float(found.x)

    def _gain(
        self,
        late: float,
        constant: float,
        band_factor: float = 1.0,
        friction: tuple[Effect, ...] | None = None,
        damping: float | None = None,
    ) -> float:
        """Return the gain with a delay and a lag, s, and bands of friction scaled by a factor."""
        y = (
            self.arriving(late, constant, band_factor, self.friction if friction is None else friction, damping)
            - self.averaged
        )
        return self.given.fixed_gain(self.bench.hypothesis_of(None, Columns(self.places, y[:, :, None])))

    def arriving(
        self, late: float, constant: float, band_factor: float, friction: tuple[Effect, ...], damping: float | None
    ) -> Array:
        """Return averages (M, m) of the simulated channels through a delay, a lag and friction."""
        return self.bench.late(self._lagged(constant, band_factor, friction, damping), late, bowed=self.delay.bowed)

    def _lagged(
        self, constant: float, band_factor: float, friction: tuple[Effect, ...], damping: float | None
    ) -> Array:
        """Return the simulated channels (N, m) through servos with this constant (s), cached for other delays."""
        x, stream = self.simulated, self.bench.stream
        if damping is not None:
            return self.delay.lagging(constant, self.shortest, damping).followed(stream, x)
        key = (constant, band_factor, friction)
        if key not in self.lagged:
            y = self._lag(constant).followed(stream, x) if constant > 0.0 else x
            for one in friction:
                stands = _with_lag(one, constant, band_factor).columns(self.bench.scene)
                y = y + Columns(stands.channels, stands.values[:, :, :1]).full(self.bench.width)[:, self.places, 0]
            self.lagged[key] = y
        return self.lagged[key]

    def _by_slope(self) -> float:
        """Return the small delay, s, with the largest gain by its slope at zero."""
        made = self.bench.hypothesis_of(None, self.bench.averaged(self.delay.columns(self.bench.stream)))
        A, r = self.given.products(made)
        return float(r[0] / A[0, 0]) if A[0, 0] > 0.0 else 0.0


def _read(clocks: Clocks) -> tuple[float, float, float | None]:
    """Return delay and constant, s, and damping of a delay, a lag or both; 0 and None for what is not there."""
    late = sum(size for end, size in clocks if end.SHIFT)
    slow = next((end.searched() for end, _ in clocks if not end.SHIFT), None)
    return (late, 0.0, None) if slow is None else (late, slow["constant"], slow.get("damping"))


def _lowest(
    cost: Callable[[Array], float],
    begun: Array,
    limits: list[tuple[float, float]],
    fine: float = FINE,
    stride: float = STRIDE,
) -> tuple[Array, float]:
    """Minimise a cost of a few values by Nelder-Mead, for a servo that sticks has corners; return values and cost."""
    simplex = begun + np.vstack([np.zeros_like(begun), stride * np.eye(len(begun))])
    options = {"xatol": fine, "fatol": 1.0, "initial_simplex": simplex}
    found = minimize(cost, begun, method="Nelder-Mead", bounds=limits, options=options)
    return found.x, float(found.fun)


def _with_lag(effect: Effect, constant: float, band_factor: float) -> Effect:
    """Return friction of a servo with this constant (s; 0: its own), in a band scaled by a factor."""
    response = {"response": constant} if constant > 0.0 else {}
    return effect.with_searched({"coulomb": band_factor * effect.searched()["coulomb"]} | response)


def parameter_count(effects: Sequence[Effect]) -> int:
    """Return the number of delays, constants and dampings."""
    return sum(max(len(effect.searched()), 1) for effect in effects)
