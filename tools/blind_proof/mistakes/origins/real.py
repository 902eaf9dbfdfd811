"""Excerpts of real recordings, where they are present beside the checkout."""

from dataclasses import dataclass

import numpy as np

from galen_hw.tools.blind_proof.mistakes.recording import Load, Recording, read
from galen_hw.tools.blind_proof.real import data_folder


@dataclass(frozen=True)
class Real:
    """One run: its folder, how long an excerpt is, every which row of it, and what its README says is in it."""

    folder: str
    rows: int
    every: int
    effects: tuple[str, ...]
    load: Load | None = None


REALS = {
    "emps": Real("emps/train", 2500, 4, ("friction",)),
    "kr300": Real("kr300-dual-encoder/train", 2500, 1, ("time_delay", "lag")),
    "panda": Real("panda-excite/train", 1500, 4, ("friction",)),
    "brfd": Real("brfd-backlash/train", 2500, 2, ("hysteresis", "backlash", "friction")),
    "kuka": Real("real-2/kuka_run1", 600, 1, ("inertial", "payload", "sensor_mounting")),
    "ft-kuka": Real("ft-kuka-ati-static", 24, 1, (), Load(0.933, (0.0, 0.0, 0.044))),
}


def present(name: str) -> bool:
    """Return whether this one is on this machine."""
    data = data_folder()
    return data is not None and (data / REALS[name].folder / "recording.csv").exists()


def make(name: str, rng: np.random.Generator, needs: frozenset[str]) -> Recording:
    """An excerpt that begins anywhere."""
    del needs
    data = data_folder()
    assert data is not None
    real = REALS[name]
    out = read(data / real.folder)
    span = min(real.rows * real.every, len(out))
    start = int(rng.integers(0, len(out) - span + 1))
    chosen = slice(start, start + span, real.every)
    out.rows(chosen)
    if out.simulation is not None:
        out.simulation.rows(chosen)
    out.origin, out.effects, out.load = name, real.effects, real.load
    return out
