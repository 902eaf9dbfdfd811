"""A tracker that was moved, or a base: from some row on all that is tracked lies elsewhere, by one turn and one shift."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.scenes.base import Scene
from galen_hw.physics.scenes.pose import POSITION, QUATERNION, TargetsScene
from galen_hw.premises.base import Action, Remark, Stage, joint_positions, known_rows, with_matrix
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.rotations import as_turn, similarity
from galen_hw.spatial import Array, quaternion_from_rotation, rotation_from_quaternion, skew


@dataclass(frozen=True)
class _Frame:
    """Where simulated points (n, 3) were measured: turned by R (3, 3), then shifted by t (3,) m."""

    R: Array
    t: Array

    @classmethod
    def of(cls, simulated: Array, measured: Array) -> Self:
        """Return the best of points (n, 3)."""
        R = similarity(simulated, measured, determinant=1).Q
        return cls(R, measured.mean(axis=0) - R @ simulated.mean(axis=0))


class MovedTracker:
    """Tests whether one turn and one shift of the frame, from some row on, are nearly all that tracked points are off by.

    A frame that moves slowly, or an arm that bends, leaves far more. A shift alone is a step of the readings, and the search's.
    """

    KEY: ClassVar[str] = "moved_tracker"
    STAGE: ClassVar[Stage] = Stage.FRAMES

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield one remark; what is tracked behind that row is brought back to the frame of the rows before it."""
        names = POSITION if seen.predict == "pose" else tuple(n for n in seen.columns if n.startswith("target."))
        if seen.predict not in ("pose", "targets") or seen.belief.robot is None or not seen.has_all(*names):
            return
        if seen.simulation is not None or not names:
            return
        rows = known_rows(seen, (*names, *joint_positions(seen)))
        if len(rows) < 4 * CRITERIA.fewest_vectors:
            return
        scene = scene_of(seen.taken(rows))
        points = _Points.of(scene, seen.taken(rows).matrix(*names))
        k = points.moment()
        if k is None:
            return
        points = points.placed(k)
        before, after = points.frames(k)
        turn = before.R @ after.R.T
        if points.shifted_alone(k, before, after):
            return
        later = np.arange(len(seen)) >= rows[k]
        values = seen.matrix(*names)
        back = (values[later].reshape(-1, 3) - after.t) @ turn.T + before.t
        values[later] = back.reshape(-1, len(names))
        repaired = with_matrix(seen, names, values)
        if seen.predict == "pose" and seen.has_all(*QUATERNION):
            q = seen.matrix(*QUATERNION)
            known = later & np.isfinite(q).all(axis=1)
            q[known] = quaternion_from_rotation(turn @ rotation_from_quaternion(q[known]))
            repaired = with_matrix(repaired, QUATERNION, q)
        where = f"row {rows[k] + 1}" if seen.time is None else f"row {rows[k] + 1} ({seen.time[rows[k]]:.5g} s)"
        moved = values[later].reshape(-1, 3) - seen.matrix(*names)[later].reshape(-1, 3)
        away = float(np.linalg.norm(np.nanmean(moved, axis=0)))
        what = (
            f"from {where} on all that is tracked lies elsewhere: turned by {as_turn(turn.T)} and {1e3 * away:.3g} mm away on "
            "average: the tracker or the base was moved; brought back to the frame before"
        )
        yield Remark(self.KEY, what, "register the tracker again", names, Action.REPAIRED, repaired)


@dataclass(frozen=True)
class _Points:
    """Tracked points of N rows.

    Args:
        simulated, measured: (N, K, 3) m.
        shared: (N, 3 K, k) how the points move with what is the same before and after: zeros of the joints, and the places of
            points on the body where these are fitted.
    """

    simulated: Array
    measured: Array
    shared: Array

    @classmethod
    def of(cls, scene: Scene, measured: Array) -> Self:
        """Return those of a scene."""
        n, width = measured.shape
        ports = [scene.joint_port(joint) for joint in scene.moved]
        shared = [port[:, :width, None] for port in ports if port is not None]
        if isinstance(scene, TargetsScene):
            shared.append(_places(scene.registration[0] @ scene.T_sensor[:, :3, :3], width // 3))
        return cls(
            scene.simulated[:, :width].reshape(n, -1, 3),
            measured.reshape(n, -1, 3),
            np.concatenate([np.zeros((n, width, 0)), *shared], axis=2),
        )

    def some(self, rows: NDArray[np.intp]) -> "_Points":
        """Return those of some rows."""
        return _Points(self.simulated[rows], self.measured[rows], self.shared[rows])

    def moment(self) -> int | None:
        """Return the row from which on the points are in another frame than before; None where no row tells.

        Each frame is a small motion [v, w] of simulated points p, v + w x p; what is `shared` is the same in both. By least
        squares, from sums up to each row of a few.
        """
        rows, fewest = _few(len(self.simulated)), CRITERIA.fewest_vectors
        few = self.some(rows)
        A, B, r = few.frame(), few.shared, (few.measured - few.simulated).reshape(len(rows), -1)
        At, size = np.swapaxes(A, 1, 2), B.shape[2]
        G, C, b = (np.cumsum(x, axis=0) for x in (At @ A, At @ B, At @ r[:, :, None]))
        D, d = np.einsum("nij,nik->jk", B, B), np.einsum("nij,ni->j", B, r)
        at = np.arange(fewest - 1, len(rows) - fewest)
        whole, right = np.zeros((len(at), 12 + size, 12 + size)), np.zeros((len(at), 12 + size))
        for place, sums in ((0, (G[at], C[at], b[at])), (6, (G[-1] - G[at], C[-1] - C[at], b[-1] - b[at]))):
            part = slice(place, place + 6)
            whole[:, part, part], whole[:, part, 12:], right[:, part] = sums[0], sums[1], sums[2][:, :, 0]
            whole[:, 12:, part] = np.swapaxes(sums[1], 1, 2)
        whole[:, 12:, 12:], right[:, 12:] = D, d
        one = np.block([[G[-1], C[-1]], [C[-1].T, D]])[None]
        square = float(np.sum(r**2))
        plain = square - float(_explained(one, np.concatenate([b[-1][:, 0], d])[None])[0])
        both = square - _explained(whole, right)
        best = int(np.argmin(both))
        if both[best] > CRITERIA.gross_left * plain:
            return None
        first, last = rows[at[best]], rows[at[best] + 1]
        there = self.placed(last)
        before, after = there.frames(last)
        # Between two rows that were looked at: behind the last one that lies nearer to the frame before.
        p, y = there.simulated[first:last], self.measured[first:last]
        off = [np.sum((y - p @ f.R.T - f.t) ** 2, axis=(1, 2)) for f in (before, after)]
        return int(first + 1 + np.sum(off[0][1:] < off[1][1:]))

    def placed(self, k: int) -> "_Points":
        """Return the points simulated with what is `shared` as it fits both frames, the second from row k on."""
        if not self.shared.shape[2]:
            return self
        rows = _few(len(self.simulated))
        few, later = self.some(rows), (rows >= k)[:, None, None]
        A, r = few.frame(), (few.measured - few.simulated).ravel()
        X = np.concatenate([A * ~later, A * later, few.shared], axis=2).reshape(len(r), -1)
        moved = self.shared @ np.linalg.lstsq(X, r, rcond=1e-9)[0][12:]
        return replace(self, simulated=self.simulated + moved.reshape(self.simulated.shape))

    def frames(self, k: int) -> tuple[_Frame, _Frame]:
        """Return the frames of the rows before k and from k on."""
        parts = (slice(0, k), slice(k, None))
        before, after = (_Frame.of(self.simulated[x].reshape(-1, 3), self.measured[x].reshape(-1, 3)) for x in parts)
        return before, after

    def shifted_alone(self, k: int, before: _Frame, after: _Frame) -> bool:
        """Return whether the turn of the frame, from row k on, moves the points by less than what both frames leave."""
        parts = [
            (self.simulated[part], self.measured[part], f)
            for part, f in ((slice(0, k), before), (slice(k, None), after))
        ]
        left = sum(float(np.sum((y - p @ f.R.T - f.t) ** 2)) for p, y, f in parts)
        p = self.simulated[k:].reshape(-1, 3)
        turned = (p - p.mean(axis=0)) @ (after.R - before.R).T
        return float(np.sum(turned**2)) <= left

    def frame(self) -> Array:
        """Return how the points move with the frame, (N, 3 K, 6)."""
        n, count, _ = self.simulated.shape
        p = self.simulated.reshape(-1, 3)
        return np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), -skew(p)], axis=2).reshape(n, 3 * count, 6)


def _places(carried: Array, count: int) -> Array:
    """Return how points move with their places on a body of axes (N, 3, 3), as the tracker sees them: (N, 3 K, 3 K)."""
    out = np.zeros((len(carried), 3 * count, 3 * count))
    for k in range(count):
        out[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = carried
    return out


def _few(n: int) -> NDArray[np.intp]:
    """Return so many of n rows as tell a moment, evenly chosen."""
    return np.unique(np.linspace(0, n - 1, min(n, CRITERIA.stretch)).astype(np.intp))


def _explained(normal: Array, right: Array) -> Array:
    """Return the sums of squares (m,) that least squares explain: normal equations (m, k, k) and right sides (m, k)."""
    size = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
    scaled = normal / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(normal.shape[1])
    own = right / size
    return np.asarray(np.sum(own * np.linalg.solve(scaled, own[:, :, None])[:, :, 0], axis=1))
