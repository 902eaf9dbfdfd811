"""What is wrong with a settings file, all of it at once: file and line, key, the bad value, and what would be right."""

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from galen_hw.errors import UsageError

Key = tuple[str | int, ...]

_HEAD: Final = re.compile(r"^\s*\[+\s*([^\[\]]+?)\s*\]+\s*(#.*)?$")
_ASSIGNMENT: Final = re.compile(r"^\s*([A-Za-z0-9_\-.\"]+)\s*=")
_TEXT: Final = re.compile(
    r'"{3}(?:\\.|(?!"{3}).)*"{3}|\'{3}.*?\'{3}|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)
"""Strings and comments: what stands in them is no key, even on a line of its own."""
_INLINE: Final = re.compile(r"[{,]\s*([A-Za-z0-9_\-\"]+)\s*=")


_TOML: Final = {
    "devices": 'devices.ft = { driver = "ati_netcanoem", '
    'transport = { interface = "socketcan", channel = "can0", bitrate = 1000000 } }'
}
"""What to write for a whole table that is missing; to be put at the top of the file, before any table."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: what, where (file:line: key), what to do."""

    what: str
    where: str
    todo: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.todo}" if self.todo else f"{self.where}: {self.what}"


class ConfigError(UsageError):
    """A settings file that cannot be used; `problems` holds one line for each thing wrong with it."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        first = problems[0]
        super().__init__(first.what, where=first.where, todo=first.todo)
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return "\n".join(map(str, self.problems))


class Places:
    """Lines of the keys of a TOML text.

    Args:
        file: how to name it in messages.
        text: its content.
    """

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self._lines: dict[Key, int] = {}
        self._begun: dict[Key, int] = {}  # tables that are there for what is in them: `a` of [a.b] and of a.b = 1
        table: Key = ()
        key: Key = ()
        depth = 0  # of arrays and inline tables that are open where a line begins
        bare = _TEXT.sub(lambda found: re.sub(r"[^\n]", "_", found[0]), text)
        for number, (line, seen) in enumerate(zip(text.split("\n"), bare.split("\n"), strict=True), start=1):
            if depth == 0 and "[" in seen and (head := _HEAD.match(line.rstrip("\r"))):
                table = _split(head[1])
                self._add(table, number)
                continue
            found = _ASSIGNMENT.match(line) if depth == 0 and "=" in seen else None
            if found:
                key = (*table, *_split(found[1]))
                self._add(key, number)
            begin = found.end() if found else 0
            for inner in _INLINE.finditer(line, begin) if found or depth else ():
                self._add((*key, *_split(inner[1])), number)
            depth = max(0, depth + sum(seen.count(c) for c in "[{") - sum(seen.count(c) for c in "]}"))

    def _add(self, key: Key, number: int) -> None:
        self._lines.setdefault(key, number)
        for n in range(1, len(key)):
            self._begun.setdefault(key[:n], number)

    def where(self, key: Key) -> str:
        """`file:line: key`, with the line of the nearest table that is in the file."""
        names = tuple(part for part in key if isinstance(part, str))
        known = self._begun | self._lines
        line = next((known[names[:n]] for n in range(len(names), 0, -1) if names[:n] in known), 1)
        return f"{self.file}:{line}: {'.'.join(map(str, key))}"


def check(model: type[BaseModel], data: Any, at: Key, places: Places) -> tuple[BaseModel | None, list[Problem]]:
    """The settings of one section, or every problem in it; `at` is the section's key."""
    try:
        return model.model_validate(data), []
    except ValidationError as error:
        found = [_problem(model, dict(e), at, places) for e in error.errors(include_url=False)]
        return None, found


def unknown(name: str, known: Mapping[str, Any] | Sequence[str]) -> str:
    """What to do about a name that is not known: the nearest one, or all of them."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"did you mean {near[0]}?" if near else f"one of: {', '.join(known)}"


def _problem(model: type[BaseModel], error: dict[str, Any], at: Key, places: Places) -> Problem:
    loc: Key = error["loc"]
    parent, field = _field(model, loc)
    where = places.where((*at, *loc))
    if error["type"] == "extra_forbidden":
        known = list(parent.model_fields) if parent else []
        return Problem("no such key", where, unknown(str(loc[-1]), known) if known else "")
    example = _example(field, next((part for part in reversed(loc) if isinstance(part, str)), ""))
    if error["type"] == "missing":
        return Problem("this key is missing", where, example)
    text = str(error["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    value = "" if isinstance(error["input"], dict | BaseModel) else f" (it is {_short(error['input'])})"
    return Problem(f"{text[:1].lower()}{text[1:]}{value}", where, example)


def _field(model: type[BaseModel], loc: Key) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that holds the key at `loc`, and the key's field, as far as they can be followed."""
    parent: type[BaseModel] | None = model
    field: FieldInfo | None = None
    for part in loc:
        if isinstance(part, str) and parent is not None and (part in parent.model_fields or field is None):
            field = parent.model_fields.get(part)
            inner = _model_in(field.annotation) if field else None
            parent = inner if inner is not None and part != loc[-1] else parent
    return parent, field


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The settings class inside an annotation like `dict[str, X]` or `X | None`, if there is one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((m for a in getattr(annotation, "__args__", ()) if (m := _model_in(a)) is not None), None)


def _example(field: FieldInfo | None, name: str) -> str:
    if field is None:
        return ""
    if name in _TOML:
        return f"e.g. at the top of the file: {_TOML[name]}"
    value = (
        field.examples[0]
        if field.examples
        else None
        if field.is_required()
        else field.get_default(call_default_factory=True)
    )
    if value is None or value == {} or isinstance(value, BaseModel):
        return ""
    return f"e.g. {name} = {_short(TypeAdapter(Any).dump_python(value, mode='json'))}"


def _short(value: Any) -> str:
    """A value as it would stand in the file, not too long."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_short(v)}" for k, v in value.items()) + " }"
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _split(dotted: str) -> Key:
    return tuple(part.strip().strip('"') for part in dotted.split("."))
