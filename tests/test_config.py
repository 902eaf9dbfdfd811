"""The settings file: what is right becomes a set-up, everything that is wrong is named at once."""

import math
import socket
import tomllib
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.config.load import Setup, Tables, check_document, load, with_transports
from galen_hw.config.paths import (
    DEFAULT_CONFIG,
    Addresses,
    client_runtime_dir,
    config_path,
    make_runtime,
    runtime_dir,
    state_dir,
)
from galen_hw.config.problems import ConfigError, Places
from galen_hw.config.robot import build_robot, identity
from galen_hw.config.schema import Config, RobotSection
from galen_hw.daemon.tables import TABLES, read_setup
from galen_hw.errors import HardwareError, UsageError
from galen_hw.kinematics import GalenRobot, UrdfRobot


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Sensor:
    wire: ClassVar[str] = "serial"

    class Settings(Strict):
        rate_hz: float = Field(default=1000.0, gt=0.0, le=3000.0)


class Wire:
    class Settings(Strict):
        url: str = Field(examples=["/dev/serial/by-id/x"])
        baud_rate: int = 115200


class Service:
    class Settings(Strict):
        window: int = Field(default=5, ge=1)


OWN = Tables(
    drivers={"sensor": "test_config_parts:Sensor"},
    transports={"serial": "test_config_parts:Wire"},
    services={"compensation": "test_config_parts:Service"},
)
GOOD = """
[devices.ft]
driver = "sensor"
transport = { url = "/dev/serial/by-id/a" }
[services.compensation]
window = 7
"""


@pytest.fixture(autouse=True)
def _parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The classes that `OWN` names, under a module name that can be imported."""
    import sys
    import types

    module = types.ModuleType("test_config_parts")
    module.Sensor, module.Wire, module.Service = Sensor, Wire, Service  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "test_config_parts", module)


def read(text: str) -> Setup:
    return check_document(tomllib.loads(text), Path("galen.toml"), Places("galen.toml", text), OWN)


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text)
    return str(caught.value).splitlines()


def test_good_file_becomes_a_setup() -> None:
    """Sections, driver settings and service settings arrive checked."""
    setup = read(GOOD)

    assert setup.devices["ft"].transport_settings == Wire.Settings(url="/dev/serial/by-id/a")
    assert setup.devices["ft"].settings == Sensor.Settings()
    assert setup.services["compensation"].settings == Service.Settings(window=7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (GOOD + "[robot]\nnme = 'x'", "8: robot.nme: no such key; did you mean name?"),
        (GOOD + "[robots]", "7: robots: no such key; did you mean robot?"),
        (
            GOOD + "[robot.delta]\nrod_length_mm = 400",
            "8: robot.delta.rod_length_mm: no such key; did you mean rod_length_m?",
        ),
        (
            GOOD + "[robot.delta]\nrod_length_m = 400",
            "8: robot.delta.rod_length_m: should be less than or equal to 2 (it is 400); e.g. rod_length_m = 0.4",
        ),
        (
            GOOD + "[robot.delta]\nradius_m = 0.5",
            "7: robot.delta: radius_m must be less than rod_length_m, or the rods cannot reach the platform",
        ),
        (
            GOOD + "[robot]\ngravity_m_per_s2 = [0, 0, -981]",
            (
                "8: robot.gravity_m_per_s2: gravity of 981 m/s^2 is not the earth's (9.76 to 9.84) "
                "(it is [0, 0, -981]); e.g. gravity_m_per_s2 = [0.0, 0.0, -9.80665]"
            ),
        ),
        (
            GOOD + "[robot]\nroll_limits_rad = [-1.57, 90]",
            (
                "8: robot.roll_limits_rad.1: 90 rad is more than a turn: is it in degrees? (it is 90); "
                "e.g. roll_limits_rad = [-1.57, 1.57]"
            ),
        ),
        (
            GOOD + "[robot]\ntilt_limits_rad = [-60.0, 0.96]",
            (
                "8: robot.tilt_limits_rad.0: -60 rad is more than a turn: is it in degrees? (it is -60.0); "
                "e.g. tilt_limits_rad = [-1.04, 0.96]"
            ),
        ),
        (
            GOOD + "[robot.delta]\nazimuths_rad = [0, 2.1, 240]",
            (
                "8: robot.delta.azimuths_rad.2: 240 rad is more than a turn: is it in degrees? (it is 240); "
                "e.g. azimuths_rad = [1.5707963267948966, 3.6651914291880923, 5.759586531581287]"
            ),
        ),
        (
            GOOD + "[robot]\nroll_limits_rad = [1, -1]",
            "7: robot: each lower limit must be below its upper limit",
        ),
        (
            GOOD + "[robot]\nsensor_link = 'x'",
            "7: robot: sensor_link and base_link belong to a URDF: give urdf too",
        ),
        (
            GOOD.replace("sensor", "sensr"),
            "3: devices.ft.driver: no driver is called 'sensr'; did you mean sensor?",
        ),
        (
            GOOD.replace('driver = "sensor"', ""),
            '2: devices.ft.driver: this key is missing; e.g. driver = "ati_netcanoem"',
        ),
        (
            GOOD.replace("url", "ulr"),
            "4: devices.ft.transport.ulr: no such key; did you mean url?",
        ),
        (
            GOOD.replace("{ url", '{ baud_rate = "fast", url'),
            (
                "4: devices.ft.transport.baud_rate: should be a valid integer, unable to parse string as an integer "
                '(it is "fast"); e.g. baud_rate = 115200'
            ),
        ),
        (
            GOOD.replace('{ url = "/dev/serial/by-id/a" }', "{}"),
            '4: devices.ft.transport.url: this key is missing; e.g. url = "/dev/serial/by-id/x"',
        ),
        (
            GOOD.replace("serial/by-id/a", "ttyUSB0"),
            (
                '4: devices.ft.transport.url: this name changes when cables are plugged (it is "/dev/ttyUSB0"); '
                "use the name that galen-hw find shows for it"
            ),
        ),
        (
            GOOD + "[devices.b]\ndriver = 'sensor'\ntransport.url = '/dev/serial/by-id/a'",
            '9: devices.b.transport.url: devices.ft has the same port "/dev/serial/by-id/a"; give each its own',
        ),
        (
            GOOD + "[devices.b]\ndriver = 'sensor'\ntransport.url = 'x'\nsettings.rate_hz = 1e4",
            (
                "10: devices.b.settings.rate_hz: should be less than or equal to 3000 (it is 10000.0); "
                "e.g. rate_hz = 1000.0"
            ),
        ),
        (
            GOOD.replace("window = 7", "window = 0"),
            "6: services.compensation.window: should be greater than or",
        ),
        (
            GOOD.replace("[services.compensation]", "[services.compensatoin]"),
            "5: services.compensatoin: no service is called 'compensatoin'; did you mean compensation?",
        ),
        (
            GOOD + '[bus]\nviewers = "tcp://0.0.0.0:9872"',
            "8: bus.viewers: viewers may connect from this machine only",
        ),
        (
            GOOD + '[bus]\nviewers = "tcp://127.0.0.1:98720"',
            "8: bus.viewers: '98720' is no port: 1 to 65535, or 0 for any free one",
        ),
        (
            GOOD.replace("[devices.ft]", "[devicse.ft]"),
            "2: devicse: no such key; did you mean devices?",
        ),
        (GOOD + "[robt.delta]\nradius_m = 0.1", "7: robt: no such key; did you mean robot?"),
        (GOOD + "[[devicse.ft.more]]", "7: devicse: no such key; did you mean devices?"),
        (
            "[robot.delta]\nradius_m = 0.1\n" + GOOD.lstrip() + '[robot]\nnme = "x"\nsensor_link = "y"',
            "9: robot.nme: no such key; did you mean name?",
        ),
        ("", "1: devices: this key is missing; e.g. at the top of the file: devices.ft = {"),
    ],
)
def test_each_problem_is_one_line_with_place_and_remedy(text: str, expected: str) -> None:
    """File and line, key, the value where there is one, what would be right."""
    found = problems(text)

    assert any(line.startswith(f"galen.toml:{expected}") for line in found), found


def test_the_example_for_an_empty_file_is_a_configuration() -> None:
    """What the message offers can be pasted: it is TOML, and with the real drivers nothing is wrong with it."""
    (line,) = problems("")
    text = line.partition("the file: ")[2]

    setup = check_document(tomllib.loads(text), Path("galen.toml"), Places("galen.toml", text), TABLES)
    assert list(setup.devices) == ["ft"]


def test_all_problems_at_once_in_the_order_of_the_file() -> None:
    """One run names every mistake: of the schema, of a driver, of a wire, of a service."""
    text = """[robot]
name = "Galen Robot"
[devices.ft]
driver = "sensor"
transport = { url = "/dev/ttyACM3" }
settings = { rate_hz = -1 }
[services.compensation]
windw = 3
[daemon]
realtime_priority = 99
"""
    found = problems(text)

    assert [line.split(": ")[0] for line in found] == [f"galen.toml:{n}" for n in (2, 5, 6, 8, 10)]


def test_broken_driver_module_is_a_line_not_a_traceback() -> None:
    """A table row whose module cannot be imported is named with the device that wants it."""
    tables = Tables(drivers={"sensor": "no_such_module_here:X"}, transports={}, services={})
    text = '[devices.ft]\ndriver = "sensor"'
    with pytest.raises(
        ConfigError, match=r"galen.toml:2: devices.ft.driver: 'sensor' cannot be loaded .*no_such_module"
    ):
        check_document(tomllib.loads(text), Path("galen.toml"), Places("galen.toml", text), tables)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"a = ", r"galen.toml:1: not TOML .*"),
        (b"[a]\nb = 1\n[a]\n", r"galen.toml:3: not TOML .*"),
        (b"\xff\xfe", "not a text file in UTF-8"),
    ],
)
def test_unreadable_file_is_one_line(tmp_path: Path, content: bytes, expected: str) -> None:
    """Not TOML, not text: where, and what to look at."""
    path = tmp_path / "galen.toml"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=expected):
        load(path, OWN)


@pytest.mark.parametrize("name", ["nothing.toml", "."])
def test_missing_file_and_folder_are_one_line(tmp_path: Path, name: str) -> None:
    """No such file, or a folder."""
    with pytest.raises(UsageError):
        load(tmp_path / name, OWN)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text() | st.integers(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    )
)
def test_any_document_is_a_setup_or_problems(value: Any) -> None:
    """Whatever stands where a section is expected, the answer is a list of problems, never a traceback."""
    for document in (
        {"devices": value},
        {"services": value, "robot": value},
        {"devices": {"ft": {"driver": "x", "transport": value, "settings": value}}},
    ):
        with pytest.raises(ConfigError) as caught:
            check_document(document, Path("x"), Places("x", ""), OWN)
        assert all(problem.what and problem.where for problem in caught.value.problems)


def test_default_file_is_good_and_complete() -> None:
    """The file that is shipped loads with the real tables, and names every key of the schema, if only as a comment."""
    setup = read_setup(str(DEFAULT_CONFIG))
    text = DEFAULT_CONFIG.read_text(encoding="utf-8")

    assert {"ft", "motors", "tracker"} == setup.devices.keys()
    for section in (Config.model_fields, RobotSection.model_fields):
        assert [key for key in section if key not in text] == []


def test_default_file_comments_show_the_defaults() -> None:
    """With every comment of a setting taken away, the set-up is the same: the comments do not lie."""
    text = DEFAULT_CONFIG.read_text(encoding="utf-8")
    examples = ("# urdf", "# sensor_link", "# base_link", "# settings", "# keys")
    lines = [line for line in text.splitlines() if not line.startswith(examples)]
    shown = "\n".join(line[2:] if line.startswith("# ") and " = " in line else line for line in lines)
    shown = shown.replace("# [robot.delta]", "[robot.delta]")
    places = Places("galen.toml", shown)
    setup = check_document(tomllib.loads(shown), Path("galen.toml"), places, TABLES)

    assert setup.config.model_dump() == read_setup(str(DEFAULT_CONFIG)).config.model_dump()


def test_default_robot_is_the_nominal_galen() -> None:
    """The defaults of the schema are those of the kinematics, number by number."""
    robot, nominal = build_robot(read(GOOD).config), GalenRobot()
    assert isinstance(robot, GalenRobot)

    q = np.array([[0.01, -0.02, 0.03, 0.4, -0.5]])
    np.testing.assert_allclose(robot.sensor_pose(q), nominal.sensor_pose(q), atol=1e-15)
    np.testing.assert_array_equal(robot.lower, nominal.lower)
    np.testing.assert_array_equal(robot.upper, nominal.upper)
    np.testing.assert_array_equal(robot.gravity, nominal.gravity)


def test_geometry_and_urdf_from_the_file(tmp_path: Path) -> None:
    """Another geometry moves the sensor; a URDF replaces the Galen."""
    moved = read(GOOD + "[robot]\ntilt_to_sensor_m = [0.065, 0, 0]").config
    urdf = Path(__file__).parents[1] / "config" / "galen.urdf"
    other = build_robot(read(f'{GOOD}[robot]\nurdf = "{urdf}"').config)
    home = np.zeros((1, 5))

    difference = build_robot(moved).sensor_pose(home) - GalenRobot().sensor_pose(home)
    np.testing.assert_allclose(difference[0, :3, 3], [0.01, 0.0, 0.0], atol=1e-12)
    assert isinstance(other, UrdfRobot)


def test_identity_follows_the_hardware_only() -> None:
    """Another geometry or driver is another identity; another port or service is not."""
    same = identity(read(GOOD.replace("by-id/a", "by-id/b").replace("window = 7", "")).config)
    other = identity(read(GOOD + "[robot]\ntilt_to_sensor_m = [0.06, 0, 0]").config)

    assert identity(read(GOOD).config) == same
    assert identity(read(GOOD).config) != other


def test_other_wires_leave_the_rest_as_it_is() -> None:
    """The virtual robot's wires replace the configured ones; devices without one are left out."""
    setup = read(GOOD + "[devices.b]\ndriver = 'sensor'\ntransport.url = 'x'")
    virtual = with_transports(setup, {"ft": {"url": "/dev/pts/7"}}, OWN)

    assert list(virtual.devices) == ["ft"]
    assert virtual.devices["ft"].transport_settings == Wire.Settings(url="/dev/pts/7")
    assert virtual.services == setup.services
    assert virtual.virtual


@pytest.mark.parametrize(
    ("environ", "runtime", "state"),
    [
        (
            {"GALEN_HW_RUNTIME": "/a", "RUNTIME_DIRECTORY": "/b", "GALEN_HW_STATE": "/c", "STATE_DIRECTORY": "/d"},
            "/a",
            "/c",
        ),
        ({"RUNTIME_DIRECTORY": "/b:/e", "XDG_RUNTIME_DIR": "/x", "STATE_DIRECTORY": "/d:/f"}, "/b", "/d"),
        ({"XDG_RUNTIME_DIR": "/x", "XDG_STATE_HOME": "/y"}, "/x/galen-hw", "/y/galen-hw"),
    ],
)
def test_directories_follow_the_environment(environ: dict[str, str], runtime: str, state: str) -> None:
    """Our own variables, then systemd's, then the desktop's."""
    assert runtime_dir(environ) == Path(runtime)
    assert state_dir(environ) == Path(state)


def test_runtime_directory_without_any_variable_is_the_users_own() -> None:
    """A directory below the temporary one that names the user."""
    assert runtime_dir({}).name.startswith("galen-hw-")
    assert client_runtime_dir({"GALEN_HW_RUNTIME": "/a"}) == Path("/a")
    assert config_path("x.toml", {}) == Path("x.toml")
    assert config_path(None, {"GALEN_HW_CONFIG": "/z"}) == Path("/z")


def test_runtime_directory_is_private_and_short_enough(tmp_path: Path) -> None:
    """Not writable by others, not too deep for a socket; each refusal is one line."""
    assert (make_runtime(tmp_path / "a").runtime.stat().st_mode & 0o777) == 0o700
    open_to_all = tmp_path / "b"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    with pytest.raises(UsageError, match="writable by others"):
        make_runtime(open_to_all)
    with pytest.raises(UsageError, match="too long for a socket"):
        make_runtime(tmp_path / ("x" * 120))
    (tmp_path / "file").touch()
    with pytest.raises(UsageError):
        make_runtime(tmp_path / "file")
    with pytest.raises(HardwareError, match=r"no daemon runs here.*galen-hw run"):
        Addresses(tmp_path).require_daemon()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(tmp_path / "command"))
        killed.listen()
        Addresses(tmp_path).require_daemon()
    with pytest.raises(HardwareError, match="no daemon runs here"):
        Addresses(tmp_path).require_daemon()


def test_numbers_that_are_none_are_refused() -> None:
    """TOML can write nan and inf; a geometry cannot."""
    found = problems(GOOD + "[robot]\ntilt_to_sensor_m = [nan, 0, 0]")

    assert math.isnan(tomllib.loads("x = nan")["x"])
    assert "robot.tilt_to_sensor_m" in found[0]


@pytest.mark.parametrize(
    ("before", "lines"),
    [
        ('viewers = """tcp\n[fake]\nvewers = 3"""\n', 3),
        ("viewers = '''\nvewers = 1\n'''\n", 3),
        ("other = [\n  [1, 2],\n  [3, 4]\n]\n", 4),
        ('other = [ # [services]\n  { a = 1 },\n  { vewers = "x" } ]\n', 3),
        ("# [services]\nother = '[x'\n", 2),
    ],
)
def test_a_key_is_named_on_its_own_line_whatever_stands_before_it(before: str, lines: int) -> None:
    """Strings over several lines, arrays of arrays and comments hold neither tables nor keys of the table they are in."""
    places = Places("galen.toml", f"[bus]\n{before}vewers = 1\n[services.x]\nraet = 2\n")
    assert places.where(("bus", "vewers")) == f"galen.toml:{lines + 2}: bus.vewers"
    assert places.where(("services", "x", "raet")) == f"galen.toml:{lines + 4}: services.x.raet"
