"""Clocks: steps back and forth, stamps in other units, rounded stamps, another rate than the samples say."""

import numpy as np

from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng
from galen_hw.tools.blind_proof.mistakes.recording import Recording

ABOUT = "cells and clocks"
CLOCKED = ("arm6-wrench", "arm6-effort", "arm6-pose", "proof-wrench", "proof-effort", "proof-pose", "emps", "panda")
CLOCK = r"clock|time.?stamp|stamps|\btime\b.{0,60}(?:unit|second|step|back|jump|round|ms\b|ns\b|rate)|seconds|\brate\b"


def _from(rec: Recording, rng: Rng) -> int:
    return int(rng.integers(len(rec) // 5, 4 * len(rec) // 5))


def step_back(rec: Recording, rng: Rng) -> Made:
    """The clock was set back once."""
    at, by = _from(rec, rng), float(np.exp(rng.uniform(np.log(0.2), np.log(30.0))))
    rec.columns["time"][at:] -= by
    return Made(f"set back by {by:.2f} s at row {at}")


def step_forth(rec: Recording, rng: Rng) -> Made:
    """The clock was set forth once."""
    at, by = _from(rec, rng), float(np.exp(rng.uniform(np.log(0.5), np.log(3600.0))))
    rec.columns["time"][at:] += by
    return Made(f"set forth by {by:.2f} s at row {at}")


def _epoch(rng: Rng) -> float:
    """Half of all stamps count from 1970."""
    return float(rng.choice([0.0, 1.7e9]))


def stamps_unit(rec: Recording, rng: Rng) -> Made:
    """Stamps in ns, us or ms, from the start or since 1970."""
    unit, per = [("ns", 1e9), ("us", 1e6), ("ms", 1e3)][int(rng.integers(3))]
    since = _epoch(rng)
    rec.columns["time"] = np.round((rec.columns["time"] + since) * per)
    return Made(f"stamps in {unit}{' since 1970' if since else ''}")


def whole_seconds(rec: Recording, rng: Rng) -> Made:
    """Stamps without their fractions."""
    rec.columns["time"] = np.floor(rec.columns["time"] + _epoch(rng))
    return Made("whole seconds")


def spreadsheet(rec: Recording, rng: Rng) -> Made:
    """Stamps rounded as a spreadsheet shows them: to tenths, to hundredths, or seconds since 1970 to five digits and a power."""
    digits = int(rng.integers(1, 3))
    step = float(np.median(np.diff(rec.columns["time"])))
    # Coarser than the samples, or it is no mistake.
    digits = min(digits, int(np.floor(-np.log10(step))))
    rec.columns["time"] = np.round(rec.columns["time"], digits)
    return Made(f"stamps to {digits} digits, a sample every {step:.4g} s")


def other_rate(rec: Recording, rng: Rng) -> Made:
    """The stamps were made from a rate that was not the samples': everything is so many times as quick."""
    by = float(rng.choice([0.1, 0.25, 0.5, 2.0, 4.0, 10.0]))
    t = rec.columns["time"]
    rec.columns["time"] = t[0] + (t - t[0]) * by
    return Made(f"seconds {by:g} times as long")


KINDS = (
    Kind("clock_back", ABOUT, "diagnose", CLOCKED, step_back, (CLOCK,), silent=True),
    Kind("clock_forth", ABOUT, "diagnose", CLOCKED, step_forth, (CLOCK,), silent=True),
    Kind("stamps_unit", ABOUT, "diagnose", CLOCKED, stamps_unit, (CLOCK,), silent=True),
    Kind("whole_seconds", ABOUT, "diagnose", CLOCKED, whole_seconds, (CLOCK,), silent=True),
    Kind("spreadsheet", ABOUT, "diagnose", CLOCKED, spreadsheet, (CLOCK,), silent=True),
    Kind(
        "other_rate",
        ABOUT,
        "diagnose",
        ("arm6-wrench", "arm6-effort", "panda"),
        other_rate,
        (CLOCK,),
        silent=True,
        needs=frozenset({"velocity"}),
        fits=lambda r: bool(r.joints("velocity")),
    ),
)
