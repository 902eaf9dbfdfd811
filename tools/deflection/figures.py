"""Figures of the deflection models, as the report's 3, 4, 5, 7, 10 and 11 for each of them, and one HTML page."""

import base64
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.identification.deflection.compare import counted, judged
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.lstm import Lstm
from galen_hw.spatial import Array
from galen_hw.tools.calibration.figures import BAND, DONE, INK, RAW, STYLE
from galen_hw.tools.deflection.fit import Comparison
from galen_hw.tools.outputs import figures_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from galen_hw.kinematics import Robot

NUMBERS: Final = {
    "independent linear": "3, 4, 10 and 11",
    "coupled linear": "5, 10 and 11",
    "LSTM (report)": "6, 10 and 11",
}


def write_report(out: Comparison, page: Path) -> Path:
    """Write the page with its figures inside, and the figures as PNG beside it in `NAME-figures/`."""
    folder = figures_beside(page)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for name, title, figure in figures(out):
        data = png(figure)
        (folder / f"{name}.png").write_bytes(data)
        pictures.append({"title": title, "data": base64.b64encode(data).decode()})
    page.write_text(_render(out, pictures), encoding="utf-8")
    return page


def _render(out: Comparison, pictures: list[dict[str, str]]) -> str:
    from galen_hw.config.report_page import page_template

    elastic = out.models.get("elastic arm")
    arm = elastic if isinstance(elastic, ElasticArm) else None
    return page_template("galen_hw.tools.deflection", "report.html.j2").render(
        out=out,
        pictures=pictures,
        arm=arm,
        units=[] if arm is None else units(arm, out.learn[0].observations.belief.robot),
    )


def units(arm: ElasticArm, robot: "Robot | None") -> list[str]:
    """SI unit of each parameter: a joint that turns gives in rad under N m, all other ports in m under N."""
    turning: set[str] = set()
    if robot is not None:
        J = robot.sensor_jacobian(0.5 * (robot.lower + robot.upper))[0]
        turning = {name for name, w in zip(robot.joint_names, J[3:].T, strict=True) if np.any(np.abs(w) > 0.0)}
    out = []
    for term in arm.terms:
        motion, load = ("rad", "(N m)") if term.port in turning else ("m", "N")
        power = getattr(term.effect, "power", 1) if getattr(term.effect, "knee", None) is None else 1
        raised = f"^{power}" if term.kind == "hardening" and power > 1 else ""
        out.append(motion if term.kind == "play" else f"{motion}/{load}{raised}")
    return out


def errors_figure(out: Comparison) -> "Figure":
    """Draw the held-out error of all models, kind by kind."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        return _errors(out, Figure((8.4, 3.2), layout="constrained"))


def figures(out: Comparison) -> Iterator[tuple[str, str, "Figure"]]:
    """Name, title and figure, one after the other."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        if out.held:
            yield "errors", "Held-out error of all models", errors_figure(out)
        for name in out.models:
            if out.held:
                figure = _model(out, name, Figure((10.0, 5.4), layout="constrained"))
                number = NUMBERS.get(name)
                title = f"{name}, as in the report's figures {number}" if number else f"{name}, the same figures"
                yield "model-" + "".join(c if c.isalnum() else "-" for c in name.lower()).strip("-"), title, figure
        net = out.models.get("LSTM (report)")
        if isinstance(net, Lstm) and net.losses:
            figure = Figure((5.2, 2.8), layout="constrained")
            axes = figure.subplots()
            axes.semilogy(np.arange(1, len(net.losses) + 1), net.losses, color=DONE)
            axes.set(xlabel="iteration", ylabel="mean square, scaled", title="Training of the net")
            yield "training", "Training of the LSTM (report, figure 7)", figure
        if out.held:
            yield "wall", "A virtual wall: share of the time on its wrong side", _wall(out)


def _errors(out: Comparison, figure: "Figure") -> "Figure":
    axes, kinds = figure.subplots(), list(out.held)
    width = 0.8 / max(len(out.models), 1)
    colours = ["#b9c3c8", "#8a979e", RAW, "#c9b04a", DONE]
    for i, name in enumerate(out.models):
        heights = [1e3 * out.scores[name].rmse[kind] for kind in kinds]
        bars = axes.bar(np.arange(len(kinds)) + i * width, heights, 0.9 * width, label=name, color=colours[i % 5])
        axes.bar_label(bars, fmt="%.2f", fontsize=7)
    axes.axhline(1e3 * out.noise_m, color=INK, lw=1, ls=":", label="tracker noise")
    axes.set_xticks(np.arange(len(kinds)) + 0.4 - 0.5 * width, kinds)
    axes.set_ylabel("rms error of the tip, mm")
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _model(out: Comparison, name: str, figure: "Figure") -> "Figure":
    """Give over force at a known and at a new configuration, and along x over time."""
    same = next((s[0] for kind, s in out.held.items() if kind == "same configuration"), None)
    new = next((s[0] for kind, s in out.held.items() if kind == "new configuration"), None)
    shown = [(s, t) for s, t in ((same, "same configuration"), (new, "new configuration")) if s is not None]
    shown = shown or [(next(iter(out.held.values()))[0], next(iter(out.held)))]
    grid = figure.subplots(2, 4, squeeze=False, width_ratios=(1, 1, 1, 2.2)) if len(shown) == 2 else None
    rows: Any = grid if grid is not None else figure.subplots(1, 4, squeeze=False, width_ratios=(1, 1, 1, 2.2))
    for axes, (data, title) in zip(rows, shown, strict=True):
        _over_force(axes[:3], data, out.scores[name].predicted[data.name], title)
        _over_time(axes[3], data, out, name)
    return figure


def _centred(data: DeflectionSet, give: Array) -> Array:
    return 1e3 * counted(data, give[:, :3])


def _over_force(axes: Any, data: DeflectionSet, give: Array, title: str) -> None:
    measured, predicted = _centred(data, data.give), _centred(data, give)
    for i, (ax, letter) in enumerate(zip(axes, "xyz", strict=True)):
        ax.plot(data.force[:, i], measured[:, i], ".", ms=1.0, color=RAW, alpha=0.4, rasterized=True)
        ax.plot(data.force[:, i], predicted[:, i], ".", ms=1.0, color=DONE, rasterized=True)
        ax.set(xlabel=f"force {letter}, N", ylabel=f"give {letter}, mm")
    axes[0].set_title(title, loc="left")


def _over_time(ax: "Axes", data: DeflectionSet, out: Comparison, name: str) -> None:
    predicted = out.scores[name].predicted[data.name]
    axis = 0  # Along x, as in the report.
    measured, model = _centred(data, data.give)[:, axis], _centred(data, predicted)[:, axis]
    ax.plot(data.time, measured, color=RAW, lw=0.7, label="tracked")
    arm = out.models[name]
    if isinstance(arm, ElasticArm):
        half = 1.96e3 * np.sqrt(arm.variance(data)[:, axis])
        ax.fill_between(data.time, model - half, model + half, color=BAND, alpha=0.7, lw=0)
    ax.plot(data.time, model, color=DONE, lw=1.0, label="predicted")
    rms = float(np.sqrt(np.nanmean((measured - model)[judged(data)] ** 2)))
    ax.set(
        xlabel="time, s", ylabel=f"give {'xyz'[axis]}, mm", title=f"{data.name}: {rms:.3f} mm rms along {'xyz'[axis]}"
    )
    ax.legend(loc="upper right", fontsize=7)


def _wall(out: Comparison) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure((7.2, 2.6), layout="constrained")
    axes, names = figure.subplots(), list(out.walls)
    reported = 100 * out.walls[names[0]][0]
    shares = [100 * out.walls[n][1] for n in names]
    bars = axes.barh(["reported pose", *names], [reported, *shares], color=[RAW, *[DONE] * len(names)], height=0.6)
    axes.bar_label(bars, fmt="%.1f %%", fontsize=8, padding=3)
    axes.invert_yaxis()
    axes.set_xlabel("time on the wrong side, % (mean of nine walls across the way that the tip gives)")
    axes.grid(visible=False, axis="y")
    return figure


def png(figure: "Figure") -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130)
    return stream.getvalue()
