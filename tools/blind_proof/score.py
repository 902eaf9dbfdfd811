"""From verdicts and unsealed truth to scores. Failures are kept, they are printed first."""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from galen_hw.tools.blind_proof.generator.noise import averaged

PREMISE_WORDS = re.compile(r"axes|axis|swap|sign|clock|delay|unit|degree|N mm|scale", re.IGNORECASE)


NAMED = "rmse_named_"
"""Begins the parameters of `unknown` that say what the findings with a name leave."""


def by_names(verdict: dict[str, Any]) -> dict[str, float]:
    """Held-out rms a channel of the findings with a name alone, in the channel's unit."""
    parameters = [item for f in verdict["findings"] for item in f["parameters"].items()]
    without = {k.removeprefix(NAMED): float(v["value"]) for k, v in parameters if k.startswith(NAMED)}
    return dict(verdict["fit"]["rmse_after"]) | without


TOLD_APART = 3.3
"""Standard errors between two curves: whoever knows both takes one for the other in one recording of twenty."""


@dataclass
class Scored:
    """One case, judged.

    Args:
        truth, verdict: as unsealed and as given (None when the tool refused the recording).
        found: effects of the findings, in order.
        stated: the first finding's effect and what it may be confused with.
        right: whether the case's own question was answered rightly; why: in words, for the list of failures.
    """

    truth: dict[str, Any]
    verdict: dict[str, Any] | None
    exit_code: int
    seconds: float
    found: list[str] = field(default_factory=list)
    stated: set[str] = field(default_factory=set)
    right: bool = False
    first: bool = False
    in_class: bool = False
    why: str = ""

    @property
    def wanted(self) -> list[str]:
        """Keys of what was concealed."""
        return [e["key"] for e in self.truth["effects"]]

    @property
    def near(self) -> list[float]:
        """Standard errors to look-alikes, of the effects that are too near for a test to tell, see `generator.look_alikes`."""
        known = [e.get("apart") for e in self.truth["effects"]]
        return [apart for apart in known if apart is not None and apart < TOLD_APART]

    @property
    def a_guess(self) -> bool:
        """Return whether no test of the recording could tell one of the effects from its look-alike."""
        return bool(self.near)

    @property
    def detected(self) -> bool:
        """The tool said that something is not as modelled."""
        return self.verdict is not None and self.verdict["verdict"] != "agrees"

    @property
    def jaccard(self) -> float:
        """Overlap of the found set with the concealed set."""
        a, b = set(self.found), set(self.wanted)
        return len(a & b) / len(a | b) if a | b else 1.0

    def rmse_ratio(self, *, named: bool = False) -> float | None:
        """Held-out error over that of the true formula, rms over touched channels; None without a second run.

        `named`: without what the tool predicts under no name.
        """
        noise = self.truth["holdout_noise_rms"]
        if self.verdict is None or not noise or not self.truth.get("second_run"):
            return None
        # The tool judges means of neighbouring rows, in which the truth's noise is less as well.
        rows = self.verdict["fit"].get("rows_averaged")
        if rows is None:
            return None
        touched = sorted({c for e in self.truth["effects"] for c in e["channels"]} or set(noise))
        after = by_names(self.verdict) if named else self.verdict["fit"]["rmse_after"]
        kind = self.truth["noise"]
        ratios = [after[c] / (noise[c] * averaged(kind, round(rows[c]))) for c in touched if c in after]
        return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def score(truth: dict[str, Any], answer: dict[str, Any]) -> Scored:
    """Judge one case."""
    verdict = answer["json"]
    case = Scored(truth, verdict, answer["exit"], answer["seconds"])
    if verdict is not None:
        case.found = [f["effect"] for f in verdict["findings"]]
        if verdict["findings"]:
            head = verdict["findings"][0]
            case.stated = {head["effect"], *(c["effect"] for c in head.get("confounded_with", []))}
    _judge(case, answer["said"])
    return case


def _judge(case: Scored, said: str) -> None:
    """Fill in `right`, `first`, `in_class` and `why`."""
    share = case.truth["share"]
    if "Traceback" in said or (case.verdict is None and share != "premise"):
        case.why = f"no verdict (exit {case.exit_code}): {said.strip().splitlines()[-1] if said.strip() else 'silent'}"
        return
    if share == "premise":
        confident = case.verdict is not None and case.verdict["verdict"] == "explained"
        delay = case.truth["premise"] == "clock offset" and case.found[:1] == ["time_delay"]
        case.right = delay or (bool(PREMISE_WORDS.search(said)) and not confident)
        case.why = f"{case.truth['premise']}: {_short(case)}"
        return
    if share == "null":
        case.right = case.verdict["verdict"] == "agrees" and not case.found  # type: ignore[index]
    elif share == "outside":
        case.right = case.verdict["verdict"] in {"partly_explained", "unexplained"}  # type: ignore[index]
    else:
        _judge_named(case)
    case.why = f"{'+'.join(case.wanted) or 'nothing'} ({_severity(case)}): {_short(case)}"


def _judge_named(case: Scored) -> None:
    """Single and several: first, within the stated class, and the exact set."""
    wanted = set(case.wanted)
    if case.truth["mask"] == "temperature not recorded":
        # The cause cannot be named for certain; drift with temperature among its confusions is the full answer.
        case.first = bool(case.found) and case.found[0] in {"drift", "temperature"}
        case.in_class = "temperature" in case.stated
        case.right = case.first and (case.in_class or len(wanted) > 1)
        return
    case.first = bool(case.found) and case.found[0] in wanted
    case.in_class = bool(case.stated & wanted)
    case.right = case.first if case.truth["share"] == "single" and not case.truth["mask"] else set(case.found) == wanted


def _severity(case: Scored) -> str:
    return f"{case.truth['group']}, {case.truth['noise']}, SNR " + "/".join(
        str(e["snr"]) for e in case.truth["effects"]
    )


def _short(case: Scored) -> str:
    if case.verdict is None:
        return f"refused (exit {case.exit_code})"
    return f"{case.verdict['verdict']}, {'+'.join(case.found) or 'no finding'}"


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.96, hits / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))
