"""Findings that were solved exactly before the search: a sensor turned by any angle, gravity along any direction."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.result import Diagnosis, Finding, Value, Verdict
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.physics.scenes.base import Scene
from galen_hw.premises import Claim, Examination
from galen_hw.spatial import Array, rotation_exp, rotation_log


def mean_square(scene: Scene, channels: Sequence[str]) -> Array:
    """Return the mean squares (C,) of a scene's residual in some channels, without its means if constants are fitted."""
    residual = scene.residual[:, [scene.channels.index(name) for name in channels]]
    residual = residual[np.isfinite(residual).all(axis=1)]
    return np.asarray(np.var(residual, axis=0) if scene.belief.bias_free else np.mean(residual**2, axis=0))


def claim_before(judged: Judged, raw: Scene, channels: Sequence[str], examination: Examination) -> Array:
    """Set the errors before all to those of the recording as it came, and return the errors (C,) after the claims alone.

    Args:
        judged: of the model on what was held out; its shares are then of the whole excess.
        raw: what was held out, unrepaired; the recording itself where nothing else was.
        channels: that are judged: of others in `raw` nothing was measured.
        examination: whose claims these are; without any nothing changes.
    """
    after = judged.before
    if not examination.claims:
        return after
    judged.before = np.maximum(mean_square(raw, channels), after)
    return after


def add_claims(
    diagnosis: Diagnosis,
    examination: Examination,
    judged: Judged,
    after: Array,
    bench: Bench,
    verdict: Callable[[list[Finding]], Verdict],
) -> None:
    """Put the claims of an examination first among the findings and into the saved terms.

    Args:
        diagnosis: is changed.
        judged: with the errors of the unrepaired recording, see `claim_before`.
        after: errors (C,) after the claims alone.
        bench: whose noise says how many rows are independent.
        verdict: of findings.
    """
    diagnosis.holdout, diagnosis.premises = judged.name, [one.to_json() for one in examination.remarks]
    rows = (
        int(np.min(bench.noise.independent(int(bench.judged.sum() or bench.train.sum())))) if examination.claims else 0
    )
    if examination.claims:
        _of_the_whole(diagnosis.findings, judged, after)
    for remark in examination.remarks:
        claim = remark.claim
        if claim is None or remark.repaired is None:
            continue
        same = next((f for f in diagnosis.findings if f.effect == claim.effect), None)
        parameters = {name: Value(*values) for name, values in claim.parameters.items()}
        if same is not None:
            diagnosis.findings.remove(same)
            parameters = combined_parameters(claim, same.parameters)
        score = 0.5 * max(rows, 1) * float(np.sum(np.log(np.maximum(judged.before / after, 1.0))))
        evidence = {
            "heldout_gain": judged.share(judged.before - after),
            "score": score,
            "false_alarm_probability": float(np.exp(-min(score, 650.0))),
        }
        finding = Finding(claim.effect, list(claim.channels), list(claim.joints), "", parameters, evidence)
        what = f"{remark.what[0].upper()}{remark.what[1:]}: {_solved(claim)}"
        finding.says = f"{what}; on data it did not learn from it {finding.takes}."
        diagnosis.findings.insert(0, finding)
        diagnosis.terms[:0] = [dict(term) for term in claim.terms]
        diagnosis.verdict = verdict(diagnosis.findings)


def _solved(claim: Claim) -> str:
    """Return how a claim was solved, in words."""
    if any(name.startswith(("turn_", "tilt_")) for name in claim.parameters):
        return "solved exactly as one rotation, before anything else was fitted"
    return "two fits on either side of that moment against one, before anything else was fitted"


def _of_the_whole(findings: list[Finding], judged: Judged, after: Array) -> None:
    """Scale the shares of the findings beside the claims to the whole excess: they were of what the claims leave."""
    left, whole = (float(np.sum(np.maximum(x - judged.floor, 0.0) / judged.floor)) for x in (after, judged.before))
    for finding in findings:
        before = finding.takes
        finding.evidence["heldout_gain"] *= left / max(whole, 1e-300)
        finding.says = finding.says.replace(before, finding.takes)


def combined_parameters(claim: Claim, more: Mapping[str, Value]) -> dict[str, Value]:
    """Return the parameters of a claim and of what the search found beside it: turns as one rotation, all else as a sum."""
    names = [f"{kind}_{axis}" for kind in ("turn", "tilt") for axis in "xyz" if f"{kind}_{axis}" in claim.parameters]
    first, then = (np.zeros(3), np.zeros(3))
    std = np.zeros(3)
    for name in names:
        at = "xyz".index(name[-1])
        first[at] = claim.parameters[name][0]
        if name in more:
            then[at], std[at] = more[name].value, more[name].std
    whole = rotation_log(rotation_exp(first) @ rotation_exp(then))
    if names and names[0].startswith("tilt"):
        whole = rotation_log(rotation_exp(then) @ rotation_exp(first))
    out = dict(more)
    for name in names:
        at = "xyz".index(name[-1])
        out[name] = Value(float(whole[at]), float(np.hypot(std[at], claim.parameters[name][1])), "rad")
    for name in [name for name in claim.parameters if name not in names]:
        value, deviation, unit = claim.parameters[name]
        other = more.get(name, Value(0.0, 0.0, unit))
        out[name] = Value(value + other.value, float(np.hypot(deviation, other.std)), unit)
    return {**{name: out.pop(name) for name in claim.parameters}, **out}
