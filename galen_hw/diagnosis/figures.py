"""The report's pictures, each as PNG bytes: residuals, floors, map of where, an effect's own curve."""

import io
from collections.abc import Mapping
from typing import Any, Final

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from galen_hw.diagnosis.traces import Curve, Traces
from galen_hw.spatial import Array

BEFORE, AFTER, FLOOR, GREY = "#c8643c", "#1f6f8b", "#cfe1e8", "#7a7a7a"
MOST_POINTS: Final = 4000


def png(figure: Figure) -> bytes:
    """The picture, closed afterwards."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=130)
    plt.close(figure)
    return out.getvalue()


def residuals(traces: Traces, floor: Mapping[str, float]) -> bytes:
    """Residual before and after over time, a panel a channel, with the band of two sigma of the noise."""
    shown = _channels(traces)
    columns = 1 if len(shown) <= 2 else 2 if len(shown) <= 4 else 3
    rows = -(-len(shown) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(11, 1.9 * rows + 0.9), sharex=True, squeeze=False, layout="constrained"
    )
    keep = _thin(len(traces.time))
    t = traces.time[keep]
    for ax, c in zip(axes.flat, shown, strict=False):
        name = traces.channels[c]
        level = floor.get(name)
        if level:
            ax.axhspan(-2 * level, 2 * level, color=FLOOR, lw=0, label="2 sigma of the noise")
        ax.plot(t, _centred(traces.before[keep, c]), color=BEFORE, lw=0.7, label="before")
        ax.plot(t, _centred(traces.after[keep, c]), color=AFTER, lw=0.7, label="after")
        _shade(ax, traces)
        ax.set_title(f"{name}, {traces.units[c]}", loc="left", fontsize=9)
        ax.tick_params(labelsize=8)
        ax.grid(alpha=0.25)
    for ax in list(axes.flat)[len(shown) :]:
        ax.set_visible(False)
    for ax in axes[-1]:
        ax.set_xlabel("time, s" if traces.clock else "row", fontsize=9)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return png(figure)


def _shade(ax: Any, traces: Traces) -> None:
    """Mark the rows that the effects were not fitted on."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], traces.held_out.astype(int), [0]])))
    last = len(traces.time) - 1
    for k, (a, b) in enumerate(edges.reshape(-1, 2)):
        if b - a < len(traces.time):
            label = "held out" if k == 0 else None
            ax.axvspan(traces.time[a], traces.time[min(b, last)], color="#f2efe6", lw=0, zorder=0, label=label)


def bars(answer: Mapping[str, Any]) -> bytes:
    """Held-out rms of each channel over its noise floor, before and after, with the ceiling."""
    fit = answer["fit"]
    names = [c for c in fit["rmse_before"] if fit["noise_floor"].get(c)]
    y = np.arange(len(names))
    figure, ax = plt.subplots(figsize=(8, 0.45 * len(names) + 1.3), layout="constrained")
    for offset, key, colour, label in ((0.18, "rmse_before", BEFORE, "before"), (-0.18, "rmse_after", AFTER, "after")):
        ax.barh(y + offset, [fit[key][c] / fit["noise_floor"][c] for c in names], 0.34, color=colour, label=label)
    ceiling = [fit["ceiling"].get(c) for c in names]
    known = [(v / fit["noise_floor"][c], i) for i, (v, c) in enumerate(zip(ceiling, names, strict=True)) if v]
    if known:
        ax.plot(*zip(*known, strict=True), "|", color="k", ms=14, mew=1.6, label="ceiling: any function of the inputs")
    ax.axvline(1.0, color=GREY, lw=0.9)
    ax.set(yticks=y, xlabel="held-out rms / noise floor")
    ax.set_yticklabels(names, fontsize=8)
    ax.invert_yaxis()
    ax.legend(frameon=False, fontsize=8)
    return png(figure)


def where(traces: Traces) -> bytes | None:
    """The size of the residual along each variable in which the excess sits; None where there is none to show."""
    if not traces.maps:
        return None
    chosen = list(traces.maps)[:6]
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(11, 2.6 * rows), squeeze=False, layout="constrained")
    spread = np.maximum(np.nanstd(traces.after, axis=0), 1e-300)
    for ax, (label, x) in zip(axes.flat, chosen, strict=False):
        for values, colour, name in ((traces.before, BEFORE, "before"), (traces.after, AFTER, "after")):
            size = np.sqrt(np.nanmean(((values - np.nanmean(values, axis=0)) / spread) ** 2, axis=1))
            middle, level = _binned(x, size)
            ax.plot(middle, level, "o-", color=colour, ms=3, lw=1.2, label=name)
        ax.set_xlabel(label, fontsize=8)
        ax.set_ylabel("rms, all channels", fontsize=8)
        ax.tick_params(labelsize=8)
        ax.grid(alpha=0.25)
    for ax in list(axes.flat)[len(chosen) :]:
        ax.set_visible(False)
    axes.flat[0].legend(frameon=False, fontsize=8)
    return png(figure)


def curve(one: Curve) -> bytes:
    """The data with all other effects taken off, and what the effect says."""
    figure, ax = plt.subplots(figsize=(5.4, 3.4), layout="constrained")
    keep = _thin(len(one.x))
    x, y, fit = one.x[keep], one.y[keep], one.fit[keep]
    ax.plot(x, y, ".", color=GREY, ms=1.6, alpha=0.35, label="data, other effects taken off")
    if not one.loop:
        middle, level = _binned(x, y, mean=True)
        ax.plot(middle, level, "o", color=BEFORE, ms=3.5, label="mean of the data")
        order = np.argsort(x)
        x, fit = x[order], fit[order]
    ax.plot(x, fit, color=AFTER, lw=1.3 if one.loop else 0.9, label="the effect")
    ax.set_title(one.title, loc="left", fontsize=10)
    ax.set_xlabel(one.x_label, fontsize=9)
    ax.set_ylabel(one.y_label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(alpha=0.25)
    ax.legend(frameon=False, fontsize=8, markerscale=2)
    return png(figure)


def _channels(traces: Traces) -> list[int]:
    """At most twelve, those that changed most first kept in order."""
    change = np.nanstd(traces.before - traces.after, axis=0) / np.maximum(np.nanstd(traces.after, axis=0), 1e-300)
    return sorted(np.argsort(-change)[:12].tolist())


def _thin(n: int) -> Array:
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, MOST_POINTS)).astype(int))


def _centred(x: Array) -> Array:
    return np.asarray(x - np.nanmedian(x))


def _binned(x: Array, y: Array, bins: int = 24, *, mean: bool = False) -> tuple[Array, Array]:
    """Middle and rms (or mean) of y in bins of equal count along x."""
    good = np.isfinite(x) & np.isfinite(y)
    order = np.argsort(x[good])
    parts = [p for p in np.array_split(order, bins) if len(p)]
    xs, ys = x[good], y[good]
    level = [np.mean(ys[p]) if mean else np.sqrt(np.mean(ys[p] ** 2)) for p in parts]
    return np.array([np.median(xs[p]) for p in parts]), np.array(level)
