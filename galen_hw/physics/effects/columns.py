"""Regressors of an effect: arrays that live in some of the compared channels."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array


@dataclass(frozen=True, slots=True)
class Columns:
    """Regressors (N, len(channels), k) that live in some channels only."""

    channels: tuple[int, ...]
    values: Array

    @property
    def count(self) -> int:
        """Number of linear parameters."""
        return int(self.values.shape[2])

    def live(self, *, rows: int = 97) -> NDArray[np.bool_]:
        """Return where (len(channels), k) a column is not zero throughout: parameters of each channel leave most empty.

        Args:
            rows: that are looked at before a column is searched for a value: nearly all columns are full.
        """
        out = np.asarray(self.values[:: max(1, len(self.values) // rows)].any(axis=0))
        for i, k in np.argwhere(~out):
            out[i, k] = self.values[:, i, k].any()
        return out

    def full(self, width: int) -> Array:
        """Return the columns (N, width, k) with zeros in the other channels."""
        out = np.zeros((self.values.shape[0], width, self.count))
        out[:, list(self.channels)] = self.values
        return out


def in_channel(channel: int, columns: Iterable[Array]) -> Columns:
    """Return columns (N,) of one channel."""
    return Columns((channel,), _abreast(columns)[:, None, :])


def _abreast(columns: Iterable[Array]) -> Array:
    """Return columns (N,) side by side, (N, n); a single one is not copied, for nobody writes to it."""
    each = list(columns)
    return each[0][:, None] if len(each) == 1 and each[0].flags.c_contiguous else np.stack(each, axis=-1)


def in_each(places: tuple[int, ...], shapes: Array) -> Columns:
    """Return columns (N, c, c n): the same shapes (N, n) in c channels, each with coefficients of its own, channel by channel."""
    count = shapes.shape[1]
    # Column by column in memory: most stay empty, and are never touched.
    values = np.zeros((len(places), count * len(places), len(shapes)))
    for i in range(len(places)):
        values[i, i * count : (i + 1) * count] = shapes.T
    return Columns(places, values.transpose(2, 0, 1))


def in_all(columns: Iterable[Array], width: int) -> Columns:
    """Return columns (N, C) of all channels; those in which all are zero are left out, where any is not."""
    values = np.stack(list(columns), axis=-1)
    live = np.flatnonzero(values.any(axis=(0, 2)))
    if 0 < len(live) < width:
        return Columns(tuple(live.tolist()), values[:, live])
    return Columns(tuple(range(width)), values)


def through(scene: Scene, joint: str, signals: Iterable[Array]) -> Columns:
    """Return columns of what errors (N,) of a joint's position do, in the channels where they show; there must be a port."""
    return Columns(scene.reached(joint), scene.reaching(joint)[:, :, None] * _abreast(signals)[:, None, :])
