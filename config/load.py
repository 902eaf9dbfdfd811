"""Reads the settings file into a `Setup`, or names everything that is wrong with it at once."""

import importlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from galen_hw.config.found_ports import lasting_name
from galen_hw.config.problems import ConfigError, Places, Problem, check, unknown
from galen_hw.config.schema import Config
from galen_hw.documents import DocumentError, load_toml
from galen_hw.errors import UsageError

_BARE_TTY: Final = re.compile(r"^/dev/tty(USB|ACM)\d+$")


@dataclass(frozen=True, slots=True)
class Tables:
    """Which classes may be named in the file: `key: "module:Class"`, loaded when they are.

    Args:
        drivers, transports (by wire: "can", "serial", "bota"), services: the tables.
    """

    drivers: Mapping[str, str]
    transports: Mapping[str, str]
    services: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class DeviceSetup:
    """One device of the file, with its classes and their checked settings."""

    name: str
    driver: type[Any]
    settings: BaseModel
    transport: type[Any]
    transport_settings: BaseModel
    optional: bool = False


@dataclass(frozen=True, slots=True)
class ServiceSetup:
    """One service of the file, with its class and its checked settings."""

    name: str
    service: type[Any]
    settings: BaseModel


@dataclass(frozen=True, slots=True)
class Setup:
    """A configuration that has been checked as far as a file can be.

    Args:
        config: as read; path: of the file, for messages.
        devices, services: by name.
        virtual: the devices' wires lead to virtual ones.
        speed: not 1: all of it in simulated time, at most so many times as fast as the clock.
    """

    config: Config
    path: Path
    devices: dict[str, DeviceSetup] = field(default_factory=dict)
    services: dict[str, ServiceSetup] = field(default_factory=dict)
    virtual: bool = False
    speed: float = 1.0


def read_document(path: Path) -> tuple[dict[str, Any], Places]:
    """The TOML document of a file, and the lines of its keys.

    Raises:
        UsageError: no such file, not readable, or not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return load_toml(text), Places(path.name, text)
    except FileNotFoundError:
        todo = "check the path; galen-hw install-service writes /etc/galen-hw/galen.toml"
        raise UsageError("no such file", where=str(path), todo=todo) from None
    except OSError as error:
        raise UsageError(error.strerror or "cannot be read", where=str(path), todo="check its permissions") from None
    except UnicodeDecodeError:
        raise UsageError(
            "not a text file in UTF-8", where=str(path), todo="give the settings with --config FILE"
        ) from None
    except DocumentError as error:
        where = f"{path.name}:{error.line}" if error.line else path.name
        raise UsageError(error.what, where=where, todo="see the comments of the default galen.toml") from None


def load(path: Path, tables: Tables) -> Setup:
    """Read and check a settings file.

    Raises:
        ConfigError: with every problem that the file has.
        UsageError: it cannot be read at all.
    """
    document, places = read_document(path)
    return check_document(document, path, places, tables)


def check_document(document: dict[str, Any], path: Path, places: Places, tables: Tables) -> Setup:
    """Check a document: the sections here, then each device's and service's own settings.

    Raises:
        ConfigError: with every problem of it.
    """
    setup, problems = examine(document, path, places, tables)
    if problems:
        raise ConfigError(problems)
    return setup


def examine(document: dict[str, Any], path: Path, places: Places, tables: Tables) -> tuple[Setup, list[Problem]]:
    """What of a document can be used (defaults for the sections that cannot), and every problem of it, by line."""
    config, problems = check(Config, document, (), places)
    devices, services = {}, {}
    for name, section in _tables(document, "devices"):
        problems += _bare_tty(section.get("transport"), ("devices", name, "transport"), places)
        device = _device(name, section, places, tables, problems)
        if device is not None:
            devices[name] = device
    for name, section in _tables(document, "services"):
        service = _service(name, section, places, tables, problems)
        if service is not None:
            services[name] = service
    problems += _shared_ports(document, places)
    usable = config if isinstance(config, Config) else Config.model_construct()
    return Setup(usable, path, devices, services), sorted(set(problems), key=_line_of)


def with_transports(
    setup: Setup,
    transports: Mapping[str, dict[str, Any]],
    tables: Tables,
    settings: Mapping[str, dict[str, Any]] | None = None,
    services: Mapping[str, dict[str, Any]] | None = None,
) -> Setup:
    """The same set-up on other wires, e.g. the virtual robot's; devices not in `transports` are left out.

    `settings`, `services`: by device and by service, what is set beside its own settings.
    """
    more = settings or {}
    document = setup.config.model_dump(mode="json", exclude_unset=True)
    document["devices"] = {
        name: {
            **section,
            "transport": transports[name],
            "settings": section.get("settings", {}) | more.get(name, {}),
        }
        for name, section in document["devices"].items()
        if name in transports
    }
    for name, values in (services or {}).items():
        document["services"][name] = document["services"][name] | values
    checked = check_document(document, setup.path, Places(setup.path.name, ""), tables)
    return replace(checked, virtual=True)


def _device(
    name: str, section: dict[str, Any], places: Places, tables: Tables, problems: list[Problem]
) -> DeviceSetup | None:
    at = ("devices", name)
    driver = section.get("driver")
    if not isinstance(driver, str):
        return None
    cls = _load_class(driver, (*at, "driver"), tables.drivers, places, problems)
    if cls is None:
        return None
    transport = _load_class(cls.wire, (*at, "driver"), tables.transports, places, problems)
    settings, found = check(cls.Settings, section.get("settings", {}), (*at, "settings"), places)
    problems += found
    if transport is None:
        return None
    wire, found = check(transport.Settings, section.get("transport", {}), (*at, "transport"), places)
    problems += found
    if settings is None or wire is None:
        return None
    return DeviceSetup(name, cls, settings, transport, wire, optional=section.get("optional") is True)


def _service(
    name: str, section: dict[str, Any], places: Places, tables: Tables, problems: list[Problem]
) -> ServiceSetup | None:
    cls = _load_class(name, ("services", name), tables.services, places, problems)
    if cls is None:
        return None
    settings, found = check(cls.Settings, section, ("services", name), places)
    problems += found
    return None if settings is None else ServiceSetup(name, cls, settings)


def _load_class(
    name: str, at: tuple[str, ...], table: Mapping[str, str], places: Places, problems: list[Problem]
) -> type[Any] | None:
    if name not in table:
        kind = "driver" if at[-1] == "driver" else "service"
        problems.append(Problem(f"no {kind} is called {name!r}", places.where(at), unknown(name, table)))
        return None
    module, _, cls = table[name].partition(":")
    try:
        found: type[Any] = getattr(importlib.import_module(module), cls)
    except (ImportError, AttributeError) as error:
        problems.append(
            Problem(f"{name!r} cannot be loaded ({error})", places.where(at), "is it installed completely?")
        )
        return None
    return found


def _bare_tty(transport: Any, at: tuple[str, ...], places: Places) -> list[Problem]:
    """A bare ttyUSBn names another device after the next plug-in; only the names by identity stay."""
    what = "this name changes when cables are plugged"
    items = transport.items() if isinstance(transport, dict) else ()
    return [
        Problem(f"{what} (it is {json.dumps(value)})", places.where((*at, key)), _lasting(value))
        for key, value in items
        if isinstance(value, str) and _BARE_TTY.match(value)
    ]


def _lasting(value: str) -> str:
    name = lasting_name(value)
    return f"write {json.dumps(name)}" if name else "use the name that galen-hw find shows for it"


def _shared_ports(document: dict[str, Any], places: Places) -> list[Problem]:
    """Two devices on one serial port."""
    seen: dict[str, str] = {}
    problems = []
    for name, section in _tables(document, "devices"):
        transport = section.get("transport")
        url = transport.get("url") if isinstance(transport, dict) else None
        if isinstance(url, str) and url in seen:
            where = places.where(("devices", name, "transport", "url"))
            problems.append(
                Problem(f"devices.{seen[url]} has the same port {json.dumps(url)}", where, "give each its own")
            )
        elif isinstance(url, str):
            seen[url] = name
    return problems


def _tables(document: dict[str, Any], key: str) -> list[tuple[str, dict[str, Any]]]:
    found = document.get(key)
    return [(n, s) for n, s in found.items() if isinstance(s, dict)] if isinstance(found, dict) else []


def _line_of(problem: Problem) -> tuple[int, str]:
    number = problem.where.split(":")[1] if ":" in problem.where else "0"
    return (int(number) if number.isdigit() else 0, problem.where)
