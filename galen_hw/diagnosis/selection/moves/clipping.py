"""Re-estimation of saturation limits given the present model."""

import numpy as np

from galen_hw.diagnosis.estimation.interactions import retime, settle_together
from galen_hw.diagnosis.estimation.linearisation import rebase
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.criteria import CRITERIA


def limits_updated(out: Selection) -> None:
    """Re-estimate each saturation limit from the mean of the clipped readings.

    All columns are made again: what the other effects contribute is cut where the readings clip, and none of them fits with the
    columns of another limit. A limit too low would stay, and leave a share of the others' contribution, or a contact, to make up
    for it.
    """
    bench, scorer = out.bench, out.scorer
    measured = bench.whole + bench.simulated
    for i in list(out.chosen):
        effect = scorer.library[i].effect
        if effect is None or not effect.clips or scorer.library[i].trials == 1:
            continue
        name, limit = effect.clips
        c = bench.scene.channels.index(name)
        beyond = bench.train & (bench.rows.average(effect.at_limit(bench.stream).astype(float)) > 0.5)
        mean = float(measured[beyond, c].mean()) if beyond.any() else limit
        off, level = abs(mean - limit) * np.sqrt(beyond.sum()) / bench.noise.sigma[c], effect.levelled(mean)
        if off < CRITERIA.standard_errors() or any(h.effect == level for h in scorer.library):
            continue
        before, cost = list(out.chosen), scorer.solve(out.chosen)[2]
        scorer.append([bench.hypothesis(level, scorer.library[i].trials)])
        out.chosen = [len(scorer.library) - 1 if k == i else k for k in before]
        _told_anew(out)
        if scorer.solve(out.chosen)[2] > cost:
            out.chosen = before
            _told_anew(out)


def _told_anew(out: Selection) -> None:
    bench, scorer = out.bench, out.scorer
    rebase(scorer, out.chosen)
    settle_together(bench, scorer, out.chosen)
    retime(bench, scorer, out.chosen)
