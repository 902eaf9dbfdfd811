"""Units of a wrench and of the tool's own numbers, judged by the simulation for whole groups at once."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, with_columns
from galen_hw.premises.channels import slope
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import scaled
from galen_hw.premises.unit_tables import FORCES, TORQUES, units_of
from galen_hw.premises.wrench_reading import FORCE, TORQUE, at_rest, comparable, lever_fit, readings
from galen_hw.spatial import Array


def _of_one_system(forces: list[str], torques: list[str]) -> tuple[list[str], list[str]]:
    """Return the units of a force (none: N) and a torque that are one unit and that times a length, where there are such."""
    pairs = [(f, t) for f in forces or ["N"] for t in torques if t.startswith(f"{f} ")]
    if not pairs:
        return forces, torques
    force, torque = pairs[0]
    return [force] if forces else [], [torque]


class ToolSize:
    """Tests the tool's own numbers: no tool is metres long."""

    KEY: ClassVar[str] = "tool_size"
    STAGE: ClassVar[Stage] = Stage.UNITS

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark for a centre of mass or a tip that lies metres off, and for an inertia of a tool as wide."""
        for what, place in (("com", seen.belief.tool.com), ("tip", seen.belief.tip)):
            if (size := float(np.linalg.norm(place))) > CRITERIA.longest_lever:
                says = f"tool.{what} lies {size:.4g} m from the sensor: is it in mm?"
                yield Remark(self.KEY, says, "give metres in recording.json", (), Action.REFUSED)
        tool = seen.belief.tool
        largest = float(np.max(np.linalg.eigvalsh(tool.inertia)))
        if 0.0 < tool.mass * CRITERIA.longest_lever**2 < largest:
            away = np.sqrt(largest / tool.mass)
            says = f"tool.inertia of {largest:.4g} kg m^2 is {tool.mass:.4g} kg at {away:.3g} m: is it in kg cm^2 or kg mm^2?"
            yield Remark(self.KEY, says, "give kg m^2 about the centre of mass in recording.json", (), Action.REFUSED)


@dataclass(frozen=True)
class _Weighed:
    """What a wrench says of the tool that hangs on it.

    Args:
        mass: kg; com: (3,) m, by force and torque as recorded.
        force_scale, torque_scale: measured over believed; 0 where the tool is not known.
    """

    mass: float
    com: Array
    force_scale: float
    torque_scale: float


class WrenchUnits:
    """Tests a wrench's units by the tool that recording.json names, and by the lever that no tool has.

    Factors are those of units, for force and torque together. They are certain where what they leave aside cannot be: a centre of
    mass metres away. A tool of a tenth of the named weight is possible: then both are said, and nothing is fitted.
    """

    KEY: ClassVar[str] = "wrench_units"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark for single columns, then one for the whole wrench."""
        if seen.predict != "wrench" or not seen.has_all(*FORCE, *TORQUE):
            return
        some = at_rest(comparable(seen, CRITERIA.most_rows))
        if len(some) < CRITERIA.fewest_vectors:
            return
        for remark in self._single(seen, some):
            yield remark
            if remark.repaired is None:
                return
            seen, some = remark.repaired, at_rest(comparable(remark.repaired, CRITERIA.most_rows))
        weighed = _weighed(some)
        if weighed is not None:
            yield from self._whole(seen, weighed)

    def _single(self, seen: Observations, some: Observations) -> Iterator[Remark]:
        """Yield a remark on columns that are not in the unit of the other two of their group."""
        expected = next(iter(readings(some))).expected
        groups = [(FORCE, expected, FORCES)]
        if some.belief.tool.mass > 0.0 and some.simulation is None:
            groups.append((TORQUE, scene_of(some).simulated[:, 3:], TORQUES))
        for names, x, table in groups:
            scales = [slope(x[:, k], some.columns[name]) for k, name in enumerate(names)]
            known = [k for k, s in enumerate(scales) if s is not None and s > 0.0]
            if len(known) < 3:
                continue
            values = np.array([float(s) for s in scales if s is not None])
            for k in known:
                others = np.delete(values, k)
                ratio = float(values[k] / np.mean(others))
                alike = abs(np.log(others[0] / others[1])) < CRITERIA.same_factor * 2.0
                if not alike or 1.0 / CRITERIA.least_factor < ratio < CRITERIA.least_factor:
                    continue
                what = f"{names[k]} is {values[k]:.4g} times its simulation, the other two axes {np.mean(others):.3g} times"
                units = units_of(ratio, table)
                if not units:
                    yield Remark(self.KEY, f"{what}: in another unit?", "give N and N m", (names[k],), Action.REFUSED)
                    return
                factor = table[units[0]]
                seen = with_columns(seen, {names[k]: seen.columns[names[k]] / factor})
                yield Remark(self.KEY, f"{what}: it is in {' or '.join(units)}", "", (names[k],), Action.REPAIRED, seen)

    def _whole(self, seen: Observations, weighed: _Weighed) -> Iterator[Remark]:
        lever = float(np.linalg.norm(weighed.com))
        named = weighed.force_scale > 0.0
        forces = units_of(weighed.force_scale, FORCES) if named else []
        torques = units_of(weighed.torque_scale, TORQUES) if named and weighed.torque_scale > 0.0 else []
        off = named and not 1.0 / CRITERIA.least_factor < weighed.force_scale < CRITERIA.least_factor
        bent = named and weighed.torque_scale > 0.0
        # A lever may be any: only the factor of a unit is one.
        bent = bent and bool(torques) and not 1.0 / CRITERIA.least_factor < weighed.torque_scale < CRITERIA.least_factor
        columns = (*FORCE, *TORQUE)
        if lever > CRITERIA.longest_lever:
            text = f"the torque says that the centre of mass lies {lever:.3g} m away"
            if named and (forces or not off) and torques:
                yield self._in_units(seen, text, forces if off else [], torques)
                return
            units = [u for u in ("N mm", "N cm") if 1e-3 < lever / TORQUES[u] < 1.0]
            hint = f"is it in {' or '.join(units)}?" if units else "it is not in N m"
            yield Remark(
                self.KEY, f"wrench.torque is {lever:.3g} m times the force: {hint}", "give N m", TORQUE, Action.REFUSED
            )
        elif off or bent:
            mass = seen.belief.tool.mass
            says = [
                f"the tool weighs {weighed.mass:.4g} kg, {weighed.force_scale:.3g} times the {mass:.4g} kg that are named"
            ]
            if bent and not off:
                says = [f"the torque is {weighed.torque_scale:.3g} times what the named tool has"]
            names = [f"force in {u}" for u in forces if off] + [f"torque in {u}" for u in torques if bent]
            hint = f"{says[0]}: {'is the ' + ', the '.join(names) + '?' if names else 'another tool, or other units?'}"
            yield Remark(self.KEY, hint, "give N and N m, or name the tool that hangs there", columns, Action.REFUSED)

    def _in_units(self, seen: Observations, text: str, forces: list[str], torques: list[str]) -> Remark:
        forces, torques = _of_one_system(forces, torques)
        columns = {name: seen.columns[name] / TORQUES[torques[0]] for name in TORQUE}
        columns |= {name: seen.columns[name] / FORCES[forces[0]] for name in FORCE if forces}
        what = f"{text}: torque is in {' or '.join(torques)}" + (f", force in {' or '.join(forces)}" if forces else "")
        return Remark(
            self.KEY, what, "", (*FORCE, *TORQUE) if forces else TORQUE, Action.REPAIRED, with_columns(seen, columns)
        )


def _weighed(some: Observations) -> _Weighed | None:
    """Return what hangs on the sensor by the wrench; None where gravity is not most of what it reads."""
    one = next(iter(readings(some)))
    plain = one.plain
    if plain.rank < 2 or plain.unexplained > CRITERIA.gross_left or plain.Q[0, 0] < 0.0 or some.simulation is not None:
        return None
    torque = some.matrix(*TORQUE)
    com, _ = lever_fit(one.force, torque)
    tool = some.belief.tool
    mass = sum(body.mass for body in some.belief.hanging)
    if tool.mass <= 0.0:
        return _Weighed(plain.scale, com, 0.0, 0.0)
    expected = scene_of(some).simulated[:, 3:]
    turned = scaled(expected, torque)
    fits = turned.unexplained <= CRITERIA.gross_left and turned.Q[0, 0] > 0.0 and turned.rank >= 2
    return _Weighed(plain.scale, com, plain.scale / mass, turned.scale if fits else 0.0)
