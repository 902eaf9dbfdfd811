"""The switches of `make ablation`: each names a rule that is there, and takes it out wherever it was imported to."""

import subprocess
import sys

import pytest

from galen_hw.tools.blind_proof import ablation
from galen_hw.tools.blind_proof.switches import SWITCHES

ASKED = """
import sys
from galen_hw.tools.blind_proof.switches import SWITCHES, switch_off
import importlib
one = SWITCHES[sys.argv[1]]
module, function = one.target.split(":")
switch_off(sys.argv[1])
assert getattr(importlib.import_module(module), function) is one.off
rules = [getattr(m, function, None) for k, m in sys.modules.items() if k.startswith("galen_hw.diagnosis")]
moves = importlib.import_module("galen_hw.diagnosis.selection.search").MOVES
print(sum(m.make is one.off for m in moves), len(moves), sum(r is one.off for r in rules))
"""


@pytest.mark.parametrize("name", ["drop", "plausible", "no worse", "band"])
def test_a_switch_takes_its_rule_out_of_every_module_and_of_the_table_of_moves(name: str) -> None:
    done = subprocess.run([sys.executable, "-c", ASKED, name], capture_output=True, text=True, check=True)
    of_moves, moves, places = (int(x) for x in done.stdout.split())
    assert moves > 10
    assert of_moves == (1 if name == "drop" else 0)
    assert places >= (0 if name == "band" else 2)


def test_a_switch_takes_a_method_out_of_its_class() -> None:
    asked = """
from galen_hw.tools.blind_proof.switches import switch_off
from galen_hw.diagnosis.stats.criteria import CRITERIA
switch_off("budget")
print(CRITERIA.standard_errors(100))
"""
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert float(done.stdout) == 1.0


def test_every_switch_names_a_function() -> None:
    import importlib
    from functools import reduce

    for one in SWITCHES.values():
        module, function = one.target.split(":")
        assert callable(reduce(getattr, function.split("."), importlib.import_module(module)))


def test_the_table_has_a_row_a_switch_and_its_cpu_over_all() -> None:
    rows = [ablation.Row("", [7, 6], 5, 2, 100.0), ablation.Row("drop", [6, 6], 4, 3, 80.0)]
    lines = ablation._table(rows, 8, 6, "0123456789").splitlines()
    assert lines[-2] == "| nothing | 7 of 8 | 6 of 8 | 5 of 6 | 2 | 1.00 |  |"
    assert lines[-1].startswith("| drop | 6 of 8 | 6 of 8 | 4 of 6 | 3 | 0.80 | ")
    assert ablation._cpu("told\ncpu_s 12.50\n") == 12.5
