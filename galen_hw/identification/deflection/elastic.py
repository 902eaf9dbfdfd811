"""The arm as springs: joints, structure and tool give through the Jacobian, with friction, creep, hardening and play.

Stiffness depends on the configuration because a load's lever about each joint does. Which effects there are is decided
on held-out sets (`elastic_fit`); the numbers are least squares with the tracker's frame of each set and its delay free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from scipy.stats import norm, t

from galen_hw.identification.deflection.blocks import Blocks
from galen_hw.identification.deflection.compare import judged, rests
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic_fit import DELAY, Decision, Search
from galen_hw.identification.deflection.elastic_stream import ElasticStream, Jitter
from galen_hw.identification.deflection.elastic_terms import Term, Weight, scenes
from galen_hw.identification.deflection.model import DeflectionModel
from galen_hw.identification.deflection.stream import GiveStream
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.operators.filters import play
from galen_hw.physics.scenes.elastic_arm import Slip
from galen_hw.spatial import Array

SURE = 0.1
"""Times the tracker's noise: memory that is no less sure than that is known."""


def _none() -> Array:
    return np.zeros((0, 0))


@dataclass
class ElasticArm(DeflectionModel):
    """The fitted arm.

    Args:
        terms, values: effects and their parameters (k,); covariance: (k, k) of these.
        slips: port to friction that the other effects lie behind.
        weight: what hangs beyond the sensor.
        floor: (d,) one sigma of what the model leaves at configurations that it has not seen, tracker's noise apart.
        noise: (d,) one sigma of the tracker; delay_s: of the tracker behind the force.
        decisions: what was kept and dropped, and by how much.
    """

    NAME: ClassVar[str] = "elastic arm"
    ABOUT: ClassVar[str] = "springs through the Jacobian; friction, creep, hardening, play where data want them"
    terms: tuple[Term, ...] = ()
    values: Array = field(default_factory=lambda: np.zeros(0))
    covariance: Array = field(default_factory=_none)
    slips: dict[str, list[Slip]] = field(default_factory=dict)
    weight: Weight = field(default_factory=Weight)
    floor: Array = field(default_factory=lambda: np.zeros(3))
    noise: Array = field(default_factory=lambda: np.zeros(3))
    delay_s: float = 0.0
    decisions: tuple[Decision, ...] = ()

    def fit(self, sets: Sequence[DeflectionSet]) -> Self:
        """Search the effects and solve for them."""
        search = Search(sets)
        blocks = search.run()
        keys = [*search.terms, DELAY]
        theta, covariance = blocks.solve(keys), blocks.robust_covariance(keys)
        self.terms, self.values = tuple(search.terms), theta[:-1]
        self.covariance, self.delay_s = covariance[:-1, :-1], -float(theta[-1])
        self.slips, self.weight, self.noise = search.slips, search.weight, search.noise
        self.decisions = tuple(search.decisions.values())
        self.floor = _floor(self, sets, blocks)
        return self

    @property
    def kept(self) -> tuple[str, ...]:
        """Kinds of effects beside compliance that the data wanted."""
        return tuple(dict.fromkeys(t.kind for t in self.terms if t.kind != "compliance"))

    def columns(self, data: DeflectionSet) -> Array:
        """(N, d, k) give per unit of each parameter; k is 0 of an arm in which nothing gives."""
        if not self.terms:
            return np.zeros((*data.give.shape, 0))
        known = dict(zip(self.terms, self.values.tolist(), strict=True))
        ((bare, settled),) = scenes([data], self.weight, known, self.slips)
        return np.stack([t.column(bare, settled) for t in self.terms], axis=2)

    def predict(self, data: DeflectionSet) -> Array:
        """Give (N, d), from the load of the first row on (its weight's sag is in the tracker's frame)."""
        return np.asarray(self.columns(data) @ self.values)

    def variance(self, data: DeflectionSet) -> Array:
        """(N, d) of the corrected tip.

        Parameters, what the model leaves, what the force's noise makes of the give here, and the friction's memory, which
        is not known until the pushes have moved each load by its width.
        """
        X = self.columns(data)
        known = np.einsum("ndi,ij,ndj->nd", X, self.covariance, X)
        jitter, steps = Jitter(X.shape[1]), np.diff(data.time, prepend=data.time[0])
        white = [jitter.take(give, dt) for give, dt in zip(X @ self.values, steps.tolist(), strict=True)]
        return np.asarray(known + self.floor**2 + np.array(white) + self.unsure(data))

    def unsure(self, data: DeflectionSet) -> Array:
        """(N, d) variance of the friction's output, which lies anywhere between those of the least and the largest start."""
        known = dict(zip(self.terms, self.values.tolist(), strict=True))
        ((bare, _),) = scenes([data], self.weight, known, self.slips)
        out = np.zeros(data.give.shape)
        for term, value in known.items():
            if isinstance(term.effect, Hysteresis):
                load, r = bare.bare_load(term.port)[:, None], np.array(term.effect.widths)
                low, high = (play(load, r, load[0] + side * r)[0][:, 0] for side in (-1.0, 1.0))
                out += ((high - low) ** 2 / 12.0)[:, None] * (value * bare.joint_port(term.port)) ** 2
        return out

    def to_json(self) -> dict[str, Any]:
        """Terms, parameters and how sure they are."""
        return {
            "terms": [t.to_json(float(v)) for t, v in zip(self.terms, self.values, strict=True)],
            "covariance": self.covariance.tolist(),
            "slips": {port: [list(slip) for slip in slips] for port, slips in self.slips.items()},
            "weight": {"mass": self.weight.mass, "moment": list(self.weight.moment)},
            "floor": self.floor.tolist(),
            "noise": self.noise.tolist(),
            "delay_s": self.delay_s,
            "decisions": [vars(d) for d in self.decisions],
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """From a file."""
        weight = values["weight"]
        return cls(
            tuple(Term.from_json(t) for t in values["terms"]),
            np.array([float(t["value"]) for t in values["terms"]]),
            np.array(values["covariance"], dtype=float).reshape(len(values["terms"]), -1),
            {str(k): [(float(r), float(s)) for r, s in v] for k, v in values["slips"].items()},
            Weight(float(weight["mass"]), tuple(map(float, weight["moment"]))),  # type: ignore[arg-type]
            np.array(values["floor"], dtype=float),
            np.array(values["noise"], dtype=float),
            float(values["delay_s"]),
            tuple(Decision(**d) for d in values["decisions"]),
        )

    def stream(self, std: Array | None = None) -> GiveStream:
        """The same numbers sample by sample."""
        del std
        return ElasticStream(self)


def _floor(model: ElasticArm, sets: Sequence[DeflectionSet], blocks: Blocks) -> Array:
    """(d,) one sigma of what is left at held-out configurations, the tracker's noise apart.

    Rows count where the friction's memory is known. The tracker's noise is white and the model's error lasts: the
    product of neighbouring rows holds that alone. What the force's noise makes of the prediction is white too, and
    differs from load to load (`Jitter`). Few configurations have been seen, and the more they differ the less is
    known: the interval of 95 % is Student's, with degrees of freedom by the scatter over the sets (Satterthwaite
    1946); where next to nothing is left, the scatter is the noise's own, and two standard errors are the most that it
    hides. The three axes of a position (and those of a turn) share one floor: what is left is no property of an axis
    of the base.
    """
    by_fold = {int(f): blocks.solve([*model.terms, DELAY], without=int(f))[:-1] for f in np.unique(blocks.fold)}
    squares = []
    for number, s in enumerate(sets):
        give = model.columns(s) @ by_fold[int(blocks.fold[blocks.owner == number][0])]
        late = np.stack([np.interp(s.time - model.delay_s, s.time, c) for c in give.T], axis=1)
        sure = judged(s) & (model.unsure(s) <= (SURE * model.noise) ** 2).all(axis=1)
        still = np.concatenate([np.zeros(0, np.intp), *rests(s)])
        still = still[sure[still]]
        if len(still) == 0:
            continue
        left = s.give - late
        left = (left - left[still].mean(axis=0))[sure]
        white = np.mean(np.diff(left, axis=0) ** 2, axis=0) / 2.0
        squares.append(np.mean(left[1:] * left[:-1], axis=0) - white / len(still))
    each = np.array(squares or [np.zeros(len(model.noise))])
    each = np.repeat(each.reshape(len(each), -1, 3).mean(axis=2), 3, axis=1)
    mean, error = each.mean(axis=0), each.std(axis=0, ddof=min(1, len(each) - 1)) / np.sqrt(len(each))
    freedom = np.clip(2.0 * mean**2 / np.maximum(error**2, 1e-300), 1.0, 1e6)
    student = mean * (t.ppf(0.975, freedom) / norm.ppf(0.975)) ** 2
    most = mean + 2.0 * error
    total = np.where(mean < error, most, np.minimum(student, most))
    return np.asarray(np.sqrt(np.maximum(total, (0.05 * model.noise) ** 2)))
