"""`galen-hw virtual`: the virtual robot, the other ends of the wires, as a process of its own."""

import argparse
from pathlib import Path
from typing import Any

from galen_hw.documents import DocumentError, load_json
from galen_hw.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--dir", type=Path, help="folder of the links can0, motors, tracker and the socket control")
    parser.add_argument("--sensor", default="ati_netcanoem", help="ati_netcanoem (default), robotous_rft or iit_strain")
    parser.add_argument("--can", default="slcan", help="slcan (default), socketcan, udp_multicast or socketcand")
    parser.add_argument("--channel", default="", help="of --can: vcan0, a multicast address, a TCP port")
    parser.add_argument("--tool", help="in the holder at first: pointer or retractor; default none")
    parser.add_argument("--seed", type=int, default=0, help="of the noise; the same seed, the same noise")
    parser.add_argument("--settings", default="{}", help="JSON, settings by device: '{\"ati_netcanoem\": {...}}'")
    parser.add_argument("--parent-pid", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help="one line of JSON instead of text when ready")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    from galen_hw.config.paths import Addresses, runtime_dir
    from galen_hw.drivers.virtual.process import Options, run

    options = Options(
        folder=(args.dir or Addresses(runtime_dir()).virtual).absolute(),
        sensor=args.sensor,
        can=args.can,
        channel=args.channel,
        seed=args.seed,
        tool=args.tool,
        settings=_settings(args.settings),
        parent_pid=args.parent_pid,
    )
    return run(options, as_json=args.json)


def _settings(text: str) -> dict[str, dict[str, Any]]:
    try:
        out = load_json(text)
    except DocumentError as error:
        raise UsageError(error.what, where="--settings", todo="check the quotes") from error
    if not isinstance(out, dict) or not all(isinstance(v, dict) for v in out.values()):
        raise UsageError("not an object of objects", where="--settings", todo='as in {"ati_netcanoem": {"base_id": 1}}')
    return out
