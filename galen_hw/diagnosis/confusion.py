"""What this recording cannot tell apart."""

from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.result import Confusion, Finding
from galen_hw.diagnosis.select import Selection
from galen_hw.diagnosis.words import WHY, why

CLOSE = 7.0
"""Difference of rank (twice a log likelihood) below which two effects count as equal."""


def confusions(model: Model, selection: Selection, finding: Finding) -> list[Confusion]:
    """Other effects that, put in the finding's place, would do as well; and those that are the same by structure."""
    scorer, scene = selection.scorer, model.bench.scene
    chosen = [(i, scorer.library[i].effect) for i in selection.chosen]
    mine = [i for i, effect in chosen if effect is not None and finding.effect == effect.KEY]
    rivals: dict[str, float] = {}
    misfit = scorer.misfit(selection.chosen)
    for i in mine:
        others = [j for j in selection.chosen if j != i]
        scores, _ = scorer.scores(others)
        if i not in scores:
            continue
        # Where physics is missing, differences of a few hundredths are that physics.
        margin = CLOSE + 0.05 * min(1.0, misfit - 1.0) * scores[i].gain
        for j, score in scores.items():
            effect = scorer.library[j].effect
            if effect is None or finding.effect == effect.KEY or score.rank < scores[i].rank - margin:
                continue
            rivals[effect.KEY] = max(rivals.get(effect.KEY, 0.0), score.rank)
    named = sorted(rivals, key=lambda key: -rivals[key])
    if finding.effect == "drift" and not scene.observations.has("temperature."):
        named.append("temperature")
    if finding.effect == "joint_offset" and scene.observations.predict == "position":
        named.append("bias")
    if finding.effect in ("backlash", "hysteresis") and scene.observations.predict == "position":
        named += ["friction", *({"backlash", "hysteresis"} - {finding.effect})]
    named = list(dict.fromkeys(named))
    assert WHY, "reasons by structure"
    return [Confusion(key, why(finding.effect, key)) for key in named[:5]]
