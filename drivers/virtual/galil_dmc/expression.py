"""Expressions of the controller's language: from left to right without precedence, parentheses first; true is 1.

Source: Galil DMC-40x0 user manual, "Mathematical and Functional Expressions".
"""

import operator
import re
from collections.abc import Callable
from typing import Final

from galen_hw.drivers.virtual.galil_dmc.format import Rejected

_OPERATORS: Final[dict[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "<=": operator.le,
    ">=": operator.ge,
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "=": operator.eq,
    "&": lambda a, b: int(a) & int(b),
    "|": lambda a, b: int(a) | int(b),
}
_TOKEN: Final = re.compile(r"\s*(<=|>=|<>|[-+*/<>=&|()]|[^-+*/<>=&|()\s]+)")
_DEEPEST: Final = 5
_BAD: Final = 4


def evaluate(text: str, operand: Callable[[str], float]) -> float:
    """The value of an expression.

    Args:
        operand: the value of a number, a variable or an operand such as `_TPA`.

    Raises:
        Rejected: not an expression (4), or parentheses too deep (5 levels, code 55).
    """
    tokens = _TOKEN.findall(text)
    if "".join(tokens) != "".join(text.split()):
        raise Rejected(_BAD)
    value, rest = _chain(tokens, operand, 0)
    if rest:
        raise Rejected(_BAD)
    return value


def _chain(tokens: list[str], operand: Callable[[str], float], depth: int) -> tuple[float, list[str]]:
    value, tokens = _term(tokens, operand, depth)
    while tokens and tokens[0] in _OPERATORS:
        right, rest = _term(tokens[1:], operand, depth)
        if tokens[0] == "/" and right == 0.0:
            raise Rejected(_BAD)
        value, tokens = float(_OPERATORS[tokens[0]](value, right)), rest
    return value, tokens


def _term(tokens: list[str], operand: Callable[[str], float], depth: int) -> tuple[float, list[str]]:
    if not tokens:
        raise Rejected(_BAD)
    first, rest = tokens[0], tokens[1:]
    if first in {"+", "-"}:
        value, rest = _term(rest, operand, depth)
        return (-value if first == "-" else value), rest
    if first != "(":
        return operand(first), rest
    if depth >= _DEEPEST:
        raise Rejected(55)
    value, rest = _chain(rest, operand, depth + 1)
    if not rest or rest[0] != ")":
        raise Rejected(_BAD)
    return value, rest[1:]
