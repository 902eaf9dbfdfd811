"""Units of joint efforts, judged by what the rigid model needs and by the limits of the URDF."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from galen_hw.kinematics import UrdfRobot
from galen_hw.physics.channels import joint_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.channels import compared
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.unit_tables import FORCES, TORQUES, units_of
from galen_hw.spatial import Array


class EffortUnits:
    """Tests joint efforts against what the rigid model needs: a factor of every joint that no load and no friction has."""

    KEY: ClassVar[str] = "effort_units"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark for all joints."""
        if seen.predict != "effort" or len(seen) < 50:
            return
        scene = compared(seen)
        if scene is None or not scene.clock or not np.isfinite(scene.q).all():
            return
        beyond = None if seen.simulation is not None else _beyond_limits(seen, scene)
        if beyond is not None:
            yield beyond
            return
        found = [
            (name, _slope(scene.simulated[:, c], scene.measured[:, c], _speed(scene, name)))
            for c, name in enumerate(scene.channels)
        ]
        known = [(name, s) for name, s in found if s is not None]
        # A wrist that carries hardly anything tells nothing: those have to speak that carry most of the arm.
        carried = np.var(scene.simulated, axis=0)
        told = [s is not None for _, s in found]
        if not known or np.sum(carried[told]) < CRITERIA.half * np.sum(carried):
            return
        slopes = np.array([s for _, s in known])
        low, high = 1.0 / CRITERIA.least_factor, CRITERIA.least_factor
        if np.all(slopes > high) or np.all((slopes < low) & (slopes > 0.0)):
            yield from self._all(seen, scene, known)
        elif seen.simulation is None:
            yield from self._single([name for name, _ in known], slopes)

    def _all(self, seen: Observations, scene: Scene, known: list[tuple[str, float]]) -> Iterator[Remark]:
        """Yield what a factor of every joint says: of the efforts, or of the model's masses."""
        names, slopes = tuple(name for name, _ in known), np.array([s for _, s in known])
        each = ", ".join(f"{joint_of(name)} {s:.3g}" for name, s in known)
        equal = float(np.max(np.abs(np.log(slopes / np.median(slopes))))) < CRITERIA.same_factor
        table = FORCES if all(scene.units[scene.channels.index(name)] == "N" for name in names) else TORQUES
        units = units_of(float(np.median(slopes)), table) if equal else []
        if not units and slopes[0] > 1.0 and (seen.simulation is not None or len(known) == 1):
            return  # somebody else's simulation may leave out most of an effort, and one joint carry what no model knows
        over = [c for c in scene.channels if (limit := _limit(seen, c)) and _reach(scene.simulated, scene, c) > limit]
        if over and seen.simulation is None:
            # What was measured is within the limits, or it would have been said.
            need, limit = _reach(scene.simulated, scene, over[0]), _limit(seen, over[0])
            what = f"the model needs {need:.4g} {scene.units[0]} at {over[0]}, beyond the joint's limit of {limit:.4g}"
            what += f"; efforts are, of that, {each}"
            todo = "give masses in kg (are they in g?) and inertias in kg m^2"
            yield Remark(self.KEY, f"the model is too heavy: {what}", todo, names, Action.REFUSED)
            return
        unit = "N" if table is FORCES else "N m"
        hint = f"are they in {' or '.join(units)}?" if units else "per mille of a rated torque, mA or counts?"
        whose = "what the model needs" if seen.simulation is None else "their simulation"
        masses = ", or the masses of the model in kg" if seen.simulation is None else ""
        yield Remark(
            self.KEY,
            f"efforts are not in {unit}: times {whose}, {each}; {hint}",
            f"give {unit}{masses}: times the rated torque, or the torque constant, of each motor",
            names,
            Action.REFUSED,
        )

    def _single(self, names: list[str], slopes: Array) -> Iterator[Remark]:
        """Yield a remark on the one column that is in another unit than all others: a load that nobody knows acts on more."""
        off = np.flatnonzero(np.abs(np.log(np.maximum(slopes, 1e-300))) > np.log(CRITERIA.least_factor))
        if len(off) != 1 or len(slopes) < 2 or slopes[off[0]] <= 0.0:
            return
        k = int(off[0])
        units = units_of(float(slopes[k]), TORQUES)
        hints = [f"in {' or '.join(units)}"] if units else []
        if not units and slopes[k] < 1.0 / CRITERIA.least_factor**2:
            hints = [f"at the motor's side of a gear of {1.0 / slopes[k]:.3g}", "does a spring carry it"]
        if hints:
            what = f"{names[k]} is {slopes[k]:.3g} times what the model needs, the others are not: is it {', or '.join(hints)}?"
            yield Remark(self.KEY, what, "give N m at the joint", (names[k],), Action.REFUSED)


def _beyond_limits(seen: Observations, scene: Scene) -> Remark | None:
    """Return a remark on efforts that no motor has: beyond limits of the URDF that the model itself keeps.

    Limits that the model breaks are placeholders, or the model is wrong: they say nothing of the efforts.
    """
    limits = {name: limit for name in scene.channels if (limit := _limit(seen, name))}
    if any(_reach(scene.simulated, scene, name) > limit for name, limit in limits.items()):
        return None
    rows = []
    for name, limit in limits.items():
        values = seen.columns[name][np.isfinite(seen.columns[name])]
        # A knock or a glitch is short; a unit shows in all that is large.
        large = float(np.quantile(np.abs(values - np.median(values)), 0.95)) if len(values) else 0.0
        if large > CRITERIA.least_factor * limit:
            rows.append((name, f"{name} reaches {large:.4g}, limit {limit:.4g}"))
    if not rows:
        return None
    names, each = (tuple(x) for x in zip(*rows, strict=True))
    what = f"efforts are far beyond the joints' limits in the URDF: {', '.join(each)}"
    what += "; N mm, per mille of a rated torque, mA or counts?"
    return Remark(EffortUnits.KEY, what, "give N m, or N of a joint that slides", names, Action.REFUSED)


def _limit(seen: Observations, channel: str) -> float:
    """Return what the URDF says that a joint's motor can do, N m or N; 0 where it says nothing."""
    robot, name = seen.belief.robot, joint_of(channel)
    if not isinstance(robot, UrdfRobot) or not robot.model.existJointName(name):
        return 0.0
    limit = float(robot.model.effortLimit[robot.model.joints[robot.model.getJointId(name)].idx_v])
    return limit if np.isfinite(limit) and limit > 0.0 else 0.0


def _reach(values: Array, scene: Scene, channel: str) -> float:
    """Return the largest size of a channel of values (N, C)."""
    return float(np.max(np.abs(values[:, scene.channels.index(channel)])))


def _speed(scene: Scene, channel: str) -> Array:
    return scene.rates[0][:, scene.joint_index(joint_of(channel))]


def _slope(expected: Array, measured: Array, speed: Array) -> float | None:
    """Return the slope of measured over expected given friction of any size; None where the two cannot be told apart."""
    good = np.isfinite(expected) & np.isfinite(measured) & np.isfinite(speed)
    if good.sum() < 50 or np.std(expected[good]) == 0.0:
        return None
    x, y, v = expected[good], measured[good], speed[good]
    others = beside_friction(v)
    own = x - others @ np.linalg.lstsq(others, x, rcond=None)[0]
    rest = y - others @ np.linalg.lstsq(others, y, rcond=None)[0]
    if np.std(own) < 0.05 * np.std(x) or np.std(rest) == 0.0:
        return None
    if float(np.corrcoef(own, rest)[0, 1]) < 0.8:
        return None
    return float(np.sum(own * rest) / np.sum(own**2))


def beside_friction(speed: Array) -> Array:
    """Return (N, 4) a constant, dry and viscous friction of a joint of speed (N,), and dry friction that holds where it rests."""
    small = 0.05 * max(float(np.std(speed)), 1e-12)
    moves = np.flatnonzero(np.abs(speed) > small)
    last = np.searchsorted(moves, np.arange(len(speed)), side="right") - 1
    held = np.sign(speed[moves[np.maximum(last, 0)]]) if len(moves) else np.zeros_like(speed)
    return np.column_stack([np.ones_like(speed), np.tanh(speed / small), speed, held])
