"""The report's main result as a figure: turned by hand and let go, a tool drifts, and stands still when compensated."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from galen_hw.config.tool_file import ToolFile
from galen_hw.services.admittance import AdmittanceSettings
from galen_hw.tools.calibration.figures import DONE, RAW, styled
from galen_hw.tools.hand_over_hand import HandOverHand, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Panel
    from matplotlib.figure import Figure

    Axes = np.ndarray[tuple[int], np.dtype[np.object_]] | list[Panel]

TURN: Final = (0.7, 0.45, 0.0)
"""The hand turns the tool so (rotation vector, rad, base axes)."""
BEFORE_S, TAKE_S, MOVE_S, LET_GO_S, END_S = 1.0, 0.5, 2.0, 4.0, 7.5
GREY: Final = "#777777"


@dataclass(frozen=True)
class Drift:
    """The two runs, and what the tip did after the hand had let go.

    Args:
        off, on: traces without and with the compensation.
        drift_off, drift_on: distance from where it was let go, m, at the end.
        speed_off, speed_on: mean speed over the first two seconds of it, m/s.
    """

    off: Trace
    on: Trace
    drift_off: float
    drift_on: float
    speed_off: float
    speed_on: float


def turn_and_let_go(
    tool: ToolFile, *, compensated: bool, held: str = "retractor", seed: int = 0, end_s: float = END_S
) -> Trace:
    """One run: tared at home with the tool in hand, turned by the user, let go.

    Args:
        tool: calibrated file; compensated: whether its weight is predicted, or only tared at home.
        held: what really hangs on the virtual robot; seed: of its noise.
    """
    robot = HandOverHand(tool, held=held, seed=seed, admittance=AdmittanceSettings())
    robot.run(0.3)
    robot.ask("compensation", "set_enabled", enabled=compensated)
    robot.ask("compensation", "tare")
    robot.run(BEFORE_S - 0.3)
    robot.begin_trace()
    robot.run(TAKE_S)
    robot.ask("admittance", "set_enabled", enabled=True)
    robot.world.guide(turn=TURN, move_s=MOVE_S, seconds=LET_GO_S - TAKE_S)
    robot.run(end_s - TAKE_S)
    return robot.trace()


def measure_drift(tool: ToolFile, *, held: str = "retractor", seed: int = 0) -> Drift:
    """Both runs, same hand, same noise."""
    off, on = (turn_and_let_go(tool, compensated=c, held=held, seed=seed) for c in (False, True))
    free = [trace.after(LET_GO_S) for trace in (off, on)]
    travel = [float(trace.travel[-1]) for trace in free]
    speed = [float(np.interp(2.0, t.time - t.time[0], t.travel) / 2.0) for t in free]
    return Drift(off, on, *travel, *speed)


def drift_figure(drift: Drift) -> "Figure":
    """Force that the control sees, speed of the tip, and how far it goes once it is let go."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12.0, 3.5), sharex=True, layout="constrained")
    for trace, colour, name in ((drift.off, RAW, "tared at home only"), (drift.on, DONE, "compensated")):
        _draw_run(axes, trace, colour, name)
    _label(axes, drift)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle("Hand over hand: the tool is turned by the hand and let go")
    return figure


def draw_drift(path_png: Path, tool: ToolFile, *, held: str = "retractor", seed: int = 0) -> Drift:
    """Simulate both runs and draw them.

    Args:
        path_png: of the figure (PNG; any ending that matplotlib knows).
        tool: the tool's calibrated file, e.g. the one that the demonstration has just found.
        held: the tool in the virtual robot's hand.
    """
    drift = measure_drift(tool, held=held, seed=seed)
    with styled():
        from matplotlib import pyplot as plt

        figure = drift_figure(drift)
        figure.savefig(path_png, dpi=140)
        plt.close(figure)
    return drift


def _draw_run(axes: "Axes", trace: Trace, colour: str, name: str) -> None:
    every = 25
    t = trace.time[::every]
    speed = np.linalg.norm(np.diff(trace.tip[::every], axis=0), axis=1) / np.diff(t)
    whole = len(trace.time) // every
    force = trace.contact[: whole * every, :3].reshape(whole, every, 3).mean(axis=1)
    free = trace.after(LET_GO_S)
    axes[0].plot(t[:whole] + 0.5 * (t[1] - t[0]), np.linalg.norm(force, axis=1), color=colour, lw=1.4, label=name)
    axes[1].plot(t[1:], 1e3 * speed, color=colour, lw=1.4)
    axes[2].plot(free.time, 1e3 * free.travel, color=colour, lw=1.8)


def _label(axes: "Axes", drift: Drift) -> None:
    titles = ("force that the control sees, N", "speed of the tip, mm/s", "travel of the tip after it is let go, mm")
    deadband = AdmittanceSettings().force_deadband
    axes[0].axhline(deadband, color=GREY, lw=0.8, ls="--")
    axes[0].text(END_S, deadband, "dead band", color=GREY, ha="right", va="bottom", fontsize=8.0)
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, loc="left")
        axis.set_xlabel("time, s")
        axis.axvspan(TAKE_S, LET_GO_S, color="#eef1f2", lw=0, zorder=0)
        axis.set_xlim(0.0, END_S)
        axis.set_ylim(bottom=0.0, top=1.12 * axis.get_ylim()[1])
        middle, top = 0.5 * (TAKE_S + LET_GO_S), 0.97 * axis.get_ylim()[1]
        axis.text(middle, top, "in the hand", ha="center", va="top", color=GREY, fontsize=8.0)
    for value, colour in ((drift.drift_off, RAW), (drift.drift_on, DONE)):
        text, place = f"{1e3 * value:.1f} mm", (END_S, 1e3 * value)
        axes[2].annotate(text, place, (-4, 5), textcoords="offset points", ha="right", color=colour, weight="bold")
