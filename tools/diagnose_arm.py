"""The give that a diagnosis found in the arm, as a model that the deflection service loads."""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.elastic_terms import Term, Weight
from galen_hw.physics.effects.compliance import Compliance, Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.services.deflection.store import DeflectionFile
from galen_hw.version import VERSION

if TYPE_CHECKING:
    from galen_hw.diagnosis.work import Work
    from galen_hw.physics.observations import Belief
    from galen_hw.recording import Recording

Gives = dict[Term, float]


def deflection_file(work: "Work", recording: "Recording") -> tuple[DeflectionFile | None, list[str]]:
    """The found give with what the baseline held, and one line for each effect that the service has no term for.

    None where nothing found is a give of the arm.
    """
    belief = work.bench.scene.belief
    named = {finding.effect for finding in work.diagnosis.findings}
    found = [term for term in work.diagnosis.terms if term["effect"] in named]
    gives, left = gives_of(found)
    if not gives or belief.robot is None:
        return None, left
    for joint, compliance in belief.compliance.items():
        _add(gives, Term("compliance", joint, Compliance("joint", joint)), compliance)
    tool = "" if recording.info.tool is None else recording.info.tool.name
    fit = {k: np.array(list(v.values())) for k, v in work.diagnosis.fit.items()}
    missed = np.sqrt(np.maximum(fit["rmse_after"] ** 2 - fit["noise_floor"] ** 2, (0.05 * fit["noise_floor"]) ** 2))
    arm = ElasticArm(
        terms=tuple(gives),
        values=np.array(list(gives.values())),
        # What is not known of the parameters is in the held-out error already.
        covariance=np.zeros((len(gives), len(gives))),
        weight=weight_of(belief),
        floor=missed,
        noise=fit["noise_floor"],
    )
    file = DeflectionFile(
        name=re.sub(r"[^a-z0-9_-]", "-", (tool or "arm").lower()),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        software=VERSION,
        robot=belief.robot.name,
        virtual=recording.info.virtual,
        tool=tool,
        tip=tuple(belief.tip.tolist()),
        model=ElasticArm.NAME,
        values=arm.to_json(),
        std=fit["rmse_after"].tolist(),
        data=[work.diagnosis.recording],
        reason=f"found by a diagnosis: {', '.join(dict.fromkeys(t['effect'] for t in found))}",
    )
    return file, left


def gives_of(found: Sequence[Mapping[str, Any]]) -> tuple[Gives, list[str]]:
    """Springs, hardening and creep of joints, structure and tool; what is none of these is named."""
    gives: Gives = {}
    left: dict[str, str] = {}
    for term in found:
        key, p = term["effect"], term["parameters"]
        joint, form = str(p.get("joint", "")), p.get("form", "joint")
        if key == "compliance" and form == "joint" and p.get("source", "all") == "all":
            _add(gives, Term(key, joint, Compliance("joint", joint)), p["compliance"])
        elif key == "compliance" and form in ("structure", "tool"):
            for axis in "xyz":
                port = f"{form}.{axis}"
                _add(gives, Term(key, port, Compliance("joint", port)), p[f"compliance_{axis}"])
        elif key == "hardening":
            power = int(p["power"])
            _add(gives, Term(key, joint, Hardening(joint, power)), p["coefficient"])
        elif key == "creep" and joint:
            # More to come after the load is a spring that is less at first.
            _add(gives, Term(key, joint, Creep(float(p["constant"]), joint=joint, form="less")), p["compliance"])
            if form == "more":
                _add(gives, Term("compliance", joint, Compliance("joint", joint)), p["compliance"])
        else:
            left[key] = f"{key} is left out, the deflection service has no term for it"
    return gives, list(left.values())


def _add(gives: Gives, term: Term, value: float) -> None:
    gives[term] = gives.get(term, 0.0) + float(value)


def weight_of(belief: "Belief") -> Weight:
    """Tool and bias body beyond the sensor."""
    bodies = [belief.tool, *([belief.bias_body] if belief.bias_body is not None else [])]
    x, y, z = sum((b.mass * np.asarray(b.com) for b in bodies), np.zeros(3)).tolist()
    return Weight(float(sum(b.mass for b in bodies)), (x, y, z))
