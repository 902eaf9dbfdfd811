"""One recording in memory: named columns of numbers and what they belong to."""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from galen_hw.recording.info import RecordingInfo
from galen_hw.spatial import Array

AXES = ("x", "y", "z")
WRENCH = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in AXES)
POSE = tuple(f"pose.position.{a}" for a in AXES) + tuple(f"pose.orientation.{a}" for a in (*AXES, "w"))
SENSOR_ORIENTATION = tuple(f"sensor.orientation.{a}" for a in (*AXES, "w"))
APPLIED = tuple(f"applied.force.{a}" for a in AXES)
IMU = tuple(f"imu.{kind}.{a}" for kind in ("acceleration", "angular_velocity") for a in AXES)
FIXED_COLUMNS = frozenset(("time", "segment", *WRENCH, *POSE, *SENSOR_ORIENTATION, *APPLIED, *IMU))
JOINT_KINDS = ("position", "velocity", "effort", "command")
GROUPS = ("wrench", "pose", *JOINT_KINDS, "targets", "sensor", "imu", "applied", "temperature", "covariate")


def joint_column(column: str) -> tuple[str, str] | None:
    """(joint, kind) of `joint.NAME.kind`; a name may have dots. None for other columns."""
    head, _, rest = column.partition(".")
    name, _, kind = rest.rpartition(".")
    return (name, kind) if head == "joint" and name and kind in JOINT_KINDS else None


def group_of(column: str) -> str | None:
    """The group that a column belongs to; None for `time` and `segment`; "covariate" for what is not known."""
    if column in ("time", "segment"):
        return None
    joint = joint_column(column)
    if joint:
        return joint[1]
    parts = column.split(".")
    if parts[0] == "target" and len(parts) >= 4 and parts[-2] == "position" and parts[-1] in AXES:
        return "targets"
    if parts[0] == "temperature" and len(parts) > 1:
        return "temperature"
    return parts[0] if column in FIXED_COLUMNS else "covariate"


@dataclass(frozen=True)
class Recording:
    """Samples by column name, all of one length.

    Args:
        columns: float arrays (N,), NaN where not measured; names as in `docs/recording.md`.
        info: what the columns belong to.
        path: folder or file that it was read from.
        simulation: the same columns as someone else simulated them.
        warnings: what is odd about the recording, one line each; not fatal.
        attachments: texts that an MCAP file bears (the robot's URDF, tools' files, the configuration).
        tool_file: text of the file of the tool in hand at the end, of an MCAP file; empty where it is not known.
        epoch: seconds since the epoch at time 0, of an MCAP file; None where it is not known.
    """

    columns: dict[str, Array]
    info: RecordingInfo = field(default_factory=RecordingInfo)
    path: Path = Path()
    simulation: "Recording | None" = None
    warnings: tuple[str, ...] = ()
    attachments: dict[str, str] = field(default_factory=dict)
    tool_file: str = ""
    epoch: float | None = None

    def __len__(self) -> int:
        """Number of samples (rows)."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def urdf(self) -> Path | str | None:
        """The robot that `info.robot` names: a file, or its text from an MCAP file; None for "galen" and no robot."""
        name = self.info.robot
        if name is None or name == "galen":
            return None
        return self.attachments.get(name, self.path / name)

    @property
    def urdf_text(self) -> str:
        """The text of `urdf`; empty where there is none."""
        urdf = self.urdf
        if isinstance(urdf, Path):
            return urdf.read_text(encoding="utf-8") if urdf.is_file() else ""
        return urdf or ""

    def with_robot(self, name: str, text: str) -> "Recording":
        """Return the same with another robot: the name of its URDF, and its text."""
        info = self.info.model_copy(update={"robot": name})
        return replace(self, info=info, attachments=self.attachments | {name: text})

    @property
    def about(self) -> str:
        """Where `info` was read, as errors name it: a file beside a table, attached to an MCAP file, or that file's own."""
        if self.path.is_file() and self.path.suffix != ".mcap":
            return str(self.path)
        if self.path.suffix != ".mcap":
            return str(self.path / "recording.json")
        return f"{self.path}: recording.json" if "recording.json" in self.attachments else str(self.path)

    def place(self, where: str) -> str:
        """What an error calls "recording" or "recording.json: KEY", with the name of this recording."""
        if where.startswith("recording.json"):
            return self.about + where.removeprefix("recording.json")
        return str(self.path) if where == "recording" else where

    def has(self, *names: str) -> bool:
        """Return whether every named column or group is there."""
        return all(name in self.columns or (name in GROUPS and bool(self.names(name))) for name in names)

    @property
    def time(self) -> Array | None:
        """(N,) s, or None where only the order is known."""
        return self.columns.get("time")

    @property
    def segment(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """(N,) whole numbers; samples of different segments are not continuous with each other."""
        found = self.columns.get("segment")
        return np.zeros(len(self), dtype=np.int64) if found is None else found.astype(np.int64)

    @property
    def segments(self) -> list[slice]:
        """Runs of rows of one segment, in order."""
        if "segment" not in self.columns:
            return [slice(0, len(self))] if len(self) else []
        edges = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *edges.tolist(), len(self)]
        return [slice(a, b) for a, b in pairwise(bounds) if b > a]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in the order in which they first appear."""
        found = (joint_column(column) for column in self.columns)
        return tuple(dict.fromkeys(joint[0] for joint in found if joint))

    def names(self, group: str) -> tuple[str, ...]:
        """Column names of a group (`GROUPS`), in the order of the file; vectors in the order x y z w."""
        return tuple(column for column in self.columns if group_of(column) == group)

    def group(self, name: str) -> dict[str, Array]:
        """Columns of a group by name, see `names`; "covariate" holds every column that is not known."""
        return {column: self.columns[column] for column in self.names(name)}

    def matrix(self, *names: str) -> Array:
        """(N, k) of the named columns; NaN where a column is absent."""
        missing = np.full(len(self), np.nan)
        return np.stack([self.columns.get(name, missing) for name in names], axis=-1)

    def joints(self, kind: str = "position", names: tuple[str, ...] | None = None) -> Array:
        """(N, n) of joint positions, velocities, efforts or commands; NaN where a joint has none."""
        names = self.joint_names if names is None else names
        return self.matrix(*(f"joint.{name}.{kind}" for name in names)) if names else np.empty((len(self), 0))

    @property
    def wrench(self) -> Array:
        """(N, 6) force (N), then torque (N m), raw, in the sensor frame."""
        return self.matrix(*WRENCH)
