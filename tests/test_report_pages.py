"""The pages of calibration, deflection and diagnosis: one base, and the words of the reader."""

import re
from importlib.resources import files

import pytest

from galen_hw.config.report_page import BASE, page_template

PAGES = {
    "galen_hw.diagnosis.report": "page.html.j2",
    "galen_hw.tools.calibration": "report.html.j2",
    "galen_hw.tools.deflection": "report.html.j2",
}
FILTERS = dict.fromkeys(("plain", "short", "parameter", "size", "moment", "chance", "number", "beside_noise"), str)


@pytest.mark.parametrize("package", PAGES)
def test_every_page_stands_on_the_base(package: str) -> None:
    """Colours come from it alone, so that a dark screen has all of them; no word of the method where a plain one does."""
    text = files(package).joinpath(PAGES[package]).read_text("utf-8")
    assert text.startswith(f'{{% extends "{BASE}" %}}')
    assert page_template(package, PAGES[package], FILTERS).blocks.keys() == {"title", "style", "body"}
    assert re.findall(r"#[0-9a-fA-F]{3,6}\b", text) == []
    assert "excess" not in re.sub(r"excess_share", "", text)
    assert "<table" not in re.sub(r'<div class="scroll"><table', "", text)


def test_every_colour_has_a_dark_one() -> None:
    text = files("galen_hw.config").joinpath(BASE).read_text("utf-8")
    light, _, dark = text.partition("prefers-color-scheme: dark")
    names = set(re.findall(r"(--\w+): #", light))
    assert names == set(re.findall(r"(--\w+): #", dark))
    assert set(re.findall(r"var\((--\w+)\)", text)) <= names
