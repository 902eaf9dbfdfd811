"""Re-estimation of the moments of jumps given the present model."""

from galen_hw.diagnosis.detection import steps
from galen_hw.diagnosis.estimation.interactions import update_stream
from galen_hw.diagnosis.estimation.least_squares import residuals
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.settings import LIMITS


def steps_relocated(out: Selection) -> bool:
    """Return whether a jump was moved to a better moment, before a contact between both moments makes up for it."""
    bench, scorer = out.bench, out.scorer
    moved = False
    for place, i in enumerate(out.chosen):
        step = scorer.library[i].effect
        if not steps.is_seen_by_itself(step):
            continue
        update_stream(bench, scorer, out.chosen)
        others = [j for j in out.chosen if j != i]
        theta, at, misfit = scorer.solve(out.chosen)
        h = scorer.library[i]
        residual, _ = residuals(bench, scorer, out.chosen)
        residual[:, list(h.raw.channels)] += h.raw.values @ theta[scorer.mask_of(at, i)]
        best = steps.relocated(bench.scene, residual, step, bench.noise)
        if best.effect == step:
            continue
        scorer.append([bench.hypothesis(best.effect, best.trials)])
        j = len(scorer.library) - 1
        if scorer.solve([*others, j])[2] < misfit - LIMITS.tie:
            out.chosen[place], moved = j, True
    return moved


def steps_split(out: Selection) -> None:
    """Split jumps that were proposed together, so that each can be moved and dropped alone."""
    bench, scorer = out.bench, out.scorer
    chosen: list[int] = []
    for i in out.chosen:
        effect = scorer.library[i].effect
        single = () if effect is None else effect.single
        chosen += range(len(scorer.library), len(scorer.library) + len(single)) if single else [i]
        if single:
            scorer.append([bench.hypothesis(one, steps.places_of(len(bench.rows))) for one in single])
    out.chosen[:] = chosen
