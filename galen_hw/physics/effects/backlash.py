"""Play in a joint: which side of its gap the far side lies on, and how it gets across."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns, through
from galen_hw.physics.effects.parameters import Parameter, Searched, duration, log_grid, spacing
from galen_hw.physics.effects.traits import Follows
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.signals.differentiation import row_noise
from galen_hw.spatial import Array


def _reading_noise(scene: Scene, joint: str, *, most: float = 0.2) -> float:
    """Return the standard deviation of a joint's readings from row to row, rad or m; 0 where none can be told.

    Args:
        most: share of a joint's own spread from which what changes from row to row is no noise: rows are poses,
            not samples of a motion.
    """
    q = scene.q[:, scene.joint_index(joint)]
    noise = row_noise(q, scene.segments)
    return noise if noise < most * float(np.std(q)) else 0.0


def _driven(scene: Scene, load: Array) -> Array:
    """Return the impulse (N,) of a load (N,) since the recording began, N m s or N s."""
    return scene.impulse("impulse", load[:, None])[:, 0]


@dataclass(frozen=True)
class Backlash(Effect):
    """Play in a joint. Where friction holds the far side ("motion") it rests until the near side has crossed the dead band.

    Then q' = P_r[q] with half width r, and the parameter is the share of it that is seen (1 for plain play). Where weight or a
    push holds it ("load") it lies on the side that the load says, q' = q + r tanh(load / l), and the parameter is r itself;
    `balanced`: weight is borne by something else, and the load is what motion alone needs; `friction`: it changes sides only
    where the load has overcome the bearing's own friction F, and the load is P_F[load] (a relay with hysteresis); `impulse`: a
    gap with grease in it is crossed at a speed in proportion to the load, c dq'/dt = load between the stops, so that q' - q is
    r / J times the stop operator of half width J of the load's impulse, J = r c; `coasting`: the link's momentum counts too,
    m d2q'/dt2 + c dq'/dt = load between stops that throw nothing back, T = m / c; `unborne`: the share of a balanced weight
    that the balance leaves, or (`lifted`) lifts beyond the weight: at rest the link sinks, or rises, to that side of its gap.
    Visible at reversals, of the motion or of the load, as a shift of fixed width that does not depend on amplitude. Confused
    with hysteresis (of which it is one element), with Coulomb friction of a servo, with joint_offset where a joint turns only
    once or its load keeps its sign, and with hardening.
    """

    KEY = "backlash"
    SAYS = "a dead band at every reversal: play, or the stand-off of a servo against friction"
    KNOWN_BY = "it shifts by a fixed width at reversals, whatever their size"
    CONFIRMED_BY = "sweep one joint slowly to and fro with small and with large reversals"
    HEAD = ("half_width", "half_play")
    ALIKE: ClassVar = {"friction": "a servo without integral action stands off against friction as if it had play"}
    TOLD_APART: ClassVar = {
        "friction": "push the stopped joint lightly by hand in both directions: play gives, friction does not"
    }
    COMPLEXITY = 2
    SEARCHED: ClassVar = {
        "half_width": Searched(1e-7, 10.0, "rad or m"),
        "transition": Searched(1e-9, 1e6, "N m or N"),
        "friction": Searched(1e-9, 1e6, "N m or N"),
        "impulse": Searched(1e-9, 1e6, "N m s or N s"),
        "unborne": Searched(1e-7, 1.0, "1"),
        "coasting": Searched(1e-4, 10.0, "s"),
    }
    joint: str
    half_width: float | None = None
    transition: float | None = None
    balanced: bool = False
    friction: float | None = None
    impulse: float | None = None
    unborne: float | None = None
    lifted: bool = False
    coasting: float | None = None

    @classmethod
    def structural(cls, scene: Scene, parameters: Sequence[str]) -> list[str]:
        """Return what holds a servo back at a reversal."""
        return ["friction", "hysteresis"] if scene.observations.predict == "position" else []

    @classmethod
    def propose(cls, scene: Scene, *, slow: int = 8) -> Iterator[Self]:
        """Yield half widths from far below the joint's range to most of it; sharp and soft crossings for each joint with a load.

        In poses bearings with friction too, from little to most of what the load reaches.

        Args:
            slow: impulses that are tried for a gap with grease in it, from one that throws the link at once
                to one that hardly does.
        """
        for joint in scene.joint_names:
            if scene.joint_port(joint) is None:
                continue
            if joint in scene.moved:
                half_range = 0.5 * float(np.ptp(scene.q[:, scene.joint_index(joint)]))
                yield from (cls(joint, r) for r in log_grid(half_range * 1e-4, half_range * 0.7, 14))
            if scene.observations.predict not in ("pose", "targets", "position"):
                continue
            for balanced in (False, True):
                load = scene.inertia_load(joint) if balanced else scene.load(joint)
                if load is not None and np.min(load) < 0.0 < np.max(load):
                    size = float(np.sqrt(np.mean(load**2)))
                    yield from (cls(joint, None, share * size, balanced) for share in (0.01, 0.05))
                    if scene.observations.predict == "position" and scene.clock:
                        reach = 0.5 * float(np.ptp(_driven(scene, load)))
                        yield from (
                            cls(joint, None, None, balanced, impulse=one)
                            for one in log_grid(0.002 * reach, 0.9 * reach, slow)
                        )
                        yield from cls._sinking(scene, joint, reach) if balanced else ()
                    if scene.observations.predict != "position" and not balanced:
                        most = min(float(np.max(load)), -float(np.min(load)))
                        yield from (
                            cls(joint, None, 0.05 * size, friction=f) for f in log_grid(0.05 * most, 0.9 * most, 4)
                        )

    @classmethod
    def _sinking(
        cls, scene: Scene, joint: str, reach: float, *, count: int = 4, shortest: float = 0.1
    ) -> Iterator[Self]:
        """Yield gaps of impulse up to `reach` that a link crosses by what a balance leaves of the weight, or lifts beyond it.

        In times from the shortest that shows between two motions to a share of the recording.

        Args:
            count: impulses, and as many times in which weight that is not balanced sinks the link through the
                gap.
            shortest: seconds of such a time at least: quicker than a motion begins and ends it might as well
                be thrown.
        """
        weight = scene.weight_load(joint)
        size = 0.0 if weight is None else float(np.sqrt(np.mean(weight**2)))
        if not size:
            return
        for impulse in log_grid(0.002 * reach, 0.9 * reach, count):
            for crossing in log_grid(shortest, 0.03 * duration(scene), count):
                share = 2.0 * impulse / (crossing * size)
                if share < 1.0:
                    yield from (
                        cls(joint, None, None, balanced=True, impulse=impulse, unborne=share, lifted=lifted)
                        for lifted in (False, True)
                    )

    def richer(self, scene: Scene, *, count: int = 4) -> Iterator[Self]:
        """Yield it with momentum, that lasts from less than a row to a good part of what a motion takes.

        Args:
            count: times that are tried for which the link's momentum lasts.
        """
        if self.impulse is not None and self.coasting is None:
            yield from (replace(self, coasting=T) for T in log_grid(0.5 * spacing(scene), 0.3, count))

    def follows(self, scene: Scene, channel: int) -> Follows:
        """Return what it follows: the joint, or the load that throws it from stop to stop, with another way back."""
        load = self.load(scene) if self.half_width is None else None
        if load is not None:
            return Follows("load", self.joint, memory=True, values=load)
        return Follows("position" if self.joint in scene.joint_names else "signal", self.joint, memory=True)

    def load(self, scene: Scene) -> Array | None:
        """Return the load (N,) that throws or drags the far side from stop to stop, N or N m; None where it is not known."""
        load = scene.inertia_load(self.joint) if self.balanced else scene.load(self.joint)
        if load is None or self.unborne is None:
            return load
        weight = scene.weight_load(self.joint)
        assert weight is not None, "known where the load of motion is"
        return load + (-self.unborne if self.lifted else self.unborne) * weight

    def at_work(self, scene: Scene, *, least: float = 2.0) -> bool:
        """Return whether the dead band exceeds the reading noise: one as narrow only makes the readings quieter.

        Args:
            least: standard deviations of a joint's readings below which a dead band of them is no play.
        """
        if self.half_width is None or self.joint not in scene.moved:
            return True
        return self.half_width > least * _reading_noise(scene, self.joint)

    def possible(self, scene: Scene, theta: Array, spread: Array) -> bool:
        """Return whether the link lies where what a robot's file says of its load takes it, not on the other side."""
        return not self.balanced or bool(theta[0] > -3.0 * spread[0])

    @property
    def freedom(self) -> int | None:
        """Number of free linear parameters, 0: all of a play is seen, or it is none; its width is searched."""
        return None if self.half_width is None else 0

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Return the share of the play, or half of it."""
        if self.half_width is None:
            return (Parameter("half_play", "rad or m"),)
        return (Parameter("share", "1", 0.0, expected=1.0),)

    def columns(self, scene: Scene) -> Columns:
        """Return the lost motion through the joint's port."""
        if self.half_width is None:
            load = self.load(scene)
            assert load is not None, "proposed only where there is a load"
            if self.impulse is not None and self.coasting is not None:
                placed = scene.gap("gap", load[:, None] / self.impulse, self.coasting)
                return through(scene, self.joint, [placed[:, 0]])
            if self.impulse is not None:
                given = _driven(scene, load)[:, None] / self.impulse
                return through(scene, self.joint, [(given - scene.play("play", given, 1.0))[:, 0]])
            assert self.transition is not None, "proposed with one"
            if self.friction is not None:
                # A bearing with dry friction F lets through P_F of its load: a play of it as wide as that.
                load = scene.play("bearing", load[:, None], self.friction)[:, 0]
            return through(scene, self.joint, [np.tanh(load / self.transition)])
        x = scene.q[:, [scene.joint_index(self.joint)]]
        start = scene.resting(f"joint.{self.joint}.position")
        return through(scene, self.joint, [(scene.play("play", x, self.half_width, start) - x)[:, 0]])
