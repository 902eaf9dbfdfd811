"""Who may connect to a daemon: the modes of its sockets' files, and one line for who may not."""

import grp
import os
import pwd
import stat
from pathlib import Path
from typing import Final

from galen_hw.errors import UsageError

OWN: Final = 0o700
"""Sockets between the daemon's own processes."""
OF_THE_GROUP: Final = 0o770


def socket_mode(directory: Path) -> int:
    """Mode of a socket that clients connect to: the group's too where the directory is for owner and group alone (0750).

    In a directory that is open to others, a group that is everybody's ("users") would command the robot.
    """
    mode = directory.stat().st_mode
    return OF_THE_GROUP if mode & stat.S_IXGRP and not mode & stat.S_IRWXO else OWN


def require_permission(path: Path) -> None:
    """Return if this user may connect to a socket's file, or none is there.

    ZeroMQ itself says nothing and tries for ever.

    Raises:
        UsageError: the file, or a directory on the way to it, is closed to this user.
    """
    try:
        closed = None if os.access(path, os.W_OK) or not path.exists() else path
    except PermissionError:
        closed = next((p for p in reversed(path.parents) if not os.access(p, os.X_OK)), path.parent)
    if closed is None:
        return
    found = closed.stat()
    user, group = _name_of_user(found.st_uid), _name_of_group(found.st_gid)
    if found.st_mode & (stat.S_IWGRP if closed == path else stat.S_IXGRP):
        what, todo = f"only members of the group {group} may", f"sudo usermod -aG {group} $USER, then log in again"
    else:
        what, todo = f"only the user {user} may", "start it as that user"
    raise UsageError(f"you may not connect to this daemon, {what}", where=str(closed), todo=todo)


def require_writable(folder: Path, command: str) -> None:
    """Return if this user may make files in a folder, or in what is there of the way to it.

    Args:
        command: what to start as the folder's owner otherwise.

    Raises:
        UsageError: not this user.
    """
    there = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not os.access(there, os.W_OK | os.X_OK):
        owner = _name_of_user(there.stat().st_uid)
        raise UsageError("you may not write there", where=str(there), todo=f"as its owner: sudo -u {owner} {command}")


def _name_of_user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _name_of_group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
