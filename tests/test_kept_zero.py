"""A zero that outlives the process which made it: taken up for the same sensor seen shortly before, else why not."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from ati_board import Board, ask, force, run_of, wrenches
from conformance.peer import Run

from galen_hw.clock import NS_PER_S, TimeBase
from galen_hw.daemon.keep import DeviceKeeper
from galen_hw.drivers.ati_netcanoem import AtiNetcanoem
from galen_hw.drivers.robotous_rft import RobotousRft

GAUGES = (100, -200, 3000, 4, 5, -6)


def zeroed_board() -> tuple[Board, dict[str, object]]:
    """A board whose driver has zeroed it, and what that driver would have written down."""
    board = Board(gauges=GAUGES)
    run = run_of(board).seconds(0.2)
    ask(run, "zero", samples=20)
    run.seconds(0.2)
    return board, run.device.snapshot(run.now_ns)


def device() -> AtiNetcanoem:
    return AtiNetcanoem("ft", AtiNetcanoem.Settings(), TimeBase())


def restarted(board: Board, state: dict[str, object], away_s: float = 1.0, obstacle: str = ""):
    """A new driver that is handed the record so long after it was written."""
    run = Run(device(), board, now_ns=state["seen_ns"] + round(away_s * NS_PER_S))
    run.device.restore(state, obstacle)
    return run.start().seconds(0.3)


def said(run) -> list[str]:
    return [fault.what for fault in run.messages("fault")]


def test_same_sensor_goes_on_with_its_zero():
    """Every sample has it, from the first on; the status says where it is from; the next zero counts on from it."""
    board, state = zeroed_board()
    run = restarted(board, state | {"tool": "drill"})
    samples = wrenches(run)
    np.testing.assert_allclose([force(sample) for sample in samples], 0.0, atol=1e-9)
    assert {sample.zeroings for sample in samples} == {1}
    assert said(run) == []
    run.seconds(1.0)
    detail = run.messages("status")[-1].detail
    assert "zeroed (restored after a restart, 1 s old, kept with drill in hand)" in detail
    assert run.device.snapshot(run.now_ns)["zeroed_ns"] == state["zeroed_ns"]
    ask(run, "zero", samples=5)
    run.seconds(1.2)
    assert wrenches(run)[-1].zeroings == 2
    assert "restored" not in run.messages("status")[-1].detail


@pytest.mark.parametrize(
    ("changed", "away_s", "obstacle", "why"),
    [
        ({"serial_number": "FT00009"}, 1.0, "", "it is that of sensor FT00009, this is FT01234"),
        ({}, 61.0, "", "out of sight for 61 s and may have been off"),
        ({"zeroed_ns": 1 << 62}, 1.0, "", "damaged"),
        ({}, 1.0, "the computer was started again since", "the computer was started again since"),
        ({"values": [1.0]}, 1.0, "", "damaged"),
        ({"values": "x"}, 1.0, "", "damaged"),
        ({"zeroings": 0}, 1.0, "", "damaged"),
    ],
)
def test_zero_that_is_not_taken_up_says_why(changed, away_s, obstacle, why):
    """The sensor is then not zeroed, one fault says why and what to do, and nothing of the record is kept."""
    board, state = zeroed_board()
    run = restarted(board, state | changed, away_s, obstacle)
    assert {sample.zeroings for sample in wrenches(run)} == {0}
    (what,) = said(run)
    assert why in what
    assert "zero the sensor" in run.messages("fault")[0].todo
    assert run.device.snapshot(run.now_ns) == {}


def test_record_that_waits_for_its_sensor_is_not_lost():
    """A process that dies before the sensor has answered hands the record on as it was."""
    board, state = zeroed_board()
    board.deaf = True
    run = restarted(board, state)
    assert run.device.snapshot(run.now_ns) == state
    board.deaf = False
    run.seconds(3.0)
    assert wrenches(run)[-1].zeroings == 1


def offered(keeper: DeviceKeeper) -> tuple[dict[str, object], str]:
    """What a keeper hands to a device of the name ft."""
    given: list[tuple[dict[str, object], str]] = []

    class Taker(AtiNetcanoem):
        def restore(self, state: dict[str, object], obstacle: str) -> None:
            given.append((state, obstacle))

    keeper.give_back("ft", Taker("ft", Taker.Settings(), TimeBase()))
    return given[0] if given else ({}, "")


def test_record_is_of_one_boot_and_one_kind_of_hardware(tmp_path: Path):
    """After another start of the computer the device is told so; virtual and real sensors have each their own."""
    boot, other = tmp_path / "boot", tmp_path / "other"
    boot.write_text("b-1\n")
    other.write_text("b-2\n")
    run = run_of(Board()).seconds(0.2)
    ask(run, "zero", samples=20)
    run.seconds(0.2)
    keeper = DeviceKeeper(tmp_path / "devices", virtual=False, boot_id=boot)
    keeper.keep_device("ft", device(), "drill", 1)
    keeper.keep_device("ft", run.device, "drill", run.now_ns)
    keeper.close()

    assert [p.name for p in (tmp_path / "devices").iterdir()] == ["ft.json"]
    state, obstacle = offered(DeviceKeeper(tmp_path / "devices", virtual=False, boot_id=boot))
    assert (state["tool"], state["serial_number"], obstacle) == ("drill", "FT01234", "")
    assert "started again" in offered(DeviceKeeper(tmp_path / "devices", virtual=False, boot_id=other))[1]
    assert "started again" in offered(DeviceKeeper(tmp_path / "devices", virtual=False, boot_id=tmp_path / "none"))[1]
    assert offered(DeviceKeeper(tmp_path / "devices", virtual=True, boot_id=boot)) == ({}, "")


def test_robotous_zero_is_never_taken_up():
    """Its bias is in the sensor, which cannot be asked for it: the record only says that there was one."""
    given = RobotousRft("ft", RobotousRft.Settings(), TimeBase())
    given.restore({"serial_number": "1", "zeroings": 1, "zeroed_ns": 1, "seen_ns": 1}, "")
    assert given._kept_zero.decide("1", 0, 1) == (None, "the sensor holds it and cannot be asked whether it still does")
