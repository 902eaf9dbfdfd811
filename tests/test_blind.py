"""Blind in the middle of a move: real daemon, real drivers, virtual robot; the truth is the virtual robot's own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.errors import CommandRejectedError, HardwareError
from tests.daemon_tree import Systemd, within

REST = 1e-3
"""rad/s, below which the arm is at rest."""
WITHIN_S = 0.25
CONTROLLER_WITHIN_S = 0.40
SLACK_S = 0.3
"""What a busy machine that tests may add."""
SETTINGS = """
[devices.ft]
driver = "ati_netcanoem"
transport = {{ interface = "slcan", channel = "{can}", bitrate = 1000000 }}
[devices.motors]
driver = "galil_dmc"
transport = {{ url = "{motors}", baud_rate = 115200 }}
[services.compensation]
[services.calibration]
[bus]
viewers = ""
[daemon]
realtime_priority = 0
"""


@dataclass
class Arm:
    """A daemon on a virtual robot whose roll joint can be set in motion and watched."""

    folder: Path
    control: VirtualControl
    addresses: Addresses
    systemd: Systemd

    def log(self) -> str:
        return (self.folder / "stderr").read_text()

    def subscriber(self, *topics: str) -> Subscriber:
        return Subscriber(self.addresses.bus, topics)

    def hear(self, subscriber: Subscriber, said: list[str], topic: str, words: str) -> bool:
        """Take a message; whether one on the topic has said these words."""
        if received := subscriber.receive(0.2):
            said.append(f"{received[0]} {received[1]}")
        return any(text.startswith(topic) and words in text for text in said)

    @contextmanager
    def stopped(self, pid: int) -> Iterator[int]:
        """Stop a process for the time of a block, which is given the time at which it was."""
        begun = time.monotonic_ns()
        os.kill(pid, signal.SIGSTOP)
        try:
            yield begun
        finally:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    def ask(self, target: str, name: str, **args: Any) -> dict[str, Any]:
        with CommandClient(self.addresses.command) as client:
            return client.call(target, name, args, 10.0)

    def pid(self, name: str) -> int:
        return int(self.ask("daemon", "info")["processes"][name])

    def speed(self) -> tuple[int, float]:
        state = self.control.state()
        return state["t_ns"], abs(state["velocities"]["roll"])

    def begin(self, speed: float = 0.5) -> None:
        """Everything in order, motors on, and a move across the range."""
        assert within(20.0, self.in_order)
        assert within(10.0, lambda: self.cleared("enable"))
        here = self.control.state()["joints"]["roll"]
        self.ask("motors", "move_jp", position={"roll": -1.5 if here > 0 else 1.5}, velocity={"roll": speed})
        assert within(5.0, lambda: self.speed()[1] > 0.99 * speed)

    def refusal(self, name: str, **args: Any) -> str:
        """Why the motors refuse a command; empty if they carry it out."""
        try:
            self.ask("motors", name, **args)
        except (CommandRejectedError, HardwareError) as error:
            return str(error)
        return ""

    def cleared(self, then: str, **args: Any) -> bool:
        """Clear the faults; whether the motors then carry out a command (a process that has just begun may stall)."""
        return not self.refusal("clear_fault") and not self.refusal(then, **args)

    def in_order(self) -> bool:
        """Both devices are ready, and samples flow."""
        info = self.ask("daemon", "info")
        return info["ready"] and all(device["ready"] for device in info["devices"].values())

    def seconds_to_rest(self, begun_ns: int, at_most_s: float = 5.0) -> float:
        """From then to the moment when the arm is at rest."""
        until = time.monotonic() + at_most_s
        while time.monotonic() < until:
            t_ns, speed = self.speed()
            if speed < REST:
                return (t_ns - begun_ns) * 1e-9
        raise AssertionError("the arm moves on")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    folder = tmp_path_factory.mktemp("blind")
    with virtual_robot(folder / "v") as robot:
        can, motors = robot.addresses["can0"]["channel"], robot.addresses["motors"]["url"]
        config = folder / "galen.toml"
        config.write_text(SETTINGS.format(can=can, motors=motors))
        systemd = Systemd(folder)
        environ = os.environ | {"GALEN_HW_STATE": str(folder / "state"), "NOTIFY_SOCKET": systemd.path}
        command = [sys.executable, "-m", "galen_hw.cli", "run", "--config", str(config), "--dir", str(folder / "run")]
        with (folder / "stderr").open("w") as said:
            process = subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=said)
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line.startswith("ready"), (folder / "stderr").read_text()
            yield Arm(folder, robot.control, Addresses(folder / "run"), systemd)
        finally:
            process.terminate()
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
            systemd.close()


def refused_until_cleared(arm: Arm, words: str) -> None:
    """A motion is refused, with the command that clears it; after that command it is carried out."""
    assert within(20.0, arm.in_order)
    assert within(10.0, lambda: "clear_fault" in arm.refusal("servo_jv", velocity={"roll": 0.1}))
    assert words in arm.refusal("servo_jv", velocity={"roll": 0.1})
    assert arm.speed()[1] == 0.0
    back = 0.1 if arm.control.state()["joints"]["roll"] < 0 else -0.1
    assert within(10.0, lambda: arm.cleared("servo_jv", velocity={"roll": back}))
    arm.ask("motors", "stop")


def test_a_core_that_is_stopped_stops_the_arm(arm: Arm) -> None:
    """SIGSTOP: at rest at once; nothing moves while core stands still, nor after it goes on, before clear_fault."""
    arm.begin()
    core = arm.pid("core")
    with arm.stopped(core) as begun:
        assert arm.seconds_to_rest(begun) < WITHIN_S + SLACK_S
        assert "no sign of life from the process core" in arm.refusal("servo_jv", velocity={"roll": 0.1})
        assert arm.systemd.hears_in("STATUS=", "motors held at rest", "process core does not run")
    refused_until_cleared(arm, "no sign of life from the process core")
    assert "motors: stopped, for nobody feels what the arm does: no sign of life from the process core" in arm.log()


def test_a_core_that_dies_stops_the_arm(arm: Arm) -> None:
    """SIGKILL: at rest, started again, and the stop stays."""
    arm.begin()
    begun = time.monotonic_ns()
    os.kill(arm.pid("core"), signal.SIGKILL)
    assert arm.seconds_to_rest(begun) < WITHIN_S + SLACK_S
    refused_until_cleared(arm, "nobody feels what the arm does")


def test_a_wrench_that_falls_silent_stops_the_arm(arm: Arm) -> None:
    """The sensor answers nothing more: at rest, said in a fault and in the motors' status."""
    arm.begin()
    with arm.subscriber("fault", "status") as subscriber:
        begun = time.monotonic_ns()
        arm.control.fault("ft.silent")
        try:
            assert arm.seconds_to_rest(begun) < WITHIN_S + SLACK_S
            said = []
            assert within(5.0, lambda: arm.hear(subscriber, said, "fault", "no wrench for"))
            assert within(5.0, lambda: arm.hear(subscriber, said, "status", "no wrench for"))
        finally:
            arm.control.fault("ft.silent", on=False)
    refused_until_cleared(arm, "no wrench for")


def test_a_motion_process_that_is_stopped_is_replaced_by_the_controllers_own_time_out(arm: Arm) -> None:
    """SIGSTOP of the motors' process: the controller stops the axes; the watchdog starves, and the status says why."""
    arm.begin()
    motion = arm.pid("motion")
    with arm.subscriber("status") as subscriber, arm.stopped(motion) as begun:
        assert arm.seconds_to_rest(begun) < CONTROLLER_WITHIN_S + SLACK_S
        assert arm.systemd.hears_in("STATUS=", "motors silent", "process motion does not run")
        arm.systemd.heard.clear()
        said: list[str] = []
        assert within(5.0, lambda: arm.hear(subscriber, said, "status", "the process motion has not run for"))
        arm.systemd.listen()
        assert "WATCHDOG=1" not in arm.systemd.heard
    refused_until_cleared(arm, "the controller heard nothing for 0.25 s and stopped the axes")


def test_a_motion_process_that_dies_is_replaced_by_the_controllers_own_time_out(arm: Arm) -> None:
    """SIGKILL of the motors' process in a move: axes at rest, and the stop outlives the process."""
    arm.begin()
    begun = time.monotonic_ns()
    os.kill(arm.pid("motion"), signal.SIGKILL)
    assert arm.seconds_to_rest(begun) < CONTROLLER_WITHIN_S + SLACK_S
    refused_until_cleared(arm, "the controller heard nothing for 0.25 s and stopped the axes")
