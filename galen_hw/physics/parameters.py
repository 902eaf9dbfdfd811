"""What the compensation of one tool needs to know, whoever found it out."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from galen_hw.kinematics import NOMINAL_GRAVITY
from galen_hw.physics.rigid import Body
from galen_hw.spatial import Array


@dataclass(frozen=True)
class CompensationParameters:
    """One tool with one accepted calibration (`ToolStore` makes it from the tool's file).

    Args:
        tool: name of the tool.
        calibration: identity of the calibration (generation and hash), travels in every message.
        mass: kg; com: (3,) m in the sensor frame; inertia: (3, 3) kg m^2 about the centre of mass.
        bias: (6,) constant offset of the sensor, N and N m.
        bias_body: what hangs on the sensor with no tool.
        zeroed_q: joint positions at which the sensor was zeroed; None if it was not, or see `zeroed_rotation`.
        zeroed_rotation: (3, 3) sensor orientation at which it was zeroed; goes before `zeroed_q`.
        gravity: (3,) m/s^2 in the base frame.
        tip, contact: (3,) m in the sensor frame; the contact is the tip unless the user set another point.
        terms: extra physical effects as they stand in the tool's file, for `build_streams`.
        sensor_serial: the calibration belongs to this sensor; empty when not known.
    """

    tool: str = ""
    calibration: str = ""
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    bias: Array = field(default_factory=lambda: np.zeros(6))
    bias_body: Body = field(default_factory=Body)
    zeroed_q: tuple[float, ...] | None = None
    zeroed_rotation: Array | None = None
    gravity: Array = field(default_factory=NOMINAL_GRAVITY.copy)
    tip: Array = field(default_factory=lambda: np.zeros(3))
    contact: Array | None = None
    terms: tuple[Any, ...] = ()
    sensor_serial: str = ""

    @property
    def body(self) -> Body:
        """The tool as a body."""
        return Body(self.mass, self.com, self.inertia)
