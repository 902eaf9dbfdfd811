"""Figures of a calibration, as the report's 8 and 9 and more, and one HTML page that holds them all."""

import base64
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.config.tool_file import ToolFile
from galen_hw.identification.candidates import Candidate
from galen_hw.identification.model import CHANNELS
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.spatial import Array
from galen_hw.tools.calibration.check import LiveCheck
from galen_hw.tools.calibration.result import Result
from galen_hw.tools.calibration.screen import SCALE, fit_rms, left_out_rms, unit
from galen_hw.tools.outputs import figures_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RAW, DONE, BAND, INK, GOOD = "#c9764a", "#1f6f8b", "#9fc7d3", "#22313a", "#2e7d4f"
LARGEST_RATIO: Final = 2.0
"""Where the bars of the candidates' figure end: the good ones are to be told apart beside a hopeless one."""
STYLE: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.edgecolor": "#8a979e",
    "axes.labelcolor": INK,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6eaec",
    "xtick.color": "#5b6970",
    "ytick.color": "#5b6970",
    "legend.frameon": False,
    "figure.facecolor": "white",
}


def write_report(
    result: Result,
    page: Path,
    tool: ToolFile,
    check: LiveCheck | None,
    state: str,
    more: Iterable[tuple[str, Callable[[], "Figure"]]] = (),
) -> Path:
    """Write a page with its figures inside, and the figures as PNG beside it; the page's path.

    Args:
        page: the HTML file; a folder that is missing is made.
        tool: the tool's file that results; check: the live check, once it has run.
        state: one line: accepted as what, or not.
        more: further figures by name, made in the same style.
    """
    folder = figures_beside(page)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {name: _png(figure) for name, figure in figures(result, check, more)}
    for name, data in pictures.items():
        (folder / f"{name}.png").write_bytes(data)
    page.write_text(render(result, pictures, tool, check, state), encoding="utf-8")
    return page


def figures(
    result: Result, check: LiveCheck | None, more: Iterable[tuple[str, Callable[[], "Figure"]]] = ()
) -> Iterator[tuple[str, "Figure"]]:
    """Name and figure, one after the other."""
    with styled():
        if check is not None:
            yield "compensation_live", live_figure(check, result.name)
        for name, make in more:
            yield name, make()
        yield "compensation", verification_figure(result)
        yield "residuals", residual_figure(result)
        yield "candidates", candidates_figure(result)
        yield "poses", poses_figure(result)


@contextmanager
def styled() -> Iterator[None]:
    """Figures made inside look alike."""
    import matplotlib as mpl

    mpl.use("Agg")
    with mpl.rc_context(STYLE):
        yield


def live_figure(check: LiveCheck, name: str) -> "Figure":
    """Raw and compensated samples during holds and slow motion (report, figures 8 and 9)."""
    step = max(1, len(check.time) // 6000)
    few = slice(None, None, step)
    figure = _before_after(
        check.time[few], check.raw[few], check.compensated[few], check.noise, "a sample", dots=False, xlabel="time, s"
    )
    ratio = check.rms / check.noise
    figure.suptitle(f"{name}: every sample in holds and slow motion; RMS at most {ratio.max():.3f} × the noise floor")
    return figure


def verification_figure(result: Result) -> "Figure":
    """Before and after compensation on the poses to verify with."""
    check = result.verification
    order = np.arange(1, len(check.after) + 1, dtype=float)
    xlabel = "held-out pose" if check.kind.startswith("held") else "pose, predicted from all others"
    expected = np.where(np.isfinite(check.expected), check.expected, np.nan)
    figure = _before_after(order, check.before, check.after, expected, "a pose's mean", dots=True, xlabel=xlabel)
    figure.suptitle(f"{result.name}: before and after compensation, {check.kind}")
    return figure


def _before_after(
    time: Array, before: Array, after: Array, sigma: Array, whose: str, *, dots: bool, xlabel: str
) -> "Figure":
    """Six channels, each above at the raw reading's scale and below at the noise's.

    Args:
        sigma: (6,) of the noise; whose: what has it, a sample or the mean of a pose.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        4, 3, figsize=(12.0, 7.6), sharex=True, layout="constrained", height_ratios=[2.0, 1.0, 2.0, 1.0]
    )
    style: dict[str, Any] = {"marker": "o", "markersize": 3.5} if dots else {"linewidth": 0.9}
    for k, channel in enumerate(CHANNELS):
        top, zoom = axes[2 * (k // 3), k % 3], axes[2 * (k // 3) + 1, k % 3]
        y0, y1, s = before[:, k] * SCALE[k], after[:, k] * SCALE[k], sigma[k] * SCALE[k]
        top.plot(time, y0, color=RAW, label="raw", **style)
        top.plot(time, y1, color=DONE, label="compensated", **style)
        top.set_title(f"{channel}, {unit(channel)}", loc="left")
        if np.isfinite(s):
            zoom.axhspan(
                -2 * s, 2 * s, color=BAND, alpha=0.45, lw=0, label=f"2 sigma of {whose} (lower panels: enlarged)"
            )
        zoom.plot(time, y1, color=DONE, **(style | {"linewidth": 0.5}))
        reach = 1.15 * max(float(np.abs(y1).max()), 2.2 * s if np.isfinite(s) else 0.0)
        zoom.set_ylim(-reach, reach)
        if k >= 3:
            zoom.set_xlabel(xlabel)
    handles = [*axes[0, 0].get_legend_handles_labels()[0], *axes[1, 0].get_legend_handles_labels()[0]]
    labels = [*axes[0, 0].get_legend_handles_labels()[1], *axes[1, 0].get_legend_handles_labels()[1]]
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def residual_figure(result: Result) -> "Figure":
    """Residuals of the fit in the order of measuring: homes show a drift, outliers a touch."""
    import matplotlib.pyplot as plt

    fit, rows = result.fit, result.poses.fit
    figure, axes = plt.subplots(2, 3, figsize=(12.0, 4.8), sharex=True, layout="constrained")
    kinds = (
        ("without the tool", ~rows.tool, "s", "#8e7cc3"),
        ("with the tool", rows.tool & ~rows.home, "o", DONE),
        ("home", rows.tool & rows.home, "D", GOOD),
    )
    aside = np.isin(np.arange(len(rows)), fit.outliers)
    clock = np.arange(len(rows)) if rows.time is None else rows.time
    for k, (channel, ax) in enumerate(zip(CHANNELS, axes.flat, strict=True)):
        y, s = fit.residual[:, k] * SCALE[k], fit.sigma[k] * SCALE[k]
        ax.axhspan(-2 * s, 2 * s, color=BAND, alpha=0.4, lw=0, label="2 sigma of a pose")
        for label, mask, marker, color in kinds:
            if np.any(mask & ~aside):
                ax.plot(clock[mask & ~aside], y[mask & ~aside], marker, color=color, markersize=3.5, label=label)
        if aside.any():
            reach = 6.0 * s
            ax.plot(clock[aside], y[aside].clip(-reach, reach), "x", color="#c0392b", label="left aside")
        ax.set_title(f"{channel}, {unit(channel)}", loc="left")
        if k >= 3:
            ax.set_xlabel("pose, in order" if rows.time is None else "time in the sweep, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    figure.suptitle("Residual of the recommended fit, pose by pose")
    return figure


def candidates_figure(result: Result) -> "Figure":
    """Mass and centre of mass by each candidate with its 95 % interval, and how each predicts left-out poses.

    The report's own equations come without an interval: a hollow mark.
    """
    import matplotlib.pyplot as plt

    found = result.comparison.candidates
    figure, axes = plt.subplots(1, 5, figsize=(12.0, 0.6 + 0.42 * (len(found) + 1)), sharey=True, layout="constrained")
    places = np.arange(len(found), dtype=float)[::-1]
    for ax, i, title in zip(axes, range(4), ("mass, g", "com x, mm", "com y, mm", "com z, mm"), strict=False):
        _forest(ax, found, places, i, result.comparison.recommended)
        ax.set_title(title, loc="left")
    axes[0].set_yticks(places, [c.title for c in found])
    reference = left_out_rms(result, result.best)
    for c, y in zip(found, places, strict=True):
        ratio = float(np.sqrt(np.mean((left_out_rms(result, c) / reference) ** 2)))
        shown = min(ratio, LARGEST_RATIO)
        axes[4].barh(y, shown, height=0.55, color=GOOD if c.key == result.comparison.recommended else BAND)
        axes[4].text(
            shown, y, f" {ratio:.3f}" if shown == ratio else f"  » {ratio:.3g}", va="center", fontsize=8.0, color=INK
        )
    axes[4].set_title("relative left-out error", loc="left")
    axes[4].set_xlim(0.0, 1.35 * max(axes[4].get_xlim()[1] / 1.05, 1.0))
    return figure


def _forest(ax: "Axes", found: Sequence[Candidate], places: Array, i: int, recommended: str) -> None:
    ends = 1e3 * np.array([(v - h, v + h) for v, h in (_interval(c, i) for c in found if c.estimate is not None)])
    low, high = ends[:, 0].min(), ends[:, 1].max()
    for c, y in zip(found, places, strict=True):
        chosen = c.key == recommended
        color = GOOD if chosen else "#8fa3ad"
        value = 1e3 * (c.mass, *c.com)[i]
        if c.estimate is None:
            at = float(np.clip(value, low - (high - low) / 2, high + (high - low) / 2))  # far off: an arrow that way
            marker = "D" if at == value else "<" if value < at else ">"
            ax.plot(at, y, marker, markersize=5.5, markerfacecolor="white", markeredgecolor=RAW)
            continue
        half = 1e3 * _interval(c, i)[1]
        if chosen:
            ax.axvspan(value - half, value + half, color=GOOD, alpha=0.08, lw=0)
        ax.errorbar(value, y, xerr=half, fmt="o", color=color, markersize=5, capsize=3)
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.tick_params(axis="x", labelsize=7.5)
    ax.locator_params(axis="x", nbins=4)


def _interval(c: Candidate, i: int) -> tuple[float, float]:
    """Value and half-width of the 95 % interval of a candidate's i-th parameter, SI."""
    assert c.estimate is not None
    return float(c.estimate.values[i]), float(c.estimate.t95 * c.estimate.std[i])


def poses_figure(result: Result) -> "Figure":
    """Where gravity points in the sensor, pose by pose: what the sweep can excite."""
    import matplotlib.pyplot as plt

    rows = result.poses
    s = gravity_in_sensor(rows.R, rows.gravity) / np.linalg.norm(rows.gravity)
    clock = np.arange(len(rows)) if rows.time is None else rows.time
    figure = plt.figure(figsize=(12.0, 4.8), layout="constrained")
    flat, globe = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    flat.plot(np.cos(turn), np.sin(turn), color="#c5ced3", lw=0.8)
    flat.plot(s[:, 0], s[:, 1], color="#e3e8ea", lw=0.6, zorder=1)
    _sphere(globe)
    span: dict[str, Any] = {"cmap": "viridis", "vmin": float(clock.min()), "vmax": float(clock.max())}
    kinds = (
        ("with the tool", rows.tool & ~rows.verify, "o"),
        ("without the tool", ~rows.tool, "s"),
        ("held out, to verify with", rows.verify, "^"),
    )
    for label, mask, marker in kinds:
        if mask.any():
            dots = flat.scatter(
                s[mask, 0], s[mask, 1], c=clock[mask], marker=marker, s=26, label=label, zorder=2, **span
            )
            globe.scatter(*s[mask].T, c=clock[mask], marker=marker, s=22, depthshade=False, zorder=5, **span)
    flat.set_aspect("equal")
    flat.locator_params(nbins=5)
    flat.set_xlabel("sensor x")
    flat.set_ylabel("sensor y")
    flat.set_title("seen along the sensor's z", loc="left")
    globe.set_title("on the sphere of all directions", loc="left")
    colors = figure.colorbar(dots, ax=[flat, globe], shrink=0.8, pad=0.02)
    colors.set_label("pose, in order" if rows.time is None else "time in the sweep, s")
    figure.legend(*flat.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle("Direction of gravity in the sensor, pose by pose")
    return figure


def _sphere(ax: Any) -> None:
    """The unit sphere as thin lines of latitude and longitude, without a box about it."""
    ax.computed_zorder = False  # the poses lie before the lines
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    ax.plot_wireframe(np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="#d5dce0", lw=0.5)
    for axis, end in zip("xyz", np.eye(3), strict=True):
        ax.plot(*np.outer(end, (0.0, 1.2)), color=INK, lw=0.9)
        ax.text(*(1.32 * end), axis, color=INK, ha="center", va="center")
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=1.6)
    ax.view_init(elev=-38.0, azim=-62.0)  # from below, where gravity points
    ax.set_axis_off()


def _png(figure: "Figure") -> bytes:
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=140)
    plt.close(figure)
    return buffer.getvalue()


def render(result: Result, pictures: dict[str, bytes], tool: ToolFile, check: LiveCheck | None, state: str) -> str:
    """The page; pictures are inside, so that it can be sent as one file."""
    from galen_hw.config.report_page import page_template

    images = {name: base64.b64encode(data).decode() for name, data in pictures.items()}
    return page_template("galen_hw.tools.calibration", "report.html.j2").render(
        result=result,
        tool=tool,
        check=check,
        state=state,
        images=images,
        channels=[(c, unit(c)) for c in CHANNELS],
        tables=_tables(result, check),
        rows=[_row(result, c) for c in result.comparison.candidates],
        parameters=list(_parameters(result)),
    )


def _tables(result: Result, check: LiveCheck | None) -> dict[str, list[str]]:
    verification = result.verification
    tables = {
        "raw": verification.rms_before,
        "compensated": verification.rms,
        "residual of the fit": fit_rms(result),
        "noise of a pose's mean": verification.expected,
        "noise floor, one sample": result.poses.noise,
    }
    if check is not None:
        tables |= {"live: raw": check.rms_raw, "live: compensated": check.rms, "live: noise floor": check.noise}
    shown = {label: [_number(v) for v in values * SCALE] for label, values in tables.items()}
    if check is not None:
        shown["live: ratio"] = [f"{x:.3f}" for x in check.rms / check.noise]
    return shown


def _row(result: Result, c: Candidate) -> dict[str, Any]:
    score = [float(np.sum(o.score)) for o in result.comparison.candidates if o.score is not None]
    return {
        "title": c.title,
        "chosen": c.key == result.comparison.recommended,
        "unknowns": c.unknowns,
        "mass": f"{1e3 * c.mass:.2f}",
        "com": ", ".join(f"{1e3 * x:.2f}" for x in c.com),
        "rms": [_number(v) for v in left_out_rms(result, c) * SCALE],
        "bic": f"{c.bic:.0f}",
        "score": "" if c.score is None else f"{float(np.sum(c.score)) - max(score):.1f}",
        "p": "" if np.isnan(c.p_value) else "< 1e-6" if c.p_value < 1e-6 else f"{c.p_value:.2g}",
    }


def _parameters(result: Result) -> Iterator[tuple[str, str, str, str]]:
    found = result.estimate
    for name, value, std in zip(found.names, found.values, found.std, strict=True):
        factor, shown, digits = (1e3, "g", 3) if name.endswith("mass") else (1e3, "mm", 3)
        if name.startswith("bias."):
            factor, shown, digits = (1.0, "N", 4) if name[5] == "F" else (1e3, "N mm", 3)
        half = found.t95 * std * factor
        yield name.replace("_", " "), f"{value * factor:.{digits}f}", f"{half:.{digits}f}", shown


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.4f}" if value < 1.0 else f"{value:.3f}" if value < 10.0 else f"{value:.1f}"
