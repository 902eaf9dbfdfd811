"""A calibration on the terminal: candidates, parameters, and the report's tables 1 and 2 beside the noise floor."""

import numpy as np
from rich import box
from rich.columns import Columns
from rich.console import Console
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from galen_hw.config.tool_file import ToolFile
from galen_hw.identification.candidates import Candidate
from galen_hw.identification.model import CHANNELS
from galen_hw.spatial import Array
from galen_hw.tools.calibration.result import Result

SCALE = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
"""N and N m to N and N mm."""


def show_result(console: Console, result: Result) -> None:
    """Everything up to the question whether to accept."""
    console.print(candidates_table(result, console.width))
    console.print(Text.assemble(("  recommended  ", "bold green"), (result.best.title, "bold")))
    _say(console, Text(result.comparison.reason), 15)
    console.print()
    console.print(Columns([parameters_table(result), residual_table(result)], padding=(0, 4)))
    for line in result.remarks:
        _say(console, Text.assemble(("! ", "yellow"), line), 1)
    console.print()


def _say(console: Console, text: Text, indent: int) -> None:
    """Print a line of prose: wrapped on a terminal, unbroken where a program reads."""
    console.print(Padding(text, (0, 0, 0, indent)) if console.is_terminal else Text(" " * indent) + text)


def candidates_table(result: Result, width: int = 120) -> Table:
    """One row a candidate: what it finds, how it predicts what it has not seen; fewer columns where it is narrow."""
    table = _table("Candidates", _caption(result))
    table.add_column("", no_wrap=True)
    table.add_column("fit", no_wrap=True)
    heads = [
        ("n", 120),
        ("mass g", 0),
        ("com mm", 104),
        *((c, 0) for c in CHANNELS),
        ("BIC", 126),
        ("score", 0),
        ("p", 112),
    ]
    for head, least in heads:
        if width >= least:
            table.add_column(head, justify="right", no_wrap=True)
    best = max(float(np.sum(c.score)) for c in result.comparison.candidates if c.score is not None)
    for row in result.comparison.candidates:
        cells = _candidate_cells(result, row, best)
        kept = [cell for cell, (_, least) in zip(cells[2:], heads, strict=True) if width >= least]
        table.add_row(*cells[:2], *kept, style="bold green" if row.key == result.comparison.recommended else "")
    return table


def good_poses(result: Result) -> Array:
    """Rows over which the candidates are compared: those that the robust fit did not leave aside."""
    robust = next(c for c in result.comparison.candidates if c.key == "robust")
    assert robust.fit is not None
    keep = np.ones(len(result.poses.fit), dtype=bool)
    keep[robust.fit.outliers] = False
    return np.flatnonzero(keep).astype(float)


def _table(title: str, caption: str = "") -> Table:
    table = Table(title=title, caption=caption or None, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.title_justify = table.caption_justify = "left"
    table.title_style = "bold"
    return table


def left_out_rms(result: Result, row: Candidate) -> Array:
    """(6,) error of poses predicted by all others, N and N m, over the good poses."""
    rows = good_poses(result).astype(int)
    return np.asarray(np.sqrt(np.mean(row.left_out[rows] ** 2, axis=0)))


def _candidate_cells(result: Result, row: Candidate, best: float) -> list[str]:
    com = " ".join(f"{1e3 * x:.2f}" for x in row.com)
    rms = [_three(v) for v in left_out_rms(result, row) * SCALE]
    score = float("nan") if row.score is None else float(np.sum(row.score)) - best
    p = "" if np.isnan(row.p_value) else _p(row.p_value)
    chosen = ">" if row.key == result.comparison.recommended else ""
    return [
        chosen,
        row.title,
        str(row.unknowns),
        f"{1e3 * row.mass:.2f}",
        com,
        *rms,
        f"{row.bic:.0f}",
        f"{score:.1f}",
        p,
    ]


def _caption(result: Result) -> str:
    aside = len(result.poses.fit) - len(good_poses(result))
    left = f", {aside} poses left aside" if aside else ""
    return (
        f"Fx ... Tz: RMS error in N and N mm of each pose predicted from all the others ({len(result.poses.fit)}"
        f" poses{left}). n: fitted numbers. score: log probability of these errors, 0 is the best. "
        "p: chance of so large a value if the added unknown were nothing."
    )


def parameters_table(result: Result) -> Table:
    """The recommended fit's parameters with their 95 % intervals."""
    found = result.estimate
    title = f"{result.name}: what hangs on the sensor"
    table = _table(title, f"condition number {result.best.condition:.1f}")
    for head in ("parameter", "value", "+- (95 %)", "unit"):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right", no_wrap=True)
    for name, value, std in zip(found.names, found.values, found.std, strict=True):
        factor, shown_unit, digits = _shown(name)
        half = f"{found.t95 * std * factor:.{digits}f}"
        table.add_row(name.replace("_", " "), f"{value * factor:.{digits}f}", half, shown_unit)
    return table


def residual_table(result: Result) -> Table:
    """The report's tables 1 and 2: RMSE per axis on the poses to verify with, beside the sensor's noise floor."""
    check = result.verification
    held = check.kind.startswith("held")
    title = f"verification: {len(check.after)} {check.kind}" if held else f"verification: {check.kind}"
    table = _table(title)
    table.add_column("RMSE")
    for channel in CHANNELS:
        table.add_column(f"{channel} {unit(channel)}", justify="right", no_wrap=True)
    _add(table, "raw", check.rms_before)
    _add(table, "compensated", check.rms, style="bold green")
    _add(table, "residual of the fit", fit_rms(result))
    _add(table, "noise of a pose's mean", check.expected)
    _add(table, "noise floor, one sample", result.poses.noise)
    return table


def check_table(rms: Array, raw: Array, noise: Array) -> Table:
    """The live check: compensated samples in holds and slow motion beside the noise floor, and their ratio."""
    table = _table("Live compensation: every sample, in holds and in slow motion")
    table.add_column("RMSE")
    for channel in CHANNELS:
        table.add_column(f"{channel} {unit(channel)}", justify="right", no_wrap=True)
    _add(table, "raw", raw)
    _add(table, "compensated", rms, style="bold")
    _add(table, "noise floor, one sample", noise)
    ratio = rms / noise
    cells = [f"[{'green' if x <= 1.05 else 'red'}]{x:.3f}[/]" for x in ratio]
    table.add_row("compensated / noise floor", *cells)
    return table


def show_accepted(console: Console, tool: ToolFile, path: str) -> None:
    """Print the tool that is in use from now on; without a frame, which would break the path, where a program reads."""
    assert tool.mass is not None
    assert tool.com is not None
    com = ", ".join(f"{1e3 * x:.2f}" for x in tool.com)
    text = Text.assemble(
        (f"{tool.calibration_id}", "bold"), f"  mass {1e3 * tool.mass:.2f} g, centre of mass ({com}) mm\n{path}"
    )
    title = "accepted, for virtual robots" if tool.origin and tool.origin.virtual else "accepted"
    if console.is_terminal:
        console.print(Panel(text, title=title, title_align="left", border_style="green", expand=False))
    else:
        console.print(Text(f"{title}: ") + text)


def unit(channel: str) -> str:
    """Unit of a channel for people."""
    return "N" if channel.startswith("F") else "N mm"


def _shown(name: str) -> tuple[float, str, int]:
    if name.endswith("mass"):
        return 1e3, "g", 3
    if ".com." in f".{name}":
        return 1e3, "mm", 3
    return (1.0, "N", 4) if name.startswith("bias.F") else (1e3, "N mm", 3)


def fit_rms(result: Result) -> Array:
    """(6,) residual of the fit over the poses that were not left aside, N and N m."""
    fit = result.fit
    keep = np.setdiff1d(np.arange(len(fit.weight)), fit.outliers)
    return np.asarray(np.sqrt(np.mean(fit.residual[keep] ** 2, axis=0)))


def _add(table: Table, label: str, values: Array, style: str = "") -> None:
    cells = ["-" if not np.isfinite(v) else _three(v) for v in values * SCALE]
    table.add_row(label, *cells, style=style)


def _three(value: float) -> str:
    return f"{value:.4f}" if value < 1.0 else f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


def _p(value: float) -> str:
    return "<1e-6" if value < 1e-6 else f"{value:.2g}"
