"""Give of the arm, which its encoders do not see: springs, play, bearings that stick, slacken, stiffen and creep.

Written from mechanics for the virtual robot alone. In each joint the load side lies x beyond the drive under effort u:

    u = s(x) + F z(x)                     spring beside a bearing with friction
    s = e (1 + (e / e2)^2) / c(q)         e2: give at which the spring has become twice as stiff
    e = x - w tanh(x / w)                 w: how far a loose bearing lets go before it holds
    c(q) = c (1 + slope q)                a screw or belt is the longer, the farther its joint has gone
    dz/dx = (1 - sgn(dx) z) / (F c)       bristles of the bearing, from -1 to 1 (Dahl 1968)

and two Kelvin elements in row with x, of time constants T and 8 T, give the share `creep` of c s in the end.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import copysign, exp, expm1, tanh
from typing import Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.spatial import Array, rotation_exp, transform

STEP_NS: Final = 5_000_000
KEPT: Final = 400
"""Steps that can still be asked for (2 s): a tracker speaks of what was a few frames ago."""
_CREEP: Final = ((2.0 / 3.0, 1.0), (1.0 / 3.0, 8.0))
"""Shares and multiples of the time constant: no real creep has a single one."""
_LEAST_SLOPE: Final = 0.1
_BALANCED: Final = 1e-9
"""N or N m: spring and friction bear an effort when they differ from it by no more."""


def _zeros() -> Array:
    return np.zeros(0)


@dataclass(slots=True)
class Compliance:
    """Give of the arm; n joints, m and N or rad and N m each.

    Args:
        joint: (n,) give of each joint's spring, m/N or rad/(N m); none where it is 0.
        structure: (6,) give between the last joint and the sensor, sensor axes: m/N, then rad/(N m).
        play: (n,) width of each joint's lost motion, m or rad: the load side follows only where the play ends.
        friction: (n,) N or N m; hardening: (n,) give at which the spring is twice as stiff, 0 for a straight one.
        bearing: (n,) half width of a loose bearing; slope: (n,) relative change of the give per m or rad of position.
        creep: (n,) share of the give that comes late; creep_s: its shorter time constant.
    """

    joint: Array
    structure: Array
    play: Array
    friction: Array = field(default_factory=_zeros)
    hardening: Array = field(default_factory=_zeros)
    bearing: Array = field(default_factory=_zeros)
    slope: Array = field(default_factory=_zeros)
    creep: Array = field(default_factory=_zeros)
    creep_s: float = 3.0
    _behind: Array | None = field(init=False, default=None)
    _bearings: "list[_Bearing]" = field(init=False)
    _steps: deque[tuple[int, Array]] = field(init=False, default_factory=lambda: deque(maxlen=KEPT))

    def __post_init__(self) -> None:
        for name in ("friction", "hardening", "bearing", "slope", "creep"):
            if not len(getattr(self, name)):
                setattr(self, name, np.zeros_like(self.joint))
        rows = zip(self.friction, self.hardening, self.bearing, self.creep, strict=True)
        self._bearings = [_Bearing(float(f), float(h), float(w), float(a), self.creep_s) for f, h, w, a in rows]

    @property
    def remembers(self) -> bool:
        """More than springs and play: the past load counts, and time has to be gone through step by step."""
        return any(v.any() for v in (self.friction, self.hardening, self.bearing, self.slope, self.creep))

    def joints(self, q: Array, effort: Array) -> Array:
        """(n,) where the load sides of the joints are, with encoders at `q` and efforts in N, N m; springs and play."""
        return np.asarray(self._follow(q) + self.joint * effort)

    def missing(self, t_ns: int) -> Iterator[int]:
        """Times up to `t_ns` that `advance` has not gone through; longer steps where nobody has asked for long."""
        last = self._steps[-1][0] if self._steps else (t_ns // STEP_NS - 1) * STEP_NS
        count = (t_ns - last) // STEP_NS
        stride = max(1, count // KEPT)
        for number in range(stride, count + 1, stride):
            yield last + number * STEP_NS

    def advance(self, t_ns: int, q: Array, effort: Array) -> None:
        """Go on to `t_ns`, with encoders at `q` (n,) and efforts (n,) in N, N m."""
        dt = (t_ns - self._steps[-1][0]) / NS_PER_S if self._steps else 0.0
        gives = self.joint * np.maximum(1.0 + self.slope * q, _LEAST_SLOPE)
        rows = zip(self._bearings, gives.tolist(), effort.tolist(), strict=True)
        moved = np.array([bearing.take(c, u, dt) if c > 0.0 else 0.0 for bearing, c, u in rows])
        self._steps.append((t_ns, self._follow(q) - q + moved))

    def at(self, t_ns: int) -> Array:
        """(n,) load sides beyond the encoders at a time that was gone through, or the last one."""
        times = [t for t, _ in self._steps]
        place = bisect_right(times, t_ns)
        if place in {0, len(times)}:
            return self._steps[0 if place == 0 else -1][1]
        (ta, a), (tb, b) = self._steps[place - 1], self._steps[place]
        return np.asarray(a + (t_ns - ta) / (tb - ta) * (b - a))

    def bend(self, load: Array) -> Array:
        """(4, 4) displacement of the sensor in its own frame under `load` (6,), sensor frame."""
        give = self.structure * load
        return transform(rotation_exp(give[3:]), give[:3])

    def _follow(self, q: Array) -> Array:
        """(n,) drives behind their play."""
        behind = q if self._behind is None else self._behind
        self._behind = np.clip(behind, q - 0.5 * self.play, q + 0.5 * self.play)
        return self._behind


@dataclass(slots=True)
class _Bearing:
    """One joint under load, see the head of this file; x and z are where it is now."""

    friction: float
    hardening: float
    loose: float
    creep: float
    creep_s: float
    x: float = 0.0
    z: float = 0.0
    slow: list[float] = field(default_factory=lambda: [0.0] * len(_CREEP))

    def take(self, c: float, effort: float, dt: float) -> float:
        """Give under an effort `dt` seconds after the last one; c: of the spring, m/N or rad/(N m)."""
        if self.friction or self.hardening or self.loose:
            moved = self._balance(c, effort)
            self.x, self.z = moved, self._bristle(c, moved)
        else:
            self.x = c * effort
        for number, (share, multiple) in enumerate(_CREEP):
            aim = self.creep * share * c * self._spring(c, self.x)
            self.slow[number] -= expm1(-dt / (multiple * self.creep_s)) * (aim - self.slow[number])
        return self.x + sum(self.slow)

    def _spring(self, c: float, x: float) -> float:
        e = x - self.loose * tanh(x / self.loose) if self.loose else x
        return e / c * (1.0 + (e / self.hardening) ** 2 if self.hardening else 1.0)

    def _bristle(self, c: float, x: float) -> float:
        """The bearing's friction, as a share, after a move straight to x."""
        if not self.friction or x == self.x:
            return self.z
        way = copysign(1.0, x - self.x)
        return way + (self.z - way) * exp(-abs(x - self.x) / (self.friction * c))

    def _balance(self, c: float, effort: float) -> float:
        """Where spring and friction bear the effort; both grow with x, so that there is one place."""

        def excess(x: float) -> float:
            return self._spring(c, x) + self.friction * self._bristle(c, x) - effort

        here = excess(self.x)
        if here == 0.0:
            return self.x
        near, step = self.x, -c * here
        far = near + step
        while excess(far) * here > 0.0:
            near, step = far, 2.0 * step
            far = near + step
        return _root(excess, near, far)


def _root(excess: Callable[[float], float], near: float, far: float) -> float:
    """Return where `excess` is 0 between two places where its signs differ: Illinois false position (Dowell, Jarratt 1971).

    scipy's solvers need `scipy.optimize`, which would be half of all that the virtual robot loads when it starts; loaded with
    the first load on a bearing, it would hold the robot up in its motion.
    """
    at_near, at_far = excess(near), excess(far)
    while abs(at_far) > _BALANCED and far != near:
        between = far - at_far * (far - near) / (at_far - at_near)
        at_between = excess(between)
        if at_between * at_far < 0.0:
            near, at_near = far, at_far
        elif between == far:  # as near as floating point comes
            break
        else:
            at_near *= 0.5  # the end that has stayed weighs less, else it would stay for ever
        far, at_far = between, at_between
    return far
