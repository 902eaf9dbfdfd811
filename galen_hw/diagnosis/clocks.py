"""Clocks all at once: a delay and a lag together, of the whole stream or of each joint by itself.

The search takes one hypothesis after the other. Of a dead time with a first-order lag behind it, the ordinary response of a
servo on a bus, it takes one that is as late as both; beside that the other is worth nothing by its slope, and what is wrong
about the shape goes to whatever bends. Where joints answer one by one, each with clocks of its own, no single exchange helps.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from galen_hw.diagnosis.bench import Bench, Hypothesis
from galen_hw.diagnosis.bends import tangent
from galen_hw.diagnosis.descent import Beside
from galen_hw.diagnosis.linear import crossed, errors
from galen_hw.diagnosis.nonlinear import settle
from galen_hw.diagnosis.plainness import ALIKE
from galen_hw.diagnosis.retiming import settle_together
from galen_hw.diagnosis.score import Scorer
from galen_hw.diagnosis.selection import Selection
from galen_hw.diagnosis.worth import taken
from galen_hw.physics.effect import Columns, Effect, log_grid, spacing
from galen_hw.physics.joint_effects import Friction
from galen_hw.physics.time_effects import Lag, TimeDelay, Timing
from galen_hw.spatial import Array

MARGIN = 6.0
"""Beyond the price of the parameters, in units of the log likelihood ratio."""
RICHER = 0.05
"""Share of the excess that is left in some channel, on blocks left out, that the clocks must take."""
COMPLETE = 0.9
"""The same that each joint's own clocks must take before anything else is known."""
CONSTANTS = 6
"""Lags between half a sample and all of what is late that are tried with the delay that suits each."""
DAMPINGS = (0.35, 0.7)
"""From which a second order is sought: of a servo that rings, and of the usual filter."""
FINE = 0.02
"""Share of what is late to which a clock is sought."""
FINEST = 2e-4
"""The same of a constant and a damping, which then stand as they were found."""
STRIDE = 0.2
"""The same, of the first steps from there to the optimum."""
SHORTEST = 1.05
"""Times the shortest constant that can be told from a delay, up to which a lag beside a delay is none."""
LN2 = float(np.log(2.0))
"""Constants and bands are sought up to twice and down to half of where they stood."""
NEAR = 10.0
"""Log likelihood by which the last steps to an optimum may still matter, at most, once a step is no more than `FINE`."""
OFTEN = 2
"""Times that one model is asked for its clocks: its other values may have moved since."""

Clocks = list[tuple[TimeDelay | Lag, float]]
"""With their delay or constant, s."""


def reclocked(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether the delays and lags of a model were exchanged for better ones: of the whole stream, or of each joint."""
    # Not for ever: what the search takes back of an exchange, it would take back again.
    model = frozenset(scorer.library[i].family for i in out.chosen)
    again = _ends(scorer, out.chosen) and out.clocked[model] < OFTEN
    proposed = list(TimeDelay.propose(bench.scene)) if again else []
    out.clocked[model] += 1
    if not proposed:
        return False
    groups = [e for e in proposed if not e.joint], [e for e in proposed if e.joint]
    for clocks, instead in _sought(bench, scorer, out.chosen, groups):
        if clocks and _exchanged(bench, scorer, out, clocks, instead):
            return True
    return False


def own_clocks(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether the first clock gave way to those of each joint, which take nearly all that the best of one clock for all leaves.

    Before anything else is chosen: of servos that answer each in its own time it would take the rest of their lateness.
    """
    proposed = list(TimeDelay.propose(bench.scene))
    ends = [e for e in proposed if e.joint]
    if not ends or len(out.chosen) != 1 or not _ends(scorer, out.chosen):
        return False
    # By its slope alone the one clock leaves what its own optimum does not.
    settle_together(bench, scorer, out.chosen)
    (one, _), (each, _) = _sought(bench, scorer, out.chosen, ([e for e in proposed if not e.joint], ends))
    # A response of second order is larger or smaller than what it follows: it would take a scale that is off for its own.
    swings = any(isinstance(end, Lag) and end.damping is not None for end, _ in one)
    exchanged = bool(one) and _exchanged(bench, scorer, out, one, {}, nearly=1 if swings else 0)
    if len({end.joint for end, _ in each}) < 2 or not _exchanged(bench, scorer, out, each, {}, nearly=2):
        return exchanged
    # What friction does is little beside all of the lateness, and much beside what the right clocks leave of it.
    out.begun = errors(bench, scorer, out.chosen) ** 2
    return True


def _ends(scorer: Scorer, chosen: list[int]) -> list[int]:
    """The delays and lags among the chosen."""
    return [i for i in chosen if isinstance(scorer.library[i].effect, Timing)]


def _sought(
    bench: Bench, scorer: Scorer, chosen: list[int], groups: Sequence[list[TimeDelay]]
) -> Iterator[tuple[Clocks, dict[Effect, Effect]]]:
    """For each group of ends the best clocks where these act, instead of the chosen ones, once it is asked for.

    And what stands instead of friction within them.
    """
    old = _ends(scorer, chosen)
    # Friction of a servo has the servo's lag in it: it goes where that goes.
    within = [e for i in chosen if (e := scorer.library[i].effect) is not None and "lag" in e.contains]
    others = [i for i in chosen if i not in old and scorer.library[i].effect not in within]
    swings = any("damping" in e.searched() for i in old if (e := scorer.library[i].effect) is not None)
    none = bench.y + sum((b for i in old if (b := scorer.library[i].bend) is not None), np.zeros_like(bench.y))
    with scorer.against(none):
        beside = Beside(bench, scorer, others)
    for ends in groups:
        mine = [tuple(one for one in within if e.joint in ("", *one.joints)) for e in ends]
        searches = [_Search(bench, beside, e, some, swings) for e, some in zip(ends, mine, strict=True)]
        clocks = [clock for search in searches for clock in search.best()]
        yield clocks, {one: other for search in searches for one, other in search.instead.items()}


def one_clock(bench: Bench, scorer: Scorer, out: Selection) -> bool:
    """Whether a delay or lag of the whole stream was taken for what had been a viscous part of the friction in several joints.

    A servo with a viscous part c follows by c later. The search finds friction joint by joint, each with the lateness of all.
    """
    late = [i for i in out.chosen if _without_viscous(scorer.library[i].effect) is not None]
    proposed = [e for e in (*TimeDelay.propose(bench.scene), *Lag.propose(bench.scene)) if not e.joint]
    if len(late) < 2 or not proposed or any(isinstance(scorer.library[i].effect, Timing) for i in out.chosen):
        return False
    dry = [(_without_viscous(h.effect), h.looked) for h in (scorer.library[i] for i in late)]
    plain = [bench.add(effect, looked) for effect, looked in dry if effect is not None]
    first = len(scorer.library)
    scorer.append([*plain, *(bench.add(end) for end in proposed)])
    kept = [*(i for i in out.chosen if i not in late), *range(first, first + len(plain))]
    trials = [[*kept, first + len(plain) + k] for k in range(len(proposed))]
    best = min(trials, key=lambda trial: scorer.solve(trial)[2])
    saved = (len(late) - 1) * float(np.log(bench.noise.effective))
    if scorer.solve(best)[2] - scorer.solve(out.chosen)[2] >= saved:
        return False
    before, after = crossed(bench, scorer, out.chosen), crossed(bench, scorer, best)
    if float(np.mean(after / before)) > 1.0 + ALIKE:
        return False
    out.chosen = best
    return True


def _without_viscous(effect: Effect | None) -> Friction | None:
    """Friction of a servo without its viscous part; None where there is none."""
    if isinstance(effect, Friction) and effect.form.endswith("servo_viscous"):
        return replace(effect, form=effect.form.removesuffix("_viscous"))
    return None


@dataclass
class _Search:
    """For the best of nothing, a delay, a lag, and a delay of what lags, where `delay` acts, beside other effects.

    With friction `within` the lag: of servos that have the lag's constant, and are as late; beside the best of clocks these
    stand `instead` of them. `swings`: a lag of second order is in the model already.
    """

    bench: Bench
    beside: Beside
    delay: TimeDelay
    within: tuple[Effect, ...]
    swings: bool

    def __post_init__(self) -> None:
        self.places = self.delay.places(self.bench.stream)
        self.simulated = self.bench.stream.simulated[:, self.places]
        self.averaged = self.bench.simulated[:, self.places]
        self.behind: dict[object, Array] = {}
        self.instead: dict[Effect, Effect] = {}
        self.price = float(np.log(self.bench.noise.effective))

    def best(self) -> Clocks:
        """The clocks that are there."""
        step = spacing(self.bench.scene)
        reach = max(4.0 * step, 4.0 * abs(self._by_slope()))
        most, all_late = self._latest(0.0, (-reach, reach))
        ways: list[tuple[float, Clocks]] = [
            (self._gain(0.0, 0.0), []),
            (most - self.price, [(self.delay, all_late)]),
        ]
        shortest = 0.5 * step
        for constant in log_grid(shortest, 2.0 * all_late, CONSTANTS):
            lag = Lag(constant, self.delay.joint, shortest, whole=True)
            ways.append((self._gain(0.0, constant) - self.price, [(lag, constant)]))
            most, late = self._latest(constant, (0.0, all_late))
            ways.append((most - 2.0 * self.price - MARGIN, [(self.delay, late), (lag, constant)]))
        clocks = self._plainer(self._refined(max(ways, key=lambda way: way[0])[1], all_late), all_late)
        # A response of second order looks like a delay, or a delay and a lag; friction within has a lag of the first. In one
        # joint by itself two more numbers would take what the others show to be something else.
        if self.within or self.delay.joint or all_late <= 0.0 or not (self.swings or clocks):
            return clocks
        wanted = self._worth(clocks) + (0.0 if self.swings else MARGIN)
        swinging = self._swinging(shortest, all_late, wanted)
        return swinging if self._worth(swinging) > wanted else clocks

    def _plainer(self, clocks: Clocks, all_late: float) -> Clocks:
        """A lag alone for a delay of what lags, where it does as well: on a grid it stands beside its optimum, and is late."""
        if len(clocks) < 2 or self.within:
            return clocks
        (_, late), (lag, constant) = clocks
        assert isinstance(lag, Lag), "a delay of what lags"
        alone = self._refined([(replace(lag, constant=constant + late), constant + late)], all_late)
        return alone if self._worth(alone) + MARGIN >= self._worth(clocks) else clocks

    def _worth(self, clocks: Clocks) -> float:
        """Gain less the price of delay, lag or swing alone."""
        late = sum(size for end, size in clocks if isinstance(end, TimeDelay))
        lag = next((end for end, _ in clocks if isinstance(end, Lag)), None)
        gain = self._gain(late, 0.0 if lag is None else lag.constant, damping=None if lag is None else lag.damping)
        return gain - self.price * _numbers([end for end, _ in clocks])

    def _refined(self, clocks: Clocks, all_late: float) -> Clocks:
        """The same with a lag, the delay with it, and the bands of friction within it at their common optimum."""
        lag, constant = clocks[-1] if clocks else (None, 0.0)
        if not isinstance(lag, Lag):
            return clocks
        delays = clocks[:-1]
        begun = np.array([0.0, *(late / all_late for _, late in delays), *(bool(self.within) * [0.0])])
        limits = [(np.log(min(lag.shortest / constant, 1.0)), LN2), *(len(delays) * [(0.0, 1.0)]), (-LN2, LN2)]

        def read(at: Array) -> tuple[float, float, float]:
            late = all_late * float(at[1]) if delays else 0.0
            return late, constant * float(np.exp(at[0])), float(np.exp(at[-1])) if self.within else 1.0

        def missed(within: tuple[Effect, ...], at: Array) -> float:
            return -self._gain(*read(at), within)

        best, least = (0.0, constant, 1.0), np.inf
        for within in dict.fromkeys((self.within, tuple(one.stripped for one in self.within))):
            at, cost = _lowest(partial(missed, within), begun, limits[: len(begun)])
            if FINE**2 * -cost > NEAR:
                at, cost = _lowest(partial(missed, within), at, limits[: len(begun)], FINEST, FINE)
            cost += self.price * sum(len(one.searched()) for one in within)
            if cost < least:
                best, least = read(at), cost
                self.instead = dict(zip(self.within, (_with_lag(one, *best[1:]) for one in within), strict=True))
        late, constant, _ = best
        if delays and not self.within and constant <= SHORTEST * lag.shortest:
            # At its shortest it is none, but a part of the delay.
            return [(self.delay, self._latest(0.0, (0.0, 2.0 * all_late))[1])] if all_late > 0.0 else clocks[:-1]
        return [*((end, late) for end, _ in delays), (replace(lag, constant=constant), constant)]

    def _swinging(self, shortest: float, all_late: float, wanted: float) -> Clocks:
        """The best lag of second order: damping and constant make up for each other, and are sought together.

        Roughly, where it stays far from being worth what is wanted.
        """
        bound = Lag.SEARCHED["damping"]
        starts = [np.log([0.5 * all_late / damping, damping]) for damping in DAMPINGS]

        def cost(at: Array) -> float:
            constant, damping = np.exp(at).tolist()
            return -self._gain(0.0, constant, damping=damping)

        begun = min(starts, key=cost)
        limits = [
            (np.log(shortest), np.log(max(8.0 * all_late, 2.0 * shortest))),
            (np.log(bound.low), np.log(bound.high)),
        ]
        at, least = _lowest(cost, np.clip(begun, *np.transpose(limits)), limits)
        if -least - 2.0 * self.price > wanted - NEAR:
            at, _ = _lowest(cost, at, limits, FINEST, FINE)
        constant, damping = np.exp(at).tolist()
        return [(Lag(constant, self.delay.joint, shortest, whole=True, damping=damping), constant)]

    def _latest(self, constant: float, bounds: tuple[float, float]) -> tuple[float, float]:
        """The most that a delay of what lags with this constant (s) takes, and the delay, s."""
        options = {"xatol": FINE * (bounds[1] - bounds[0])}
        found = minimize_scalar(
            lambda late: -self._gain(late, constant), bounds=bounds, method="bounded", options=options
        )
        return -float(found.fun), float(found.x)

    def _gain(
        self,
        late: float,
        constant: float,
        wide: float = 1.0,
        within: tuple[Effect, ...] | None = None,
        damping: float | None = None,
    ) -> float:
        """Fall of the whitened sum of squares with a delay and a lag, s, and bands of friction so many times as wide."""
        lagged = self._lagged(constant, wide, self.within if within is None else within, damping)
        y = self.bench.late(lagged, late) - self.averaged
        return self.beside.whole(self.bench.made(None, Columns(self.places, y[:, :, None])))

    def _lagged(self, constant: float, wide: float, within: tuple[Effect, ...], damping: float | None) -> Array:
        """(N, m) what servos with this constant (s) make of the simulated; kept, for it comes again with other delays."""
        x, stream = self.simulated, self.bench.stream
        if damping is not None:
            return stream.second_order("lag", x, constant, damping, held=stream.commanded)
        key = (constant, wide, within)
        if key not in self.behind:
            y = stream.lag("lag", x, constant, held=stream.commanded) if constant > 0.0 else x
            for one in within:
                stands = _with_lag(one, constant, wide).columns(self.bench.scene)
                y = y + Columns(stands.channels, stands.values[:, :, :1]).full(self.bench.width)[:, self.places, 0]
            self.behind[key] = y
        return self.behind[key]

    def _by_slope(self) -> float:
        """How late the recording is for small delays, s."""
        made = self.bench.made(None, self.bench.averaged(self.delay.columns(self.bench.stream)))
        A, r = self.beside.products(made)
        return float(r[0] / A[0, 0]) if A[0, 0] > 0.0 else 0.0


def _lowest(
    cost: Callable[[Array], float],
    begun: Array,
    limits: list[tuple[float, float]],
    fine: float = FINE,
    stride: float = STRIDE,
) -> tuple[Array, float]:
    """Where a cost of a few values is lowest, and how low; by simplices, for a servo that sticks has corners."""
    simplex = begun + np.vstack([np.zeros_like(begun), stride * np.eye(len(begun))])
    options = {"xatol": fine, "fatol": 1.0, "initial_simplex": simplex}
    found = minimize(cost, begun, method="Nelder-Mead", bounds=limits, options=options)
    return found.x, float(found.fun)


def _with_lag(effect: Effect, constant: float, wide: float) -> Effect:
    """Friction of a servo whose lag has this constant (s; 0: its own), in a band so many times as wide."""
    response = {"response": constant} if constant > 0.0 else {}
    return effect.with_searched({"coulomb": wide * effect.searched()["coulomb"]} | response)


def _exchanged(
    bench: Bench,
    scorer: Scorer,
    out: Selection,
    clocks: Clocks,
    instead: dict[Effect, Effect],
    *,
    nearly: int = 0,
) -> bool:
    """Whether a model with other clocks, and all else as it arrives through them, was better and was taken.

    `nearly`: only if these take nearly all that is above the noise wherever they are better, in so many channels at least.
    """
    before, y, timing, old = scorer.solve(out.chosen)[2], bench.y, bench.timing, _ends(scorer, out.chosen)
    missed, others = crossed(bench, scorer, out.chosen), [i for i in out.chosen if i not in old]
    kept = [(end, theta) for end, theta in timing if not isinstance(end, Timing)]
    bench.timing = [*kept, *((effect, np.array([1.0 if isinstance(effect, Lag) else size])) for effect, size in clocks)]
    try:
        fresh = [scorer.retimed(_in_place_of(bench, scorer.library[i], instead)) for i in others]
        for effect, size in clocks:
            h = bench.add(effect)
            fresh.append(tangent(bench, h, np.array([size])) if isinstance(effect, TimeDelay) else h)
        bench.y = bench.whole - bench.company - sum((h.bend for h in fresh if h.bend is not None), np.zeros_like(y))
        scorer.append(fresh)
        scorer.retarget(bench.y)
        trial = list(range(len(scorer.library) - len(fresh), len(scorer.library)))
        settle(bench, scorer, trial, anew=True)
    finally:
        bench.timing = timing  # the search brings all columns to the clocks that it finds chosen
    gone = [one for i in old if (one := scorer.library[i].effect) is not None]
    price = (_numbers([one for one, _ in clocks]) - _numbers(gone)) * float(np.log(bench.noise.effective))
    fall = before - scorer.solve(trial)[2] - price
    enough = partial(_nearly_all, channels=nearly) if nearly else _richer
    if fall > MARGIN and enough(bench, missed, crossed(bench, scorer, trial)):
        out.chosen = trial
        return True
    bench.y = y
    scorer.retarget(y)
    return False


def _numbers(effects: Sequence[Effect]) -> int:
    """Delays, constants and dampings."""
    return sum(max(len(effect.searched()), 1) for effect in effects)


def _in_place_of(bench: Bench, h: Hypothesis, instead: dict[Effect, Effect]) -> Hypothesis:
    """The one that stands instead of the hypothesis, or this one."""
    return h if h.effect is None or h.effect not in instead else bench.add(instead[h.effect], h.looked)


def _richer(bench: Bench, before: Array, after: Array) -> bool:
    """Whether errors (C,) on blocks left out fall, by enough of the excess in some channel."""
    most = float(np.max(taken(before, after, bench.noise.sigma**2)))
    return most >= RICHER and float(np.mean(after / before)) < 1.0


def _nearly_all(bench: Bench, before: Array, after: Array, channels: int) -> bool:
    """Whether errors (C,) on blocks left out fall in so many channels, and by nearly all of the excess wherever they do."""
    share = taken(before, after, bench.noise.sigma**2)
    fallen = share[share >= RICHER]
    return len(fallen) >= channels and bool(np.min(fallen) >= COMPLETE) and float(np.mean(after / before)) < 1.0
