"""The raw sweep on disk: a table folder that is complete after every pose, so that nothing is lost with a power cut."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.config.tool_store import write_atomic
from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from galen_hw.services.calibration.plan import Step
from galen_hw.spatial import Array, quaternion_from_rotation

STD = tuple(f"covariate.std.{name.removeprefix('wrench.')}" for name in WRENCH)


class SweepFile:
    """Writes `recording.csv`, `recording.json` and `sweep.json` of one sweep.

    Args:
        folder: of this sweep, made here; robot: for joint names and the sensor's orientation.
        about: what is known when it begins (tool, sensor serial, settings, start), for `sweep.json`.

    Raises:
        UsageError: the folder cannot be written.
    """

    def __init__(self, folder: Path, robot: Robot, about: dict[str, Any]) -> None:
        self.folder, self._robot, self._about = folder, robot, about
        self._rows: list[str] = []
        names = (f"joint.{name}.position" for name in robot.joint_names)
        flags = (f"covariate.{name}" for name in ("pose", "samples", "tool", "verify", "home"))
        self._header = ",".join(("time", *names, *SENSOR_ORIENTATION, *WRENCH, *STD, *flags))

    def __len__(self) -> int:
        """Number of poses written."""
        return len(self._rows)

    def begin(self, zeroed_at: dict[str, float]) -> None:
        """Write what the columns belong to, once the sensor has been zeroed."""
        galen = isinstance(self._robot, GalenRobot)
        R0 = self._rotation(np.array([zeroed_at[name] for name in self._robot.joint_names]))
        info = {
            "schema": 1,
            "robot": "galen" if galen else None,
            "tool": {"name": self._about.get("tool", "")},
            "zeroed_at": zeroed_at if galen else quaternion_from_rotation(R0).tolist(),
            "gravity": [float(g) for g in self._robot.gravity],
            "predict": "wrench",
            "model": {"bias": "free"},
            "sensor_serial": self._about.get("sensor_serial", ""),
            "virtual": bool(self._about.get("virtual")),
            "notes": "static poses of a calibration sweep, averaged; see sweep.json",
        }
        write_atomic(self.folder / "recording.json", json.dumps(info, indent=1) + "\n")
        self.note("running")

    def add(self, step: Step, *, time_s: float, q: Array, mean: Array, std: Array, samples: int) -> None:
        """Add a pose: joints (n,), mean and scatter of one sample (6,)."""
        orientation = quaternion_from_rotation(self._rotation(q))
        flags = (len(self._rows), samples, int(step.tool), int(step.kind == "verify"), int(step.kind == "home"))
        numbers = [time_s, *q, *orientation, *mean, *std]
        self._rows.append(",".join([*(repr(float(x)) for x in numbers), *map(str, flags)]))
        write_atomic(self.folder / "recording.csv", "\n".join((self._header, *self._rows)) + "\n")

    def note(self, state: str, reason: str = "") -> None:
        """Say in `sweep.json` how the sweep stands: "running", "done" or "stopped" with its reason."""
        about = self._about | {"state": state, "reason": reason, "poses": len(self._rows)}
        write_atomic(self.folder / "sweep.json", json.dumps(about, indent=1) + "\n")

    def _rotation(self, q: Array) -> Array:
        R: Array = self._robot.sensor_pose(q)[0, :3, :3]
        return R
