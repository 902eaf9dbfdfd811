"""The pages of calibration, deflection and diagnosis: one base with its colours (light, dark, print) and small screens."""

from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from jinja2 import Template

BASE = "report_base.html.j2"


def page_template(package: str, name: str, filters: "Mapping[str, Callable[..., Any]] | None" = None) -> "Template":
    """Return a page's template, which extends the base; a name that it does not know is an error when it is rendered.

    Args:
        package: that holds the file.
        name: of the file.
        filters: of the page.
    """
    from jinja2 import DictLoader, Environment, StrictUndefined

    texts = {
        BASE: files("galen_hw.config").joinpath(BASE).read_text("utf-8"),
        name: files(package).joinpath(name).read_text("utf-8"),
    }
    environment = Environment(
        loader=DictLoader(texts), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters or {}
    return environment.get_template(name)
