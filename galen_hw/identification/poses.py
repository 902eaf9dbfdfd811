"""The static poses of a sweep: what every fit reads."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from galen_hw.kinematics import NOMINAL_GRAVITY
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Poses:
    """Averaged readings of a sensor at rest, one row a pose, in the order in which they were measured.

    Args:
        R: (n, 3, 3) sensor to base.
        wrench: (n, 6) mean reading, N and N m.
        variance: (n, 6) of that mean, from the scatter within the pose; NaN where not known.
        time: (n,) s of each pose; None where only the order is known.
        tool: (n,) the tool was on; a sweep without it finds the bias body.
        verify: (n,) held out of the fit.
        home: (n,) a return to the home pose, for the drift.
        noise: (6,) sigma of a single sample, the sensor's noise floor; NaN where not known.
        zero: (3, 3) orientation at which the sensor was zeroed with the bias body alone; None if it was not.
        bias_body: what hung on the sensor when it was zeroed, if it is known beforehand.
        gravity: (3,) m/s^2 in the base.
    """

    R: Array
    wrench: Array
    variance: Array
    time: Array | None
    tool: Mask
    verify: Mask
    home: Mask
    noise: Array = field(default_factory=lambda: np.full(6, np.nan))
    zero: Array | None = None
    bias_body: Body | None = None
    gravity: Array = field(default_factory=NOMINAL_GRAVITY.copy)

    @classmethod
    def make(cls, R: Array, wrench: Array, *, zero: Array | None = None, bias_body: Body | None = None) -> "Poses":
        """Poses with the tool on, all for the fit, of which nothing else is known."""
        n = len(R)
        no, yes = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
        unknown = np.full((n, 6), np.nan)
        return cls(R, wrench, unknown, None, yes, no, no.copy(), zero=zero, bias_body=bias_body)

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.R)

    def select(self, rows: Mask) -> "Poses":
        """Only these rows."""
        time = None if self.time is None else self.time[rows]
        return replace(
            self,
            R=self.R[rows],
            wrench=self.wrench[rows],
            variance=self.variance[rows],
            time=time,
            tool=self.tool[rows],
            verify=self.verify[rows],
            home=self.home[rows],
        )

    @property
    def clock(self) -> Array:
        """(n,) time, or the row number where only the order is known."""
        return np.arange(len(self), dtype=float) if self.time is None else self.time

    @property
    def fit(self) -> "Poses":
        """The rows that are fitted."""
        return self.select(~self.verify)

    @property
    def held_out(self) -> "Poses":
        """The rows that are not fitted, with the tool on."""
        return self.select(self.verify & self.tool)
