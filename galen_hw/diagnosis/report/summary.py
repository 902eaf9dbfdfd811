"""The answer for people in five lines: mismatch, place, reason, improvement, next recording."""

from collections.abc import Mapping
from typing import Any, Final

from galen_hw.diagnosis.findings.quantities import headline, readable
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.result import Diagnosis, Finding
from galen_hw.physics.effects.registry import effect_class

VERDICTS: Final = {
    "agrees": "simulation and recording agree",
    "explained": "simulation and recording differ, and named physics explains it",
    "partly_explained": "simulation and recording differ; named physics explains part of it",
    "unexplained": "simulation and recording differ, and no named physics explains it",
}


def summary(d: Diagnosis) -> str:
    """Return the five lines as plain text, each under its label, and notes."""
    return "\n".join([f"{d.recording}: {VERDICTS[d.verdict]}", *(f"  {label:<6} {text}" for label, text in lines(d))])


def lines(d: Diagnosis) -> list[tuple[str, str]]:
    """Return label and text of each line; one line a finding; notes last."""
    out = [("what", _what(d))]
    if d.findings:
        out.append(("where", _where(d)))
        shown = d.findings[: CAPS.findings]
        out += [("why" if k == 0 else "", _why(f)) for k, f in enumerate(shown)]
        if len(d.findings) > len(shown):
            out.append(("", "and " + ", ".join(f.effect for f in d.findings[len(shown) :])))
    out += [("fit", _fit(d)), ("next", d.next_experiment)]
    told = " ".join(f.says for f in d.findings)
    return out + [("note", note) for note in d.notes if note not in told]


def channel_words(channel: str) -> str:
    """Return a short name for people: "torque x", "elbow effort", "position z", "target 2 x"."""
    parts = channel.split(".")
    if parts[0] == "target" and len(parts) == 4:
        return f"target {parts[1]} {parts[3]}"
    if parts[0] == "joint" and len(parts) > 2:
        return f"{'.'.join(parts[1:-1])} {parts[-1]}"
    return " ".join(parts[1:]) if len(parts) > 1 else channel


def in_one_unit(a: float, b: float, unit: str) -> tuple[str, str]:
    """Return two values in one readable unit, which stands behind the second."""
    shown = readable(max(a, b), 0.0, unit)
    factor = shown.value / max(a, b) if max(a, b) > 0.0 else 1.0
    return f"{factor * a:.3g}", f"{factor * b:.3g} {shown.unit}".strip()


def times_words(ratio: float) -> str:
    """Return a ratio with two digits, written out: 2300, 41, 1.3."""
    return f"{float(f'{ratio:.2g}'):.10g}"


def _what(d: Diagnosis) -> str:
    worst = d.channels[0] if d.channels else None
    if worst is None:
        return "nothing was compared"
    name, off, floor = worst["channel"], worst["rmse"], worst["noise_floor"]
    a, b = in_one_unit(off, floor, d.units.get(name, ""))
    if d.verdict == "agrees":
        count = "in its one channel" if len(d.channels) == 1 else f"in all {len(d.channels)} channels"
        return f"what is left {count} is noise, {b} rms in {channel_words(name)}"
    times = f", {times_words(off / floor)} times as much" if floor > 0.0 else ""
    return f"{channel_words(name)} is off by {a} {b.partition(' ')[2]} rms where its noise is {b}{times}"


def _where(d: Diagnosis) -> str:
    loud = [c for c in d.channels if c["excess_share"] >= 0.05][: CAPS.names]
    parts = [
        f"{100 * c['excess_share']:.0f} % of the unexplained error in {channel_words(c['channel'])}" for c in loud[:1]
    ]
    parts += [f"{100 * c['excess_share']:.0f} % in {channel_words(c['channel'])}" for c in loud[1:]]
    out = ", ".join(parts) or "too small to share out among the channels"
    out += "".join(f"; {w['says']}" for w in d.where[:1])
    if d.when and any(_momentary(f) for f in d.findings):
        more = f" and {len(d.when) - CAPS.names} more" if len(d.when) > CAPS.names else ""
        out += f"; at {', '.join(moment(a, b, d.clock) for a, b in d.when[: CAPS.names])}{more}"
    return out


def _momentary(finding: Finding) -> bool:
    """Return whether it is physics of moments, of which there is something to be said."""
    kind = effect_class(finding.effect)
    return finding.named and kind.EPISODIC and not kind.THROUGHOUT


def moment(start: float, end: float, clock: bool = True) -> str:
    """Return a time or a stretch of time, s, in words; of a recording without a clock a row or rows."""
    if not clock:
        return f"row {start:.0f}" if round(end) <= round(start) else f"rows {start:.0f} to {end:.0f}"
    return f"{start:.2f} s" if end <= start else f"{start:.1f} to {end:.1f} s"


def _why(finding: Finding) -> str:
    if not finding.named:
        return f"unknown: {finding.says}"
    place = ", ".join(finding.joints[: CAPS.names] or [channel_words(c) for c in finding.channels[: CAPS.names]])
    more = max(len(finding.joints) - CAPS.names, 0)
    place += f" and {more} more" if more else ""
    out = f"{finding.effect.replace('_', ' ')} ({place}): {headline(finding)}; {finding.takes}"
    others = [c.effect.replace("_", " ") for c in finding.rivals[: CAPS.names]]
    others += ["in another joint"] if len(finding.rivals) < len(finding.confounded_with) else []
    if others:
        out += f"; could also be {' or '.join(others)}"
    return out


def _fit(d: Diagnosis) -> str:
    before, after, floor = (d.fit[k] for k in ("rmse_before", "rmse_after", "noise_floor"))
    if not before:
        return "nothing was compared"
    name = max(before, key=lambda c: _ratio(before, floor, c) - _ratio(after, floor, c))
    judged = f"judged on {d.holdout or 'blocks set aside'}"
    if (averaged := int(max(d.fit.get("rows_averaged", {}).values(), default=1.0))) > 1:
        judged += f", on means of {averaged} rows"
    spread = sorted(_ratio(after, floor, c) for c in after if floor.get(c) or not any(floor.values()))
    middle, most = spread[len(spread) // 2], spread[-1]
    rest = f"{most:.2f} times the noise" if len(spread) == 1 else f"{middle:.2f} times the noise (worst {most:.2f})"
    if d.verdict == "agrees":
        return f"error on held-out data {rest}; {judged}"
    a, b = in_one_unit(before[name], after[name], d.units.get(name, ""))
    out = f"error on held-out data {a} to {b} in {channel_words(name)}; what is left is {rest}"
    ceiling = d.fit.get("ceiling", {})
    least = min((ceiling[c] / after[c] for c in ceiling if after.get(c)), default=1.0)
    if least < 0.9:
        out += f", and up to {100 * (1.0 - least):.0f} % of it could still be explained by the known inputs"
    return f"{out}; {judged}"


def _ratio(values: Mapping[str, Any], floor: Mapping[str, Any], channel: str) -> float:
    return float(values[channel] / floor[channel]) if floor.get(channel) else 0.0
