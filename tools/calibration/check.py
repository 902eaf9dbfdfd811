"""The proof at the end: every compensated sample in holds and slow motion, beside the sensor's noise floor."""

import threading
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from galen_hw.bus import Subscriber
from galen_hw.config.paths import Addresses
from galen_hw.errors import HardwareError
from galen_hw.messages import CalibrationProgress, JointsState, Message, Vector3, WrenchCompensated, WrenchRaw
from galen_hw.spatial import Array
from galen_hw.tools.calibration.sweep import run_check

COUNTED = ("slow motion", "hold")
"""Details of the progress during which samples count; swift moves to the start and home do not."""
TOPICS = ("wrench/raw", "wrench/compensated", "joints/state", "calibration/progress")
TAIL_NS = 60_000_000
"""A sample counts if the state has not changed soon after it: joint states come at 40 Hz."""
HARD = 0.3
"""rad/s^2 beyond which a motion is not slow."""
LEAST_SAMPLES = 2000
LIMIT = 1.05
"""Compensated over noise floor that counts as compensated."""


@dataclass(frozen=True)
class LiveCheck:
    """What was heard on the bus during the slow motion.

    Args:
        time: (n,) s; raw, compensated: (n, 6) N and N m, of the same samples.
        noise: (6,) sigma of one raw sample while the robot stands still, the noise floor.
        moving: (n,) share of the samples in motion is its mean; invalid, lost: samples.
        braked: share of samples left out because a joint braked hard: the weight alone is compensated.
    """

    time: Array
    raw: Array
    compensated: Array
    noise: Array
    moving: NDArray[np.bool_]
    braked: float
    invalid: int
    lost: int

    @property
    def rms(self) -> Array:
        """(6,) of the compensated samples."""
        return np.asarray(np.sqrt(np.mean(self.compensated**2, axis=0)))

    @property
    def ratios(self) -> dict[str, list[float]]:
        """Compensated over noise floor: of all samples, of those at held-out poses, of those in motion."""
        squares = self.compensated**2
        return {key: (np.sqrt(squares[rows].mean(axis=0)) / self.noise).tolist() for key, rows in self._parts().items()}

    @property
    def samples(self) -> dict[str, int]:
        """How many samples each of these rests on."""
        return {key: int(rows.sum()) for key, rows in self._parts().items()}

    def _parts(self) -> dict[str, NDArray[np.bool_]]:
        parts = {"all": np.ones_like(self.moving), "at_rest": ~self.moving, "moving": self.moving}
        return {key: rows for key, rows in parts.items() if rows.any()}

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
    phases: list[tuple[int, bool]] = field(default_factory=list)
    speeds: list[tuple[int, tuple[float, ...]]] = field(default_factory=list)
    invalid: int = 0
    lost: int = 0
    end: threading.Event = field(default_factory=threading.Event)

    def listen(self) -> None:
        """Until `end` is set."""
        with Subscriber(self.addresses.bus, TOPICS, queue=200_000, as_published=True) as bus:
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
            self.speeds.append((message.t_ns, tuple(message.velocity.values())))
        elif isinstance(message, CalibrationProgress):
            self.phases.append((message.t_ns, message.detail in COUNTED))


def _six(force: Vector3, torque: Vector3) -> tuple[float, ...]:
    return (force.x, force.y, force.z, torque.x, torque.y, torque.z)


def live_check(
    addresses: Addresses, tool: str, calibration: str, console: Console, noise: Array | None = None
) -> LiveCheck:
    """Move slowly across the swept range and compare every compensated sample with the noise floor.

    Args:
        tool: in hand and selected; calibration: identity that the samples must bear.
        noise: (6,) noise floor, from the many holds of the sweep; from the few of this motion if None.

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
    result = _result(ear)
    return result if noise is None or not np.isfinite(noise).all() else replace(result, noise=noise)


def _result(ear: _Ear) -> LiveCheck:
    stamps = np.array(sorted(ear.raw.keys() & ear.compensated.keys()))
    if len(stamps) < LEAST_SAMPLES:
        what = f"only {len(stamps)} compensated samples bear the calibration {ear.calibration}"
        raise HardwareError(what, where="wrench/compensated", todo="galen-hw monitor")
    stamps = stamps[_latest(ear.phases, stamps) & _latest(ear.phases, stamps + TAIL_NS)]
    braked = _braked(ear.speeds, stamps)
    stamps = stamps[~braked]
    raw = np.array([ear.raw[t] for t in stamps])
    compensated = np.array([ear.compensated[t] for t in stamps])
    still = _latest(ear.rests, stamps) & _latest(ear.rests, stamps + TAIL_NS)
    return LiveCheck(
        1e-9 * (stamps - stamps[0]),
        raw,
        compensated,
        _noise(raw, stamps, still),
        ~still,
        float(braked.mean()),
        ear.invalid,
        ear.lost,
    )


def _latest(states: list[tuple[int, bool]], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """What the last of (time, state) before each stamp says."""
    times, values = np.array([t for t, _ in states]), np.array([state for _, state in states])
    return np.asarray(values[(np.searchsorted(times, stamps) - 1).clip(0)])


def _braked(speeds: list[tuple[int, tuple[float, ...]]], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Samples near a joint acceleration that is not slow motion: the controller brakes at its own firm rate."""
    times = np.array([t for t, _ in speeds])
    velocity = np.array([v for _, v in speeds])
    steps = np.maximum(np.diff(times) * 1e-9, 1e-3)
    hard = np.flatnonzero(np.nanmax(np.abs(np.diff(velocity, axis=0)), axis=1) / steps > HARD)
    near = np.zeros(len(stamps), dtype=bool)
    for k in hard:
        near |= (stamps > times[k] - TAIL_NS) & (stamps < times[k + 1] + TAIL_NS)
    return near


def _noise(raw: Array, stamps: NDArray[np.int64], still: NDArray[np.bool_]) -> Array:
    """Sigma of one sample (6,): scatter about the mean of each rest, its first 0.15 s (the tool swings) left out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    total, freedom = np.zeros(6), 0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        start = int(np.searchsorted(stamps, stamps[first] + 150_000_000))
        hold = raw[start:last]
        if len(hold) > 50:
            total += np.sum((hold - hold.mean(axis=0)) ** 2, axis=0)
            freedom += len(hold) - 1
    return np.asarray(np.sqrt(total / max(freedom, 1)))
