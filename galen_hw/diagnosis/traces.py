"""What a report shows beside the answer: traces, curves and the table of evidence. Numbers only, no pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from galen_hw.spatial import Array


@dataclass(frozen=True)
class Curve:
    """One effect's own picture.

    Args:
        effect: key; title: of the picture, with joint or channel.
        x_label, y_label: with units.
        x, y: (M,) what the data show once all other effects are taken off.
        fit: (M,) what the effect says at the same rows.
        loop: the rows belong together in order (hysteresis, drift), else they are sorted along x (friction).
    """

    effect: str
    title: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    fit: Array
    loop: bool = False


@dataclass(frozen=True)
class Evidence:
    """One hypothesis that was asked.

    Args:
        effect: key; where: channel or joint.
        score: likelihood gain less its price, in units of log-likelihood times two.
        chance: probability that noise alone reaches the gain.
        heldout_gain: share of the held-out excess that it removes beside the others; NaN where it was not tried.
        outcome: "kept", "refused", or "not needed"; reason: in words.
    """

    effect: str
    where: str
    score: float
    chance: float
    heldout_gain: float
    outcome: str
    reason: str = ""


@dataclass(frozen=True)
class Traces:
    """The residual before and after, on the rows of the diagnosis.

    Args:
        time: (M,) s, or the row number without a clock.
        clock: `time` is seconds.
        channels, units: C names and units.
        before, after: (M, C) recorded less simulated, without and with the effects found.
        held_out: (M,) rows that the effects were not fitted on.
        maps: pictures of where the excess sits: (label of x, x (M,)), coloured by the residual before.
    """

    time: Array
    clock: bool
    channels: tuple[str, ...]
    units: tuple[str, ...]
    before: Array
    after: Array
    held_out: NDArray[np.bool_]
    maps: Sequence[tuple[str, Array]] = ()
    curves: Sequence[Curve] = ()
    evidence: Sequence[Evidence] = field(default_factory=tuple)
