"""Robots: where the sensor is, how it moves, and what the rigid body says the joints must bear.

Arrays are batches: `q`, `dq`, `ddq` are (N, n) in the order of `joint_names`, rad or m and their rates.
"""

from galen_hw.kinematics.delta import LinearDelta
from galen_hw.kinematics.dynamics import UrdfRobot
from galen_hw.kinematics.galen import GALEN_JOINTS, GalenRobot
from galen_hw.kinematics.motion import NOMINAL_GRAVITY, Motion

__all__ = ["GALEN_JOINTS", "NOMINAL_GRAVITY", "GalenRobot", "LinearDelta", "Motion", "Robot", "UrdfRobot"]

Robot = GalenRobot | UrdfRobot
"""Either kind: both have joint_names, lower, upper, gravity, chain, link_pose, sensor_pose, sensor_jacobian and
sensor_motion."""
