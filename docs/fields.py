"""Reads what the docstring of a class says of each of its fields, for the pages that are written from the code."""

import inspect
import re
from collections.abc import Collection


def described(cls: type, fields: Collection[str]) -> dict[str, str]:
    """Return the words of each field, from the docstrings of the class and its parents; fields without any are not in it.

    A docstring lists them under `Args:` as "one: words; two, three: words" or line by line.
    """
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__):
        if one.__module__.startswith("galen_hw."):
            _, _, text = inspect.cleandoc(one.__doc__ or "").partition("Args:\n")
            found |= _entries(inspect.cleandoc(re.split(r"\n\n", text)[0]), fields)
    return found


def _entries(text: str, fields: Collection[str]) -> dict[str, str]:
    text = " ".join(text.split())
    name = r"`?(?:" + "|".join(map(re.escape, sorted(fields, key=len, reverse=True))) + r")`?"
    heads = list(re.finditer(rf"(?:^|(?<=[.;,)] ))({name}(?:, {name})*): ", text)) if fields else []
    out = {}
    for head, after in zip(heads, [*heads[1:], None], strict=False):
        words = text[head.end() : None if after is None else after.start()].strip().rstrip(";,.").strip()
        out |= {each.strip("` "): words for each in head[1].split(",")}
    return out


def summary(cls: type) -> str:
    """The docstring without its list of fields."""
    return inspect.cleandoc(cls.__doc__ or "").partition("Args:\n")[0].strip()
