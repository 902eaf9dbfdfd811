"""Writes the manual page from the program's own parsers: `python -m docs.man FILE` (argparse-manpage, extra `docs`)."""

import os
import sys

from docs.reference import STATUS, write
from galen_hw.cli import whole_parser
from galen_hw.version import VERSION

FILES = """.TP
/etc/galen\\-hw/galen.toml
settings; another with \\-\\-config or GALEN_HW_CONFIG
.TP
/run/galen\\-hw, /tmp/galen\\-hw\\-UID
sockets of the daemon, as a service and by hand; another with \\-\\-dir or GALEN_HW_RUNTIME
.TP
/var/lib/galen\\-hw, ~/.local/state/galen\\-hw
tools and calibrations; another with GALEN_HW_STATE
"""


def main() -> int:
    """Write the manual page."""
    return write(page())


def page() -> str:
    """Return the page in the language of man: every command, its parts and their options; the same on every day.

    Raises:
        ImportError: argparse-manpage is not installed.
    """
    from argparse_manpage.manpage import Manpage

    os.environ["COLUMNS"] = "100"  # as wide for everybody as argparse wraps
    parser = whole_parser()
    parser._positionals.title = "commands"  # noqa: SLF001 - argparse gives no other way to a heading
    written = Manpage(parser, format="single-commands-section", _data={"version": VERSION, "manual_title": "galen-hw"})
    written.date, written.description = "", "hardware interface of the Galen surgical robot"
    written.add_section("files", "=", FILES)
    written.add_section("exit status", "=", STATUS)
    return str(written)


if __name__ == "__main__":
    sys.exit(main())
