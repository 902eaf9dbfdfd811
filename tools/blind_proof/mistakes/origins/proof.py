"""Recordings of the proof's own generator, short, with nothing in them or one strong effect."""

import tempfile
from pathlib import Path

import numpy as np

from galen_hw.tools.blind_proof.generator.build import build
from galen_hw.tools.blind_proof.generator.case import Case, Injected
from galen_hw.tools.blind_proof.mistakes.recording import Recording, read

STRONG = 4.0
"""Severity of an effect: certain to be named where nothing else is wrong."""
EFFECTS = {
    "wrench": ("payload", "base_tilt", "gain"),
    "pose": ("joint_offset", "compliance"),
    "effort": ("friction", "payload"),
    "position": ("time_delay", "backlash"),
}
RATE_HZ = {"wrench": 40.0, "pose": 30.0, "effort": 50.0, "position": 100.0}
"""Position runs through a simulation of the servo's own steps: its rate stays."""


def make(group: str, rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """One run; with "nothing" among the needs, without an effect."""
    effects = []
    if "nothing" not in needs and rng.random() < 0.4:
        key = str(rng.choice(EFFECTS[group]))
        effects = [Injected(key, key, STRONG)]
    case = Case(
        name="start",
        seed=int(rng.integers(2**31)),
        group=group,
        # Of this share the generator writes no second run.
        share="premise",
        noise=str(rng.choice(["white", "coloured", "quantised"])),
        motion=str(rng.choice(["stream", "sweep"], p=[0.7, 0.3])),
        rate_hz=RATE_HZ[group],
        duration_s=float(rng.uniform(25.0, 35.0)) if group != "position" else 15.0,
        effects=effects,
        bias_free=True,
    )
    with tempfile.TemporaryDirectory() as scratch:
        built = build(case, Path(scratch))
        out = read(Path(scratch) / "train")
    out.origin, out.effects = f"proof-{group}", tuple(e.key for e in built.effects)
    return out
