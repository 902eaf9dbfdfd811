"""The loop closed over ptys and ZeroMQ: a concealed cable and a concealed drift are recorded, named, saved, taken up by
the live compensation, and a new recording agrees."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from galen_hw.bus import CommandClient, Subscriber
from galen_hw.cli import main
from galen_hw.config.paths import Addresses
from galen_hw.config.tool_store import ToolStore
from galen_hw.daemon.session import own_daemon
from galen_hw.drivers.galil_dmc.settings import GalilSettings
from galen_hw.drivers.virtual.control import VirtualControl
from galen_hw.recording import read_recording
from tests.test_admittance import calibrated

STIFFNESS, WARM_UP, WARM_UP_S = 3.0, 0.9, 8.0
JOINTS = ("carriage1", "carriage2", "carriage3", "roll", "tilt")
REACH = np.array([0.03, 0.03, 0.03, 0.7, 0.5])
CONFIG = """
[devices.ft]
driver = "ati_netcanoem"
settings = { rate_hz = 100.0 }
transport = { interface = "socketcan", channel = "can0", bitrate = 1000000 }
[devices.motors]
driver = "galil_dmc"
settings = { axes = AXES }
transport = { url = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A1B2C3D4-if00-port0", baud_rate = 115200 }
[services.compensation]
dynamic = true
[bus]
viewers = ""
[daemon]
blind_after_s = 2.0
"""


def axes() -> str:
    """Gentle axes: at 57 joint states a second nobody could follow harder steps of acceleration."""
    rows = []
    for axis in GalilSettings().axes:
        gentle = (
            {"acceleration": 0.02, "velocity": 0.02} if axis.unit == "m" else {"acceleration": 0.2, "velocity": 0.3}
        )
        values = axis.model_dump(exclude_unset=True) | gentle
        rows.append("{" + ", ".join(f"{k} = {json.dumps(v)}" for k, v in values.items()) + "}")
    return "[" + ", ".join(rows) + "]"


class Robot:
    """The daemon on the virtual robot, as one who records sees it."""

    def __init__(self, folder: Path, addresses: Addresses, client: CommandClient, states: Subscriber) -> None:
        self.folder, self.addresses, self.client, self.states = folder, addresses, client, states

    def state(self):
        """The next joint state."""
        found = self.states.receive(5.0)
        assert found is not None, "the bus fell silent"
        return found[1]

    def wander(self, seconds: float, rng: np.random.Generator) -> None:
        """From one random place to the next until so much of the robot's own time is over."""
        begin = self.state().t_ns
        while (self.state().t_ns - begin) * 1e-9 < seconds:
            goal = dict(zip(JOINTS, (rng.uniform(-1.0, 1.0, 5) * REACH).tolist(), strict=True))
            self.client.call("motors", "move_jp", {"position": goal}, timeout_s=10.0)
            asked = self.state().t_ns
            while any((now := self.state()).moving.values()) or now.t_ns - asked < 200_000_000:
                pass

    def record(self, name: str, seconds: float, seed: int) -> Path:
        """`galen-hw record` of such a motion."""
        path = self.folder / name
        words = ["record", "-o", str(path), "--dir", str(self.addresses.runtime)]
        words += ["--config", str(self.folder / "galen.toml")]
        recorder = subprocess.Popen([sys.executable, "-m", "galen_hw.cli", *words], stdout=subprocess.DEVNULL)
        try:
            while not (path.exists() and path.stat().st_size > 0):
                self.state()
            self.wander(seconds, np.random.default_rng(seed))
        finally:
            recorder.terminate()
            recorder.wait(timeout=30)
        return path


def live_residual(path: Path) -> np.ndarray:
    """(6,) standard deviation of the live compensated wrench."""
    recording = read_recording(path, compensated=True)
    names = [f"covariate.compensated.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
    return np.nanstd(recording.matrix(*names), axis=0)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_concealed_cable_and_drift_are_named_saved_served_and_gone(tmp_path, monkeypatch, capsys):
    """Cable and drift are found with their numbers; import makes a new generation that the daemon uses at once; the live
    residual falls by what the report promised; a new recording agrees; rollback brings the old residual back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GALEN_HW_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("GALEN_HW_RUNTIME", str(tmp_path / "run"))
    (tmp_path / "galen.toml").write_text(CONFIG.replace("AXES", axes()))
    tool = calibrated()
    ToolStore(tmp_path / "state").save(
        tool.model_copy(update={"origin": tool.origin.model_copy(update={"virtual": True})})
    )
    with (
        own_daemon(
            config=str(tmp_path / "galen.toml"), state=tmp_path / "state", runtime=tmp_path / "run"
        ) as addresses,
        CommandClient(addresses.command) as client,
        Subscriber(addresses.bus, ["joints/state"]) as states,
        VirtualControl(addresses.virtual) as world,
    ):
        robot = Robot(tmp_path, addresses, client, states)
        client.call("ft", "zero", {"samples": 100}, timeout_s=30.0)
        world.attach_tool("retractor")
        world.noise(scale=3.0)
        client.call("motors", "enable")
        client.call("compensation", "select_tool", {"tool": "retractor"})
        world.cable(anchor=[0.15, -0.3, 0.5], attached=[0.0, 0.01, -0.03], stiffness=STIFFNESS)
        world.drift(warm_up=[WARM_UP, 0, 0, 0, 0, 0], warm_up_s=WARM_UP_S)
        hidden = robot.record("hidden.mcap", 28.0, seed=1)

        words = ["--tool", "retractor", "--save-model", "retractor+cable.json", "-o", "hidden.json"]
        assert main(["diagnose", str(hidden), *words]) == 1
        answer = json.loads(Path("hidden.json").read_text())
        found = {f["effect"]: f["parameters"] for f in answer["findings"]}
        assert set(found) == {"cable_drag", "drift"}, capsys.readouterr().out
        stiffness = found["cable_drag"]["stiffness"]
        assert stiffness["value"] == pytest.approx(STIFFNESS, abs=max(0.05 * STIFFNESS, 4.0 * stiffness["std"]))
        assert found["drift"]["constant"]["value"] == pytest.approx(WARM_UP_S, rel=0.3)
        capsys.readouterr()

        assert main(["tool", "import", "retractor+cable.json"]) == 0
        assert "with " in (said := capsys.readouterr().out)
        assert "the daemon uses it now" in said
        after = robot.record("after.mcap", 28.0, seed=2)
        before_live, after_live = live_residual(hidden), live_residual(after)
        promised = {k: np.array(list(answer["fit"][k].values())) for k in ("rmse_before", "rmse_after")}
        moved = promised["rmse_before"] > 2.0 * promised["rmse_after"]
        assert moved.sum() >= 3
        np.testing.assert_array_less(after_live[moved], 1.25 * promised["rmse_after"][moved])
        np.testing.assert_array_less(promised["rmse_before"][moved] / 2.0, before_live[moved])

        assert main(["diagnose", str(after), "-o", "after.json"]) == 0, capsys.readouterr().out
        assert json.loads(Path("after.json").read_text())["verdict"] == "agrees"
        capsys.readouterr()

        assert main(["tool", "rollback", "retractor"]) == 0
        assert "the daemon uses it now" in capsys.readouterr().out
        assert (
            client.call("compensation", "reload")["calibration"]
            == ToolStore(tmp_path / "state").load("retractor").calibration_id
        )
    assert main(["replay", str(after), "--verify"]) == 0
