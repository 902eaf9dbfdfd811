"""Rules and moves of the diagnosis that can be switched off, one at a time: python -m ...switches NAME ARGUMENTS.

A switch replaces one function, wherever it was imported to, by what it says when it has nothing to say. Without a name all rules
are there and watched: how often each says anything else, and the CPU time that it takes. The rest of the command line is
`galen-hw diagnose`'s own.
"""

import functools
import importlib
import runpy
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

SELECTION, MOVES = "galen_hw.diagnosis.selection", "galen_hw.diagnosis.selection.moves"


def _no(*_: Any, **__: Any) -> bool:
    return False


def _yes(*_: Any, **__: Any) -> bool:
    return True


def _nothing(*_: Any, **__: Any) -> list[Any]:
    return []


def _none(*_: Any, **__: Any) -> None:
    return None


def _pays(*_: Any, **__: Any) -> tuple[bool, float]:
    return True, 1.0


def _first(_bench: Any, _scorer: Any, _chosen: Any, _scores: Any, able: list[int], **_: Any) -> int:
    return able[0]


def _in_order(_scorer: Any, able: list[int]) -> list[int]:
    return able


def _alone(_scorer: Any, rivals: dict[int, Any], i: int) -> float:
    return float(rivals[i].rank)


def _one(*_: Any, **__: Any) -> float:
    return 1.0


def _zero(*_: Any, **__: Any) -> float:
    return 0.0


@dataclass(frozen=True)
class Switch:
    """Names one rule or move.

    Args:
        target: "module:function" or "module:Class.method"; off: what stands in its place; what: in words, for the table.
    """

    target: str
    off: Callable[..., Any]
    what: str


SWITCHES: Final[dict[str, Switch]] = {
    "tendon": Switch(f"{MOVES}.tighten:tightened", _no, "a spring as the tendon that it may be"),
    "exchange": Switch(f"{MOVES}.exchange:regrouped", _no, "two effects for others that stand for both"),
    "reclock": Switch(f"{MOVES}.timing:reclocked", _no, "clocks of all effects at once"),
    "pairs": Switch(f"{MOVES}.add:hidden", _no, "two effects that are significant together alone"),
    "kinds first": Switch(f"{MOVES}.add:_kinds_first", _in_order, "the best of each kind before a second of any"),
    "its kind": Switch(
        f"{SELECTION}.kinds:with_its_kind", _alone, "an effect in many channels against all joints' own"
    ),
    "alike": Switch(
        "galen_hw.diagnosis.first_look:Known.alike", _nothing, "other forms than were seen first are no noise"
    ),
    "drop": Switch(f"{MOVES}.drop:dropped", _no, "effects that others have made needless"),
    "swap": Switch(f"{MOVES}.swap:swapped", _no, "each effect for its look-alikes"),
    "simplified": Switch(f"{MOVES}.swap:simplified", _no, "a plainer kind for one no better than what is missing"),
    "refine": Switch(f"{MOVES}.refine:refined", _no, "finer forms of what was found"),
    "paired test": Switch(f"{SELECTION}.acceptance:pays", _pays, "held-out errors before an effect joins"),
    "simpler": Switch(f"{SELECTION}.simplicity:plainest", _first, "the simpler within one standard error"),
    "no worse": Switch(f"{SELECTION}.acceptance:no_worse", _yes, "held-out errors before an exchange"),
    "budget": Switch("galen_hw.diagnosis.stats.criteria:Criteria.standard_errors", _one, "one budget of false alarms"),
    "discrepancy": Switch("galen_hw.diagnosis.validation.verdict:tolerated", _zero, "what laws may miss"),
    "plausible": Switch(f"{SELECTION}.acceptance:plausible", _yes, "parameters that a machine can have"),
    "trees": Switch("galen_hw.diagnosis.lack_of_fit.trees:hidden", _nothing, "structure that trees find"),
    "unsteady": Switch("galen_hw.diagnosis.validation.verdict:unsteady", _nothing, "a standing machine, not steady"),
    "band": Switch("galen_hw.physics.signals.recorded_band:recorded_band", _none, "the cut-off of a recorded wrench"),
}


def switch_off(name: str) -> None:
    """Replace a rule in every module that has it, and in the table of moves.

    Raises:
        KeyError: there is no such switch, or what it names is nowhere.
    """
    _replace(SWITCHES[name], SWITCHES[name].off)


def watch() -> tuple[Counter[str], dict[str, float]]:
    """Return, by switch, how often a rule says what it would not when off, and its CPU seconds; both grow as rules are asked."""
    spoke, seconds = Counter[str](), dict.fromkeys(SWITCHES, 0.0)
    for name, one in SWITCHES.items():
        _replace(one, _watched(name, one, _rule(one), spoke, seconds))
    return spoke, seconds


def _watched(
    name: str, one: Switch, rule: Callable[..., Any], spoke: Counter[str], seconds: dict[str, float]
) -> Callable[..., Any]:
    @functools.wraps(rule)
    def watched(*args: Any, **kwargs: Any) -> Any:
        start = time.thread_time()
        said = rule(*args, **kwargs)
        seconds[name] += time.thread_time() - start
        spoke[name] += int(_differs(said, one.off(*args, **kwargs)))
        return said

    return watched


def _differs(said: Any, silent: Any) -> bool:
    """Return whether a rule said anything; a model is another one unless it is the same."""
    plain = isinstance(said, (bool, int, float, list, tuple, np.ndarray, np.generic)) or said is None
    return bool(np.any(said != silent)) if plain else said is not silent


def _rule(one: Switch) -> Callable[..., Any]:
    """The function that a switch names.

    Raises:
        KeyError: it is not there.
    """
    module, function = one.target.split(":")
    rule: Any = importlib.import_module(module)
    for name in function.split("."):
        rule = getattr(rule, name, None)
    if rule is None:
        raise KeyError(f"{one.target} is not there")
    return rule  # type: ignore[no-any-return]


def _replace(one: Switch, new: Callable[..., Any]) -> None:
    importlib.import_module("galen_hw.diagnosis.pipeline")
    importlib.import_module("galen_hw.physics.scenes.wrench")
    rule = _rule(one)
    module, function = one.target.split(":")
    if "." in function:
        owner, function = function.split(".")
        setattr(getattr(importlib.import_module(module), owner), function, new)
        return
    for loaded in [m for key, m in list(sys.modules.items()) if key.startswith("galen_hw") and m is not None]:
        for key in [k for k, v in vars(loaded).items() if v is rule]:
            setattr(loaded, key, new)
    table = importlib.import_module(MOVES)
    kept = tuple(replace(m, make=new) if m.make is rule else m for m in table.MOVES)
    for loaded in (table, importlib.import_module(f"{SELECTION}.search")):
        vars(loaded)["MOVES"] = kept


def main(argv: list[str]) -> int:
    """Diagnose without one rule; the tool is run as its users run it."""
    status, spoke, seconds = 0, Counter[str](), dict[str, float]()
    if argv[0]:
        switch_off(argv[0])
    else:
        spoke, seconds = watch()
    sys.argv = ["galen-hw", "diagnose", *argv[1:]]
    try:
        runpy.run_module("galen_hw.cli", run_name="__main__")
    except SystemExit as end:
        status = int(end.code or 0)
    for name in seconds:
        print(f"rule {name}: spoke {spoke[name]}, cpu_s {seconds[name]:.2f}", file=sys.stderr)
    print(f"cpu_s {time.process_time():.2f}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
