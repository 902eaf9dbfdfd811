"""`galen-hw command`: one request to a device or service of the running daemon."""

import argparse
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from galen_hw.documents import DocumentError, load_json
from galen_hw.errors import UsageError
from galen_hw.tools.answer import stamped
from galen_hw.units import SI, number_in, quantity


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("target", metavar="TARGET", help="device or service, e.g. motors, ft, compensation, daemon")
    parser.add_argument("name", metavar="NAME", help="what to do, e.g. stop, zero, select_tool, info")
    parser.add_argument(
        "args",
        metavar="KEY=VALUE",
        nargs="*",
        default=[],
        help="SI numbers, numbers with a unit (17deg, 5mm), words, or JSON; a.b=1 fills a map",
    )
    parser.add_argument("--json", action="store_true", help="print the reply as JSON")
    parser.add_argument(
        "--timeout", type=number_in("s"), default=30.0, metavar="S", help="seconds to wait for the reply"
    )
    parser.add_argument("--dir", metavar="RUNTIME", type=Path, help="runtime directory of the daemon")
    parser.epilog = "examples: galen-hw command motors stop; galen-hw command motors move_jp position.roll=17deg"


def run(args: argparse.Namespace) -> int:
    """Send it and print the result."""
    from galen_hw.bus import CommandClient
    from galen_hw.config.paths import Addresses, client_runtime_dir

    arguments = parse_arguments(args.args)
    if not (math.isfinite(args.timeout) and args.timeout > 0):
        raise UsageError("must be a number of seconds above 0", where="--timeout", todo="e.g. --timeout 30")
    addresses = Addresses(args.dir or client_runtime_dir())
    addresses.require_daemon()
    with CommandClient(addresses.command) as client:
        if units := units_given(args.args):
            check_units(units, client.call("daemon", "info").get("units", {}).get(args.target, {}))
        result = client.call(args.target, args.name, arguments, args.timeout)
    if args.json:
        print(json.dumps(stamped({}) | result))  # the reply's own keys come through, whatever they are called
    else:
        print("\n".join(f"{key}: {_text(value)}" for key, value in result.items()) or "done")
    return 0


def parse_arguments(words: list[str]) -> dict[str, Any]:
    """`["position.roll=0.3", "tool=retractor"]` as `{"position": {"roll": 0.3}, "tool": "retractor"}`.

    Raises:
        UsageError: a word without `=`, a key twice, or a key that is both a value and a map.
    """
    found: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        path = key.split(".")
        if not equals or not all(path):
            raise UsageError("not of the form key=value", where=repr(word), todo="e.g. tool=retractor")
        inner = found
        for part in path[:-1]:
            inner = inner.setdefault(part, {})
            if not isinstance(inner, dict):
                raise UsageError(f"{part} is a value and a map", where=repr(word), todo="give one of them")
        if path[-1] in inner:
            raise UsageError("given twice", where=repr(word), todo="give it once")
        inner[path[-1]] = _value(text)
    return found


def units_given(words: list[str]) -> dict[str, tuple[str, str]]:
    """Return the words that end in a unit: the word and its SI unit, by key."""
    pairs = [(word, *word.partition("=")[::2]) for word in words]
    return {key: (word, found[1]) for word, key, text in pairs if (found := quantity(text)) is not None}


def check_units(given: Mapping[str, tuple[str, str]], expected: Mapping[str, str]) -> None:
    """Refuse a unit of another kind: five millimetres for an angle would be taken for 0.005 rad, and the arm would move.

    Args:
        given: of `units_given`; expected: SI units by key, of the device; a key that it does not name may have any.

    Raises:
        UsageError: the first such word.
    """
    for key, (word, unit) in given.items():
        if (right := expected.get(key, unit)) != unit:
            units = [name for name, (si, _) in SI.items() if si == right] or [right]
            raise UsageError(f"{unit} is no unit of {key}", where=repr(word), todo=f"give {' or '.join(units)}")


def _value(text: str) -> Any:
    """JSON where it is JSON (numbers, true, null, lists, maps), a number with a unit in SI, else the word itself."""
    try:
        value = load_json(text, parse_constant=_refuse, parse_float=_finite)
    except DocumentError as error:
        if error.beyond:
            raise UsageError(error.what, where=f"{text[:20]!r}...", todo="give less") from None
        found = quantity(text)
        return text if found is None else _finite(repr(found[0]))
    return value


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse(number)


def _refuse(constant: str) -> NoReturn:
    raise UsageError("not a number that can be commanded", where=constant, todo="give a finite one")


def _text(value: Any) -> str:
    return json.dumps(value) if isinstance(value, dict | list) else str(value)
