"""Where the mismatch sits: channels, times, and regions of joint space, speed, load and temperature."""

from typing import Any

import numpy as np

from galen_hw.diagnosis.bench import Bench
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.judge import Judged
from galen_hw.physics.event_effects import Contact, Glitches, Step
from galen_hw.spatial import Array


def channels_of(bench: Bench, judged: Judged) -> list[dict[str, Any]]:
    """Every channel with its share of the excess, in units of its noise; most first."""
    floor = judged.floor
    excess = np.maximum(judged.before / floor - 1.0 - 3.0 * np.sqrt(2.0 / max(len(bench.rows), 1)), 0.0)
    share = excess / max(float(excess.sum()), 1e-300)
    return [
        {
            "channel": bench.scene.channels[c],
            "excess_share": float(share[c]),
            "rmse": float(np.sqrt(judged.before[c])),
            "noise_floor": float(np.sqrt(floor[c])),
        }
        for c in np.argsort(-share)
    ]


def where_of(model: Model) -> list[dict[str, Any]]:
    """Ranges of a variable that hold much more of the excess than of the time, found on training rows, kept if held-out agree."""
    bench = model.bench
    energy = np.sum(bench.whole**2 / bench.noise.sigma**2, axis=1) - bench.width
    out: list[dict[str, Any]] = []
    train, judged = bench.train, bench.judged if bench.judged.any() else bench.train
    for name, unit, values in variables(bench):
        found = _range(values[train], energy[train])
        if found is None:
            continue
        low, high = found
        inside = (values >= low) & (values <= high)
        shares = [float(energy[rows & inside].sum() / max(energy[rows].sum(), 1e-300)) for rows in (train, judged)]
        time = float(inside.mean())
        if min(shares) > 1.5 * time + 0.05 and time < 0.7:
            span = f"{name} from {low:.3g} to {high:.3g} {unit}"
            says = f"{100 * shares[1]:.0f} % of the excess in {100 * time:.0f} % of the rows: {span}"
            out.append({"variable": name, "range": [float(low), float(high)], "excess_share": shares[1], "says": says})
    return sorted(out, key=lambda one: -float(one["excess_share"]))[:4]


def variables(bench: Bench) -> list[tuple[str, str, Array]]:
    """Name, unit and values (M,) of what the excess may depend on."""
    scene, out = bench.scene, []
    for joint in scene.moved:
        j = scene.joint_index(joint)
        out.append((f"joint.{joint}.position", "", bench.rows.average(scene.q[:, j])))
        if scene.clock:
            out.append((f"joint.{joint}.velocity", "", bench.rows.average(scene.rates[0][:, j])))
    for name, values in scene.observations.columns.items():
        if name.startswith(("temperature.", "applied.force")) and np.isfinite(values).all() and np.ptp(values) > 0:
            out.append((name, "", bench.rows.average(values)))
    return out


def _range(values: Array, energy: Array, bins: int = 10) -> tuple[float, float] | None:
    """The run of tenths whose mean excess is above twice the overall mean."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    if len(edges) < 4 or energy.sum() <= 0:
        return None
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    mean = np.array([energy[place == b].mean() if (place == b).any() else 0.0 for b in range(len(edges) - 1)])
    top = int(np.argmax(mean))
    if mean[top] < 1.6 * energy.mean():
        return None
    low = high = top
    while low > 0 and mean[low - 1] > 1.3 * energy.mean():
        low -= 1
    while high < len(mean) - 1 and mean[high + 1] > 1.3 * energy.mean():
        high += 1
    return float(edges[low]), float(edges[high + 1])


def episodes_of(model: Model, glitch: list[Glitches]) -> list[list[float]]:
    """Times at which something happens: of contacts, after steps, around glitches; else where the excess is loud."""
    scene, out = model.bench.scene, []
    for h in model.effects:
        if isinstance(h.effect, Contact):
            out += [list(e) for e in h.effect.episodes]
        if isinstance(h.effect, Step):
            out.append([h.effect.moment, float(scene.time[-1])])
    for one in glitch:
        out += [[float(scene.time[r]), float(scene.time[r])] for r in one.rows[:50]]
    return sorted(out) or _loud(model)


def _loud(model: Model) -> list[list[float]]:
    bench = model.bench
    energy = np.sum(bench.whole**2 / bench.noise.sigma**2, axis=1)
    count = min(60, len(energy) // 8)
    if count < 8:
        return []
    pieces = np.array_split(np.arange(len(energy)), count)
    mean = np.array([energy[p].mean() for p in pieces])
    loud = mean > 2.0 * energy.mean()
    at = bench.rows.starts
    out: list[list[float]] = []
    for k in np.flatnonzero(loud):
        start, end = (float(bench.scene.time[at[pieces[k][i]]]) for i in (0, -1))
        if out and k > 0 and loud[k - 1]:
            out[-1][1] = end
        else:
            out.append([start, end])
    return out
