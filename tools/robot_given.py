"""`--robot` and `--sensor-link`: the robot that a person names for a recording, in place of what the recording names."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.errors import UsageError

if TYPE_CHECKING:
    from galen_hw.kinematics.xacro import RobotFile
    from galen_hw.recording import Recording


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Options that name a robot."""
    text = "URDF or xacro of the robot, or galen, in place of what the recording names (xacro: extra xacro)"
    parser.add_argument("--robot", metavar="FILE", type=Path, help=text)
    parser.add_argument(
        "--xacro-arg", metavar="KEY:=VALUE", action="append", default=[], help="of --robot; may be given several times"
    )
    parser.add_argument("--sensor-link", metavar="LINK", help="of the robot, that bears the sensor")


def robot_given(args: argparse.Namespace) -> "RobotFile | None":
    """Return the robot that the options name, a xacro expanded.

    Raises:
        UsageError: it cannot be read; or arguments without a robot.
    """
    if args.robot is None:
        if args.xacro_arg:
            raise UsageError("of which robot?", where="--xacro-arg", todo="add --robot FILE.xacro")
        return None
    from galen_hw.kinematics.xacro import robot_file

    return robot_file(args.robot, args.xacro_arg)


def keys_given(args: argparse.Namespace) -> dict[str, Any]:
    """Return the keys of recording.json that the options give."""
    given = {"sensor_link": args.sensor_link, "predict": getattr(args, "predict", None)}
    return {key: value for key, value in given.items() if value is not None}


def with_keys(recording: "Recording", args: argparse.Namespace, robot: "RobotFile | None") -> "Recording":
    """Return a recording with what the options of `import` say of it."""
    given = keys_given(args)
    made = replace(recording, info=recording.info.model_copy(update=given)) if given else recording
    return made if robot is None else made.with_robot(robot.name, robot.text)
