"""What a sensor's driver makes of frames that others exchanged: a log is listened to, nobody is asked."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.pairing import Pairer, PairLayout

Frames: TypeAlias = Sequence[tuple[CanFrame, int]]
"""Frames of a log with their times, ns."""
WINDOW_NS: Final = 5_000_000
"""From the first to the second frame of a sample at most."""
NEVER_NS: Final = 2**62
Sensor = TypeVar("Sensor")


@dataclass(frozen=True)
class Heard:
    """The samples of a log.

    Args:
        t_ns: (N,) when the second frame of each pair was logged.
        wrench: (N, 6) N and N m, raw, in the sensor frame; NaN where a sample was saturated or not valid.
        serial_number: of the sensor, empty where the log does not say; described: for people.
        lost: what was no sample, by reason.
    """

    t_ns: npt.NDArray[np.int64]
    wrench: npt.NDArray[np.float64]
    serial_number: str = ""
    described: str = ""
    lost: dict[str, int] = field(default_factory=dict)


def matrix_of(value: Any, size: int) -> npt.NDArray[np.float64] | None:
    """A (size, size) matrix of finite numbers from a document; None where it is none."""
    try:
        matrix = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return matrix if matrix.shape == (size, size) and np.isfinite(matrix).all() else None


def most_heard(frames: Frames, sensor: Callable[[CanFrame, CanFrame], Sensor | None]) -> Sensor | None:
    """Return which sensor most samples are of, each of two frames that follow each other.

    Args:
        frames: of the log, in order.
        sensor: whose sample two frames are, None: of none.
    """
    seen = Counter(
        found for (first, _), (second, _) in pairwise(frames) if (found := sensor(first, second)) is not None
    )
    return seen.most_common(1)[0][0] if seen else None


def is_first(frame: CanFrame, layout: PairLayout) -> bool:
    """Return whether a frame may be the first one of a sample."""
    return frame.arbitration_id == layout.first_id and frame.data.startswith(layout.head)


def paired(frames: Frames, layout: PairLayout) -> tuple[list[tuple[bytes, int]], dict[str, int]]:
    """Return the samples of a log, both frames' bytes and the time of the second, ns; and what was none, by reason."""
    times = np.array([t for frame, t in frames if is_first(frame, layout)], dtype=np.int64)
    period_ns = max(1, int(np.median(np.diff(times)))) if len(times) > 1 else WINDOW_NS
    counters = dict.fromkeys(("lost", "late", "doubled", "short"), 0)
    pairer = Pairer(layout, period_ns, max(1, min(WINDOW_NS, period_ns // 2)), NEVER_NS, counters)
    out = []
    for frame, t_ns in frames:
        if frame.arbitration_id == layout.first_id:
            pairer.first(frame.data, t_ns)
        elif frame.arbitration_id == layout.second_id and (pair := pairer.second(frame.data, t_ns)) is not None:
            out.append((pair, t_ns))
    return out, {
        "a sample of which one frame is missing": counters["lost"],
        "a frame that came twice": counters["doubled"],
    }
