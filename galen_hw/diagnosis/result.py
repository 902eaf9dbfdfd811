"""The answer as data: what `--json` writes, key by key as in `docs/diagnosis.md`."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

Verdict = Literal["agrees", "explained", "partly_explained", "unexplained"]


@dataclass(frozen=True)
class Value:
    """A parameter with its standard deviation."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Confusion:
    """Another effect, or the same in other joints, that this recording cannot tell from the one found."""

    effect: str
    why: str


UNKNOWN: Final = "unknown"
"""The effect of a finding that has no name."""


@dataclass
class Finding:
    """One effect, in all its channels and joints."""

    effect: str
    channels: list[str]
    joints: list[str]
    says: str
    parameters: dict[str, Value]
    evidence: dict[str, float]
    confounded_with: list[Confusion] = field(default_factory=list)

    @property
    def named(self) -> bool:
        """Whether it is a kind of physics, and not structure without a name."""
        return self.effect != UNKNOWN

    @property
    def rivals(self) -> list[Confusion]:
        """Other effects that it could be."""
        return [c for c in self.confounded_with if c.effect != self.effect]

    @property
    def takes(self) -> str:
        """Its gain on held-out data, in words."""
        gain = self.evidence["heldout_gain"]
        return f"takes {100 * gain:.{0 if gain >= 0.01 else 1}f} % of the unexplained error"


@dataclass
class Diagnosis:
    """Everything that is known in the end.

    Besides what is specified: `notes` (one line each), `premises` (what was noted, repaired or refused before anything was
    fitted), `terms` (the saved model), the channels' `units`, and whether there is a `clock`: else times are rows.
    """

    recording: str
    holdout: str
    predict: str
    verdict: Verdict
    channels: list[dict[str, Any]]
    where: list[dict[str, Any]]
    when: list[list[float]]
    findings: list[Finding]
    fit: dict[str, dict[str, float]]
    next_experiment: str
    notes: list[str] = field(default_factory=list)
    premises: list[dict[str, Any]] = field(default_factory=list)
    terms: list[dict[str, Any]] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    clock: bool = True

    def to_json(self) -> dict[str, Any]:
        """Return the answer as specified in `docs/diagnosis.md`; numbers that are not finite become null."""
        answer = {
            "schema": 1,
            "recording": self.recording,
            "holdout": self.holdout,
            "predict": self.predict,
            "verdict": self.verdict,
            "locate": {"channels": self.channels, "where": self.where, "when": self.when},
            "findings": [asdict(finding) for finding in self.findings],
            "fit": self.fit,
            "next_experiment": self.next_experiment,
            "premises": self.premises,
        }
        return {key: _finite(value) for key, value in answer.items()}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
