"""Writes the pages of settings, messages and effects from the code: `python -m docs.tables` (into docs/), see `PAGES`."""

import importlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.fields import described, summary
from galen_hw.config import schema
from galen_hw.daemon.tables import TRANSPORTS
from galen_hw.drivers.table import DRIVERS
from galen_hw.messages import TOPICS, Message
from galen_hw.physics.effects.registry import EFFECTS, effect_class
from galen_hw.services.table import SERVICES

FOLDER: Final = Path(__file__).parent
WRITTEN: Final = "Written from the code (`make docs`); a test compares it.\n"
SECTIONS: Final[dict[str, type[BaseModel]]] = {
    "[robot]": schema.RobotSection,
    "[robot.delta]": schema.DeltaSection,
    "[devices.NAME]": schema.DeviceSection,
    "[bus]": schema.BusSection,
    "[daemon]": schema.DaemonSection,
}
"""Tables of the file that every set-up may have; those below a device or service follow from the tables of the program."""


def settings() -> str:
    """Return the page of the settings file: every table, key, default, bound and meaning."""
    parts = [
        "# Settings\n",
        f"Keys of `galen.toml` (`config/galen.toml` is one to begin with); every key carries its unit or is SI. {WRITTEN}",
    ]
    for heading, section in SECTIONS.items():
        parts += _section(heading, section)
    for below, table in (
        ("[devices.NAME.settings]", DRIVERS),
        ("[devices.NAME.transport]", TRANSPORTS),
        ("[services.NAME]", SERVICES),
    ):
        for name, path in table.items():
            heading = below.replace("NAME", name) if "services" in below else f"{below}: {name}"
            parts += _section(heading, _load(path).Settings)
    return "\n".join(parts)


def messages() -> str:
    """Return the page of the bus: every topic, then every message field by field."""
    rows = [
        (
            f"`{name}`",
            f"[{t.message.__name__}](#{t.message.__name__.lower()})",
            f"{t.rate_hz:g}" if t.rate_hz else "event",
            t.doc,
        )
        for name, t in TOPICS.items()
    ]
    parts = ["# Messages\n", f"What is on which topic; how it travels: [topics.md](topics.md). {WRITTEN}"]
    parts.append(_table(("topic", "message", "Hz", "what"), rows))
    for kind in dict.fromkeys([Message, *(topic.message for topic in TOPICS.values())]):
        parts += [f"## {kind.__name__}\n", f"{_words(summary(kind))}\n"]
        fields = [f for f in msgspec.structs.fields(kind) if kind is Message or f.name not in _names(Message)]
        said = described(kind, _names(kind))
        parts.append(
            _table(("field", "type", "meaning"), [(f"`{f.name}`", _type(f.type), said[f.name]) for f in fields])
        )
    return "\n".join(parts)


def effects() -> str:
    """Return the page of the vocabulary of `diagnose`: what each effect is, and the numbers that are searched."""
    parts = [
        "# Effects\n",
        f"What `diagnose` may name, and what the terms of a tool's file may be; r is what it adds to the reading. {WRITTEN}",
    ]
    for key in EFFECTS:
        found = effect_class(key)
        parts += [f"## {key}\n", f"{_words(summary(found))}\n"]
        searched = [(f"`{n}`", f"{s.low:g} to {s.high:g}", s.unit) for n, s in found.SEARCHED.items()]
        if searched:
            parts.append(_table(("searched", "within", "unit"), searched))
        if found.NEEDS_CLOCK:
            parts.append("Needs a column `time`.\n")
    return "\n".join(parts)


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "settings.md": settings,
    "messages.md": messages,
    "effects.md": effects,
}


def _load(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def _section(heading: str, kind: type[BaseModel]) -> Iterator[str]:
    yield f"## {heading}\n"
    yield f"{_words(summary(kind))}\n"
    said = described(kind, kind.model_fields)
    own = inspect.get_annotations(kind)
    rows = [
        (f"`{name}`", _type(field.annotation), _default(field), _bounds(field), said[name])
        for name, field in sorted(kind.model_fields.items(), key=lambda named: named[0] not in own)
    ]
    if rows:
        yield _table(("key", "type", "default", "bounds", "meaning"), rows)


def _names(kind: type[msgspec.Struct]) -> list[str]:
    return [field.name for field in msgspec.structs.fields(kind)]


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    value = field.get_default(call_default_factory=True)
    if value is None or value is PydanticUndefined:
        return ""
    return "its own" if isinstance(value, BaseModel) else f"`{list(value) if isinstance(value, tuple) else value!r}`"


SIGNS: Final = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<", "min_length": "length >=", "max_length": "length <="}


def _bounds(field: FieldInfo) -> str:
    found = [f"{SIGNS[n]} {getattr(m, n)}" for m in field.metadata for n in SIGNS if getattr(m, n, None) is not None]
    return ", ".join(found)


def _type(annotation: Any) -> str:
    """A type as people write it: without modules, and without what it is annotated with."""
    text = (
        annotation.__name__ if inspect.isclass(annotation) and not hasattr(annotation, "__args__") else str(annotation)
    )
    if "Annotated" in text or "Radians" in text:
        text = _plain(annotation)
    for module in ("typing.", "pathlib.", "pathlib._local.", "galen_hw.messages."):
        text = text.replace(module, "")
    return f"`{text}`".replace("NoneType", "None")


def _plain(annotation: Any) -> str:
    """Annotated[float, ...] is float, within tuples and lists too."""
    origin, args = getattr(annotation, "__origin__", None), getattr(annotation, "__args__", ())
    if hasattr(annotation, "__metadata__"):
        return _plain(origin)
    if args and inspect.isclass(origin):
        return f"{origin.__name__}[{', '.join(_plain(a) for a in args)}]"
    if args:
        return " | ".join(_plain(a) for a in args)
    return annotation.__name__ if inspect.isclass(annotation) else str(annotation)


def _words(text: str) -> str:
    """A docstring as Markdown: what looks like a tag is none."""
    return text.replace("<", "&lt;").replace("*", "\\*")


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *(tuple(cell.replace("|", "\\|") for cell in row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def main() -> int:
    """Write every page into the folder of the documentation."""
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
