"""A table recording while a mistake is made in it: columns, recording.json, the files and the simulation beside it."""

import copy
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = "xyz"
FORCE = tuple(f"wrench.force.{a}" for a in AXES)
TORQUE = tuple(f"wrench.torque.{a}" for a in AXES)
POINT = tuple(f"pose.position.{a}" for a in AXES)
TURN = tuple(f"pose.orientation.{a}" for a in "xyzw")
SENSOR = tuple(f"sensor.orientation.{a}" for a in "xyzw")


@dataclass(frozen=True)
class Load:
    """What hangs on the sensor in truth: kg, and m in the sensor frame."""

    mass: float
    com: tuple[float, float, float]

    def with_part(self, part: "Load") -> "Load":
        """This load and another one together."""
        mass = self.mass + part.mass
        com = (self.mass * np.array(self.com) + part.mass * np.array(part.com)) / mass
        return Load(mass, (float(com[0]), float(com[1]), float(com[2])))


@dataclass
class Recording:
    """One recording, and what is true of it.

    Args:
        columns: by name, (N,) each; NaN is an empty cell.
        info: recording.json.
        files: further files of the folder by name, the URDF among them.
        simulation: what stands in `simulation/`, or None.
        origin: which family it is of.
        effects: keys of what a finding may rightly name in it before any mistake.
        load: true mass and centre of mass of a static set.
        turn: (N, 3, 3) from sensor to base, where the maker knows it.
        clean: (N, 6) the wrench of the load without offsets and noise, where the maker knows it.
        parts: how many recordings one after the other it is, each of which becomes a folder.
        coulomb: greatest dry friction of a joint in truth, N m; None where it is not known.
    """

    columns: dict[str, Array]
    info: dict[str, Any]
    files: dict[str, str] = field(default_factory=dict)
    simulation: "Recording | None" = None
    origin: str = ""
    effects: tuple[str, ...] = ()
    load: Load | None = None
    turn: Array | None = None
    clean: Array | None = None
    coulomb: float | None = None
    parts: int = 1

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def copy(self) -> "Recording":
        """A second one to change."""
        return copy.deepcopy(self)

    def has(self, *names: str) -> bool:
        """Return whether all of these columns are there."""
        return all(n in self.columns for n in names)

    def joints(self, what: str = "position") -> list[str]:
        """Names of the columns `joint.NAME.<what>`, in order."""
        return [c for c in self.columns if c.startswith("joint.") and c.endswith(f".{what}")]

    def get(self, names: Iterable[str]) -> Array:
        """Columns side by side (N, n)."""
        return np.column_stack([self.columns[n] for n in names])

    def put(self, names: Iterable[str], values: Array) -> None:
        """Write columns (N, n)."""
        for k, name in enumerate(names):
            self.columns[name] = np.array(values[:, k], dtype=float)

    def rows(self, chosen: Array | slice) -> None:
        """Keep these rows, in this order, of everything that has rows."""
        self.columns = {n: v[chosen] for n, v in self.columns.items()}
        if self.turn is not None:
            self.turn = self.turn[chosen]
        if self.clean is not None:
            self.clean = self.clean[chosen]

    @property
    def compared(self) -> list[str]:
        """Columns of the group that is compared."""
        group = self.info["predict"]
        if group in {"effort", "position"}:
            return self.joints(group)
        return [c for c in self.columns if c.startswith({"targets": "target."}.get(group, f"{group}."))]

    def write(self, folder: Path) -> Path:
        """The folder as a user has it; numbers to nine digits, clocks to all of theirs."""
        folder.mkdir(parents=True, exist_ok=True)
        if self.parts > 1:
            self._write_parts(folder)
            return folder
        cells = [[_cell(v, exact=n == "time") for v in values] for n, values in self.columns.items()]
        lines = [",".join(self.columns), *(",".join(row) for row in zip(*cells, strict=True))]
        (folder / "recording.csv").write_text("\n".join(lines) + "\n")
        (folder / "recording.json").write_text(json.dumps(self.info, indent=1))
        for name, text in self.files.items():
            (folder / name).write_text(text)
        if self.simulation is not None:
            self.simulation.write(folder / "simulation")
        return folder

    def _write_parts(self, folder: Path) -> None:
        rows = len(self) // self.parts
        for k in range(self.parts):
            one = self.copy()
            one.parts = 1
            one.rows(slice(k * rows, (k + 1) * rows))
            one.write(folder / f"set{k + 1}")


def _cell(value: float, *, exact: bool) -> str:
    if np.isnan(value):
        return ""
    if exact:
        return str(int(value)) if abs(value) >= 1e9 and value == int(value) else repr(float(value))
    return f"{value:.9g}"


def read(folder: Path) -> Recording:
    """A table folder; an empty cell is NaN.

    Raises:
        OSError: it is not there.
    """
    path = folder / "recording.csv"
    with path.open() as lines:
        names = next(lines).strip().split(",")
    table = np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)
    info = json.loads((folder / "recording.json").read_text())
    files = {p.name: p.read_text() for p in folder.iterdir() if p.suffix == ".urdf"}
    beside = folder / "simulation"
    return Recording(
        {n: table[:, k] for k, n in enumerate(names)}, info, files, read(beside) if beside.is_dir() else None
    )
