"""Two streams that were not sampled alike: what is compared runs on a clock of its own, or was smoothed by itself."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.sampling import compared_names
from galen_hw.premises.thinning import Rates, thinned
from galen_hw.spatial import Array

ROWS: Final = 4000
"""On which a stream is looked at: of five minutes, thirteen a second."""
ORDERS: Final = (1, 2)
"""Of the filters that people run forth and back: 1 / (1 + (f / cut-off)^2), which means over a window are nearly too, and ^4."""
JUMP_S: Final = 0.1
"""To which the moment of a jump is told."""
QUICKEST: Final = 0.05
"""Of the rate of the rows: quicker, a motion that is differentiated may lack as much."""


@dataclass(frozen=True)
class _Streams:
    """Compared channels that move, over their own variance: (N,) s, and (N, C) measured and simulated."""

    time: Array
    measured: Array
    simulated: Array

    def late(self, basis: Array, *, iterations: int = 4) -> tuple[Array, Array]:
        """Return the delays (N,) s in the span of a basis (N, k) that suit best, and the unexplained shares (C,) beside them.

        Args:
            iterations: of Gauss and Newton; each leaves the square of what the one before has left.
        """
        delay, weight = np.zeros(len(self.time)), np.ones(self.measured.shape[1])
        for _ in range(iterations):
            x = self._at(self.time - delay)
            slope = np.gradient(x, self.time, axis=0)
            columns = _less_mean(-slope[:, :, None] * basis[:, None, :]) * weight[:, None]
            rest = _less_mean(self.measured - x) * weight
            delay = delay + basis @ np.linalg.lstsq(columns.reshape(-1, basis.shape[1]), rest.ravel(), rcond=None)[0]
            # A channel counts by what it can tell.
            weight = 1.0 / np.sqrt(
                np.maximum(np.mean(_less_mean(self.measured - self._at(self.time - delay)) ** 2, axis=0), 1e-12)
            )
        return delay, self.unexplained(self._at(self.time - delay))

    def unexplained(self, simulated: Array) -> Array:
        """Return the share (C,) of the measured variance that a simulation (N, C) leaves, a constant aside."""
        return np.asarray(
            np.mean(_less_mean(self.measured - simulated) ** 2, axis=0)
            / np.mean(_less_mean(self.measured) ** 2, axis=0)
        )

    def _at(self, time: Array) -> Array:
        return np.stack([np.interp(time, self.time, x) for x in self.simulated.T], axis=-1)


class ApartClocks:
    """Tests whether what is compared is late by a time that grows, or that jumps: clocks that run apart, or one that was set."""

    KEY: ClassVar[str] = "apart_clocks"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal where a delay that grows in proportion to time, or jumps once, leaves far less than a constant one."""
        streams = _streams(seen)
        if streams is None:
            return
        level = np.ones((len(streams.time), 1))
        constant = streams.late(level)[1]
        delay, growing = streams.late(np.column_stack([level, np.linspace(-1.0, 1.0, len(level))]))
        if not _far_better(growing, constant):
            yield from self._jump(seen, streams, constant)
            return
        first, last, span = float(delay[0]), float(delay[-1]), float(np.ptp(streams.time))
        what = (
            f"what is compared runs on a clock of its own, {1e2 * abs(last - first) / span:.2g} % apart: "
            f"it is late by {1e3 * first:.3g} ms at first and by {1e3 * last:.3g} ms at the end"
        )
        todo = (
            "stamp both by one clock, or stretch the stamps of one before they are joined (or were rows of one lost?)"
        )
        yield Remark(self.KEY, what, todo, tuple(compared_names(seen)), Action.REFUSED)

    def _jump(self, seen: Observations, streams: _Streams, constant: Array) -> Iterator[Remark]:
        """Yield a refusal where two delays, one before some moment and one from it on, leave far less than one."""
        time, span = streams.time, float(np.ptp(streams.time))
        best: tuple[float, float, Array, Array] | None = None
        width = 1.0 / CRITERIA.pieces
        moments = np.arange(1, CRITERIA.pieces) * width * span
        while width * span > JUMP_S and len(moments):
            for at in moments:
                delay, left = streams.late(np.column_stack([time < at, time >= at]).astype(float), iterations=3)
                if best is None or float(np.mean(left)) < best[0]:
                    best = (float(np.mean(left)), float(at), delay, left)
            assert best is not None, "there are moments"
            if best[0] > CRITERIA.half * float(np.mean(constant)):
                return  # nowhere near
            width /= 4.0
            moments = best[1] + width * span * np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
            moments = moments[(moments > 0.0) & (moments < span)]
        if best is None or not _far_better(best[3], constant):
            return
        _, at, delay, _ = best
        assert seen.time is not None, "asked only with a clock"
        what = (
            f"one of two clocks was set: what is compared is late by {1e3 * delay[0]:.3g} ms before "
            f"{float(seen.time[0]) + at:.4g} s and by {1e3 * delay[-1]:.3g} ms from then on"
        )
        todo = "stamp both by one clock, or move the stamps of one before they are joined"
        yield Remark(self.KEY, what, todo, tuple(compared_names(seen)), Action.REFUSED)


class SmoothedStream:
    """Tests whether what is compared is its simulation without quick motion, yet not late: smoothed forth and back, by itself.

    Nothing physical is smooth without being late.
    """

    KEY: ClassVar[str] = "smoothed_stream"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal where the simulation behind a filter without phase leaves far less than with any delay."""
        streams = _streams(seen)
        if streams is None or streams.measured.shape[1] < 2:
            return  # what one joint does behind a spring is an even function of frequency too
        steps = np.diff(streams.time)
        step = float(np.median(steps))
        if np.max(np.abs(steps - step)) > CRITERIA.half * step:
            return
        constant = streams.late(np.ones((len(streams.time), 1)))[1]
        slowest, quickest = 4.0 / float(np.ptp(streams.time)), QUICKEST / step
        if slowest >= quickest:
            return
        each = [_cut_off(streams, order, step, slowest, quickest) for order in ORDERS]
        cut_off, behind = min(each, key=lambda one: float(np.mean(one[1])))
        if not _far_better(behind, constant):
            return
        what = (
            f"what is compared lacks its quick motion without being late, as behind a low-pass of {cut_off:.2g} Hz that was run "
            "forth and back (or a mean over rows before and after): its simulation was not smoothed"
        )
        todo = "compare it as it was measured, or smooth the joints' positions alike"
        yield Remark(self.KEY, what, todo, tuple(compared_names(seen)), Action.REFUSED)


def late_shares(some: tuple[Observations, Rates]) -> Array | None:
    """Return the shares (C,) of what is compared that its simulation leaves with the best constant delay; None: no stream.

    Args:
        some: thinned rows.
    """
    streams = _of(some)
    return None if streams is None else streams.late(np.ones((len(streams.time), 1)))[1]


def _streams(seen: Observations) -> _Streams | None:
    """Return what is compared and its simulation, of the channels that move; None where there are hardly any rows."""
    return _of(thinned(seen, ROWS)) if seen.time is not None and len(seen.segments) == 1 else None


def _of(some: tuple[Observations, Rates] | None) -> _Streams | None:
    if some is None or some[0].time is None or len(some[0]) < 2 * CRITERIA.most_rows:
        return None
    scene = scene_of(some[0], rates=some[1])
    y, x = scene.measured, scene.simulated
    # The variance of a constant may be rounding.
    live = (np.ptp(y, axis=0) > 0.0) & (np.ptp(x, axis=0) > 0.0)
    if not live.any() or not (np.isfinite(y).all() and np.isfinite(x).all()) or np.any(np.diff(scene.time) <= 0.0):
        return None
    size = np.std(y[:, live], axis=0)
    return _Streams(scene.time - scene.time[0], y[:, live] / size, x[:, live] / size)


def _far_better(one: Array, other: Array) -> bool:
    """Return whether unexplained shares (C,) are far below others wherever the one explains anything, and grow nowhere."""
    told = one < CRITERIA.gross_left
    return bool(
        told.any()
        and np.all(one <= other + CRITERIA.small_turn)
        and np.sum(told) >= CRITERIA.half * len(told)
        and np.mean(one[told]) < CRITERIA.gross_gain * np.mean(other[told])
        and np.all(one[told] < CRITERIA.half * other[told])
    )


def _cut_off(streams: _Streams, order: int, step: float, low: float, high: float) -> tuple[float, Array]:
    """Return the best cut-off, Hz, of a filter of some order, and the unexplained shares (C,) behind it."""

    def behind(log_f: float) -> Array:
        return streams.unexplained(_smoothed(streams.simulated, step, float(np.exp(log_f)), order))

    found = minimize_scalar(
        lambda log_f: float(np.mean(behind(log_f))), bounds=(np.log(low), np.log(high)), method="bounded"
    )
    return float(np.exp(found.x)), behind(found.x)


def _smoothed(x: Array, step: float, cut_off: float, order: int) -> Array:
    """Return signals (N, C) of rows `step` s apart behind a Butterworth filter that is run forth and back."""
    return np.asarray(sosfiltfilt(butter(order, 2.0 * step * cut_off, output="sos"), x, axis=0))


def _less_mean(x: Array) -> Array:
    return np.asarray(x - np.mean(x, axis=0))
