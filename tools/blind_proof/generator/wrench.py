"""Wrench recordings of the Galen: which effects can be hidden in them, and how each is made."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator import signal
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.generator.galen import GRAVITY, JOINTS, Cable, Mechanics, carriages, wrench_along
from galen_hw.tools.blind_proof.generator.motion import Path, between, episodes, sines, sweep_targets

Array = NDArray[np.float64]

CHANNELS = tuple(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
SIGMA = np.array([0.015, 0.015, 0.020, 2.5e-4, 2.5e-4, 2.0e-4])


@dataclass
class Scene:
    """One recording while it is being made; effects change it in the order mechanics, signal."""

    case: Case
    path: Path
    tool: str
    path_seed: int = 0
    mech: Mechanics = field(default_factory=Mechanics)
    static_model: bool = False
    temperature: Array | None = None
    record_temperature: bool = True
    after: list[Callable[[Array], Array]] = field(default_factory=list)

    def of_machine(self, hidden: Injected, name: str, value: float) -> float:
        """A number that the machine has by its first run (run 0) and keeps in all others."""
        if self.path_seed % 10 == 0:
            hidden.machine[name] = value
        return hidden.machine[name]


def make_path(rng: np.random.Generator, case: Case, *, pace: float = 1.0) -> Path:
    """Moving all the time, or pose to pose with rests; `pace` times as quick as usual."""
    t = np.arange(round(case.duration_s * case.rate_hz)) / case.rate_hz
    if case.motion == "stream":
        return sines(rng, t, np.array([0.04, 0.04, 0.04, 0.9, 0.6]), slow_hz=0.03 * pace, fast_hz=0.45 * pace)
    move, dwell = 0.9 / pace, 1.2 / pace
    targets = sweep_targets(rng, int(case.duration_s / (move + dwell)) + 2, ordered=case.motion == "sorted")
    return between(t, targets, move_s=move, dwell_s=dwell)


def simulate(scene: Scene) -> Array:
    """Noise-free readings (N, 6)."""
    reading = wrench_along(scene.path, scene.tool, scene.mech)
    for change in scene.after:
        reading = change(reading)
    return reading


def baseline(scene: Scene) -> Array:
    """What the nominal model says for the scene's path: the excess over it is the effect."""
    path = scene.path
    if scene.static_model:
        path = Path(path.t, path.q, 0 * path.dq, 0 * path.ddq)
    return wrench_along(path, scene.tool, Mechanics())


JITTER = np.array([0.04] * 3 + [1.0] * 2)
"""m a rad of a carriage's encoder on its screw's motor, and of the joints' own."""


def columns(scene: Scene, reading: Array, rng: np.random.Generator) -> dict[str, Array]:
    """The recording's columns: time, reported joints (encoder steps), wrench, temperature."""
    q = np.hstack([carriages(scene.path.q[:, :3]), scene.path.q[:, 3:]])
    steps = np.array([1e-6] * 3 + [2.4e-5] * 2)
    q = np.round((q + scene.case.encoder * JITTER * rng.normal(size=q.shape)) / steps) * steps
    out = {"time": scene.path.t}
    out |= {f"joint.{name}.position": q[:, i] for i, name in enumerate(JOINTS)}
    out |= {name: reading[:, i] for i, name in enumerate(CHANNELS)}
    if scene.temperature is not None and scene.record_temperature:
        out["temperature.sensor"] = scene.temperature + rng.normal(0, 0.02, len(scene.temperature))
    return out


# Each effect: (scene, injected, rng of the case, amplitude) changes the scene. Random choices come from a generator
# seeded by the case, so that the same choice is made at every amplitude.
Maker = Callable[[Scene, Injected, np.random.Generator, float], None]


def _three(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _some(rng: np.random.Generator) -> Array:
    """A pattern over one to three channels."""
    pattern = np.zeros(6)
    chosen = rng.choice(6, size=rng.integers(1, 4), replace=False)
    pattern[chosen] = rng.choice([-1, 1], len(chosen)) * rng.uniform(0.5, 1.0, len(chosen))
    return np.asarray(pattern * SIGMA)


def drift(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The zero moves: warm-up, a straight line, or a slow wander."""
    t, pattern = scene.path.t, _some(rng)
    hidden.kind = str(rng.choice(["warm-up", "linear", "wander"]))
    if hidden.kind == "warm-up":
        shape = signal.warm_up(t, t[-1] * rng.uniform(0.15, 0.5))
    else:
        shape = t / t[-1] if hidden.kind == "linear" else signal.random_walk(rng, len(t))
    scene.after.append(lambda x: x + a * shape[:, None] * pattern)


def step(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The zero jumps: something bumped the sensor."""
    at, pattern = rng.uniform(0.2, 0.8) * scene.path.t[-1], _some(rng)
    hidden.when, hidden.parameters = [(float(at), float(at))], {"time": float(at)}
    scene.after.append(lambda x: x + a * (scene.path.t >= at)[:, None] * pattern)


def temperature(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The zero follows the room."""
    scene.temperature = signal.room_temperature(rng, scene.path.t)
    pattern, deviation = _some(rng), scene.temperature - scene.temperature.mean()
    hidden.kind = "follows the recorded temperature"
    scene.after.append(lambda x: x + a * deviation[:, None] * pattern)


def gain(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """One channel's amplifier is off."""
    c = int(rng.integers(6))
    hidden.parameters = {"gain": a}

    def change(x: Array) -> Array:
        x = x.copy()
        x[:, c] *= 1 + a
        return x

    scene.after.append(change)


def cross_talk(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A force leaks into a torque channel, or one force into another."""
    source, sink = int(rng.integers(3)), int(rng.integers(3, 6))
    if rng.random() < 0.4:
        sink = int((source + rng.integers(1, 3)) % 3)
    scale = SIGMA[sink] / SIGMA[source]

    def change(x: Array) -> Array:
        x = x.copy()
        x[:, sink] += a * scale * x[:, source]
        return x

    hidden.parameters = {"coefficient": a * scale}
    scene.after.append(change)


def saturation(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A channel cannot go beyond a limit."""
    c, top = int(rng.integers(6)), bool(rng.random() < 0.5)

    def change(x: Array) -> Array:
        x = x.copy()
        lo, hi = x[:, c].min(), x[:, c].max()
        depth = min(0.9, 0.02 * a) * (hi - lo)
        limit = scene.of_machine(hidden, "limit", float(hi - depth if top else lo + depth))
        x[:, c] = np.minimum(x[:, c], limit) if top else np.maximum(x[:, c], limit)
        return x

    scene.after.append(change)


def time_delay(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The wrench is late against the joints."""
    del rng
    hidden.parameters = {"delay": 0.01 * a}
    scene.after.append(lambda x: signal.delayed(scene.path.t, x, 0.01 * a))


def lag(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The sensor's filter is slow."""
    del rng
    hidden.parameters = {"time_constant": 0.02 * a}
    scene.after.append(lambda x: signal.lagged(x, 1 / scene.case.rate_hz, 0.02 * a))


def creep(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The gauges' glue gives slowly: a share of the load arrives late."""
    tau = rng.uniform(4.0, 12.0)
    hidden.parameters = {"time_constant": float(tau), "share": 0.01 * a}
    scene.after.append(lambda x: x + 0.01 * a * (signal.lagged(x, 1 / scene.case.rate_hz, tau) - x))


def hysteresis(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A channel remembers the way of its load (Preisach)."""
    c, width = int(rng.integers(6)), rng.uniform(0.1, 0.3)

    def change(x: Array) -> Array:
        x = x.copy()
        wide = scene.of_machine(hidden, "width", float(width * np.ptp(x[:, c])))
        span = scene.of_machine(hidden, "span", float(np.ptp(x[:, c])))
        middle = scene.of_machine(hidden, "middle", float(0.5 * (x[:, c].min() + x[:, c].max())))
        x[:, c] += a * SIGMA[c] * signal.preisach(x[:, c], wide, 1.5 * span, middle)
        return x

    scene.after.append(change)


def vibration(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A hum: mains, motor, structure."""
    hz, pattern = rng.uniform(6.0, 35.0), _some(rng)
    hidden.parameters = {"frequency": float(hz)}
    hum = signal.narrow_band(rng, scene.path.t, hz)
    scene.after.append(lambda x: x + a * hum[:, None] * pattern)


def glitches(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Isolated outliers, sixty or so of them."""
    n, pattern = len(scene.path.t), _some(rng)
    at = rng.choice(n, size=max(8, n // 200), replace=False)
    size = rng.choice([-1, 1], len(at)) * rng.uniform(8, 25, len(at))
    hidden.kind = "outliers"

    def change(x: Array) -> Array:
        x = x.copy()
        x[at] += a * size[:, None] * pattern
        return x

    scene.after.append(change)


def payload(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Something more is on the tool: a clip, a cap, fluid."""
    scene.mech.extra_mass = 0.004 * a
    scene.mech.extra_at = (
        float(rng.uniform(-0.02, 0.04)),
        float(rng.uniform(-0.02, 0.02)),
        float(rng.uniform(-0.13, -0.03)),
    )
    hidden.parameters = {"mass": 0.004 * a}


def base_tilt(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The cart stands askew."""
    azimuth, angle = rng.uniform(0, 2 * np.pi), 0.005 * a
    g = abs(GRAVITY[2])
    s = np.sin(angle)
    scene.mech.gravity = (float(g * s * np.cos(azimuth)), float(g * s * np.sin(azimuth)), float(-g * np.cos(angle)))
    hidden.parameters = {"angle": angle}


def inertial(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The model knows weight alone and the arm moves quickly; `a` is the square of the pace."""
    del rng
    hidden.kind = "static model of a quick motion"
    scene.static_model = True
    scene.path = make_path(np.random.default_rng(scene.path_seed), scene.case, pace=float(np.sqrt(a)))


def joint_offset(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A zero of roll or tilt is off."""
    j = int(rng.integers(2))
    scene.mech.offset[j] += 0.005 * a
    hidden.joints, hidden.parameters = [JOINTS[3 + j]], {"offset": 0.005 * a}


def joint_scale(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """An encoder's or gear's scale of roll or tilt is off."""
    j = int(rng.integers(2))
    scene.mech.scale[j] *= 1 + 0.01 * a
    hidden.joints, hidden.parameters = [JOINTS[3 + j]], {"scale": 0.01 * a}


def link_geometry(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The tilt joint's axis is not where the model says."""
    angle = 0.01 * a
    if rng.random() < 0.5:
        scene.mech.tilt_axis = (float(np.sin(angle)), float(np.cos(angle)), 0.0)
    else:
        scene.mech.tilt_axis = (0.0, float(np.cos(angle)), float(np.sin(angle)))
    hidden.kind, hidden.joints, hidden.parameters = "tilt axis turned", ["tilt"], {"angle": angle}


def sensor_mounting(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """The sensor sits turned on its flange."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    half = 0.005 * a / 2
    scene.mech.sensor_quat = (float(np.cos(half)), *_three(np.sin(half) * axis))
    hidden.parameters = {"angle": 0.005 * a}


def cable_drag(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """A cable from the room pulls on the tool: a spring that can go slack, with friction in its conduit."""
    anchor = (float(rng.uniform(0.0, 0.45)), float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0.3, 0.6)))
    rubbing = bool(rng.random() < 0.4)
    stiffness = 0.5 * a
    scene.mech.cable = Cable(stiffness, float(rng.uniform(0.1, 0.3)), anchor, 0.04 * stiffness if rubbing else 0.0)
    hidden.kind = "spring with friction" if rubbing else "spring"


def contact(scene: Scene, hidden: Injected, rng: np.random.Generator, a: float) -> None:
    """Somebody touches the tip a few times."""
    t = scene.path.t
    hidden.when = episodes(rng, t[-1], count=int(rng.integers(2, 5)), length_s=(0.8, 4.0))
    forces = np.zeros((len(t), 3))
    for start, end in hidden.when:
        u = np.clip((t - start) / (end - start), 0, 1)
        direction = rng.normal(size=3)
        forces += a * 0.05 * (np.sin(np.pi * u) ** 0.5)[:, None] * direction / np.linalg.norm(direction)
    scene.mech.tip_forces = forces


EFFECTS: dict[str, Maker] = {
    f.__name__: f
    for f in (
        drift, step, temperature, gain, cross_talk, saturation, time_delay, lag, creep, hysteresis, vibration, glitches,
        payload, base_tilt, inertial, joint_offset, joint_scale, link_geometry, sensor_mounting, cable_drag, contact,
    )
}  # fmt: skip

TIME_LOCAL = {"step", "contact", "glitches", "drift", "temperature", "vibration"}
"""Effects of a moment or of the clock: a second recording does not repeat them."""
