"""The recordings that mistakes are made in: families by name, each of which makes one from a generator and needs."""

from collections.abc import Callable
from functools import partial

import numpy as np

from galen_hw.tools.blind_proof.generator.build import UnreachableError
from galen_hw.tools.blind_proof.mistakes.origins import arm6, proof, pushed, real, static
from galen_hw.tools.blind_proof.mistakes.recording import Recording

Maker = Callable[[np.random.Generator, frozenset[str]], Recording]

FAMILIES: dict[str, Maker] = {
    "static": static.make,
    **{f"proof-{group}": partial(proof.make, group) for group in proof.EFFECTS},
    "arm6-wrench": arm6.wrench,
    "arm6-effort": arm6.effort,
    "arm6-pose": arm6.pose,
    "arm6-targets": arm6.targets,
    "pushed": pushed.make,
    **{name: partial(real.make, name) for name in real.REALS},
}
REAL = frozenset(real.REALS)


def present(family: str) -> bool:
    """Return whether recordings of a family can be made on this machine."""
    return family not in REAL or real.present(family)


def make(family: str, rng: np.random.Generator, needs: frozenset[str] = frozenset()) -> Recording:
    """One recording of a family."""
    for _ in range(5):
        try:
            out = FAMILIES[family](rng, needs)
        except UnreachableError:
            continue
        out.origin = family
        return out
    return FAMILIES[family](rng, needs | {"nothing"})
