"""Static poses of a wrist sensor with a tool on it: orientations or joints, averages or raw rows, with or without a clock."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.mistakes import turns
from galen_hw.tools.blind_proof.mistakes.origins import arm6
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, SENSOR, TORQUE, Load, Recording

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Sensor:
    """Noise of one sample, N and N m, and how many samples are averaged."""

    force: float
    torque: float


SENSORS = {"ati gamma": Sensor(0.05, 2e-3), "ati mini40": Sensor(0.02, 5e-4), "robotous rft": Sensor(0.1, 4e-3)}


def reading(turn: Array, load: Load, gravity: Array = GRAVITY) -> Array:
    """Force and moment (N, 6) of a load at rest, without offsets: R^T w and c x R^T w."""
    force = np.einsum("nji,j->ni", turn, load.mass * gravity)
    return np.hstack([force, np.cross(np.asarray(load.com), force)])


def make(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """A set of 12 to 60 poses.

    Args:
        rng: what draws it; needs: of "tool", "no tool", "clock", "no clock", "raw", "averages", "joints", "quaternion".
    """
    raw = _choice(rng, needs, "raw", "averages", 0.3)
    poses = int(rng.integers(12, 26 if raw else 61))
    load = Load(float(np.exp(rng.uniform(np.log(0.2), np.log(2.5)))), _com(rng))
    columns: dict[str, Array] = {}
    info: dict[str, object] = {"schema": 1, "robot": None, "predict": "wrench"}
    files: dict[str, str] = {}
    if _choice(rng, needs, "joints", "quaternion", 0.3):
        arm = arm6.draw(rng)
        joints = arm6.static_joints(rng, poses)
        turn = arm6.sensor_turn(arm, joints)
        columns |= {f"joint.{j}.position": joints[:, k] for k, j in enumerate(arm6.JOINTS)}
        info |= {"robot": "arm.urdf", "base_link": "base", "sensor_link": "ft"}
        files["arm.urdf"] = arm6.urdf(arm)
    else:
        turn = turns.anywhere(rng, poses)
        columns |= dict(zip(SENSOR, turns.to_quat(turn).T, strict=True))
    if _choice(rng, needs, "tool", "no tool", 0.4):
        info["tool"] = {"name": "tool", "mass": round(load.mass, 4), "com": np.round(load.com, 4).tolist()}
    # The arm is not quite where it says.
    true = np.einsum("nij,njk->nik", turn, turns.small(rng, poses, rng.choice([0.0, 1e-3, 4e-3])))
    sensor = SENSORS[str(rng.choice(list(SENSORS)))]
    bias = np.concatenate([rng.uniform(-8, 8, 3), rng.uniform(-0.2, 0.2, 3)])
    clean = reading(true, load) + bias
    per = int(rng.integers(40, 3000 // poses)) if raw else 1
    averaged = 1.0 if raw else np.sqrt(200.0)
    noise = np.array([sensor.force] * 3 + [sensor.torque] * 3) / averaged
    columns = {n: np.repeat(v, per) for n, v in columns.items()}
    wrench = np.repeat(clean, per, axis=0)
    wrench += rng.normal(size=wrench.shape) * noise
    columns |= dict(zip((*FORCE, *TORQUE), wrench.T, strict=True))
    if _choice(rng, needs, "clock", "no clock", 0.4):
        at = np.arange(poses)[:, None] * rng.uniform(4.0, 7.0) + np.arange(per) * (1.0 / 100)
        columns = {"time": at.ravel(), **columns}
    return Recording(columns, info, files, None, "", (), load, np.repeat(turn, per, axis=0))


def _choice(rng: np.random.Generator, needs: frozenset[str], yes: str, no: str, share: float) -> bool:
    """What is needed, or else so often yes."""
    drawn = bool(rng.random() < share)
    return yes in needs or (drawn and no not in needs)


def _com(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y = rng.uniform(0.006, 0.025, 2) * rng.choice([-1, 1], 2)
    return float(x), float(y), float(rng.uniform(0.03, 0.12))
