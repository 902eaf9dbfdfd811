"""`galen-hw keys`: which viewers on other machines may connect."""

import argparse
from pathlib import Path

from galen_hw.errors import EXIT_OK

FOLDER = Path("/etc/galen-hw/keys")
WHAT = ("add", "list", "remove")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("what", choices=WHAT, metavar=f"{{{','.join(WHAT)}}}", help="add NAME, list, or remove NAME")
    parser.add_argument("name", nargs="?", default="", help="of the viewer: small letters, digits, - and _")
    parser.add_argument(
        "--keys", type=Path, default=FOLDER, metavar="DIR", help=f"the daemon's folder (default: {FOLDER})"
    )
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="where the viewer's secret is written")
    parser.epilog = (
        "a viewer only ever reads; who may command is a matter of the group; example: galen-hw keys add laptop"
    )


def run(args: argparse.Namespace) -> int:
    """Make, list or take away."""
    from galen_hw import keys
    from galen_hw.errors import UsageError

    if (args.what == "list") == bool(args.name):
        todo = "galen-hw keys list, galen-hw keys add NAME, galen-hw keys remove NAME"
        raise UsageError("takes no name" if args.name else "needs a name", where=args.what, todo=todo)
    if args.what == "add":
        secret = keys.add_key(args.keys, args.name, args.out)
        print(f"{secret}: the viewer's secret; give it to nobody else, with {args.keys / 'server.key'}")
        print(f'the daemon needs [bus] keys = "{args.keys}", and a new start')
    elif args.what == "remove":
        keys.remove_key(args.keys, args.name)
        print(f"{args.name} may not connect any more, once the daemon has been started again")
    else:
        for name in keys.names(args.keys):
            print(name)
    return EXIT_OK
