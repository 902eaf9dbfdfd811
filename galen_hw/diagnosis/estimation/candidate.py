"""One hypothesis of a model: an effect at a place, with its columns, raw and whitened."""

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
    """Hold one effect with its columns on the bench.

    Args:
        effect: physical effect; None: a nuisance or a generic term.
        raw: averaged columns.
        whitened: the same, whitened channel by channel; None: not yet, or released (see `white`).
        trials: number of places that were searched for it; each of several contacts counts as many.
        theta: parameters at which `raw` is the slope (nonlinear effects); None: at zero.
        nonlinear: (M, C) nonlinear remainder: its contribution at theta beyond slope times theta; None where it is linear.
        interaction: (M, C) its additional contribution in a converged model given the other effects; None: nothing.
        noise: by which it is whitened; None: `whitened` is given.
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
        """Whitened columns (M, len(channels), k)."""
        out = self.whitened
        if out is None:
            assert self.noise is not None, "it is given where there is no noise to whiten by"
            out = self.whitened = _whitened(self.noise, self.raw, self.live)
        return out

    def release(self) -> None:
        """Release the whitened columns, which are computed again on access: most are never needed again."""
        if self.noise is not None:
            self.whitened = None

    def nonzero_columns(self, channel: int) -> tuple[Index, Array]:
        """Return the numbers (n,) of its nonzero columns in a channel, and these whitened (M, n)."""
        i = self.raw.channels.index(channel)
        at = np.flatnonzero(self.live[i])
        return at, self.white.values[:, i] if len(at) == self.count else self.white.values[:, i, at]

    def unobserved(self, train: Mask) -> int:
        """Return how many of its parameters have no training rows: those of moments in held-out blocks, without gain or penalty.

        The value is cached: the rows `train` (M,) of a bench do not change.
        """
        if self._unobserved is None:
            episodic = self.effect is not None and self.effect.EPISODIC
            self._unobserved = sum(not self._seen(j, train) for j in range(self.count)) if episodic else 0
        return self._unobserved

    def _seen(self, column: int, train: Mask) -> bool:
        """Return whether a column is nonzero in any training row; only its nonzero channels are examined."""
        return any(bool(self.raw.values[train, i, column].any()) for i in np.flatnonzero(self.live[:, column]))

    @cached_property
    def live(self) -> Mask:
        """Mask (len(channels), k) of columns that are not zero throughout."""
        return self.raw.live()

    @cached_property
    def family(self) -> Any:
        """Family of its effect; None: a nuisance."""
        return None if self.effect is None else self.effect.family

    def line(self, scene: Scene) -> Line | None:
        """Return its spectral line, or None."""
        return None if self.effect is None else self.effect.line(scene)

    @property
    def fixed(self) -> Array:
        """Values (k,) of its fixed parameters, NaN for fitted ones."""
        held = None if self.effect is None else self.effect.held
        return np.full(self.count, np.nan) if held is None else held

    def effective_parameters(self, count: int | None = None, *, whole: bool = False) -> int:
        """Return the effective number of parameters that are penalised, searched values included.

        Of `count` columns that are identifiable (all). `whole`: with all parameters of a relaxed hypothesis, which stands for
        physics with fewer parameters and may not be that physics.
        """
        shown = self.count if count is None else count
        if self.effect is None:
            return shown
        relaxed = self.effect.freedom is not None and not (whole and self.effect.loose)
        return (min(shown, self.effect.freedom or 0) if relaxed else shown) + len(self.effect.searched())

    def informative_share(self, train: Mask) -> float:
        """Return the share of training rows that inform its parameters: of contacts those while they last, else all.

        The value is cached, as that of `unobserved`.
        """
        if self._informative_share is None:
            touching = self.effect is not None and bool(self.effect.touches)
            self._informative_share = float(np.mean(self.raw.values[train].any(axis=(1, 2)))) if touching else 1.0
        return self._informative_share

    def penalty(self, bench: "Bench") -> float:
        """Return the BIC penalty of one parameter: the log of the effective sample size, at least the AIC penalty 2.

        Schwarz 1978; Akaike 1974.
        """
        return max(float(np.log(max(bench.noise.effective * self.informative_share(bench.train), 1.0))), 2.0)

    def log_trials(self, train: Mask) -> float:
        """Return the log of the number of trials (look-elsewhere effect); each of several contacts counts by itself."""
        times = 1.0
        if self.effect is not None and self.effect.touches and self.count:
            times = len(self.effect.touches) * (1.0 - self.unobserved(train) / self.count)
        return times * math.log(self.trials)

    def contribution(self, theta: Array) -> Array:
        """Return the predicted contribution (M, len(channels)) at theta (k,), including its nonlinear remainder."""
        more = [x[:, list(self.raw.channels)] for x in (self.nonlinear, self.interaction) if x is not None]
        return np.asarray(sum(more, self.raw.values @ theta))

    def change(self, theta: Array, width: int) -> Array:
        """Return the same in all channels (M, width), zero where it does not act."""
        out = np.zeros((len(self.raw.values), width))
        out[:, list(self.raw.channels)] = self.contribution(theta)
        return out

    def pinned_gain(self, scene: Scene, A: Array, r: Array) -> float | None:
        """Return the gain at the one value its parameters can have, from inner products; None where they are free.

        A fitted value could be something else: a lag with a share of two is a delay.
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
    """Yield each part of a model with its slice of the parameters theta (k,)."""
    done = 0
    for h in parts:
        yield h, theta[done : done + h.count]
        done += h.count


def place_of(effect: Effect | None) -> tuple[str, ...]:
    """Return the location of an effect: of one kind a location holds one hypothesis, except of momentary effects."""
    return () if effect is None else effect.location


def identity_of(effect: Effect | None) -> tuple[object, ...]:
    """Return the effect's family and which of its values are searched: a bearing with friction is not one without."""
    return () if effect is None else (effect.family, *effect.searched())
