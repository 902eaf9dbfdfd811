"""A fit that no tool can be the cause of is refused, whatever its intervals say: cause first, consequence never."""

from collections.abc import Iterator

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.estimate import Estimate
from galen_hw.spatial import Array

ASIDE = 0.5
"""Share of the poses that a robust fit may leave aside: beyond it nobody knows which half is the wrong one."""
LONGEST_LEVER_M = 2.5
CONTRADICTS = 0.2
"""Share of a named mass, and, in a tenth of a metre, of a named centre of mass, that a kitchen scale and a ruler do not miss."""


def require_sense(found: Estimate, weight: Array, raw: Array, after: Array, where: str) -> None:
    """Refuse a fit that does not describe what was measured.

    Args:
        found: mass and centre of mass.
        weight: (n,) of the poses in the fit, 0 where one was left aside.
        raw, after: (m, 6) readings of poses that the fit did not see, before and after compensation, N and N m.
        where: what errors name.

    Raises:
        UsageError: more than half of the poses were left aside, a constant predicts as well, or a lever of metres.
    """
    aside = int(np.sum(weight == 0.0))
    if aside > ASIDE * len(weight):
        what = f"{aside} of {len(weight)} poses do not fit the others: not one tool, or not one zeroing"
        raise UsageError(what, where=where, todo="split the recording, or record the sweep again untouched")
    for k, (name, unit) in enumerate((("force", "N"), ("torque", "N m"))):
        part = slice(3 * k, 3 * k + 3)
        before = float(np.sqrt(np.mean((raw[:, part] - raw[:, part].mean(axis=0)) ** 2)))
        left = float(np.sqrt(np.mean(after[:, part] ** 2)))
        if len(raw) > 3 and left >= before:
            what = f"the fitted weight predicts the {name} no better than a constant: {left:.3g} {unit} are left of {before:.3g}"
            todo = "check axes and signs of the wrench, and the orientation"
            raise UsageError(what, where=where, todo=todo)
    lever = float(np.linalg.norm(found.com))
    if lever > LONGEST_LEVER_M:
        what = f"the centre of mass comes out {lever:.3g} m from the sensor: the torque is not in N m"
        raise UsageError(what, where=where, todo="give N m")


def contradictions(found: Estimate, mass: float | None, com: tuple[float, ...] | None) -> Iterator[str]:
    """Yield what a fit says against the tool that a recording names (kg, m in the sensor frame)."""
    if mass and abs(found.mass / mass - 1.0) > max(CONTRADICTS, 3.0 * float(found.std[0]) / mass):
        yield f"the tool weighs {1e3 * found.mass:.1f} g where {1e3 * mass:.1f} g are named"
    if com is not None:
        off = float(np.linalg.norm(np.asarray(found.com) - np.asarray(com)))
        if off > max(0.1 * CONTRADICTS, 3.0 * float(np.linalg.norm(found.std[1:4]))):
            yield f"the centre of mass lies {1e3 * off:.1f} mm from the one that is named"
