"""Effects of a tool's file, sample by sample: the same classes as in the diagnosis, on scenes of one row."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot
from galen_hw.physics.effects.interactions import Placed, compound
from galen_hw.physics.effects.registry import effect_of
from galen_hw.physics.effects.terms import is_dated, why_not_live
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.scenes.wrench import WRENCH, WrenchScene
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.operators.stateful import Memory


class Sample(Protocol):
    """What a stream looks at: times of the wrench, joint positions, and the prediction (6,) of the rigid bodies."""

    @property
    def t_ns(self) -> int:
        """Monotonic clock, ns."""

    @property
    def timestamp(self) -> float:
        """Seconds since the epoch."""

    @property
    def q(self) -> tuple[float, ...]:
        """Joint positions in the order given to `build_streams`."""

    @property
    def predicted(self) -> Sequence[float]:
        """Force, then torque."""


class EffectStream:
    """Effects that stand beside each other, with their memory.

    Args:
        effects: the pieces of physics with their linear parameters (k,); those of the wall clock (`is_dated`) by themselves.
        dated: they go by the wall clock.
        joint_names: order of the joints in the samples.
        belief: robot, and for errors of geometry the bodies.
    """

    def __init__(
        self, effects: Sequence[Placed], joint_names: Sequence[str], belief: Belief, *, dated: bool = False
    ) -> None:
        self.effects, self.belief, self._dated = effects, belief, dated
        self._columns = [f"joint.{name}.position" for name in joint_names]
        self._order = [list(joint_names).index(n) for n in belief.robot.joint_names] if belief.robot else []
        self._memory: Memory = {}
        self._last: tuple[float, Array, Array] | None = None

    def step(self, sample: Sample) -> Array:
        """Return what (6,) the effects add to the reading, sensor frame, N and N m."""
        time, q = sample.t_ns * 1e-9, np.asarray(sample.q, dtype=float)
        rate = self._rates(time, q)
        if self._dated:
            time = sample.timestamp
        return self.at(time, q, rate, np.zeros_like(rate), np.asarray(sample.predicted, dtype=float))

    def at(self, time: float, q: Array, dq: Array, ddq: Array, predicted: Array) -> Array:
        """Return the same with joint rates (n,) and their rates that are known."""
        columns = {name: q[i : i + 1] for i, name in enumerate(self._columns)}
        columns["time"] = np.array([time])
        simulated = {name: predicted[i : i + 1] for i, name in enumerate(WRENCH)}
        rates = tuple(x[self._order][None] if self._order else x[None] for x in (dq, ddq))
        observations = Observations("wrench", columns, simulated, self.belief)
        scene = WrenchScene(observations, rates=(rates[0], rates[1]), memory=self._memory)
        return np.asarray(np.sum(compound(scene, self.effects), axis=0)[0])

    def _rates(self, time: float, q: Array, *, constant: float = 0.02) -> Array:
        """Return joint rates (n,) by differences, smoothed.

        Args:
            constant: s, over which joint rates are smoothed for the effects that need them.
        """
        if self._last is None:
            self._last = (time, q, np.zeros_like(q))
        before, old, rate = self._last
        step = time - before
        if step > 0.0:
            share = -np.expm1(-step / constant)
            rate = rate + share * ((q - old) / step - rate)
            self._last = (time, q, rate)
        return rate


def build_streams(
    terms: Sequence[Any],
    *,
    joint_names: Sequence[str],
    robot: Robot | None,
    belief: Belief | None = None,
) -> list[EffectStream]:
    """Return one stream for all terms that the machine meets together, and one for each that goes by the wall clock.

    Args:
        terms: objects or mappings with `effect` and `parameters`, as `galen-hw diagnose --save-model` writes them.
        joint_names: order of the joints in the samples.
        robot: that carries the sensor.
        belief: bodies and gravity; needed by errors of geometry alone.

    Raises:
        UsageError: an effect that is not known, is not about wrenches, or cannot be predicted live.
    """
    known = replace(belief or Belief(), robot=robot)
    each = [_plain(term) for term in terms]
    placed = [(_placed(term, joint_names, known), is_dated(term)) for term in each]
    together = [one for one, dated in placed if not dated]
    streams = [EffectStream(together, joint_names, known)] if together else []
    return streams + [EffectStream([one], joint_names, known, dated=True) for one, dated in placed if dated]


def _plain(term: Any) -> dict[str, Any]:
    if isinstance(term, Mapping):
        return dict(term)
    return {"effect": term.effect, "parameters": dict(term.parameters)}


def _placed(term: dict[str, Any], joint_names: Sequence[str], belief: Belief) -> Placed:
    key, parameters = term["effect"], term["parameters"]
    where = f"terms: {key}"
    why = why_not_live(term)
    if why:
        raise UsageError(f"cannot be predicted live: {why}", where=where, todo="leave the term out")
    effect = effect_of(term)
    observations = Observations("wrench", {"time": np.zeros(1), **{n: np.zeros(1) for n in WRENCH}}, None, belief)
    columns = dict(observations.columns) | {f"joint.{n}.position": np.zeros(1) for n in joint_names}
    scene = WrenchScene(Observations("wrench", columns, None, belief), rates=_still(belief))
    try:
        return effect, effect.theta_of(scene, parameters)
    except KeyError as error:
        raise UsageError(f"no parameter {error}", where=where, todo="save the model again") from error


def _still(belief: Belief) -> tuple[Array, Array]:
    n = len(belief.robot.joint_names) if belief.robot is not None else 0
    return np.zeros((1, n)), np.zeros((1, n))
