"""The answer for people: a few lines on the terminal."""

import numpy as np

from galen_hw.diagnosis.result import Diagnosis

VERDICTS = {
    "agrees": "simulation and recording agree",
    "explained": "a mismatch was found and is explained",
    "partly_explained": "a mismatch was found; part of it is explained",
    "unexplained": "a mismatch was found that no named effect explains",
}


def quantity(value: float, std: float | None, unit: str) -> str:
    """A number with its standard deviation and unit, as many digits as it deserves."""
    if std is None or not std > 0.0:
        return f"{value:.4g} {unit}".strip()
    digits = max(3, 2 + _order(abs(value)) - _order(std)) if value else 3
    return f"{value:.{min(digits, 8)}g} ± {std:.2g} {unit}".strip()


def _order(x: float) -> int:
    return int(f"{x:e}".split("e")[1])


def summary(d: Diagnosis) -> str:
    """Verdict, findings, fit, what is open, and notes."""
    lines = [f"{d.recording}: {VERDICTS[d.verdict]}"]
    for finding in d.findings:
        place = ", ".join(finding.joints or finding.channels[:3])
        lines.append(f"  {finding.effect} in {place}: {finding.says}")
        if finding.confounded_with:
            lines.append(f"    could also be: {', '.join(c.effect for c in finding.confounded_with)}")
    before, after, floor = (np.array(list(d.fit[k].values())) for k in ("rmse_before", "rmse_after", "noise_floor"))
    ratio = float(np.exp(np.mean(np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300)))))
    above = float(np.median(after / np.maximum(floor, 1e-300)))
    lines.append(f"  held-out error {ratio:.2f} times lower, {above:.2f} times the noise")
    lines.append(f"  next: {d.next_experiment}")
    lines += [f"  note: {note}" for note in d.notes]
    return "\n".join(lines)
