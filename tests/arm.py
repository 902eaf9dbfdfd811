"""A real daemon on a virtual robot whose roll joint moves; the truth is the virtual robot's own."""

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

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.drivers.virtual.start import virtual_robot
from galen_hw.errors import CommandRejectedError, HardwareError
from tests.daemon_tree import Systemd, within

REST = 1e-3
"""rad/s, below which the arm is at rest."""
SETTINGS = """
[devices.ft]
driver = "ati_netcanoem"
transport = {{ interface = "slcan", channel = "{can}", bitrate = 1000000 }}
[devices.motors]
driver = "galil_dmc"
transport = {{ url = "{motors}", baud_rate = 115200 }}
settings = {{ {settings} }}
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
    process: "subprocess.Popen[str]"

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
        self.systemd.drain()
        state = self.control.state()
        return state["t_ns"], abs(state["velocities"]["roll"])

    def begin(self, speed: float = 0.5) -> None:
        """Everything in order, motors on, and a move across the range; again if a stall of the machine has stopped it."""
        assert within(20.0, self.in_order)
        assert within(60.0, lambda: self.moves(speed))

    def moves(self, speed: float) -> bool:
        """Set the roll joint in motion; whether it reaches its speed."""
        here = self.control.state()["joints"]["roll"]
        far = {"position": {"roll": -1.5 if here > 0 else 1.5}, "velocity": {"roll": speed}}
        if not self.cleared("enable") or self.refusal("move_jp", **far):
            return False
        return within(5.0, lambda: self.speed()[1] > 0.99 * speed)

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


@contextmanager
def running_arm(folder: Path, *, daemon: str = "", motors_settings: str = "") -> Iterator[Arm]:
    """A daemon and its virtual robot, gone afterwards; with these settings of the daemon and of the motors."""
    with virtual_robot(folder / "v") as robot:
        can, motors = robot.addresses["can0"]["channel"], robot.addresses["motors"]["url"]
        config = folder / "galen.toml"
        config.write_text(SETTINGS.format(can=can, motors=motors, settings=motors_settings) + daemon)
        systemd = Systemd(folder)
        environ = os.environ | {"GALEN_HW_STATE": str(folder / "state"), "NOTIFY_SOCKET": systemd.path}
        command = [sys.executable, "-m", "galen_hw.cli", "run", "--config", str(config), "--dir", str(folder / "run")]
        with (folder / "stderr").open("w") as said:
            process = subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=said)
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line.startswith("ready"), (folder / "stderr").read_text()
            yield Arm(folder, robot.control, Addresses(folder / "run"), systemd, process)
        finally:
            process.terminate()
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
            systemd.close()
