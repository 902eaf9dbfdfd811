"""The report as one self-contained HTML page."""

import base64
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from galen_hw.diagnosis import figures
from galen_hw.diagnosis.summary import VERDICTS, quantity
from galen_hw.diagnosis.traces import Traces
from galen_hw.version import VERSION


def write_page(path: Path, answer: Mapping[str, Any], traces: Traces) -> None:
    """Write the page; nothing is left behind if it cannot be made.

    Args:
        path: of the HTML file; answer: the JSON of the specification; traces: what is drawn.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["quantity"] = lambda p: quantity(p["value"], p["std"], p["unit"])
    template = environment.from_string(files("galen_hw.diagnosis").joinpath("page.html.j2").read_text("utf-8"))
    text = template.render(
        answer=answer,
        verdict=VERDICTS[answer["verdict"]],
        lines=answer.get("notes", ()),
        evidence=traces.evidence,
        pictures=_pictures(answer, traces),
        version=VERSION,
    )
    whole = path.with_name(path.name + ".part")
    whole.write_text(text, encoding="utf-8")
    whole.replace(path)


def _pictures(answer: Mapping[str, Any], traces: Traces) -> dict[str, Any]:
    """Data addresses of all pictures."""
    floor = {k: v for k, v in answer["fit"]["noise_floor"].items() if v}
    place = figures.where(traces)
    return {
        "residuals": _data(figures.residuals(traces, floor)),
        "bars": _data(figures.bars(answer)) if floor else "",
        "where": _data(place) if place else "",
        "curves": [(c.effect, _data(figures.curve(c))) for c in traces.curves],
    }


def _data(picture: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")
