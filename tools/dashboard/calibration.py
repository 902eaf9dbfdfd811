"""A calibration as the page leads through it: bare sensor, sweep, tool on, sweep, fit, decision, check, report.

It is `galen-hw calibrate` with buttons in place of a terminal. It runs in a thread; the page that began it must say that it
is alive, or the robot stops: nobody would see what it does.
"""

import io
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from galen_hw.bus import CommandClient
from galen_hw.config.paths import Addresses
from galen_hw.config.tool_file import ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.errors import CommandRejectedError, GalenError
from galen_hw.permission import require_writable
from galen_hw.recording import read_recording
from galen_hw.tools.calibration.check import LiveCheck, live_check
from galen_hw.tools.calibration.figures import write_report
from galen_hw.tools.calibration.poses import poses_of
from galen_hw.tools.calibration.recorded import setting_of
from galen_hw.tools.calibration.result import Result, analyse, tool_file, with_terms
from galen_hw.tools.calibration.sweep import Operator, by_virtual_hand, run_sweep
from galen_hw.tools.outputs import PAGE

ALIVE_S: Final = 2.0
"""Silence of the page that calibrates, after which the robot stops."""
DECIDE_S: Final = 1800.0
TURN_S: Final = 0.1
RUNNING: Final = ("starting", "bare", "sweep", "tool", "fit", "decide", "check")


class Calibration:
    """One calibration at a time.

    Args:
        addresses: of the daemon.
        overrides: arguments of the sweep that differ from its settings; check: run the slow motion that checks.
    """

    def __init__(self, addresses: Addresses, overrides: dict[str, Any], *, check: bool = True) -> None:
        self._addresses, self._overrides, self._check = addresses, overrides, check
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._go_on, self._abort = threading.Event(), threading.Event()
        self._accept: bool | None = None
        self._owner: object = None
        self._alive_s = 0.0
        self._why = ""
        self.count = 0
        """Goes up with each change of `state`."""
        self.state: dict[str, Any] = {"step": "idle"}

    @property
    def running(self) -> bool:
        """Return whether one is under way."""
        return self.state["step"] in RUNNING

    def start(self, tool: str, owner: object) -> None:
        """Begin, for a page.

        Raises:
            CommandRejectedError: one is under way.
        """
        with self._lock:
            if self.running:
                raise CommandRejectedError("a calibration is under way", where="dashboard", todo="abort it first")
            self._go_on.clear()
            self._abort.clear()
            self._accept, self._owner, self._alive_s, self._why = None, owner, time.monotonic(), ""
            self._show("starting", tool=tool)
            self._thread = threading.Thread(target=self._run, args=(tool,), daemon=True)
            self._thread.start()
            threading.Thread(target=self._watch, daemon=True).start()

    def alive(self, owner: object) -> None:
        """The page says that it is there."""
        if owner is self._owner:
            self._alive_s = time.monotonic()

    def go_on(self) -> None:
        """What was asked for is done."""
        self._go_on.set()

    def decide(self, *, accept: bool) -> None:
        """Use the result, or not."""
        self._accept = accept
        self._go_on.set()

    def abort(self, why: str = "aborted") -> None:
        """End it; the robot stops at once, the poses so far are kept."""
        if not self.running:
            return
        self._why = self._why or why
        self._abort.set()
        self._go_on.set()
        with suppress(GalenError), CommandClient(self._addresses.command) as client:
            client.call("calibration", "stop", timeout_s=1.0)

    def close(self) -> None:
        """The server ends."""
        self.abort("the dashboard was ended")
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _watch(self) -> None:
        """Stop the robot when its page is gone; not while nothing moves and a decision is awaited."""
        thread = self._thread
        while thread is not None and thread.is_alive() and not self._abort.wait(TURN_S):
            if time.monotonic() - self._alive_s > ALIVE_S and self.state["step"] not in ("fit", "decide"):
                self.abort("the page that began it was closed")

    def _show(self, step: str, **more: Any) -> None:
        kept = {k: v for k, v in self.state.items() if k in ("tool", "result", "report", "virtual")}
        self.state = (kept if step != "starting" else {}) | {"step": step} | more
        self.count += 1

    def _run(self, tool: str) -> None:
        try:
            self._calibrate(tool)
        except GalenError as error:
            self._show("failed", what=self._why or str(error))
        except Exception as error:  # noqa: BLE001 - a thread that dies silently leaves the page waiting
            self._show("failed", what=f"internal error: {error!r}; please report it")

    def _calibrate(self, tool: str) -> None:
        with CommandClient(self._addresses.command) as client:
            info = client.call("daemon", "info")
        store = ToolStore(Path(info["state_dir"]), virtual=bool(info["virtual"]))
        nominal = store.load(tool)
        require_writable(store.path(tool, 1).parent, "galen-hw dashboard")
        self.state["virtual"] = bool(info["virtual"])
        console = Console(file=io.StringIO(), width=120)
        operator = self._operator(tool, virtual=bool(info["virtual"]), console=console)
        folder, stopped = run_sweep(self._addresses, tool, self._overrides, operator, console)
        if stopped:
            raise CommandRejectedError(stopped, where="sweep")
        self._show("fit")
        recording = read_recording(folder)
        found = poses_of(recording)
        result = analyse(tool, found.poses, str(folder), found.notes)
        file = tool_file(result, with_terms(nominal, found.terms), setting_of(recording))
        self._show("decide", result=summary(result, file))
        self._wait("decide", DECIDE_S)
        if not self._accept:
            self._show("done", accepted=False, what="Not accepted: nothing has changed")
            return
        self._finish(store, store.save(file), result, console)

    def _finish(self, store: ToolStore, file: ToolFile, result: Result, console: Console) -> None:
        """Take it in hand, check it in slow motion, write the report."""
        with CommandClient(self._addresses.command) as client:
            client.call("compensation", "select_tool", {"tool": file.name})
            client.call("compensation", "set_enabled", {"enabled": True})
        check, words = None, f"{file.calibration_id} is in use"
        if self._check:
            self._show("check")
            try:
                check = live_check(self._addresses, file.name, file.calibration_id, console, result.poses.noise)
                words += ", and the check passed" if check.passed else "; THE CHECK DID NOT PASS: see the report"
            except GalenError as error:
                words += f"; it was not checked: {self._why or error}"
        report = self._report(store, file, result, check)
        self._show("done", accepted=True, what=words, passed=check is None or check.passed, report=report)

    def _report(self, store: ToolStore, file: ToolFile, result: Result, check: LiveCheck | None) -> str:
        assert file.origin is not None
        leaf = f"{file.name}-{file.origin.generation:04d}"
        try:
            page = store.state_dir / "reports" / leaf / PAGE
            write_report(result, page, file, check, f"accepted as {file.calibration_id}")
        except OSError:
            return ""
        return f"{leaf}/{page.name}"

    def _operator(self, tool: str, *, virtual: bool, console: Console) -> Operator:
        hands = by_virtual_hand(console, tool, self._addresses.virtual) if virtual else None

        def step(name: str, hand: Callable[[], None] | None) -> Callable[[], None]:
            def wait() -> None:
                self._show(name)
                self._wait(name, DECIDE_S)
                if hand is not None:
                    hand()
                self._show("sweep")

            return wait

        return Operator(step("bare", hands.bare if hands else None), step("tool", hands.tool if hands else None))

    def _wait(self, what: str, seconds: float) -> None:
        """Until the page goes on.

        Raises:
            CommandRejectedError: it aborts, or nobody answers.
        """
        self._go_on.clear()
        if self._abort.is_set() or not self._go_on.wait(seconds) or self._abort.is_set():
            raise CommandRejectedError(self._why or f"nobody answered ({what})", where="dashboard")


def summary(result: Result, file: ToolFile) -> dict[str, Any]:
    """What a person decides upon; g, mm, N and N mm."""
    half = result.estimate.t95 * result.estimate.std[:4]
    assert file.mass is not None
    assert file.com is not None
    residual = np.asarray(result.best.rms, dtype=float)
    return {
        "mass_g": 1e3 * file.mass,
        "mass_half_g": 1e3 * float(half[0]),
        "com_mm": [1e3 * x for x in file.com],
        "com_half_mm": [1e3 * float(x) for x in half[1:]],
        "residual_n": float(np.sqrt(np.mean(residual[:3] ** 2))),
        "residual_nmm": 1e3 * float(np.sqrt(np.mean(residual[3:] ** 2))),
        "method": result.comparison.recommended,
        "remarks": list(result.remarks),
    }
