"""Load and zeroing: zeroed anew, a part picked up or put down, another tool, raw rows among averages."""

import numpy as np
from numpy.typing import NDArray

from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng
from galen_hw.tools.blind_proof.mistakes.origins.static import GRAVITY, reading
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, TORQUE, Load, Recording

Flags = NDArray[np.bool_]

ABOUT = "load"
WRENCH = (*FORCE, *TORQUE)


def _from(rec: Recording, rng: Rng) -> Flags:
    """Rows (N,) from a pose on that lies in the middle part."""
    turn = rec.turn
    assert turn is not None
    fresh = np.r_[True, np.abs(np.diff(turn, axis=0)).max(axis=(1, 2)) > 1e-6] if len(turn) else np.array([])
    pose = np.cumsum(fresh) - 1
    count = pose[-1] + 1
    return np.asarray(pose >= int(rng.integers(max(4, count // 4), min(count - 4, 3 * count // 4))))


def _where(rec: Recording, later: Flags) -> str:
    row = int(np.flatnonzero(later)[0])
    return f"from row {row} ({rec.columns['time'][row]:.1f} s)" if "time" in rec.columns else f"from row {row}"


def zeroed_anew(rec: Recording, rng: Rng) -> Made:
    """The sensor is zeroed once more: all six offsets jump."""
    if "time" in rec.columns and rec.origin != "static":
        later: Flags = np.arange(len(rec)) >= int(rng.uniform(0.3, 0.7) * len(rec))
    else:
        later = _from(rec, rng)
    # Zeroing takes off what was read then.
    row = int(np.flatnonzero(later)[0])
    off = rec.get(WRENCH)[row]
    rec.put(WRENCH, rec.get(WRENCH) - later[:, None] * off)
    return Made(f"zeroed {_where(rec, later)}, {np.linalg.norm(off[:3]):.2f} N")


def _added(rec: Recording, later: Flags, load: Load) -> None:
    turn = rec.turn
    assert turn is not None
    rec.put(WRENCH, rec.get(WRENCH) + later[:, None] * reading(turn, load, GRAVITY))


def part_picked(rec: Recording, rng: Rng) -> Made:
    """A part is picked up, or was there and is put down."""
    assert rec.load is not None
    later = _from(rec, rng)
    part = Load(float(rng.uniform(0.15, 0.6)) * rec.load.mass, (0.0, 0.01, float(rng.uniform(0.08, 0.2))))
    down = rng.random() < 0.4
    _added(rec, ~later if down else later, part)
    says = f"{part.mass:.3f} kg {'put down' if down else 'picked up'} {_where(rec, later)}"
    return Made(says, loads=[rec.load.with_part(part)])


def tool_changed(rec: Recording, rng: Rng) -> Made:
    """Another tool from a pose on."""
    assert rec.load is not None
    later = _from(rec, rng)
    other = Load(
        rec.load.mass * float(rng.choice([0.4, 0.6, 1.6, 2.2])), (-0.02, 0.015, float(rng.uniform(0.03, 0.15)))
    )
    _added(rec, later, Load(-rec.load.mass, rec.load.com))
    _added(rec, later, other)
    return Made(f"a tool of {other.mass:.3f} kg for {rec.load.mass:.3f} {_where(rec, later)}", loads=[other])


def part_moving(rec: Recording, rng: Rng) -> Made:
    """A part is picked up or put down while the arm moves: the load's own shape, so that its whole wrench grows by a share."""
    assert rec.load is not None
    assert rec.clean is not None
    later = np.arange(len(rec)) >= int(rng.uniform(0.3, 0.7) * len(rec))
    share, down = float(rng.uniform(0.1, 0.4)), rng.random() < 0.4
    rec.put(WRENCH, rec.get(WRENCH) + (~later if down else later)[:, None] * share * rec.clean)
    mass = share * rec.load.mass
    return Made(f"{mass:.3f} kg {'put down' if down else 'picked up'} {_where(rec, later)}", {"payload": mass})


def raw_among_averages(rec: Recording, rng: Rng) -> Made:
    """Some poses as averages, others as all of their rows."""
    count = len(rec)
    raw = rng.random(count) < 0.4
    raw[:2] = [True, False]
    per = np.where(raw, int(rng.integers(20, 60)), 1)
    rec.rows(np.repeat(np.arange(count), per))
    loud = np.repeat(raw, per)[:, None] * np.array([0.05] * 3 + [2e-3] * 3)
    rec.put(WRENCH, rec.get(WRENCH) + rng.normal(size=(len(rec), 6)) * loud)
    return Made(f"{int(raw.sum())} of {count} poses raw")


def raw_rows(rec: Recording, rng: Rng) -> Made:
    """Right, though many: all rows of each pose, none averaged, and each pose's orientation a little off."""
    del rng
    return Made(f"{len(rec)} raw rows")


ZERO = r"zero|offset.{0,80}(?:jump|step|chang)|bias.{0,80}(?:jump|step|chang)|jump|taken? anew"
LOAD = (
    r"picked|put down|load.{0,60}chang|chang.{0,60}(?:mass|weight|load|tool)|two (?:tools|loads|fits)"
    r"|(?:mass|weight|payload|tool).{0,100}(?:chang|differ|from (?:pose|row|\d)|until|before|after)"
)
AVERAGES = r"raw|averag|rows of (?:one|a) pose|rows? (?:each|a pose)|by pose"
STEP = frozenset({"step"})
PAYLOAD = frozenset({"payload"})

KINDS = (
    Kind("zeroed_anew_static", ABOUT, "calibrate", ("static",), zeroed_anew, (ZERO,)),
    Kind("zeroed_anew", ABOUT, "diagnose", ("arm6-wrench", "proof-wrench"), zeroed_anew, (ZERO,), effects=STEP),
    Kind("part_static", ABOUT, "calibrate", ("static",), part_picked, (LOAD,)),
    Kind("tool_changed_static", ABOUT, "calibrate", ("static",), tool_changed, (LOAD,)),
    Kind("part_moving", ABOUT, "diagnose", ("arm6-wrench",), part_moving, (LOAD,), effects=PAYLOAD),
    Kind(
        "raw_among_averages",
        ABOUT,
        "calibrate",
        ("static",),
        raw_among_averages,
        (AVERAGES,),
        silent=True,
        needs=frozenset({"averages"}),
    ),
    Kind("raw_rows", ABOUT, "calibrate", ("static",), raw_rows, (AVERAGES,), silent=True, needs=frozenset({"raw"})),
)
