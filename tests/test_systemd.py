"""The unit under a real systemd, in a box of namespaces: its sandbox, its start, its watchdog, its end.

Skipped with the reason where none can be started. The robot is virtual; all else is what `install-service` writes.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from galen_hw.tools.install_service import SETTINGS, UNIT, planned
from tests.daemon_tree import within
from tests.systemd_box import Box, obstacle, systemd_box

WHY_NOT = obstacle()
pytestmark = [
    pytest.mark.skipif(bool(WHY_NOT), reason=f"no systemd can be started here: {WHY_NOT}"),
    pytest.mark.live,
    pytest.mark.slow,
    pytest.mark.timeout(300),
]
START_S = 60.0
GALEN = ("/usr/bin/env", "PYTHONPATH=/opt/sources", "LD_LIBRARY_PATH=/opt/python/lib", "/opt/galen-hw/bin/galen-hw")
AS_MEMBER = ("setpriv", "--reuid=65534", "--regid=65534", "--groups")


@pytest.fixture(name="box", scope="module")
def booted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Box]:
    folder = tmp_path_factory.mktemp("systemd")
    for file in planned("/opt/galen-hw/bin/galen-hw", 1_000_000, 100):
        path = folder / "files" / file.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(file.text)
    try:
        with systemd_box(folder) as box:
            yield box
    except RuntimeError as error:
        pytest.skip(f"no systemd comes up here: {error}")


@pytest.fixture(name="service")
def started(box: Box) -> Box:
    """The service, active; started anew where a test before has ended it."""
    box.run("systemctl", "reset-failed", "galen-hw")
    box.run("systemctl", "start", "galen-hw")
    assert box.reaches("active", START_S), box.run("journalctl", "-u", "galen-hw", "--no-pager").stdout[-3000:]
    return box


def test_it_is_started_when_samples_flow_with_no_rights_at_all(service: Box) -> None:
    """READY came from the daemon; its user is its own, without a capability, behind a filter of system calls."""
    assert within(START_S, lambda: service.show("StatusText").startswith("ft ready, motors ready"))
    said = service.run("cat", f"/proc/{service.main}/status").stdout
    state = {key: value.strip() for key, _, value in (line.partition(":") for line in said.splitlines())}
    assert int(state["Uid"].split()[0]) != 0
    assert {int(state[key], 16) for key in ("CapEff", "CapPrm", "CapBnd", "CapInh", "CapAmb")} == {0}
    assert (state["NoNewPrivs"], state["Seccomp"]) == ("1", "2")


def test_its_group_commands_and_nobody_else(service: Box) -> None:
    """A member of the group is answered; who is none is told so at once, whatever the umask."""
    group = service.run("getent", "group", "galen-hw").stdout.split(":")[2]
    command = (*GALEN, "command", "daemon", "info", "--dir", "/run/galen-hw")
    member = service.run(*AS_MEMBER, group, *command)
    assert member.returncode == 0, member.stderr
    assert "robot: galen" in member.stdout
    other = service.run(*AS_MEMBER, "65534", *command)
    assert (other.returncode, other.stderr.count("\n")) == (2, 1), other.stderr
    assert "only members of the group galen-hw may" in other.stderr


def test_a_supervisor_that_stands_still_is_replaced_by_the_watchdog(service: Box) -> None:
    """SIGSTOP: the watchdog of five seconds asks for the end, and the service is active again with another process."""
    before, restarts = service.main, int(service.show("NRestarts"))
    service.run("kill", "-STOP", str(before))
    assert service.reaches("activating", 40.0)
    assert service.reaches("active", START_S)
    assert service.main != before
    assert int(service.show("NRestarts")) == restarts + 1


def test_a_supervisor_that_is_killed_is_started_again(service: Box) -> None:
    before = service.main
    service.run("kill", "-KILL", str(before))
    assert service.reaches("activating", 10.0)
    assert service.reaches("active", START_S)
    assert service.main != before


def test_it_is_stopped_cleanly_and_leaves_no_process(service: Box) -> None:
    """`systemctl stop`: status 0, the group of the service is empty, the sockets are gone with its directory."""
    assert service.run("systemctl", "stop", "galen-hw").returncode == 0
    assert (service.show("ActiveState"), service.show("Result"), service.show("ExecMainStatus")) == (
        "inactive",
        "success",
        "0",
    )
    assert service.run("pgrep", "--uid", "galen-hw").stdout == ""
    assert service.run("test", "-e", "/run/galen-hw").returncode == 1


def test_wrong_settings_are_said_once_and_not_tried_again(box: Box) -> None:
    """Status 2: systemd leaves it at that; the journal says what is wrong."""
    box.run("systemctl", "stop", "galen-hw")
    box.run("sh", "-c", f"cp /{SETTINGS} /tmp/good && echo 'nonsense = 1' > /{SETTINGS}")
    try:
        box.run("systemctl", "start", "galen-hw")
        assert box.reaches("failed", 20.0)
        assert (box.show("ExecMainStatus"), box.show("NRestarts")) == ("2", "0")
        assert "nonsense" in box.run("journalctl", "-u", "galen-hw", "--no-pager").stdout
    finally:
        box.run("cp", "/tmp/good", f"/{SETTINGS}")


def test_systemd_finds_nothing_to_say_against_the_unit(box: Box) -> None:
    """`systemd-analyze verify` of the unit as it is installed: no unknown directive, no missing program."""
    done = box.run("systemd-analyze", "verify", f"/{UNIT}")
    assert [line for line in done.stderr.splitlines() if Path(UNIT).name in line] == []
