"""Sets for `deflection fit`: the proof's giving Galen, held at a place and pushed at its tip, one set a place."""

import numpy as np

from galen_hw.tools.blind_proof.generator import pose
from galen_hw.tools.blind_proof.generator.case import Case
from galen_hw.tools.blind_proof.generator.galen import TOOLS
from galen_hw.tools.blind_proof.generator.motion import Path, pushes
from galen_hw.tools.blind_proof.mistakes.recording import Recording

PLACES, SECONDS, RATE_HZ = 6, 20.0, 25.0
GIVE = np.array([2e-5, 6e-4, 9e-4])
"""Of a giving arm: m/N of its lift, rad/(N m) of roll and tilt."""


def make(rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """Six places, the first of them twice, pushes of up to 8 N in all directions at each."""
    del needs
    tool = str(rng.choice(list(TOOLS)))
    give = pose.Give(compliance=GIVE * rng.uniform(0.6, 1.4, 3))
    case = Case("pushed", 0, "pose", "null", rate_hz=RATE_HZ, duration_s=SECONDS)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    places = [np.concatenate([rng.uniform(-0.04, 0.04, 3), rng.uniform(-0.8, 0.8, 2)]) for _ in range(PLACES)]
    parts = []
    for number, place in enumerate([*places, places[0]]):
        q = np.repeat(place[None], len(t), axis=0)
        path = Path(t + 60.0 * number, q, 0 * q, 0 * q)
        scene = pose.PoseScene(case, path, pushes(rng, t, newtons=8.0, period_s=10.0), tool, give)
        seen = pose.simulate(scene)
        parts.append(pose.columns(scene, seen + rng.normal(0, pose.SIGMA, seen.shape), rng))
    columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    t0 = TOOLS[tool]
    about = {"name": tool, "mass": t0.mass, "com": list(t0.com), "tip": list(t0.tip)}
    return Recording(columns, {"schema": 1, "robot": "galen", "predict": "pose", "tool": about}, parts=len(parts))
