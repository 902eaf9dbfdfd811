"""Recordings whose premises are wrong: what a person does wrong with a table."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PREMISES = ("swapped axes", "wrong sign", "clock offset", "torque in N mm", "angles in degrees")


def spoil(premise: str, columns: dict[str, Array], info: dict[str, Any]) -> None:
    """Change the columns in place."""
    del info
    if premise == "swapped axes":
        x, y = columns["wrench.force.x"], columns["wrench.force.y"]
        columns["wrench.force.x"], columns["wrench.force.y"] = y, x
    elif premise == "wrong sign":
        for axis in "xyz":
            columns[f"wrench.force.{axis}"] = -columns[f"wrench.force.{axis}"]
            columns[f"wrench.torque.{axis}"] = -columns[f"wrench.torque.{axis}"]
    elif premise == "clock offset":
        # The wrench was stamped by another computer whose clock is 1.7 s ahead.
        t = columns["time"]
        for name in [n for n in columns if n.startswith("wrench.")]:
            columns[name] = np.interp(t + 1.7, t, columns[name])
    elif premise == "torque in N mm":
        for axis in "xyz":
            columns[f"wrench.torque.{axis}"] = 1000.0 * columns[f"wrench.torque.{axis}"]
    elif premise == "angles in degrees":
        for joint in ("roll", "tilt"):
            columns[f"joint.{joint}.position"] = np.degrees(columns[f"joint.{joint}.position"])
    else:
        raise ValueError(premise)
