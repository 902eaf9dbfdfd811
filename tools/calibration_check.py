"""The proof at the end: every compensated sample in holds and slow motion, beside the sensor's noise floor."""

import threading
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console

from galen_hw.bus import Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.errors import HardwareError
from galen_hw.messages import JointsState, Message, Vector3, WrenchCompensated, WrenchRaw
from galen_hw.spatial import Array
from galen_hw.tools.calibration_sweep import run_check

LEAST_SAMPLES = 2000
LIMIT = 1.05
"""Compensated over noise floor that counts as compensated."""


@dataclass(frozen=True)
class LiveCheck:
    """What was heard on the bus during the slow motion.

    Args:
        time: (n,) s; raw, compensated: (n, 6) N and N m, of the same samples.
        noise: (6,) sigma of one raw sample while the robot stands still.
        moving: (n,) share of the samples in motion is its mean; invalid, lost: samples.
    """

    time: Array
    raw: Array
    compensated: Array
    noise: Array
    moving: Array
    invalid: int
    lost: int

    @property
    def rms(self) -> Array:
        """(6,) of the compensated samples."""
        return np.asarray(np.sqrt(np.mean(self.compensated**2, axis=0)))

    @property
    def rms_raw(self) -> Array:
        """(6,) of the raw samples."""
        return np.asarray(np.sqrt(np.mean(self.raw**2, axis=0)))

    @property
    def passed(self) -> bool:
        """All six axes within the limit."""
        return bool(np.all(self.rms <= LIMIT * self.noise))


@dataclass
class _Ear:
    """Collects samples in a thread while the sweep service moves the robot."""

    addresses: Addresses
    calibration: str
    raw: dict[int, tuple[float, ...]] = field(default_factory=dict)
    compensated: dict[int, tuple[float, ...]] = field(default_factory=dict)
    rests: list[tuple[int, bool]] = field(default_factory=list)
    invalid: int = 0
    lost: int = 0
    end: threading.Event = field(default_factory=threading.Event)

    def listen(self) -> None:
        """Until `end` is set."""
        with Subscriber(self.addresses.bus, ("wrench/raw", "wrench/compensated", "joints/state"), queue=200_000) as bus:
            while not self.end.is_set():
                received = bus.receive(0.2)
                if received is not None:
                    self._take(received[1])
            self.lost = sum(bus.lost.values())

    def _take(self, message: Message) -> None:
        if isinstance(message, WrenchRaw):
            self.raw[message.t_ns] = _six(message.force, message.torque)
        elif isinstance(message, WrenchCompensated):
            if message.calibration == self.calibration and message.blend >= 1.0:
                self.invalid += not message.valid
                if message.valid:
                    self.compensated[message.t_ns] = _six(message.force, message.torque)
        elif isinstance(message, JointsState):
            self.rests.append((message.t_ns, not any(message.moving.values())))


def _six(force: Vector3, torque: Vector3) -> tuple[float, ...]:
    return (force.x, force.y, force.z, torque.x, torque.y, torque.z)


def live_check(addresses: Addresses, tool: str, calibration: str, console: Console) -> LiveCheck:
    """Move slowly round the swept range and compare every compensated sample with the noise floor.

    Args:
        tool: in hand and selected; calibration: identity that the samples must bear.

    Raises:
        HardwareError: the motion was stopped, or no sample bears the calibration.
    """
    ear = _Ear(addresses, calibration)
    thread = threading.Thread(target=ear.listen, daemon=True)
    thread.start()
    try:
        run_check(addresses, tool, console)
    finally:
        ear.end.set()
        thread.join(timeout=5.0)
    return _result(ear)


def _result(ear: _Ear) -> LiveCheck:
    stamps = np.array(sorted(ear.raw.keys() & ear.compensated.keys()))
    if len(stamps) < LEAST_SAMPLES:
        what = f"only {len(stamps)} compensated samples bear the calibration {ear.calibration}"
        raise HardwareError(what, where="wrench/compensated", todo="galen-hw monitor")
    raw = np.array([ear.raw[t] for t in stamps])
    compensated = np.array([ear.compensated[t] for t in stamps])
    times = np.array([t for t, _ in ear.rests])
    rest = np.array([still for _, still in ear.rests])
    after = np.searchsorted(times, stamps).clip(1, len(times) - 1)
    still = rest[after] & rest[after - 1]
    return LiveCheck(
        1e-9 * (stamps - stamps[0]), raw, compensated, _noise(raw, stamps, still), ~still, ear.invalid, ear.lost
    )


def _noise(raw: Array, stamps: Array, still: Array) -> Array:
    """Sigma of one sample (6,): scatter about the mean of each rest, its first 0.15 s (the tool swings) left out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still.astype(bool), [False]]).astype(int)))
    total, freedom = np.zeros(6), 0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        start = int(np.searchsorted(stamps, stamps[first] + 150_000_000))
        hold = raw[start:last]
        if len(hold) > 50:
            total += np.sum((hold - hold.mean(axis=0)) ** 2, axis=0)
            freedom += len(hold) - 1
    return np.asarray(np.sqrt(total / max(freedom, 1)))
