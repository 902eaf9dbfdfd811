"""The residual over time, before and after what was found: the picture of `DiagnosisResult.plot`."""

from typing import TYPE_CHECKING

import numpy as np

from galen_hw.diagnosis.report.plot_data import Traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEFORE, AFTER, HELD = "#c9764a", "#1f6f8b", "#eef1f3"


def residual_figure(traces: Traces) -> "Figure":
    """Draw one panel a channel, SI units; rows that the effects were not fitted on are shaded.

    Raises:
        UsageError: matplotlib is not installed.
    """
    from matplotlib.figure import Figure

    count = len(traces.channels)
    figure = Figure(figsize=(9.0, 1.7 * count + 0.8), layout="constrained")
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for c, panel in enumerate(panels):
        for values, colour, label in ((traces.before, BEFORE, "before"), (traces.after, AFTER, "after")):
            rms = float(np.sqrt(np.nanmean(values[:, c] ** 2)))
            panel.plot(traces.time, values[:, c], color=colour, lw=0.8, label=f"{label}, rms {rms:.3g}")
        low, high = panel.get_ylim()
        panel.fill_between(traces.time, low, high, where=traces.held_out, color=HELD, lw=0, zorder=-1, step="mid")
        panel.set_ylim(low, high)
        panel.set_ylabel(f"{traces.channels[c]}\n{traces.units[c]}", fontsize=8)
        panel.legend(loc="upper right", fontsize=7, ncols=2)
    panels[-1].set_xlabel("time, s" if traces.clock else "row")
    figure.suptitle("recorded less simulated; held-out rows are shaded", fontsize=10)
    return figure
