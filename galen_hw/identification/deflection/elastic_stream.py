"""The elastic arm sample by sample, in plain floats: what the effects of `galen_hw.physics` give for all rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1, tanh
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from galen_hw.identification.deflection.bent import chain_order
from galen_hw.identification.deflection.elastic_terms import Term, Weight
from galen_hw.identification.deflection.stream import GiveStream, Place, Six, Triple
from galen_hw.kinematics import NOMINAL_GRAVITY
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.compliance import Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.scenes.elastic_arm import FRAMES, RestingLoad, Slip
from galen_hw.spatial import Array


class Arm(Protocol):
    """What the stream needs of a fitted arm, see `ElasticArm`."""

    terms: tuple[Term, ...]
    values: Array
    covariance: Array
    slips: dict[str, list[Slip]]
    weight: Weight
    floor: Array


@dataclass(slots=True)
class _Slip:
    """A play operator with the band in which its output may truly lie.

    Until the load moves for the first time it is at the mean of `start`; None: it has moved. What happened before the
    first load is not known: the band is whole until the load has moved by its width.
    """

    half_width: float
    share: float = 0.0
    output: float | None = None
    low: float = 0.0
    high: float = 0.0
    start: RestingLoad | None = None

    def take(self, x: float) -> float:
        """Output for the next load."""
        r = self.half_width
        if self.output is None:
            self.start = RestingLoad()
        if self.start is not None:
            rests = self.start.take(x, r)
            self.output = self.start.mean
            self.low, self.high = self.output - r, self.output + r
            self.start = self.start if rests else None
        assert self.output is not None, "it has begun"
        low, high = x - r, x + r
        self.low, self.high = min(max(self.low, low), high), min(max(self.high, low), high)
        self.output = min(max(self.output, low), high)
        return self.output

    def gap(self) -> None:
        """The load was anywhere: so may the output be, until the load has moved by the whole width."""
        if self.output is not None:
            self.start = None
            self.low, self.high = self.output - 2.0 * self.half_width, self.output + 2.0 * self.half_width


@dataclass(slots=True)
class _Part:
    """A term at work: `kind` with its searched number, and its regressor's last value."""

    kind: str
    number: float
    slip: _Slip | None = None
    slow: float | None = None
    unsure: float = 0.0
    value: float = 0.0


@dataclass(slots=True)
class _Side:
    """A port's friction and terms with their memory; each port has one for the rigid arm and one for the bent one."""

    slips: list[_Slip]
    parts: list[_Part]
    coefficients: list[float]

    def give(self, load: float, dt: float) -> float:
        """Give of the port under a load, and what it remembers."""
        left = load
        for slip in self.slips:
            left += slip.share * (slip.take(load) - load)
        out = 0.0
        for part, coefficient in zip(self.parts, self.coefficients, strict=True):
            part.value = _answer(part, load, left, dt)
            out += coefficient * part.value
        return out


JITTER_S: Final = 0.25
"""Time constant of the running mean that says how much the give jitters."""
APART_S: Final = 0.015
"""Samples nearer than this are not looked at: what a low-pass leaves of the force's noise hardly differs between them."""


class Jitter:
    """How much the give jitters by the force's noise, from its second differences: a loose bearing at rest makes much of it.

    The variance of white noise is a sixth of the mean square of its second differences, whatever moves slowly below.

    Args:
        width: numbers of a give.
    """

    def __init__(self, width: int) -> None:
        self._past: list[Sequence[float]] = []
        self._since = 0.0
        self.variance = [0.0] * width

    def take(self, give: Sequence[float], dt: float) -> list[float]:
        """(width,) variance with the next give, dt s after the last."""
        self._since += dt
        if self._past and self._since < APART_S:
            return self.variance
        if len(self._past) == 2:
            first, second = self._past
            share = -expm1(-self._since / JITTER_S)
            self.variance = [
                v + share * ((a - 2.0 * b + c) ** 2 / 6.0 - v)
                for v, a, b, c in zip(self.variance, first, second, give, strict=True)
            ]
        self._past, self._since = [*self._past[-1:], give], 0.0
        return self.variance

    def gap(self) -> None:
        """What comes next does not follow what was last."""
        self._past = []


class ElasticStream(GiveStream):
    """A fitted arm at work.

    Args:
        arm: the model; gravity: (3,) m/s^2 in the base.
    """

    def __init__(self, arm: Arm, gravity: Array = NOMINAL_GRAVITY) -> None:
        self._weight, self._gravity = arm.weight, gravity
        self._names = list(dict.fromkeys(t.port for t in arm.terms))
        self._owner = [self._names.index(t.port) for t in arm.terms]
        self._rigid, self._bent = ([_side(arm, name) for name in self._names] for _ in range(2))
        each = [iter(side.parts) for side in self._bent]
        self._parts = [next(each[number]) for number in self._owner]
        self._values, self._parameters, floor = arm.values, arm.covariance, arm.floor
        full = np.zeros(6)
        full[: len(floor)] = floor
        self._floor = np.diag(full**2)
        count = len(self._names)
        self._answers = np.zeros((count, 6))
        self._second = np.zeros((count, count, 3))
        self._columns = np.zeros((count, 6 * count))
        self._weights, self._bent_weights = np.zeros(count), np.zeros((count, count))
        self._screws = np.zeros((count, 6))
        self._t: float | None = None
        self._jitter = Jitter(6)

    def place(self, place: Place) -> None:
        """Screws of the ports for these joints, their answers, and how each changes with the others' gives."""
        weight, count = self._weight.mass * self._gravity, len(self._names)
        point = place.sensor + place.R @ (np.asarray(self._weight.moment) / (self._weight.mass or 1.0))
        proximal, distal = self._pairs(place.names)
        screws = np.array([_screw(place, name) for name in self._names]).reshape(count, 6)
        turn = screws[:, 3:]
        along, held = (screws[:, :3] + _cross(turn, p) for p in (place.tip, point))
        second = _cross(turn[proximal], along[distal])
        turns = _cross(turn[proximal], turn[distal])
        self._bent_weights = _cross(turn[proximal], held[distal]) @ weight
        self._screws, self._second, self._weights = screws, second, held @ weight
        self._answers = np.concatenate([along, turn], axis=1)
        self._columns = np.concatenate([0.5 * second, 0.25 * turns], axis=2).reshape(count, 6 * count)

    def _pairs(self, joints: Sequence[str]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(n, n) which of two ports is nearer to the base, and which is farther."""
        order = chain_order(self._names, joints)
        rank = np.array([order.index(name) for name in self._names], dtype=np.intp)
        number = np.arange(len(rank), dtype=np.intp)
        nearer = rank[:, None] <= rank[None]
        return np.where(nearer, number[:, None], number), np.where(nearer, number, number[:, None])

    def step(self, t_s: float, force: Triple, moment: Triple) -> Six:
        """Gives of the rigid arm, which bend it; loads on the bent arm; gives, each through the bent port."""
        dt = 0.0 if self._t is None else max(t_s - self._t, 0.0)
        self._t = t_s
        loads = self._screws @ (*force, *moment) + self._weights
        bent = np.array([side.give(load, dt) for side, load in zip(self._rigid, loads.tolist(), strict=True)])
        loads = loads + (self._second @ force + self._bent_weights) @ bent
        gives = np.array([side.give(load, dt) for side, load in zip(self._bent, loads.tolist(), strict=True)])
        # The second-order parts are the same either way round, so that the first index may be summed over.
        answers = self._answers + (bent @ self._columns).reshape(self._answers.shape)
        give = (gives @ answers).tolist()
        self._jitter.take(give, dt)
        return tuple(give)

    def covariance(self) -> list[float]:
        """Parameters, what the model leaves, what the force's noise makes of the give, and memory that is not sure."""
        X = self._answers[self._owner].T * [p.value for p in self._parts]
        total = X @ self._parameters @ X.T + self._floor + np.diag(self._jitter.variance)
        for part, owner, value in zip(self._parts, self._owner, self._values, strict=True):
            slip = part.slip
            width = part.unsure if slip is None else (slip.high - slip.low) ** 2 / 12.0
            if width > 0.0:
                column = self._answers[owner] * float(value)
                total += width * np.outer(column, column)
        return total.ravel().tolist()

    def gap(self) -> None:
        """The load between is not known."""
        self._jitter.gap()
        for slip in self._slips():
            slip.gap()
        for part in self._parts:
            if part.kind == "creep":
                part.unsure += (part.slow or 0.0) ** 2 + part.value**2

    def reset(self) -> None:
        """As at rest under the next load."""
        self._t, self._jitter = None, Jitter(6)
        for part in self._all():
            part.slow, part.unsure = None, 0.0
        for slip in self._slips():
            slip.output = None

    def _all(self) -> list[_Part]:
        return [part for side in (*self._rigid, *self._bent) for part in side.parts]

    def _slips(self) -> list[_Slip]:
        outside = [slip for side in (*self._rigid, *self._bent) for slip in side.slips]
        return outside + [p.slip for p in self._all() if p.slip is not None]

    def memory(self) -> dict[str, Any]:
        """Outputs of the operators."""
        return {"slips": [s.output for s in self._slips()], "slow": [p.slow for p in self._all()]}

    def remember(self, memory: dict[str, Any]) -> None:
        """Outputs of the operators, their bands as after a gap."""
        slips, slow = memory["slips"], memory["slow"]
        for slip, output in zip(self._slips(), slips, strict=True):
            slip.output = None if output is None else float(output)
        for part, value in zip(self._all(), slow, strict=True):
            part.slow = None if value is None else float(value)
        self.gap()


def _side(arm: Arm, name: str) -> _Side:
    """A port's memory, as at the start."""
    mine = [(t, v) for t, v in zip(arm.terms, arm.values.tolist(), strict=True) if t.port == name]
    slips = [_Slip(r, share) for r, share in arm.slips.get(name, ())]
    return _Side(slips, [_part(t) for t, _ in mine], [v for _, v in mine])


def _part(term: Term) -> _Part:
    effect = term.effect
    if isinstance(effect, Hysteresis):
        return _Part("hysteresis", effect.widths[0], _Slip(effect.widths[0]))
    if isinstance(effect, Creep):
        return _Part("creep", effect.constant)
    if isinstance(effect, Hardening):
        return _Part("hardening", float(effect.power)) if effect.knee is None else _Part("knee", effect.knee)
    if isinstance(effect, Backlash) and effect.transition is not None:
        return _Part("play", effect.transition)
    return _Part("compliance", 0.0)


def _screw(place: Place, name: str) -> Array:
    frame, _, axis = name.partition(".")
    if frame not in FRAMES:
        return np.asarray(place.screws[:, place.names.index(name)])
    screw = np.zeros(6)
    screw[:3] = np.eye(3)["xyz".index(axis)] if frame == "structure" else place.R[:, "xyz".index(axis)]
    return screw


def _answer(part: _Part, load: float, left: float, dt: float) -> float:
    """A term's regressor for a load, and for what the friction leaves of it."""
    kind = part.kind
    if kind == "compliance":
        return load
    if kind == "hysteresis":
        assert part.slip is not None, "made with one"
        return part.slip.take(load) - load
    if kind == "creep":
        if part.slow is None:
            part.slow = left
        share = -expm1(-dt / part.number)
        part.slow += share * (left - part.slow)
        part.unsure *= (1.0 - share) ** 2
        return part.slow - left
    if kind == "hardening":
        return left * float(abs(left) ** (part.number - 1.0))
    if kind == "knee":
        return left * abs(left) / (part.number + abs(left))
    return tanh(left / part.number)


def _cross(a: Array, b: Array) -> Array:
    """Of vectors (..., 3); numpy's own is several times slower for few pairs."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
