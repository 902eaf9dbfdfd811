"""The switches of `make ablation`: each names a rule that is there, and takes it out wherever it was imported to."""

import subprocess
import sys

import pytest

from galen_hw.diagnosis.selection.moves import MOVES
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
    assert moves == len(MOVES)
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


def test_the_table_has_a_row_a_switch_with_its_error_and_cpu_over_all() -> None:
    rows = [
        ablation.Row("", [7, 6], 5, 2, 100.0, 1.0, 22),
        ablation.Row("drop", [6, 6], 4, 3, 80.0, 1.1, 4),
    ]
    lines = ablation._table(rows, 8, 6, "0123456789").splitlines()
    assert lines[-2] == "| nothing | 7 of 8 | 6 of 8 | 5 of 6 | 2 | 1.000 | 1.00 | 22 |  |"
    assert lines[-1].startswith("| drop | 6 of 8 | 6 of 8 | 4 of 6 | 3 | 1.100 | 0.80 | 4 | ")
    assert ablation._cpu("told\ncpu_s 12.50\n") == 12.5


def test_what_a_watched_rule_said_is_counted_and_a_recording_in_which_it_was_silent_is_not_asked_again() -> None:
    asked = """
from galen_hw.tools.blind_proof.switches import watch
spoke, seconds = watch()
from galen_hw.diagnosis.selection.acceptance import no_worse
import numpy as np
worse, better = np.full((40, 1), 2.0), np.ones((40, 1))
print(no_worse(worse, better), spoke["no worse"], no_worse(better, worse), spoke["no worse"], seconds["no worse"] > 0.0)
"""
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "0", "False", "1", "True"]
    said = ablation._rules("rule no worse: spoke 0, cpu_s 1.50\nrule drop: spoke 3, cpu_s 0.25\ncpu_s 9.00\n")
    assert said == {"no worse": (0, 1.5), "drop": (3, 0.25)}
    whole = {"json": {"findings": [], "fit": {"rmse_after": {"a": 2.0}, "noise_floor": {"a": 1.0}}}, "seconds": 9.0}
    told = {
        ("", "emps"): whole,
        ("drop", "emps"): whole | {"json": {"fit": {"rmse_after": {"a": 3.0}, "noise_floor": {"a": 1.0}}}},
    }
    silent = ablation._row("no worse", {}, told, {"emps": said})
    assert (silent.seconds, silent.error, silent.spoke) == (7.5, 1.0, 0)
    assert ablation._row("drop", {}, told, {"emps": said}).error == pytest.approx(1.5)
