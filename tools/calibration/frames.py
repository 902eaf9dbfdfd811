"""Draws the frames of `docs/calibration.md`: `python -m galen_hw.tools.calibration.frames docs/images/frames.svg`."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.kinematics import GalenRobot
from galen_hw.spatial import Array, rotation_about

AXES = ("#c0392b", "#2e7d4f", "#2d5fa8")
INK, SOFT, TOOL, BODY, ARM = "#22313a", "#5b6970", "#b4632f", "#7a5ea8", "#cdd5d9"
# Levers larger than life, so that they can be seen.
COM_TOOL, COM_BODY = np.array([0.050, 0.0, -0.105]), np.array([0.020, 0.0, 0.058])
TOOL_SHAPE = np.array([[0.0, 0, 0], [0.012, 0, -0.045], [0.050, 0, -0.105], [0.045, 0, -0.150]])
VIEW = rotation_about(0, 0.33) @ rotation_about(2, -0.62)


def main() -> None:
    """Write the picture to the path given."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "frames"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.9), layout="constrained", sharex=True, sharey=True)
    home, pose = np.zeros(5), np.array([0.0, 0.0, 0.0, 0.50, 0.55])
    _panel(axes[0], home, "home, $R_0$: zeroed here, the bias body on", with_tool=False)
    _panel(axes[1], pose, "pose $i$, $R_i$: bias body and tool", with_tool=True)
    svg = sys.argv[1].endswith("svg")
    figure.savefig(Path(sys.argv[1]), metadata={"Date": None} if svg else None, dpi=130)


def flat(point: Array) -> Array:
    """Picture coordinates (2,) of a point: seen from the front right, a little above, without perspective."""
    x, depth, z = VIEW @ np.asarray(point, dtype=float)
    del depth
    return np.array([x, z])


def _panel(ax: Any, q: Array, title: str, *, with_tool: bool) -> None:
    """The arm from the roll axis on, the sensor's frame, and what hangs on it."""
    robot = GalenRobot()
    T = robot.sensor_pose(q)[0]
    R, p = T[:3, :3], T[:3, 3]
    roll = np.asarray(robot.platform_to_roll) + np.array([0.09, 0.0, 0.0])
    turn = rotation_about(0, q[3])
    elbow = np.asarray(robot.platform_to_roll) + turn @ [0.210, 0.0, 0.0]
    tilt = np.asarray(robot.platform_to_roll) + turn @ np.asarray(robot.roll_to_tilt)
    _axis(ax, roll - np.array([0.02, 0, 0]), elbow + np.array([0.10, 0, 0]), "roll")
    across = turn @ np.array([0.0, 0.085, 0.0])
    _axis(ax, tilt + across, tilt - across, "tilt")
    _path(ax, (roll, elbow, tilt, p), ARM, 13.0)
    if with_tool:
        _path(ax, [p + R @ point for point in TOOL_SHAPE], "#ecd3c1", 10.0)
    ax.plot(*flat(p), "o", color="#9fb0b8", markersize=19.0, zorder=2)
    _triad(ax, p, R, size=0.085, name="s", shift=(-0.016, -0.020))
    _triad(ax, np.array([0.075, 0.0, -0.105]), np.eye(3), size=0.055, name="B", shift=(-0.013, -0.010))
    _hung(ax, p, R @ COM_BODY, name="b", color=BODY, weight=0.050)
    if with_tool:
        _hung(ax, p, R @ COM_TOOL, name="t", color=TOOL, weight=0.085)
    ax.set_title(title, color=INK, fontsize=12.0)
    ax.set_aspect("equal")
    ax.set_axis_off()


def _path(ax: Any, points: "list[Array] | tuple[Array, ...]", color: str, width: float) -> None:
    ax.plot(*np.array([flat(x) for x in points]).T, color=color, lw=width, solid_capstyle="round", zorder=1)


def _axis(ax: Any, start: Array, end: Array, label: str) -> None:
    ax.plot(*np.array([flat(start), flat(end)]).T, color="#8a979e", lw=1.0, ls=(0, (6, 4)), zorder=1)
    ax.annotate(label, flat(end), color=SOFT, fontsize=9.5, ha="center", va="bottom", xytext=(0, 5), **_POINTS)


_POINTS: dict[str, Any] = {"textcoords": "offset points"}


def _arrow(ax: Any, start: Array, end: Array, *, color: str, width: float = 2.0) -> None:
    style = {"arrowstyle": "-|>", "color": color, "lw": width, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 13.0}
    ax.annotate("", flat(end), flat(start), arrowprops=style, zorder=4)
    ax.update_datalim([flat(start), flat(end)])


def _triad(ax: Any, origin: Array, R: Array, *, size: float, name: str, shift: tuple[float, float]) -> None:
    for k, axis in enumerate("xyz"):
        _arrow(ax, origin, origin + size * R[:, k], color=AXES[k])
        at = flat(origin + 1.17 * size * R[:, k])
        ax.text(at[0], at[1], axis, color=AXES[k], fontsize=11.0, ha="center", va="center")
    at = flat(origin) + np.array(shift)
    ax.text(at[0], at[1], name, color=INK, fontsize=14.0, weight="bold", ha="center", va="center", zorder=5)


def _hung(ax: Any, p: Array, lever: Array, *, name: str, color: str, weight: float) -> None:
    """A centre of mass, its lever from the sensor, and its weight: along base -z in every pose."""
    at = p + lever
    ax.plot(*np.array([flat(p), flat(at)]).T, color=color, lw=1.8, ls=":", zorder=4)
    ax.plot(*flat(at), "o", color=color, markersize=9.0, zorder=5)
    _arrow(ax, at, at - [0.0, 0.0, weight], color=color, width=2.6)
    below: dict[str, Any] = {"fontsize": 14.0, "color": color, "ha": "center", "va": "top", "xytext": (12, 4)}
    ax.annotate(f"$f_{name}$", flat(at - [0.0, 0.0, weight]), **below, **_POINTS)
    beside: dict[str, Any] = {"fontsize": 13.0, "color": color, "ha": "left", "va": "center"}
    ax.annotate(f"$p_{{s{name}}}$", flat(p + 0.5 * lever), xytext=(-34, 13 if name == "b" else 4), **beside, **_POINTS)
    ax.annotate(f"{name}", flat(at), xytext=(9, 5), weight="bold", **beside, **_POINTS)


if __name__ == "__main__":
    main()
