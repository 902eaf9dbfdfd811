"""Where deflection models live: JSON files in the state directory, in generations.

    STATE/deflection/NAME.json               the one in use of that name
    STATE/deflection/history/NAME/0001.json  every one that was saved, never changed
    STATE/deflection/selected.json           {"model": NAME}: what the service corrects with

Every file is written beside its place, flushed and renamed over it.
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from galen_hw.config.tool_file import NAME
from galen_hw.config.tool_store import write_atomic
from galen_hw.documents import DocumentError, intact, load_json, sealed
from galen_hw.errors import UsageError

SCHEMA: Final = 1
AGAIN: Final = "galen-hw deflection fit DATA... --save NAME"


class DeflectionFile(BaseModel):
    """A fitted model and where it came from.

    Args:
        model: name in the table of models; values: its own numbers.
        robot, tool, tip: what it was fitted on (tip in the sensor frame, m); it serves no other.
        virtual: fitted on a virtual robot: it serves no real one.
        rmse_m: held-out error by kind of held-out set; std_m: one sigma of that error along each channel.
        data: names of the sets; reason: why it was recommended.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_version: int = Field(default=SCHEMA, alias="schema")
    name: str = Field(pattern=NAME)
    generation: int = 0
    date: str = ""
    software: str = ""
    robot: str
    virtual: bool = False
    tool: str = ""
    tip: tuple[float, float, float] | None = None
    model: str
    values: dict[str, Any]
    std: list[float] = []
    rmse_m: dict[str, float] = {}
    data: list[str] = []
    reason: str = ""

    @property
    def id(self) -> str:
        """As poses bear it."""
        return f"{self.name}/{self.generation:04d}"


def parse_deflection(text: str) -> DeflectionFile:
    """A model's file from its text; one with a `digest` must be what the digest was made of.

    Raises:
        DocumentError: not JSON, a value that does not fit, or another content than was written.
    """
    data = load_json(text)
    if not isinstance(data, dict):
        raise DocumentError("not a JSON object")
    try:
        file = DeflectionFile.model_validate_json(json.dumps({k: v for k, v in data.items() if k != "digest"}))
    except ValidationError as error:
        first = error.errors()[0]
        raise DocumentError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if intact(data) is False:
        raise DocumentError("is not what was written: its digest is another")
    return file


@dataclass(frozen=True, slots=True)
class DeflectionStore:
    """The deflection models of one installation, below its state directory."""

    state_dir: Path

    @property
    def folder(self) -> Path:
        """Of all models."""
        return Path(self.state_dir) / "deflection"

    def names(self) -> list[str]:
        """Saved models, sorted."""
        found = (p.stem for p in self.folder.glob("*.json") if p.stem != "selected")
        return sorted(n for n in found if re.fullmatch(NAME, n))

    def load(self, name: str) -> DeflectionFile:
        """The model in use of a name.

        Raises:
            UsageError: there is none, or its file is damaged.
        """
        return self._read(self._path(name), name)

    def save(self, file: DeflectionFile, *, select: bool = True) -> DeflectionFile:
        """Add a generation, make it the one in use of its name, and (unless told otherwise) the one that serves.

        Raises:
            UsageError: the directory cannot be written.
        """
        file = file.model_copy(update={"generation": max(self.generations(file.name), default=0) + 1})
        text = json.dumps(sealed(file.model_dump(mode="json", by_alias=True)), indent=1) + "\n"
        write_atomic(self._generation(file.name, file.generation), text)
        write_atomic(self._path(file.name), text)
        if select:
            self.select(file.name)
        return file

    def generations(self, name: str) -> list[int]:
        """Numbers of all that were saved under a name."""
        folder = self.folder / "history" / name
        return sorted(int(p.stem) for p in folder.glob("*.json") if p.stem.isdigit())

    def rollback(self, name: str, number: int | None = None) -> DeflectionFile:
        """Go back to a generation, or to the one before the one in use.

        Raises:
            UsageError: there is none.
        """
        now = self.load(name).generation
        older = [n for n in self.generations(name) if n < now] if number is None else [number]
        if not older:
            raise UsageError(f"model {name!r} has no earlier generation", todo="galen-hw deflection list")
        path = self._generation(name, older[-1])
        file = self._read(path, name)
        write_atomic(self._path(name), path.read_text(encoding="utf-8"))
        return file

    def selected(self) -> str | None:
        """Name of the model that serves; None for none."""
        path = self.folder / "selected.json"
        if not path.exists():
            return None
        try:
            data = load_json(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            data = None
        if not isinstance(data, dict) or not set(data) <= {"model", "digest"} or intact(data) is False:
            raise UsageError("is damaged", where=str(path), todo="galen-hw deflection select NAME")
        name = data.get("model")
        return name if isinstance(name, str) and re.fullmatch(NAME, name) else None

    def select(self, name: str | None) -> None:
        """Serve a model from now on; None for none.

        Raises:
            UsageError: no such model.
        """
        if name is not None:
            self.load(name)
        write_atomic(self.folder / "selected.json", json.dumps(sealed({"model": name})) + "\n")

    def _path(self, name: str) -> Path:
        if not re.fullmatch(NAME, name) or name == "selected":
            raise UsageError(f"{name!r} cannot be a model's name", todo="small letters, digits, - and _, at most 40")
        return self.folder / f"{name}.json"

    def _generation(self, name: str, number: int) -> Path:
        return self.folder / "history" / name / f"{number:04d}.json"

    def _read(self, path: Path, name: str) -> DeflectionFile:
        try:
            file = parse_deflection(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            known = ", ".join(self.names())
            todo = f"there are: {known}" if known else "galen-hw deflection fit DATA... makes one"
            raise UsageError(f"no deflection model {name!r}", where=str(path), todo=todo) from None
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"cannot be read ({error})", where=str(path), todo=AGAIN) from None
        except DocumentError as error:
            raise UsageError(error.what, where=error.within(str(path)), todo=AGAIN) from None
        if file.schema_version != SCHEMA or file.name != name:
            raise UsageError(f"is not model {name!r} of schema {SCHEMA}", where=str(path), todo=AGAIN)
        return file
