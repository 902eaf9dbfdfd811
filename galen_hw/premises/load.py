"""What hangs on the sensor, and what it was zeroed with, stays so while a recording lasts."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.physics.rigid import Body
from galen_hw.premises.base import Action, Claim, Remark, Stage, with_matrix
from galen_hw.premises.criteria import CRITERIA
from galen_hw.premises.efforts import Efforts
from galen_hw.premises.wrench_reading import FORCE, TORQUE, at_rest, comparable
from galen_hw.spatial import Array

BODY = 4
"""Mass and first moment: what weight alone shows of a body."""
KINDS = (("zero", slice(0, 6)), ("load", slice(6, 6 + BODY)))


@dataclass(frozen=True)
class _ChangePoint:
    """A change point: two fits on either side of a row.

    Args:
        row: the first of the second part, of the rows looked at.
        kind: "load" or "zero".
        change: (4,) of mass and first moment, or (6,) of the offset.
        std: of these.
        cost: squared residual, whitened; left: (6,) its rms in each channel.
    """

    row: int
    kind: str
    change: Array
    std: Array
    cost: float
    left: Array


class ToolTwice:
    """Tests whether the named tool is named a second time: as a link of the model, or as what hung on a zeroed sensor."""

    KEY: ClassVar[str] = "tool_twice"
    STAGE: ClassVar[Stage] = Stage.LOAD

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark, where one body is named twice and the readings hold it once."""
        if seen.simulation is not None or seen.belief.tool.mass <= 0.0:
            return
        if seen.predict == "effort":
            yield from self._in_efforts(seen)
        if seen.predict != "wrench":
            return
        for what, once in _once(seen):
            left = [_misfit(comparable(one)) for one in (once, seen)]
            if left[0] <= CRITERIA.gross_gain * left[1]:
                yield Remark(self.KEY, what, "", (*FORCE, *TORQUE), Action.REPAIRED, once)
                return

    def _in_efforts(self, seen: Observations) -> Iterator[Remark]:
        """Yield a remark where efforts hold nothing of the tool: which link of a merged URDF holds it cannot be told."""
        efforts, tool = Efforts.of(seen), seen.belief.tool
        if efforts is None:
            return
        robot = efforts.robot.without(tool.mass, tool.com, tool.inertia)
        bare = replace(seen, belief=replace(seen.belief, tool=Body(), robot=robot))
        without = Efforts.of(bare)
        if without is None:
            return
        left = [one.unexplained(one.scene.simulated) for one in (without, efforts)]
        if not left[0] <= CRITERIA.gross_gain * left[1]:
            return  # nor where any of it is not finite
        what = (
            f"the efforts hold nothing of the named tool of {tool.mass:.4g} kg: the robot's model bears it already, in a link, "
            "or it is not on the arm; taken off"
        )
        yield Remark(self.KEY, what, "name it in one place only", efforts.scene.channels, Action.REPAIRED, bare)


def _once(seen: Observations) -> Iterator[tuple[str, Observations]]:
    """Yield what is said, and a wrench's recording with the tool once, for each second name of it."""
    tool, belief = seen.belief.tool, seen.belief
    twin = next((k for k, body in enumerate(belief.distal) if _alike(body, tool)), None)
    if twin is not None:
        what = f"the tool and a link of the model beyond the sensor are one body of {tool.mass:.4g} kg, "
        what += "which the wrench holds once: counted once"
        others = tuple(body for k, body in enumerate(belief.distal) if k != twin)
        yield what, replace(seen, belief=replace(belief, distal=others))
    if belief.bias_body is not None and _alike(belief.bias_body, tool):
        what = f"what hung on the sensor when it was zeroed (bias_body) is the tool itself, {tool.mass:.4g} kg: counted once"
        yield what, replace(seen, belief=replace(belief, tool=Body(), bias_body=tool))


def _alike(body: Body, tool: Body) -> bool:
    """Return whether two bodies are one, as far as a file's digits and a change of frames may say."""
    return bool(
        abs(body.mass - tool.mass) <= CRITERIA.small_turn * tool.mass
        and np.linalg.norm(body.com - tool.com) <= CRITERIA.small_turn * max(float(np.linalg.norm(tool.com)), 0.1)
    )


def _misfit(seen: Observations) -> float:
    """Return the mean square of the residual beside a constant, each channel over its own variance."""
    scene = scene_of(seen)
    missed = np.var(scene.measured - scene.simulated, axis=0)
    return float(np.mean(missed / np.maximum(np.var(scene.measured, axis=0), 1e-300)))


class LoadChange:
    """Tests whether the tool's weight, or the sensor's zero, is another one from some row on.

    Two fits against one: bodies and offsets by least squares on either side of every row (cumulated normal equations), whitened
    by what the better fit leaves. A jump is told from a slow drift by being better than a straight line of the offsets.
    """

    KEY: ClassVar[str] = "load_change"
    STAGE: ClassVar[Stage] = Stage.LOAD

    def examine(self, seen: Observations) -> Iterator[Remark]:
        """Yield at most one remark; in a motion a picked-up part is repaired and claimed, in poses it is refused."""
        if seen.predict != "wrench" or seen.simulation is not None or not seen.has_all(*FORCE, *TORQUE):
            return
        split, some = self._change_point(_with_tool(seen))
        if split is None:
            return
        where, at = _moment(some, split.row)
        if split.kind == "zero":
            sizes = ", ".join(f"{c:.3g}" for c in split.change)
            what = f"the sensor was zeroed anew {where}: its offset jumps by ({sizes}) N, N m"
            # In a motion a step of the offset has a name of its own, and the search finds its moment.
            action = Action.REFUSED if seen.time is None else Action.NOTE
            row = round(at) if action is Action.REFUSED else 0
            yield Remark(self.KEY, what, "split the recording there", (*FORCE, *TORQUE), action, split=row)
            return
        mass = float(split.change[0])
        what = f"{'picked up' if mass > 0.0 else 'put down'} {where}: the load changes by {mass:+.4g} +- {split.std[0]:.2g} kg"
        if seen.time is None or seen.belief.tool.mass <= 0.0:
            todo, row = "split the recording there, one tool a part", round(at) if seen.time is None else 0
            yield Remark(self.KEY, what, todo, (*FORCE, *TORQUE), Action.REFUSED, split=row)
            return
        yield self._claimed(seen, at)

    def _change_point(self, seen: Observations) -> tuple[_ChangePoint | None, Observations]:
        """Return the change point to believe, and the rows that its row counts in."""
        moving = seen.belief.dynamic and seen.time is not None
        # What accelerates the load may be the larger part of it: a motion is differentiated as a whole, then thinned out.
        some = comparable(seen) if moving else at_rest(comparable(seen, CRITERIA.most_rows))
        scene = scene_of(some)
        port = scene.body_port() if len(some) > CRITERIA.fewest_split else None
        if port is None:
            return None, some
        rows = np.linspace(0, len(some) - 1, min(len(some), CRITERIA.most_rows)).astype(int)
        split = _best_change((scene.measured - scene.simulated)[rows], port[rows])
        return None if split is None else replace(split, row=int(rows[split.row])), some

    def _claimed(self, seen: Observations, at: float) -> Remark:
        """Return the repair and the claim: the recording without what the change adds from its moment on."""
        time = seen.time
        assert time is not None, "claimed only of motions"
        port = scene_of(seen).body_port()
        assert port is not None, "wrenches have one"
        change, std, at = _refined(seen, port, at)
        after = (time >= at)[:, None]
        wrench = seen.matrix(*FORCE, *TORQUE) - np.where(after, port @ change, 0.0)
        mass = float(change[0])
        com = change[1:BODY] / mass
        parameters = {"mass": (mass, float(std[0]), "kg"), "moment": (at, 0.0, "s")}
        parameters |= {f"com_{a}": (float(com[k]), float(std[1 + k] / abs(mass)), "m") for k, a in enumerate("xyz")}
        claim = Claim("payload", parameters, (*FORCE, *TORQUE))
        repaired = with_matrix(seen, (*FORCE, *TORQUE), wrench)
        text = f"the load changes by {mass:+.4g} +- {std[0]:.2g} kg from {at:.4g} s on"
        return Remark(self.KEY, text, "record each load by itself", (*FORCE, *TORQUE), Action.REPAIRED, repaired, claim)


def _refined(seen: Observations, port: Array, at: float) -> tuple[Array, Array, float]:
    """Fit the change (10,) of the inertial parameters, its standard deviations and the moment, on all rows with acceleration."""
    time = seen.time
    assert time is not None, "claimed only of motions"
    y = seen.matrix(*FORCE, *TORQUE)
    good = np.isfinite(y).all(axis=1) & np.isfinite(port).all(axis=(1, 2))
    step = max(2.0 * float(np.ptp(time)) / CRITERIA.most_rows, 1e-9)
    candidates = time[good & (np.abs(time - at) <= step)]
    base = np.concatenate([np.tile(np.eye(6), (int(good.sum()), 1, 1)), port[good]], axis=2)
    sigma = _spread(base.reshape(-1, base.shape[2]), y[good])
    white, b = base / sigma[:, None], (y[good] / sigma).reshape(-1)
    width = base.shape[2]
    best: tuple[float, float, Array, Array] | None = None
    for t in candidates[:: max(len(candidates) // 100, 1)]:
        after = np.where((time[good] >= t)[:, None, None], white[:, :, 6:], 0.0)
        X = np.concatenate([white, after], axis=2).reshape(-1, width + port.shape[2])
        # Inertia that the motion does not show stays where it is.
        theta, _, rank, _ = np.linalg.lstsq(X, b, rcond=1e-6)
        left = b - X @ theta
        cost = float(left @ left)
        if best is None or cost < best[0]:
            covariance = np.linalg.pinv(X.T @ X, rcond=1e-12, hermitian=True) * cost / max(len(b) - int(rank), 1)
            best = (cost, float(t), theta[width:], np.sqrt(np.maximum(np.diag(covariance)[width:], 0.0)))
    assert best is not None, "there is at least one candidate"
    return best[2], best[3], best[1]


def _with_tool(seen: Observations) -> Observations:
    """Return the rows with the tool on: a sweep of our own says which these are, and takes it off itself."""
    on = seen.columns.get("covariate.tool")
    return seen if on is None else seen.taken(np.asarray(on > 0.5))


def _moment(some: Observations, row: int) -> tuple[str, float]:
    """Return where a change point is, in words, and its time (s) or row."""
    if some.time is None:
        return f"before pose {row + 1}", float(row)
    return f"at {some.time[row]:.4g} s", float(some.time[row])


def _best_change(y: Array, port: Array) -> _ChangePoint | None:
    """Return the change point that is far better than one fit and than a drift; None where there is none.

    Args:
        y: (N, 6) measured less simulated.
        port: (N, 6, 10) reading by inertial parameters.
    """
    base = np.concatenate([np.tile(np.eye(6), (len(y), 1, 1)), port[:, :, :BODY]], axis=2)
    best, sigma = None, _spread(base.reshape(-1, 10), y)
    for _ in range(2):
        # First by what one fit leaves, then by what the better of the two leaves: channels have their own noise.
        best = _best_of_kinds(base / sigma[:, None], y / sigma)
        sigma = np.maximum(best.left * sigma, 1e-9 * np.abs(y).max())
    A, b = base / sigma[:, None], y / sigma
    assert best is not None, "there is always a best row"
    ramp = np.linspace(-0.5, 0.5, len(y))[:, None, None] * A[:, :, :6]
    whole = _cost(A.reshape(-1, 10), b.reshape(-1))
    drifting = _cost(np.concatenate([A, ramp], axis=2).reshape(-1, 16), b.reshape(-1))
    split = _best_of_kinds(A, b)
    sure = np.abs(split.change) > CRITERIA.standard_errors * split.std
    if split.cost > CRITERIA.gross_gain * min(whole, drifting) or not (sure[0] if split.kind == "load" else sure.any()):
        return None
    return split


def _best_of_kinds(A: Array, b: Array) -> _ChangePoint:
    """Return the best change point of either kind, of whitened A (N, 6, 10) and b (N, 6)."""
    found = [(_scan_rows(A, b, columns), kind, columns) for kind, columns in KINDS]
    (row, _), kind, columns = min(found, key=lambda one: one[0][1])
    return _fitted(A, b, columns, row, kind)


def _spread(X: Array, y: Array) -> Array:
    """Return the rms residual (6,) of each channel after a fit of y (N, 6) by X (6 N, k)."""
    left = y - (X @ np.linalg.lstsq(X, y.reshape(-1), rcond=1e-9)[0]).reshape(-1, 6)
    return np.asarray(np.maximum(np.sqrt(np.mean(left**2, axis=0)), 1e-12))


def _cost(X: Array, b: Array) -> float:
    left = b - X @ np.linalg.lstsq(X, b, rcond=None)[0]
    return float(left @ left)


def _scan_rows(A: Array, b: Array, columns: slice) -> tuple[int, float]:
    """Return the change point with the least residual, and its square, of fits with some columns (6, k) free anew from it on.

    By cumulated normal equations: every row costs one small solution, whatever the length of the recording.
    """
    part = A[:, :, columns]
    n, p, k = len(A), A.shape[2], part.shape[2]
    G, h, total = np.einsum("nci,ncj->ij", A, A), np.einsum("nci,nc->i", A, b), float(np.sum(b**2))
    cross = np.cumsum(np.einsum("nci,ncj->nij", A, part)[::-1], axis=0)[::-1]
    own = np.cumsum(np.einsum("nci,ncj->nij", part, part)[::-1], axis=0)[::-1]
    right = np.cumsum(np.einsum("nci,nc->ni", part, b)[::-1], axis=0)[::-1]
    least = CRITERIA.fewest_split // 2
    rows = np.arange(least, n - least)
    M = np.empty((len(rows), p + k, p + k))
    M[:, :p, :p], M[:, :p, p:], M[:, p:, :p], M[:, p:, p:] = G, cross[rows], np.swapaxes(cross[rows], 1, 2), own[rows]
    M += 1e-10 * np.trace(G) / p * np.eye(p + k)
    v = np.concatenate([np.tile(h, (len(rows), 1)), right[rows]], axis=1)
    left = total - np.einsum("ni,ni->n", v, np.linalg.solve(M, v[:, :, None])[:, :, 0])
    best = int(np.argmin(left))
    return int(rows[best]), float(left[best])


def _fitted(A: Array, b: Array, columns: slice, row: int, kind: str) -> _ChangePoint:
    part = np.where((np.arange(len(A)) >= row)[:, None, None], A[:, :, columns], 0.0)
    X, y = np.concatenate([A, part], axis=2).reshape(-1, A.shape[2] + part.shape[2]), b.reshape(-1)
    theta, _, rank, _ = np.linalg.lstsq(X, y, rcond=1e-6)
    left = y - X @ theta
    cost = float(left @ left)
    covariance = np.linalg.pinv(X.T @ X, rcond=1e-12, hermitian=True) * cost / max(len(y) - int(rank), 1)
    at = slice(A.shape[2], None)
    spread = np.sqrt(np.mean(left.reshape(-1, 6) ** 2, axis=0))
    return _ChangePoint(row, kind, theta[at], np.sqrt(np.maximum(np.diag(covariance)[at], 0.0)), cost, spread)
