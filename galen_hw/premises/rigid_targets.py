"""Tracked points of one rigid body: their distances are the same in every row, whatever the arm and the tracker do."""

from collections.abc import Iterator
from itertools import combinations
from typing import ClassVar

import numpy as np

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Remark, Stage, known_rows
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import as_axes, signed_permutations
from galen_hw.spatial import Array


class RigidTargets:
    """Tests whether one of three targets or more does not keep its distances, while the others keep theirs."""

    KEY: ClassVar[str] = "rigid_targets"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield a refusal: in other axes than the others, if these restore the distances, else of another body."""
        if seen.predict != "targets":
            return
        names = list(dict.fromkeys(n.rsplit(".", 1)[0] for n in seen.columns if n.startswith("target.")))
        axes = {name: tuple(f"{name}.{a}" for a in "xyz") for name in names}
        if len(names) < 3 or not all(seen.has_all(*one) for one in axes.values()):
            return
        rows = known_rows(seen, [n for one in axes.values() for n in one], CRITERIA.most_rows)
        if len(rows) < CRITERIA.fewest_vectors:
            return
        at = {name: seen.matrix(*one)[rows] for name, one in axes.items()}
        spread = {pair: _spread(at[pair[0]] - at[pair[1]]) for pair in combinations(names, 2)}
        for name in names:
            own = [s for pair, s in spread.items() if name in pair]
            others = max(s for pair, s in spread.items() if name not in pair)
            # Beside noise that differs by axis and target: what is a tenth of it is another body's.
            if min(own) * CRITERIA.gross_left <= others:
                continue
            read = {
                k: max(_spread(at[name] @ P - at[other]) for other in names if other != name)
                for k, P in enumerate(signed_permutations())
            }
            best = min(read, key=lambda k: read[k])
            what = f"{name} is {1e3 * min(own):.3g} mm rms off its distance to the other targets, which keep theirs"
            todo = "leave its columns out: it is on another body, or mixed up with another marker"
            if read[best] < CRITERIA.gross_left * min(own):
                what = f"{what}; it keeps it with {as_axes(signed_permutations()[best])}: it is in other axes"
                todo = "give all targets in the tracker's axes"
            yield Remark(self.KEY, what, todo, axes[name], Action.REFUSED)
            return


def _spread(apart: Array) -> float:
    """Return the standard deviation, m, of the length of vectors (N, 3)."""
    return float(np.std(np.linalg.norm(apart, axis=1)))
