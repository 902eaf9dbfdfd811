"""What a command prints for `--json`: one object that says its schema, the version that made it, when, and with which seed."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

from galen_hw.version import VERSION

SCHEMA: Final = 1
"""Counts up when a key of an answer is taken away or changes its meaning; new keys do not count."""


def stamped(values: Mapping[str, Any], *, seed: int | None = None, date: str | None = None) -> dict[str, Any]:
    """Return the values behind `schema`, `software`, `date` (ISO 8601, UTC) and, where chance had a part, `seed`.

    Args:
        values: of the answer; a `schema` of their own is kept, other keys of the head are not its own.
        seed: of what was drawn by chance, None: nothing was; date: now if None.
    """
    head: dict[str, Any] = {
        "schema": values.get("schema", SCHEMA),
        "software": f"galen-hw {VERSION}",
        "date": date or datetime.now(UTC).isoformat(timespec="seconds"),
    }
    if seed is not None:
        head["seed"] = seed
    return head | {key: value for key, value in values.items() if key not in head}


def print_stamped(values: Mapping[str, Any], *, seed: int | None = None) -> None:
    """Print the values behind the head, see `stamped`, as one line of JSON."""
    print(json.dumps(stamped(values, seed=seed)))
