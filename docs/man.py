"""Writes the manual page from the program's own parsers: `python -m docs.man FILE` (argparse-manpage, extra `docs`)."""

import os
import sys
from pathlib import Path

from docs.reference import STATUS
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
    """Write the page to the path given, or to the standard output."""
    text = page()
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 0


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
