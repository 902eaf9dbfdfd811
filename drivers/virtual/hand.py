"""The virtual hand: it pushes, leads and lets go. It acts on the tool at a contact point, in base axes."""

from dataclasses import dataclass, field

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.motion import SensorMotion
from galen_hw.spatial import Array, rotation_exp, rotation_log


@dataclass(frozen=True, slots=True)
class Push:
    """A wrench that rises, holds and falls.

    Args:
        start_ns: when it begins.
        wrench: (6,) at its height: force N and torque N m in base axes, at the contact point.
        seconds: how long it holds its height; infinite for good.
        rise_s: how long it takes to rise, and to fall.
    """

    start_ns: int
    wrench: Array
    seconds: float
    rise_s: float = 0.0

    def share(self, t_ns: int) -> float:
        """Part of the height at `t_ns`, 0 to 1."""
        t = (t_ns - self.start_ns) / NS_PER_S
        left = self.seconds + 2.0 * self.rise_s - t
        if t < 0.0 or left <= 0.0:
            return 0.0
        return min(1.0, t / self.rise_s, left / self.rise_s) if self.rise_s > 0.0 else 1.0


@dataclass(frozen=True, slots=True)
class Guide:
    """A human hand that leads the tool: a spring and a damper to a point that travels smoothly and then stays.

    Args:
        start_ns: when it takes hold; it pulls at nothing until its aim moves.
        position: (3,) base, m, and R: (3, 3) sensor to base, where it took hold.
        by: (3,) base, m, and turn: (3,) rotation vector in base axes, rad: where it leads, over `move_s`.
        stiffness N/m, damping N s/m, turn_stiffness N m/rad, turn_damping N m s/rad; limits in N and N m.
        seconds: when it lets go.
    """

    start_ns: int
    position: Array
    R: Array
    by: Array
    turn: Array
    move_s: float = 2.0
    seconds: float = float("inf")
    stiffness: float = 300.0
    damping: float = 20.0
    turn_stiffness: float = 3.0
    turn_damping: float = 0.1
    limit_n: float = 20.0
    limit_nm: float = 1.0

    def wrench(self, t_ns: int, position: Array, velocity: Array, R: Array, omega: Array) -> Array:
        """(6,) on the tool at the contact point, base axes."""
        t = (t_ns - self.start_ns) / NS_PER_S
        if not 0.0 <= t < self.seconds:
            return np.zeros(6)
        s = min(1.0, t / self.move_s) if self.move_s > 0.0 else 1.0
        share = s**3 * (10.0 + s * (6.0 * s - 15.0))  # Minimum jerk (Flash and Hogan 1985).
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / self.move_s if s < 1.0 else 0.0
        aim = rotation_exp(share * self.turn) @ self.R
        force = self.stiffness * (self.position + share * self.by - position)
        force += self.damping * (rate * self.by - velocity)
        torque = self.turn_stiffness * rotation_log(aim @ R.T) + self.turn_damping * (rate * self.turn - omega)
        return np.concatenate((_clamped(force, self.limit_n), _clamped(torque, self.limit_nm)))


@dataclass(slots=True)
class Hand:
    """All that the hand does at the moment.

    Args:
        contact: (3,) sensor frame, m, where it touches; None for the tool's tip.
    """

    contact: Array | None = None
    pushes: list[Push] = field(default_factory=list)
    guide: Guide | None = None

    @property
    def idle(self) -> bool:
        """It touches nothing."""
        return not self.pushes and self.guide is None

    def release(self) -> None:
        """Let go of everything."""
        self.pushes.clear()
        self.guide = None

    def forget(self, now_ns: int) -> None:
        """Drop what has ended."""
        self.pushes = [p for p in self.pushes if (now_ns - p.start_ns) / NS_PER_S < p.seconds + 2.0 * p.rise_s]
        guide = self.guide
        if guide is not None and (now_ns - guide.start_ns) / NS_PER_S >= guide.seconds:
            self.guide = None

    def wrench(self, t_ns: int, motion: SensorMotion, contact: Array) -> Array:
        """(6,) that acts on the tool at `contact` (sensor frame, m), in base axes."""
        out = np.zeros(6)
        for push in self.pushes:
            out += push.share(t_ns) * push.wrench
        if self.guide is not None:
            arm = motion.R @ contact
            velocity = motion.v + np.cross(motion.omega, arm)
            out += self.guide.wrench(t_ns, motion.p + arm, velocity, motion.R, motion.omega)
        return out


def _clamped(v: Array, limit: float) -> Array:
    size = float(np.linalg.norm(v))
    return v if size <= limit else np.asarray(v * (limit / size))
