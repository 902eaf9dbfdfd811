"""The time-out on the controller: the real driver and the virtual controller, in simulated time."""

import pytest

from galen_hw.drivers.galil_dmc import GalilDmc
from galen_hw.drivers.galil_dmc.watch import program
from galen_hw.drivers.virtual.galil_dmc import VirtualGalilDmc
from galen_hw.drivers.virtual.galil_dmc.format import Rejected
from galen_hw.drivers.virtual.world import World
from galen_hw.errors import CommandRejectedError
from tests.galil_host import Host
from tests.serial_pair import TIME_BASE, Pair

BOUND_S = 0.37
"""Time-out, the program's own look every 4 ms, and a stop within `stop_s`."""


def connected(device: VirtualGalilDmc, **settings: float) -> Pair:
    pair = Pair(GalilDmc("motors", GalilDmc.Settings(**settings), TIME_BASE), device)
    assert pair.run(5.0, lambda: pair.driver.ready), pair.said
    return pair


def moving(**settings: float) -> Pair:
    """A robot on its way."""
    pair = connected(VirtualGalilDmc(VirtualGalilDmc.Settings(), World()), **settings)
    assert pair.call("enable").error is None
    assert pair.call("move_jp", {"position": {"roll": 1.5, "carriage1": 0.2}, "velocity": {"roll": 1.0}}).error is None
    pair.run(0.6)
    return pair


def speed(pair: Pair) -> float:
    return max(abs(pair.device.world.joints(pair.now_ns)[1]))


def alone(pair: Pair, seconds: float) -> float:
    """Let the controller run without its host; seconds until it rests, or `seconds`."""
    begun = pair.now_ns
    while speed(pair) > 0.0 and pair.now_ns - begun < seconds * 1e9:
        pair.now_ns += 1_000_000
        pair.device.poll(pair.now_ns)
    return (pair.now_ns - begun) * 1e-9


def test_axes_rest_when_the_host_falls_silent():
    """Nothing more is heard in the middle of a move: at rest within the bound; without the program it goes on."""
    pair = moving()
    assert speed(pair) == pytest.approx(1.0, abs=1e-3)
    assert 0.2 < alone(pair, 3.0) < BOUND_S

    unwatched = moving(watchdog_s=0)
    assert alone(unwatched, 0.9) == pytest.approx(0.9, abs=2e-3)


def test_the_stop_stays_for_the_next_host_until_it_is_cleared():
    """A driver that finds what the controller did refuses motion until clear_fault, and arms the time-out again."""
    pair = moving()
    alone(pair, 3.0)
    after = connected(pair.device)
    with pytest.raises(CommandRejectedError, match=r"heard nothing for 0\.25 s and stopped the axes"):
        after.call("move_jp", {"position": {"roll": 0.0}})
    assert "clear_fault" in after.driver.held
    assert after.call("clear_fault").error is None
    assert after.driver.held == ""
    assert after.call("move_jp", {"position": {"roll": 0.0}, "velocity": {"roll": 0.5}}).error is None
    after.run(0.4)
    assert alone(after, 3.0) < BOUND_S


def test_a_host_that_was_late_finds_out_and_begins_nothing():
    """The same driver goes on after the time-out has run out: the stop is latched before a request moves anything."""
    pair = moving()
    alone(pair, 3.0)
    assert pair.run(1.0, lambda: pair.driver.held)
    with pytest.raises(CommandRejectedError, match="clear_fault"):
        pair.call("servo_jv", {"velocity": {"roll": 0.1}})
    assert pair.driver.counters["controller_stops"] == 1
    assert [fault.what for fault in pair.of("fault")] == [
        "the controller heard nothing for 0.25 s and stopped the axes"
    ]


def test_a_host_that_was_late_at_rest_has_nothing_to_clear():
    """Nothing moved when the time-out ran out: it is set up again, and the next move is carried out."""
    pair = connected(VirtualGalilDmc(VirtualGalilDmc.Settings(), World()))
    assert pair.call("enable").error is None
    pair.now_ns += 10**9
    pair.device.poll(pair.now_ns)
    pair.run(0.5)
    assert pair.driver.held == ""
    assert pair.call("move_jp", {"position": {"roll": 1.0}}).error is None
    pair.run(0.3)
    assert alone(pair, 3.0) < BOUND_S


def test_a_clean_end_leaves_nothing_behind():
    """`stop` ends the program too: the next start has nothing to clear."""
    pair = moving()
    for wire in pair.driver.stop(pair.now_ns):
        pair.device.feed(wire, pair.now_ns)
    assert alone(pair, 3.0) < 0.15
    pair.now_ns += 10**9
    pair.device.poll(pair.now_ns)
    assert connected(pair.device).driver.held == ""


def test_programs_of_the_user_are_kept():
    """One that lies in memory stays, ours behind it, loaded once; beside one that runs nothing is loaded: a fault."""
    device = VirtualGalilDmc(VirtualGalilDmc.Settings(echo=False, baud_rate=0), World())
    host = Host()
    host.device = device
    for line in ("DL", "#MINE", "WT 5", "JP #MINE", "\\"):
        host.ask(line)
    host.now_ns = 2 * 10**9
    for _ in range(2):
        connected(device)
        assert device.controller.program.lines == ["#MINE", "WT 5", "JP #MINE", *program("ABCDE")]

    other = VirtualGalilDmc(VirtualGalilDmc.Settings(echo=False, baud_rate=0), World())
    host = Host()
    host.device = other
    for line in ("DL", "#MINE", "WT 5", "JP #MINE", "\\", "XQ #MINE,2"):
        host.ask(line)
    pair = connected(other)
    assert other.controller.program.lines == ["#MINE", "WT 5", "JP #MINE"]
    (fault,) = pair.of("fault")
    assert "a program of its own runs in thread 2" in fault.what
    assert pair.call("enable").error is None
    assert pair.call("move_jp", {"position": {"roll": 0.1}}).error is None


@pytest.mark.parametrize("command", ["MG _TM", "HX 7", "XQ #GHA1F,7"])
def test_a_controller_that_knows_no_such_program_is_used_without(command, monkeypatch):
    """Whatever it refuses, the robot runs and the fault says that nothing stops it by itself."""
    device = VirtualGalilDmc(VirtualGalilDmc.Settings(), World())
    execute = device._interpreter._execute
    refuses = lambda text: _refuse() if text == command else execute(text)  # noqa: E731
    monkeypatch.setattr(device._interpreter, "_execute", refuses)
    pair = connected(device)
    (fault,) = pair.of("fault")
    assert "the controller stops nothing by itself" in fault.what
    assert pair.call("enable").error is None
    assert pair.call("move_jp", {"position": {"roll": 0.1}}).error is None


def _refuse():
    raise Rejected(1)


@pytest.mark.parametrize(
    ("text", "value"),
    [("1+2*3", 9.0), ("1+(2*3)", 7.0), ("(TIME-x)<250", 1.0), ("-x+2", -3.0), ("(x=5)&(x<>4)", 1.0), ("x>=6|0", 0.0)],
)
def test_expressions_go_from_left_to_right(text, value):
    """As the manual has it: no precedence but that of parentheses."""
    host = Host()
    host.ask("x=5")
    host.ask(f"y={text}")
    assert host.numbers("MG y") == [value]


@pytest.mark.parametrize("text", ["1+", "(1", "1)", "1 2", "((((((1))))))", "1/0"])
def test_what_is_no_expression_is_refused(text):
    """A question mark, and nothing is set."""
    host = Host()
    assert host.ask(f"y={text}") == "?"
    assert host.ask("y=") == "?"
