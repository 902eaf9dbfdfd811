"""Which drivers, transports and services a settings file may name, and the reading of it with them."""

from pathlib import Path
from typing import Final

from galen_hw.config.load import Setup, Tables, load
from galen_hw.config.paths import config_path
from galen_hw.drivers.table import DRIVERS
from galen_hw.services.table import SERVICES

TRANSPORTS: Final[dict[str, str]] = {
    "can": "galen_hw.drivers.can_transport:CanTransport",
    "serial": "galen_hw.drivers.serial_transport:SerialTransport",
    "bota": "galen_hw.drivers.bota_transport:BotaTransport",
}
TABLES: Final = Tables(drivers=DRIVERS, transports=TRANSPORTS, services=SERVICES)


def read_setup(given: str | None = None, tables: Tables = TABLES) -> Setup:
    """The checked settings of the file given, or of the usual place (see `config_path`).

    Raises:
        ConfigError: with every problem of the file.
        UsageError: it cannot be read at all.
    """
    return load(Path(config_path(given)), tables)
