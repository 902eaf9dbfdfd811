"""A real systemd in a box: namespaces and a root of its own, in which the unit that is installed runs a virtual robot."""

import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.daemon_tree import within

ROOT = Path(__file__).parent.parent
NAMESPACES = ("--pid", "--fork", "--mount", "--uts", "--ipc", "--net", "--cgroup")
DROP_IN = """[Service]
ExecStart=
ExecStart=/opt/galen-hw/bin/galen-hw run --virtual --config /etc/galen-hw/galen.toml
Environment=PYTHONPATH=/opt/sources LD_LIBRARY_PATH=/opt/python/lib
"""
"""Changes the unit for the box: the robot is virtual, and the environment is made of the tests' own."""


def obstacle() -> str:
    """Return why no systemd can be started here; empty if it can be tried."""
    if os.geteuid() != 0:
        return "only root may make the namespaces"
    missing = [name for name in ("unshare", "nsenter", "pivot_root", "systemctl") if shutil.which(name) is None]
    if missing or not Path("/lib/systemd/systemd").exists():
        return f"not installed: {', '.join(missing) or 'systemd'}"
    if _own_group() is None:
        return "no control groups of version 2 are mounted"
    done = subprocess.run(["unshare", *NAMESPACES, "true"], capture_output=True, text=True, check=False)
    return f"no namespaces: {done.stderr.strip()}" if done.returncode else ""


class Box:
    """A booted systemd; `pid` is its process as seen from here."""

    def __init__(self, pid: int) -> None:
        self.pid = pid

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command in the box."""
        inside = ["nsenter", "--target", str(self.pid), "--mount", "--pid", "--uts", "--ipc", "--net", "--cgroup", "--"]
        return subprocess.run([*inside, *words], capture_output=True, text=True, check=False, timeout=60)

    def show(self, name: str) -> str:
        """Return a property of the service, e.g. "ActiveState"."""
        return self.run("systemctl", "show", "galen-hw", "-p", name, "--value").stdout.strip()

    def reaches(self, state: str, seconds: float) -> bool:
        """Return whether the service comes to be "active", "inactive" or "failed" in time."""
        return within(seconds, lambda: self.show("ActiveState") == state)

    @property
    def main(self) -> int:
        """The service's main process, as the box numbers it."""
        return int(self.show("MainPID") or 0)


def _own_group() -> Path | None:
    """The folder of this process's control group of version 2."""
    own = next((x[3:] for x in Path("/proc/self/cgroup").read_text().splitlines() if x.startswith("0::")), None)
    mounts = (line.split() for line in Path("/proc/mounts").read_text().splitlines())
    at = next((words[1] for words in mounts if words[2] == "cgroup2"), None)
    return Path(at) / own.lstrip("/") if own is not None and at is not None else None


@contextmanager
def systemd_box(folder: Path) -> Iterator[Box]:
    """Boot a systemd with the files of `install-service`; whatever runs in it ends with the block.

    Raises:
        RuntimeError: it does not come up.
    """
    files, root = folder / "files", folder / "root"
    root.mkdir()
    drop_in = files / "etc/systemd/system/galen-hw.service.d/box.conf"
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(DROP_IN)
    own = _own_group()
    assert own is not None, "see obstacle"
    group = own / f"galen-hw-{uuid.uuid4().hex[:8]}"
    group.mkdir()
    where = (str(root), str(files), str(ROOT), sys.base_prefix, sysconfig.get_path("purelib"))
    boot = ["unshare", *NAMESPACES, "--kill-child", str(ROOT / "tests" / "systemd_box.sh"), *where]
    # The shell enters the group, so that the namespace of groups begins there: `preexec_fn` is not safe beside threads.
    enter = ["bash", "-c", 'echo $$ > "$0"/cgroup.procs && exec "$@"', str(group), *boot]
    with (folder / "boot.log").open("w") as log, subprocess.Popen(enter, stdout=log, stderr=log) as process:
        try:
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
            within(10.0, lambda: process.poll() is not None or bool(children.read_text().split()))
            box = Box(int((children.read_text().split() or ["0"])[0]) if process.poll() is None else 0)
            up = box.pid and within(30.0, lambda: box.run("systemctl", "is-active", "box.target").returncode == 0)
            if not up:
                raise RuntimeError((folder / "boot.log").read_text() or "systemd says nothing")
            yield box
        finally:
            if process.poll() is None:
                with suppress(OSError, ValueError, IndexError):
                    os.kill(int(children.read_text().split()[0]), signal.SIGKILL)  # pid 1: all in the box end with it
            process.wait(timeout=30)
            within(10.0, lambda: _is_gone(group))  # its processes may still be ending


def _is_gone(group: Path) -> bool:
    """Take the control groups of the box away, the innermost first; whether none is left."""
    for path in (*sorted((p for p in group.rglob("*") if p.is_dir()), reverse=True), group):
        with suppress(OSError):
            path.rmdir()
    return not group.exists()
