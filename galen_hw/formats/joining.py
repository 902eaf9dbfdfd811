"""Streams on clocks of their own, joined on the clock of the group that is compared."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from galen_hw.clock import NS_PER_S
from galen_hw.errors import UsageError
from galen_hw.formats.contents import Stream
from galen_hw.formats.mapping import Entry, Map
from galen_hw.recording.from_mcap import at_times
from galen_hw.recording.recording import group_of
from galen_hw.spatial import Array

ORDER: Final = ("wrench", "effort", "pose", "targets", "position")
"""Whose samples are the rows, where nothing is named to compare."""
SAME_S: Final = 1e-9
"""Stamps in whole nanoseconds that are this near are the same."""


@dataclass
class Joined:
    """The table, and where its rows come from.

    Args:
        columns: ours, (N,); epoch: s since 1970 at time 0, None where it is not known.
        account: one line a stream: rows in, rows out, dropped and why.
    """

    columns: dict[str, Array]
    epoch: float | None = None
    account: list[str] = field(default_factory=list)


def join(streams: Sequence[Stream], what: Map, predict: str | None) -> Joined:
    """Every mapped column at the samples of one stream.

    Raises:
        UsageError: nothing is mapped, or streams have no clock or no time in common.
    """
    by_name = {stream.name: stream for stream in streams}
    wanted: dict[str, list[Entry]] = defaultdict(list)
    for entry in what.entries:
        wanted[entry.stream].append(entry)
    if not wanted:
        raise UsageError("no column is one of a recording", todo="name them in a map: --write-map MAP.toml, then --map")
    base = by_name[what.rows or _base(wanted, predict)]
    joined = Joined({})
    shift = {name: what.offset_s.get(name, 0.0) for name in wanted}
    time = _clock(base, what)
    if time is not None:
        time = time + shift.get(base.name, 0.0)
        joined.columns["time"] = time
        joined.epoch = None if base.origin_ns is None else base.origin_ns / NS_PER_S
    joined.account.append(_line(base, f"{len(base)} rows out"))
    joined.columns |= {e.target: _scaled(base.columns[e.column], e.factor) for e in wanted[base.name]}
    for name, entries in wanted.items():
        if name != base.name:
            _add(joined, base, by_name[name], entries, what, shift[name])
    for stream in streams:
        if stream.name not in wanted:
            joined.account.append(_line(stream, "not taken: no column of it is in the map"))
    return joined


def _scaled(values: Array, factor: float) -> Array:
    """In SI; of a million rows no second copy is made where there is nothing to do."""
    return values if factor == 1.0 else values * factor


def _base(wanted: dict[str, list[Entry]], predict: str | None) -> str:
    groups = {name: {group_of(entry.target) for entry in entries} for name, entries in wanted.items()}
    for group in filter(None, (predict, *ORDER)):
        found = next((name for name, having in groups.items() if group in having), None)
        if found is not None:
            return found
    return next(iter(wanted))


def _clock(stream: Stream, what: Map) -> Array | None:
    if what.stamps == "log" and stream.logged is not None:
        return stream.logged
    return stream.time


def _line(stream: Stream, end: str, dropped: dict[str, int] | None = None) -> str:
    lost = {**stream.lost, **(dropped or {})}
    reasons = "".join(f"; {count} dropped: {why}" for why, count in lost.items() if count)
    return f"{stream.title}: {stream.rows_in} in, {end}{reasons}"


def _add(joined: Joined, base: Stream, stream: Stream, entries: list[Entry], what: Map, shift: float) -> None:
    """The columns of another stream, interpolated to the rows; the age of the newest sample of joints is kept."""
    time, t = joined.columns.get("time"), _clock(stream, what)
    if time is None or t is None:
        if len(stream) != len(base):
            clockless = base if time is None else stream
            what_ = f"{len(stream)} rows of {stream.title} beside {len(base)} of {base.title}, and no clock"
            raise UsageError(f"{clockless.title} has no time: {what_}", todo="give a map that leaves one of them out")
        joined.columns |= {e.target: stream.columns[e.column] * e.factor for e in entries}
        joined.account.append(_line(stream, "joined row by row: there is no clock"))
        return
    t = t + shift + _between(base, stream, told=stream.name in what.offset_s or base.name in what.offset_s)
    keep = _increasing(t)
    dropped = {"a time that is not after the one before": len(t) - int(keep.sum())}
    t = t[keep]
    if not len(t) or t[0] > time.max() or t[-1] < time.min():
        span = f"{t[0]:.6g} to {t[-1]:.6g} s" if len(t) else "none"
        what_ = f"{stream.title} ({span}) shares no time with {base.title} ({time.min():.6g} to {time.max():.6g} s)"
        raise UsageError(what_, todo="give the difference of their clocks as offset_s in a map")
    series = {e.target: stream.columns[e.column][keep] * e.factor for e in entries}
    _continue_turns(series)
    out = {target: at_times(time, t, values) for target, values in series.items()}
    _unit_length(out)
    joined.columns |= out
    if any(e.target.startswith("joint.") for e in entries):
        newest = np.searchsorted(t, time + SAME_S, side="right") - 1
        joined.columns["covariate.joint_age"] = np.where(
            newest < 0, np.nan, np.maximum(time - t[np.maximum(newest, 0)], 0.0)
        )
    first = next(iter(out.values()))
    empty = int(np.isnan(first).sum())
    beyond = f", {empty} rows without it" if empty else ""
    joined.account.append(_line(stream, f"interpolated to the {len(time)} rows of {base.title}{beyond}", dropped))


def _between(base: Stream, stream: Stream, *, told: bool) -> float:
    """What to add to a stream's time so that it counts from the base's origin, s.

    Args:
        base, stream: as they are.
        told: a person gave offsets: a clock of its own then counts, with its offset, from 1970.
    """
    if (base.origin_ns is None) != (stream.origin_ns is None) and not told:
        one, other = (base, stream) if base.origin_ns is None else (stream, base)
        what = f"{one.title} counts from a moment of its own, {other.title} from 1970"
        raise UsageError(what, todo="give that moment (s since 1970) as offset_s of the first in a map")
    return ((stream.origin_ns or 0) - (base.origin_ns or 0)) / NS_PER_S


def _increasing(t: Array) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Samples later than every one before them."""
    highest = np.maximum.accumulate(np.concatenate([[-np.inf], t[:-1]])) if len(t) else t
    return np.asarray(t > highest)


def _turns(columns: dict[str, Array]) -> list[list[str]]:
    found = [[f"{head}.orientation.{a}" for a in "xyzw"] for head in ("pose", "sensor")]
    return [names for names in found if all(name in columns for name in names)]


def _continue_turns(series: dict[str, Array]) -> None:
    """Give neighbours the same sign: a quaternion and its negative are one rotation, but what lies between is none."""
    for names in _turns(series):
        q = np.stack([series[name] for name in names])
        flips = np.cumsum(np.einsum("ij,ij->j", q[:, 1:], q[:, :-1]) < 0) % 2
        signs = np.concatenate([[1.0], 1.0 - 2.0 * flips])
        for name in names:
            series[name] = series[name] * signs


def _unit_length(out: dict[str, Array]) -> None:
    for names in _turns(out):
        size = np.sqrt(np.sum([out[name] ** 2 for name in names], axis=0))
        size = np.where(np.abs(size - 1.0) < 0.2, size, 1.0)  # one that was none stays as it was
        for name in names:
            out[name] = out[name] / size
