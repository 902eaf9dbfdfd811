"""The order of a sweep's poses.

Rows of the slow joint in shuffled order, the fast joint back and forth, and home every few poses. Of many shuffles the
one is taken in which gravity in the sensor correlates least with time and its square, so that a drift of the sensor
cannot pass for a weight.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from galen_hw.errors import CommandRejectedError
from galen_hw.kinematics import Robot
from galen_hw.physics.rigid import gravity_in_sensor
from galen_hw.services.calibration.settings import AxisSettings, CalibrationSettings
from galen_hw.spatial import Array

SHUFFLES: Final = 1000
LOOKED_AT: Final = 100_000
"""Poses of all shuffles together: what the loop of the motors can spare the time for."""
Kind = Literal["fit", "home", "verify", "check"]


@dataclass(frozen=True, slots=True)
class Step:
    """One pose.

    Args:
        target: joint positions (m, rad) of all joints.
        kind: fitted, a return home (fitted too), held out, or of the slow check.
        tool: the tool is on.
    """

    target: dict[str, float]
    kind: Kind
    tool: bool


@dataclass(frozen=True, slots=True)
class Plan:
    """All poses in their order: without the tool, with it, and of the check of the compensation."""

    home: Step
    bare: tuple[Step, ...]
    tool: tuple[Step, ...]
    check: tuple[Step, ...]


def make_plan(settings: CalibrationSettings, robot: Robot) -> Plan:
    """The plan of a sweep.

    Raises:
        CommandRejectedError: a joint that the robot has not, or a pose beyond its limits.
    """
    for name in (*settings.axes, *settings.home):
        if name not in robot.joint_names:
            todo = f"the joints are {', '.join(robot.joint_names)}"
            raise CommandRejectedError(f"no joint {name!r}", where="services.calibration", todo=todo)
    home = {name: settings.home.get(name, 0.0) for name in robot.joint_names}
    rng = np.random.default_rng(settings.seed)
    grid = _best_order(settings, robot, home, rng)
    plan = Plan(
        Step(home, "home", tool=False),
        tuple(_with_homes(_around(settings.axes, settings.bare_poses), home, settings.home_every, tool=False)),
        tuple(_tool_steps(settings, home, grid, rng)),
        tuple(Step(home | pose, "check", tool=True) for pose in _diagonal(settings.axes)),
    )
    for step in (plan.home, *plan.bare, *plan.tool):
        _check_limits(step, robot)
    return plan


def duration_s(settings: CalibrationSettings, steps: Sequence[Step], rate_hz: float = 1000.0) -> float:
    """Expected time for steps from home: moves, settling and averaging, before any pace has been learnt."""
    total, before = 0.0, steps[0].target if steps else {}
    for step in steps:
        total += move_s(settings, before, step.target) + settings.settle_s + 0.25 + settings.samples / rate_hz
        before = step.target
    return total


def move_s(settings: CalibrationSettings, start: dict[str, float], end: dict[str, float]) -> float:
    """Time of a trapezoidal move, s."""
    v, a = settings.velocity_rad_per_s, settings.acceleration_rad_per_s2
    d = max((abs(end[name] - start[name]) for name in settings.axes), default=0.0)
    return 2.0 * float(np.sqrt(d / a)) if d < v * v / a else d / v + v / a


def _best_order(
    settings: CalibrationSettings, robot: Robot, home: dict[str, float], rng: np.random.Generator
) -> list[dict[str, float]]:
    names = list(settings.axes)
    values = [np.linspace(axis.low, axis.high, axis.count) for axis in settings.axes.values()]
    counts = [len(v) for v in values]
    q = np.array(
        [[*home.values()]] * int(np.prod(counts)),
    )
    combinations = list(itertools.product(*values))
    for k, name in enumerate(names):
        q[:, robot.joint_names.index(name)] = [c[k] for c in combinations]
    s = gravity_in_sensor(robot.sensor_pose(q)[:, :3, :3], robot.gravity)
    score = _Score(s)
    shuffles = min(SHUFFLES, max(100, LOOKED_AT // len(s)))
    orders = (_shuffled(counts, rng) for _ in range(shuffles))
    best = min(orders, key=score.correlation)
    return [dict(zip(names, map(float, combinations[i]), strict=True)) for i in best]


def _shuffled(counts: list[int], rng: np.random.Generator) -> Array:
    """Row numbers of a grid: slow rows shuffled, the fast joint back and forth."""
    rows = int(np.prod(counts[:-1])) if len(counts) > 1 else 1
    fast = counts[-1]
    forward = bool(rng.integers(2))
    order = rng.permutation(rows)[:, None] * fast + np.arange(fast)
    back = slice(1 if forward else 0, None, 2)
    order[back] = order[back, ::-1]
    return np.asarray(order.ravel())


class _Score:
    """How well an order hides a drift.

    Args:
        s: (n, 3) gravity in the sensor, pose by pose of the grid.
    """

    def __init__(self, s: Array) -> None:
        t = np.linspace(-1.0, 1.0, len(s))
        self._clocks = np.stack([t, t**2 - np.mean(t**2)])
        centred = s - s.mean(axis=0)
        spread = np.linalg.norm(centred, axis=0)
        used = spread > 1e-6
        self._centred = centred[:, used]
        self._scale = np.linalg.norm(self._clocks, axis=1)[:, None] * spread[used] + 1e-300

    def correlation(self, order: Array) -> float:
        """Largest correlation of gravity in the sensor with time and its square."""
        if not self._centred.size:
            return 0.0
        return float(np.abs(self._clocks @ self._centred[order] / self._scale).max())


def _tool_steps(
    settings: CalibrationSettings, home: dict[str, float], grid: list[dict[str, float]], rng: np.random.Generator
) -> Iterator[Step]:
    yield from _with_homes(grid, home, settings.home_every, tool=True)
    for _ in range(settings.verify_poses):
        pose = {name: float(rng.uniform(axis.low, axis.high)) for name, axis in settings.axes.items()}
        yield Step(home | pose, "verify", tool=True)


def _with_homes(poses: list[dict[str, float]], home: dict[str, float], every: int, *, tool: bool) -> Iterator[Step]:
    """Home first, last, and after every few poses."""
    if not poses:
        return
    for i, pose in enumerate(poses):
        if i % every == 0:
            yield Step(home, "home", tool)
        yield Step(home | pose, "fit", tool)
    yield Step(home, "home", tool)


def _around(axes: dict[str, AxisSettings], count: int) -> list[dict[str, float]]:
    """Poses round the rim of the swept range, from a corner on: few poses that excite most."""
    found = []
    for k in range(count):
        phase = np.pi / 4 + 2 * np.pi * k / count
        waves = (np.sin(phase), np.cos(phase), np.sin(2 * phase), np.cos(2 * phase))
        pose = {}
        for (name, axis), wave in zip(axes.items(), itertools.cycle(waves)):
            share = float(np.clip(np.sqrt(2.0) * wave, -1.0, 1.0))
            pose[name] = 0.5 * (axis.low + axis.high) + 0.5 * (axis.high - axis.low) * share
        found.append(pose)
    return found


def _diagonal(axes: dict[str, AxisSettings]) -> list[dict[str, float]]:
    """From one corner of the range to the opposite one, and back in the slow joint alone."""
    low = {name: axis.low for name, axis in axes.items()}
    high = {name: axis.high for name, axis in axes.items()}
    slow = next(iter(axes))
    return [low, high, high | {slow: axes[slow].low}]


def _check_limits(step: Step, robot: Robot) -> None:
    for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True):
        value = step.target[name]
        if not low <= value <= high:
            what = f"pose {name} = {value:.3f} is beyond the limits {low:.3f} to {high:.3f}"
            raise CommandRejectedError(what, where="services.calibration", todo="narrow the sweep's range")
