"""JSON and TOML from outside, within bounds: whatever a text holds, it is a document or one `DocumentError`.

Python's own readers end with a `RecursionError` on deep nesting and with a bare `ValueError` (or, once the number is
made a float, an `OverflowError`) on integers of thousands of digits. No document of ours comes near these bounds.
"""

import hashlib
import json
import re
import tomllib
from collections.abc import Callable
from typing import Any, Final

MAX_DEPTH: Final = 64
MAX_DIGITS: Final = 20
"""Of an integer: 64 bits, with or without a sign, have no more."""
MAX_CHARACTERS: Final = 64 * 2**20
_PLACE: Final = re.compile(r"\(at line (\d+), column (\d+)\)")
_LONG: Final = re.compile(rf"\d[\d_]{{{MAX_DIGITS}}}")


class DocumentError(ValueError):
    """A text that is no document, or is beyond the bounds.

    Args:
        what: is wrong, a clause; line, column: where, from 1; 0 where it is not known.
        beyond: it would be a document, but for the bounds.
    """

    def __init__(self, what: str, line: int = 0, column: int = 0, *, beyond: bool = False) -> None:
        super().__init__(what)
        self.what, self.line, self.column, self.beyond = what, line, column, beyond

    def within(self, where: str) -> str:
        """The place in a file: its name and the line, where that is known."""
        return f"{where}, line {self.line}" if self.line else where


def load_json(
    text: str | bytes,
    parse_constant: Callable[[str], Any] | None = None,
    parse_float: Callable[[str], Any] | None = None,
) -> Any:
    """The value of a JSON text; `parse_constant` is asked what NaN and the infinities are, `parse_float` numbers with a point.

    Raises:
        DocumentError: not JSON or not UTF-8, nested more than `MAX_DEPTH` deep, an integer of more than `MAX_DIGITS`
            digits, or more than `MAX_CHARACTERS`.
    """
    if isinstance(text, bytes):
        try:
            text = text.decode()
        except UnicodeDecodeError as error:
            raise DocumentError("not a text in UTF-8") from error
    _check_size(text)
    try:
        value = json.loads(text, parse_int=_integer, parse_constant=parse_constant, parse_float=parse_float)
    except json.JSONDecodeError as error:
        raise DocumentError(f"not JSON ({error.msg})", error.lineno, error.colno) from None
    except RecursionError:
        raise _too_deep() from None
    except _TooLongError as error:
        raise _too_long(error.digits, text) from None
    _check_values(value, text)
    return value


def load_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        DocumentError: not TOML, or beyond the bounds of `load_json`.
    """
    _check_size(text)
    try:
        value = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = _PLACE.search(str(error))
        line, column = (int(place[1]), int(place[2])) if place else (len(text.splitlines()), 0)
        raise DocumentError(f"not TOML ({error})", line, column) from None
    except RecursionError:
        raise _too_deep() from None
    except ValueError:  # Python's own bound on the digits of an integer
        raise _too_long(0, text) from None
    _check_values(value, text)
    return value


def sealed(data: dict[str, Any]) -> dict[str, Any]:
    """The document with the digest of its content as its last key, `digest`."""
    content = {key: value for key, value in data.items() if key != "digest"}
    return content | {"digest": _digest(content)}


def intact(data: dict[str, Any]) -> bool | None:
    """Return whether the content is what its `digest` was made of; None where there is none."""
    if "digest" not in data:
        return None
    return bool(sealed(data)["digest"] == data["digest"])


def _digest(content: dict[str, Any]) -> str:
    """SHA-256 of the values, whatever the spaces and the order of the keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


class _TooLongError(Exception):
    def __init__(self, digits: int) -> None:
        super().__init__(digits)
        self.digits = digits


def _integer(text: str) -> int:
    if len(text.lstrip("-")) > MAX_DIGITS:
        raise _TooLongError(len(text.lstrip("-")))
    return int(text)


def _check_size(text: str) -> None:
    if len(text) > MAX_CHARACTERS:
        raise DocumentError(f"too long: {len(text)} characters, at most {MAX_CHARACTERS}")


def _check_values(value: Any, text: str) -> None:
    """Refuse nesting and integers beyond the bounds, without recursion of its own."""
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH + 1):
        inner: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                inner += item.values()
            elif isinstance(item, list):
                inner += item
            elif isinstance(item, int) and abs(item) >= 10**MAX_DIGITS:
                raise _too_long(0, text)
        level = inner
        if not level:
            return
    raise _too_deep()


def _too_deep() -> DocumentError:
    return DocumentError(f"nested more than {MAX_DEPTH} deep", beyond=True)


def _too_long(digits: int, text: str) -> DocumentError:
    found = _LONG.search(text)
    count = f"{digits} digits" if digits else f"more than {MAX_DIGITS} digits"
    return DocumentError(f"an integer of {count}", text.count("\n", 0, found.start()) + 1 if found else 0, beyond=True)
