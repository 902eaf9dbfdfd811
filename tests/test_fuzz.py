"""Whatever reads foreign bytes, with Hypothesis: nothing but the program's own typed errors. `make fuzz` does it at length."""

import gc
import random
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.tools.fuzz import live
from galen_hw.tools.fuzz.command import main
from galen_hw.tools.fuzz.mutate import LONGEST, mutated
from galen_hw.tools.fuzz.targets import TARGETS


@cache
def call_of(name: str) -> Callable[[bytes], None]:
    return TARGETS[name].make()


@pytest.fixture(scope="module", autouse=True)
def ended() -> Iterator[None]:
    """What the targets hold open ends with these tests, and not with the interpreter."""
    yield
    call_of.cache_clear()
    gc.collect()


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=40)
@given(data=st.data())
def test_any_bytes_are_read_or_refused_with_the_own_error(name: str, data: st.DataObject) -> None:
    """Noise, and mutations of what the parser takes."""
    seed = data.draw(st.none() | st.integers(0, 2**32))
    content = data.draw(st.binary(max_size=300)) if seed is None else mutated(random.Random(seed), TARGETS[name].seeds)
    call_of(name)(content)


@pytest.mark.parametrize("name", TARGETS)
def test_what_a_target_begins_from_is_read(name: str) -> None:
    """Each seed passes, so that its mutations reach what lies behind the first check."""
    for seed in TARGETS[name].seeds:
        assert seed
        call_of(name)(seed)


def test_a_run_counts_and_writes_its_page(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A whole run of three targets: numbers for each, no find, and the page. The settings load drivers on their way: what
    libraries had reserved before (a gigabyte of addresses) had counted as theirs, and the first input was a find."""
    page = tmp_path / "fuzz.md"
    targets = ("socket: command", "wire: slcan", "file: settings")
    words = [word for name in targets for word in ("--target", name)]
    assert main([*words, "--inputs", "50", "--write", str(page)]) == 0
    rows = [line for line in page.read_text().splitlines() if line.startswith(("| socket", "| wire", "| file"))]
    assert [row.split(" | ")[1] for row in rows] == ["50", "50", "50"]
    assert all(row.endswith(" | 0 |") for row in rows)
    assert "| socket: command | 50 |" in capsys.readouterr().out


def test_inputs_are_bounded() -> None:
    """Mutations stay below what is fuzzed, and are the same for the same seed."""
    pool = (b"abc" * 2000, b"")
    first = [mutated(random.Random(seed), pool) for seed in range(200)]
    assert max(map(len, first)) <= LONGEST
    assert first == [mutated(random.Random(seed), pool) for seed in range(200)]


@pytest.mark.live
def test_no_frame_ends_a_process_of_a_running_daemon(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A small shower on every socket of a daemon on the virtual robot: the same processes run, samples flow, the page has it."""
    page = tmp_path / "fuzz.md"
    page.write_text("# Fuzzing\n")
    assert live.main(["--frames", "2000", "--append", str(page)]) == 0
    assert capsys.readouterr().out.count("| 2000 |") == 5
    assert page.read_text().count("| none |") == 5
