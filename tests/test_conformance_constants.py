"""Numbers with a name: how many the diagnosis and its physics have. The limits only go down.

A threshold for each case that once went wrong is no method: a new number takes the place of an old one, follows from another
(the budget of false alarms, the rows, the noise), or is a setting that a caller may want otherwise. Settings are counted too, so
that they are no way round the first limit.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import galen_hw

CONSTANTS = {"diagnosis": 44, "physics": 32}
"""Capitals at module level that are bound to numbers."""
SETTINGS = {"diagnosis": 192, "physics": 124}
"""Fields of classes and arguments whose default is a number."""


def numeric(value: ast.expr | None) -> bool:
    """Whether an expression is made of numbers alone: 3, -1e-3, 2.0 * np.log(10.0), (1, 2), np.logspace(-2.0, 4.0, 13)."""
    match value:
        case ast.Constant(value=bool()):
            return False
        case ast.Constant(value=int() | float()):
            return True
        case ast.UnaryOp(operand=one):
            return numeric(one)
        case ast.BinOp(left=left, right=right):
            return numeric(left) and numeric(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Call(args=parts):
            return bool(parts) and all(map(numeric, parts))
    return False


def constants(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], node.value
        elif isinstance(node, ast.AnnAssign):
            target, value = node.target, node.value
        else:
            continue
        several = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
        for one, number in zip(target.elts, value.elts, strict=True) if several else [(target, value)]:
            if isinstance(one, ast.Name) and one.id.isupper() and numeric(number):
                yield one.id


def settings(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        match node:
            case ast.arguments(posonlyargs=first, args=args, defaults=defaults, kwonlyargs=named, kw_defaults=given):
                both = [*first, *args]
                pairs = [
                    *zip(both[len(both) - len(defaults) :], defaults, strict=True),
                    *zip(named, given, strict=True),
                ]
                yield from (one.arg for one, value in pairs if numeric(value))
            case ast.ClassDef(body=body):
                for one in body:
                    if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
                        given = one.value
                        if isinstance(given, ast.Call):  # field(default=3)
                            given = next((k.value for k in given.keywords if k.arg == "default"), None)
                        if numeric(given):
                            yield one.target.id


def found(package: str, kind) -> list[str]:
    files = sorted((Path(galen_hw.__file__).parent / package).rglob("*.py"))
    assert len(files) > 30
    return [f"{path.stem}.{name}" for path in files for name in kind(ast.parse(path.read_text(encoding="utf-8")))]


def test_what_counts_as_a_number():
    source = """
A = 3
B: Final = -1e-3
C = (1, 2.0)
D = 2.0 * np.log(10.0)
NAME = "text"
FLAG = True
E = OTHER / 10.0
F, G = 1, 2.0
def f(x, y=3, *, z=0.5, flag=False, word="a"): pass
class Some:
    w: float = 0.1
    v: int = field(default=4, kw_only=True)
    u: bool = True
"""
    assert list(constants(ast.parse(source))) == ["A", "B", "C", "D", "F", "G"]
    assert sorted(settings(ast.parse(source))) == ["v", "w", "y", "z"]


@pytest.mark.parametrize("package", list(CONSTANTS))
def test_named_numbers_become_fewer(package):
    names = found(package, constants)
    assert len(names) <= CONSTANTS[package], f"of {package} one too many: {', '.join(names)}"
    assert len(names) > CONSTANTS[package] - 5, f"{package} has {len(names)}: lower the limit"


@pytest.mark.parametrize("package", list(SETTINGS))
def test_settings_become_fewer(package):
    names = found(package, settings)
    assert len(names) <= SETTINGS[package], f"of {package} one too many: {', '.join(names)}"
