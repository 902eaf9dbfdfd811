"""What is odd about a recording without making it unreadable: one line each, for people."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from galen_hw.recording.recording import (
    JOINT_KINDS,
    POSE,
    SENSOR_ORIENTATION,
    WRENCH,
    Recording,
    group_of,
    joint_column,
)
from galen_hw.spatial import Array

GAP_FACTOR = 5.0
"""A step of time this many times the median is a gap."""
FEW = 3
"""Names that are shown of many columns with the same remark."""


def check(recording: Recording) -> list[str]:
    """All warnings of a recording."""
    with np.errstate(over="ignore", invalid="ignore"):  # a cell may hold any number: that is what is looked for
        found = [*_keys(recording), *_clock(recording), *_cells(recording), *_units(recording), *_vectors(recording)]
    if recording.simulation is not None:
        found += check_simulation(recording, recording.simulation)
    return found


def check_simulation(recording: Recording, simulation: Recording) -> list[str]:
    """Warnings of the simulation beside a recording, and of how the two match."""
    return [f"simulation: {line}" for line in (*simulation.warnings, *_match(recording, simulation))]


def _keys(recording: Recording) -> Iterator[str]:
    for key in recording.info.unknown:
        yield f"recording.json: {key} is not a known key and is not used"
    size = float(np.linalg.norm(recording.info.gravity))
    if not 9.5 < size < 10.1:
        yield f"recording.json: gravity has the size {size:.4g} m/s^2"
    tool = recording.info.tool
    for key, vector in (("com", tool.com), ("tip", tool.tip)) if tool else ():
        if vector is not None and max(map(abs, vector)) > 1.5:
            yield f"recording.json: tool.{key} reaches {max(map(abs, vector)):.4g} m: is it in mm?"
    for column in recording.info.ranges:
        if column not in recording.columns:
            yield f"recording.json: ranges names {column}, which is not a column"
    unknown = [c for c in recording.names("covariate") if not c.startswith("covariate.")]
    if unknown:
        yield f"not known columns, kept as covariates: {', '.join(unknown)}"


def _clock(recording: Recording) -> Iterator[str]:
    time = recording.time
    if time is None or len(time) < 3:
        return
    steps = np.concatenate([np.diff(time[part]) for part in recording.segments])
    forward = steps > 0
    if not forward.any():
        yield "time: does not advance"
        return
    step = float(np.median(steps if forward.all() else steps[forward]))
    for what, found in (
        ("runs backwards", steps < 0),
        ("repeats", steps == 0),
        (f"has gaps of more than {GAP_FACTOR:.0f} times the median step of {step:.6g} s", steps > GAP_FACTOR * step),
    ):
        if found.any():
            yield f"time: {what} at {int(found.sum())} places, first at row {_row(int(np.argmax(found)), recording.segments)}"
    if step >= 0.5 and len(time) > 200:
        yield f"time: the median step is {step:.4g} s: is it in ms or a row number?"


def _row(step: int, parts: Sequence[slice]) -> int:
    """The row, counted from 1, that a step of time ends at; steps are those within the parts, one part after the other."""
    for part in parts:
        inside = part.stop - part.start - 1
        if step < inside:
            break
        step -= inside
    return int(part.start) + step + 2


def _cells(recording: Recording) -> Iterator[str]:
    still, empty = dict[str, list[str]](), dict[str, list[str]]()
    for name, values in recording.columns.items():
        if missing := int(np.isnan(values).sum()):
            empty.setdefault(f"{missing} of {len(values)} cells are empty", []).append(name)
        if name not in ("time", "segment") and len(values) > 2 and np.nanmax(values) == np.nanmin(values):
            still.setdefault(f"{values[~np.isnan(values)][0]:.6g}", []).append(name)
    for what, names in empty.items():
        yield f"{_few(names)}: {what}"
    for value, names in still.items():
        yield f"{_few(names)}: constant at {value}"


def _few(names: list[str]) -> str:
    return ", ".join(names[:FEW]) + (f" and {len(names) - FEW} more" if len(names) > FEW else "")


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values)))


def _units(recording: Recording) -> Iterator[str]:
    limits = {
        "pose": (20.0, "m: is it in mm?"),
        "targets": (20.0, "m: is it in mm?"),
        "imu": (400.0, "m/s^2 or rad/s: is it in mg or degrees?"),
        "temperature": (200.0, "degrees Celsius: is it in kelvin?"),
    }
    for name, values in recording.columns.items():
        group, joint = group_of(name), joint_column(name)
        if joint and joint[1] in ("position", "command") and _largest(values) > 4.0 * np.pi:
            yield f"{name}: reaches {_largest(values):.4g}: is it in degrees or mm?"
        if group in limits and _largest(values) > limits[group][0]:
            yield f"{name}: reaches {_largest(values):.4g} {limits[group][1]}"
    if recording.has(*WRENCH):
        # Column by column: a million rows are not held twice.
        force, torque = (
            np.mean([np.nanmean(recording.columns[n] ** 2) for n in part]) for part in (WRENCH[:3], WRENCH[3:])
        )
        lever = float(np.sqrt(torque / force)) if force > 0.0 else 0.0  # of a sensor of torques alone nothing is known
        if lever > 5.0:
            yield f"wrench: torque is {lever:.3g} m times the force: is it in N mm?"


def _vectors(recording: Recording) -> Iterator[str]:
    for names in (SENSOR_ORIENTATION, POSE[3:]):
        there = [name for name in names if name in recording.columns]
        if len(there) == 4:
            size = np.linalg.norm(recording.matrix(*names), axis=1)
            off = np.flatnonzero(np.abs(size - 1.0) > 1e-3)
            if len(off):
                row = off[0]
                yield f"{names[0][:-2]}: not of length 1 in {len(off)} rows, first {size[row]:.6g} at row {row + 1}"
    for whole in (WRENCH, SENSOR_ORIENTATION, POSE[:3], POSE[3:]):
        there = [name for name in whole if name in recording.columns]
        if there and len(there) < len(whole):
            yield f"{there[0]} is there but {next(n for n in whole if n not in there)} is not"
    for kind, columns in groupby(sorted(recording.columns, key=_kind_key), _kind_key):
        having = [joint[0] for c in columns if (joint := joint_column(c))]
        absent = [name for name in recording.joint_names if name not in having]
        if kind in JOINT_KINDS and absent:
            yield f"joint {kind} is there for {len(having)} joints but not for {', '.join(absent)}"


def _kind_key(column: str) -> str:
    joint = joint_column(column)
    return joint[1] if joint else ""


def _match(recording: Recording, simulation: Recording) -> Iterator[str]:
    clocked = recording.time is not None and simulation.time is not None
    if not clocked and len(simulation) != len(recording):
        yield f"{len(simulation)} rows beside {len(recording)} and no common clock to match them by"
    if clocked and simulation.time is not None and recording.time is not None:
        outside = (recording.time < simulation.time.min()) | (recording.time > simulation.time.max())
        if outside.any():
            yield f"{int(outside.sum())} samples of the recording lie outside its time"
