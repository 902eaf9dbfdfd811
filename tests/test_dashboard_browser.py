"""The page in a real browser: a whole calibration of a virtual tool by clicking, a stop, and a page that may only look.

Skipped with a reason where no Chromium is installed: none is downloaded.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from galen_hw.config.tool_store import ToolStore
from galen_hw.drivers.virtual.truth import TOOLS

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed on this machine"),
    pytest.mark.long,  # a page in a browser beside a live robot: a machine of its own
    pytest.mark.slow,
    pytest.mark.timeout(600),
]
LONG_MS = 240_000


@contextmanager
def dashboard(tmp_path: Path) -> Iterator[str]:
    """`galen-hw dashboard --virtual` in directories of its own; its address with the token."""
    text = (resources.files("galen_hw.config") / "galen.toml").read_text(encoding="utf-8")
    config = tmp_path / "galen.toml"
    # As in the tests of the command line: no port for viewers, and a stall of this machine is not what this is about.
    text = text.replace("[bus]\n", '[bus]\nviewers = ""\n').replace("[daemon]\n", "[daemon]\nblind_after_s = 2.0\n")
    text = text.replace("[services.calibration]\n", "[services.calibration]\nheartbeat_s = 5.0\n")
    config.write_text(text, encoding="utf-8")
    words = [
        "dashboard",
        "--virtual",
        "--config",
        str(config),
        "--port",
        "0",
        "--poses",
        "3x4",
        "--samples",
        "80",
        "--no-check",
    ]
    command = [sys.executable, "-m", "galen_hw.cli", *words, "--dir", str(tmp_path / "run")]
    environ = os.environ | {"GALEN_HW_STATE": str(tmp_path / "state")}
    with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            line = next((line for line in process.stdout if line.startswith("dashboard: ")), "")
            assert line, "the dashboard has not started"
            yield line.removeprefix("dashboard: ").strip()
        finally:
            process.terminate()
            process.wait(timeout=60)


@contextmanager
def browser_page(url: str, **window: Any) -> Iterator[Any]:
    """A page in headless Chromium; whatever it complains of fails the test."""
    complaints: list[str] = []
    with playwright.sync_playwright() as started:
        # Tests run as root in containers, where Chromium's own sandbox cannot.
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(**window)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: complaints.extend([] if "127.0.0.1" in request.url else [request.url]))
        page.goto(url)
        yield page
        browser.close()
    assert complaints == []


def reach(page: Any, role: str, name: str) -> Any:
    """A button or link once it is there; what the page says where the calibration has ended before."""
    wanted = page.get_by_role(role, name=name)
    wanted.or_(page.get_by_text("It did not come to its end")).first.wait_for(timeout=LONG_MS)
    assert wanted.is_visible(), page.inner_text("#cal-body")
    return wanted


def test_a_whole_calibration_by_clicking(tmp_path: Path) -> None:
    """Begin, tool off, tool on, accept; the tool is saved as it is, in hand, and its report can be opened."""
    with dashboard(tmp_path) as url:
        with browser_page(url, viewport={"width": 1280, "height": 900}) as page:
            assert "token" not in page.url
            # What to do stands beside the alarm: nobody has zeroed the virtual sensor yet.
            page.locator("#alarms small", has_text="zero it with no tool on").wait_for(timeout=LONG_MS)
            page.get_by_role("button", name="pointer").last.click()
            page.click("#calibrate")
            page.click("#ask-yes")
            reach(page, "button", "It is off, go on").click()
            page.get_by_text("Measuring").wait_for(timeout=LONG_MS)
            reach(page, "button", "It is on, go on").click()
            reach(page, "button", "Accept").click()
            report = reach(page, "link", "Open the report")
            with page.expect_popup() as opened:
                report.click()
            # No `wait_for_load_state`: a new window is loaded once before as an empty one.
            playwright.expect(opened.value).to_have_title(re.compile("pointer"))
            page.get_by_text("Valid: pointer compensated").wait_for(timeout=LONG_MS)
            page.click("#enable")
            page.get_by_text("Valid, but compensation is off").wait_for(timeout=LONG_MS)
            page.click("#stop")
            page.get_by_text("Stopped", exact=True).wait_for(timeout=LONG_MS)
        with browser_page(re.sub("#.*", "", url), viewport={"width": 400, "height": 800}) as page:
            page.get_by_text("look only").wait_for(timeout=LONG_MS)
            page.locator("#lights li").first.wait_for(timeout=LONG_MS)
            assert page.locator("#stop").is_disabled()
            assert all(button.is_disabled() for button in page.locator("#tools button").all())
            assert page.evaluate("document.documentElement.scrollWidth") == 400

    saved = ToolStore(tmp_path / "state", virtual=True).load("pointer")
    assert saved.mass == pytest.approx(TOOLS["pointer"].mass, rel=0.02)
    assert saved.origin is not None
    assert saved.origin.virtual


def test_a_page_that_is_closed_stops_its_calibration(tmp_path: Path) -> None:
    """Nobody would see what the robot does; another page reads why."""
    with dashboard(tmp_path) as url:
        with browser_page(url) as page:
            page.get_by_role("button", name="pointer").last.click()
            page.click("#calibrate")
            page.click("#ask-yes")
            reach(page, "button", "It is off, go on").click()
            page.get_by_text("pose 2 of").wait_for(timeout=LONG_MS)
        with browser_page(url) as page:
            page.get_by_text("the page that began it was closed").wait_for(timeout=LONG_MS)


STANDING_OUT = """() => [...document.querySelectorAll(".card")].flatMap((card) =>
  [...card.querySelectorAll("button, td, output, li, dd, p, canvas")]
    .filter((x) => x.getBoundingClientRect().right > card.getBoundingClientRect().right + 1)
    .map((x) => `${card.className}: ${x.outerHTML.slice(0, 80)}`))"""


def test_nothing_stands_out_of_its_panel_at_any_width(tmp_path: Path) -> None:
    """A laptop, both ways to hold a tablet, a phone: the bars of force and torque had lain over the tools at 1024."""
    with dashboard(tmp_path) as url, browser_page(url, viewport={"width": 1440, "height": 900}) as page:
        page.locator("#lights li").first.wait_for(timeout=LONG_MS)
        for width in (1440, 1101, 1100, 1024, 861, 860, 768, 561, 560, 400):
            page.set_viewport_size({"width": width, "height": 800})
            page.wait_for_timeout(300)  # the plots are drawn anew
            assert page.evaluate(STANDING_OUT) == [], width
            assert page.evaluate("document.documentElement.scrollWidth") <= width
