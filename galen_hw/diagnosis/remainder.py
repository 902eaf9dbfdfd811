"""What physics left over, predicted without a name by generic functions of the inputs: the part of `unknown` that can be said.

It shows how far any function of the known inputs and their past would go (the ceiling), and on what. It is never saved for the
live services: a function that nobody can explain does not act on a robot.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from galen_hw.diagnosis.bench import Bench
from galen_hw.diagnosis.final import Model
from galen_hw.diagnosis.generic import Inputs, dictionaries
from galen_hw.diagnosis.rows import Mask, Rows
from galen_hw.physics.scene import Scene
from galen_hw.spatial import Array

RIDGES: Final = np.logspace(-2.0, 4.0, 13)
"""Tried; in units of the noise's square over that of one function's whole contribution."""
FOLDS: Final = 5
MOST_FAMILIES: Final = 3
WORTH: Final = 0.1
"""Share of what is explained by which a family must be better than a plainer one, or another family add."""
LEAST: Final = 1e-3
"""And share of the whole rest."""


@dataclass(frozen=True)
class Remainder:
    """Ridge regressions of what a model left on generic functions, channel by channel.

    Args:
        inputs: of the recording that it was learnt on.
        parts: per channel, names of the families and the coefficient of each of their functions.
        offsets: per channel, the mean of their sum over the rows that it was learnt on.
        gain: fall of the whitened sum of squares on blocks left out, all channels together.
        crossed: (M, C) prediction of each row that it was learnt on from other blocks, 0 elsewhere.
    """

    inputs: Inputs
    parts: dict[int, dict[str, Array]]
    offsets: dict[int, float]
    gain: float
    crossed: Array

    def predict(self, scene: Scene, rows: Rows, width: int) -> Array | None:
        """(M, C) for another recording; None where it cannot speak of it."""
        try:
            inputs = Inputs.of(scene, rows, like=self.inputs)
        except (KeyError, ValueError):
            return None
        return self._sum(inputs, width) if self.inputs.comparable(inputs) else None

    def own(self, width: int) -> Array:
        """(M, C) on the recording that it was learnt on."""
        return self._sum(self.inputs, width)

    def _sum(self, inputs: Inputs, width: int) -> Array:
        out = np.zeros((len(inputs.position), width))
        for kind, X in _by_name(inputs).items():
            for c, families in self.parts.items():
                if kind in families:
                    out[:, c] += X @ families[kind]
        for c, offset in self.offsets.items():
            out[:, c] -= offset
        return out


def learn(model: Model, kinds: dict[int, set[str]]) -> Remainder | None:
    """The remainder of a model, from its training rows.

    Args:
        kinds: per channel the families of functions in which structure is left.
    """
    bench = model.bench
    inputs = Inputs.of(bench.scene, bench.rows)
    functions = _by_name(inputs)
    rest, white = model.rest() / bench.noise.sigma, model.rest(white=True)
    parts: dict[int, dict[str, Array]] = {}
    offsets, gain, crossed = {}, 0.0, np.zeros_like(rest)
    for c, names in kinds.items():
        mine = {name: X for name, X in functions.items() if name in names}
        candidates = [_Ridge(bench, mine, rest[:, c], white[:, c], c, weighed=weighed) for weighed in (True, False)]
        best = max(candidates, key=lambda ridge: ridge.reached)
        if best.chosen:
            parts[c] = best.coefficients()
            offsets[c] = float(sum(mine[name][bench.train].mean(axis=0) @ t for name, t in parts[c].items()))
            gain += best.white_gain
            crossed[bench.train, c] = best.crossed() * bench.noise.sigma[c]
    return Remainder(inputs, parts, offsets, gain, crossed) if parts else None


def _by_name(inputs: Inputs) -> dict[str, Array]:
    """(M, k) functions of all families by name, the plain ones first; the resonances share one."""
    out: dict[str, list[Array]] = {}
    for name, X in dictionaries(inputs):
        out.setdefault(name, []).append(X)
    return {name: np.concatenate(parts, axis=1) for name, parts in out.items()}


class _Ridge:
    """Ridge regression of one channel's rest on families of functions, few of them.

    Args:
        functions: (M, k) by name, the plain ones first.
        rest, white: (M,) over the noise's standard deviation, and whitened.
        weighed: fitted as whitened (generalised) or as it is: the first is best where noise is the rest's larger part, the
            second where physics is.
    """

    def __init__(
        self, bench: Bench, functions: dict[str, Array], rest: Array, white: Array, channel: int, *, weighed: bool
    ) -> None:
        train = bench.train
        self._fold = np.unique(bench.block[train], return_inverse=True)[1] % FOLDS
        self._weighed = weighed
        self._rest, self._white = rest[train], white[train]
        self._raw: dict[str, Array] = {}
        self._whitened: dict[str, Array] = {}
        self._sizes: dict[str, Array] = {}
        for name, X in functions.items():
            centred = X - X[train].mean(axis=0)
            raw, whitened = centred[train] / bench.noise.sigma[channel], bench.noise.whiten(centred, channel)[train]
            size = np.linalg.norm(whitened if weighed else raw, axis=0)
            size = np.where(size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300), size, np.inf)
            self._raw[name], self._whitened[name], self._sizes[name] = raw / size, whitened / size, size
        self.chosen, self.reached, self.white_gain, self._ridge = self._choose()

    def _choose(self) -> tuple[list[str], float, float, int]:
        """Families, one after the other as long as each explains more of blocks left out; what they reach; the ridge's place.

        Another motion is where many functions that say the same of this one differ: the plainest that does nearly as well
        as the best is taken, and another beside it must be worth it.
        """
        names: list[str] = []
        reached, white, ridge, total = 0.0, 0.0, 0, float(self._rest @ self._rest)
        while len(names) < MOST_FAMILIES:
            tried = {n: self._gains([*names, n]) for n in self._raw if n not in names}
            gains = {n: float(raw.max()) for n, (raw, _) in tried.items()}
            best = max(gains.values(), default=0.0)
            if best - reached < max(WORTH * best, LEAST * total):
                break
            name = next(n for n, gain in gains.items() if gain >= best - WORTH * (best - reached))
            names.append(name)
            reached, ridge = gains[name], int(np.argmax(tried[name][0]))
            white = float(tried[name][1][ridge])
        return names, reached, white, ridge

    def coefficients(self) -> dict[str, Array]:
        """Of every function of the chosen families, in the channel's unit."""
        theta = self._solutions(self.chosen, np.ones(len(self._fold), dtype=bool))[:, self._ridge]
        sizes = np.concatenate([self._sizes[n] for n in self.chosen])
        ends = np.cumsum([self._raw[n].shape[1] for n in self.chosen])[:-1]
        return dict(zip(self.chosen, np.split(theta / sizes, ends), strict=True))

    def crossed(self) -> Array:
        """(n,) what the chosen families predict of each training row from other blocks, over the noise's deviation."""
        out, X = np.zeros(len(self._fold)), _joined(self._raw, self.chosen)
        for judge, theta in self._folds(self.chosen):
            out[judge] = X[judge] @ theta[:, self._ridge]
        return out

    def _gains(self, names: list[str]) -> tuple[Array, Array]:
        """Falls (len(RIDGES),) of the sum of squares on blocks left out in turn, raw and whitened."""
        raw, white = np.zeros(len(RIDGES)), np.zeros(len(RIDGES))
        X, Z = _joined(self._raw, names), _joined(self._whitened, names)
        for judge, theta in self._folds(names):
            raw += _falls(X[judge] @ theta, self._rest[judge])
            white += _falls(Z[judge] @ theta, self._white[judge])
        return raw, white

    def _folds(self, names: list[str]) -> Iterator[tuple[Mask, Array]]:
        """Rows of the blocks left out in turn, and coefficients (k, len(RIDGES)) learnt on the others."""
        for f in range(FOLDS):
            judge = self._fold == f
            if judge.any() and not judge.all():
                yield judge, self._solutions(names, ~judge)

    def _solutions(self, names: list[str], rows: Mask) -> Array:
        """(k, len(RIDGES)) coefficients learnt on some rows, one column a ridge."""
        columns, target = (self._whitened, self._white) if self._weighed else (self._raw, self._rest)
        A = _joined(columns, names)[rows]
        value, vector = np.linalg.eigh(A.T @ A)
        turned = vector.T @ (A.T @ target[rows])
        return np.asarray(vector @ (turned[:, None] / (np.maximum(value, 0.0)[:, None] + RIDGES)))


def _falls(predicted: Array, target: Array) -> Array:
    """(k,) falls of the sum of squares of a target (n,) by predictions (n, k)."""
    return np.asarray(np.sum(predicted * (2.0 * target[:, None] - predicted), axis=0))


def _joined(columns: dict[str, Array], names: list[str]) -> Array:
    return np.concatenate([columns[n] for n in names], axis=1)
