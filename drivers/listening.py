"""What a sensor's driver makes of frames that others exchanged: a log is listened to, nobody is asked."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.device import CanFrame

Frames: TypeAlias = Sequence[tuple[CanFrame, int]]
"""Frames of a log with their times, ns."""


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
