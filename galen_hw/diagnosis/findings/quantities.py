"""The size of a finding for people: the parameters that matter, in readable units, with their uncertainty."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from galen_hw.diagnosis.result import Finding, Value
from galen_hw.physics.effects.parameters import IN_PROPORTION
from galen_hw.physics.effects.registry import effect_class

SIGNAL: Final = "rms_signal"
"""The parameter that every finding has: rms of what it adds to its strongest channel."""

MOMENT: Final = "moment"
"""The parameter that tells, in s, from when on a finding holds that does not hold all along."""

PERCENT: Final = {"gain_error", "leak", "scale_error", "share", "load_share"}


@dataclass(frozen=True)
class Shown:
    """A number in a unit that reads well."""

    value: float
    std: float
    unit: str


def quantity(value: float, std: float | None, unit: str) -> str:
    """Return a number with its standard deviation and unit, with as many digits as are significant."""
    if std is None or not std > 0.0 or not math.isfinite(std):
        return f"{value:.4g} {unit}".strip()
    place = _order(std)
    digits = max(1 - place, 0)
    if digits > 6 or abs(value) >= 1e6:
        return f"{value:.{max(2, min(2 + _order(abs(value) or std) - place, 8))}g} ± {std:.2g} {unit}".strip()
    return f"{value:.{digits}f} ± {std:.{digits}f} {unit}".strip()


def _order(x: float) -> int:
    return int(f"{x:e}".split("e")[1])


def readable(value: float, std: float, unit: str, name: str = "") -> Shown:
    """Return an SI quantity in a unit that people read: mm, mrad or deg, ms, g, N mm, per cent."""
    base, proportion, what = unit.partition(IN_PROPORTION)
    if proportion:
        inner = readable(value, std, base, name)
        return replace(inner, unit=f"{inner.unit}{proportion}{what}".strip())
    if name in PERCENT and unit == "1":
        return Shown(100.0 * value, 100.0 * std, "%")
    size = max(abs(value), std) if math.isfinite(std) else abs(value)
    table: dict[str, list[tuple[float, float, str]]] = {
        "m": [(1e-4, 1e6, "um"), (0.5, 1e3, "mm")],
        "rad": [(2e-4, 1e6, "urad"), (0.1, 1e3, "mrad"), (math.inf, math.degrees(1.0), "deg")],
        "s": [(0.5, 1e3, "ms")],
        "kg": [(0.5, 1e3, "g")],
        "kg m": [(0.5, 1e6, "g mm")],
        "N m": [(0.02, 1e3, "N mm")],
        "rad/(N m)": [(0.02, 1e3, "mrad/(N m)")],
        "m/N": [(1e-3, 1e6, "um/N")],
        "rad/s": [(math.inf, math.degrees(1.0), "deg/s")],
    }
    if name == "wave_number" and unit in ("rad/rad", "rad/m") and value > 0.0:
        period = readable(2.0 * math.pi / value, 0.0, unit.removeprefix("rad/"))
        return Shown(period.value, period.value * std / value, period.unit)
    for below, factor, shown in table.get(unit, []):
        if size < below:
            return Shown(factor * value, factor * std, shown)
    return Shown(value, std, "" if unit == "1" else unit)


def text(name: str, value: Value) -> str:
    """Return one parameter in words."""
    shown = readable(value.value, value.std, value.unit, name)
    return quantity(shown.value, shown.std, shown.unit)


def headline(finding: Finding, *, most: int = 3) -> str:
    """Return the size of a finding in a few words: up to three parameters, ranges over joints or channels.

    Args:
        most: parameters that are named; of more that are alike (the moments of a body) the best known.
    """
    parts, kind = _by_name(finding.parameters), effect_class(finding.effect)
    named = _named(parts, kind.HEAD, most)
    # Of parameters that are known together alone, as a polynomial's, none says how large it is.
    sure = SIGNAL not in parts or any(_sure(value) for name in named for value in parts[name])
    words = [_range(name, parts[name]) for name in named] if sure else []
    if MOMENT in parts and not kind.EPISODIC:
        moments = sorted(parts[MOMENT], key=lambda value: value.value)
        words.append(f"{' and '.join(f'from {text(MOMENT, value)}' for value in moments[:most])} on")
    if kind.RMS_TOLD or not words:
        words += [f"{text(SIGNAL, value)} rms" for value in parts.get(SIGNAL, [])[:1]]
    return ", ".join(words)


def _sure(value: Value) -> bool:
    """Return whether it differs from zero at all."""
    return abs(value.value) > 2.0 * value.std


def _named(parts: Mapping[str, list[Value]], patterns: Sequence[str], most: int) -> list[str]:
    """Return the names that fit the patterns, in their order: those that differ from zero, if any do."""
    fitting = [[name for name in parts if re.fullmatch(pattern, name)] for pattern in patterns]
    sure = {name for names in fitting for name in names if any(_sure(v) for v in parts[name])}
    named: list[str] = []
    for names in fitting:
        asked = [name for name in names if name not in named and (name in sure or not sure)]
        best = sorted(asked, key=lambda name: -max(_clearness(v) for v in parts[name]))[: most - len(named)]
        named += [name for name in asked if name in best]
    return named


def _clearness(value: Value) -> float:
    """Return how many standard deviations it is from zero."""
    return abs(value.value) / value.std if value.std > 0.0 else math.inf


def _by_name(parameters: Mapping[str, Value]) -> dict[str, list[Value]]:
    """Return the parameters of all parts by their bare name: "joint3: coulomb" is a coulomb."""
    out: dict[str, list[Value]] = {}
    for name, value in parameters.items():
        out.setdefault(name.rsplit(": ", 1)[-1], []).append(value)
    if len(out.get("coulomb_forward", [])) + len(out.get("coulomb", [])) > 1:
        # Of several joints the mean of both directions is named; the page has them one by one.
        both = zip(out.pop("coulomb_forward", []), out.pop("coulomb_backward", []), strict=True)
        means = [Value(0.5 * (a.value + b.value), 0.5 * math.hypot(a.std, b.std), a.unit) for a, b in both]
        out["coulomb"] = [*out.get("coulomb", []), *means]
    return out


def _range(name: str, values: list[Value]) -> str:
    """Return a parameter's range, one for each unit: a force and a torque, a number and what it gains with a covariate."""
    label = {"wave_number": "period"}.get(name, name.replace("_", " "))
    alike: dict[str, list[Value]] = {}
    for value in values:
        alike.setdefault(value.unit, []).append(value)
    told = [group for group in alike.values() if any(_sure(v) for v in group)] or list(alike.values())
    return f"{label} {', '.join(_spread(name, group) for group in told)}"


def _spread(name: str, values: list[Value]) -> str:
    if len(values) == 1:
        return text(name, values[0])
    shown = [readable(v.value, v.std, v.unit, name) for v in sorted(values, key=lambda v: v.value)]
    if len({one.unit for one in shown}) > 1:
        return f"{shown[0].value:.3g} {shown[0].unit} to {shown[-1].value:.3g} {shown[-1].unit}"
    low, high = (f"{pick(one.value for one in shown):.3g}" for pick in (min, max))
    return f"{low if low == high else f'{low} to {high}'} {shown[0].unit}".strip()
