"""Findings from a fitted model: one per kind of effect, with all its channels, joints and parameters."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.special import erfc

from galen_hw.diagnosis.detection import outliers
from galen_hw.diagnosis.estimation.candidate import Hypothesis
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.line_frequency import mean_frequency
from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.findings.quantities import SIGNAL, headline
from galen_hw.diagnosis.findings.wording import believing, saying
from galen_hw.diagnosis.lack_of_fit.basis_functions import Inputs
from galen_hw.diagnosis.lack_of_fit.structure_test import FALSE_ALARM, Structure
from galen_hw.diagnosis.preprocessing.checks import Screening
from galen_hw.diagnosis.result import UNKNOWN, Finding, Value
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA
from galen_hw.diagnosis.validation.judgement import ELSEWHERE, Judged
from galen_hw.diagnosis.validation.verdict import COMES_AND_GOES, FEW_SAMPLES, NOTHING_ELSEWHERE
from galen_hw.physics.channels import joint_of
from galen_hw.physics.effects.events import Glitches
from galen_hw.physics.scenes.base import Scene


def findings_of(model: Model, selection: Selection, judged: Judged, glitch: list[Glitches]) -> list[Finding]:
    """Return all findings, sorted by the product of score and share of the held-out error."""
    by_key: dict[str, list[Hypothesis]] = {}
    for h in model.effects:
        assert h.effect is not None, "effects, not nuisances"
        by_key.setdefault(h.effect.KEY, []).append(h)
    out = [_finding(model, selection, judged, key, parts) for key, parts in by_key.items()]
    out.sort(key=lambda f: -f.evidence["score"] * max(f.evidence["heldout_gain"], 0.0))
    isolated = [_glitch(model, judged, g) for g in glitch]
    return out + [one for one in isolated if one.evidence["false_alarm_probability"] < CRITERIA.chance]


def _finding(model: Model, selection: Selection, judged: Judged, key: str, parts: list[Hypothesis]) -> Finding:
    bench = model.bench
    signal = np.zeros((len(bench.rows), bench.width))
    variance = np.zeros(bench.width)
    parameters: dict[str, Value] = {}
    free = model.free_constants
    prefixes = _prefixes(parts)
    for n, h in enumerate(parts):
        s = model.slice_of(h)
        line = h.line(bench.scene)
        # Averages over neighbouring rows have less of a quick oscillation than was recorded.
        passed = 1.0 if line is None else bench.aliases.passed(line.frequency)
        signal[:, list(h.raw.channels)] += h.contribution(model.final[s]) / passed
        variance[list(h.raw.channels)] += model.signal_of(h)[1] / passed**2
        parameters |= _parameters(model, h, s, prefix=prefixes[n], number=n)
    power = np.mean((signal - free * signal.mean(axis=0)) ** 2, axis=0)
    energy = power / bench.noise.sigma**2
    channels = [bench.scene.channels[c] for c in np.argsort(-energy) if energy[c] > 0.02 * energy.max()]
    strongest = int(np.argmax(energy))
    parameters[SIGNAL] = Value(
        float(np.sqrt(power[strongest])), float(np.sqrt(variance[strongest])), bench.scene.units[strongest]
    )
    joints = list(dict.fromkeys(j for h in parts if h.effect is not None for j in h.effect.joints))
    score, surprise = _evidence(model, selection, parts)
    gain = judged.gain(key)
    chance = float(min(1.0, CRITERIA.chance * np.exp(np.clip(selection.needed - surprise, -650.0, 6.0))))
    evidence = {"heldout_gain": gain, "score": score, "false_alarm_probability": chance}
    finding = Finding(key, channels, joints, "", parameters, evidence)
    remarks = dict.fromkeys(h.effect.remark for h in parts if h.effect is not None and h.effect.remark)
    if key in judged.cross_validated:
        remarks["The other recording hardly rouses it; that was told by blocks left out of this one."] = None
    finding.says = " ".join([says(finding), *remarks])
    return finding


def says(finding: Finding) -> str:
    """Return a finding in words: what physics, how much of it, and why it is believed."""
    key = finding.effect
    names = finding.joints or finding.channels
    place = ", ".join(names) if len(names) < 4 else f"{', '.join(names[:3])} and {len(names) - 3} more"
    what, why = saying(key), believing(key)
    first = f"{what[0].upper()}{what[1:]} ({place}): {headline(finding)}."
    return f"{first} {why[0].upper()}{why[1:]}; on data it did not learn from it {finding.takes}."


def _prefixes(parts: Sequence[Hypothesis]) -> list[str]:
    """Return what stands before the parameters of each part: its place, with a number from the second at one place on."""
    if len(parts) < 2:
        return ["" for _ in parts]
    met, out = Counter[str](), list[str]()
    for h in parts:
        place = _place(h)
        met[place] += 1
        out.append("" if not place else f"{place}: " if met[place] == 1 else f"{place} {met[place]}: ")
    return out


def _place(h: Hypothesis) -> str:
    place = getattr(h.effect, "channel", "") or getattr(h.effect, "joint", "")
    return f"{place} {h.effect.side}" if h.effect is not None and h.effect.side else str(place)


def _parameters(model: Model, h: Hypothesis, s: slice, prefix: str, number: int) -> dict[str, Value]:
    bench, effect = model.bench, h.effect
    assert effect is not None, "effects, not nuisances"
    variance = model.variance[s]
    values = effect.searched()
    searched = {name: model.parameter_errors.searched[model.effects.index(h), name] for name in values}
    line = effect.line(bench.scene)
    if line is not None:
        values["frequency"], wandering = mean_frequency(model, h, line)
        searched["frequency"] = float(np.hypot(searched["frequency"], wandering))
    named = zip(effect.parameters(bench.scene), model.final[s], np.sqrt(variance), strict=True)
    joints = effect.joints or tuple(joint_of(bench.scene.channels[c]) for c in h.raw.channels)
    mark = prefix or (f"{number + 1}: " if number else "")
    out = {f"{mark}{p.name}": Value(float(v), float(d), _unit(bench.scene, joints, p.unit)) for p, v, d in named}
    for name, value in values.items():
        unit = _unit(bench.scene, joints, effect.searched_unit(name))
        out[f"{mark}{name}"] = Value(value, searched[name], unit)
    if effect.jump is not None:
        out[f"{mark}moment"] = Value(float(effect.jump), 0.0, "s")
    if effect.clips:
        unit = bench.scene.units[h.raw.channels[0]]
        out[f"{mark}limit"] = Value(float(effect.clips[1]), 0.0, unit)
    return out


def _unit(scene: Scene, joints: tuple[str, ...], unit: str) -> str:
    """Return the joint's own unit of "rad or m" and its like, inside a compound unit too."""
    if " or " not in unit or not joints or joints[0] not in scene.joint_names:
        return unit
    slides = scene.joint_units(joints[0])[0] == "m"
    inner = re.sub(r"\((\S+) or (\S+)\)", r"\2" if slides else r"\1", unit)
    first, either, second = inner.partition(" or ")
    return second if slides and either else first


def _evidence(model: Model, selection: Selection, parts: list[Hypothesis]) -> tuple[float, float]:
    """Return score and surprise of a finding: of its parts together, or the z of a constant."""
    score, surprise = 0.0, 0.0
    for i, h in zip(selection.chosen, selection.hypotheses, strict=True):
        if any(h.effect is p.effect for p in parts) and i in selection.evidence:
            score += selection.evidence[i].rank
            surprise = max(surprise, selection.evidence[i].surprise)
    if score == 0.0:
        for h in parts:
            s = model.slice_of(h)
            gain = float(np.sum(model.final[s] ** 2 / np.maximum(np.diag(model.covariance)[s], 1e-300)))
            score += gain
            surprise = max(surprise, 0.5 * gain)
    return float(score), float(surprise)


def _glitch(model: Model, judged: Judged, glitch: Glitches) -> Finding:
    """Return the finding of isolated samples; its share is of the whole excess of the recording, theirs included."""
    bench, rows = model.bench, np.asarray(glitch.rows)
    places = [bench.scene.channels.index(name) for name in glitch.channels]
    residual = outliers.sample_residual(model)
    away, z = (x[rows][:, places] for x in (np.abs(residual), outliers.deviations(bench, residual)))
    # In the channel with most of the largest deviations: newtons and newton metres have no common size.
    strongest = np.argmax(z, axis=1)
    first = int(np.bincount(strongest).argmax())
    size = float(np.median(away[strongest == first, first]))
    own = float(np.sum(z**2))
    others = float(np.sum(np.maximum(judged.before / judged.floor - 1.0, 0.0))) * len(bench.scene)
    # Some repeated samples deviate nowhere.
    least = np.min(z, where=z > outliers.FAR, initial=np.max(z))
    chance = float(np.clip(len(bench.scene) * bench.width * erfc(least / np.sqrt(2.0)), 1e-300, 1.0))
    return Finding(
        Glitches.KEY,
        list(glitch.channels),
        [],
        f"{len(rows)} isolated or repeated samples stand far off what is measured around them; they are left out of every fit.",
        {"count": Value(float(len(rows)), 0.0, "1"), "size": Value(size, 0.0, bench.scene.units[places[first]])},
        {"heldout_gain": own / max(own + others, 1e-300), "score": own, "false_alarm_probability": chance},
    )


def unknown_finding(
    bench: Bench, judged: Judged, structures: list[Structure], screening: Screening, *, near: float = 0.9
) -> Finding:
    """Return the finding of what nothing named explains.

    Args:
        near: share of the strongest evidence with which a plainer family of functions is named in its place.
    """
    names = bench.scene.channels
    channels = list(dict.fromkeys([*screening.channels, *(names[one.channel] for one in structures)]))
    if screening.wrong:
        says, share, z = screening.wrong[0], 0.0, 10.0
    else:
        # A simpler family that explains as much is reported instead.
        alike = [one for one in structures if one.channel == structures[0].channel and one.z >= near * structures[0].z]
        best = min(alike, key=lambda one: one.place)
        share, z = best.share, best.z
        where = names[best.channel] + (f" of {ELSEWHERE}" if best.elsewhere else "")
        if best.basis.shape[1]:
            follows = dependence(best.kind, Inputs.of(bench.scene, bench.rows).names)
            says = (
                f"Structure is left in {where} that no named effect explains: {follows}, "
                f"which makes up {100 * share:.3g} % of what is left and holds on blocks that it was not fitted on."
            )
        elif best.kind == FEW_SAMPLES:
            says = (
                f"Few samples hold {100 * share:.0f} % of the mean square of {where}, which is {z:.0f} times a usual sample's: "
                "knocks, or a fault of the sensor, too short or too many to be told."
            )
        elif best.kind == COMES_AND_GOES:
            says = (
                f"The error in {where} comes and goes, {z**0.5:.2g} times as large at one time as at another, while nothing is "
                "commanded: a push, play or a cable from outside, or a sensor whose noise changes."
            )
        elif best.kind == NOTHING_ELSEWHERE:
            says = (
                f"In the recording itself the error in {where} is {z**0.5:.2g} times the noise, and nothing that holds in "
                f"{ELSEWHERE} too explains what is left."
            )
        else:
            says = (
                f"On held-out data the error in {where} is {z**0.5:.2g} times the noise, and nothing that was recorded "
                "explains what is left."
            )
    gain = judged.unnamed_gain()
    if gain > 0.0:
        says += f" Generic functions of the inputs, without a name, take {100 * gain:.3g} % of the held-out unexplained error"
        says += "; they are not saved."
    parameters = {"share_left": Value(float(share), 0.0, "1")}
    for c in np.flatnonzero(judged.reached != judged.after):
        # Held-out error of the named findings: a saved model reaches this, not `rmse_after`.
        parameters[f"rmse_named_{names[c]}"] = Value(float(np.sqrt(judged.after[c])), 0.0, bench.scene.units[c])
    evidence = {"heldout_gain": gain, "score": float(z), "false_alarm_probability": FALSE_ALARM}
    return Finding(UNKNOWN, channels, [], says, parameters, evidence)


def dependence(kind: str, names: Sequence[str]) -> str:
    """Return what generic functions depend on, in words; inputs by their names, see `basis_functions.Inputs`."""
    number = re.fullmatch(r"periodic in input (\d+)", kind)
    if number:
        return f"it repeats along {names[int(number[1]) - 1]}"
    return "it follows " + re.sub(r"input (\d+)", lambda found: names[int(found[1]) - 1], kind)
