"""A robot that its user names: the text of its URDF, or what a xacro file expands to.

xacrodoc expands it in a process of its own: relative includes are looked for in the working directory, whatever file
holds them, and a loop without an end must not be ours. A xacro file runs Python: only what a person names on the command
line is expanded, never what a recording or a map names.
"""

import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from galen_hw.errors import UsageError
from galen_hw.extras import need
from galen_hw.kinematics.urdf import read_urdf

EXPAND: Final = """
import sys
from xacrodoc import XacroDoc
given = dict(word.split(":=", 1) for word in sys.argv[2:])
print(XacroDoc.from_file(sys.argv[1], subargs=given, resolve_packages=False).to_urdf_string())
"""
LIMIT_S: Final = 60.0
"""For an expansion; those of whole mobile manipulators take a second."""


@dataclass(frozen=True)
class RobotFile:
    """A robot: the name that a recording gives it, and the text of its URDF; empty for the Galen, which has none."""

    name: str
    text: str


def robot_file(path: Path, arguments: Sequence[str] = ()) -> RobotFile:
    """Read a URDF, or expand a xacro file.

    Args:
        path: the file, a xacro by its name (.xacro) or by what is in it; or `galen`, where no such file is.
        arguments: KEY:=VALUE for its <xacro:arg>.

    Raises:
        UsageError: it is not there, cannot be read or expanded, or is no xacro and has arguments.
        MissingExtraError: xacrodoc is not installed.
    """
    where = str(path)
    if where == "galen" and not arguments and not path.exists():
        return RobotFile("galen", "")
    todo = "give a URDF or a xacro file"
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        what = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read ({error.strerror})"
        raise UsageError(what, where=where, todo=todo) from error
    if not text.lstrip().startswith("<"):
        raise UsageError("not a URDF", where=where, todo=todo)
    wrong = [word for word in arguments if not re.fullmatch(r"\w+:=.*", word)]
    if wrong:
        raise UsageError("not KEY:=VALUE", where=f"--xacro-arg {wrong[0]}", todo="e.g. --xacro-arg ur_type:=ur5e")
    if path.suffix != ".xacro" and "<xacro:" not in text:
        if arguments:
            raise UsageError("it is no xacro file", where=where, todo="leave --xacro-arg out")
        read_urdf(path)  # Here, where an error can name the file: a recording holds the text alone.
        return RobotFile(path.name, text)
    need("xacro", where)
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    return RobotFile(f"{stem}.urdf", _expanded(path, arguments))


def _expanded(path: Path, arguments: Sequence[str]) -> str:
    # -P: a file xacrodoc.py beside the robot is not the library.
    command = [sys.executable, "-P", "-c", EXPAND, path.name, *arguments]
    try:
        done = subprocess.run(
            command, cwd=path.resolve().parent, capture_output=True, text=True, check=False, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        what = f"xacrodoc has not expanded it within {LIMIT_S:.0f} s"
        raise UsageError(what, where=str(path), todo="make a URDF of it with the tools of its ROS package") from None
    if done.returncode:
        raise _explained(done.stderr, str(path))
    return done.stdout


def _explained(said: str, where: str) -> UsageError:
    """The error for what xacrodoc said last."""
    words = said.partition("Traceback")[2].splitlines() or said.splitlines() or [""]
    last = next((line for line in reversed(words) if re.match(r"[\w.]+(Exception|Error)\b", line)), words[-1])
    reason = re.sub(r"^[\w.]+: ", "", last).strip()
    argument = re.search(r"Undefined substitution argument (\w+)", reason)
    package = re.search(r"Package not found: (\S+)", reason)
    if argument:
        what = f"xacro argument {argument[1]} has no value"
        return UsageError(what, where=where, todo=f"--xacro-arg {argument[1]}:=VALUE")
    if package:
        todo = "source its ROS workspace, or name the folder of its packages in ROS_PACKAGE_PATH"
        return UsageError(f"there is no ROS package {package[1]}", where=where, todo=todo)
    return UsageError(f"xacrodoc cannot expand it ({reason[:160]})", where=where, todo="correct the file")
