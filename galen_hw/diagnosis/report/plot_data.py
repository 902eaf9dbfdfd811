"""Data of a report besides the answer: traces, curves, maps and tables. Numbers only, no pictures."""

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
        x_label, y_label: names; x_unit, y_unit: SI, "" where there is none.
        x, y: (M,) what the data show once all other effects are taken off.
        fit: (M,) what the effect says at the same rows.
        loop: the rows belong together in order (hysteresis, drift), else they are sorted along x (friction).
    """

    effect: str
    title: str
    x_label: str
    x_unit: str
    y_label: str
    y_unit: str
    x: Array
    y: Array
    fit: Array
    loop: bool = False


@dataclass(frozen=True)
class Evidence:
    """One hypothesis that was asked.

    Args:
        effect: key; where: channel or joint.
        score: penalised gain, in units of twice the log likelihood.
        chance: probability that noise alone reaches the gain.
        heldout_gain: share of the held-out excess that it removes given the others; NaN where it was not tried.
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
class Alike:
    """How well a finding is told from another effect.

    Args:
        found, rival: keys.
        angle: deg between the found signal and what the rival can make of it; nearest: deg, smallest principal angle.
        odds: how much likelier the found one is, as a natural logarithm.
        apart: this recording tells them apart.
    """

    found: str
    rival: str
    angle: float
    nearest: float
    odds: float
    apart: bool


@dataclass(frozen=True)
class Along:
    """The residual of one channel along one variable.

    Args:
        label, unit: of the variable; channel: name; x: (M,).
        share: of the channel's held-out excess that is a function of the variable.
        region: range in which the excess sits, None where there is none.
    """

    label: str
    unit: str
    channel: int
    x: Array
    share: float
    region: tuple[float, float] | None = None


@dataclass(frozen=True)
class Option:
    """A recording that could be made next: minutes until it settles the first open question, and the angle it gives, deg."""

    name: str
    minutes: float
    angle: float


@dataclass(frozen=True)
class Traces:
    """The residual before and after, on the rows of the diagnosis.

    Args:
        time: (M,) s, or the row number without a clock.
        clock: `time` is seconds.
        channels, units: C names and units.
        before, after: (M, C) recorded less simulated, without and with the effects found.
        held_out: (M,) rows that the effects were not fitted on.
        along: the variables that organise the excess best, strongest first.
        plane: two variables of joint space, their values, for the map of the excess; None where fewer moved.
    """

    time: Array
    clock: bool
    channels: tuple[str, ...]
    units: tuple[str, ...]
    before: Array
    after: Array
    held_out: NDArray[np.bool_]
    along: Sequence[Along] = ()
    plane: tuple[tuple[str, str, Array], tuple[str, str, Array]] | None = None
    curves: Sequence[Curve] = ()
    evidence: Sequence[Evidence] = field(default_factory=tuple)
    alike: Sequence[Alike] = ()
    options: Sequence[Option] = ()
