"""JSON and TOML from outside: a document or one typed error, whatever is in them; a digest that no flipped bit passes."""

import json
import sys
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from galen_hw.documents import DocumentError, intact, load_json, load_toml, sealed

DEEP = 100_000
DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("load", "text", "what", "line"),
    [
        (load_json, "[" * DEEP + "]" * DEEP, "nested more than 64 deep", 0),
        (load_json, '{"a":' * 70 + "1" + "}" * 70, "nested more than 64 deep", 0),
        (load_json, '{"a": 1,\n"b": ' + DIGITS + "}", "an integer of 5000 digits", 2),
        (load_json, '{"b": -' + "1" * 21 + "}", "an integer of 21 digits", 1),
        (load_json, '{"a": 1,\n"b"}', "not JSON (Expecting ':' delimiter)", 2),
        (load_json, b'{"a": "\xff"}', "not a text in UTF-8", 0),
        (load_toml, "a = " + "[" * DEEP + "]" * DEEP, "nested more than 64 deep", 0),
        (load_toml, "a" + ".a" * 500 + " = 1", "nested more than 64 deep", 0),
        (load_toml, "b = 1\na = " + DIGITS, "an integer of more than 20 digits", 2),
        (load_toml, "a = 0x" + "f" * 40, "an integer of more than 20 digits", 0),
        (load_toml, "b = 1\na = = 2", "not TOML (Invalid value (at line 2, column 5))", 2),
    ],
)
def test_what_is_beyond_the_bounds_is_one_typed_error(
    load: Callable[[Any], Any], text: Any, what: str, line: int
) -> None:
    """Python's own readers end with RecursionError, OverflowError or a bare ValueError here."""
    with pytest.raises(DocumentError) as error:
        load(text)
    assert (error.value.what, error.value.line) == (what, line)


def test_what_is_within_them_is_read_as_it_stands() -> None:
    """64-bit integers, floats of any length, nesting that somebody might mean."""
    assert load_json("[" * 60 + str(2**64 - 1) + "]" * 60)[0] != []
    assert load_json(f"[{sys.float_info.max}, 0.{DIGITS}, {-(2**63)}]") == [sys.float_info.max, 1.0, -(2**63)]
    assert load_toml("a = 1.5\n[b]\nc = [1, 2]") == {"a": 1.5, "b": {"c": [1, 2]}}


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | st.text(),
    lambda x: st.lists(x, max_size=3) | st.dictionaries(st.text(), x, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_a_digest_is_of_the_values_and_survives_the_disk(data: dict[str, Any]) -> None:
    """Written, read, written with other spaces and another order of keys: still intact."""
    kept = json.loads(json.dumps(sealed(data), indent=1))
    assert intact(kept) is True
    assert intact(dict(reversed(kept.items()))) is True
    assert intact({k: v for k, v in kept.items() if k != "digest"}) is None
    assert intact(kept | {"one more": 1}) is False
