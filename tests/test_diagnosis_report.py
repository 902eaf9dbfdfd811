"""What people see of a diagnosis: five lines, JSON as specified, a page that stands alone, one table for many recordings."""

import argparse
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from galen_hw.cli import main
from galen_hw.diagnosis.findings.quantities import headline, quantity, text
from galen_hw.diagnosis.report.collect import traces_of
from galen_hw.diagnosis.report.page import write_page
from galen_hw.diagnosis.report.plot_data import Curve, Traces
from galen_hw.diagnosis.report.plots import _binned
from galen_hw.diagnosis.report.summary import in_one_unit, lines, summary, times_words
from galen_hw.diagnosis.result import Diagnosis, Finding, Value
from galen_hw.tools.diagnose import add_arguments
from galen_hw.tools.diagnose_many import answers_to
from galen_hw.tools.diagnose_screen import show, table
from galen_hw.tools.progress import counting, working
from tests import diagnosis_parts as parts

KEYS = {
    "schema",
    "recording",
    "holdout",
    "predict",
    "verdict",
    "locate",
    "findings",
    "fit",
    "next_experiment",
    "premises",
}


class Page(HTMLParser):
    """What a page refers to, and the words in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words += data


def test_five_lines_say_what_where_why_how_much_and_what_next() -> None:
    """The delay of 20 ms is named with its size and error; the lines stand in their order."""
    answer = parts.diagnosed("late").diagnosis
    said = lines(answer)
    assert [label for label, _ in said if label][:5] == ["what", "where", "why", "fit", "next"]
    why = dict(said)["why"]
    delay = re.search(r"delay ([\d.]+) ± ([\d.]+) ms", why)
    assert why.startswith("time delay")
    assert delay is not None
    assert abs(float(delay[1]) - 20.0) < 4.0 * float(delay[2]) + 0.05
    assert summary(answer).startswith("late: simulation and recording differ")


def test_json_has_the_specified_keys_and_nothing_that_json_cannot_say() -> None:
    """Key by key as specified, strict JSON even where a number is not finite."""
    answer = parts.diagnosed("late").diagnosis.to_json()
    assert set(answer) == KEYS
    assert set(answer["locate"]) == {"channels", "where", "when"}
    assert set(answer["fit"]) == {"rmse_before", "rmse_after", "noise_floor", "ceiling", "rows_averaged"}
    for finding in answer["findings"]:
        assert set(finding) == {"effect", "channels", "joints", "says", "parameters", "evidence", "confounded_with"}
        assert all(set(p) == {"value", "std", "unit"} for p in finding["parameters"].values())
        assert set(finding["evidence"]) == {"heldout_gain", "score", "false_alarm_probability"}
    bad = Diagnosis("r", "", "wrench", "agrees", [], [], [], [], {"rmse_after": {"a": math.nan}}, "")
    assert json.loads(json.dumps(bad.to_json(), allow_nan=False))["fit"] == {"rmse_after": {"a": None}}


@pytest.mark.parametrize(
    ("value", "std", "unit", "said"),
    [
        (0.0123456, 0.00012, "rad", "0.01235 ± 0.00012 rad"),
        (20.83, 1.44, "N", "20.8 ± 1.4 N"),
        (6903.2, 905.0, "g mm", "6903 ± 905 g mm"),
        (0.5, 0.0, "1", "0.5 1"),
    ],
)
def test_a_quantity_has_the_digits_that_its_error_allows(value: float, std: float, unit: str, said: str) -> None:
    """Two digits of the error, the value to the same place."""
    assert quantity(value, std, unit) == said


def test_two_numbers_stand_in_one_unit() -> None:
    assert in_one_unit(6.4e-4, 2.53e-4, "N m") == ("0.64", "0.253 N mm")
    assert in_one_unit(0.0, 0.0, "N") == ("0", "0 N")


def test_numbers_are_told_in_units_that_people_read() -> None:
    """SI in the answer; milliseconds, millimetres, degrees and grams for people, and no change of the number."""
    assert text("delay", Value(0.008, 0.0001, "s")) == "8.00 ± 0.10 ms"
    assert text("offset", Value(0.5, 0.01, "rad")) == "28.65 ± 0.57 deg"
    assert text("gain_error", Value(0.031, 0.002, "1")) == "3.10 ± 0.20 %"
    assert text("wave_number", Value(12.0, 0.0, "rad/rad")) == "30 deg"
    joints = {f"j{k}: coulomb": Value(0.1 * k, 0.01, "N m") for k in (1, 2, 5)}
    assert headline(Finding("friction", [], ["j1", "j2", "j5"], "", joints, {})) == "coulomb 0.1 to 0.5 N m"
    joints |= {"x: coulomb": Value(12.0, 0.1, "N")}
    assert headline(Finding("friction", [], ["j1", "x"], "", joints, {})) == "coulomb 0.1 to 0.5 N m, 12.00 ± 0.10 N"


def test_a_body_that_goes_with_a_covariate_is_told_beside_what_is_there_all_along() -> None:
    """Each number with its own unit; of the three moments the two that are known best, not the first two."""
    body = {
        "mass": Value(0.4, 2e-4, "kg"),
        "moment_x": Value(1.584e-3, 2.2e-5, "kg m"),
        "moment_y": Value(-4.014e-3, 2.4e-5, "kg m"),
        "moment_z": Value(0.023985, 3.0e-5, "kg m"),
    }
    opening = {
        "2: moment_x": Value(0.012027, 2.8e-5, "kg m a unit of opening"),
        "2: moment_y": Value(3e-5, 3e-5, "kg m a unit of opening"),
        "2: moment_z": Value(-3.955e-3, 3.6e-5, "kg m a unit of opening"),
    }
    plain = headline(Finding("payload", [], [], "", body, {}))
    assert plain == "mass 400.00 ± 0.20 g, moment y -4014 ± 24 g mm, moment z 23985 ± 30 g mm"
    both = headline(Finding("payload", [], [], "", body | opening, {}))
    assert "moment x 1584 ± 22 g mm, 12027 ± 28 g mm a unit of opening" in both
    assert "others" not in both
    assert "moment y" not in both


def test_rows_of_one_value_are_one_point_of_a_curve() -> None:
    """A jaw that is shut half of the time: its bins lie side by side, none upon another."""
    rng = np.random.default_rng(3)
    x = np.r_[np.zeros(500), rng.uniform(0.0, 1.0, 400), np.ones(300)]
    middle, mean, low, high = _binned(x, x + rng.normal(0.0, 0.1, len(x)))
    assert np.all(np.diff(middle) > 0.0)
    assert middle[0] == 0.0
    assert len(middle) == len(mean) == len(low) == len(high) > 5
    assert abs(mean[0]) < 0.05


@pytest.mark.parametrize("kind", ["late", "drifting", "nothing", "poses"])
def test_the_page_stands_alone_and_says_what_the_answer_says(kind: str, tmp_path: Path) -> None:
    """No address but data inside the page; with and without a clock; verdict, findings and next experiment are in it."""
    work = parts.diagnosed(kind)
    write_page(tmp_path / "page.html", work.diagnosis, traces_of(work))
    page = Page((tmp_path / "page.html").read_text("utf-8"))
    assert page.sources
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    assert work.diagnosis.next_experiment in page.words
    if work.diagnosis.findings:
        first = work.diagnosis.channels[0]
        before, floor = in_one_unit(first["rmse"], first["noise_floor"], work.diagnosis.units.get(first["channel"], ""))
        assert before in page.words
        assert floor in page.words
    assert all(finding.says in page.words for finding in work.diagnosis.findings)
    assert list(tmp_path.iterdir()) == [tmp_path / "page.html"]


@pytest.mark.parametrize("width", [1, 14])
def test_pages_of_one_and_of_fourteen_channels(width: int, tmp_path: Path) -> None:
    """Any number of joints fits on a page."""
    rng, names = np.random.default_rng(1), tuple(f"joint.j{k}.effort" for k in range(width))
    before, x = rng.normal(size=(500, width)), rng.normal(size=500)
    curve = Curve("friction", "friction, j0", "j0 speed", "rad/s", "j0 effort", "N m", x, x + before[:, 0], x)
    traces = Traces(np.arange(500.0), True, names, ("N m",) * width, before, 0.5 * before, x > 1.0, curves=[curve])
    fit = {k: dict.fromkeys(names, v) for k, v in (("rmse_before", 2.0), ("rmse_after", 1.0), ("noise_floor", 1.0))}
    channels = [{"channel": n, "excess_share": 1.0 / width, "rmse": 2.0, "noise_floor": 1.0} for n in names]
    values = {"coulomb": Value(0.3, 0.01, "N m")}
    evidence = {"heldout_gain": 0.5, "score": 9.0, "false_alarm_probability": 0.0}
    finding = Finding("friction", list(names), ["j0"], "It rubs.", values, evidence)
    answer = Diagnosis("r", "", "effort", "explained", channels, [], [], [finding], fit | {"ceiling": {}}, "Rest.")
    write_page(tmp_path / "page.html", answer, traces)
    page = Page((tmp_path / "page.html").read_text("utf-8"))
    assert len(page.sources) == 3
    assert all(name in page.words for name in names)


def test_each_found_effect_has_its_own_curve_against_what_it_is_a_function_of() -> None:
    """A delay over the rate of the signal: the picture's slope is the delay."""
    curve = traces_of(parts.diagnosed("late")).curves[0]
    assert curve.effect == "time_delay"
    assert curve.x_label.endswith("simulated rate")
    assert np.polyfit(curve.x, curve.y, 1)[0] == pytest.approx(-0.02, rel=0.05)


def test_a_terminal_gets_labels_and_a_program_gets_whole_lines() -> None:
    """Narrow terminals wrap; a pipe gets one line a fact."""
    answer = parts.diagnosed("late").diagnosis
    piped, narrow = Console(file=None, record=True, width=60), Console(record=True, width=60, force_terminal=True)
    for console in (piped, narrow):
        with console.capture() as screen:
            show(console, [answer])
        said = screen.get()
        assert "time delay" in said
        if console is piped:
            assert any(line.startswith("  next ") and line.endswith("to one.") for line in said.splitlines())
        else:
            assert max(len(re.sub(r"\x1b\[[\d;]*m", "", line)) for line in said.splitlines()) <= 60


def test_one_table_has_a_row_for_each_of_many_recordings() -> None:
    """Names without the common folder, verdicts, findings."""
    answers = [parts.diagnosed(kind).diagnosis for kind in ("late", "drifting", "nothing", "poses")]
    with Console(width=120, record=True) as console:
        console.print(table(answers))
    said = console.export_text()
    assert all(re.search(rf"^ *{answer.recording} +{answer.verdict}", said, re.MULTILINE) for answer in answers)
    assert "time_delay" in said


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings side by side."""
    out = tmp_path_factory.mktemp("many")
    parts.write_table(parts.late(0.02), out / "late")
    parts.write_table(parts.drifting(0.06), out / "drifting")
    return out


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_folder_of_recordings_is_diagnosed_on_all_cores(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A list in the JSON in the order of the folder, a page for each, status 1, one table."""
    out = folder / "out"
    out.mkdir()
    status = main(["diagnose", str(folder), "-o", str(out / "a.json"), "--report", str(out / "page.html")])
    answers = json.loads((out / "a.json").read_text())
    assert status == 1
    assert [Path(a["recording"]).name for a in answers] == ["drifting", "late"]
    assert [a["findings"][0]["effect"] for a in answers] == ["drift", "time_delay"]
    assert {p.name for p in out.glob("*.html")} == {"page-late.html", "page-drifting.html"}
    assert "0 of 2 agree" in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["--together"]])
def test_a_cluster_for_one_diagnosis_is_said_to_be_of_no_use(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its address had been ignored in silence."""
    monkeypatch.setattr("galen_hw.tools.diagnose_many._whole", lambda *_, **__: "answer")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    args = parser.parse_args(["run", "--dask", "tcp://127.0.0.1:1", *words])
    assert answers_to([tmp_path / name for name in ("run", "other")[: 1 + len(words)]], args) == ["answer"]
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "galen-hw diagnose: --dask is for many recordings; one is diagnosed on this machine"


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.filterwarnings("default")
def test_a_dask_cluster_gives_the_same_answers(folder: Path, tmp_path: Path) -> None:
    """The same recordings over a scheduler's address, on a real cluster of this machine."""
    distributed = pytest.importorskip("distributed", reason="dask is not installed: pip install 'galen-hw[dask]'")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        main(["diagnose", str(folder), "--dask", cluster.scheduler_address, "-o", str(tmp_path / "a.json")])
    answers = json.loads((tmp_path / "a.json").read_text())
    assert [a["findings"][0]["effect"] for a in answers] == ["drift", "time_delay"]


def test_a_scheduler_that_does_not_answer_is_said_in_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2, what to do, no traceback."""
    pytest.importorskip("distributed", reason="dask is not installed: pip install 'galen-hw[dask]'")
    assert main(["diagnose", str(folder), "--dask", "tcp://127.0.0.1:9"]) == 2
    said = capsys.readouterr().err
    assert "no scheduler answers" in said
    assert "Traceback" not in said


def test_ratios_are_written_out() -> None:
    """Two digits without an exponent."""
    assert [times_words(ratio) for ratio in (2345.6, 41.2, 1.26)] == ["2300", "41", "1.3"]


def test_progress_is_some_lines_where_there_is_no_terminal(capsys):
    """One line a stage on stderr, nothing of what may still be refused; of many recordings ten lines at most."""
    with working("reading run.mcap") as told:
        for stage, share in (("checking", 0.0), ("choosing", 0.5), ("choosing", 0.6), ("judging", 0.9)):
            told(stage, share)
    assert capsys.readouterr() == ("", "choosing\njudging\n")
    with counting("diagnosing", 95) as done:
        for _ in range(95):
            done()
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert lines[0] == "diagnosing 95 recordings"
    assert lines[-1] == "95 of 95"
    assert len(lines) == 11
