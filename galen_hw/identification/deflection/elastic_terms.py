"""What the elastic arm may consist of: one effect at one port, its candidates and its column for a set."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.bent import BentScene, GiveScene
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.physics.effects.backlash import Backlash
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.compliance import Compliance, Hardening
from galen_hw.physics.effects.creep import Creep
from galen_hw.physics.effects.hysteresis import Hysteresis
from galen_hw.physics.scenes.elastic_arm import GivingScene, Slip
from galen_hw.spatial import Array

KINDS: Final[dict[str, type[Effect]]] = {
    "compliance": Compliance,
    "hysteresis": Hysteresis,
    "creep": Creep,
    "hardening": Hardening,
    "play": Backlash,
}
WIDTHS: Final = tuple(np.geomspace(0.01, 0.4, 10).tolist())
CONSTANTS_S: Final = (0.7, 1.5, 3.0, 6.0, 12.0, 30.0)
KNEES: Final = (0.1, 0.4, 1.5)
"""Of the load's amplitude: where stiffness has doubled."""
TRANSITIONS: Final = (0.003, 0.01, 0.03)
"""Of the load's amplitude; a softer step than the last is a curved spring, and hardening's business."""


@dataclass(frozen=True)
class Weight:
    """What hangs beyond the sensor: mass kg and moment (3,) kg m in the sensor frame."""

    mass: float = 0.0
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, data: DeflectionSet) -> "Weight":
        """All that hangs on the sensor, as the recording knows it."""
        bodies = data.observations.belief.hanging
        moment = sum((b.mass * np.asarray(b.com) for b in bodies), np.zeros(3))
        return cls(float(sum(b.mass for b in bodies)), tuple(np.asarray(moment).tolist()))


@dataclass(frozen=True)
class Term:
    """One effect at one port."""

    kind: str
    port: str
    effect: Effect

    @property
    def bare(self) -> bool:
        """Return whether it acts on the whole load; the others act on what the friction leaves of it."""
        return self.kind in ("compliance", "hysteresis")

    @property
    def place(self) -> tuple[str, str, int]:
        """What there can be only one of: a curved spring may have a square and a cube."""
        return self.kind, self.port, getattr(self.effect, "power", 0)

    def column(self, bare: GivingScene, settled: GivingScene) -> Array:
        """(N, d) give per unit of the parameter."""
        scene = bare if self.bare else settled
        return np.asarray(self.effect.columns(scene).full(len(scene.channels))[:, :, 0])

    def to_json(self, value: float) -> dict[str, Any]:
        """The form of a term in files."""
        form = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self.effect).items()}
        return {"kind": self.kind, "port": self.port, "form": form, "value": value}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Term":
        """The term of a file.

        Raises:
            UsageError: a kind that is not known.
        """
        if values["kind"] not in KINDS:
            raise UsageError(f"no kind {values['kind']!r}", where="terms", todo="fit the model again")
        return cls(values["kind"], values["port"], KINDS[values["kind"]].from_form(values["form"]))


def scenes(
    sets: Sequence[DeflectionSet],
    weight: Weight,
    known: Mapping[Term, float],
    slips: Mapping[str, Sequence[Slip]],
    like: Sequence[BentScene] = (),
) -> list[tuple[BentScene, BentScene]]:
    """Two scenes a set, of the whole load and of what the friction leaves of it.

    Args:
        known: terms and their values, which bend the arm; like: scenes whose geometry is taken over.
    """
    out = []
    for number, s in enumerate(sets):

        def scene(kind: type[BentScene], number: int = number, s: DeflectionSet = s, **more: Any) -> BentScene:
            made = kind(s.observations, mass=weight.mass, moment=weight.moment, **more)
            return made.sharing(like[number]) if like else made

        gives: dict[str, Array] = {}
        if known:
            rigid, behind = scene(GiveScene), scene(GiveScene, slips=slips)
            for term, value in known.items():
                gives[term.port] = gives.get(term.port, 0.0) + value * term.column(rigid, behind)[:, 0]
        bare = scene(BentScene, gives=gives)
        out.append((bare, scene(BentScene, gives=gives, slips=slips).sharing(bare) if slips else bare))
    return out


def amplitude(views: Sequence[GivingScene], port: str) -> float:
    """Half the range of a port's load over all sets, N or N m; 0 where it bears none."""
    low = min(float(v.bare_load(port).min()) for v in views)
    high = max(float(v.bare_load(port).max()) for v in views)
    return 0.5 * (high - low) if high - low > 1e-6 else 0.0


def elastic_candidates(views: Sequence[GivingScene]) -> Iterator[Term]:
    """Compliance of every port that bears load in every set."""
    for port in views[0].ports:
        if all(v.load(port) is not None for v in views):
            yield Term("compliance", port, Compliance("joint", port))


def settled_candidates(views: Sequence[GivingScene], ports: Sequence[str]) -> Iterator[Term]:
    """Creep, hardening and play of some ports."""
    for port in ports:
        size = amplitude(views, port)
        for constant in CONSTANTS_S:
            yield Term("creep", port, Creep(constant, joint=port, form="less"))
        for power in (2, 3):
            yield Term("hardening", port, Hardening(port, power))
        for share in TRANSITIONS:
            yield Term("play", port, Backlash(port, None, share * size))


def hysteresis_columns(views: Sequence[GivingScene], port: str, widths: Sequence[float]) -> dict[Term, list[Array]]:
    """Columns of slip elements of some widths, worked out in one pass a set."""
    effect = Hysteresis.of_load(port, widths)
    full = [effect.columns(v).full(len(v.channels)) for v in views]
    terms = [Term("hysteresis", port, Hysteresis.of_load(port, (r,))) for r in widths]
    return {term: [f[:, :, i] for f in full] for i, term in enumerate(terms)}


def zoomed(term: Term, factor: float, softest: float, count: int = 5) -> list[Term]:
    """The same effect at neighbouring values of what is searched, from 1/factor to factor times.

    Args:
        softest: largest transition of play, N or N m.
    """
    ratios = [x for x in np.geomspace(1.0 / factor, factor, count).tolist() if abs(x - 1.0) > 1e-9]
    e = term.effect
    if isinstance(e, Hysteresis):
        return [Term(term.kind, term.port, Hysteresis.of_load(term.port, (e.widths[0] * x,))) for x in ratios]
    if isinstance(e, Creep):
        return [Term(term.kind, term.port, Creep(e.constant * x, joint=e.joint, form="less")) for x in ratios]
    if isinstance(e, Hardening) and e.knee is not None:
        return [Term(term.kind, term.port, Hardening(e.joint, 2, e.knee * x)) for x in ratios]
    if isinstance(e, Backlash) and e.transition is not None:
        steps = [e.transition * x for x in ratios if e.transition * x <= softest]
        return [Term(term.kind, term.port, Backlash(e.joint, None, step)) for step in steps]
    return []


def knees(port: str, size: float) -> list[Term]:
    """Hardening of a port in the form that levels off, for a load of some amplitude.

    Not a candidate by itself: soft at small loads and linear above, it would take the place of a play that is not found yet.
    """
    return [Term("hardening", port, Hardening(port, 2, share * size)) for share in KNEES]


Columns = dict[Hashable, list[Array]]
