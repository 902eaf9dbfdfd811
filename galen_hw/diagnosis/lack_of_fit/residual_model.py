"""A model of the residual without a name: regressions on generic functions of the inputs.

It shows how far any function of the known inputs and their past would go (the ceiling), and on what. It is never saved for the
live services: a function that nobody can explain does not act on a robot.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from galen_hw.diagnosis.estimation.model import Model
from galen_hw.diagnosis.lack_of_fit.basis_functions import PLAIN, Inputs
from galen_hw.diagnosis.lack_of_fit.gram import Functions, Sums, by_name
from galen_hw.diagnosis.lack_of_fit.pursuit import Pursuit
from galen_hw.diagnosis.lack_of_fit.regression import Blend, Regression
from galen_hw.diagnosis.stats.sampling import Rows
from galen_hw.lazy import cached_property
from galen_hw.physics.scenes.base import Scene
from galen_hw.spatial import Array

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingRegressor

RIDGES: Final = np.logspace(-2.0, 4.0, 13)
"""Tried; in units of the noise's square over that of one function's whole contribution."""


@dataclass(frozen=True)
class Remainder:
    """Regressions of a model's residual on generic functions, channel by channel.

    Args:
        inputs: of the recording that it was learnt on.
        parts: per channel, names of the families and the coefficient of each of their functions.
        offsets: per channel, the mean of their sum over the training rows, less the fitted constant.
        gain: fall of the whitened sum of squares on held-out blocks, all channels together.
        crossed: (M, C) prediction of each row that it was learnt on from other blocks, 0 elsewhere.
        trees: per channel, trees that are averaged with the sum of the parts.
    """

    inputs: Inputs
    parts: dict[int, dict[str, Array]]
    offsets: dict[int, float]
    gain: float
    cross_validated: Array
    trees: dict[int, "HistGradientBoostingRegressor"] = field(default_factory=dict)

    def joined(self, other: "Remainder") -> "Remainder":
        """Return both remainders as one, as yet without trees; they have no channel in common."""
        return replace(
            self,
            parts=self.parts | other.parts,
            offsets=self.offsets | other.offsets,
            gain=self.gain + other.gain,
            cross_validated=self.cross_validated + other.cross_validated,
        )

    def predict(self, scene: Scene, rows: Rows, width: int) -> Array | None:
        """Return predictions (M, C) for another recording; None where its inputs are not comparable."""
        try:
            inputs = Inputs.of(scene, rows, like=self.inputs)
        except (KeyError, ValueError):
            return None
        return self._sum(inputs, width) if self.inputs.comparable(inputs) else None

    def own(self, width: int) -> Array:
        """Return predictions (M, C) on the recording that it was learnt on."""
        return self._sum(self.inputs, width)

    def _sum(self, inputs: Inputs, width: int) -> Array:
        out = np.zeros((len(inputs.position), width))
        for kind, X in by_name(inputs).items():
            for c, families in self.parts.items():
                if kind in families:
                    out[:, c] += X @ families[kind]
        for c, offset in self.offsets.items():
            out[:, c] -= offset
        for c, trees in self.trees.items():
            out[:, c] = 0.5 * (out[:, c] + trees.predict(inputs.seen))
        return out


def learn(model: Model, kinds: dict[int, set[str]], functions: Functions | None = None) -> Remainder | None:
    """Fit the remainder of a model on its training rows.

    Args:
        kinds: per channel the families of functions that are tried.
        functions: of the model's bench, where they are known already.
    """
    bench = model.bench
    functions = functions if functions is not None and functions.bench is bench else Functions(bench)
    residual, white = model.residual() / bench.noise.sigma, model.residual(white=True)
    parts: dict[int, dict[str, Array]] = {}
    offsets, gain, cross_validated = {}, 0.0, np.zeros_like(residual)
    for c, kind in kinds.items():
        names = [name for name in functions.columns if name in kind]
        if not names:  # trees alone follow it
            continue
        best = _best(functions, names, c, residual[functions.rows, c], white[functions.rows, c])
        if best.chosen:
            parts[c] = best.coefficients()
            level = functions.level(parts[c], c, white[functions.rows, c])
            cross_validated[functions.rows, c] = best.cross_validated() * bench.noise.sigma[c] + level
            # In another recording the functions are not centred by their mean on this one.
            offsets[c] = float(sum(functions.means[n] @ t for n, t in parts[c].items())) - level
            gain += best.white_gain
    return Remainder(functions.inputs, parts, offsets, gain, cross_validated) if parts else None


def _best(
    functions: Functions, names: list[str], channel: int, residual: Array, white_residual: Array, *, short: float = 0.03
) -> Regression:
    """Return the regression of a channel's residual (n,) with the largest cross-validated gain, or a simpler one nearly as good.

    A resonance may be in step with a speed in one motion, and is not in the next.

    Args:
        short: share of what is explained by which a few low powers may fall short of all functions: they hold of another
            motion too.
    """

    def of(kind: type[Ridge | Pursuit], some: list[str]) -> Ridge | Pursuit:
        plain, white = functions.plain(some, channel), functions.white(some, channel)
        each = (kind(plain, white, residual, white_residual, weighed=weighed) for weighed in (True, False))
        return max(each, key=lambda one: one.reached)

    tried: list[Regression] = [of(Ridge, names), of(Pursuit, names)]
    if all(one.chosen for one in tried):
        tried.append(Blend.between(*tried))
    best = max(tried, key=lambda one: one.reached)
    powers = [name for name in functions.columns if name in PLAIN]
    plainer = of(Pursuit, powers) if powers and best.chosen else best
    return plainer if plainer.chosen and plainer.reached >= (1.0 - short) * best.reached else best


@dataclass
class Ridge(Regression):
    """Ridge regression on families of functions, few of them.

    Args:
        most: families.
        worth: share of the gain by which a family must be better than a simpler one, or another family add.
        tried: families that are tried given the chosen ones: those that explain most of their residual.
    """

    most: int = field(default=3, kw_only=True)
    worth: float = field(default=0.1, kw_only=True)
    tried: int = field(default=8, kw_only=True)
    _ridge: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        """Choose families by forward selection as long as each raises the cross-validated gain.

        Where many functions agree on this motion they differ on another one: the simplest family that does nearly as well as the
        best is taken, and a further family must be worth it.
        """
        self._learnt = self.white if self.weighed else self.plain
        self._plain_b, self._white_b = self.plain.against(self.residual), self.white.against(self.white_residual)
        self._b = self._white_b if self.weighed else self._plain_b
        self._alone: dict[str, list[tuple[Array, Array]]] = {}
        total, names = float(self.residual @ self.residual), list(self.plain.columns)
        while len(self.chosen) < self.most:
            candidates = [n for n in names if n not in self.chosen]
            if self.chosen:
                promise = self._promises(candidates)
                best_few = sorted(candidates, key=lambda n: -promise[n])[: self.tried]
                candidates = [n for n in candidates if n in best_few]
            tried = {n: self._gains([*self.chosen, n]) for n in candidates}
            gains = {n: float(raw.max()) for n, (raw, _) in tried.items()}
            best = max(gains.values(), default=0.0)
            if best - self.reached < max(self.worth * best, self.least * total):
                return
            name = next(n for n, gain in gains.items() if gain >= best - self.worth * (best - self.reached))
            self.chosen.append(name)
            self.reached, self._ridge = gains[name], int(np.argmax(tried[name][0]))
            self.white_gain = float(tried[name][1][self._ridge])

    @cached_property
    def _sizes(self) -> dict[str, Array]:
        """Norms (k,) of the columns as they are fitted; a column that is hardly there counts as none."""
        out = {}
        for name in self.plain.columns:
            size = np.sqrt(np.einsum("fkk->k", self._learnt.pair(name, name)))
            out[name] = np.where(size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300), size, np.inf)
        return out

    def coefficients(self) -> dict[str, Array]:
        """Return the coefficients of every function of the chosen families, in the channel's unit."""
        theta = self._whole(self.chosen)[:, self._ridge] / self._size(self.chosen)
        ends = np.cumsum([len(self._sizes[n]) for n in self.chosen])[:-1]
        return dict(zip(self.chosen, np.split(theta, ends), strict=True))

    def cross_validated(self, *, white: bool = False) -> Array:
        """Return predictions (n,) of the chosen families for each row from other folds, over the noise's deviation."""
        columns = (self.white if white else self.plain).joined(self.chosen)
        out, X = np.zeros(len(self.residual)), columns / self._size(self.chosen)
        for rows, theta in zip(self.plain.folds, self._thetas(self.chosen), strict=True):
            out[rows] = X[rows] @ theta[:, self._ridge]
        return out

    def _size(self, names: list[str]) -> Array:
        return np.concatenate([self._sizes[n] for n in names])

    def _gains(self, names: list[str]) -> tuple[Array, Array]:
        """Return the falls (len(RIDGES),) of the sum of squares on held-out folds, plain and whitened."""
        thetas, size = self._thetas(names), self._size(names)
        return tuple(  # type: ignore[return-value]
            sum(
                _falls(theta, G / np.outer(size, size), b / size)
                for theta, G, b in zip(thetas, sums.gram(names), _joined(inner, names), strict=True)
            )
            for sums, inner in ((self.plain, self._plain_b), (self.white, self._white_b))
        )

    def _promises(self, names: list[str]) -> dict[str, float]:
        """Return the cross-validated gain of each family alone on the residual of the chosen ones: a quick lower bound."""
        chosen, size, out = self.chosen, self._size(self.chosen), {}
        thetas = [theta[:, self._ridge] / size for theta in self._thetas(chosen)]
        for name in names:
            mine = self._sizes[name]
            learnt = self._residual_products(self._learnt, self._b, name, thetas)
            judged = self._residual_products(self.plain, self._plain_b, name, thetas)
            G = self.plain.pair(name, name) / np.outer(mine, mine)
            gain = np.zeros(len(RIDGES))
            for f, (value, vector) in enumerate(self._eigen(name)):
                others = sum(learnt[f][g] for g in range(len(thetas)) if g != f)
                theta = _ridged(value, vector, np.asarray(others) / mine)
                gain += _falls(theta, G[f], judged[f][f] / mine)
            out[name] = float(gain.max())
        return out

    def _residual_products(self, sums: Sums, inner: dict[str, Array], name: str, thetas: list[Array]) -> list[Array]:
        """Return, for each fold's parameters of the chosen families, products (folds, k) with their residual."""
        cross = np.concatenate([sums.pair(name, other) for other in self.chosen], axis=2)
        return [inner[name] - cross @ theta for theta in thetas]

    def _eigen(self, name: str) -> list[tuple[Array, Array]]:
        """Return the eigendecomposition of a family by itself without each fold, cached."""
        if name not in self._alone:
            G = self._learnt.pair(name, name) / np.outer(self._sizes[name], self._sizes[name])
            self._alone[name] = [tuple(np.linalg.eigh(G.sum(axis=0) - one)) for one in G]  # type: ignore[misc]
        return self._alone[name]

    def _thetas(self, names: list[str]) -> list[Array]:
        """Return for each fold the coefficients (k, len(RIDGES)) learnt on the others, one column a ridge."""
        b = _joined(self._b, names)
        residuals = (b.sum(axis=0) - b) / self._size(names)
        if len(names) == 1:
            return [_ridged(*eigen, residual) for eigen, residual in zip(self._eigen(names[0]), residuals, strict=True)]
        size = self._size(names)
        G = self._learnt.gram(names) / np.outer(size, size)
        return [
            _ridged(*np.linalg.eigh(G.sum(axis=0) - one), residual) for one, residual in zip(G, residuals, strict=True)
        ]

    def _whole(self, names: list[str]) -> Array:
        """Return coefficients (k, len(RIDGES)) learnt on all rows."""
        size = self._size(names)
        G = self._learnt.gram(names).sum(axis=0) / np.outer(size, size)
        return _ridged(*np.linalg.eigh(G), _joined(self._b, names).sum(axis=0) / size)


def _ridged(value: Array, vector: Array, b: Array) -> Array:
    """Return solutions (k, len(RIDGES)) of normal equations by their eigenvalues and eigenvectors."""
    return np.asarray(vector @ ((vector.T @ b)[:, None] / (np.maximum(value, 0.0)[:, None] + RIDGES)))


def _falls(theta: Array, G: Array, b: Array) -> Array:
    """Return falls (m,) of a sum of squares by parameters (k, m), from inner products (k, k) and (k,) with the target."""
    return np.asarray(2.0 * b @ theta - np.einsum("km,km->m", theta, G @ theta))


def _joined(inner: dict[str, Array], names: list[str]) -> Array:
    return np.concatenate([inner[n] for n in names], axis=1)
