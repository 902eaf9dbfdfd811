"""One candidate term of a model: an effect at a place, with its columns plain and whitened."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from galen_hw.diagnosis.noise.spectrum import Noise
from galen_hw.diagnosis.stats.linear_algebra import pinned_at
from galen_hw.diagnosis.stats.sampling import Index, Mask
from galen_hw.lazy import cached_property
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.columns import Columns
from galen_hw.physics.effects.traits import Line
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from galen_hw.diagnosis.estimation.dataset import Bench


@dataclass(eq=False)
class Hypothesis:
    """One effect on the bench.

    Args:
        effect: the piece of physics; None: a nuisance or a generic term.
        raw: averaged columns, unfiltered.
        whitened: the same, whitened channel by channel; None: not yet, or released (see `white`).
        looked: at how many places it was looked for; each of several touches at as many.
        theta: parameters at which `raw` is the slope (nonlinear effects); None: at zero.
        bend: (M, C) what it predicts at theta beyond slope times theta; None where it is linear.
        beside: (M, C) what it adds in a settled model because the others are there too; None: nothing.
        noise: by which it is whitened; None: `whitened` is given.
        unseen: see `aside`; telling: see `lasts`; None: not asked yet.
    """

    effect: Effect | None
    raw: Columns
    whitened: Columns | None
    trials: int = 1
    name: str = ""
    theta: Array | None = None
    nonlinear: Array | None = None
    interaction: Array | None = None
    noise: Noise | None = None
    _unobserved: int | None = None
    _informative_share: float | None = None

    @property
    def count(self) -> int:
        """Number of linear parameters."""
        return self.raw.count

    @property
    def white(self) -> Columns:
        """Its columns, whitened channel by channel."""
        out = self.whitened
        if out is None:
            assert self.noise is not None, "it is given where there is no noise to whiten by"
            out = self.whitened = _whitened(self.noise, self.raw, self.live)
        return out

    def release(self) -> None:
        """Forget the whitened columns, which are computed again where they are asked for: most are never."""
        if self.noise is not None:
            self.whitened = None

    def own(self, channel: int) -> tuple[Index, Array]:
        """Its columns in a channel that are not zero throughout: their numbers, and whitened (M, n)."""
        i = self.raw.channels.index(channel)
        at = np.flatnonzero(self.live[i])
        return at, self.white.values[:, i] if len(at) == self.count else self.white.values[:, i, at]

    def unobserved(self, train: Mask) -> int:
        """How many parameters belong to moments of which no row is learnt from: they gain nothing there, and cost nothing.

        Told once, for it is asked at every turn of a search: the rows `train` (M,) of a bench stay as they are.
        """
        if self._unobserved is None:
            episodic = self.effect is not None and self.effect.EPISODIC
            self._unobserved = sum(not self._seen(j, train) for j in range(self.count)) if episodic else 0
        return self._unobserved

    def _seen(self, column: int, train: Mask) -> bool:
        """Whether a column is other than zero in any row that is learnt from; only channels in which it lives are looked at."""
        return any(bool(self.raw.values[train, i, column].any()) for i in np.flatnonzero(self.live[:, column]))

    @cached_property
    def live(self) -> Mask:
        """(len(channels), k) where a column is not zero throughout."""
        return self.raw.live()

    @cached_property
    def family(self) -> Any:
        """Of its effect; None: a nuisance."""
        return None if self.effect is None else self.effect.family

    def line(self, scene: Scene) -> Line | None:
        """The line of the spectrum that it is, if any."""
        return None if self.effect is None else self.effect.line(scene)

    @property
    def fixed(self) -> Array:
        """(k,) values of its parameters that are not fitted in a model, nan for those that are."""
        held = None if self.effect is None else self.effect.held
        return np.full(self.count, np.nan) if held is None else held

    def effective_parameters(self, count: int | None = None, *, whole: bool = False) -> int:
        """Numbers that it pays for: those that its physics has, searched values included, of `count` columns that show (all).

        `whole`: with all parameters of a loose hypothesis, which stands for physics with fewer and may not be it.
        """
        shown = self.count if count is None else count
        if self.effect is None:
            return shown
        relaxed = self.effect.freedom is not None and not (whole and self.effect.loose)
        return (min(shown, self.effect.freedom or 0) if relaxed else shown) + len(self.effect.searched())

    def informative_share(self, train: Mask) -> float:
        """Share of the rows that are learnt from which tell of its parameters: of touches those while they last, else all.

        Told once, as `aside` is.
        """
        if self._informative_share is None:
            touching = self.effect is not None and bool(self.effect.touches)
            self._informative_share = float(np.mean(self.raw.values[train].any(axis=(1, 2)))) if touching else 1.0
        return self._informative_share

    def penalty(self, bench: "Bench") -> float:
        """Of one of its numbers: the log of how many independent values tell of it (Schwarz 1978).

        Of few no less than two: what it takes of noise alone on average, and as much again (Akaike 1974).
        """
        return max(float(np.log(max(bench.noise.effective * self.informative_share(bench.train), 1.0))), 2.0)

    def log_trials(self, train: Mask) -> float:
        """Log of how many ways it could have been found in: each of several touches, of which rows are learnt from, anywhere."""
        times = 1.0
        if self.effect is not None and self.effect.touches and self.count:
            times = len(self.effect.touches) * (1.0 - self.unobserved(train) / self.count)
        return times * math.log(self.trials)

    def contribution(self, theta: Array) -> Array:
        """(M, len(channels)) its change with parameters theta (k,), what it is bent by included."""
        more = [x[:, list(self.raw.channels)] for x in (self.nonlinear, self.interaction) if x is not None]
        return np.asarray(sum(more, self.raw.values @ theta))

    def pinned_gain(self, scene: Scene, A: Array, r: Array) -> float | None:
        """Fall of the whitened sum of squares at the one value its parameters can have, by inner products; None: free.

        What is fitted instead could be something else: a lag of share two is a delay.
        """
        at = None if self.effect is None else self.effect.pinned(scene)
        if at is None:
            return None
        at = pinned_at(at, A, r)
        return float(2.0 * at @ r - at @ A @ at)


def _whitened(noise: Noise, raw: Columns, live: Mask) -> Columns:
    if live.all():
        return Columns(raw.channels, noise.whitened_each(noise.transformed(raw.values), raw.channels))
    white = np.zeros((*live.shape, len(raw.values))).transpose(2, 0, 1)
    at, k = np.nonzero(live)
    flat = noise.transformed(raw.values[:, at, k])
    white[:, at, k] = noise.whitened_each(flat[:, :, None], tuple(raw.channels[i] for i in at))[:, :, 0]
    return Columns(raw.channels, white)


def with_parameters(parts: Iterable[Hypothesis], theta: Array) -> Iterator[tuple[Hypothesis, Array]]:
    """Give each part of a model with its share of the parameters theta (k,) of all, in their order."""
    done = 0
    for h in parts:
        yield h, theta[done : done + h.count]
        done += h.count


def place_of(effect: Effect | None) -> tuple[str, ...]:
    """Where an effect sits: one hypothesis of a kind a place; those of moments may stand side by side."""
    return () if effect is None else effect.location


def identity_of(effect: Effect | None) -> tuple[object, ...]:
    """What an effect is, and which of its numbers are searched: a bearing with friction is not one without."""
    return () if effect is None else (effect.family, *effect.searched())
