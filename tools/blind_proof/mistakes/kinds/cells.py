"""Cells: values that mean "lost", velocities that are not those of the positions, wrapped joints, held and doubled rows."""

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng, both
from galen_hw.tools.blind_proof.mistakes.recording import POINT, TURN, Recording

ABOUT = "cells and clocks"
BAD_FLOAT = -3.697314e28
"""What NDI's API gives for a value that is missing."""
POSES = ("arm6-pose", "proof-pose")
MOVING = ("arm6-wrench", "arm6-effort", "proof-wrench", "proof-effort")
LOST = r"lost|missing|not (?:seen|measured|tracked)|drop|no value|place.?holder|bad.?float|not a measurement"


def _lost(rec: Recording, rng: Rng) -> NDArray[np.bool_]:
    """Rows (N,) in which a tracker has lost its marker: a few stretches, 2 to 12 % of all."""
    out = np.zeros(len(rec), dtype=bool)
    share = rng.uniform(0.02, 0.12)
    while out.mean() < share:
        start = int(rng.integers(3, len(rec) - 2))
        out[start : start + int(rng.integers(1, 16))] = True
    return out


def _pose(rec: Recording) -> list[str]:
    return [c for c in (*POINT, *TURN) if c in rec.columns]


def _fill(rec: Recording, lost: NDArray[np.bool_], values: dict[str, float]) -> Made:
    for name, value in values.items():
        rec.columns[name][lost] = value
    return Made(f"{100 * lost.mean():.0f} % of the rows read {sorted(set(values.values()))} in {len(values)} columns")


def ndi_bad_float(rec: Recording, rng: Rng) -> Made:
    """A lost tracker reads NDI's bad float."""
    return _fill(rec, _lost(rec, rng), dict.fromkeys(_pose(rec), BAD_FLOAT))


def lost_zeros(rec: Recording, rng: Rng) -> Made:
    """A lost tracker reads zero in all of its columns."""
    return _fill(rec, _lost(rec, rng), dict.fromkeys(_pose(rec), 0.0))


def lost_identity(rec: Recording, rng: Rng) -> Made:
    """A lost tracker reads the origin, and no turn."""
    values = dict.fromkeys(_pose(rec), 0.0)
    if "pose.orientation.w" in values:
        values["pose.orientation.w"] = 1.0
    return _fill(rec, _lost(rec, rng), values)


def lost_held(rec: Recording, rng: Rng) -> Made:
    """A lost tracker repeats the last value that it had."""
    lost, names = _lost(rec, rng), _pose(rec)
    for i in np.flatnonzero(lost):
        for name in names:
            rec.columns[name][i] = rec.columns[name][i - 1]
    return Made(f"{100 * lost.mean():.0f} % of the rows repeat the last pose")


def velocity_zero(rec: Recording, rng: Rng) -> Made:
    """The velocity columns are all zero though the joints move: all of them, or some."""
    names = rec.joints("velocity")
    chosen = names if rng.random() < 0.6 else list(rng.choice(names, 2, replace=False))
    for name in chosen:
        rec.columns[name] = 0.0 * rec.columns[name]
    return Made(f"zero: {', '.join(chosen)}")


def velocity_contradicts(rec: Recording, rng: Rng) -> Made:
    """The velocity columns are not those of the positions: of other joints, turned about, or in deg/s."""
    names, how = rec.joints("velocity"), str(rng.choice(["shifted by one joint", "reversed", "in deg/s"]))
    values = rec.get(names)
    values = {"shifted by one joint": np.roll(values, 1, axis=1), "reversed": -values}.get(how, np.degrees(values))
    rec.put(names, values)
    return Made(f"velocities {how}")


def wrapped(rec: Recording, rng: Rng) -> Made:
    """Positions are wrapped to a turn, from where the joint moves across it."""
    names = [n for n in rec.joints() if np.ptp(rec.columns[n]) > 0.3 and "carriage" not in n]
    chosen = list(rng.choice(names, min(len(names), int(rng.integers(1, 3))), replace=False))
    for name in chosen:
        values = rec.columns[name]
        # What the joint calls its half turn lies in the middle of where it moves.
        cut = rng.uniform(*np.quantile(values, [0.3, 0.7]))
        rec.columns[name] = np.where(values > cut, values - 2 * np.pi, values)
    return Made(f"jumps by a turn: {', '.join(chosen)}")


def staircase(rec: Recording, rng: Rng) -> Made:
    """Joint positions come less often than the rest and are held between."""
    per = int(rng.integers(3, 7))
    at = np.arange(len(rec)) // per * per
    for name in (*rec.joints(), *rec.joints("velocity")):
        rec.columns[name] = rec.columns[name][at]
    return Made(f"joints held for {per} rows each")


def doubled(rec: Recording, rng: Rng) -> Made:
    """Rows are in the file twice: some, or all."""
    share = float(rng.choice([0.05, 0.3, 1.0]))
    times = 1 + (rng.random(len(rec)) < share)
    rec.rows(np.repeat(np.arange(len(rec)), times))
    return Made(f"{100 * share:.0f} % of the rows twice")


def outer_join(rec: Recording, rng: Rng) -> Made:
    """Two topics joined by time: joints and what is compared stand on rows of their own, stamps never alike."""
    joints = [*rec.joints(), *rec.joints("velocity"), *rec.joints("effort")]
    compared = set(rec.compared)
    mine = np.arange(len(rec)) % 2 == int(rng.integers(2))
    for name in rec.columns:
        if name in compared:
            rec.columns[name] = np.where(mine, rec.columns[name], np.nan)
        elif name in joints:
            rec.columns[name] = np.where(mine, np.nan, rec.columns[name])
    return Made("joints and the compared group on rows of their own")


def _top_bit(rec: Recording) -> float:
    """The least power of two, in N m of a thousandth each, that no effort reaches."""
    most = np.abs(rec.get(rec.joints("effort"))).max()
    return float(2.0 ** np.ceil(np.log2(1000.0 * most)) / 1000.0)


def sign_magnitude(rec: Recording, rng: Rng) -> Made:
    """Efforts come as sign and magnitude and were read as unsigned: the sign's bit is added to what is negative."""
    del rng
    bit = _top_bit(rec)
    for name in rec.joints("effort"):
        values = rec.columns[name]
        rec.columns[name] = np.where(values < 0, bit - values, values)
    return Made(f"negative efforts read as {bit:g} and their size")


def unsigned_wrap(rec: Recording, rng: Rng) -> Made:
    """Negative efforts, in two's complement, were read as unsigned."""
    del rng
    turn = 2.0 * _top_bit(rec)
    for name in rec.joints("effort"):
        values = rec.columns[name]
        rec.columns[name] = np.where(values < 0, values + turn, values)
    return Made(f"negative efforts read as {turn:g} more")


UNSIGNED = both("sign", "magnitude|unsigned|bit|two.?s complement|jump|wrap|lost|read") + r"|unsigned|no sign"
VELOCITY = both(
    "velocit", "zero|contradict|not (?:the|those|of)|left out|derivative|differ|disagree|unit|deg|ignored|sign"
)
EFFORTS = ("arm6-effort", "proof-effort")

KINDS = (
    Kind("ndi_bad_float", ABOUT, "diagnose", POSES, ndi_bad_float, (LOST + "|e28|NDI",)),
    Kind("lost_zeros", ABOUT, "diagnose", POSES, lost_zeros, (LOST + "|zero",)),
    Kind("lost_identity", ABOUT, "diagnose", POSES, lost_identity, (LOST + "|identity|origin|zero",)),
    Kind(
        "lost_held",
        ABOUT,
        "diagnose",
        POSES,
        lost_held,
        (LOST + r"|\bheld\b(?! out)|repeat|frozen|stuck|same value",),
        silent=True,
        effects=frozenset({"glitches"}),
    ),
    Kind(
        "velocity_zero",
        ABOUT,
        "diagnose",
        ("arm6-effort", "arm6-wrench", "panda"),
        velocity_zero,
        (VELOCITY,),
        silent=True,
        needs=frozenset({"velocity"}),
        fits=lambda r: bool(r.joints("velocity")),
    ),
    Kind(
        "velocity_contradicts",
        ABOUT,
        "diagnose",
        ("arm6-effort", "arm6-wrench", "panda"),
        velocity_contradicts,
        (VELOCITY,),
        silent=True,
        needs=frozenset({"velocity"}),
        fits=lambda r: bool(r.joints("velocity")),
    ),
    Kind(
        "wrapped",
        ABOUT,
        "diagnose",
        (*MOVING, "arm6-pose", "proof-pose"),
        wrapped,
        (r"wrap|full turn|2 ?pi|360|turns?\b.*jump|jump.*turn",),
        silent=True,
    ),
    Kind(
        "staircase",
        ABOUT,
        "diagnose",
        MOVING,
        staircase,
        (r"staircase|\bheld\b(?! out)|\bhold|repeat|slower|\brates?\b|same value|\bsteps\b",),
        effects=frozenset({"time_delay", "lag"}),
    ),
    Kind(
        "doubled",
        ABOUT,
        "diagnose",
        (*MOVING, *POSES, "emps"),
        doubled,
        (r"twice|doubl|duplicat|same (?:time|stamp)|repeat",),
        silent=True,
    ),
    Kind(
        "outer_join",
        ABOUT,
        "diagnose",
        (*MOVING, *POSES),
        outer_join,
        (r"resampl|interpolat|two clocks|join|rows of (?:their|its) own|never (?:in )?the same row|no row",),
        silent=True,
    ),
    Kind("sign_magnitude", ABOUT, "diagnose", EFFORTS, sign_magnitude, (UNSIGNED,)),
    Kind("unsigned_wrap", ABOUT, "diagnose", EFFORTS, unsigned_wrap, (UNSIGNED,)),
)
