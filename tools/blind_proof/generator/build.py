"""From a case's plan to a folder: find the severity, make the recording and its second run, add noise, write."""

import json
from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.generator import arm, outside, pose, wrench
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.generator.galen import BIAS_COM, BIAS_MASS, TOOLS
from galen_hw.tools.blind_proof.generator.look_alikes import LOOK_ALIKES, apart
from galen_hw.tools.blind_proof.generator.noise import add_noise
from galen_hw.tools.blind_proof.generator.premises import spoil

Array = NDArray[np.float64]

SIGMA = {"wrench": wrench.SIGMA, "pose": pose.SIGMA, "effort": arm.EFFORT_SIGMA, "position": arm.POSITION_SIGMA}
CHANNELS = {
    "wrench": wrench.CHANNELS,
    "pose": pose.CHANNELS,
    "effort": tuple(f"joint.{j}.effort" for j in arm.JOINTS),
    "position": tuple(f"joint.{j}.position" for j in arm.JOINTS),
}
MAKERS: dict[str, dict[str, Any]] = {
    "wrench": wrench.EFFECTS,
    "pose": pose.EFFECTS,
    "effort": arm.EFFORT_EFFECTS,
    "position": arm.POSITION_EFFECTS,
}


def build(case: Case, folder: FilePath) -> Case:
    """Write `folder/train` and `folder/test`, another run of the same machine; returns the case with its truth."""
    _scaled(case)
    _measured_apart(case)
    case.noise_rms = _write(case, folder / "train", run=0)
    if case.share != "premise":
        case.holdout_noise_rms = _write(case, folder / "test", run=1)
    return case


class UnreachableError(Exception):
    """No amplitude gives the wanted severity."""


DRAWS = 10
LARGEST = 9.2
"""Logarithm of an amplitude beyond which no effect is itself any more."""


def _scaled(case: Case) -> None:
    """Find the amplitudes; where an effect cannot be as strong as it should, the case is drawn anew.

    Raises:
        UnreachableError: in none of ten draws.
    """
    for draw in range(DRAWS):
        try:
            for hidden in case.effects:
                if hidden.snr is not None:
                    hidden.amplitude = _amplitude(case, hidden)
        except UnreachableError:
            if draw == DRAWS - 1:
                raise
            case.seed += 1
        else:
            return


def _measured_apart(case: Case) -> None:
    """Of every effect that may be taken for another: how far it is from that, for one who knows what else is there."""
    simulate, _ = _parts(case.group)
    for hidden in case.effects:
        if hidden.key in LOOK_ALIKES:
            scene, others = _scene(case, run=0), _scene(case, run=0)
            for number, one in enumerate(case.effects):
                _hide(case, scene, one, number, one.amplitude)
                if one is not hidden:
                    _hide(case, others, one, number, one.amplitude)
            changed, clean = simulate(scene), simulate(others)
            hidden.apart = apart(hidden.key, scene.path.t, clean, changed, SIGMA[case.group], case.noise)


def nominal(case: Case, run: int) -> Array:
    """What the nominal machine would have read in a run (N, c), on its true path."""
    scene = _scene(case, run)
    for number, hidden in enumerate(case.effects):
        if hidden.key in {"inertial", "hardening", "hysteresis", "creep"}:
            # These change what the recording's model states (static dynamics, a known compliance), and so its baseline.
            _hide(case, scene, hidden, number, hidden.amplitude)
    _, baseline = _parts(case.group)
    return baseline(scene)


def _scene(case: Case, run: int) -> Any:
    """The recording's scene without effects; run 0 and 1 differ in their motion."""
    seed = case.seed * 10 + run
    rng = np.random.default_rng(seed)
    if case.group == "wrench":
        tool = str(np.random.default_rng(case.seed).choice(list(TOOLS)))
        return wrench.Scene(case, wrench.make_path(rng, case), tool, path_seed=seed)
    if case.group == "pose":
        scene = pose.make_scene(rng, case)
        scene.tool = str(np.random.default_rng(case.seed).choice(list(TOOLS)))
        return scene
    return arm.make_scene(rng, case)


def _parts(group: str) -> tuple[Callable[[Any], Array], Callable[[Any], Array]]:
    """Simulate and baseline of a group."""
    if group == "wrench":
        return wrench.simulate, wrench.baseline
    if group == "pose":
        return pose.simulate, pose.baseline
    return (arm.efforts if group == "effort" else arm.positions), arm.baseline


def _hide(case: Case, scene: Any, hidden: Injected, number: int, amplitude: float) -> None:
    """Apply one effect; its random choices depend on the case and its number, not on the run or the amplitude."""
    rng = np.random.default_rng([case.seed, 77, number])
    name = hidden.kind if hidden.key == "unknown" and hidden.kind in outside.OUTSIDE else hidden.key
    maker = outside.OUTSIDE[name] if name in outside.OUTSIDE else MAKERS[case.group][name]
    maker(scene, hidden, rng, amplitude)


def _excess(case: Case, hidden: Injected, number: int, amplitude: float) -> Array:
    """Reading less baseline (N, c) in units of the noise, for one effect alone; less its mean where bias is free."""
    scene = _scene(case, run=0)
    name = hidden.kind
    _hide(case, scene, hidden, number, amplitude)
    if hidden.key == "unknown":
        hidden.kind = name
    simulate, baseline = _parts(case.group)
    excess = (simulate(scene) - baseline(scene)) / SIGMA[case.group]
    return np.asarray(excess - excess.mean(axis=0) if case.bias_free else excess)


def _severity(excess: Array) -> tuple[float, Array]:
    """SNR over the channels that the effect touches, and which those are."""
    rms = np.sqrt(np.mean(excess**2, axis=0))
    touched = rms >= 0.3 * rms.max()
    return float(np.sqrt(np.mean(rms[touched] ** 2))), touched


def _amplitude(case: Case, hidden: Injected) -> float:
    """The amplitude that gives the wanted SNR: the secant rule on logarithms, and halving where its step leaves the bracket.

    Raises:
        UnreachableError: there is none.
    """
    assert hidden.snr is not None
    number, at, wanted = case.effects.index(hidden), 0.0, np.log(hidden.snr)
    low, high, last = -np.inf, np.inf, None
    for _ in range(30):
        snr, touched = _severity(_excess(case, hidden, number, float(np.exp(at))))
        hidden.channels = [c for c, on in zip(CHANNELS[case.group], touched, strict=True) if on]
        if abs(snr / hidden.snr - 1) < 0.03:
            return float(np.exp(at))
        now = (at, float(np.log(max(snr, 1e-9))))
        low, high = (max(low, at), high) if now[1] < wanted else (low, min(high, at))
        slope = 1.0 if last is None or at == last[0] else (now[1] - last[1]) / (at - last[0])
        at += float(np.clip((wanted - now[1]) / np.clip(slope, 0.4, 5.0), -3.0, 3.0))
        if not low < at < high:
            at = 0.5 * (low + high) if np.isfinite(low) and np.isfinite(high) else at
        last = now
        if abs(at) > LARGEST:
            break
    raise UnreachableError(
        f"{case.name}: {hidden.key} does not reach SNR {hidden.snr}, only {snr:.2g} at {np.exp(at):.2g}"
    )


def _write(case: Case, folder: FilePath, run: int) -> dict[str, float]:
    """One run: simulate with all effects, add noise, spoil the premises, write; returns the noise really added."""
    scene = _scene(case, run)
    for number, hidden in enumerate(case.effects):
        kind = hidden.kind
        _hide(case, scene, hidden, number, hidden.amplitude)
        if hidden.key == "unknown":
            hidden.kind = kind
    if case.mask == "temperature not recorded":
        scene.record_temperature = False
    simulate, _ = _parts(case.group)
    module = {"wrench": wrench, "pose": pose}.get(case.group, arm)
    rng = np.random.default_rng([case.seed, 99, run])
    clean = simulate(scene)
    reading = add_noise(rng, clean, SIGMA[case.group], case.noise)
    columns = module.columns(scene, reading, rng)
    info = _info(case, scene)
    if case.premise:
        spoil(case.premise, columns, info)
    _write_table(folder, columns, info)
    if case.group == "position":
        ideal = arm.baseline(scene)
        names = CHANNELS["position"]
        simulated = {"time": scene.path.t} | {n: ideal[:, k] for k, n in enumerate(names)}
        _write_table(folder / "simulation", simulated, {"schema": 1, "robot": None, "predict": "position"})
    rms = np.sqrt(np.mean((reading - clean) ** 2, axis=0))
    return {name: float(r) for name, r in zip(CHANNELS[case.group], rms, strict=True)}


def _info(case: Case, scene: Any) -> dict[str, Any]:
    """recording.json: what the simulation believes, which is the nominal machine."""
    info: dict[str, Any] = {"schema": 1, "predict": case.group}
    if case.bias_free:
        info["model"] = {"bias": "free"}
    if case.group in {"effort", "position"}:
        return info | {"robot": "robot.urdf"}
    t = TOOLS[scene.tool]
    info |= {
        "robot": "galen",
        "tool": {
            "name": scene.tool,
            "mass": t.mass,
            "com": list(t.com),
            "tip": list(t.tip),
            "inertia": np.diag(t.inertia).tolist(),
        },
        "bias_body": {"mass": BIAS_MASS, "com": list(BIAS_COM)},
        "zeroed_at": [0.0, 0.0, 0.0, 0.0, 0.0],
    }
    model = info.setdefault("model", {})
    if getattr(scene, "static_model", False):
        model["dynamics"] = "static"
    if getattr(scene, "known_compliance", False):
        known = dict(zip(pose.PASSIVE, pose.stated(scene).tolist(), strict=True))
        model["compliance"] = {"joint": {"roll": known["roll"], "tilt": known["tilt"]}}
    return info


def _write_table(folder: FilePath, columns: dict[str, Array], info: dict[str, Any]) -> None:
    """recording.csv and recording.json, and the URDF where it is named."""
    folder.mkdir(parents=True, exist_ok=True)
    names = list(columns)
    table = np.column_stack([columns[n] for n in names])
    np.savetxt(folder / "recording.csv", table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    (folder / "recording.json").write_text(json.dumps(info, indent=1))
    if info.get("robot") == "robot.urdf":
        (folder / "robot.urdf").write_text(arm.urdf())
