"""Deflection data: configurations, forces on the tip and how far the tip was from where the rigid robot says."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from galen_hw.errors import UsageError
from galen_hw.physics.effects.terms import known_change
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.pose import APPLIED, PoseScene
from galen_hw.spatial import Array

SATURATED_SHARE = 0.02


@dataclass(frozen=True)
class DeflectionSet:
    """One recording of pushes.

    Args:
        name: of the recording; two sets of one configuration share `configuration`.
        configuration: label of where the arm was.
        observations: the recording, group "pose".
        time: (N,) s; q: (N, n) joints; force: (N, 3) on the tip in the base, N; torque: (N, 3) about the tip, N m.
        give: (N, d) tracked minus rigid tip: position m and, if tracked, rotation vector rad (d = 3 or 6).
        tool: name of the tool; sets of different tools are not mixed.
    """

    name: str
    configuration: str
    observations: Observations
    time: Array
    q: Array
    force: Array
    give: Array
    tool: str = ""

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time)

    @classmethod
    def of(cls, name: str, observations: Observations, *, configuration: str = "", tool: str = "") -> "DeflectionSet":
        """The set of a recording; its constant offset (registration's rest) is taken out over the rows without force.

        Raises:
            UsageError: no forces, or no rows without force to register on.
        """
        observations = replace(observations, belief=replace(observations.belief, compliance={}))
        scene = PoseScene(observations, known=known_change)
        seen = np.isfinite(scene.residual).all(axis=1) & np.isfinite(observations.matrix(*APPLIED)).all(axis=1)
        if not seen.all() and seen.any():  # Where the tool was hidden nothing can be learned.
            observations = observations.taken(seen)
            scene = PoseScene(observations, known=known_change)
        force, give = scene.force, scene.residual
        size = np.linalg.norm(force, axis=1)
        if not np.any(size > 0.0):
            if all(column in observations.columns for column in APPLIED):
                what = "no force was applied: applied.force is 0 in every row"
                raise UsageError(what, where=name, todo="push and pull the tip, and record the set again")
            raise UsageError("no applied.force column", where=name, todo="record the force on the tip with the pose")
        free = size < max(0.05 * size.max(), 0.1)
        if np.count_nonzero(free) < 10:
            raise UsageError(
                "the tip is never free of force", where=name, todo="let go of the tool for a few seconds in each set"
            )
        label = configuration or _label(scene.q)
        return cls(name, label, observations, scene.time, scene.q, force, give, tool)

    def rows(self, index: slice | NDArray[np.bool_]) -> "DeflectionSet":
        """Some of the rows."""
        return DeflectionSet(
            self.name,
            self.configuration,
            self.observations.taken(index),
            self.time[index],
            self.q[index],
            self.force[index],
            self.give[index],
            self.tool,
        )


def _label(q: Array) -> str:
    """A configuration by its rounded middle: two sets at one place get the same label."""
    return " ".join(f"{v:+.2f}" for v in np.median(q, axis=0))


def check(sets: Sequence[DeflectionSet]) -> list[str]:
    """What these data cannot show, one line each with what to record next; empty when they are fit to be fitted.

    Raises:
        UsageError: sets of different tools are mixed.
    """
    tools = sorted({s.tool for s in sets if s.tool})
    if len(tools) > 1:
        raise UsageError(f"sets of different tools: {', '.join(tools)}", todo="fit each tool by itself")
    lines = []
    configurations = {s.configuration for s in sets}
    if len(configurations) < 3:
        lines.append(
            f"{len(configurations)} configuration(s): stiffness that depends on the configuration cannot be told; "
            "record at three or more"
        )
    force = np.concatenate([s.force for s in sets])
    for axis, name in enumerate("xyz"):
        low, high = np.quantile(force[:, axis], [0.01, 0.99])
        strong = max(abs(low), abs(high))
        if strong < 0.5:
            lines.append(f"hardly any force along {name} ({strong:.2f} N): push and pull along it")
        elif min(-low, high) < 0.15 * strong:
            lines.append(
                f"pushes along {name} go one way only: pull back through zero as well, or hysteresis stays unseen"
            )
    clipped = [s for s in sets if _clips(s)]
    if clipped:
        share, names = max(map(_saturated, clipped)), ", ".join(s.name for s in clipped)
        lines.append(f"the force sits at its limit in {share:.0%} of the rows: push less, and record again: {names}")
    return lines


def _saturated(s: DeflectionSet) -> float:
    """Share of the rows at the very extreme of a component: a sensor at its limit repeats it exactly."""
    return float(max(np.mean(np.abs(s.force[:, a]) >= np.abs(s.force[:, a]).max() * (1 - 1e-9)) for a in range(3)))


def _clips(s: DeflectionSet) -> bool:
    return _saturated(s) > SATURATED_SHARE
