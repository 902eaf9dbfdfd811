"""The plan of a deflection session: where to hold the arm, which way to push and how hard, and what is done already."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.config.tool_store import write_atomic
from galen_hw.documents import load_json
from galen_hw.errors import UsageError
from galen_hw.kinematics import Robot
from galen_hw.spatial import Array

PLAN: Final = "session.json"
FIRST_SET: Final = "calibration-1"
"""Registers the markers for the whole session."""
REACH: Final = 0.55
"""Share of each joint's range, about its middle, that is visited; of the sliding joints half of that."""


@dataclass(frozen=True)
class Push:
    """One push: force (3,) N at its height in base axes; both ways through zero."""

    force: tuple[float, float, float]

    def words(self) -> str:
        """What the operator is told."""
        names = [f"{f:+.0f} N along {'xyz'[i]}" for i, f in enumerate(self.force) if abs(f) > 0.5]
        return " and ".join(names)


@dataclass(frozen=True)
class Step:
    """One set of the session.

    Args:
        name: of its folder; purpose: "calibration" (no force, several places) or "pushes".
        places: joint positions (n,) that are visited; pushes: at the only place.
    """

    name: str
    purpose: str
    places: list[list[float]]
    pushes: list[list[float]] = field(default_factory=list)


@dataclass
class Plan:
    """A session in a folder.

    Args:
        folder: of the sets; robot, tool: names; steps: in order; day: its date.
        rise_s, dwell_s, rest_s: of each push; still_s: at each place of a calibration set.
    """

    folder: Path
    robot: str
    tool: str
    day: str
    steps: list[Step]
    rise_s: float = 1.0
    dwell_s: float = 2.0
    rest_s: float = 2.0
    still_s: float = 1.5

    @property
    def left(self) -> list[Step]:
        """Steps without a recording yet."""
        return [s for s in self.steps if not (self.folder / s.name / "recording.json").exists()]

    @property
    def numbers(self) -> dict[str, float]:
        """What it was begun with, by option of the command; the force is in each push alone."""
        pushes = [s for s in self.steps if s.purpose == "pushes"]
        configurations = len({s.name.partition("-")[0] for s in pushes})
        return {
            "configurations": configurations,
            "rounds": len(pushes) // max(configurations, 1),
            "places": max((len(s.places) for s in self.steps if s.purpose == "calibration"), default=0),
            "dwell": self.dwell_s,
            "rise": self.rise_s,
            "rest": self.rest_s,
            "still": self.still_s,
        }

    def save(self) -> None:
        """Write it into its folder."""
        values = {k: v for k, v in asdict(self).items() if k != "folder"}
        write_atomic(self.folder / PLAN, json.dumps(values, indent=1) + "\n")

    @classmethod
    def load(cls, folder: Path) -> "Plan | None":
        """The plan of a session that was begun; None where there is none.

        Raises:
            UsageError: it is damaged.
        """
        path = folder / PLAN
        if not path.exists():
            return None
        try:
            values: dict[str, Any] = load_json(path.read_text(encoding="utf-8"))
            steps = [Step(**s) for s in values.pop("steps")]
            return cls(folder=folder, steps=steps, **values)
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise UsageError(f"is damaged ({error})", where=str(path), todo="begin in a new folder") from error


def make_steps(
    robot: Robot, configurations: int, newtons: float, *, rounds: int = 2, places: int = 8, seed: int = 0
) -> list[Step]:
    """A calibration set, `rounds` of one set of pushes at every configuration, a calibration set.

    Every set pushes along all three axes and once askew, both ways, at different levels; a calibration set visits
    `places`.
    """
    rng = np.random.default_rng(seed)
    held = _places(robot, configurations, 11)
    calibration = _places(robot, places, 101)
    steps = [Step(FIRST_SET, "calibration", [p.tolist() for p in calibration])]
    for turn in range(1, rounds + 1):
        for k, place in enumerate(held, start=1):
            pushes = [
                (newtons * rng.uniform(0.5, 1.0) * rng.choice([-1.0, 1.0]) * e) for e in rng.permutation(np.eye(3))
            ]
            askew = rng.normal(size=3)
            pushes.append(newtons * rng.uniform(0.5, 1.0) * askew / np.linalg.norm(askew))
            steps.append(Step(f"place{k}-{turn}", "pushes", [place.tolist()], [p.tolist() for p in pushes]))
    return [*steps, Step("calibration-2", "calibration", [p.tolist() for p in calibration[::-1]])]


def _places(robot: Robot, count: int, start: int) -> list[Array]:
    """Joint positions that cover the workspace evenly (Halton's sequence) and that the robot can reach."""
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    turns = np.any(np.abs(robot.sensor_jacobian(middle)[0, 3:]) > 0.0, axis=0)
    reach = np.where(turns, REACH, 0.5 * REACH) * half
    out: list[Array] = []
    number = start
    while len(out) < count:
        number += 1
        u = np.array([_radical(number, base) for base in (2, 3, 5, 7, 11, 13, 17, 19)[: len(middle)][::-1]])
        place = middle + reach * (2.0 * u - 1.0)
        if np.isfinite(robot.sensor_pose(place)).all():
            out.append(place)
    return out


def _radical(number: int, base: int) -> float:
    """Van der Corput's sequence."""
    out, share = 0.0, 1.0
    while number:
        share /= base
        number, digit = divmod(number, base)
        out += share * digit
    return out
