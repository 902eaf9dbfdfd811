"""From the joints that somebody reads to all coordinates of a URDF: what stands, and what follows another joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from galen_hw.errors import UsageError
from galen_hw.kinematics.urdf import MOVING, Urdf
from galen_hw.spatial import Array


@dataclass(frozen=True)
class JointMap:
    """q_all = A q + b, and what follows from it: rates by A, efforts and Jacobians by its transpose.

    Args:
        names: of the joints that are read.
        A: (all, n), with one entry a row at most.
        b: (all,) rad or m where nothing is read.
    """

    names: tuple[str, ...]
    A: Array
    b: Array

    def positions(self, q: Array) -> Array:
        """(N, all) of (N, n)."""
        return self.rates(q) + self.b if np.any(self.b) else self.rates(q)

    def rates(self, dq: Array) -> Array:
        """(N, all) of (N, n), velocities or accelerations."""
        if self.plain:
            return dq
        out = np.zeros((len(dq), len(self.b)))
        # Not a product of matrices: a joint that is not known leaves the others alone.
        for row, place in np.argwhere(self.A):
            out[:, row] = self.A[row, place] * dq[:, place]
        return out

    def joined(self, values: Array) -> Array:
        """(..., n) per joint that is read of (..., all): virtual work."""
        return values if self.plain else np.asarray(values @ self.A)

    @property
    def plain(self) -> bool:
        """Every coordinate is read as it is."""
        return len(self.names) == len(self.b) and not np.any(self.b) and bool(np.all(np.diagonal(self.A) == 1.0))


def joint_map(
    urdf: Urdf, order: Sequence[str], names: Sequence[str] | None = None, at: Mapping[str, float] | None = None
) -> JointMap:
    """The map onto coordinates in an order.

    Args:
        urdf: says what follows what.
        order: of all moving joints.
        names: joints that are read; None: all that follow no other.
        at: where others stand, rad or m; zero where nothing is said.

    Raises:
        UsageError: joints follow each other in a loop.
    """
    free = [name for name in order if urdf.joints[name].mimic is None]
    read = tuple(free if names is None else (name for name in free if name in set(names)))
    A, b = np.zeros((len(order), len(read))), np.zeros(len(order))
    for row, name in enumerate(order):
        source, scale, shift = followed(urdf, name)
        if source in read:
            A[row, read.index(source)], b[row] = scale, shift
        else:
            b[row] = scale * (at or {}).get(source, 0.0) + shift
    return JointMap(read, A, b)


def followed(urdf: Urdf, name: str) -> tuple[str, float, float]:
    """The joint that a joint follows in the end (itself if none), the factor and the offset.

    Raises:
        UsageError: joints follow each other in a loop.
    """
    scale, shift, seen = 1.0, 0.0, {name}
    while (mimic := urdf.joints[name].mimic) is not None:
        scale, shift, name = scale * mimic.multiplier, shift + scale * mimic.offset, mimic.source
        if name in seen:
            what = "joints mimic each other in a loop"
            raise UsageError(what, where=f"{urdf.where}: joint {name}", todo="let one of them follow none")
        seen.add(name)
    return name, scale, shift


def sources(urdf: Urdf, joints: Sequence[str]) -> tuple[str, ...]:
    """The joints to be read for some joints to be known, each once; fixed ones need none."""
    found = (followed(urdf, name)[0] for name in joints if urdf.joints[name].kind in MOVING)
    return tuple(dict.fromkeys(name for name in found if urdf.joints[name].kind in MOVING))
