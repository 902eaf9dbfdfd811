"""Units: a whole group or one column in the field's units, in a power of ten, in counts or shares of a rated value."""

from dataclasses import dataclass

import numpy as np

from galen_hw.tools.blind_proof.mistakes.kinds.kind import Kind, Made, Rng, both
from galen_hw.tools.blind_proof.mistakes.recording import FORCE, POINT, TORQUE, Recording

ABOUT = "units"
G = 9.80665
POUND = 4.4482216
INCH = 0.0254


@dataclass(frozen=True)
class Unit:
    """What force and moment are multiplied by; `words` show that it was seen."""

    name: str
    force: float
    torque: float
    words: str


WRENCHES = (
    Unit("moments in N mm", 1.0, 1e3, r"N ?mm|milli|1000|power of ten|1e-?3"),
    Unit("kgf and kgf m", 1 / G, 1 / G, r"kgf|kilogram|1/9\.8|9\.8"),
    Unit("kgf and kgf mm", 1 / G, 1e3 / G, r"kgf|kilogram|9\.8|mm"),
    Unit("lbf and lbf in", 1 / POUND, 1 / (POUND * INCH), r"lb|pound|inch"),
    Unit("lbf and lbf ft", 1 / POUND, 1 / (POUND * 0.3048), r"lb|pound|ft"),
    Unit("counts of the sensor", 1e6, 1e6, r"count|1e6|1000000|power of ten|million"),
    Unit("mN and mN m", 1e3, 1e3, r"mN|milli|1000|power of ten"),
    Unit("kN and kN m", 1e-3, 1e-3, r"kN|kilo|1000|power of ten"),
    Unit("gram-force", 1e3 / G, 1e3 / G, r"gf|gram|9\.8"),
)
UNIT = (
    r"\bunits?\b|\bin (?:[kmcd]?N(?: ?m| ?mm| ?cm)?|kgf|lbf|mm|deg|counts|mA|per ?mille|degrees)\b|power of ten"
    r"|times (?:as|too) (?:large|small|big|great|high)"
)


def wrench_unit(rec: Recording, rng: Rng) -> Made:
    """Force and moment in another unit; without a named tool only one that shows, the moment's own."""
    named = "mass" in rec.info.get("tool", {})
    unit = WRENCHES[int(rng.integers(len(WRENCHES)))] if named else WRENCHES[0]
    rec.put(FORCE, rec.get(FORCE) * unit.force)
    rec.put(TORQUE, rec.get(TORQUE) * unit.torque)
    return Made(unit.name)


def wrench_column(rec: Recording, rng: Rng) -> Made:
    """One column of the wrench a power of ten off."""
    name = str(rng.choice([*FORCE, *TORQUE]))
    by = float(rng.choice([10.0, 100.0, 1e3, 1e-3]))
    rec.columns[name] = rec.columns[name] * by
    return Made(f"{name} times {by:g}")


def joints_in_degrees(rec: Recording, rng: Rng) -> Made:
    """All turning joints in degrees, positions and velocities."""
    del rng
    names = [n for n in rec.joints() + rec.joints("velocity") if "carriage" not in n]
    rec.put(names, np.degrees(rec.get(names)))
    return Made("joints in deg")


def one_joint_in_degrees(rec: Recording, rng: Rng) -> Made:
    """One turning joint in degrees."""
    name = str(rng.choice([n for n in rec.joints() if "carriage" not in n]))
    rec.columns[name] = np.degrees(rec.columns[name])
    return Made(f"{name} in deg")


def joints_in_turns(rec: Recording, rng: Rng) -> Made:
    """Turning joints in revolutions or encoder counts."""
    unit, per = [("rev", 1.0), ("counts of 4096", 4096.0), ("counts of 2^20", 2.0**20)][int(rng.integers(3))]
    names = [n for n in rec.joints() + rec.joints("velocity") if "carriage" not in n]
    values = rec.get(names) / (2 * np.pi) * per
    rec.put(names, values if per == 1.0 else np.round(values))
    return Made(f"joints in {unit}")


def carriages_in_mm(rec: Recording, rng: Rng) -> Made:
    """The sliding joints in mm."""
    del rng
    names = [n for n in rec.joints() if "carriage" in n]
    rec.put(names, rec.get(names) * 1e3)
    return Made("carriages in mm")


def pose_in_mm(rec: Recording, rng: Rng) -> Made:
    """Tracked positions in mm, cm or inches."""
    unit, per = [("mm", 1e3), ("cm", 1e2), ("inches", 1 / INCH)][int(rng.choice(3, p=[0.7, 0.15, 0.15]))]
    names = [c for c in rec.compared if ".position." in c]
    rec.put(names, rec.get(names) * per)
    return Made(f"positions in {unit}")


def pose_column(rec: Recording, rng: Rng) -> Made:
    """One coordinate of the tracked position in mm."""
    name = str(rng.choice(POINT))
    rec.columns[name] = rec.columns[name] * 1e3
    return Made(f"{name} in mm")


def effort_unit(rec: Recording, rng: Rng) -> Made:
    """Efforts in per mille of each motor's rated torque, in mA, or all in one other unit."""
    names, how = (
        rec.joints("effort"),
        str(rng.choice(["per mille of the rated torque", "mA", "N mm", "lbf in", "kgf cm"])),
    )
    if how.startswith("per mille"):
        per = 1e3 / rng.uniform(0.6, 40.0, len(names))
    elif how == "mA":
        # 0.05 to 0.3 N m/A behind gears of 50 to 160.
        per = 1e3 / (rng.uniform(0.05, 0.3, len(names)) * rng.choice([50, 100, 160], len(names)))
    else:
        per = np.full(len(names), {"N mm": 1e3, "lbf in": 1 / (POUND * INCH), "kgf cm": 100 / G}[how])
    rec.put(names, rec.get(names) * per)
    return Made(f"efforts in {how}: {', '.join(f'{p:.3g}' for p in per)} a N m")


def effort_column(rec: Recording, rng: Rng) -> Made:
    """One motor's effort a power of ten off."""
    name, by = str(rng.choice(rec.joints("effort"))), float(rng.choice([10.0, 100.0, 1e3]))
    rec.columns[name] = rec.columns[name] * by
    return Made(f"{name} times {by:g}")


def position_unit(rec: Recording, rng: Rng) -> Made:
    """The measured joint positions in degrees, their commands in rad."""
    del rng
    names = rec.joints()
    rec.put(names, np.degrees(rec.get(names)))
    return Made("positions in deg, commands in rad")


WRENCH = ("arm6-wrench", "proof-wrench")
EFFORT = ("arm6-effort", "proof-effort", "panda")
# A joint that hardly bears weight, or turns about the vertical, shows no unit in its effort: friction alone has no scale.
TOOL = frozenset({"tool"})
DEGREES = UNIT + "|degree|deg\\b"

KINDS = (
    Kind("wrench_unit", ABOUT, "diagnose", WRENCH, wrench_unit, (UNIT, *(u.words for u in WRENCHES[1:5]))),
    Kind(
        "wrench_unit_static",
        ABOUT,
        "calibrate",
        ("static",),
        wrench_unit,
        (UNIT, "kgf|lbf|N ?mm", both("named|tool|recording.json", "mass|times|unit")),
        needs=TOOL,
    ),
    Kind(
        "moment_unit_static",
        ABOUT,
        "calibrate",
        ("static", "ft-kuka"),
        wrench_unit,
        (UNIT, "N ?mm", both("moment|torque|com", "mm|lever|far|metres")),
        needs=frozenset({"no tool"}),
        fits=lambda r: "mass" not in r.info.get("tool", {}),
    ),
    Kind("wrench_column", ABOUT, "diagnose", WRENCH, wrench_column, (UNIT,), effects=frozenset({"gain"})),
    Kind(
        "wrench_column_static",
        ABOUT,
        "calibrate",
        ("static", "ft-kuka"),
        wrench_column,
        (UNIT, both("force|torque|F[xyz]|T[xyz]", "scale|gain|times")),
    ),
    Kind(
        "joints_in_degrees",
        ABOUT,
        "diagnose",
        (*WRENCH, "arm6-effort", "proof-effort", "arm6-pose", "proof-pose", "panda"),
        joints_in_degrees,
        (DEGREES,),
    ),
    Kind(
        "one_joint_in_degrees",
        ABOUT,
        "diagnose",
        (*WRENCH, "arm6-effort", "arm6-pose"),
        one_joint_in_degrees,
        (DEGREES,),
        effects=frozenset({"joint_scale"}),
    ),
    Kind(
        "joints_in_turns",
        ABOUT,
        "diagnose",
        (*WRENCH, "arm6-effort", "arm6-pose"),
        joints_in_turns,
        (UNIT + "|count|turns|\\brev",),
    ),
    Kind(
        "joints_in_degrees_static",
        ABOUT,
        "calibrate",
        ("static",),
        joints_in_degrees,
        (DEGREES,),
        needs=frozenset({"joints"}),
    ),
    Kind("carriages_in_mm", ABOUT, "diagnose", ("proof-pose",), carriages_in_mm, (UNIT + r"|\bmm\b",)),
    Kind(
        "pose_unit",
        ABOUT,
        "diagnose",
        ("arm6-pose", "proof-pose", "arm6-targets"),
        pose_in_mm,
        (UNIT + r"|\bmm\b|\bcm\b|inch",),
    ),
    Kind("pose_column", ABOUT, "diagnose", ("arm6-pose", "proof-pose"), pose_column, (UNIT + r"|\bmm\b",)),
    Kind("effort_unit", ABOUT, "diagnose", EFFORT, effort_unit, (UNIT + r"|N ?mm|per ?mille|rated|\bmA\b|lbf|kgf",)),
    Kind("effort_column", ABOUT, "diagnose", EFFORT, effort_column, (UNIT,), effects=frozenset({"gain"})),
    Kind("position_unit", ABOUT, "diagnose", ("proof-position", "kr300"), position_unit, (DEGREES,)),
)
