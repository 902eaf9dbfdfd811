"""A wrench without its slow part: a high-pass, AC coupling or automatic zeroing took the tool's weight off with the drift."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.wrench_reading import FORCE, TORQUE, comparable
from galen_hw.spatial import Array


class HighPassedWrench:
    """Tests whether a wrench is its simulation behind a high-pass of first order: at every rest the weight decays to nothing."""

    KEY: ClassVar[str] = "high_passed_wrench"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal where the simulation behind a filter leaves far less than the simulation itself."""
        if seen.predict != "wrench" or seen.time is None or len(seen.segments) > 1 or not seen.has_all(*FORCE, *TORQUE):
            return
        some = comparable(seen)
        if some.time is None or len(some) < 2 * CRITERIA.most_rows:
            return
        scene = scene_of(some)
        t, y, x = some.time, scene.measured, scene.simulated
        live = (np.var(y, axis=0) > 0.0) & (np.var(x, axis=0) > 0.0)
        if not live.any():
            return
        t, y, x = t - t[0], y[:, live], x[:, live]
        # Longer than half the recording it is a drift, shorter than some rows a derivative.
        shortest, longest = 10.0 * float(np.median(np.diff(t))), 0.5 * float(t[-1])
        if not 0.0 < shortest < longest:
            return
        found = minimize_scalar(
            lambda log_constant: _unexplained(t, y, x, float(np.exp(log_constant))),
            bounds=(np.log(shortest), np.log(longest)),
            method="bounded",
        )
        # A warm-up of the gauges alone is no filter: what the start of one explains is granted to the simulation as it is.
        plain = _unexplained(t, y, x, float(np.exp(found.x)), passed=False)
        if not found.fun <= min(CRITERIA.gross_left, CRITERIA.gross_gain * plain):
            return  # nor where any of it is not finite
        what = (
            f"the wrench has lost its slow part, as behind a high-pass with a time constant of {np.exp(found.x):.3g} s: "
            "what the tool weighs decays to nothing at every rest"
        )
        todo = "record it without filter, automatic zeroing or AC coupling"
        yield Remark(self.KEY, what, todo, (*FORCE, *TORQUE), Action.REFUSED)


def _unexplained(t: Array, y: Array, x: Array, constant: float, *, passed: bool = True) -> float:
    """Return the share of the variance of y (N, C) that x (N, C) leaves, a constant and the start of a filter aside.

    Args:
        t: (N,) s from 0 on; constant: of the filter, s; passed: whether x goes through the filter.
    """
    if passed:
        keep = constant / (constant + float(np.median(np.diff(t))))
        x = lfilter([keep, -keep], [1.0, -keep], x - x[0], axis=0)
    Q = np.linalg.qr(np.stack([np.ones(len(t)), np.exp(-t / constant)], axis=-1))[0]
    left = y - x
    left = left - Q @ (Q.T @ left)
    return float(np.mean(np.var(left, axis=0) / np.var(y, axis=0)))
