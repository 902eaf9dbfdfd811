"""Wrong premises: units, signs and axes mixed up, dead channels. Any of them makes every finding worthless."""

from itertools import permutations, product
from typing import TYPE_CHECKING, Final

import numpy as np

from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.guards import Premise

FACTORS: Final = {1000.0: "milli", 57.29578: "degrees", 9.80665: "kilograms-force", 4.44822: "pounds-force"}
HEAVIER: Final = 20.0
"""Times its believed weight that a tool could be."""
ALIKE: Final = 0.95
"""Correlation from which two signals are one signal in another scale."""
FAR: Final = 0.15
"""Share of the squared error that is left when the right axes are taken, at most."""
LONGEST_LEVER_M: Final = 5.0
LONGEST_TOOL_M: Final = 2.5
ROWS_OF_MOTION: Final = 200
SLOW_S: Final = 0.5
SMOOTH: Final = 0.02
"""Mean squared step from row to row over the variance, of a joint that moves smoothly."""
DEAD: Final = 0.05
"""Of the liveliest simulated channel of its unit: a channel that should move so much cannot stand still."""


def joints(out: "Premise") -> None:
    """Positions against the joints' limits, velocities against the change of positions."""
    scene = out.scene
    robot, time = scene.belief.robot, scene.time
    for name in scene.observations.joint_names:
        q = scene.observations.columns.get(f"joint.{name}.position")
        v = scene.observations.columns.get(f"joint.{name}.velocity")
        if q is None or not np.isfinite(q).any():
            continue
        if robot is not None:
            place = robot.joint_names.index(name)
            low, high = float(robot.lower[place]), float(robot.upper[place])
            beyond = max(float(np.nanmax(q)) - high, low - float(np.nanmin(q)))
            if beyond > 0.5 * (high - low) > 0.0:
                reached = float(q[np.nanargmax(np.abs(q))])
                line = f"joint.{name}.position reaches {reached:.4g}, far beyond the joint's limits of {low:.3g} to {high:.3g}"
                out.refuse(f"joint.{name}.position", f"{line}: is it in degrees or mm?")
        if v is not None and scene.clock:
            _velocity(out, name, time, q, v)


def clock(out: "Premise") -> None:
    """Seconds from row to row in which an arm would have been anywhere, were they seconds."""
    scene = out.scene
    if not scene.clock or len(scene) < ROWS_OF_MOTION:
        return
    step = float(np.median(np.diff(scene.time)))
    moving = [scene.q[:, scene.joint_index(name)] for name in scene.moved]
    smooth = [float(np.mean(np.diff(q) ** 2)) < SMOOTH * float(np.var(q)) for q in moving]
    if step >= SLOW_S and any(smooth):
        out.refuse("time", f"time advances by {step:.4g} s a row while the joints move smoothly: is it in ms?")


def bodies(out: "Premise") -> None:
    """No tool is metres long."""
    belief = out.scene.belief
    for what, place in (("com", belief.tool.com), ("tip", belief.tip)):
        if (size := float(np.linalg.norm(place))) > LONGEST_TOOL_M:
            out.refuse("tool", f"tool.{what} lies {size:.4g} m from the sensor: is it in mm?")


def _velocity(out: "Premise", name: str, time: Array, q: Array, v: Array) -> None:
    """A measured velocity is the change of the position."""
    inside = np.ones(len(time) - 1, dtype=bool)
    for part in out.scene.segments[1:]:
        inside[part.start - 1] = False
    change = np.diff(q)[inside] / np.diff(time)[inside]
    between = 0.5 * (v[1:] + v[:-1])[inside]
    good = np.isfinite(change) & np.isfinite(between)
    scale = _scale(between[good], change[good])
    if scale is None:
        return
    if -1.25 < scale < -0.8:
        out.refuse(f"joint.{name}.velocity", f"joint.{name}.velocity has the opposite sign of its position's change")
    for factor in (1000.0, 57.29578):
        if _near(scale, factor):
            line = f"joint.{name}.velocity is {scale:.3g} times the change of its position"
            out.refuse(f"joint.{name}.velocity", f"{line}: is one in degrees or mm, or time in ms?")


def channels(out: "Premise") -> None:
    """Compared channels against their simulation."""
    group = out.scene.observations.predict
    _dead(out)
    if group == "wrench":
        _axes(out, (("wrench.force", slice(0, 3)), ("wrench.torque", slice(3, 6))))
        _lever(out)
    elif group == "pose":
        _axes(out, (("pose.position", slice(0, 3)),))
    elif group in ("effort", "position"):
        _signs(out)
    _units(out)


def _dead(out: "Premise") -> None:
    """A channel that stands still while its simulation moves."""
    scene = out.scene
    moves = np.ptp(scene.simulated, axis=0)
    for c, name in enumerate(scene.channels):
        if np.ptp(scene.measured[:, c]) > 0.0:
            continue
        kin = [d for d, unit in enumerate(scene.units) if unit == scene.units[c]]
        if moves[c] > DEAD * max(moves[d] for d in kin):
            still = f"{name} stands still at {scene.measured[0, c]:.4g} while its simulation moves by {moves[c]:.3g}"
            out.refuse(name, f"{still} {scene.units[c]}: the channel is dead")
        else:
            out.notes.append(f"{name} is constant: the channel may be dead")


def _axes(out: "Premise", blocks: tuple[tuple[str, slice], ...]) -> None:
    """Whether another order or sign of the axes meets the simulation far better than the one that is named."""
    scene = out.scene
    y, s = (x - x.mean(axis=0) for x in (scene.measured, scene.simulated))
    for name, block in blocks:
        plain = float(np.sum((y[:, block] - s[:, block]) ** 2))
        best, text = _best_axes(y[:, block], s[:, block])
        if best < FAR * plain and text:
            for axis in "xyz":
                out.channels.append(f"{name}.{axis}")
            out.wrong.append(f"{name}: {text}; the axes or signs are probably mixed up")


def _best_axes(y: Array, s: Array) -> tuple[float, str]:
    """Least squared error over all orders and signs of the axes, and how it reads; no text for the plain one."""
    G, size = y.T @ s, np.sum(s**2, axis=0)
    best, text = np.inf, ""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            gain = sum(signs[a] * G[a, o] for a, o in enumerate(order))
            error = float(np.sum(y**2) - 2.0 * gain + np.sum(size))
            if error < best * (1.0 - 1e-9):
                names = [f"{'-' if g < 0 else ''}{'xyz'[o]}" for g, o in zip(signs, order, strict=True)]
                best = error
                text = "" if names == ["x", "y", "z"] else f"x, y, z read like {', '.join(names)} of the simulation"
    return best, text


def _lever(out: "Premise") -> None:
    """No tool is metres long."""
    measured, simulated = (np.std(x, axis=0) for x in (out.scene.measured, out.scene.simulated))
    lever, expected = (
        float(np.linalg.norm(x[3:]) / max(float(np.linalg.norm(x[:3])), 1e-12)) for x in (measured, simulated)
    )
    if lever > LONGEST_LEVER_M > expected:
        out.wrong.append(f"wrench.torque is {lever:.3g} m times the force: is it in N mm?")
        out.channels += [f"wrench.torque.{axis}" for axis in "xyz"]


def _signs(out: "Premise") -> None:
    """Whether a channel reads with the opposite sign, or like another channel."""
    scene = out.scene
    scales = np.array([[_scale(y, s) or 0.0 for s in scene.simulated.T] for y in scene.measured.T])
    for c, name in enumerate(scene.channels):
        if scales[c, c] < 0.0:
            out.refuse(name, f"{name} reads with the opposite sign of its simulation")
        for d in range(c):
            crossed = scales[c, d] * scales[d, c] != 0.0
            if crossed and scales[c, c] == scales[d, d] == 0.0:
                out.refuse(name, f"{name} reads like {scene.channels[d]} and the other way round: are they swapped?")


def _units(out: "Premise") -> None:
    """Whether recorded and simulated channels differ by a factor that is a change of units."""
    scene = out.scene
    for c, name in enumerate(scene.channels):
        scale = _scale(scene.measured[:, c], scene.simulated[:, c])
        for factor, text in FACTORS.items():
            if scale is not None and _near(scale, factor):
                out.refuse(name, f"{name} is {scale:.3g} times what is simulated: is it in other units ({text})?")


def _scale(y: Array, x: Array) -> float | None:
    """Least squares y = scale x + constant where the two are one signal; None where they are not."""
    if len(y) < 3 or not np.std(x) > 0.0 or not np.std(y) > 0.0:
        return None
    if abs(float(np.corrcoef(y, x)[0, 1])) < ALIKE:
        return None
    return float(np.cov(y, x)[0, 1] / np.var(x, ddof=1))


def _near(scale: float, factor: float) -> bool:
    # A tool of some times the believed weight is no unit: a small factor must be met closely.
    return min(abs(scale / factor - 1.0), abs(scale * factor - 1.0)) < (0.1 if factor > HEAVIER else 0.02)
