"""The report's pictures, each as SVG."""

import io
from collections.abc import Mapping
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from galen_hw.diagnosis.findings.quantities import readable
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.report.plot_data import Along, Curve, Option, Traces
from galen_hw.diagnosis.report.summary import channel_words
from galen_hw.diagnosis.stats.sampling import true_runs
from galen_hw.spatial import Array

BEFORE, AFTER, FLOOR, GREY, INK, HELD = "#d1603d", "#17627f", "#d5e7ee", "#8a949b", "#1d2a33", "#efe9da"
STYLE: Final[Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.hashsalt": "galen-hw",
}


def svg(figure: Figure) -> bytes:
    """Return the picture; dense points are rasterised inside it."""
    out = io.BytesIO()
    figure.savefig(out, format="svg", dpi=150, metadata={"Date": None})
    return out.getvalue()


def residuals(traces: Traces, floor: Mapping[str, float]) -> bytes:
    """Draw the residual before and after over time, a panel a channel, with the band of two sigma of the noise."""
    shown = _channels(traces)
    columns = 1 if len(shown) <= 2 else 2
    rows = -(-len(shown) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, (2.6 if columns == 1 else 1.75) * rows + 0.7), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        keep = _thin(len(traces.time))
        for ax, c in zip(axes.flat, shown, strict=False):
            _residual(ax, traces, c, keep, floor.get(traces.channels[c], 0.0))
        for ax in list(axes.flat)[len(shown) :]:
            ax.set_visible(False)
        for k, ax in enumerate(axes.flat):
            if k + columns >= len(shown):
                ax.set_xlabel("time, s" if traces.clock else "row")
                ax.tick_params(labelbottom=True)
        handles, labels = axes.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
        return svg(figure)


def _residual(ax: Any, traces: Traces, c: int, keep: Array, level: float) -> None:
    """Draw one channel, in the unit that is readable for all channels of its quantity."""
    before, after, name = traces.before[:, c], traces.after[:, c], traces.channels[c]
    alike = [k for k in _channels(traces) if traces.units[k] == traces.units[c]]
    factor, unit = _scale(traces.before[:, alike].ravel(), traces.units[c])
    middle = float(np.nanmedian(after))
    style: dict[str, Any] = {"lw": 0.7} if len(traces.time) > 200 else {"lw": 0.8, "marker": "o", "ms": 3}
    if level:
        ax.axhspan(-2 * factor * level, 2 * factor * level, color=FLOOR, lw=0, label="2 sigma of the noise", zorder=0)
        for edge in (-2 * factor * level, 2 * factor * level):
            ax.axhline(edge, color=FLOOR, lw=0.9, zorder=4)
    for values, colour, label in ((before, BEFORE, "before"), (after, AFTER, "after")):
        ax.plot(
            traces.time[keep], factor * (values[keep] - middle), color=colour, rasterized=True, label=label, **style
        )
    _shade(ax, traces)
    ax.set_title(f"{channel_words(name)}, {unit}")
    fall = " to ".join(f"{factor * float(np.std(v)):.3g}" for v in (before, after))
    ax.set_title(f"rms {fall} {unit}", loc="right", fontweight="normal", color=GREY)
    ax.margins(x=0.005)


def _shade(ax: Any, traces: Traces) -> None:
    """Mark the rows that the effects were not fitted on."""
    last = len(traces.time) - 1
    for k, (a, b) in enumerate(true_runs(traces.held_out)):
        if b - a < len(traces.time):
            label = "held out" if k == 0 else None
            ax.axvspan(traces.time[a], traces.time[min(b, last)], color=HELD, lw=0, zorder=-1, label=label)


def bars(answer: Mapping[str, Any]) -> bytes:
    """Draw the held-out rms of each channel over its noise floor, before and after, with the ceiling."""
    fit = answer["fit"]
    names = [c for c in fit["rmse_before"] if fit["noise_floor"].get(c)]
    ratio = {k: np.array([(fit[k].get(c) or np.nan) / fit["noise_floor"][c] for c in names]) for k in fit}
    y = np.arange(len(names))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.34 * len(names) + 1.0), layout="constrained")
        ax = figure.subplots()
        ax.axvspan(0.0, 1.0, color=FLOOR, lw=0, label="noise")
        ax.hlines(y, ratio["rmse_after"], ratio["rmse_before"], color=GREY, lw=2.5, alpha=0.5)
        if np.isfinite(ratio.get("ceiling", np.full(1, np.nan))).any():
            ax.plot(ratio["ceiling"], y, "|", color=INK, ms=13, mew=1.8, label="ceiling: any function of the inputs")
        ax.plot(ratio["rmse_before"], y, "o", color=BEFORE, ms=7, label="before")
        ax.plot(ratio["rmse_after"], y, "o", color=AFTER, ms=7, label="after")
        most = float(np.nanmax(ratio["rmse_before"]))
        if most > 12.0:
            ax.set_xscale("log")
            ax.xaxis.set_major_formatter("{x:g}")
            ax.set_xlim(min(0.8, 0.9 * float(np.nanmin(ratio["rmse_after"]))), 1.2 * most)
        else:
            ax.set_xlim(0.0, 1.08 * max(most, 1.2))
        ax.set(yticks=y, xlabel="held-out rms / noise floor", ylim=(len(names) - 0.5, -0.5))
        ax.set_yticklabels([channel_words(c) for c in names])
        figure.legend(loc="outside upper center", ncols=4)
        return svg(figure)


def plane(traces: Traces) -> bytes | None:
    """Draw the rms over the noise on the plane of the two joints that matter most, before and after."""
    if traces.plane is None:
        return None
    (name_a, unit_a, a), (name_b, unit_b, b) = traces.plane
    (fa, unit_a), (fb, unit_b) = _scale(a, unit_a), _scale(b, unit_b)
    spread = np.maximum(np.std(traces.after, axis=0), 1e-300)
    bins = int(np.clip(np.sqrt(len(a) / 12.0), 5, 26))
    edges = np.linspace(fa * a.min(), fa * a.max(), bins + 1), np.linspace(fb * b.min(), fb * b.max(), bins + 1)
    count = np.histogram2d(fa * a, fb * b, bins=edges)[0]
    maps = []
    for values in (traces.before, traces.after):
        size = np.mean(((values - np.mean(values, axis=0)) / spread) ** 2, axis=1)
        with np.errstate(invalid="ignore"):
            maps.append(np.sqrt(np.histogram2d(fa * a, fb * b, bins=edges, weights=size)[0] / count))
    top = float(np.nanquantile(maps[0], 0.98))
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(11, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        for ax, image, title in ((left, maps[0], "before"), (right, maps[1], "after")):
            mesh = ax.pcolormesh(*edges, image.T, cmap="magma_r", vmin=0.8, vmax=max(top, 1.6), rasterized=True)
            ax.set(title=title, xlabel=_named(name_a, unit_a))
        left.set_ylabel(_named(name_b, unit_b))
        figure.colorbar(mesh, ax=[left, right], label="rms over that of the residual after, all channels", shrink=0.9)
        return svg(figure)


def along(traces: Traces) -> bytes | None:
    """Draw the residual over each variable that explains it: mean in bins before and after, the region shaded."""
    if not traces.along:
        return None
    columns = min(3, len(traces.along))
    rows = -(-len(traces.along) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 2.5 * rows + 0.3), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax, one in zip(axes.flat, traces.along, strict=False):
            _along(ax, traces, one)
        for ax in list(axes.flat)[len(traces.along) :]:
            ax.set_visible(False)
        handles, labels = axes.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
        return svg(figure)


def _along(ax: Any, traces: Traces, one: Along) -> None:
    (fx, unit_x), c = _scale(one.x, one.unit), one.channel
    fy, unit = _scale(traces.before[:, c], traces.units[c])
    if one.region is not None:
        ax.axvspan(
            fx * one.region[0],
            fx * one.region[1],
            color=HELD,
            lw=0,
            label="where the unexplained error sits",
            zorder=-1,
        )
    middle = float(np.median(traces.after[:, c]))
    for values, colour, label in ((traces.before[:, c], BEFORE, "before"), (traces.after[:, c], AFTER, "after")):
        x, mean, low, high = _binned(fx * one.x, fy * (values - middle))
        ax.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
        ax.plot(x, mean, "o-", color=colour, ms=2.5, lw=1.3, label=f"{label}, mean and middle two thirds")
    ax.set(xlabel=_named(one.label, unit_x), ylabel=_named(channel_words(traces.channels[c]), unit))
    ax.set_title(f"{100 * one.share:.0f} % of it is a function of this", fontweight="normal", fontsize=8.5)


def curve(one: Curve) -> bytes:
    """Draw the data with all other effects removed, and the effect."""
    (fx, unit_x), (fy, unit_y) = _scale(one.x, one.x_unit), _scale(one.y, one.y_unit)
    x, y, fit = fx * one.x, fy * one.y, fy * one.fit
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.4, 3.2), layout="constrained")
        ax = figure.subplots()
        keep = _thin(len(x))
        size = 1.6 if len(x) > 300 else 4.0
        ax.plot(
            x[keep], y[keep], ".", color=GREY, ms=size, alpha=0.35, rasterized=True, label="data, other effects off"
        )
        if one.loop:
            time = one.x_label in ("time", "row")
            ax.plot(x[keep], fit[keep], color=AFTER, lw=1.8 if time else 0.9, label="the effect", rasterized=not time)
        else:
            _function(ax, x, y, fit)
        low, high = np.quantile(y, [0.002, 0.998])
        margin = 0.08 * max(high - low, 1e-300)
        ax.set_ylim(min(low, fit.min()) - margin, max(high, fit.max()) + margin)
        ax.set(title=one.title, xlabel=_named(one.x_label, unit_x), ylabel=_named(one.y_label, unit_y))
        ax.legend(fontsize=7.5, loc="best", handlelength=1.4)
        return svg(figure)


def _function(ax: Any, x: Array, y: Array, fit: Array) -> None:
    """Draw means of the data in bins; the effect as a line where it is a function of x, else its mean and spread."""
    at, mean, _, _ = _binned(x, y, bins=28)
    middle, level, low, high = _binned(x, fit, bins=120)
    if float(np.mean(high - low)) < 0.12 * max(float(np.ptp(fit)), 1e-300):
        ax.plot(middle, level, color=AFTER, lw=2.0, label="the effect")
    else:
        ax.fill_between(middle, low, high, color=AFTER, alpha=0.2, lw=0)
        ax.plot(middle, level, color=AFTER, lw=2.0, label="the effect, mean and middle two thirds")
    ax.plot(at, mean, "o", color=BEFORE, ms=3.5, label="mean of the data")


def options(chosen: list[Option]) -> bytes | None:
    """Draw the minutes until each recording settles the first open question, and the angle that it gives."""
    if not chosen:
        return None
    y = np.arange(len(chosen))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.34 * len(chosen) + 0.8), layout="constrained")
        ax = figure.subplots()
        ax.barh(y, [o.minutes for o in chosen], 0.6, color=[AFTER, *[GREY] * (len(chosen) - 1)])
        for k, o in enumerate(chosen):
            ax.text(o.minutes, k, f"  {o.minutes:.1f} min, {o.angle:.0f} deg apart", va="center", fontsize=8.5)
        ax.set(yticks=y, xlabel="minutes until the odds are a thousand to one", ylim=(len(chosen) - 0.5, -0.5))
        ax.set_yticklabels([o.name for o in chosen])
        ax.margins(x=0.22)
        ax.grid(visible=False, axis="y")
        return svg(figure)


def _channels(traces: Traces) -> list[int]:
    """Return at most fourteen channels, those that changed most, in their own order."""
    change = np.nanstd(traces.before - traces.after, axis=0) / np.maximum(np.nanstd(traces.after, axis=0), 1e-300)
    return sorted(np.argsort(-change)[: CAPS.channels].tolist())


def _scale(x: Array, unit: str) -> tuple[float, str]:
    """Return factor and unit in which values are readable."""
    base, slash, per = unit.partition("/")
    size = float(np.nanmax(np.abs(x))) if len(x) else 1.0
    shown = readable(size, 0.0, base)
    factor = shown.value / size if size > 0.0 else 1.0
    return (factor, f"{shown.unit}{slash}{per}") if base else (1.0, unit)


def _named(label: str, unit: str) -> str:
    return f"{label}, {unit}" if unit else label


def _thin(n: int) -> Array:
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, CAPS.points)).astype(int))


def _binned(x: Array, y: Array, bins: int = 24) -> tuple[Array, Array, Array, Array]:
    """Return the median of x, and mean and middle two thirds of y, in bins of equal count along x."""
    good = np.isfinite(x) & np.isfinite(y)
    order = np.argsort(x[good], kind="stable")
    xs, ys = x[good], y[good]
    cuts = np.cumsum([len(p) for p in np.array_split(order, min(bins, max(len(xs) // 4, 1)))])[:-1]
    # Rows of the same x are one bin, however many they are: a jaw that is mostly shut is one point of the curve.
    cuts = np.unique(np.searchsorted(xs[order], xs[order][cuts]))
    parts = [p for p in np.split(order, cuts) if len(p)]
    spread = np.array([np.quantile(ys[p], [1.0 / 6.0, 5.0 / 6.0]) for p in parts]).reshape(-1, 2)
    middle = np.array([np.median(xs[p]) for p in parts])
    return middle, np.array([np.mean(ys[p]) for p in parts]), spread[:, 0], spread[:, 1]
