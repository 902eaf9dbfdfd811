"""`galen-hw install-service`: the daemon as a systemd service, with its user, udev rules, unit and settings."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from galen_hw.errors import EXIT_OK, UsageError

BITRATE: Final = 1_000_000
RESTART_MS: Final = 100
HIDDEN: Final = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # noqa: S108 - what the unit hides from the service
SETTINGS: Final = "etc/galen-hw/galen.toml"
UNIT: Final = "etc/systemd/system/galen-hw.service"
BEFORE: Final = ".before-galen-hw"
"""Ends the name of what stood where a file of ours goes, and was another."""


@dataclass(frozen=True, slots=True)
class File:
    """A file to be installed.

    Args:
        path: below the root; text: of it; keep: the user's own: never replaced, never taken away.
    """

    path: str
    text: str
    keep: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--dry-run", action="store_true", help="say what would be done, and do nothing")
    parser.add_argument("--uninstall", action="store_true", help="take the service away; settings and state stay")
    parser.add_argument("--config", metavar="FILE", type=Path, help="settings to install (default: the package's)")
    parser.add_argument("--bitrate", type=int, default=BITRATE, help="of CAN interfaces, bit/s (default: 1000000)")
    parser.add_argument("--restart-ms", type=int, default=RESTART_MS, help="CAN comes back so long after bus-off")
    parser.add_argument("--root", type=Path, default=Path("/"), help="files only, below this folder: for an image")
    parser.epilog = "example: sudo galen-hw install-service --dry-run"


def run(args: argparse.Namespace) -> int:
    """Install, or take away."""
    if not 10_000 <= args.bitrate <= 1_000_000:
        raise UsageError("must be from 10000 to 1000000", where="--bitrate", todo="e.g. --bitrate 1000000")
    if not 1 <= args.restart_ms <= 10_000:
        raise UsageError("must be from 1 to 10000", where="--restart-ms", todo="e.g. --restart-ms 100")
    here = args.root == Path("/")
    if here and not args.dry_run:
        _require_system()
    files = planned(_program(), args.bitrate, args.restart_ms, args.config)
    if args.uninstall:
        _uninstall(files, args.root, dry=args.dry_run, here=here)
    else:
        _install(files, args.root, dry=args.dry_run, here=here)
    return EXIT_OK


def planned(program: str, bitrate: int, restart_ms: int, settings: Path | None = None) -> list[File]:
    """The files, with this installation's path and the CAN settings in them.

    Raises:
        UsageError: the settings cannot be read, or the service could not see this installation.
    """
    from galen_hw.config.load import read_document
    from galen_hw.config.paths import DEFAULT_CONFIG

    for folder in HIDDEN:
        if Path(program).is_relative_to(folder):
            todo = "install it in a virtual environment that all may read: python3 -m venv /opt/galen-hw"
            raise UsageError(f"the service would not see it: the unit hides {folder}", where=program, todo=todo)
    ours = DEFAULT_CONFIG.parent
    wanted = settings or DEFAULT_CONFIG
    read_document(wanted)
    unit = _text(ours / "galen-hw.service").replace("/opt/galen-hw/bin/galen-hw", program)
    rules = _text(ours / "99-galen-hw.rules")
    rules = re.sub(r"bitrate \d+ restart-ms \d+", f"bitrate {bitrate} restart-ms {restart_ms}", rules)
    rules = rules.replace("# CAN adapters: 1 Mbit/s,", f"# CAN adapters: {bitrate} bit/s,")
    return [
        File("etc/sysusers.d/galen-hw.conf", _text(ours / "galen-hw.sysusers.conf")),
        File("etc/udev/rules.d/99-galen-hw.rules", rules),
        File(SETTINGS, _text(wanted), keep=True),
        File(UNIT, unit),
    ]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _program() -> str:
    """The `galen-hw` of this environment."""
    return str(Path(sys.prefix) / "bin" / "galen-hw")


def _require_system() -> None:
    """Refuse where nothing can be installed.

    Raises:
        UsageError: no systemd, or not root.
    """
    if shutil.which("systemctl") is None or not Path("/run/systemd/system").is_dir():
        todo = "start the daemon by hand (galen-hw run), or write the files for an image with --root DIR"
        raise UsageError("systemd does not run here", where="install-service", todo=todo)
    if os.geteuid() != 0:
        raise UsageError(
            "only root may install a service", where="install-service", todo="sudo galen-hw install-service"
        )


def _install(files: list[File], root: Path, *, dry: bool, here: bool) -> None:
    for file in files:
        _place(file, root / file.path, dry=dry)
    _carry_out(
        [
            ["systemd-sysusers"],
            ["udevadm", "control", "--reload"],
            ["udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=usb-serial", "--subsystem-match=net"],
            ["systemctl", "daemon-reload"],
            ["systemctl", "enable", "galen-hw"],
        ],
        dry=dry,
        here=here,
    )
    print(f"next: edit /{SETTINGS} (galen-hw find, galen-hw check), then systemctl start galen-hw")


def _place(file: File, path: Path, *, dry: bool) -> None:
    old = _read(path)
    if old == file.text:
        print(f"{path}: is there already")
    elif old is not None and file.keep:
        print(f"{path}: stays as it is, it is yours")
    else:
        if old is not None:
            before = path.with_name(path.name + BEFORE)
            print(f"{path}: {'would be' if dry else 'is'} replaced; what was there is in {before.name}")
            if not dry and not before.exists():
                _write(before, old)
        else:
            print(f"{path}: {'would be' if dry else 'is'} written")
        if not dry:
            _write(path, file.text)


def _uninstall(files: list[File], root: Path, *, dry: bool, here: bool) -> None:
    _carry_out([["systemctl", "disable", "--now", "galen-hw"]], dry=dry, here=here)
    for file in files:
        path = root / file.path
        old = _read(path)
        if old is None:
            print(f"{path}: is not there")
        elif file.keep:
            print(f"{path}: stays, it is yours")
        else:
            print(f"{path}: {'would be' if dry else 'is'} taken away")
            if not dry:
                path.unlink()
                _give_back(path)
    _carry_out([["systemctl", "daemon-reload"], ["udevadm", "control", "--reload"]], dry=dry, here=here)
    print("the user galen-hw and /var/lib/galen-hw (calibrations) stay: userdel galen-hw; rm -r /var/lib/galen-hw")


def _give_back(path: Path) -> None:
    before = path.with_name(path.name + BEFORE)
    if before.exists():
        before.replace(path)
        print(f"{path}: is what it was before")


def _carry_out(commands: list[list[str]], *, dry: bool, here: bool) -> None:
    """Run commands on this machine; say them where they are not run.

    Raises:
        UsageError: one has failed; those before it stay done, and the same again goes on.
    """
    for command in commands:
        words = " ".join(command)
        if dry or not here:
            print(f"{'would run' if here else 'to be run there'}: {words}")
            continue
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            why = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
            raise UsageError(f"failed ({why})", where=words, todo="mend that, then do the same again")


def _read(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(path), todo="look at what it is") from None


def _write(path: Path, text: str) -> None:
    from galen_hw.config.tool_store import write_atomic

    write_atomic(path, text)
    path.chmod(0o644)
