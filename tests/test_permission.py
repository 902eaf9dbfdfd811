"""Who may command a daemon: with the unit's umask its group may, others not, and who may not is told at once."""

import os
import pwd
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.errors import UsageError
from galen_hw.permission import OF_THE_GROUP, OWN, require_permission, socket_mode
from tests.daemon_tree import Tree, daemon_tree

OPERATORS = 54321
"""A group number that no other file of this machine has."""
UNIT = (Path(__file__).parents[1] / "config" / "galen-hw.service").read_text(encoding="utf-8")
try:
    NOBODY = pwd.getpwnam("nobody")
except KeyError:
    NOBODY = None  # type: ignore[assignment]
as_root = pytest.mark.skipif(os.getuid() != 0 or NOBODY is None, reason="only root can be somebody else")


DROP = """
import contextlib, grp, io, locale, os, pwd, sys
from galen_hw.cli import main
with contextlib.redirect_stderr(io.StringIO()):  # loads what rights may hide afterwards
    main(["command", "daemon", "info", "--dir", "/no-such-directory"])
os.setgroups({groups}), os.setgid({gid}), os.setuid({uid})
"""


def as_user(code: str, *groups: int, environ: dict[str, str]) -> "subprocess.CompletedProcess[str]":
    """What a user without rights, in these groups, sees of some Python."""
    drop = DROP.format(groups=list(groups), gid=NOBODY.pw_gid, uid=NOBODY.pw_uid)
    return subprocess.run(
        [sys.executable, "-c", drop + code], env=environ, capture_output=True, text=True, timeout=60, check=False
    )


@pytest.fixture(scope="module")
def service() -> Iterator[Tree]:
    """A daemon as the unit runs it: its umask, and a runtime directory of its group's with its mode."""
    mask = re.search(r"^UMask=(\d+)$", UNIT, re.MULTILINE)
    mode = re.search(r"^RuntimeDirectoryMode=(\d+)$", UNIT, re.MULTILINE)
    assert mask is not None
    assert mode is not None
    with tempfile.TemporaryDirectory() as folder, daemon_tree(Path(folder)) as tree:
        Path(folder).chmod(0o755)
        runtime = Path(folder) / "run"
        runtime.mkdir()
        os.chown(runtime, -1, OPERATORS)
        runtime.chmod(int(mode[1], 8))
        tree.write_config()
        before = os.umask(int(mask[1], 8))
        try:
            tree.start_ready()
        finally:
            os.umask(before)
        # What systemd does with Group=: the sockets are of the group that the daemon runs as.
        for name in ("command", "bus.pub", "batches"):
            os.chown(runtime / name, -1, OPERATORS)
        yield tree


CALL = """
sys.exit(main(["command", "daemon", "info", "--dir", sys.argv[1]]))
"""


def call(tree: Tree, *groups: int) -> "subprocess.CompletedProcess[str]":
    code = CALL.replace("sys.argv[1]", repr(str(tree.addresses.runtime)))
    return as_user(code, *groups, environ=tree.environ)


@as_root
def test_a_member_of_the_group_commands_and_others_are_told_at_once(service: Tree) -> None:
    """The unit's umask takes the group's right to write, without which a socket cannot be connected to."""
    member, begun = call(service, OPERATORS), time.monotonic()
    stranger = call(service)
    took_s = time.monotonic() - begun

    assert member.returncode == 0, member.stderr
    assert "ready: True" in member.stdout
    assert stranger.returncode == 2
    runtime = service.addresses.runtime
    line = (
        f"galen-hw command: {runtime}: you may not connect to this daemon, only members of the group {OPERATORS} may; "
    )
    assert stranger.stderr == f"{line}sudo usermod -aG {OPERATORS} $USER, then log in again\n"
    assert took_s < 20.0


@as_root
def test_only_the_clients_sockets_are_the_groups(service: Tree) -> None:
    """A member of the group commands; he does not speak for the daemon's own processes."""
    names = ("command", "bus.pub", "batches", "control", "inward")
    modes = [(service.addresses.runtime / name).stat().st_mode & 0o777 for name in names]

    assert modes == [OF_THE_GROUP, OF_THE_GROUP, OF_THE_GROUP, OWN, OWN]


@as_root
def test_a_closed_socket_says_so_to_every_kind_of_client(service: Tree) -> None:
    """Commands and subscriptions, through a directory that others may enter: the socket's own mode counts then."""
    runtime = service.addresses.runtime
    runtime.chmod(0o755)
    try:
        code = f"""
from galen_hw.bus import CommandClient, Subscriber
from galen_hw.errors import UsageError
for make, name in ((CommandClient, "command"), (Subscriber, "bus.pub")):
    try:
        make("ipc://{runtime}/" + name)
    except UsageError as error:
        print(error)
"""
        found = as_user(code, environ=service.environ)
    finally:
        runtime.chmod(0o750)

    assert found.stdout.count("you may not connect to this daemon") == 2, found.stderr


@pytest.mark.parametrize(
    ("mode", "expected"), [(0o750, OF_THE_GROUP), (0o700, OWN), (0o755, OWN), (0o770, OF_THE_GROUP)]
)
def test_the_directory_says_whether_the_group_may(tmp_path: Path, mode: int, expected: int) -> None:
    """For owner and group alone: the group commands. Open to others: who knows what its group is."""
    folder = tmp_path / "run"
    folder.mkdir()
    folder.chmod(mode)

    assert socket_mode(folder) == expected


def test_where_nobody_is_there_is_nothing_to_forbid(tmp_path: Path) -> None:
    """No file, no folder, no directory but a file: the client will meet that, in other words."""
    for path in (tmp_path / "command", tmp_path / "no" / "command"):
        require_permission(path)
        with CommandClient(f"ipc://{path}"), Subscriber(f"ipc://{path}"):
            pass


@pytest.mark.skipif(os.getuid() == 0, reason="root may everything")
def test_who_may_not_is_told_whose_it_is(tmp_path: Path) -> None:
    """A socket of the owner alone."""
    path = tmp_path / "command"
    path.touch(mode=0o400)
    with pytest.raises(UsageError, match=r"only the user .* may; start it as that user"):
        require_permission(path)
