"""The monitor shows what is, not what was: a daemon that has ended, a topic that is silent, a message that is late."""

import io
import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from galen_hw.messages import (
    Alarm,
    Health,
    JointsState,
    Message,
    Pose,
    Quaternion,
    Status,
    Vector3,
    WrenchCompensated,
    WrenchRaw,
)
from galen_hw.tools.monitor.screen import GONE, screen
from galen_hw.tools.monitor.view import View, fresh_for_s
from tests.daemon_tree import daemon_tree

ZERO = Vector3()


def heard(ago_s: float, late_s: float = 0.0) -> View:
    """A view to which everything came `ago_s` ago, of a time `late_s` before that."""
    view, now = View(), time.monotonic() - ago_s
    head: dict[str, Any] = {
        "timestamp": 0.0,
        "t_ns": int(1e9 * (now - late_s)),
        "seq": 1,
        "valid": True,
        "source": "ft",
    }
    by_joint = {"roll": 0.0}
    messages: dict[str, Message] = {
        "wrench/raw": WrenchRaw(**head, force=ZERO, torque=ZERO),
        "wrench/compensated": WrenchCompensated(**head, force=ZERO, torque=ZERO),
        "joints/state": JointsState(**head, position=by_joint, velocity=by_joint, effort=by_joint),
        "pose/reported": Pose(**head, position=ZERO, orientation=Quaternion()),
        "status": Status(**head, state="ready"),
    }
    for topic, message in messages.items():
        view.take(topic, message, now)
    return view


def text_of(view: View, *, gone: bool = False) -> str:
    out = io.StringIO()
    Console(file=out, width=160).print(screen(view, {}, "robot", 160, gone=gone))
    return out.getvalue()


def test_what_has_just_come_is_valid_and_ready() -> None:
    """Otherwise the tests below would pass with a monitor that shows nothing."""
    text = text_of(heard(0.0))

    assert "yes" in text
    assert "ready" in text
    assert "silent" not in text
    assert all(topic["valid"] for topic in heard(0.0).as_json({})["topics"].values())


def test_twelve_seconds_of_silence_are_not_valid() -> None:
    """Every topic with its age, every source as silent, on the screen and for scripts: nothing says yes or ready."""
    view = heard(12.0)
    text, found = text_of(view), view.as_json({})

    assert "yes" not in text
    assert "ready" not in text
    assert text.count("silent for 12.") == 5 + 3 + 1  # rows, titles of panels with their numbers, the source
    assert not any(topic["valid"] for topic in found["topics"].values())
    assert all(topic["old"] and topic["age_s"] > 12.0 for topic in found["topics"].values())
    assert found["status"]["ft"]["state"] == "silent"


def test_what_comes_late_is_not_valid_though_it_comes() -> None:
    """A pose of 11 s ago that has just arrived, and calls itself valid."""
    view = heard(0.0, late_s=11.0)
    text = text_of(view)

    assert "late by 11." in text
    assert "yes" not in text
    assert not view.as_json({})["topics"]["pose/reported"]["valid"]


def test_how_long_a_message_counts_follows_from_its_topic() -> None:
    """Three periods of the nominal rate, at least half a second; an event is never too old."""
    assert fresh_for_s("wrench/raw") == 0.5
    assert fresh_for_s("status") == 3.0
    assert fresh_for_s("fault") == float("inf")


def test_a_daemon_that_has_ended_is_said_above_all() -> None:
    """One line in front of what was heard of it."""
    assert GONE in text_of(heard(0.1), gone=True)
    assert GONE not in text_of(heard(0.1))


@pytest.mark.parametrize("how", ["terminate", "kill"])
def test_monitor_sees_the_daemon_end(tmp_path: Path, how: str) -> None:
    """A script that watches is told so within seconds: no daemon, nothing valid, every source silent."""
    with daemon_tree(tmp_path) as tree:
        tree.write_config()
        daemon = tree.start_ready()
        command = tree.command("monitor", "--json", "--dir", str(tree.addresses.runtime))
        with subprocess.Popen(command, env=tree.environ, stdout=subprocess.PIPE, text=True) as monitor:
            assert monitor.stdout is not None
            screens = map(json.loads, monitor.stdout)
            first = next(found for found in screens if "wrench/compensated" in found["topics"])
            getattr(daemon, how)()
            daemon.wait(timeout=30)
            begun = time.monotonic()
            last = next(found for found in screens if {s["state"] for s in found["status"].values()} == {"silent"})
            took_s = time.monotonic() - begun
            monitor.kill()

    assert first["daemon"]
    assert not last["daemon"]
    assert not any(topic["valid"] for name, topic in last["topics"].items() if fresh_for_s(name) < 10.0)
    assert took_s < 30.0


def test_an_alarm_of_the_health_service_is_shown_with_what_to_do() -> None:
    """And not any more when the service is silent: it may be over."""
    for silent_s, shown in ((0.0, True), (12.0, False)):
        view = heard(silent_s)
        now = time.monotonic() - silent_s
        alarm = Alarm(cause="drift", level="warning", what="the wrench drifts", todo="tare it")
        header = {"timestamp": 0.0, "t_ns": round(now * 1e9), "seq": 0, "valid": True, "source": "health"}
        view.take("health", Health(**header, state="warning", alarms=[alarm]), now)
        assert ("the wrench drifts" in text_of(view)) == shown
        assert ("tare it" in text_of(view)) == shown


def test_what_a_source_wants_done_stands_beside_its_state() -> None:
    """A daemon may run without the health service; what a silent source wanted is of another trouble."""
    for silent_s, shown in ((0.0, True), (12.0, False)):
        view = heard(silent_s)
        now = time.monotonic() - silent_s
        header = {"timestamp": 0.0, "t_ns": round(now * 1e9), "seq": 0, "valid": True, "source": "ft"}
        view.take("status", Status(**header, state="fault", detail="too hot", todo="let it cool"), now)
        assert ("to do: let it cool" in text_of(view)) == shown
        assert view.as_json({})["status"]["ft"]["todo"] == "let it cool"


def test_a_tip_at_zero_has_no_sign() -> None:
    """Rounded, -0.002 mm had been shown as -0.00."""
    view, now = heard(0.0), time.monotonic()
    place, head = Vector3(-2e-6, 0.0, 0.1), {"timestamp": 0.0, "t_ns": int(1e9 * now), "seq": 2, "valid": True}
    pose = Pose(**head, source="arm", position=place, orientation=Quaternion())
    for topic in ("pose/reported", "pose/corrected"):
        view.take(topic, pose, now)
    shown = text_of(view)
    assert "100.00" in shown
    assert "-0.00" not in shown
