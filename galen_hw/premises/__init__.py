"""What must hold before anything is fitted: cells and clocks, units, the model, frames and signs, load and zeroing.

`PREMISES` is the table, in the order in which they are asked. To add one: a file with a class, and a line here.
"""

from functools import cache
from importlib import import_module
from typing import Final

from galen_hw.physics.observations import Observations
from galen_hw.premises.base import Action, Claim, Examination, Premise, Remark, Stage, examine
from galen_hw.premises.parts import by_runs

PREMISES: Final = (
    "cells.LostValues",
    "points.DecimalPoints",
    "blanks.BlankSamples",
    "sampling.OuterJoin",
    "unpadded.UnpaddedStamps",
    "clock.RowOrder",
    "clock.ClockUnit",
    "interleaved.InterleavedRuns",
    "cells.DoubledRows",
    "clock.ClockSteps",
    "cuts.CutMotion",
    "cells.PoseRows",
    "clock.RoundedClock",
    "dead_band.DeadBand",
    "dead_band.ReportedOnChange",
    "overflow.Overflow",
    "channels.CopiedColumns",
    "joints.WrappedJoints",
    "gaps.FilledGaps",
    "clock.ClockRate",
    "sampling.SlowReadings",
    "sampling.Staircase",
    "held_joints.HeldJoints",
    "simulated_motion.SimulatedMotion",
    "standardised.Standardised",
    "standardised.RunMeans",
    "commands.CommandedRates",
    "normalised.CommonUnit",
    "position_units.PositionUnits",
    "joints.CopiedPositions",
    "commands.CopiedCommands",
    "joints.VelocityColumns",
    "joints.SignMagnitude",
    "imu.ImuUnits",
    "units.ToolSize",
    "channels.DeadChannels",
    "channels.StuckChannels",
    "magnitudes.Magnitudes",
    "high_pass.HighPassedWrench",
    "row_match.RowMatch",
    "wrench_frames.WrenchFrames",
    "units.WrenchUnits",
    "effort_units.EffortUnits",
    "efforts.EffortGravity",
    "efforts.MissingBody",
    "efforts.MotionForces",
    "channels.JointSigns",
    "tracked_point.TrackedPoint",
    "pose_frames.PoseFrames",
    "pose_frames.TargetFrames",
    "rigid_targets.RigidTargets",
    "moved_tracker.MovedTracker",
    "pushes.PushAxes",
    "pushes.PushSigns",
    "pushes.PushUnits",
    "joint_reading.JointReading",
    "link_lengths.LinkLengths",
    "streams.ApartClocks",
    "streams.SmoothedStream",
    "load.ToolTwice",
    "weightless.WeightlessTool",
    "tool_inertia.ToolInertia",
    "load.LoadChange",
)
"""Modules and classes, in order."""


@cache
def premises() -> tuple[Premise, ...]:
    """Return one object of every class of the table."""
    found = []
    for path in PREMISES:
        module, _, name = path.rpartition(".")
        found.append(getattr(import_module(f"galen_hw.premises.{module}"), name)())
    return tuple(found)


def examined(seen: Observations, *, repair: bool = True) -> Examination:
    """Ask every premise of the table about a recording, and about its runs one by one; see `base.examine`."""

    def ask(one: Observations) -> Examination:
        return examine(one, premises(), repair=repair)

    return by_runs(seen, ask(seen), ask, {one.KEY: one.STAGE for one in premises()})


__all__ = [
    "PREMISES",
    "Action",
    "Claim",
    "Examination",
    "Observations",
    "Premise",
    "Remark",
    "Stage",
    "examined",
    "premises",
]
