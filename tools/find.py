"""`galen-hw find`: the ports of this machine, each with the line that goes into galen.toml."""

import argparse
from dataclasses import asdict

from galen_hw.errors import EXIT_FOUND, EXIT_OK
from galen_hw.tools.answer import print_stamped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.epilog = "exit status: 0 ports were found, 1 none; example: galen-hw find"


def run(args: argparse.Namespace) -> int:
    """List serial ports by their lasting names, and CAN interfaces."""
    from galen_hw.config.found_ports import found_ports

    ports = found_ports()
    if args.json:
        print_stamped({"ports": [asdict(port) | {"setting": port.setting} for port in ports]})
        return EXIT_OK if ports else EXIT_FOUND
    for port in ports:
        print(port.setting)
        words = [f"now {port.device}" if port.device != port.name else "", port.note]
        if any(words):
            print(f"    {'; '.join(word for word in words if word)}")
    if not ports:
        print("no serial adapter and no CAN interface; plug one in, or use an slcan adapter's serial port for CAN")
    return EXIT_OK if ports else EXIT_FOUND
