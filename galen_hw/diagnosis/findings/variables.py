"""Variables that a mismatch may depend on: positions, speeds and loads of joints, forces, temperatures."""

from dataclasses import dataclass

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.physics.scenes.wrench import WrenchScene
from galen_hw.spatial import Array


@dataclass(frozen=True, eq=False)
class Variable:
    """One thing that the excess may depend on.

    Args:
        name: as in the answer, e.g. "joint.tilt.position"; unit: of the values.
        about: the joint or column that it belongs to.
        values: (M,) on the bench's rows.
    """

    name: str
    unit: str
    about: str
    values: Array

    @property
    def label(self) -> str:
        """Name for people: "tilt position"."""
        return self.name.removeprefix("joint.").replace(".", " ")

    def span(self, low: float, high: float, *, outside: float = 0.02) -> str:
        """Return a range in words: from, above, below, or the direction where it is all of one sign.

        Args:
            low, high: of the range.
            outside: share of the values; a range beyond which fewer lie is said to be open there.
        """
        values, joint = self.values, self.about
        at_bottom, at_top = np.mean(values < low) < outside, np.mean(values > high) < outside
        reach = float(np.ptp(values))
        if self.name.endswith(".velocity") and (at_top or at_bottom):
            edge = low if at_top else high
            if abs(edge) < 0.05 * reach:
                return f"{joint} moves {'forward' if at_top else 'backward'}"
        if at_top != at_bottom:
            return f"{self.name} is {'above' if at_top else 'below'} {(low if at_top else high):.3g} {self.unit}"
        return f"{self.name} is from {low:.3g} to {high:.3g} {self.unit}"


def variables(bench: Bench) -> list[Variable]:
    """Return all known variables of the recording's rows that vary."""
    scene, average, out = bench.scene, bench.rows.average, []
    for joint in scene.moved:
        j, (unit, load_unit) = scene.joint_index(joint), scene.joint_units(joint)
        out.append(Variable(f"joint.{joint}.position", unit, joint, average(scene.q[:, j])))
        if scene.clock:
            speed = average(scene.rates[0][:, j])
            out.append(Variable(f"joint.{joint}.velocity", f"{unit}/s", joint, speed))
            out.append(Variable(f"joint.{joint}.speed", f"{unit}/s", joint, np.abs(speed)))
        load = scene.load(joint)
        if load is not None:
            out.append(Variable(f"joint.{joint}.load", load_unit, joint, average(load)))
    out += _columns(bench) + ([] if scene.moved else _gravity(bench))
    return [v for v in out if np.isfinite(v.values).all() and np.ptp(v.values) > 0.0]


def _columns(bench: Bench) -> list[Variable]:
    """Return temperatures, the magnitude of the applied force, and other recorded covariates."""
    columns, average, out = bench.scene.observations.columns, bench.rows.average, []
    for name, values in columns.items():
        unit = "degC" if name.startswith("temperature.") else ""
        if name.startswith(("temperature.", "covariate.")) and np.isfinite(values).all():
            out.append(Variable(name, unit, name, average(np.asarray(values, dtype=float))))
    force = [columns[n] for n in (f"applied.force.{a}" for a in "xyz") if n in columns]
    if len(force) == 3 and np.isfinite(force).all():
        out.append(Variable("applied.force", "N", "applied.force", average(np.linalg.norm(force, axis=0))))
    return out


def _gravity(bench: Bench) -> list[Variable]:
    """Return gravity in the sensor's frame, where only the sensor's orientation is known."""
    scene = bench.scene
    if not isinstance(scene, WrenchScene):
        return []
    seen = bench.rows.average(gravity_in_sensor(scene.R, scene.belief.gravity))
    return [Variable(f"gravity.sensor.{a}", "m/s^2", "gravity", seen[:, i]) for i, a in enumerate("xyz")]
