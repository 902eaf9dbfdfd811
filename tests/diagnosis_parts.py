"""Small recordings with one thing wrong, made by formulas of their own, and their diagnoses."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from galen_hw.diagnosis.pipeline import diagnose
from galen_hw.diagnosis.work import Work
from galen_hw.kinematics import GalenRobot
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Belief, Observations
from galen_hw.physics.scenes.base import Scene
from tests import physics_scenes

SIGMA = np.array([0.01, 0.01, 0.01, 2e-4, 2e-4, 2e-4])
ROWS, RATE = 2000, 100.0


def nominal(seed: int = 1, rows: int = ROWS) -> Scene:
    """A wrench recording whose channels are zero yet; offsets are free."""
    return physics_scenes.scene("wrench", np.random.default_rng(seed), rows, RATE, bias_free=True)


def recorded(scene: Scene, wrench: np.ndarray, seed: int = 2, *, thermometer: bool = False) -> Scene:
    """The scene with what was read (N, 6), white noise added."""
    noise = np.random.default_rng(seed).normal(size=wrench.shape) * SIGMA
    columns = {k: v for k, v in scene.observations.columns.items() if thermometer or not k.startswith("temperature.")}
    columns |= dict(zip(physics_scenes.WRENCH, (wrench + noise).T, strict=True))
    return scene_of(replace(scene.observations, columns=columns))


def late(seconds: float) -> Scene:
    """Every channel late by so much, by interpolation."""
    scene = nominal()
    read = [np.interp(scene.time - seconds, scene.time, scene.simulated[:, c]) for c in range(6)]
    return recorded(scene, np.stack(read, axis=-1))


def drifting(size: float) -> Scene:
    """Force z drifts by so much over the recording, in a straight line."""
    scene = nominal()
    wrench = scene.simulated.copy()
    wrench[:, 2] += size * scene.time / scene.time[-1]
    return recorded(scene, wrench)


@cache
def diagnosed(kind: str) -> Work:
    """The diagnosis of a recording; made once for all tests of a process."""
    scenes = {
        "late": lambda: late(0.02),
        "drifting": lambda: drifting(0.06),
        "nothing": lambda: late(0.0),
        "poses": poses,
    }
    return diagnose(scenes[kind](), name=kind)


def poses() -> Scene:
    """Forty poses without a clock, of a tool that is 30 g heavier than believed."""
    rng = np.random.default_rng(4)
    robot, belief = GalenRobot(), physics_scenes.belief(bias_free=True, dynamic=False)
    q = rng.uniform(robot.lower, robot.upper, (40, 5)) * 0.7
    columns = {f"joint.{n}.position": q[:, i] for i, n in enumerate(robot.joint_names)}
    columns |= {name: np.zeros(40) for name in physics_scenes.WRENCH}
    scene = scene_of(Observations("wrench", columns, None, belief))
    weight = robot.sensor_rotation(q).swapaxes(1, 2) @ np.array([0.0, 0.0, -0.03 * 9.80665])
    wrench = scene.simulated + np.hstack([weight, np.cross(belief.tool.com, weight)])
    return recorded(scene, wrench)


def write_table(scene: Scene, folder: Path) -> Path:
    """The scene as a table recording of the Galen with the believed tool."""
    belief: Belief = scene.belief
    folder.mkdir(parents=True, exist_ok=True)
    columns = scene.observations.columns
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "recording.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    tool = {
        "name": "retractor",
        "mass": belief.tool.mass,
        "com": list(belief.tool.com),
        "inertia": np.asarray(belief.tool.inertia).tolist(),
        "tip": list(belief.tip),
    }
    assert belief.bias_body is not None
    info = {
        "schema": 1,
        "robot": "galen",
        "predict": "wrench",
        "tool": tool,
        "bias_body": {"mass": belief.bias_body.mass, "com": list(belief.bias_body.com)},
        "zeroed_at": [0.0] * 5,
        "model": {"bias": "free"},
    }
    (folder / "recording.json").write_text(json.dumps(info))
    return folder
