"""The answer of a diagnosis: findings, verdict, advice and notes of a judged model."""

import numpy as np

from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.findings.from_model import findings_of, unknown_finding
from galen_hw.diagnosis.findings.localisation import channels_of, episodes_of, where_of
from galen_hw.diagnosis.identifiability.experiment import next_experiment
from galen_hw.diagnosis.identifiability.rivals import confusions
from galen_hw.diagnosis.lack_of_fit import structure_test
from galen_hw.diagnosis.preprocessing.checks import Screening
from galen_hw.diagnosis.result import Diagnosis
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.validation.judgement import Judged
from galen_hw.diagnosis.validation.verdict import above_noise, contradicted, outlying, unsteady, verdict_of
from galen_hw.physics.effects.events import Glitches


def answer(
    model: Model,
    selection: Selection,
    judged: Judged,
    structures: list[structure_test.Structure],
    screening: Screening,
    glitch: list[Glitches],
    name: str,
) -> Diagnosis:
    """Return the answer: what was found, what remains unexplained and what to record next."""
    bench = model.bench
    findings = findings_of(model, selection, judged, glitch)
    for finding in findings:
        finding.confounded_with = confusions(model, selection, finding)
    unexplained = structures or above_noise(judged, model, outside_contacts=True) or contradicted(judged, model)
    unexplained = unexplained if unexplained or findings else outlying(model) or unsteady(model)
    if screening.wrong or unexplained:
        findings.append(unknown_finding(bench, judged, unexplained, screening))
    verdict = verdict_of(findings, unexplained, screening)
    advice = next_experiment(model, selection, findings, unexplained)
    notes = list(screening.notes)
    if verdict == "agrees":
        notes.append(_limit(bench))
    notes += _wandering(model) + _ringing(bench)
    if judged.cross_validated:
        told = ", ".join(key.replace("_", " ") for key in sorted(judged.cross_validated))
        notes.append(f"the recording held out hardly rouses {told}: told by blocks left out of the first")
    if bench.scene.heard is not None:
        why = (
            "the recording was filtered"
            if bench.scene.cut
            else "the noise of the joint positions, differentiated, drowns all"
        )
        notes.append(f"compared below {bench.scene.heard:.3g} Hz: above it {why}")
    return Diagnosis(
        recording=name,
        holdout="",
        predict=bench.scene.observations.predict,
        clock=bench.scene.clock,
        verdict=verdict,
        channels=channels_of(bench, judged),
        where=where_of(model) if findings else [],
        when=episodes_of(model, glitch) if findings else [],
        findings=findings,
        fit=judged.fit(bench, structures),
        next_experiment=advice,
        notes=notes,
        terms=[effect.to_term(bench.scene, theta) for effect, theta in model.placed()],
    )


def _limit(bench: Bench) -> str:
    """Return the smallest effect that would have been detected, in words; of a slow one, where the noise is slow."""
    least = bench.detectable
    each = ", ".join(f"{bench.scene.channels[c]} {least[c]:.2g}" for c in np.flatnonzero(~bench.without_data))
    return f"an effect of this rms in one channel would have been seen: {each}"


def _wandering(model: Model) -> list[str]:
    """Return channels with more low-frequency noise than quick noise and no drift, in words."""
    bench = model.bench
    drifting = {name for h in model.effects if h.effect is not None for name in h.effect.wandering}
    told = [
        f"{name} {slow:.2g} {unit}"
        for name, unit, slow, quick in zip(
            bench.scene.channels, bench.scene.units, *bench.noise.slow_and_quick_rms, strict=True
        )
        if slow > quick and name not in drifting
    ]
    return [f"what wanders so slowly passes for noise, rms: {', '.join(told)}"] if told else []


def _ringing(bench: Bench) -> list[str]:
    """Return which channels ring at one frequency without a name: liquid in a tool, a loose part, a stand that swings."""
    frequency, size = bench.noise.ringing
    units = zip(bench.scene.channels, bench.scene.units, frequency / bench.spacing, size, strict=True)
    told = [f"{name} {rms:.2g} {unit} near {hertz:.2g} Hz" for name, unit, hertz, rms in units if rms > 0.0]
    return [f"what rings passes for noise, rms: {', '.join(told)}"] if bench.scene.clock and told else []
