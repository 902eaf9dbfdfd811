"""docs/faults.md: every row has its five cells, names a test that there is, and quotes what the program says."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "faults.md"
HEAD = ["fault", "noticed by, within", "what happens", "what the operator reads", "test"]
SAID_IN = ("galen_hw", "drivers", "services", "config", "tools")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def rows() -> list[list[str]]:
    lines = [cells(line) for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    return [line for line in lines if line != HEAD and not all(set(cell) <= {"-"} for cell in line)]


@cache
def names_in(name: str) -> frozenset[str]:
    path = ROOT / "tests" / f"{name}.py"
    return (
        frozenset(re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))
        if path.exists()
        else frozenset()
    )


@cache
def program() -> str:
    """All that the program may say: literals that a line break divides are one text again."""
    found = [p.read_text(encoding="utf-8") for name in SAID_IN for p in sorted((ROOT / name).rglob("*.py"))]
    return re.sub(r'"\s*\n\s*f?"', "", "\n".join(found))


@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row[0]}"[:60])
def test_a_fault_names_its_test_and_what_is_read(row: list[str]) -> None:
    """Five cells, none empty; the test exists; each quoted text stands in the program."""
    assert len(row) == len(HEAD)
    assert all(row)
    module, _, test = row[4].partition("::")
    assert test in names_in(module), f"no test {row[4]}"
    quoted = re.findall(r"`([^`]+)`", row[3])
    assert quoted, "what does the operator read?"
    assert [text for text in quoted if text not in program()] == []


def test_the_page_has_every_kind_of_fault() -> None:
    """The kinds that an operator's list begins with; a row more is a line more."""
    faults = " ".join(row[0] for row in rows())
    for kind in (
        *("CAN silent", "bus-off", "adapter unplugged", "half a sample", "late pair", "stuck gauge", "saturation"),
        *(
            "status bit",
            "garbage",
            "late",
            "cable out and back",
            "limit",
            "emergency stop",
            "position error",
            "motor off",
        ),
        *(
            "tracker lost",
            "NaN",
            "time going back",
            "gaps",
            "dies",
            "stands still",
            "client of a sweep",
            "slow",
            "stuck",
        ),
        *(
            "hostile",
            "full disk",
            "read-only",
            "power cut",
            "clock steps",
            "two daemons",
            "damaged settings",
            "flipped bits",
        ),
    ):
        assert kind in faults, kind
