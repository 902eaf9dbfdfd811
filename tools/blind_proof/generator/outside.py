"""Physics that no word of the vocabulary names: the tool must say that it does not know what is there."""

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator.case import Injected
from galen_hw.tools.blind_proof.generator.galen import tip_along
from galen_hw.tools.blind_proof.generator.wrench import SIGMA, Maker, Scene

Array = NDArray[np.float64]


def quadratic_gauge(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A gauge bridge far from its null: the reading bends with the square of the load, both ways the same."""
    c = int(rng.integers(6))
    hidden.kind = "quadratic gauge"

    def change(x: Array) -> Array:
        x = x.copy()
        null = scene.of_machine(hidden, "null", float(x[:, c].mean()))
        span = scene.of_machine(hidden, "span", float(x[:, c].std()))
        x[:, c] += a * SIGMA[c] * ((x[:, c] - null) / span) ** 2
        return x

    scene.after.append(change)


def eddy_pick_up(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Two motors' stray fields beat in the sensor's wires: a reading that goes with the product of two speeds."""
    c = int(rng.integers(6))
    product = scene.path.dq[:, 3] * scene.path.dq[:, 4]
    product = product / scene.of_machine(hidden, "fast", float(product.std()))
    hidden.kind = "product of two speeds"
    scene.after.append(lambda x: x + a * SIGMA[c] * product[:, None] * np.eye(6)[c])


def air_drag(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A drape in the air: a force against the tip's velocity that grows with its square."""
    del rng
    position, _ = tip_along(scene.path.q, scene.tool, scene.mech)
    v = np.gradient(position, scene.path.t, axis=0)
    hidden.kind = "quadratic drag of the air"
    scene.mech.tip_forces = -0.5 * a * np.linalg.norm(v, axis=1, keepdims=True) * v


def spinning_drill(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The rotor of a drill resists being turned: a torque across its axis and the arm's turning."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    hidden.kind = "gyroscopic torque of a rotor"
    tilt = scene.path.q[:, 4]
    roll_rate, tilt_rate = scene.path.dq[:, 3], scene.path.dq[:, 4]
    omega = np.stack([roll_rate * np.cos(tilt), tilt_rate, roll_rate * np.sin(tilt)], axis=1)
    torque = -1e-3 * a * np.cross(omega, axis)
    scene.after.append(lambda x: x + np.hstack([np.zeros_like(torque), torque]))


def magnet(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A magnet in the tool, a steel post beside the workspace: a pull that dies away with the fourth power of the distance."""
    position, _ = tip_along(scene.path.q, scene.tool, scene.mech)
    centre, side = position.mean(axis=0), rng.normal(size=3)
    radius = float(np.max(np.linalg.norm(position - centre, axis=1)))
    at = centre + 1.2 * radius * side / np.linalg.norm(side)
    post = np.array([scene.of_machine(hidden, f"post_{axis}", float(x)) for axis, x in zip("xyz", at, strict=True)])
    near = scene.of_machine(hidden, "near", 0.5 * radius)
    reach = post - position
    distance = np.linalg.norm(reach, axis=1, keepdims=True)
    hidden.kind = "pull of a magnet"
    scene.mech.tip_forces = 0.1 * a * reach / (distance + near) / (1.0 + (distance / near) ** 2) ** 2


def tight_drape(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A drape that is pulled tight where roll and tilt are both far to one side, and slack elsewhere."""
    c, side = int(rng.integers(6)), float(rng.choice([-1.0, 1.0]))
    pull = np.maximum(side * scene.path.q[:, 3] / 0.6 + scene.path.q[:, 4] / 0.4 - 1.0, 0.0) ** 1.5
    hidden.kind = "drape tight in a corner"
    scene.after.append(lambda x: x + a * SIGMA[c] * pull[:, None] * np.eye(6)[c])


OUTSIDE: dict[str, Maker] = {
    f.__name__: f for f in (quadratic_gauge, eddy_pick_up, air_drag, spinning_drill, magnet, tight_drape)
}
