"""The recordings with mistakes that were handed over: asked with defaults, and what their README calls right."""

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from galen_hw.tools.blind_proof.mistakes.ask import ask
from galen_hw.tools.blind_proof.mistakes.kinds import frames
from galen_hw.tools.blind_proof.mistakes.kinds.cells import UNSIGNED
from galen_hw.tools.blind_proof.mistakes.score import Answer, failed, findings, lines_said, premises, short

TRUE_MASS, TRUE_COM = 0.85, (0.012, -0.004, 0.061)


@dataclass(frozen=True)
class Given:
    """One of them: the command, and a predicate on the answer."""

    command: str
    right: Callable[[Answer], bool]


def _says(answer: Answer, pattern: str) -> bool:
    text = [*lines_said(answer), " ".join(lines_said(answer))]
    return any(re.search(pattern, line, re.IGNORECASE) for line in text)


def _calibrated(answer: Answer, grams: float, millimetres: float) -> bool:
    """Accepted, and so near to the truth."""
    given = answer["json"] or {}
    if not given.get("accepted"):
        return False
    mass, com = given["tool"]["mass"], given["tool"]["com"]
    off = max(abs(a - b) for a, b in zip(com, TRUE_COM, strict=True))
    return bool(abs(mass - TRUE_MASS) <= 1e-3 * grams and off <= 1e-3 * millimetres)


def _refused(answer: Answer) -> bool:
    given = answer["json"]
    return answer["exit"] in {2, 4} or (given is not None and not given.get("accepted", True))


def _found(answer: Answer) -> list[str]:
    return [f["effect"] for f in findings(answer)]


def _agrees(answer: Answer) -> bool:
    return answer["json"] is not None and answer["json"].get("verdict") == "agrees"


def _only(answer: Answer, *effects: str) -> bool:
    """No finding but these."""
    return set(_found(answer)) <= set(effects)


def _spoke_or_alone(answer: Answer, pattern: str, *effects: str) -> bool:
    """A refusal or a repair that names it, and no other name beside: `unknown` is none, it is where a refusal is told."""
    return _says(answer, pattern) and _only(answer, *effects, "unknown")


def _value(answer: Answer, effect: str, unit: str) -> float:
    """Size of a finding's parameters of a unit; not a number without one."""
    for finding in findings(answer):
        if finding["effect"] == effect:
            values = [p["value"] for p in finding["parameters"].values() if p.get("unit") == unit]
            return float(sum(v * v for v in values) ** 0.5)
    return float("nan")


def _mirror(answer: Answer) -> bool:
    return _says(answer, frames.MIRROR) and (_refused(answer) or _calibrated(answer, 5.0, 1.0) or _turned_com(answer))


def _turned_com(answer: Answer) -> bool:
    """The mass, and the centre of mass in the mirrored axes."""
    given = answer["json"] or {}
    if not given.get("accepted"):
        return False
    com = [abs(c) for c in given["tool"]["com"]]
    return bool(
        abs(given["tool"]["mass"] - TRUE_MASS) < 5e-3 and abs(com[2] - 0.061) < 1e-3 and given["tool"]["com"][2] > 0
    )


def _raw_rows(answer: Answer) -> bool:
    claims = [line for line in lines_said(answer) if re.search(r"drift|tilt", line)]
    terms = (answer["json"] or {}).get("recommended")
    return _calibrated(answer, 1.3, 0.05) and not claims and terms in {"robust", "joint", "report"}


def _payload_from_12(answer: Answer) -> bool:
    kilograms = _value(answer, "payload", "kg")
    said = str([f.get("says") for f in findings(answer)] + [p.get("what") for p in premises(answer)])
    return _only(answer, "payload") and abs(kilograms - 0.15) < 0.02 and bool(re.search(r"\b1[12](?:\.\d+)? ?s", said))


def _mount45(answer: Answer) -> bool:
    angle = _says(answer, r"\b4[45](?:\.\d+)? ?(?:deg|°)|0\.78")
    return angle and _says(answer, r"mount|turned") and not _says(answer, "more poses")


def _mount45_moving(answer: Answer) -> bool:
    return _found(answer) == ["sensor_mounting"] and abs(_value(answer, "sensor_mounting", "rad") - 0.785) < 0.02


UNIT = r"\bunits?\b|per ?mille|rated"
JOINED = r"resampl|interpolat|two clocks|join|rows of (?:their|its) own"
HELD = r"staircase|held|hold|repeat"
ZEROED = r"velocit"

GIVEN: dict[str, Given] = {
    "left_handed_wrench": Given("calibrate", _mirror),
    "kgf_tool_named": Given("calibrate", lambda a: _says(a, r"kgf|kilogram")),
    "mount45_static": Given("calibrate", _mount45),
    "quat_wxyz_static": Given(
        "calibrate", lambda a: _says(a, frames.QUAT_ORDER) and (_refused(a) or _calibrated(a, 5.0, 1.0))
    ),
    "raw_rows_no_time": Given("calibrate", _raw_rows),
    "clock_back": Given("diagnose", lambda a: _agrees(a) and _says(a, r"clock|time|back")),
    "mount45_moving": Given("diagnose", _mount45_moving),
    "wrench_in_base_moving": Given("diagnose", lambda a: _spoke_or_alone(a, frames.BASE_AXES)),
    "permille_effort": Given("diagnose", lambda a: _spoke_or_alone(a, UNIT, "friction")),
    "sign_magnitude_effort": Given("diagnose", lambda a: _spoke_or_alone(a, UNSIGNED, "friction")),
    "velocity_zero_effort": Given("diagnose", lambda a: _found(a) == ["friction"] and _says(a, ZEROED)),
    "urdf_without_masses": Given("diagnose", lambda a: _spoke_or_alone(a, r"mass|inertial", "friction")),
    "ndi_missing_value": Given("diagnose", lambda a: _agrees(a) and _says(a, r"lost|missing|not measured|NDI|e28")),
    "outer_join": Given("diagnose", lambda a: _spoke_or_alone(a, JOINED)),
    "pick_moving": Given("diagnose", _payload_from_12),
    "hold_joints": Given("diagnose", lambda a: _only(a, "time_delay") and (bool(_found(a)) or _says(a, HELD))),
}


def judged(folder: Path, workers: int) -> list[tuple[str, bool, str]]:
    """Ask every recording that is there: its name, whether the answer is right, and the answer in a few words."""
    present = [name for name in GIVEN if (folder / name / "recording.csv").exists()]
    with ThreadPoolExecutor(workers) as pool:
        answers = list(pool.map(lambda name: ask(GIVEN[name].command, folder / name), present))
    return [
        (name, GIVEN[name].right(answer) and not failed(answer), short(answer))
        for name, answer in zip(present, answers, strict=True)
    ]
