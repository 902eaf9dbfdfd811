"""What a calibration does, step by step, written as generators that wait for conditions.

`yield Wait(...)` hands control back until its condition holds; `CalibrationService` feeds the samples, keeps the watch
and turns a `SweepStopped` into a stop of the motors.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from galen_hw.services.calibration.hold import Average, Expectation, average, touched, unsteady
from galen_hw.services.calibration.plan import Step
from galen_hw.services.calibration.state import Run, StaleError, SweepStoppedError

SLOW, HOLD = "slow motion", "hold"
"""Details of the progress of a check while its samples count."""
DISK_S = 60.0
"""Longest wait, at rest, for the files of a sweep to be on the disk."""
ARRIVED = 0.004
"""rad or m from the target that counts as there."""


@dataclass(frozen=True, slots=True)
class Wait:
    """Go on when `until` holds; after `timeout_s` the sweep stops for `reason`."""

    until: Callable[[], bool]
    timeout_s: float
    reason: Callable[[], str]


Script: TypeAlias = Generator[Wait, None, None]


def sweep(run: Run) -> Script:
    """Home, zero, poses without the tool, the tool, poses with it, home."""
    if run.held:
        run.show("checking", "any tool is taken off")
        yield Wait(lambda: not run.held, 3600.0, lambda: "nobody said that the sensor is bare")
    yield from _prepare(run)
    yield from _zero(run)
    for step in run.plan.bare:
        yield from _pose(run, step)
        _refuse_loaded(run)
    yield from _put_tool_on(run)
    for step in run.plan.tool:
        yield from _pose(run, step)
    yield from _move(run, run.plan.home)
    run.file.note("done")
    yield Wait(lambda: run.file.idle, DISK_S, lambda: f"the disk has not taken the sweep within {DISK_S:g} s")
    run.finish()


def check(run: Run) -> Script:
    """Slow motion across the swept range, for whoever watches the compensated wrench; swift to its start and home."""
    yield from _prepare(run)
    for i, step in enumerate(run.plan.check):
        run.pose += 1
        if i > 0:
            run.show("moving", SLOW)
        yield from _move(run, step, slow=i > 0)
        yield from _settle(run)
        run.show("averaging", HOLD)
        run.begin_hold()
        yield Wait(lambda: len(run.samples) >= run.settings.samples, 10.0, lambda: "the sensor gives no samples")
    run.show("moving", "home")
    yield from _move(run, run.plan.home)
    run.finish()


def _prepare(run: Run) -> Script:
    """Health of sensor and motors, then home."""
    run.show("checking", "sensor and motors")
    yield Wait(lambda: run.raw is not None and run.joints is not None, 3.0, run.absent)
    run.require_health()
    yield from _call(run, run.context.motors, "enable", {})
    run.show("moving", "home")
    yield from _move(run, run.plan.home)
    yield from _settle(run)
    run.begin_hold()
    yield Wait(lambda: len(run.samples) >= run.settings.samples, 10.0, lambda: "the sensor gives no samples")
    _refuse_touch(run, "before the sweep")
    run.noise = average(run.samples).std


def _zero(run: Run) -> Script:
    run.show("checking", "zeroing the sensor")
    yield from _call(run, run.context.sensor, "zero", {"samples": run.settings.zero_samples}, timeout_s=30.0)
    yield from _settle(run)
    run.begin_hold()
    yield Wait(lambda: len(run.samples) >= run.settings.samples, 10.0, lambda: "the sensor gives no samples")
    _refuse_touch(run, "while it was zeroed")
    read = average(run.samples)
    limit = np.array([0.2] * 3 + [0.01] * 3)
    if np.any(np.abs(read.mean) > limit):
        worst = int(np.argmax(np.abs(read.mean) / limit))
        raise SweepStoppedError(f"the sensor does not read zero after zeroing (axis {worst + 1})", "zero it again")
    run.noise = read.std
    run.home_bare = read.mean
    run.file.begin(run.plan.home.target)


def _put_tool_on(run: Run) -> Script:
    """Wait until the client says that the tool is on, then see that it is."""
    run.expectation = Expectation(run.gravity)
    yield from _move(run, run.plan.home)
    run.tool_on = False
    run.show("waiting", "put the tool on")
    yield Wait(lambda: run.tool_on, 3600.0, lambda: "nobody put the tool on")
    yield from _settle(run)
    run.begin_hold()
    yield Wait(lambda: len(run.samples) >= run.settings.samples, 10.0, lambda: "the sensor gives no samples")
    _refuse_touch(run, "after the tool was put on")
    weight = float(np.linalg.norm(average(run.samples).mean[:3] - run.home_bare[:3]))
    mass = weight / float(np.linalg.norm(run.gravity))
    if mass < run.settings.least_tool_mass_kg:
        what = f"putting the tool on changed the reading by {weight:.3f} N only: it was on when the sensor was zeroed"
        raise SweepStoppedError(what, "take the tool off and calibrate again", kind="loaded")


def _pose(run: Run, step: Step) -> Script:
    """One pose; it begins anew if a device falls silent and comes back."""
    began = run.now_ns
    run.pose += 1
    while True:
        try:
            yield from _attempt(run, step)
        except StaleError:
            yield from _recover(run)
        else:
            run.learn_pace(began)
            return


def _recover(run: Run) -> Script:
    """The robot stands; wait until sensor and motors are heard again."""
    who = run.silent()
    run.show("paused", f"no samples from {who}")
    reason = f"no samples from {who} for {run.settings.stale_s + run.settings.recover_s:g} s"
    yield Wait(lambda: not run.silent() and run.resting(), run.settings.recover_s, lambda: reason)
    run.paused = False


def _attempt(run: Run, step: Step) -> Script:
    """Move, wait until still, average, judge, write."""
    run.show("moving", "home" if step.kind == "home" else "")
    yield from _move(run, step)
    run.show("settling")
    yield from _settle(run)
    run.show("averaging")
    for attempt in range(3):
        run.begin_hold()
        yield Wait(lambda: _full(run), 10.0, lambda: "the sensor gives too few good samples")
        reading = average(run.samples)
        if run.noise is None or np.max(reading.std / np.maximum(run.noise, 1e-12)) < 2.0:
            break
        if attempt == 2:
            raise SweepStoppedError("the wrench will not come to rest", "look for what shakes the robot or the tool")
        yield from _settle(run)
    _record(run, step, reading)


def _full(run: Run) -> bool:
    """Enough samples; on the way, a touch stops the sweep."""
    if len(run.samples) % 40 == 0:
        _refuse_touch(run, "during a hold")
    return len(run.samples) >= run.settings.samples


def _record(run: Run, step: Step, reading: Average) -> None:
    q = run.positions()
    R = run.context.robot.sensor_pose(q)[0, :3, :3]
    settings = run.settings
    surprise = run.expectation.surprise(R, reading.mean, settings.touch_force_n, settings.touch_torque_nm)
    if surprise:
        raise SweepStoppedError(f"touched: {surprise}", "let go of robot, tool and cables, then calibrate again")
    run.expectation.add(R, reading.mean)
    time_s = 1e-9 * (run.now_ns - run.began_ns)
    run.file.add(step, time_s=time_s, q=q, mean=reading.mean, std=reading.std, samples=reading.samples)


def _refuse_touch(run: Run, when: str) -> None:
    reason = touched(run.samples, run.settings.touch_force_n, run.settings.touch_torque_nm)
    if reason:
        raise SweepStoppedError(f"touched {when}: {reason}", "let go of robot, tool and cables, then calibrate again")


def _refuse_loaded(run: Run) -> None:
    """More than a bare sensor carries: it was loaded when it was zeroed."""
    mass = run.expectation.mass
    if mass is not None and mass > run.settings.max_bare_mass_kg:
        what = f"{mass:.3f} kg hang on the sensor, at most {run.settings.max_bare_mass_kg:.3f} kg without a tool"
        todo = "take the tool off before the sensor is zeroed, or raise max_bare_mass_kg"
        raise SweepStoppedError(what, todo, kind="loaded")


def _move(run: Run, step: Step, *, slow: bool = False) -> Script:
    """Move and wait until the robot stands at the target."""
    target = run.changed(step.target)
    if target:
        yield from _call(run, run.context.motors, "move_jp", run.move_arguments(target, slow=slow))
        yield Wait(lambda: run.arrived(step.target, ARRIVED), run.move_timeout_s(target, slow=slow), run.not_arrived)


def _settle(run: Run) -> Script:
    """Joints at rest for `settle_s`, and the wrench steady."""
    reason, checked = "no samples", 0

    def still() -> bool:
        nonlocal reason, checked
        if not run.resting():
            run.begin_hold()
            reason, checked = run.moving_joint(), 0
            return False
        if run.rested_s() < run.settings.settle_s or len(run.samples) < checked + 20:
            return False
        checked = len(run.samples)
        reason = unsteady(run.samples, run.noise)
        return not reason

    run.begin_hold()
    yield Wait(still, run.settings.pose_timeout_s, lambda: f"does not come to rest: {reason}")


def _call(run: Run, target: str, name: str, args: dict[str, Any], timeout_s: float = 15.0) -> Script:
    """Send a request to a device and wait until it is carried out."""
    request_id = run.send(target, name, args)
    yield Wait(lambda: request_id in run.replies, timeout_s, lambda: f"{target} does not answer to {name}")
    error = run.replies.pop(request_id).error
    if error is not None:
        raise SweepStoppedError(f"{target} {name}: {error.what}", error.todo)
