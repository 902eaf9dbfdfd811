"""What the words of `galen-hw calibrate` ask of a virtual robot, tried before the robot is started, which takes ten seconds."""

import argparse
import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.config.paths import state_dir
from galen_hw.config.robot import build_robot
from galen_hw.config.tool_store import ToolStore
from galen_hw.daemon.tables import read_setup
from galen_hw.drivers.virtual.truth import tool_named
from galen_hw.errors import GalenError, UsageError
from galen_hw.identification.excitation import require_excitation
from galen_hw.services.calibration.plan import make_plan
from galen_hw.services.calibration.settings import CalibrationSettings, overridden

if TYPE_CHECKING:
    from galen_hw.kinematics import Robot
    from galen_hw.services.calibration.plan import Plan

OPTIONS: Final = {"counts": "--poses", "samples": "--samples", "seed": "--seed"}
"""Arguments of a sweep, and where a person gives them."""


def overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of the sweep that differ from its settings.

    Raises:
        UsageError: `--poses` are no counts.
    """
    found: dict[str, Any] = {}
    if args.poses is not None:
        if not re.fullmatch(r"\d{1,4}(x\d{1,4})*", args.poses):
            raise UsageError(f"{args.poses!r} is not TILTSxROLLS", where="--poses", todo="e.g. --poses 7x8")
        # Only the counts: which joints are swept, and how far, is the daemon's to say.
        found["counts"] = [int(count) for count in args.poses.split("x")]
    found |= {key: getattr(args, key) for key in ("samples", "seed") if getattr(args, key) is not None}
    return found | ({"bare_poses": 0} if args.no_bare else {})


def check_virtual(args: argparse.Namespace) -> None:
    """See that the tool is there and that the sweep can be made and fitted.

    Raises:
        UsageError: one of them is not so; or bad settings.
    """
    ToolStore(state_dir(), virtual=True).load(args.tool)
    tool_named(args.tool)
    setup = read_setup(args.config)
    service = setup.services.get("calibration")
    if service is None:
        return
    assert isinstance(service.settings, CalibrationSettings)
    robot = build_robot(setup.config)
    try:
        plan = make_plan(overridden(service.settings, overrides(args)), robot)
    except GalenError as error:
        raise UsageError(error.what, where=OPTIONS.get(error.where, error.where), todo=error.todo) from error
    require_excitation(_orientations(plan, robot), robot.gravity, f"--poses {args.poses}" if args.poses else "sweep")


def _orientations(plan: "Plan", robot: "Robot") -> "np.ndarray[tuple[int, ...], np.dtype[np.float64]]":
    """(n, 3, 3) of the sensor at the poses that are fitted."""
    fitted = [step.target for step in plan.tool if step.kind in ("fit", "home")]
    q = np.array([[target[name] for name in robot.joint_names] for target in fitted])
    return robot.sensor_pose(q)[:, :3, :3]
