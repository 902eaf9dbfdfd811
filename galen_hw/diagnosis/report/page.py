"""The report as one self-contained HTML page."""

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.config.report_page import page_template
from galen_hw.diagnosis.findings.quantities import headline, quantity, text
from galen_hw.diagnosis.report import plots
from galen_hw.diagnosis.report.caps import CAPS
from galen_hw.diagnosis.report.plot_data import Curve, Traces
from galen_hw.diagnosis.report.summary import VERDICTS, channel_words, in_one_unit, lines, moment
from galen_hw.diagnosis.result import Diagnosis, Value
from galen_hw.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable


def write_page(path: Path, answer: Diagnosis, traces: Traces) -> None:
    """Write the page; nothing is left behind if it cannot be made.

    Args:
        path: of the HTML file; answer: of the diagnosis; traces: what is drawn.
    """
    filters: dict[str, Callable[..., Any]] = {
        "plain": lambda key: key.replace("_", " "),
        "short": channel_words,
        "parameter": _parameter,
        "size": headline,
        "moment": lambda w: moment(w[0], w[1], answer.clock),
        "chance": lambda p: f"{p:.0e}" if p >= CAPS.chance else f"< {CAPS.chance:.0e}",
        "beside_noise": lambda c: in_one_unit(c["rmse"], c["noise_floor"], answer.units.get(c["channel"], "")),
    }
    template = page_template("galen_hw.diagnosis.report", "page.html.j2", filters)
    whole = path.with_name(path.name + ".part")
    page = template.render(
        answer=answer,
        verdict=VERDICTS[answer.verdict],
        lines=lines(answer),
        few=CAPS.alike,
        evidence=traces.evidence,
        highest=max((e.score for e in traces.evidence), default=1.0),
        alike=traces.alike,
        pictures=_pictures(answer, traces),
        unnamed=any(not f.named and f.evidence["heldout_gain"] > 0.0 for f in answer.findings),
        version=VERSION,
    )
    whole.write_text(page, encoding="utf-8")
    whole.replace(path)


def _parameter(name: str, value: Value) -> str:
    """Return a parameter in SI with its standard deviation, and in a readable unit where that is another."""
    plain = quantity(value.value, value.std, "" if value.unit == "1" else value.unit)
    shown = text(name.rsplit(": ", 1)[-1], value)
    return plain if shown == plain else f"{plain} ({shown})"


def _pictures(answer: Diagnosis, traces: Traces) -> dict[str, Any]:
    """Return data addresses of all pictures; curves by effect."""
    json = answer.to_json()
    floor = {k: v for k, v in json["fit"]["noise_floor"].items() if v}
    curves: dict[str, list[tuple[Curve, str]]] = {}
    for one in traces.curves:
        curves.setdefault(one.effect, []).append((one, _data(plots.curve(one))))
    return {
        "residuals": _data(plots.residuals(traces, floor)),
        "bars": _data(plots.bars(json)) if floor else "",
        "plane": _data(plots.plane(traces)),
        "along": _data(plots.along(traces)),
        "options": _data(plots.options(list(traces.options))),
        "curves": curves,
    }


def _data(picture: bytes | None) -> str:
    return "" if picture is None else "data:image/svg+xml;base64," + base64.b64encode(picture).decode("ascii")
