"""The elastic arm sample by sample, in plain floats: what the effects of `galen_hw.physics` give for all rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1, tanh
from typing import Any, Protocol

import numpy as np

from galen_hw.identification.deflection.elastic_terms import Term, Weight
from galen_hw.identification.deflection.stream import NONE, GiveStream, Place, Six, Triple
from galen_hw.kinematics import NOMINAL_GRAVITY
from galen_hw.physics.elastic_effects import Hardening
from galen_hw.physics.joint_memory_effects import FRAMES, BearingPlay, JointHysteresis, Slip
from galen_hw.physics.memory_effects import Creep
from galen_hw.spatial import Array


class Arm(Protocol):
    """What the stream needs of a fitted arm, see `ElasticArm`."""

    terms: tuple[Term, ...]
    values: Array
    covariance: Array
    lever: dict[str, float]
    slips: dict[str, list[Slip]]
    weight: Weight
    floor: Array


@dataclass(slots=True)
class _Slip:
    """A play operator with the band in which its output may truly lie."""

    half_width: float
    share: float = 0.0
    output: float | None = None
    low: float = 0.0
    high: float = 0.0

    def take(self, x: float) -> float:
        """Output for the next load; at first the load itself."""
        r = self.half_width
        if self.output is None:
            self.output, self.low, self.high = x, x, x
        low, high = x - r, x + r
        self.low, self.high = min(max(self.low, low), high), min(max(self.high, low), high)
        self.output = min(max(self.output, low), high)
        return self.output

    def gap(self) -> None:
        """The load was anywhere: so may the output be, until the load has moved by the whole width."""
        if self.output is not None:
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


class _Port:
    """A place that gives: its screw and weight for the present joints, its friction and its terms."""

    def __init__(self, name: str, lever: float, slips: Sequence[Slip]) -> None:
        self.name, self.lever = name, lever
        self.slips = [_Slip(r, share) for r, share in slips]
        self.parts: list[_Part] = []
        self.coefficients: list[float] = []
        self.screw: Six = NONE
        self.along: Triple = (0.0, 0.0, 0.0)
        self.weight = 0.0


class ElasticStream(GiveStream):
    """A fitted arm at work.

    Args:
        arm: the model; gravity: (3,) m/s^2 in the base.
    """

    def __init__(self, arm: Arm, gravity: Array = NOMINAL_GRAVITY) -> None:
        self._weight, self._gravity = arm.weight, gravity
        names = list(dict.fromkeys([*arm.lever, *(t.port for t in arm.terms)]))
        self._ports = [_Port(name, arm.lever.get(name, 0.0), arm.slips.get(name, ())) for name in names]
        self._parts: list[_Part] = []
        self._owner: list[int] = []
        for term, value in zip(arm.terms, arm.values.tolist(), strict=True):
            port = self._ports[names.index(term.port)]
            part = _part(term)
            port.parts.append(part)
            port.coefficients.append(value)
            self._parts.append(part)
            self._owner.append(names.index(term.port))
        self._values, self._parameters, floor = arm.values, arm.covariance, arm.floor
        full = np.zeros(6)
        full[: len(floor)] = floor
        self._floor = np.diag(full**2)
        self._answers = np.zeros((6, len(self._ports)))
        self._tip: Triple = (0.0, 0.0, 0.0)
        self._half: Triple = (0.0, 0.0, 0.0)
        self._t: float | None = None

    def place(self, place: Place) -> None:
        """Screws and weights of the ports for these joints."""
        weight = self._weight.mass * self._gravity
        moment = np.cross(place.R @ self._weight.moment, self._gravity) + np.cross(place.sensor, weight)
        self._tip = tuple(place.tip.tolist())
        for i, port in enumerate(self._ports):
            screw = _screw(place, port.name)
            along = screw[:3] + np.cross(screw[3:], place.tip)
            port.screw, port.along = tuple(screw.tolist()), tuple(along.tolist())
            port.weight = float(screw[:3] @ weight + screw[3:] @ moment)
            self._answers[:3, i], self._answers[3:, i] = along, screw[3:]

    def step(self, t_s: float, force: Triple, moment: Triple) -> Six:
        """Loads on the bent arm, friction, then each port's give through its screw."""
        fx, fy, fz = force
        mx, my, mz = self._bent_moment(force, moment)
        dt = 0.0 if self._t is None else max(t_s - self._t, 0.0)
        self._t = t_s
        hx, hy, hz = self._half
        x, y, z = self._tip
        x, y, z = x + hx, y + hy, z + hz
        a = b = c = d = e = f = 0.0
        for port in self._ports:
            sx, sy, sz, wx, wy, wz = port.screw
            load = sx * fx + sy * fy + sz * fz + wx * mx + wy * my + wz * mz + port.weight
            give = _give(port, load, dt)
            a += give * (sx + wy * z - wz * y)
            b += give * (sy + wz * x - wx * z)
            c += give * (sz + wx * y - wy * x)
            d, e, f = d + give * wx, e + give * wy, f + give * wz
        return (a, b, c, d, e, f)

    def _bent_moment(self, force: Triple, moment: Triple) -> Triple:
        """The moment about the base's origin when the tip has moved with the arm; half of the move is kept."""
        fx, fy, fz = force
        mx, my, mz = moment
        u = v = w = 0.0
        for port in self._ports:
            if port.lever:
                sx, sy, sz, wx, wy, wz = port.screw
                g = port.lever * (sx * fx + sy * fy + sz * fz + wx * mx + wy * my + wz * mz + port.weight)
                ax, ay, az = port.along
                u, v, w = u + g * ax, v + g * ay, w + g * az
        self._half = (0.5 * u, 0.5 * v, 0.5 * w)
        return mx + v * fz - w * fy, my + w * fx - u * fz, mz + u * fy - v * fx

    def covariance(self) -> list[float]:
        """Parameters, what the model leaves, and memory that is not sure."""
        X = self._answers[:, self._owner] * [p.value for p in self._parts]
        total = X @ self._parameters @ X.T + self._floor
        for part, owner, value in zip(self._parts, self._owner, self._values, strict=True):
            slip = part.slip
            width = part.unsure if slip is None else (slip.high - slip.low) ** 2 / 12.0
            if width > 0.0:
                column = self._answers[:, owner] * float(value)
                total += width * np.outer(column, column)
        return total.ravel().tolist()

    def gap(self) -> None:
        """The load between is not known."""
        for port in self._ports:
            for slip in port.slips:
                slip.gap()
        for part in self._parts:
            if part.slip is not None:
                part.slip.gap()
            elif part.kind == "creep":
                part.unsure += (part.slow or 0.0) ** 2 + part.value**2

    def reset(self) -> None:
        """As at rest under the next load."""
        self._t = None
        for part in self._parts:
            part.slow, part.unsure = None, 0.0
        for slip in self._slips():
            slip.output = None

    def _slips(self) -> list[_Slip]:
        inside = [p.slip for p in self._parts if p.slip is not None]
        return [s for port in self._ports for s in port.slips] + inside

    def memory(self) -> dict[str, Any]:
        """Outputs of the operators."""
        return {"slips": [s.output for s in self._slips()], "slow": [p.slow for p in self._parts]}

    def remember(self, memory: dict[str, Any]) -> None:
        """Outputs of the operators, their bands as after a gap."""
        slips, slow = memory["slips"], memory["slow"]
        for slip, output in zip(self._slips(), slips, strict=True):
            slip.output = None if output is None else float(output)
        for part, value in zip(self._parts, slow, strict=True):
            part.slow = None if value is None else float(value)
        self.gap()


def _part(term: Term) -> _Part:
    effect = term.effect
    if isinstance(effect, JointHysteresis):
        return _Part("hysteresis", effect.widths[0], _Slip(effect.widths[0]))
    if isinstance(effect, Creep):
        return _Part("creep", effect.constant)
    if isinstance(effect, Hardening):
        return _Part("hardening", float(effect.power))
    if isinstance(effect, BearingPlay):
        return _Part("play", effect.transition)
    return _Part("compliance", 0.0)


def _screw(place: Place, name: str) -> Array:
    frame, _, axis = name.partition(".")
    if frame not in FRAMES:
        return np.asarray(place.screws[:, place.names.index(name)])
    screw = np.zeros(6)
    screw[:3] = np.eye(3)["xyz".index(axis)] if frame == "structure" else place.R[:, "xyz".index(axis)]
    return screw


def _give(port: _Port, load: float, dt: float) -> float:
    """Give of a port under a load, and what it remembers."""
    left = load
    for slip in port.slips:
        left += slip.share * (slip.take(load) - load)
    out = 0.0
    for part, coefficient in zip(port.parts, port.coefficients, strict=True):
        kind = part.kind
        if kind == "compliance":
            value = load
        elif kind == "hysteresis":
            assert part.slip is not None, "made with one"
            value = part.slip.take(load) - load
        elif kind == "creep":
            if part.slow is None:
                part.slow = left
            share = -expm1(-dt / part.number)
            part.slow += share * (left - part.slow)
            part.unsure *= (1.0 - share) ** 2
            value = part.slow - left
        elif kind == "hardening":
            value = left * abs(left) ** (part.number - 1.0)
        else:
            value = tanh(left / part.number)
        part.value = value
        out += coefficient * value
    return out
