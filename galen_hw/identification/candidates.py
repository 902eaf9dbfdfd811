"""The candidates of a calibration side by side, and the one that is recommended, with its reason.

All are judged by readings they have not seen: each pose in turn is left out, predicted, and its six errors scored by
one heavy-tailed density (Student's t), the same for all, so that a touched pose cannot decide. An unknown stays only
if the score gains by more than its own uncertainty and the unknown is significant.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import stats

from galen_hw.identification import report
from galen_hw.identification.estimate import Estimate, estimate
from galen_hw.identification.excitation import condition
from galen_hw.identification.fit import Fit, fit
from galen_hw.identification.model import BIAS, MOUNT, PRIOR_ZERO, TILT, Unknowns, drift_names
from galen_hw.identification.poses import Poses
from galen_hw.spatial import Array

SIGNIFICANT: Final = 0.01
LEAST_HOMES: Final = 3
HEAVY_TAIL: Final = 5.0


@dataclass(frozen=True)
class Candidate:
    """One row of the table.

    Args:
        key, title: short name, and what people read.
        unknowns: number of fitted numbers; fit, estimate: None for the report's two steps.
        residual: (n, 6) of the fitted poses; left_out: (n, 6) error of each pose when it was left out.
        score: (n,) log density of the left-out errors; bic: smaller is better.
        p_value: of the unknowns that it adds; 0 to 1, NaN where it adds none.
        note: why it is or is not the one.
    """

    key: str
    title: str
    unknowns: int
    fit: Fit | None
    estimate: Estimate | None
    mass: float
    com: Array
    residual: Array
    left_out: Array
    p_value: float = float("nan")
    score: Array | None = None
    bic: float = float("nan")
    note: str = ""

    @property
    def rms(self) -> Array:
        """(6,) of the residuals."""
        return np.asarray(np.sqrt(np.mean(self.residual**2, axis=0)))

    @property
    def left_out_rms(self) -> Array:
        """(6,) of the errors of poses that were left out."""
        return np.asarray(np.sqrt(np.mean(self.left_out**2, axis=0)))

    @property
    def condition(self) -> float:
        """Condition number of the scaled problem; NaN for the two steps."""
        return float("nan") if self.fit is None else condition(self.fit)


@dataclass(frozen=True)
class Comparison:
    """All candidates, and the key of the recommended one with the reason."""

    candidates: tuple[Candidate, ...]
    recommended: str
    reason: str

    @property
    def best(self) -> Candidate:
        """The recommended candidate."""
        return next(c for c in self.candidates if c.key == self.recommended)


def compare(poses: Poses) -> Comparison:
    """Fit all candidates that these poses allow.

    Args:
        poses: of the whole sweep; those to verify with are not touched.
    """
    rows = poses.fit
    bare = bool(np.any(~rows.tool))
    base = Unknowns(body=bare)
    plain = _joint("joint", "joint least squares", rows, base, robust=False)
    robust = _joint("robust", "joint, robust", rows, base)
    found = [_two_step(rows), plain, robust]
    tied = _zeroing(rows)
    found += [tied] if tied else []
    base_key = "robust"
    if _trusts_zeroing(tied):
        base_key, base = "zeroing", Unknowns(trust_zero=True, body=True)
    extras = _extras(rows, base)
    found += extras
    found = _scored(found, rows)
    return _recommend(found, base_key, rows)


def _joint(key: str, title: str, rows: Poses, unknowns: Unknowns, *, robust: bool = True) -> Candidate:
    found = fit(rows, unknowns, robust=robust)
    what = estimate(found)
    return Candidate(key, title, len(found.theta), found, what, what.mass, what.com, found.residual, _left_out(found))


def _left_out(found: Fit) -> Array:
    """(n, 6) errors of prediction with each pose left out: (1 - H_ii)^-1 r_i, exact for a linear model."""
    white = found.derivative / found.scale[:, :, None]
    size = np.linalg.norm(white.reshape(-1, white.shape[-1]), axis=0) + 1e-300
    scaled = white / size
    information = np.einsum("n,ncp,ncq->pq", found.weight, scaled, scaled)
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    H = found.weight[:, None, None] * np.einsum("ncp,pq,ndq->ncd", scaled, inverse, scaled)
    keep = np.eye(6) - H
    z = (found.residual / found.scale)[..., None]
    return np.asarray(np.linalg.solve(keep + 1e-9 * np.eye(6), z)[..., 0] * found.scale)


def _two_step(rows: Poses) -> Candidate:
    """The report's equations (1) to (8); leaving out by fitting again."""
    body, tool = _report(rows)
    left_out = np.empty((len(rows), 6))
    residual = rows.wrench - _report_prediction(rows, body, tool)
    for i in range(len(rows)):
        others = np.arange(len(rows)) != i
        one = rows.select(~others)
        left_out[i] = (one.wrench - _report_prediction(one, *_report(rows.select(others))))[0]
    n = 12 if np.any(~rows.tool) else 6
    title = "report, eq. (1)-(8)" if np.any(~rows.tool) else "report, eq. (5)-(8)"
    return Candidate("report", title, n, None, None, tool.mass, tool.com, residual, left_out)


def _report(rows: Poses) -> tuple[report.WeightedPoint, report.WeightedPoint]:
    on, off = rows.select(rows.tool), rows.select(~rows.tool)
    known = rows.bias_body
    body = report.NOTHING if known is None else report.WeightedPoint(known.mass * rows.gravity, np.asarray(known.com))
    bare = (off.R, off.wrench) if len(off) >= 3 and rows.zero is not None else None
    return report.two_step(on.R, on.wrench, zero=rows.zero, bare=bare, body=body)


def _report_prediction(rows: Poses, body: report.WeightedPoint, tool: report.WeightedPoint) -> Array:
    with_tool = report.predict(rows.R, rows.zero, body, tool)
    without = report.predict(rows.R, rows.zero, body, report.NOTHING)
    return np.where(rows.tool[:, None], with_tool, without)


def _zeroing(rows: Poses) -> Candidate | None:
    """The sensor still reads zero where it was zeroed: what is constant then shows the bias body."""
    if rows.zero is None or rows.bias_body is not None or np.any(~rows.tool):
        return None
    unknowns = Unknowns(trust_zero=True, body=True)
    found = _joint("zeroing", "joint, zeroing trusted", rows, unknowns)
    assert found.fit is not None
    z = found.fit.theta[[found.fit.model.columns[name] for name in BIAS]] / np.array(PRIOR_ZERO)
    # Three of the six constants cannot come from a weight (two across gravity, a moment along it) and stay biases.
    return replace(found, p_value=float(stats.chi2.sf(float(z @ z), 3)))


def _trusts_zeroing(tied: Candidate | None) -> bool:
    """No poses of the bare sensor: only the zeroing can tell the tool from the bias body."""
    if tied is None or tied.estimate is None:
        return False
    body = tied.estimate.bias_body
    return body is not None and tied.p_value > 1e-3 and 0.0 < body.mass < 2.0


def _extras(rows: Poses, base: Unknowns) -> list[Candidate]:
    tries = [
        ("tilt", "+ tilt of gravity", replace(base, tilt=True), TILT),
        ("mount", "+ sensor mounting", replace(base, mount=True), MOUNT),
    ]
    if _can_drift(rows):
        tries.insert(0, ("drift", "+ linear drift", replace(base, drift=1), drift_names(0)))
    if rows.home.sum() > LEAST_HOMES:
        tries.insert(1, ("drift2", "+ curved drift", replace(base, drift=2), drift_names(1)))
    found = []
    for key, title, unknowns, names in tries:
        if 6 * len(rows) > 2 * len(unknowns.names):
            one = _joint(key, title, rows, unknowns)
            assert one.fit is not None
            found.append(replace(one, p_value=_wald(one.fit, names)))
    return found


def _wald(found: Fit, names: tuple[str, ...]) -> float:
    """Probability of values as large as these if the unknowns were zero."""
    i = [found.model.columns[name] for name in names]
    theta, C = found.theta[i], found.covariance[np.ix_(i, i)]
    size = np.sqrt(np.diag(C)) + 1e-300
    q = float((theta / size) @ np.linalg.solve(C / np.outer(size, size) + 1e-12 * np.eye(len(i)), theta / size))
    return float(stats.f.sf(q / len(i), len(i), max(found.freedom, 1.0)))


def _scored(found: list[Candidate], rows: Poses) -> list[Candidate]:
    """Log density of the left-out errors, one scale a channel for all candidates."""
    reference = next(c for c in found if c.key == "robust")
    assert reference.fit is not None
    sigma = np.maximum(reference.fit.sigma, 1e-12)
    scored = []
    for one in found:
        z = one.left_out / sigma
        density = stats.t.logpdf(z, HEAVY_TAIL).sum(axis=1)
        own = stats.t.logpdf(one.residual / sigma, HEAVY_TAIL).sum()
        bic = one.unknowns * np.log(6 * len(rows)) - 2.0 * own
        scored.append(replace(one, score=density, bic=float(bic)))
    return scored


def _recommend(found: list[Candidate], base_key: str, rows: Poses) -> Comparison:
    chosen = next(c for c in found if c.key == base_key)
    reasons = [_base_reason(chosen)]
    extras = [c for c in found if c.key in ("drift", "drift2", "tilt")]
    better = [c for c in extras if c.p_value < SIGNIFICANT and gain(c, chosen) > 0.0]
    if better:
        chosen = max(better, key=lambda c: float(np.sum(c.score)) if c.score is not None else -np.inf)
        reasons.append(f"{chosen.title.removeprefix('+ ')} predicts left-out poses better (p = {chosen.p_value:.1g})")
        chosen, found = _with_another(chosen, found, rows)
        reasons += ["drift and tilt together still better"] if chosen.key == "both" else []
    else:
        reasons.append("no further unknown predicts left-out poses clearly better")
    return Comparison(tuple(found), chosen.key, "; ".join(reasons))


def _with_another(chosen: Candidate, found: list[Candidate], rows: Poses) -> tuple[Candidate, list[Candidate]]:
    """A drift beside a tilt, or a tilt beside a drift: one can hide the other until it is fitted."""
    assert chosen.fit is not None
    unknowns = chosen.fit.model.unknowns
    added = replace(unknowns, drift=1) if unknowns.tilt else replace(unknowns, tilt=True)
    if not (_can_drift(rows) or unknowns.drift):
        return chosen, found
    drift = "curved drift" if added.drift > 1 else "linear drift"
    both = _joint("both", f"+ {drift} and tilt", rows, added)
    assert both.fit is not None
    both = replace(both, p_value=_wald(both.fit, drift_names(0) if unknowns.tilt else TILT))
    scored = _scored([*found, both], rows)
    wanted = both.p_value < SIGNIFICANT and gain(scored[-1], chosen) > 0.0
    return (scored[-1], scored) if wanted else (chosen, found)


def _can_drift(rows: Poses) -> bool:
    """Returns home (or no word of homes at all) let a drift be told from gravity."""
    return bool(rows.home.sum() >= LEAST_HOMES or rows.time is None or not rows.home.any())


def gain(one: Candidate, other: Candidate) -> float:
    """Gain in score less one standard error of the paired difference."""
    assert one.score is not None
    assert other.score is not None
    difference = one.score - other.score
    return float(difference.sum() - np.sqrt(len(difference)) * difference.std(ddof=1))


def _base_reason(chosen: Candidate) -> str:
    assert chosen.fit is not None
    touched = len(chosen.fit.outliers)
    if chosen.key == "zeroing":
        return "without poses of the bare sensor only the zeroing tells the tool from what else hangs there"
    if touched:
        return f"robust: {touched} of {len(chosen.fit.weight)} poses lie off and are left aside"
    return "all unknowns at once, and a touched pose could not spoil it"
