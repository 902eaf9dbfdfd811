"""From answers and unsealed truth to: was the cause named, and was anything said with confidence that is not so."""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from galen_hw.tools.blind_proof.mistakes.kinds import KINDS
from galen_hw.tools.blind_proof.mistakes.origins import REAL

Answer = dict[str, Any]

MASS = (0.015, 0.002)
"""How far an accepted mass may be from the truth: this share of it, and kg."""
COM = (0.02, 0.002)
"""How far an accepted centre of mass may be off: this share of its distance, and m."""
ANGLE = (0.05, 0.03)
"""The same of an angle that a finding gives: share and rad."""
PAYLOAD = (0.15, 0.01)
"""The same of a payload: share and kg."""
FRICTION = 3.0
"""So many times the true dry friction, or a part of it, is another number."""
NUMBERS = {"sensor_mounting": ANGLE, "base_tilt": ANGLE, "payload": PAYLOAD}
ALIKE = ({"lag", "time_delay"},)
"""Effects that the proof does not hold against the tool where the other one is there."""
STANDING = re.compile(r"would have been seen|wanders so slowly passes for noise|not said where the sensor was zeroed")
"""Remarks on what a recording can show at all: they are no answer to what is wrong with it."""


@dataclass
class Scored:
    """One case, judged.

    Args:
        truth: as unsealed; asked, control: the answers with the mistake and without.
        named: the cause was named (or the answer is right and nothing was spoiled).
        wrong: what was said with confidence and is not so; beside: the part of it that is said without the mistake too.
        spoken: what a premise repaired or refused in the recording without a mistake.
        short: the answer in a few words.
    """

    truth: dict[str, Any]
    asked: Answer
    control: Answer
    named: bool = False
    wrong: list[str] = field(default_factory=list)
    beside: list[str] = field(default_factory=list)
    spoken: list[str] = field(default_factory=list)
    short: str = ""

    @property
    def warned(self) -> bool:
        """A warning of Python or numpy reached the screen."""
        return bool(re.search(r"\w*Warning: ", self.asked["err"]))

    @property
    def right(self) -> bool:
        """Named, and nothing wrong beside it."""
        return self.named and not self.wrong


def score(truth: dict[str, Any], both: dict[str, Answer]) -> Scored:
    """Judge one case."""
    out = Scored(truth, both["asked"], both["control"])
    kind = KINDS[truth["kind"]]
    standing = set(map(_bare, lines_said(out.control)))
    said = [line for line in lines_said(out.asked) if _bare(line) not in standing]
    found = [f["effect"] for f in findings(out.asked)]
    spelled = any(kind.names(line) for line in [*said, " ".join(said)]) or bool(kind.effects & set(found))
    repaired = any(p.get("action") == "repaired" for p in premises(out.asked))
    out.wrong = wrong(truth, out.asked, kind.effects, _known(truth, out.control), named=spelled, repaired=repaired)
    if truth["command"] == "deflection":
        out.wrong = [] if spelled and not repaired else _worse(out.asked, out.control)
    elif out.control["json"]:
        beside = wrong(truth, out.control, frozenset(), _known(truth, out.control), named=False, repaired=False)
        out.beside = [w for w in out.wrong if w.split(" ")[0] in {b.split(" ")[0] for b in beside}]
    answered = out.asked["exit"] in {0, 1} and out.asked["json"] is not None
    quiet = kind.silent and answered and not out.wrong and _as_good(truth, out.asked) and _as_sharp(both)
    out.named = (spelled or quiet) and not failed(out.asked)
    out.spoken = spoken(out.control)
    out.short = short(out.asked)
    return out


def _known(truth: dict[str, Any], control: Answer) -> set[str]:
    """Effects that are in the recording without the mistake; of a real one nobody knows all, its own answer stands."""
    known = set(truth["effects"])
    if truth["family"] in REAL:
        known |= {f["effect"] for f in findings(control)}
    for pair in ALIKE:
        if known & pair:
            known |= pair
    return known


def _as_good(truth: dict[str, Any], asked: Answer) -> bool:
    """The answer finds what is there, as it would without the mistake."""
    if truth["command"] == "calibrate":
        return bool(asked["json"].get("accepted"))
    if truth["command"] == "deflection" or truth["family"] in REAL:
        return True
    found = {f["effect"] for f in findings(asked)}
    return bool(found) if truth["effects"] else asked["json"].get("verdict") == "agrees"


BLUNT = 3.0


def _as_sharp(both: dict[str, Answer]) -> bool:
    """No channel is called so many times as noisy as without the mistake: who calls everything noise agrees with all."""
    floors = [((both[what]["json"] or {}).get("fit") or {}).get("noise_floor") or {} for what in ("asked", "control")]
    return all(floors[0].get(c, x) <= BLUNT * x for c, x in floors[1].items())


def wrong(
    truth: dict[str, Any],
    answer: Answer,
    names: frozenset[str],
    known: set[str],
    *,
    named: bool,
    repaired: bool,
) -> list[str]:
    """What an answer says with confidence and is not so, each in a few words."""
    if not answer["json"]:
        return []
    if truth["command"] == "calibrate":
        # Who asks "is it in kgf?" has not said that the number is right; who repaired it has.
        return [] if named and not repaired else _wrong_load(truth, answer["json"], named=named)
    out = []
    for finding in findings(answer):
        stated = {finding["effect"], *(c["effect"] for c in finding.get("confounded_with", []))}
        if finding["effect"] != "unknown" and not stated & (known | names):
            out.append(f"{finding['effect']} is not there")
        elif off := _wrong_number(truth, finding, known):
            out.append(off)
    return out


MISSED = 1.5


def _worse(asked: Answer, control: Answer) -> list[str]:
    """A deflection model that is recommended though it misses so many times as much as without the mistake."""
    told = [a["json"] or {} for a in (asked, control)]
    if any(t.get("recommended") not in t.get("models", {}) for t in told):
        return []
    errors = [max(t["models"][t["recommended"]]["rmse_m"].values(), default=0.0) for t in told]
    return (
        [f"recommended with {1e3 * errors[0]:.3g} mm for {1e3 * errors[1]:.3g}"]
        if errors[0] > MISSED * errors[1]
        else []
    )


def _wrong_load(truth: dict[str, Any], answer: dict[str, Any], *, named: bool) -> list[str]:
    """An accepted mass or centre of mass that is not the truth; in another frame only for those who say so."""
    if not answer.get("accepted") or truth["load"] is None:
        return []
    tool = answer["tool"]
    right = [truth["load"], *(truth["loads"] if named else [])]
    offs = [_off(tool, load) for load in right]
    return [] if None in offs else [offs[0] or ""]


def _off(tool: dict[str, Any], load: dict[str, Any]) -> str | None:
    """How far a tool is off a load, in words; None within the tolerance."""
    mass, com = float(tool["mass"]), np.array(tool["com"], dtype=float)
    true = np.array(load["com"], dtype=float)
    if abs(mass - load["mass"]) > MASS[0] * load["mass"] + MASS[1]:
        return f"mass {1e3 * mass:.1f} g for {1e3 * load['mass']:.1f}"
    if np.abs(com - true).max() > COM[0] * float(np.linalg.norm(true)) + COM[1]:
        return f"com {np.round(1e3 * com, 1).tolist()} mm for {np.round(1e3 * true, 1).tolist()}"
    return None


def _wrong_number(truth: dict[str, Any], finding: dict[str, Any], known: set[str]) -> str | None:
    """A named effect whose number is another one, in words."""
    effect, parameters = finding["effect"], finding.get("parameters", {})
    if effect == "friction" and truth["coulomb"] is not None:
        values = [abs(p["value"]) for n, p in parameters.items() if "coulomb" in n and p.get("unit") == "N m"]
        if values and not 1 / FRICTION < max(values) / truth["coulomb"] < FRICTION:
            return f"friction {max(values):.3g} N m for {truth['coulomb']:.3g}"
    true = truth["numbers"].get(effect)
    if true is None or effect in known:
        return None
    unit = "kg" if effect == "payload" else "rad"
    values = [float(p["value"]) for p in parameters.values() if p.get("unit") == unit]
    size, (share, least) = float(np.linalg.norm(values)), NUMBERS[effect]
    return f"{effect} {size:.3f} {unit} for {true:.3f}" if abs(size - true) > share * true + least else None


def findings(answer: Answer) -> list[dict[str, Any]]:
    """Findings of a diagnosis."""
    return list((answer["json"] or {}).get("findings") or [])


def premises(answer: Answer) -> list[dict[str, Any]]:
    """What the premises say in an answer."""
    return list((answer["json"] or {}).get("premises") or [])


def lines_said(answer: Answer) -> list[str]:
    """What an answer says of the recording itself: its refusal, premises, remarks and notes, a line each."""
    given = answer["json"] or {}
    out = [line for stream in ("err", "out") for line in _remarks(answer[stream])]
    for premise in premises(answer):
        columns = " ".join(map(str, premise.get("columns") or []))
        out.append(" ".join(str(premise.get(k, "")) for k in ("premise", "what", "todo")) + " " + columns)
    for key in ("remarks", "notes", "doubts"):
        out += [str(line) for line in given.get(key) or []]
    return [line for line in out if not STANDING.search(line)]


REMARK = re.compile(r"^ *(?:galen-hw |note |premises? |repaired |refused |! ?)")
"""How a line of the screen begins that speaks of the recording; tables of what was fitted do not."""


def _remarks(text: str) -> list[str]:
    """Lines of a screen that speak of the recording; a warning of a library, with its line of code, does not."""
    text = re.sub(r"^.*Warning: .*\n(?:  .*\n?)?", "", text, flags=re.MULTILINE)
    return [line.strip() for line in text.splitlines() if REMARK.match(line)]


def _bare(line: str) -> str:
    """A line without its numbers: what is said of the recording without a mistake too is no answer to the mistake."""
    return " ".join(re.sub(r"[\d.+\-e]+", "#", line).split())


def failed(answer: Answer) -> bool:
    """No answer at all: a crash, or none in time."""
    return "Traceback" in answer["err"] or answer["exit"] not in {0, 1, 2, 4}


def spoken(answer: Answer) -> list[str]:
    """Premises that repaired or refused something, or the line of a refusal without one."""
    out = [f"{p['premise']} {p['action']}: {p.get('what', '')}" for p in premises(answer) if p.get("action") != "note"]
    if not out and (answer["exit"] not in {0, 1} or answer["json"] is None):
        out = ["refused: " + (answer["err"].strip().splitlines() or ["silent"])[-1]]
    return out


def short(answer: Answer) -> str:
    """The answer in a few words."""
    given = answer["json"]
    if failed(answer) or given is None:
        return f"exit {answer['exit']}: {(answer['err'].strip().splitlines() or ['silent'])[-1][:240]}"
    spoke = "; ".join(f"{p.get('premise')} {p.get('action')}: {p.get('what', '')}"[:160] for p in premises(answer))
    if "verdict" in given:
        found = "+".join(f["effect"] for f in findings(answer)) or "no finding"
        return f"{given['verdict']}, {found}" + (f"; {spoke}" if spoke else "")
    if "models" in given:
        return f"recommends {given.get('recommended')}: {given.get('reason', '')[:120]}" + (
            f"; {spoke}" if spoke else ""
        )
    tool = given.get("tool") or {}
    taken = "accepted" if given.get("accepted") else "not accepted"
    return f"{taken}, {1e3 * float(tool.get('mass') or 0):.1f} g" + (f"; {spoke}" if spoke else "")
