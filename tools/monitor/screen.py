"""What `galen-hw monitor` shows: topics, wrench, joints and tip, and how everything is doing; side by side if it fits."""

import math
import time
from collections.abc import Mapping
from typing import Any, Final

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.rule import Rule
from rich.table import Table

from galen_hw.messages import Health, JointsState, Pose, WrenchCompensated, WrenchRaw
from galen_hw.tools.monitor.view import WINDOW_S, View, fresh_for_s

BAR_WIDTH: Final = 21
FULL_SCALE: Final = {"force": 10.0, "torque": 1.0}
WIDE: Final = 138
"""Columns from which on two panels stand side by side."""
COLOURS: Final = {"ready": "green", "fault": "red", "degraded": "yellow", "starting": "cyan"}
ACCENT: Final = "deep_sky_blue3"
GONE: Final = "the daemon has ended: nothing below is the present; galen-hw run starts it"


def screen(view: View, lost: Mapping[str, int], about: str, width: int, *, gone: bool = False) -> RenderableType:
    """Everything, for a terminal of this width.

    Args:
        lost: messages that never came, by topic; about: which daemon, one line; gone: it does not run any more.
    """
    now = time.monotonic()
    upper = [_topics(view, lost, now), _wrench(view, now)]
    lower = [_joints(view, now), _pose(view, now)]
    parts: list[RenderableType] = [Rule(f"[bold]galen-hw monitor[/]  {escape(about)}", align="left", style=ACCENT)]
    parts += [f"[bold white on red] {GONE} [/]"] if gone else []
    for panels in (upper, lower):
        found = [panel for panel in panels if panel is not None]
        parts += [_beside(found)] if width >= WIDE and len(found) > 1 else found
    if (alarms := _alarms(view, now)) is not None:
        parts.append(alarms)
    parts.append(_states(view, now))
    return Group(*parts)


def _beside(panels: list[Panel]) -> Table:
    grid = Table.grid(expand=True)
    for _ in panels:
        grid.add_column(ratio=1)
    grid.add_row(*panels)
    return grid


def _panel(title: str, content: RenderableType, style: str = "grey50") -> Panel:
    return Panel(content, title=f"[bold]{title}[/]", title_align="left", border_style=style, box=box.ROUNDED)


def _table(*heads: str, numbers: tuple[int, ...] = ()) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", expand=False)
    for i, head in enumerate(heads):
        table.add_column(head, justify="right" if i in numbers else "left", no_wrap=True)
    return table


def _topics(view: View, lost: Mapping[str, int], now: float) -> Panel:
    table = _table("topic", "source", "rate Hz", "age ms", "lost", "valid", numbers=(2, 3, 4))
    for name, seen in sorted(view.topics.items()):
        rate, age_ms, missing = view.rate_hz(name, now), 1e3 * view.age_s(name, now), lost.get(name, 0)
        silent, old = not rate and name != "fault", view.is_old(name, now)
        table.add_row(
            f"[dim]{name}[/]" if silent else name,
            seen.message.source,
            f"[{'red' if old else 'dim'}]none for {WINDOW_S:g} s[/]" if silent else f"{rate:.1f}",
            f"[red]{age_ms:.1f}[/]" if old else f"{age_ms:.1f}",
            f"[red]{missing}[/]" if missing else "[dim]0[/]",
            f"[red]{_old(view, name, now)}[/]" if old else "[green]yes[/]" if seen.message.valid else "[red]no[/]",
        )
    return _panel("topics", table, "red" if any(view.is_old(name, now) for name in view.topics) else "grey50")


def _old(view: View, topic: str, now: float) -> str:
    """Why a message is not the present: nothing came since, or what comes is late."""
    late = now - view.topics[topic].heard_s <= fresh_for_s(topic)
    return f"{'late by' if late else 'silent for'} {view.age_s(topic, now):.1f} s"


def _title(view: View, title: str, topic: str, now: float) -> str:
    """A panel's title; with a red remark where its numbers are old."""
    return f"{title} [red]{_old(view, topic, now)}[/]" if view.is_old(topic, now) else title


def _wrench(view: View, now: float) -> Panel | None:
    """Compensated (or raw) force and torque as numbers and bars, and beside it the raw reading."""
    raw, done = _message(view, "wrench/raw", WrenchRaw), _message(view, "wrench/compensated", WrenchCompensated)
    shown = done or raw
    if shown is None:
        return None
    topic = "wrench/compensated" if done else "wrench/raw"
    colour = "green" if shown.valid and not view.is_old(topic, now) else "red"
    table = _table("", "raw", "compensated" if done else "", "", "", numbers=(1, 2))
    for kind, unit in (("force", "N"), ("torque", "N m")):
        for axis in "xyz":
            value = getattr(getattr(shown, kind), axis)
            before = getattr(getattr(raw, kind), axis) if raw else math.nan
            text = f"[bold]{value:9.3f}[/]" if done else ""
            cells = (f"{before:9.3f}", text, unit, f"[{colour}]{bar(value, FULL_SCALE[kind])}[/]")
            table.add_row(f"{kind} {axis}", *cells)
    scale = f"bars: {FULL_SCALE['force']:g} N, {FULL_SCALE['torque']:g} N m"
    by = "no tool: nothing is taken off" if not done or not done.calibration else f"with {done.calibration}"
    by += "; [red]the sensor is not zeroed[/]" if done and done.unzeroed else ""
    return _panel(_title(view, "wrench", topic, now), Group(table, f"[dim]{scale}; {by}[/]"), colour)


def _joints(view: View, now: float) -> Panel | None:
    state = _message(view, "joints/state", JointsState)
    if state is None:
        return None
    table = _table("joint", "m or rad", "per s", "", numbers=(1, 2))
    for name, position in state.position.items():
        velocity = state.velocity.get(name, math.nan)
        table.add_row(name, f"{position:.5f}", f"{velocity:.4f}", _limits(state, name))
    bad = state.estop or view.is_old("joints/state", now)
    return _panel(_title(view, "joints", "joints/state", now), table, "red" if bad else "grey50")


def _limits(state: JointsState, name: str) -> str:
    words = [
        word
        for word, flags in (("at lower limit", state.at_lower), ("at upper limit", state.at_upper))
        if flags.get(name)
    ]
    words += ["moving"] if state.moving.get(name) else []
    return "[red]emergency stop[/]" if state.estop else ", ".join(words)


def _pose(view: View, now: float) -> Panel | None:
    """Tip as the joints tell it, and what the arm's give adds."""
    reported, corrected = _message(view, "pose/reported", Pose), _message(view, "pose/corrected", Pose)
    if reported is None:
        return None
    table = _table("tip, mm", "x", "y", "z", "", numbers=(1, 2, 3))
    table.add_row("reported", *(f"{1e3 * v:z.2f}" for v in _xyz(reported)), reported.tool or "no tool")
    if corrected is not None:
        table.add_row("corrected", *(f"{1e3 * v:z.2f}" for v in _xyz(corrected)), corrected.model)
        gap = [1e3 * (c - r) for c, r in zip(_xyz(corrected), _xyz(reported), strict=True)]
        table.add_row("[bold]give[/]", *(f"[bold]{v:z.3f}[/]" for v in gap), f"{math.hypot(*gap):.3f} mm in all")
    title = _title(view, "tip in the base", "pose/reported", now)
    return _panel(title, table, "red" if view.is_old("pose/reported", now) else "grey50")


def _xyz(pose: Pose) -> tuple[float, float, float]:
    return pose.position.x, pose.position.y, pose.position.z


def _alarms(view: View, now: float) -> Panel | None:
    """What `health` wants an operator to know; nothing while there is no alarm or it is silent (which `topics` says)."""
    health = _message(view, "health", Health)
    if health is None or not health.alarms or view.is_old("health", now):
        return None
    table = _table("level", "what", "to do")
    table.columns[1].no_wrap = table.columns[2].no_wrap = False
    for alarm in health.alarms:
        colour = {"advice": "cyan", "warning": "yellow"}.get(alarm.level, "red")
        table.add_row(f"[{colour}]{alarm.level}[/]", escape(alarm.what), f"[dim]{escape(alarm.todo)}[/]")
    return _panel("alarms", table, {"advice": "cyan", "warning": "yellow"}.get(health.state, "red"))


def _states(view: View, now: float) -> Panel:
    table = _table("source", "state", "detail")
    table.columns[2].no_wrap = False
    found = set()
    for name, (status, heard_s) in sorted(view.statuses.items()):
        silent = view.is_silent(name, now)
        state = f"silent for {now - heard_s:.1f} s" if silent else status.state
        found.add("fault" if silent else status.state)
        colour = "red" if silent else COLOURS.get(status.state, "default")
        todo = f"; [dim]to do: {escape(status.todo)}[/]" if status.todo and not silent else ""
        detail = f"[dim]{escape(status.detail)}[/]" if silent else escape(status.detail) + todo
        table.add_row(name, f"[{colour}]{state}[/]", detail)
    worst = next((c for s, c in (("fault", "red"), ("degraded", "yellow")) if s in found), "grey50")
    if not view.last_fault:
        return _panel("state", table, worst)
    ago = now - view.last_fault_s
    return _panel("state", Group(table, f"[yellow]last fault, {ago:.0f} s ago[/]  {escape(view.last_fault)}"), worst)


def _message(view: View, topic: str, kind: type[Any]) -> Any:
    seen = view.topics.get(topic)
    return seen.message if seen is not None and isinstance(seen.message, kind) else None


def bar(value: float, full_scale: float) -> str:
    """A bar from the middle: left negative, right positive, to half a cell; full at `full_scale`."""
    half = BAR_WIDTH // 2
    steps = min(2 * half, round(2 * half * abs(value) / full_scale)) if math.isfinite(value) else 0
    cells, rest = divmod(steps, 2)
    left, right = ("▐" * rest + "█" * cells, "") if value < 0 else ("", "█" * cells + "▌" * rest)
    return f"{left:>{half}}│{right:<{half}}"
