"""Interactions of the effects of a model: what one effect changes about the contribution of another."""

from typing import TYPE_CHECKING

import numpy as np

from galen_hw.diagnosis.estimation import signal_chain
from galen_hw.diagnosis.estimation.candidate import with_parameters
from galen_hw.diagnosis.estimation.dataset import Bench
from galen_hw.diagnosis.estimation.linearisation import rebase
from galen_hw.diagnosis.estimation.nonlinear import settle
from galen_hw.diagnosis.estimation.normal_equations import Scorer
from galen_hw.diagnosis.settings import BUDGET
from galen_hw.physics.effects.base import Effect
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.physics.scenes.base import Scene


def retime(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """Pass the columns of all effects through the fitted delays and filters, and fit again; at most twice.

    A delayed play is not a delay plus a play.
    """
    for _ in range(2):
        theta, now = scorer.solve(chosen)[0], list[tuple[Effect, Array]]()
        for h, t in with_parameters(scorer.parts(chosen), theta):
            if h.effect is not None and h.effect.DOWNSTREAM:
                now.append((h.effect, t))
        before = bench.stream
        update_stream(bench, scorer, chosen)
        if _same_timing(bench.timing, now) and _same_clips(now, before, bench.stream):
            return
        stream = bench.stream
        bench.update_state(
            timing=now, stream=stream.carrying(stream.standing, stream.carried, signal_chain.limited(now))
        )
        scorer.retime()
        settle(bench, scorer, chosen, anew=True)


def cost_without(bench: Bench, scorer: Scorer, chosen: list[int], end: Effect) -> float:
    """Return the whitened sum of squares of a model without one part of its output stage, all columns made again.

    Columns that came through a lag contain the lag: given these the lag itself seems to explain little.
    """
    with bench.delivering([(other, theta) for other, theta in bench.timing if other != end]):
        fresh = [scorer.retimed(scorer.library[i]) for i in chosen]
        nonlinear = sum((h.nonlinear for h in fresh if h.nonlinear is not None), np.zeros_like(bench.y))
        with scorer.against(bench.whole - bench.state.interaction - nonlinear), scorer.trying(fresh):
            places = list(range(len(scorer.library) - len(fresh), len(scorer.library)))
            settle(bench, scorer, places, anew=True)
            return scorer.solve(places)[2]


def update_stream(bench: Bench, scorer: Scorer, chosen: list[int]) -> None:
    """Update the simulated stream with the model's contribution: a reading that clips, clips all of it."""
    scene, theta = bench.scene, scorer.solve(chosen)[0]
    standing = np.zeros(bench.width)
    for h, t in with_parameters(scorer.base, theta):
        if len(h.raw.channels) == 1:
            standing[h.raw.channels[0]] = t[0]
    carried = signal_chain.carried(scene, _placed(scorer, chosen, theta), bench.timing)
    bench.update_state(stream=scene.carrying(standing, carried, signal_chain.limited(bench.timing)))


def settle_together(bench: Bench, scorer: Scorer, chosen: list[int], *, met: float = 0.02) -> None:
    """Iterate nonlinear effects and their interactions to a fixed point, which the residual then excludes.

    A model of which one part cancels another (two slow shares of several hundred per cent) diverges: its interactions are then
    left out.

    Args:
        met: change of the interactions, over the noise of one row, below which they have converged.
    """
    last = np.inf
    bench.update_state(diverging=False)
    for _ in range(BUDGET.rounds):
        settle(bench, scorer, chosen)
        placed = _placed(scorer, chosen, scorer.solve(chosen)[0])
        together = signal_chain.interaction_terms(bench.scene, placed, bench.timing)
        now = sum((bench.rows.average(x) for x in together), np.zeros_like(bench.whole))
        moved = float(np.max(np.abs(now - bench.state.interaction) / bench.noise.sigma))
        if moved < met:
            return
        converging = moved < last  # not of what is not finite
        bench.update_state(interaction=now if converging else 0.0, diverging=not converging)
        last = moved
        rebase(scorer, chosen)
        if not converging:
            settle(bench, scorer, chosen)
            return


def _placed(scorer: Scorer, chosen: list[int], theta: Array) -> list[tuple[Effect, Array]]:
    """Return the chosen effects with their slices of the parameters."""
    parts = with_parameters(scorer.parts(chosen), theta)
    return [(h.effect, t) for h, t in parts if h.effect is not None]


def _same_clips(timing: list[tuple[Effect, Array]], old: "Scene", new: "Scene") -> bool:
    """Return whether the readings that clip are the same ones, and come back to the same constants."""
    clips = [effect for effect, _ in timing if effect.clips]
    return all(np.array_equal(c.at_limit(old), c.at_limit(new)) for c in clips)


def _same_timing(old: signal_chain.OutputStage, new: list[tuple[Effect, Array]], *, share: float = 0.1) -> bool:
    """Return whether a stream is as late as it was, by the same effects.

    Args:
        share: by which a delay or lag may move before all other effects' columns are made again.
    """
    return len(old) == len(new) and all(
        a == b and bool(np.max(np.abs(s - t)) <= share * np.max(np.abs(t)))
        for (a, s), (b, t) in zip(old, new, strict=True)
    )
