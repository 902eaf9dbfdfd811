"""Recordings where fsspec reaches them: object storage, another computer, a URL; fetched for as long as they are read.

`s3://bucket/run.mcap` is a `Remote` wherever a path may stand. `file://` is the path itself.
"""

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from galen_hw.errors import GalenError, UsageError
from galen_hw.extras import need
from galen_hw.formats.own import TABLES, expanded

WHOLE: Final = (*TABLES, "metadata.yaml")
"""Files that make one recording of the folder that they are in."""


@dataclass(frozen=True)
class Remote:
    """A file or a folder by its URL."""

    url: str

    @property
    def name(self) -> str:
        """Return the last part of it."""
        return PurePosixPath(self.url).name

    @property
    def stem(self) -> str:
        """Return the name without its ending."""
        return PurePosixPath(self.url).stem

    def __str__(self) -> str:
        return self.url


Place = Path | Remote
"""Where a recording is."""


def place(word: str | Path) -> Place:
    """Return where a word of the command line says that a recording is."""
    text = str(word)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    return Remote(text.rstrip("/")) if isinstance(word, str) and "://" in text else Path(word)


def recordings_in(where: Place) -> list[Place]:
    """Return the recordings of a folder of recordings, as `own.expanded` does; else the place itself.

    Raises:
        UsageError: it is not there or cannot be reached.
    """
    if isinstance(where, Path):
        return list(expanded(where))
    with _told(where):
        system, root = _opened(where)
        if not system.isdir(root):
            return [where]
        below = {name.removeprefix(root).strip("/") for name in system.find(root, maxdepth=2)}
    if below.intersection(WHOLE):
        return [where]
    inside = {name.rpartition("/")[0] for name in below if name.endswith("/recording.json")}
    inside |= {name for name in below if "/" not in name and name.endswith(".mcap")}
    return [Remote(f"{where.url}/{name}") for name in sorted(inside)] or [where]


@contextmanager
def at_hand(places: Sequence[Place]) -> Iterator[list[Path]]:
    """Paths at which recordings can be read; what had to be fetched is removed at the end.

    With a file come what says what it is: recording.json, its map, and the URDFs beside it. An error inside names the URL.

    Raises:
        UsageError: one is not there, cannot be reached, or has no room here.
    """
    names: dict[str, str] = {}
    with ExitStack() as stack:
        paths = []
        for one in places:
            if isinstance(one, Path):
                paths.append(one)
                continue
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="galen-hw-fetched-")))
            with _told(one):
                paths.append(_fetched(one, folder))
            names[str(paths[-1])] = str(one)
        try:
            yield paths
        except GalenError as error:
            for path, url in names.items():
                error.where, error.todo = error.where.replace(path, url), error.todo.replace(path, url)
            error.args = (error.what, error.where, error.todo)
            raise


def _fetched(where: Remote, folder: Path) -> Path:
    """The path of what was fetched into an empty folder."""
    system, root = _opened(where)
    if system.isdir(root):
        found = {name: name.removeprefix(root).strip("/") for name in system.find(root)}
        found = {name: f"{where.name}/{below}" for name, below in found.items()}
    else:
        above = root.rpartition("/")[0]
        beside = [n.rpartition("/")[2] for n in system.ls(above, detail=False)] if system.isdir(above) else []
        wanted = [n for n in beside if n in ("recording.json", f"{where.name}.map.toml") or n.endswith(".urdf")]
        found = {root: where.name} | {f"{above}/{name}": name for name in wanted}
    sizes = [system.size(name) or 0 for name in found]
    free = shutil.disk_usage(folder).free
    if sum(sizes) > free:
        what = f"{sum(sizes) / 1e6:.0f} MB, where {free / 1e6:.0f} MB are free in {folder.parent}"
        raise UsageError(what, where=str(where), todo="make room, or set TMPDIR")
    for name, below in found.items():
        if ".." in PurePosixPath(below).parts:
            raise UsageError(f"a name with '..' in it: {name}", where=str(where), todo="rename it there")
        (folder / below).parent.mkdir(parents=True, exist_ok=True)
        system.get_file(name, str(folder / below))
    return folder / where.name


def _opened(where: Remote) -> tuple[Any, str]:
    """The file system of a URL and the path in it, which exists."""
    need("remote", str(where), "fsspec")
    from fsspec.core import url_to_fs

    system, root = url_to_fs(where.url)
    # An earlier listing is no answer: the recording may have come since.
    system.invalidate_cache()
    if not system.exists(root):
        raise FileNotFoundError(where.url)
    return system, str(root).rstrip("/")


@contextmanager
def _told(where: Remote) -> Iterator[None]:
    """Whatever a storage raises as one line: each has errors of its own, and fsspec gives them on."""
    try:
        yield
    except GalenError:
        raise
    except FileNotFoundError as error:
        raise UsageError("there is no such recording", where=str(where), todo="check the URL") from error
    except PermissionError as error:
        raise UsageError("it may not be read with these credentials", where=str(where), todo="log in there") from error
    except ImportError as error:
        todo = "pip install 'galen-hw[remote]' for s3://, else the package that it names"
        raise UsageError(f"this storage needs a package ({error})", where=str(where), todo=todo) from error
    except Exception as error:
        first = (str(error).splitlines() or [""])[0][:160] or type(error).__name__
        todo = "check the URL, the network and the storage's settings"
        raise UsageError(f"cannot be fetched ({first})", where=str(where), todo=todo) from error
