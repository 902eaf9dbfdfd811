"""What the nominal model does not know of: drift, temperature, a cable (`give`: the arm's). All off by default."""

from dataclasses import dataclass, field

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.spatial import Array

_WALK_STEP_NS = 10_000_000
_REFERENCE_C = 22.0


def _six() -> Array:
    return np.zeros(6)


@dataclass(slots=True)
class Drift:
    """The sensor's slow wander, N and N m in the sensor frame, from `start_ns` on.

    Args:
        rate: (6,) per second.
        warm_up: (6,) that is reached with the time constant `warm_up_s`.
        walk: (6,) random walk, one sigma after one second.
        seed: of the walk.
    """

    start_ns: int
    rate: Array = field(default_factory=_six)
    warm_up: Array = field(default_factory=_six)
    warm_up_s: float = 600.0
    walk: Array = field(default_factory=_six)
    seed: int = 0
    _rng: np.random.Generator = field(init=False)
    _steps: list[Array] = field(init=False, default_factory=lambda: [np.zeros(6)])

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def wrench(self, t_ns: int) -> Array:
        """(6,) at `t_ns`; the same value whenever it is asked for again."""
        t = max(0, t_ns - self.start_ns)
        seconds = t / NS_PER_S
        out = self.rate * seconds + self.warm_up * (1.0 - np.exp(-seconds / self.warm_up_s))
        return np.asarray(out + self.walk * self._walked(t) if self.walk.any() else out)

    def _walked(self, t: int) -> Array:
        index, rest = divmod(t, _WALK_STEP_NS)
        missing = index + 2 - len(self._steps)
        if missing > 0:
            jumps = self._rng.standard_normal((missing, 6)) * np.sqrt(_WALK_STEP_NS / NS_PER_S)
            self._steps.extend(self._steps[-1] + np.cumsum(jumps, axis=0))
        a, b = self._steps[index], self._steps[index + 1]
        return np.asarray(a + (rest / _WALK_STEP_NS) * (b - a))


@dataclass(frozen=True, slots=True)
class Thermal:
    """Air temperature and what it does to the sensor.

    Args:
        start_ns: when the temperature leaves `start_c` (degrees Celsius) at `rate` (K/s) plus a swing.
        swing_c, period_s: amplitude and period of the swing.
        gain: (6,) N/K and N m/K, sensor frame, about 22 degrees Celsius.
    """

    start_ns: int = 0
    start_c: float = _REFERENCE_C
    rate: float = 0.0
    swing_c: float = 0.0
    period_s: float = 600.0
    gain: Array = field(default_factory=_six)

    def temperature(self, t_ns: int) -> float:
        """Degrees Celsius at `t_ns`."""
        t = max(0, t_ns - self.start_ns) / NS_PER_S
        return self.start_c + self.rate * t + self.swing_c * float(np.sin(2.0 * np.pi * t / self.period_s))

    def wrench(self, t_ns: int) -> Array:
        """(6,) that the temperature adds to the reading."""
        return np.asarray(self.gain * (self.temperature(t_ns) - _REFERENCE_C))


@dataclass(slots=True)
class Cable:
    """A cable from the tool to a point of the room: a spring that only pulls, with dry friction of its own.

    Args:
        anchor: (3,) base, m; attached: (3,) sensor frame, m.
        stiffness: N/m beyond `rest_length` (m).
        friction: N, against the change of length; builds up over `slip` (m), so it has a memory (hysteresis).
    """

    anchor: Array
    attached: Array
    stiffness: float = 20.0
    rest_length: float = 0.0
    friction: float = 0.0
    slip: float = 0.002
    _bristle: float = field(init=False, default=0.0)
    _length: float | None = field(init=False, default=None)

    def force(self, point: Array) -> Array:
        """(3,) on the tool, base axes, with its end at `point` (base, m); asked in the order of time."""
        line = self.anchor - point
        length = float(np.linalg.norm(line))
        if length < 1e-9:
            return np.zeros(3)
        if self._length is not None:
            self._bristle = min(self.slip, max(-self.slip, self._bristle + length - self._length))
        self._length = length
        pull = self.stiffness * max(0.0, length - self.rest_length) + self.friction * self._bristle / self.slip
        return np.asarray(line * (pull / length))
