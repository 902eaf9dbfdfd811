"""The engine knows no effect by its class or key: what only one of them needs stands in that effect's own file."""

import ast
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest

import galen_hw.diagnosis
from galen_hw.physics.effects.base import Effect
from galen_hw.physics.effects.registry import EFFECTS, kinds

ROOT = Path(galen_hw.diagnosis.__file__).parent
MODULES = {path.split(":")[0] for path in EFFECTS.values()}
MOST_IMPORTS = 4
"""Files that name an effect's class: the rows that are left out are handed on as the effect that they are. Only goes down."""
MOST_KEYS = 1
"""Keys as strings: the word for what has no name. Only goes down."""


def trees() -> Iterator[tuple[str, ast.Module]]:
    """Every file of the diagnosis but detection, which proposes effects and so names them."""
    for path in sorted(ROOT.rglob("*.py")):
        if path.relative_to(ROOT).parts[0] != "detection":
            yield str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))


def asked_of_effects() -> list[str]:
    """Places where a class of effects, or what is one by its name, is asked for by isinstance or issubclass."""
    out = []
    for name, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
                asked = {getattr(x, "id", getattr(x, "attr", "")) for x in ast.walk(node.args[1])}
                known = {kind.__name__ for one in kinds() for kind in one.__mro__} - {"object", "ABC"}
                out += [f"{name}:{node.lineno} {one}" for one in sorted(asked & known)]
    return out


def test_no_effect_is_asked_for_its_class() -> None:
    assert asked_of_effects() == []


def test_few_files_import_the_class_of_an_effect() -> None:
    found = [
        f"{name} {one.name}"
        for name, tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in MODULES
        for one in node.names
    ]
    assert len(found) <= MOST_IMPORTS, found


def test_hardly_any_key_stands_as_a_string() -> None:
    found = [
        f"{name}:{node.lineno} {node.value}"
        for name, tree in trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and node.value in EFFECTS
    ]
    assert len(found) <= MOST_KEYS, found


@pytest.mark.parametrize("kind", kinds(), ids=lambda kind: kind.KEY)
def test_no_field_of_an_effect_hides_a_question(kind: type[Effect]) -> None:
    """A dataclass would take the answer of most for the field's default."""
    assert not [f.name for f in fields(kind) if hasattr(Effect, f.name)]  # type: ignore[arg-type]
