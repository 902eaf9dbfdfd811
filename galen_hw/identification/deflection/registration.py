"""Registration of the tracker: where the robot's base is for it, from moments without force (report, 13-14)."""

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from galen_hw.errors import UsageError
from galen_hw.spatial import Array, inverse, quaternion_from_rotation, rotation_from_quaternion, rotation_log, transform

MOVED_M: Final = 5e-4
MOVED_RAD: Final = 2e-3
JUMP_S: Final = 0.1
LEAST_PLACES: Final = 4


@dataclass(frozen=True)
class Registration:
    """The reference marker's place on the robot's base.

    Args:
        T_marker_base: (4, 4) g_fB of the report's equation (13): base in the reference marker's frame.
        T_tip_tool_marker: (4, 4) tool marker in the tip frame; identity where it sits on the tip.
        position_std: (3,) m and rotation_std: (3,) rad, one sigma of the mean.
        scatter: (2,) rms of a single moment, m and rad.
        used: rows that were taken.
    """

    T_marker_base: Array
    T_tip_tool_marker: Array
    position_std: Array
    rotation_std: Array
    scatter: tuple[float, float]
    used: NDArray[np.bool_]


def register(
    T_tracker_marker: Array,
    T_tracker_tool: Array,
    T_base_tip: Array,
    *,
    T_tip_tool_marker: Array | None = None,
) -> Registration:
    """g_fB = g_Tf^-1 g_Tt g_Bt^-1 over rows without force, the mean taken on the rotations' manifold.

    Args:
        T_tracker_marker: (N, 4, 4) reference marker; T_tracker_tool: (N, 4, 4) tool marker, in the tracker's frame.
        T_base_tip: (N, 4, 4) tip as the robot reports it.
        T_tip_tool_marker: (4, 4) where the tool marker sits; on the tip if None.

    Raises:
        UsageError: fewer than ten rows in which both markers were seen.
    """
    offset = np.eye(4) if T_tip_tool_marker is None else T_tip_tool_marker
    seen = np.asarray(np.isfinite(T_tracker_marker + T_tracker_tool).all(axis=(1, 2)))
    if np.count_nonzero(seen) < 10:
        raise UsageError(
            f"both markers were seen in {np.count_nonzero(seen)} moments only",
            where="registration",
            todo="turn the markers to the tracker and keep still for two seconds",
        )
    each = inverse(T_tracker_marker[seen]) @ T_tracker_tool[seen] @ inverse(T_base_tip[seen] @ offset)
    used, mean = _robust_mean(each)
    keep = seen.copy()
    keep[seen] = used
    p, r = _deviations(each[used], mean)
    n = max(int(np.count_nonzero(used)), 2)
    return Registration(
        mean,
        offset,
        p.std(axis=0, ddof=1) / np.sqrt(n),
        r.std(axis=0, ddof=1) / np.sqrt(n),
        (float(np.sqrt(np.mean(np.sum(p**2, axis=1)))), float(np.sqrt(np.mean(np.sum(r**2, axis=1))))),
        keep,
    )


def true_tip(registration: Registration, T_tracker_marker: Array, T_tracker_tool: Array) -> Array:
    """Tip in the base as the tracker sees it, g_Bt = g_fB^-1 g_Tf^-1 g_Tt (14), (N, 4, 4)."""
    seen = inverse(registration.T_marker_base) @ inverse(T_tracker_marker) @ T_tracker_tool
    return np.asarray(seen @ inverse(registration.T_tip_tool_marker))


def _robust_mean(each: Array) -> tuple[NDArray[np.bool_], Array]:
    """Mean of poses with those left out that lie beyond four robust sigmas of position."""
    used = np.ones(len(each), dtype=bool)
    mean = _mean(each)
    for _ in range(5):
        p, _r = _deviations(each, mean)
        size = np.linalg.norm(p, axis=1)
        limit = 4.0 * max(1.4826 * float(np.median(size)), 1e-9)
        now = size <= limit
        mean = _mean(each[now])
        if np.array_equal(now, used):
            break
        used = now
    return used, mean


def _mean(each: Array) -> Array:
    """Mean position, and the rotation whose quaternion is the principal axis of all (Markley et al. 2007)."""
    q = quaternion_from_rotation(each[:, :3, :3])
    _, vectors = np.linalg.eigh(q.T @ q)
    return transform(rotation_from_quaternion(vectors[:, -1]), each[:, :3, 3].mean(axis=0))


def _deviations(each: Array, mean: Array) -> tuple[Array, Array]:
    """Positions (N, 3) m and rotation vectors (N, 3) rad from the mean."""
    return each[:, :3, 3] - mean[:3, 3], rotation_log(mean[:3, :3].T @ each[:, :3, :3])


@dataclass
class MarkerWatch:
    """Notices while recording what is else found too late: a moved base or marker, swapped handles, lost frames.

    Args:
        rate_hz: the tracker's frame rate, its frame number is the clock.
        moved_m, moved_rad: how far the reference marker may wander before it counts as moved.
        frames: so many first frames are averaged, and so many in a row must lie apart: noise alone moves nothing.
    """

    rate_hz: float = 60.0
    moved_m: float = MOVED_M
    moved_rad: float = MOVED_RAD
    frames: int = 12
    _first: list[Array] = field(default_factory=list)
    _home: Array | None = None
    _away: int = 0
    _frame: int | None = None
    _time_s: float = 0.0
    _last: Array | None = None

    def look(self, frame: int, time_s: float, T_tracker_marker: Array, T_tracker_tool: Array) -> list[str]:
        """One frame of both markers (4, 4), NaN where missing; what is wrong with it, a line each."""
        lines = []
        if self._frame is not None:
            lines += self._clock(frame, time_s)
        self._frame, self._time_s = frame, time_s
        both = np.stack([T_tracker_marker, T_tracker_tool])
        if self._last is not None and np.array_equal(both, self._last):
            lines.append(f"frame {frame} repeats the poses of the one before")
        self._last = both
        if np.isfinite(T_tracker_marker).all():
            lines += self._reference(T_tracker_marker, T_tracker_tool)
        return lines

    def _clock(self, frame: int, time_s: float) -> list[str]:
        assert self._frame is not None
        step = frame - self._frame
        if step == 0:
            return [f"frame {frame} came twice"]
        if step < 0:
            return ["the frame number fell back: the tracker was restarted, record this set again"]
        lines = [f"{step - 1} frame(s) lost before {frame}"] if step > 1 else []
        jump = (time_s - self._time_s) - step / self.rate_hz
        if abs(jump) > JUMP_S:
            lines.append(f"the clock jumped by {jump:+.2f} s, record this set again")
        return lines

    def _reference(self, T_tracker_marker: Array, T_tracker_tool: Array) -> list[str]:
        if self._home is None:
            self._first.append(T_tracker_marker)
            self._home = _mean(np.array(self._first)) if len(self._first) >= self.frames else None
            return []
        p, r = _deviations(T_tracker_marker[None], self._home)
        moved, turned = float(np.linalg.norm(p)), float(np.linalg.norm(r))
        self._away = self._away + 1 if moved > self.moved_m or turned > self.moved_rad else 0
        if self._away < self.frames:
            return []
        if np.isfinite(T_tracker_tool).all():
            q, _ = _deviations(T_tracker_tool[None], self._home)
            if float(np.linalg.norm(q)) <= self.moved_m:
                return ["tool and reference marker have changed places: the handles are swapped"]
        return ["the reference marker or the tracker was moved: put it back, or register again in a new session"]


@dataclass(frozen=True)
class Places:
    """Where both markers sit, found together.

    Args:
        T_marker_base: (4, 4) base in the reference marker's frame; T_tip_tool: (4, 4) tool marker in the tip's.
        position_std: (3,) m and rotation_std: (3,) rad of the base, one sigma (jackknife over the configurations; NaN
            for fewer than five of them).
        scatter_m, scatter_rad: rms of what is left at one configuration.
    """

    T_marker_base: Array
    T_tip_tool: Array
    position_std: Array
    rotation_std: Array
    scatter_m: float
    scatter_rad: float

    def off(self, T_marker_tool: Array, T_base_tip: Array) -> tuple[float, float]:
        """How far (m) and turned (rad) a tool marker (4, 4) is from where a tip (4, 4) says that it is."""
        p, r = _deviations(T_marker_tool[None], self.T_marker_base @ T_base_tip @ self.T_tip_tool)
        return float(np.linalg.norm(p)), float(np.linalg.norm(r))

    @property
    def limits(self) -> tuple[float, float]:
        """Beyond these m and rad a marker or the base has moved: the least that matters, and four of the scatter."""
        return MOVED_M + 4.0 * self.scatter_m, MOVED_RAD + 4.0 * self.scatter_rad


def register_both(T_marker_tool: Array, T_base_tip: Array) -> Places:
    """Base in the reference marker's frame and tool marker in the tip's, neither known beforehand: M_i = X B_i Z.

    Rotations from the turns between poses, the places by least squares (robot-world and hand-eye; Shah 2013 states the
    problem).

    Args:
        T_marker_tool: (N, 4, 4) tool marker as the reference marker sees it, one a configuration without force.
        T_base_tip: (N, 4, 4) tip as the robot reports it.

    Raises:
        UsageError: fewer than four configurations, or all turned about one axis.
    """
    M, B = np.asarray(T_marker_tool), np.asarray(T_base_tip)
    X, Z = _solve_both(M, B)
    p, r = _each_deviation(M, X @ B @ Z)
    scatter = [float(np.sqrt(np.mean(np.sum(v**2, axis=1)))) for v in (p, r)]
    count, others = len(M), []
    for left_out in range(count) if count > LEAST_PLACES else ():
        keep = np.arange(count) != left_out
        with suppress(UsageError):  # The rest may be turned about one axis only.
            others.append(_solve_both(M[keep], B[keep])[0])
    stds = np.full((2, 3), np.nan)
    if len(others) == count:
        spread = [v - v.mean(axis=0) for v in _deviations(np.array(others), X)]
        stds = np.array([np.sqrt((count - 1) / count * np.sum(v**2, axis=0)) for v in spread])
    return Places(X, Z, stds[0], stds[1], *scatter)


def _each_deviation(each: Array, others: Array) -> tuple[Array, Array]:
    """Positions (N, 3) m and rotation vectors (N, 3) rad of poses from one other each."""
    turns = np.swapaxes(others[:, :3, :3], 1, 2) @ each[:, :3, :3]
    return each[:, :3, 3] - others[:, :3, 3], rotation_log(turns)


def _solve_both(M: Array, B: Array) -> tuple[Array, Array]:
    """X and Z (4, 4) of `register_both`."""
    i, j = np.triu_indices(len(M), 1)
    a = rotation_log(M[i, :3, :3] @ np.swapaxes(M[j, :3, :3], 1, 2))
    b = rotation_log(B[i, :3, :3] @ np.swapaxes(B[j, :3, :3], 1, 2))
    spread = np.linalg.svd(b, compute_uv=False)
    if len(M) < LEAST_PLACES or spread[1] < 0.1 * spread[0]:
        raise UsageError(
            f"{len(M)} configurations do not tell where the markers sit",
            where="registration",
            todo="hold the tool still at four or more places, turned about two axes",
        )
    U, _, Vt = np.linalg.svd(a.T @ b)
    R_x = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    R_z = _mean(transform(np.swapaxes(R_x @ B[:, :3, :3], 1, 2) @ M[:, :3, :3], np.zeros((len(M), 3))))[:3, :3]
    A = np.concatenate([R_x @ B[:, :3, :3], np.tile(np.eye(3), (len(M), 1, 1))], axis=2).reshape(-1, 6)
    y = (M[:, :3, 3] - B[:, :3, 3] @ R_x.T).reshape(-1)
    t = np.linalg.lstsq(A, y, rcond=None)[0]
    return transform(R_x, t[3:]), transform(R_z, t[:3])
