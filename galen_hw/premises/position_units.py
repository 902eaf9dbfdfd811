"""Units of joint positions: degrees, revolutions or mm, by the robot's limits, measured velocities and the simulation."""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, joint_positions, known_rows, with_columns
from galen_hw.premises.channels import compared, slope
from galen_hw.premises.clock import travelled
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.joints import joint_columns, wrong_velocity
from galen_hw.premises.sampling import compared_names, measured
from galen_hw.premises.unit_tables import JOINT_ANGLES, JOINT_LENGTHS, TURN
from galen_hw.premises.wrench_reading import at_rest, readings
from galen_hw.spatial import Array


class PositionUnits:
    """Tests joint positions against the robot's limits: degrees, revolutions or millimetres, for the whole group at once."""

    KEY: ClassVar[str] = "position_units"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark for revolute joints and one for prismatic ones; repaired where one unit alone fits all limits."""
        robot = seen.belief.robot
        if seen.predict == "position" and (remark := self._beside_simulation(seen)) is not None:
            yield remark
            return
        if robot is None:
            yield from self._by_size(seen)
            return
        # A prismatic joint's limits are metres, mostly below one: told apart by what the robot itself says.
        for slides, units in ((False, JOINT_ANGLES), (True, JOINT_LENGTHS)):
            joints = [k for k, name in enumerate(robot.joint_names) if seen.belief.slides(name) is slides]
            names = [f"joint.{robot.joint_names[k]}.position" for k in joints]
            present = [(n, k) for n, k in zip(names, joints, strict=True) if n in seen.columns]
            beyond = [
                (n, k)
                for n, k in present
                if _beyond(seen.columns[n], robot.lower[k], robot.upper[k], slides=slides) > 0.5
            ]
            if not beyond:
                moving = [robot.joint_names[k] for _, k in present]
                remark = self._by_velocity(seen, moving, units) or self._by_simulation(seen, moving, units)
                if remark is not None and remark.repaired is not None:
                    seen = remark.repaired
                    yield remark
                continue
            fitting = [
                (unit, f)
                for unit, f in units.items()
                if f > 1.0
                and all(
                    _beyond(seen.columns[n] / f, robot.lower[k], robot.upper[k], slides=slides) <= 0.05
                    for n, k in present
                )
            ]
            name, k = beyond[0]
            reach = float(seen.columns[name][np.nanargmax(np.abs(seen.columns[name]))])
            what = f"{name} reaches {reach:.4g}, far beyond the joint's limits of {robot.lower[k]:.3g} to {robot.upper[k]:.3g}"
            moving = [robot.joint_names[k] for _, k in present]
            by_velocity = self._by_velocity(seen, moving, dict(fitting)) if len(fitting) > 1 else None
            if by_velocity is not None and by_velocity.repaired is not None:
                seen = by_velocity.repaired
                yield by_velocity
                continue
            chosen = _unit_told(seen, moving, fitting) if len(fitting) != 1 else fitting[0][0]
            if chosen:
                columns = _scaled(seen, moving, units[chosen])
                seen = with_columns(seen, columns)
                yield Remark(self.KEY, f"{what}: joints are in {chosen}", "", tuple(columns), Action.REPAIRED, seen)
            else:
                hint = " or ".join(unit for unit, _ in fitting) or ("mm" if slides else "degrees")
                yield Remark(self.KEY, f"{what}: is it in {hint}?", "give rad and m", (name,), Action.REFUSED)

    def _beside_simulation(self, seen: Observations) -> Remark | None:
        """Return a remark on compared positions that are all the same unit's factor of their simulation."""
        scene = compared(seen)
        if scene is None or not np.isfinite(scene.simulated).all():
            return None
        slopes = [slope(x, y) for x, y in zip(scene.simulated.T, scene.measured.T, strict=True)]
        known = [abs(s) for s in slopes if s is not None]
        units = (JOINT_LENGTHS if set(scene.units) == {"m"} else JOINT_ANGLES).items()
        for unit, factor in units:
            if known and all(abs(np.log(s / factor)) < CRITERIA.same_factor for s in known):
                joints = [joint_of(name) for name in scene.channels]
                columns = {n: v for n, v in _scaled(seen, joints, factor).items() if not n.endswith(".command")}
                what = f"positions are {known[0]:.4g} times their simulation: they are in {unit}"
                return Remark(self.KEY, what, "", tuple(columns), Action.REPAIRED, with_columns(seen, columns))
        return None

    def _by_velocity(self, seen: Observations, joints: Sequence[str], units: Mapping[str, float]) -> Remark | None:
        """Return a remark where velocities of all joints, in SI, are the change of positions in another unit."""
        scales = [s for joint in joints if (s := _velocity_scale(seen, joint)) is not None]
        if len(scales) < 2:
            return None
        off = {u: float(np.max(np.abs(np.log(np.array(scales) * f)))) for u, f in units.items()}
        unit = min(off, key=lambda u: off[u])
        if off[unit] > CRITERIA.same_factor:
            return None
        columns = _scaled(seen, joints, units[unit])
        what = f"velocities of {len(scales)} joints are {float(np.median(scales)):.4g} times the change of the position"
        repaired = with_columns(seen, columns)
        return Remark(self.KEY, f"{what}: joints are in {unit}", "", tuple(columns), Action.REPAIRED, repaired)

    def _by_simulation(self, seen: Observations, joints: Sequence[str], units: Mapping[str, float]) -> Remark | None:
        """Return a remark where the simulation follows in another unit, unlike in the named one: revolutions break no limit."""
        if not joints:
            return None
        shares = {"": _shares(seen)}
        if float(np.mean(shares[""])) <= CRITERIA.gross_left:
            return None
        shares |= {u: _shares(with_columns(seen, _scaled(seen, joints, f))) for u, f in units.items()}
        # What no unit explains (friction alone, noise) says nothing of units.
        told = np.min(list(shares.values()), axis=0) < CRITERIA.half
        left = {u: float(np.mean(x[told])) if told.any() else 1.0 for u, x in shares.items()}
        plain = left.pop("")
        unit = min(left, key=lambda u: left[u])
        if left[unit] > min(CRITERIA.gross_left, CRITERIA.gross_gain * plain):
            return None
        columns = _scaled(seen, joints, units[unit])
        what = f"the simulation explains {1.0 - plain:.0%} of what is compared, and {1.0 - left[unit]:.0%} with joints in {unit}"
        return Remark(
            self.KEY, f"{what}: joints are in {unit}", "", tuple(columns), Action.REPAIRED, with_columns(seen, columns)
        )

    def _by_size(self, seen: Observations) -> Iterator[Remark]:
        """Yield what can be said without a robot, whose limits nobody knows: only what no joint reaches."""
        for name in joint_columns(seen, "position"):
            values = seen.columns[name]
            if seen.predict == "wrench" and np.isfinite(values).any() and float(np.nanmax(np.abs(values))) > 4.0 * TURN:
                what = f"{name} reaches {float(np.nanmax(np.abs(values))):.4g}: is it in degrees or mm?"
                yield Remark(self.KEY, what, "give rad and m", (name,))


def _velocity_scale(seen: Observations, joint: str) -> float | None:
    """Return a joint's measured velocity over the change of its position; None where the two are not one signal."""
    q, v = (seen.columns.get(f"joint.{joint}.{kind}") for kind in ("position", "velocity"))
    found = None if q is None or v is None else travelled(seen, q, v)
    if found is None or min(map(np.ptp, found)) == 0.0 or np.corrcoef(*found)[0, 1] < CRITERIA.one_signal:
        return None
    change, told = found
    return float(np.sum(told * change) / np.sum(change**2))


def _beyond(values: Array, low: float, high: float, *, slides: bool) -> float:
    """Return how far values go beyond limits over their span; 0 where there are none. A whole turn more is the same angle.

    Of each value by itself: angles read between -pi and pi lie a turn off in a part of the rows.
    """
    there = values[np.isfinite(values)]
    span = high - low
    if not len(there) or not np.isfinite(span) or span <= 0.0:
        return 0.0
    turned = there + np.array([[0.0]] if slides else [[-TURN], [0.0], [TURN]])
    return float(np.max(np.min(np.maximum(np.maximum(turned - high, low - turned), 0.0), axis=0))) / span


def _scaled(seen: Observations, joints: Sequence[str], factor: float) -> dict[str, Array]:
    """Return the columns of joints in another unit; velocities too, unless they are already those of the position so read."""
    out = {}
    for joint in joints:
        for kind in ("position", "command", "velocity"):
            name = f"joint.{joint}.{kind}"
            if name in seen.columns:
                out[name] = seen.columns[name] / factor
        q, v = (f"joint.{joint}.{kind}" for kind in ("position", "velocity"))
        if v in out and q in out and seen.time is not None and not wrong_velocity(seen, out[q], seen.columns[v]):
            del out[v]
    return out


def _unit_told(seen: Observations, joints: Sequence[str], fitting: Sequence[tuple[str, float]]) -> str:
    """Return the unit in which the simulation follows what is compared; empty where it cannot tell."""
    left = sorted((_unexplained(with_columns(seen, _scaled(seen, joints, f))), unit) for unit, f in fitting)
    return left[0][1] if left and left[0][0] < CRITERIA.half * min(1.0, left[1][0]) else ""


def _unexplained(seen: Observations) -> float:
    """Return the mean share of variance that the simulation at rest does not explain; 1 where nothing is known."""
    return float(np.mean(_shares(seen)))


def _shares(seen: Observations) -> Array:
    """Return the unexplained shares by channel (K,); ones where nothing is known."""
    robot = seen.belief.robot
    assert robot is not None, "asked only with a robot"
    seen = measured(seen)
    driven = joint_positions(seen)
    rows = known_rows(seen, (*compared_names(seen), *driven), CRITERIA.most_rows)
    unknown = np.ones(3 if seen.predict == "pose" else len(compared_names(seen)))
    if len(rows) < CRITERIA.fewest_vectors or len(driven) < len(robot.joint_names):
        return unknown
    some = at_rest(seen.taken(rows))
    if seen.predict == "wrench" and not some.belief.hanging:
        return np.array([next(iter(readings(some))).plain.unexplained])
    scene = scene_of(some)
    if not np.isfinite(scene.simulated).all():
        return unknown
    # An orientation is measured from the simulated one: its place says it all.
    width = 3 if seen.predict == "pose" else len(scene.channels)
    y, left = scene.measured[:, :width], (scene.measured - scene.simulated)[:, :width]
    return np.asarray(np.minimum(np.var(left, axis=0) / np.maximum(np.var(y, axis=0), 1e-300), 1.0))
