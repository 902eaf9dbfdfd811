"""Universal Robots' RTDE as CSV: UR's own client (blank-separated) and ur_rtde's recorder (commas) write the same names.

`ft_raw_wrench` is what the sensor reads, in its frame. `actual_TCP_force` is turned to the base axes, about the tool's tip, and
the payload that the controller knows is taken off: it is turned back by `actual_TCP_pose`, the rest is said.
"""

from pathlib import Path
from typing import Final

import numpy as np

from galen_hw.formats.contents import Contents, Head, Stream
from galen_hw.formats.csv_table import header_of, read_stream
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from galen_hw.spatial import Array

JOINTS: Final = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
KINDS: Final = {
    "actual_q": "position",
    "actual_qd": "velocity",
    "actual_current_as_torque": "effort",
    "target_q": "command",
}


def sniff(head: Head) -> bool:
    """By the names of the header."""
    names = set(header_of(head))
    return {"actual_q_0", "actual_q_5"} <= names or {"actual_TCP_pose_0", "actual_TCP_pose_5"} <= names


def read(path: Path) -> Contents:
    """One stream.

    Raises:
        UsageError: it cannot be read.
    """
    stream, notes, passed = read_stream(path)
    contents = Contents([stream], passed, notes)
    for name, kind in KINDS.items():
        hints = {f"{name}_{i}": f"joint.{joint}_joint.{kind}" for i, joint in enumerate(JOINTS)}
        stream.hints |= {column: target for column, target in hints.items() if column in stream.columns}
    rotation = _six(stream, "actual_TCP_pose")
    if rotation is not None:
        _add(stream, SENSOR_ORIENTATION, _quaternions(rotation[:, 3:]))
    raw, force = _six(stream, "ft_raw_wrench"), _six(stream, "actual_TCP_force")
    if raw is not None:
        _add(stream, WRENCH, raw)
        contents.how.append("ft_raw_wrench is the wrench, as the sensor reads it")
    elif force is not None and rotation is not None:
        _add(stream, WRENCH, _in_sensor(force, rotation[:, 3:]))
        contents.how.append(
            "actual_TCP_force is turned into the axes of the tool by actual_TCP_pose; the controller has taken its payload off"
        )
    elif force is not None:
        contents.passed.append("actual_TCP_force: in base axes, and no actual_TCP_pose that would turn it, not taken")
    _leave(contents, _DERIVED, "computed by the controller from what is compared")
    return contents


_DERIVED: Final = ("actual_TCP_", "target_TCP_", "ft_raw_wrench_", "target_moment", "target_current", "actual_current_")


def _leave(contents: Contents, starts: tuple[str, ...], why: str) -> None:
    """Leave columns out that would be found to explain what they were made of, and say so."""
    for stream in contents.streams:
        gone = [name for name in stream.columns if name.startswith(starts) and name not in stream.hints]
        for name in gone:
            del stream.columns[name]
        if gone:
            contents.passed.append(f"not taken, {why}: {', '.join(gone)}")


def _six(stream: Stream, name: str) -> Array | None:
    columns = [stream.columns.get(f"{name}_{i}") for i in range(6)]
    if any(column is None for column in columns):
        return None
    return np.stack([column for column in columns if column is not None], axis=1)


def _add(stream: Stream, names: tuple[str, ...], values: Array) -> None:
    stream.columns |= dict(zip(names, values.T, strict=True))
    stream.hints |= {name: name for name in names}


def _rotations(vectors: Array) -> tuple[Array, Array]:
    """Angle (N,) and axis (N, 3) of rotation vectors."""
    angle = np.linalg.norm(vectors, axis=1)
    return angle, vectors / np.where(angle > 0, angle, 1.0)[:, None]


def _quaternions(vectors: Array) -> Array:
    """(N, 4) x y z w of rotation vectors (N, 3)."""
    angle, axis = _rotations(vectors)
    return np.column_stack([axis * np.sin(angle / 2)[:, None], np.cos(angle / 2)])


def _in_sensor(wrench: Array, vectors: Array) -> Array:
    """Base axes to those of the tool: R^T f and R^T t, by Rodrigues' formula with the angle turned round."""
    angle, axis = _rotations(vectors)
    c, s = np.cos(angle)[:, None], -np.sin(angle)[:, None]
    halves = []
    for v in (wrench[:, :3], wrench[:, 3:]):
        along = np.sum(axis * v, axis=1, keepdims=True) * axis
        halves.append(v * c + np.cross(axis, v) * s + along * (1.0 - c))
    return np.hstack(halves)
