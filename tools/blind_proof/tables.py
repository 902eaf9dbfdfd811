"""The figures that the proof promises, computed from scored cases."""

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from galen_hw.tools.blind_proof.generator.case import SNR_LEVELS
from galen_hw.tools.blind_proof.score import Scored, wilson


@dataclass(frozen=True)
class Figure:
    """One promised figure: what, what was promised, what was reached, and whether that is enough."""

    what: str
    promised: str
    reached: str
    good: bool


OWN = {"tool", "named", "name"}
"""Of a case that the rivals had too: what is not theirs."""


def share(cases: list[Scored], attribute: str) -> tuple[int, int]:
    """How many of the cases have the attribute, of how many."""
    return sum(bool(getattr(c, attribute)) for c in cases), len(cases)


def of(cases: list[Scored], *shares: str, plain: bool = True) -> list[Scored]:
    """Cases of the given shares; `plain` leaves masked ones out."""
    return [c for c in cases if c.truth["share"] in shares and not (plain and c.truth["mask"])]


def figures(cases: list[Scored], rivals: list[dict[str, Any]]) -> list[Figure]:
    """All promised figures."""
    out = []
    nulls = of(cases, "null")
    wrong = sum(not c.right for c in nulls)
    out.append(_row("false alarms on null cases", "<= 1 %", wrong, len(nulls), good=wrong <= 0.01 * len(nulls)))
    for level, least in ((0.2, 0.70), (0.4, 0.90), (0.8, 0.97)):
        some = [c for c in of(cases, "single") if c.truth["effects"][0]["snr"] == level]
        hits, n = share(some, "first")
        out.append(_row(f"right effect first, SNR {level}", f">= {least:.2f}", hits, n, good=hits >= least * n))
        able = [c for c in some if not c.a_guess]
        if len(able) < n:
            what = f"the same without {n - len(able)} that no test could tell from a look-alike"
            hits, n = share(able, "first")
            out.append(_row(what, f">= {least:.2f}", hits, n, good=hits >= least * n))
    some = [c for c in of(cases, "single") if c.truth["effects"][0]["snr"] == 0.8]
    hits = sum(c.first or c.in_class for c in some)
    stated = np.mean([len(c.stated) for c in some if c.stated] or [0])
    what = f"first or in the stated class (of {stated:.1f} effects on average), SNR 0.8"
    out.append(_row(what, ">= 0.99", hits, len(some), good=hits >= 0.99 * len(some)))
    several = of(cases, "several")
    hits, n = share(several, "right")
    out.append(_row("pairs and triples, exact set", ">= 0.70", hits, n, good=hits >= 0.70 * n))
    jaccard = float(np.mean([c.jaccard for c in several])) if several else 1.0
    out.append(Figure("pairs and triples, Jaccard", ">= 0.85", f"{jaccard:.2f}", jaccard >= 0.85))
    able = [c for c in several if not c.a_guess]
    if len(able) < n:
        what = f"exact set without {n - len(able)} of which no test could tell one from its look-alike"
        hits, n = share(able, "right")
        out.append(_row(what, ">= 0.70", hits, n, good=hits >= 0.70 * n))
    hits, n = share(of(cases, "outside"), "right")
    out.append(_row("outside the vocabulary, SNR 1: said so", ">= 0.95", hits, n, good=hits >= 0.95 * n))
    named = of(cases, "single", "several")
    false_unknown = sum("unknown" in c.found for c in named)
    good = false_unknown <= 0.02 * len(named)
    out.append(_row("false `unknown` on others", "<= 2 %", false_unknown, len(named), good=good))
    out += _fit_figures(cases)
    out += _parameter_figures(cases)
    if rivals:
        out += _rival_figures(rivals, {c.truth["name"] for c in of(cases, "single", "several", plain=False)})
    hits, n = share(of(cases, "premise"), "right")
    out.append(_row("wrong premises noticed", "all", hits, n, good=hits == n))
    return out


def _rival_figures(rivals: list[dict[str, Any]], named: set[str]) -> list[Figure]:
    """How often the best rival was beaten: of all, and where the physics is of the vocabulary."""
    best = {row["name"]: row[best_rival(row)] for row in rivals}
    beaten = {row["name"]: row["tool"] < best[row["name"]] for row in rivals}
    # Better than the formula that made the data is luck, and nothing can be better than it but by luck.
    lucky = {name for name, error in best.items() if error < 1.0}
    some = {
        "rivals on held-out runs, beaten": set(beaten),
        "the same where the physics is of the vocabulary": set(beaten) & named,
    }
    if lucky:
        some[f"the same without {len(lucky)} where a rival was nearer than the true formula"] = set(beaten) - lucky
    return [_won(what, [beaten[name] for name in sorted(names)]) for what, names in some.items() if names]


def best_rival(row: dict[str, Any]) -> str:
    """The name of the rival with the smallest error in one case."""
    return min((name for name in row if name not in OWN), key=row.__getitem__)


def _won(what: str, won: list[bool]) -> Figure:
    return _row(what, "> 0.95", sum(won), len(won), good=sum(won) > 0.95 * len(won))


def _row(what: str, promised: str, hits: int, n: int, *, good: bool) -> Figure:
    low, high = wilson(hits, n)
    rate = hits / n if n else float("nan")
    return Figure(what, promised, f"{rate:.3f} ({hits} of {n}; 95 %: {low:.2f} to {high:.2f})", good)


def _fit_figures(cases: list[Scored]) -> list[Figure]:
    """Held-out error over that of the true formula, on cases that were detected at SNR 0.8 and more."""
    ratios = [c.rmse_ratio() for c in cases if c.truth["share"] in {"single", "several"}]
    known = np.array([r for r in ratios if r is not None])
    if not len(known):
        return []
    median, high = float(np.median(known)), float(np.quantile(known, 0.9))
    return [
        Figure("held-out error over the true formula's, median", "<= 1.05", f"{median:.3f}", median <= 1.05),
        Figure("held-out error over the true formula's, 90 %", "<= 1.2", f"{high:.3f}", high <= 1.2),
    ]


class ParameterRow(NamedTuple):
    """A parameter as concealed and as found, with the standard deviation that was claimed."""

    effect: str
    name: str
    true: float
    found: float
    std: float

    @property
    def error(self) -> float:
        """How far off, signs aside: conventions differ."""
        return abs(abs(self.found) - abs(self.true))

    @property
    def holds(self) -> bool:
        """Return whether the 95 % interval holds the truth."""
        return self.error <= 1.96 * self.std


def parameter_rows(cases: list[Scored], *, beside: bool = False) -> list[ParameterRow]:
    """Wherever truth and finding speak of the same quantity: of effects by themselves, or of those beside others, all found."""
    rows = []
    for case in cases:
        if case.verdict is None or case.truth["share"] not in ("single", "several"):
            continue
        company = case.truth["share"] == "several" or bool(case.truth["mask"])
        if company is not beside or (company and case.jaccard < 1.0):
            continue
        for effect in case.truth["effects"]:
            finding = next((f for f in case.verdict["findings"] if f["effect"] == effect["key"]), None)
            for name, value in effect["parameters"].items() if finding else ():
                match = _same(name, finding["parameters"])  # type: ignore[index]
                if match is not None and value:
                    row = ParameterRow(effect["key"], name, float(value), float(match["value"]), float(match["std"]))
                    rows.append(row)
    return rows


def _same(name: str, parameters: dict[str, Any]) -> dict[str, Any] | None:
    """The finding's parameter of that name, exactly or as the first word of a longer one (mass, mass_change)."""
    if name in parameters:
        return dict(parameters[name])
    hits = [v for k, v in parameters.items() if k.startswith(name + "_") or k.endswith(("_" + name, "." + name))]
    return dict(hits[0]) if len(hits) == 1 else None


def _parameter_figures(cases: list[Scored]) -> list[Figure]:
    strong = [c for c in cases if any(e["snr"] and e["snr"] >= 0.8 for e in c.truth["effects"])]
    # Together: of two dozen intervals by themselves only one number of hits lies within the band.
    alone, beside = parameter_rows(strong), parameter_rows(strong, beside=True)
    if not alone + beside:
        return []
    error, hits = _median_error(alone + beside), sum(r.holds for r in alone + beside)
    parts = {"alone": alone, "beside others": beside}
    errors = ", ".join(f"{100 * _median_error(rows):.1f} % {which}" for which, rows in parts.items() if rows)
    held = ", ".join(f"{sum(r.holds for r in rows)} of {len(rows)} {which}" for which, rows in parts.items())
    n, what = len(alone + beside), "parameters at SNR >= 0.8"
    intervals = _row(f"{what}, 95 % intervals that hold", "92-98 %", hits, n, good=0.92 <= hits / n <= 0.98)
    return [
        Figure(f"{what}, median error", "<= 5 %", f"{100 * error:.1f} % (n = {n}; {errors})", error <= 0.05),
        replace(intervals, reached=f"{intervals.reached}; {held}"),
    ]


def _median_error(rows: list[ParameterRow]) -> float:
    return float(np.median([r.error / abs(r.true) for r in rows]))


def power(cases: list[Scored]) -> dict[str, dict[float, tuple[int, int, int]]]:
    """Per effect and severity: detected, right first, of how many."""
    out: dict[str, dict[float, tuple[int, int, int]]] = defaultdict(dict)
    for level in SNR_LEVELS:
        for case in of(cases, "single"):
            effect = case.truth["effects"][0]
            if effect["snr"] == level:
                key = f"{effect['key']} ({case.truth['group']})"
                d, f, n = out[key].get(level, (0, 0, 0))
                out[key][level] = (d + case.detected, f + case.first, n + 1)
    return dict(sorted(out.items()))


def confusion(cases: list[Scored]) -> Counter[tuple[str, str]]:
    """(concealed, called first) over single effects at SNR 0.4 and more."""
    some = [c for c in of(cases, "single") if c.truth["effects"][0]["snr"] >= 0.4]
    return Counter((c.wanted[0], c.found[0] if c.found else "nothing") for c in some)


def channel_f1(cases: list[Scored]) -> float:
    """F1 of the channels named by the right findings."""
    values = []
    for case in of(cases, "single"):
        if case.verdict is None or not case.first:
            continue
        named, true = set(case.verdict["findings"][0]["channels"]), set(case.truth["effects"][0]["channels"])
        values.append(2 * len(named & true) / (len(named) + len(true)) if named or true else 1.0)
    return float(np.mean(values)) if values else float("nan")


def onset_errors(cases: list[Scored]) -> list[float]:
    """Seconds between a step's true and found moment."""
    out = []
    for _, name, true, found, _ in parameter_rows(cases):
        if name == "time":
            out.append(abs(found - true))
    return out
