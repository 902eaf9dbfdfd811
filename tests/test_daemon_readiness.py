"""When the daemon is ready: given times and states, no processes and no clock."""

import pytest

from galen_hw.daemon.links import DeviceState
from galen_hw.daemon.readiness import INTERPRETERS_WITHIN_S, Readiness, waits_for

READY = DeviceState("open", ready=True, optional=False, attempts=1)
SILENT = DeviceState("open", ready=False, optional=False, attempts=1)
FAILED = DeviceState("failed", ready=False, optional=False, attempts=1, problem=("gone", "/dev/x", "plug it in"))
REFUSING = DeviceState("open", ready=False, optional=True, attempts=1, problem=("no such body", "", "set rom_file"))


def readiness() -> Readiness:
    return Readiness({"ft": False, "motors": False, "tracker": True}, 20.0, 5.0, 100.0)


def states(**more: DeviceState) -> dict[str, DeviceState]:
    return {"ft": READY, "motors": READY} | more


def test_ready_when_all_run_and_answer_and_samples_flow() -> None:
    """Not while a process is missing, not before the first sample; then at once."""
    own, all_ready = readiness(), states(tracker=READY)
    assert not own.judge(101.0, all_ready, all_up=False, flows=True).ready
    assert not own.judge(102.0, all_ready, all_up=True, flows=False).ready
    assert own.judge(103.0, all_ready, all_up=True, flows=True).ready


@pytest.mark.parametrize("tracker", [SILENT, None])
def test_an_optional_device_is_waited_for_and_not_for_ever(tracker: DeviceState | None) -> None:
    """The wait begins when all else is in order, and begins anew when it was not any more."""
    own, known = readiness(), states(**({"tracker": tracker} if tracker else {}))
    assert not own.judge(110.0, known, all_up=True, flows=True).ready
    assert not own.judge(114.9, known, all_up=True, flows=True).ready
    assert not own.judge(114.95, known | {"ft": SILENT}, all_up=True, flows=True).ready
    assert not own.judge(115.5, known, all_up=True, flows=True).ready
    assert own.judge(120.6, known, all_up=True, flows=True).ready


@pytest.mark.parametrize("tracker", [READY, FAILED, REFUSING])
def test_an_optional_device_that_has_spoken_is_not_waited_for(tracker: DeviceState) -> None:
    """Ready, unplugged, or refusing with a reason: there is nothing to wait for."""
    assert readiness().judge(101.0, states(tracker=tracker), all_up=True, flows=True).ready


def test_a_required_wire_that_fails_is_refused_at_once_and_named() -> None:
    """Once every required wire has been tried, so that all are named together."""
    own = readiness()
    opening = DeviceState("opening", ready=False, optional=False, attempts=1)
    assert not own.judge(100.1, {"ft": FAILED, "motors": opening}, all_up=True, flows=False).refused
    verdict = own.judge(100.2, {"ft": FAILED, "motors": SILENT, "tracker": FAILED}, all_up=True, flows=False)
    assert verdict.refused
    assert list(verdict.devices) == ["ft"]


def test_devices_have_their_time_from_when_all_processes_run() -> None:
    """A slow start of the interpreters is not theirs; a process that never comes ends the wait as well."""
    own = readiness()
    assert not own.judge(125.0, {}, all_up=False, flows=False).refused
    assert not own.judge(126.0, states(ft=SILENT), all_up=True, flows=False).refused
    assert not own.judge(145.9, states(ft=SILENT), all_up=True, flows=False).refused
    verdict = own.judge(146.1, states(ft=SILENT), all_up=True, flows=False)
    assert (verdict.refused, list(verdict.devices)) == (True, ["ft"])
    late = 100.0 + INTERPRETERS_WITHIN_S + 20.1
    assert readiness().judge(late, states(), all_up=False, flows=True).refused


def test_what_a_start_waits_for_is_said():
    """Processes first, then devices that have not answered, then samples; nothing once all is there."""
    ready, silent = (DeviceState(wire="open", ready=r, optional=False) for r in (True, False))
    tracker = DeviceState(wire="opening", ready=False, optional=True)
    assert waits_for({"ft": silent}, ["core", "motion"], flows=False) == "processes core, motion to start"
    assert waits_for({"ft": silent, "m": ready, "t": tracker}, [], flows=False) == "an answer of ft, t (optional)"
    assert waits_for({"ft": ready, "m": ready}, [], flows=False) == "samples to flow"
    assert waits_for({"ft": ready}, [], flows=True) == ""
