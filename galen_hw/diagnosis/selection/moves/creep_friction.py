"""What a joint does behind the friction of its bearing: the load that it feels is what the friction lets through."""

from typing import Final

import numpy as np
from scipy.optimize import minimize

from galen_hw.diagnosis.estimation.candidate import Hypothesis, told
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.selection.acceptance import left_out, no_worse, plausible
from galen_hw.diagnosis.selection.search_state import Selection
from galen_hw.diagnosis.stats.significance import LOG_ODDS
from galen_hw.physics.effects.compliance import Compliance
from galen_hw.physics.effects.hysteresis import Creep, Hysteresis
from galen_hw.spatial import Array

FRICTIONS: Final = np.geomspace(0.02, 0.95, 7)
"""Shares of half of what the load does that are tried before the best one is sought."""
QUICKER: Final = (1.0, 0.6)
"""Shares of the constant that are tried with each: what waits for the friction seems to take longer."""
TOLERANCE: Final = 3e-3
"""To which share friction and constant are sought from there, in so many points, by steps that begin with these logarithms."""
MOST: Final = 60
SIMPLEX: Final = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, -0.2]])


def behind_friction(out: Selection) -> bool:
    """Return whether a joint's creep beside its friction was better told as one behind the other, of the same friction.

    Apart, each is told wrong: friction with the widths that creep makes of it, and what both miss as a give or a jump.
    """
    scorer = out.scorer
    for i in out.chosen:
        creep = scorer.library[i].effect
        if not isinstance(creep, Creep) or not creep.joint or creep.friction is not None:
            continue
        for j in out.chosen:
            loop = scorer.library[j].effect
            if not isinstance(loop, Hysteresis) or not loop.rubs_in(creep.joint):
                continue
            tried = frozenset((told(scorer.library[k].effect), k in (i, j)) for k in out.chosen)
            if tried in out.regrouped:
                continue
            out.regrouped.add(tried)
            if _taken(out, (i, j), (creep, loop)):
                return True
    return False


def _taken(out: Selection, pair: tuple[int, int], apart: tuple[Creep, Hysteresis]) -> bool:
    """Return whether the pair with one friction was better, and stands in the place of the two that were apart.

    A give of the joint that only made up for a creep told from the wrong end goes with them.
    """
    bench, scorer = out.bench, out.scorer
    creep, loop = apart
    plain = (creep, creep.otherwise())
    others = [k for k in out.chosen if k not in pair]
    giving = [k for k in others if not _gives(scorer, k, creep.joint)]
    rows = float(np.log(bench.noise.effective))

    def made(at: Array) -> list[Hypothesis]:
        """Creep from either end, and the friction, at the logarithms of friction and constant."""
        friction, constant = np.exp(at).tolist()
        creeps = [one.with_searched({"friction": friction, "constant": constant}) for one in plain]
        return [bench.add(effect) for effect in (*creeps, loop.stuck_by(friction))]

    def ways(stuck: int) -> list[list[int]]:
        """What comes late or what is missing at first, beside the gives or without them."""
        return [[*kept, stuck - 2 + form, stuck] for kept in (others, giving) for form in (0, 1)]

    def left(at: Array) -> list[float]:
        """Of each way, price included; both have the same friction: it is one number."""
        with scorer.trying(made(at)):
            models = ways(len(scorer.library) - 1)
            return [scorer.solve(m)[2] + (_owed(scorer, m) - 1) * rows for m in models]

    begun = np.array([[np.log(f * loop.scale), np.log(share * creep.constant)] for f in FRICTIONS for share in QUICKER])
    tried = np.array([left(at) for at in begun])
    best, way = np.unravel_index(int(np.argmin(tried)), tried.shape)
    options = {"xatol": TOLERANCE, "fatol": 0.1, "maxfev": MOST, "initial_simplex": begun[best] + SIMPLEX}
    found = minimize(lambda at: left(at)[way], begun[best], method="Nelder-Mead", options=options)
    before = scorer.solve(out.chosen)[2] + rows * _owed(scorer, out.chosen)
    if found.fun + LOG_ODDS >= before:
        return False
    errors = left_out(out, out.chosen)
    scorer.append(made(found.x))
    trial = ways(len(scorer.library) - 1)[int(way)]
    real = all(plausible(bench, scorer, [k for k in trial if k != own], own) for own in trial[-2:])
    if real and no_worse(errors, left_out(out, trial)):
        out.chosen = trial
        return True
    return False


def _owed(scorer: Scorer, model: list[int]) -> int:
    return sum(scorer.library[k].owed() for k in model)


def _gives(scorer: Scorer, k: int, joint: str) -> bool:
    """Return whether it is a give of the joint in proportion to its load."""
    effect = scorer.library[k].effect
    return isinstance(effect, Compliance) and effect.form == "joint" and effect.joint == joint
