"""The raw sweep on disk: a table folder that is complete after every pose, so that nothing is lost with a power cut."""

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np

from galen_hw.config.tool_store import write_atomic
from galen_hw.errors import UsageError
from galen_hw.kinematics import GalenRobot, Robot
from galen_hw.recording.recording import SENSOR_ORIENTATION, WRENCH
from galen_hw.services.calibration.plan import Step
from galen_hw.spatial import Array, quaternion_from_rotation

STD = tuple(f"covariate.std.{name.removeprefix('wrench.')}" for name in WRENCH)


class Writer:
    """Writes files in a thread, for a loop that moves the arm waits for no disk.

    Of several texts of one file the newest is written; files are in the order in which they were given last.
    """

    def __init__(self) -> None:
        self.error: UsageError | None = None
        self.written: dict[Path, int] = {}
        self._texts: dict[Path, tuple[str, int]] = {}
        self._changed = threading.Condition()
        self._busy = self._closed = False
        self._thread: threading.Thread | None = None

    @property
    def idle(self) -> bool:
        """All is on the disk, or could not be written."""
        with self._changed:
            return not self._busy and not self._texts

    def put(self, path: Path, text: str, rows: int = 0) -> None:
        """Write a file soon; `rows` is then in `written`."""
        with self._changed:
            self._texts.pop(path, None)
            self._texts[path] = (text, rows)
            self._changed.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._write, name="sweep file", daemon=True)
            self._thread.start()

    def wait(self, timeout_s: float) -> bool:
        """Wait until it is idle; whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._busy and not self._texts, timeout_s)

    def close(self) -> None:
        """End the thread once all is written; waits for nothing."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _write(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._texts or self._closed)
                if not self._texts:
                    return
                path = next(iter(self._texts))
                text, rows = self._texts.pop(path)
                self._busy = True
            try:
                write_atomic(path, text)
                self.written[path] = rows
            except UsageError as error:
                self.error = self.error or error
            with self._changed:
                self._busy = False
                self._changed.notify_all()


class SweepFile:
    """Writes `recording.csv`, `recording.json` and `sweep.json` of one sweep, beside the loop; see `check`.

    Args:
        folder: of this sweep, made here; robot: for joint names and the sensor's orientation.
        about: what is known when it begins (tool, sensor serial, settings, start), for `sweep.json`.
    """

    def __init__(self, folder: Path, robot: Robot, about: dict[str, Any]) -> None:
        self.folder, self._robot, self._about = folder, robot, about
        self._rows: list[str] = []
        self._writer = Writer()
        names = (f"joint.{name}.position" for name in robot.joint_names)
        flags = (f"covariate.{name}" for name in ("pose", "samples", "tool", "verify", "home"))
        self._header = ",".join(("time", *names, *SENSOR_ORIENTATION, *WRENCH, *STD, *flags))

    def __len__(self) -> int:
        """Number of poses that are kept: written, or still on their way to the disk."""
        if self._writer.error is not None:
            return self._writer.written.get(self.folder / "recording.csv", 0)
        return len(self._rows)

    def check(self) -> None:
        """Say what became of the files so far.

        Raises:
            UsageError: one of them could not be written.
        """
        if self._writer.error is not None:
            raise self._writer.error

    @property
    def idle(self) -> bool:
        """All is on the disk, or could not be written."""
        return self._writer.idle

    def wait(self, timeout_s: float) -> bool:
        """Wait until it is idle; whether it is."""
        return self._writer.wait(timeout_s)

    def close(self) -> None:
        """Nothing more comes."""
        self._writer.close()

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
            "model": {"bias": "free", "dynamics": "static"},
            "sensor_serial": self._about.get("sensor_serial", ""),
            "virtual": bool(self._about.get("virtual")),
            "notes": "static poses of a calibration sweep, averaged; see sweep.json",
        }
        self._writer.put(self.folder / "recording.json", json.dumps(info, indent=1) + "\n")
        self.note("running")

    def add(self, step: Step, *, time_s: float, q: Array, mean: Array, std: Array, samples: int) -> None:
        """Add a pose: joints (n,), mean and scatter of one sample (6,)."""
        orientation = quaternion_from_rotation(self._rotation(q))
        flags = (len(self._rows), samples, int(step.tool), int(step.kind == "verify"), int(step.kind == "home"))
        numbers = [time_s, *q, *orientation, *mean, *std]
        self._rows.append(",".join([*(repr(float(x)) for x in numbers), *map(str, flags)]))
        text = "\n".join((self._header, *self._rows)) + "\n"
        self._writer.put(self.folder / "recording.csv", text, len(self._rows))

    def note(self, state: str, reason: str = "") -> None:
        """Say in `sweep.json` how the sweep stands: "running", "done" or "stopped" with its reason."""
        about = self._about | {"state": state, "reason": reason, "poses": len(self._rows)}
        self._writer.put(self.folder / "sweep.json", json.dumps(about, indent=1) + "\n")

    def _rotation(self, q: Array) -> Array:
        R: Array = self._robot.sensor_pose(q)[0, :3, :3]
        return R
