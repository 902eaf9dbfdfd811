"""The virtual robot in place of the configured wires."""

import json
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from galen_hw.config.load import Setup, Tables, with_transports
from galen_hw.daemon.layout import MOTORS, SENSOR, TRACKER
from galen_hw.errors import HardwareError

READY_WITHIN_S: Final = 20.0
WIRE_OF: Final = {SENSOR: "can0", MOTORS: "motors", TRACKER: "tracker"}


@contextmanager
def virtual_setup(setup: Setup, tables: Tables, folder: Path) -> Iterator[Setup]:
    """Start the virtual robot in `folder` and yield the set-up with its wires; it ends with the block, or with us.

    Raises:
        HardwareError: it does not start; its own line says why.
    """
    sensor = setup.config.devices[SENSOR].driver if SENSOR in setup.config.devices else "ati_netcanoem"
    command = [sys.executable, "-m", "galen_hw.cli", "virtual", "--json", "--dir", str(folder), "--sensor", sensor]
    process = subprocess.Popen(
        [*command, "--parent-pid", str(os.getpid())], stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        addresses = _addresses(process)
        wires = {name: addresses[wire] for name, wire in WIRE_OF.items() if wire in addresses}
        yield with_transports(setup, wires, tables)
    finally:
        process.terminate()
        try:
            process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


def _addresses(process: "subprocess.Popen[bytes]") -> dict[str, dict[str, Any]]:
    """What the virtual robot says when it is ready: transport settings by wire."""
    assert process.stdout is not None
    if select.select([process.stdout], (), (), READY_WITHIN_S)[0] and (line := process.stdout.readline()):
        ready: dict[str, dict[str, dict[str, Any]]] = json.loads(line)
        return ready["addresses"]
    process.terminate()
    todo = "run galen-hw virtual by hand to see what it says"
    raise HardwareError("the virtual robot does not start", where="galen-hw virtual", todo=todo)
