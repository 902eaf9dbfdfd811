"""CURVE keys: who may connect to the viewers' copy from another machine, and that it is this daemon which answers.

The daemon's folder:

    server.key_secret   the daemon's own pair; server.key its public half, which every viewer is given
    clients/NAME.key    public keys of the viewers that may connect

A viewer has NAME.key_secret, which was made with `galen-hw keys add NAME` and is kept nowhere else.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import zmq
import zmq.auth

from galen_hw.errors import UsageError

SERVER: Final = "server"
CLIENTS: Final = "clients"
NAME: Final = r"[a-z0-9][a-z0-9_-]{0,39}"


def add_key(folder: Path, name: str, out: Path) -> Path:
    """Make a viewer's pair (and the daemon's, if it has none); the secret half is written into `out`.

    Raises:
        UsageError: an impossible name, one that is there already, or a folder that cannot be written.
    """
    if not re.fullmatch(NAME, name) or name == SERVER:
        raise UsageError(f"{name!r} cannot be a viewer's name", todo="small letters, digits, - and _, at most 40")
    public = folder / CLIENTS / f"{name}.key"
    for path in (public, out / f"{name}.key_secret"):
        if path.exists():
            raise UsageError("is there already", where=str(path), todo=f"galen-hw keys remove {name}, or another name")
    try:
        with _private():
            (folder / CLIENTS).mkdir(parents=True, exist_ok=True)
            if not (folder / f"{SERVER}.key_secret").exists():
                zmq.auth.create_certificates(folder, SERVER)
            made, secret = (Path(path) for path in zmq.auth.create_certificates(folder, name))
            target = out / secret.name
            target.write_bytes(secret.read_bytes())
            secret.unlink()
            made.replace(public)
    except OSError as error:
        todo = "as the folder's owner: sudo galen-hw keys ..."
        raise UsageError(f"cannot be written ({error.strerror})", where=str(error.filename), todo=todo) from None
    return target


def remove_key(folder: Path, name: str) -> None:
    """Take a viewer's right away.

    Raises:
        UsageError: there is none of that name.
    """
    path = folder / CLIENTS / f"{name}.key"
    if not re.fullmatch(NAME, name) or not path.exists():
        raise UsageError(f"no viewer {name!r}", where=str(folder), todo=f"one of: {', '.join(names(folder)) or 'none'}")
    path.unlink()


def names(folder: Path) -> list[str]:
    """The viewers that may connect."""
    return sorted(path.stem for path in (folder / CLIENTS).glob("*.key"))


def secret_of(path: Path) -> tuple[bytes, bytes]:
    """Public and secret half of a file.

    Raises:
        UsageError: missing, not readable, damaged, or readable by others.
    """
    todo = "galen-hw keys add NAME makes one"
    try:
        if path.stat().st_mode & 0o007:
            raise UsageError("others may read it", where=str(path), todo=f"chmod o= {path}, and make a new one")
        public, secret = zmq.auth.load_certificate(path)
    except OSError as error:
        raise UsageError(f"cannot be read ({error.strerror or error})", where=str(path), todo=todo) from None
    except ValueError:
        raise UsageError("is no key", where=str(path), todo=todo) from None
    if secret is None or len(secret) != len(public) or len(public) != 40:
        raise UsageError("is no secret key", where=str(path), todo=todo)
    return public, secret


def public_of(path: Path) -> bytes:
    """The public half of a file.

    Raises:
        UsageError: missing, not readable or damaged.
    """
    try:
        public, _ = zmq.auth.load_certificate(path)
    except (OSError, ValueError):
        raise UsageError("is no key", where=str(path), todo="copy the daemon's server.key") from None
    return bytes(public)


def prove(socket: "zmq.Socket[Any]", secret: Path, server: Path) -> None:
    """Have a viewer's socket prove who it is, and demand it of the other end; before `connect`.

    Raises:
        UsageError: one of the keys cannot be used.
    """
    own, other = secret_of(secret), public_of(server)
    socket.curve_publickey, socket.curve_secretkey = own
    socket.curve_serverkey = other


@contextmanager
def _private() -> Iterator[None]:
    """Files that are made meanwhile are the owner's and the group's alone."""
    before = os.umask(0o027)
    try:
        yield
    finally:
        os.umask(before)
