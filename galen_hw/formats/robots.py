"""The robot of an imported recording: its URDF in the file or beside it, and what its joints are called there."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from galen_hw.errors import UsageError
from galen_hw.formats.contents import Contents
from galen_hw.formats.mapping import Entry, Map
from galen_hw.kinematics.urdf import MOVING, Urdf, read_urdf
from galen_hw.recording.info import URDF
from galen_hw.recording.recording import joint_column

NUMBERED: Final = "joint_"
"""Joints that a file only numbers are called so."""


def attach_robot(what: Map, texts: dict[str, str], path: Path, targets: Sequence[str]) -> list[str]:
    """Put the robot's URDF among the texts, and its name into the map's keys; what was done, for people.

    Named in the map or in recording.json; else in the file itself (`/robot_description`); else the only URDF beside it, where
    joints were recorded.

    Raises:
        UsageError: a file that is named and not there.
    """
    name, notes = what.info.get("robot"), []
    if name is None and URDF in texts:
        what.info["robot"] = URDF
        notes.append("the robot is the one that the file describes")
    elif name is None and any(joint_column(target) for target in targets):
        found = sorted(path.parent.glob("*.urdf"))
        if len(found) == 1:
            texts[found[0].name] = found[0].read_text(encoding="utf-8", errors="replace")
            what.info["robot"] = found[0].name
            notes.append(f"{found[0].name} beside it is taken as the robot")
    elif name not in (None, "galen") and name not in texts:
        places = [what.beside / str(name), path.parent / str(name)]
        file = next((place for place in places if place.is_file()), None)
        if file is None and URDF in texts:
            texts[str(name)] = texts[URDF]
            return notes
        if file is None:
            raise UsageError(
                "the robot's file is not there", where=str(places[-1]), todo="put the URDF beside the recording"
            )
        texts[file.name] = file.read_text(encoding="utf-8", errors="replace")
        what.info["robot"] = file.name
    return notes


def name_sensor(what: Map, text: str | None, contents: Sequence[Contents]) -> list[str]:
    """Take the frame of the wrench as the sensor's link, where the robot has such a link and none is named."""
    streams = {stream.name: stream.frame for one in contents for stream in one.streams}
    frame = next((streams.get(e.stream, "") for e in what.entries if e.target == "wrench.force.x"), "").lstrip("/")
    if text is None or not frame or what.info.get("sensor_link") is not None or frame not in read_urdf(text).links:
        return []
    what.info["sensor_link"] = frame
    return [f"the wrench is in the frame {frame}, which is taken as sensor_link"]


def renamed_joints(entries: list[Entry], urdf: str | None, info: dict[str, Any]) -> tuple[list[Entry], list[str]]:
    """Entries with the URDF's names for joints that the file only numbers, in the order from the base on."""
    numbers = sorted(
        {name for e in entries if (name := _numbered(e.target))}, key=lambda n: int(n.removeprefix(NUMBERED))
    )
    if urdf is None or not numbers:
        return entries, []
    robot = read_urdf(urdf)
    names = _chain(robot, info.get("sensor_link") or info.get("tip_link"))
    if set(numbers) <= set(robot.joints):
        return entries, []
    if len(numbers) > len(names):
        return entries, [f"{len(numbers)} joints beside {len(names)} of the robot: their names are not known"]
    names_of = dict(zip(numbers, names, strict=False))
    made = [replace(e, target=_renamed(e.target, names_of)) for e in entries]
    return made, [f"joints by their order: {', '.join(f'{a} is {b}' for a, b in names_of.items())}"]


def _numbered(target: str) -> str:
    joint = joint_column(target)
    number = joint[0].removeprefix(NUMBERED) if joint and joint[0].startswith(NUMBERED) else ""
    return joint[0] if joint and number.isdigit() else ""


def _renamed(target: str, names: dict[str, str]) -> str:
    joint = joint_column(target)
    return target if joint is None or joint[0] not in names else f"joint.{names[joint[0]]}.{joint[1]}"


def _chain(robot: Urdf, tip: str | None) -> list[str]:
    """Moving joints from the base to a link, or to the link that most joints bear."""
    link = tip if tip is not None and tip in robot.links else robot.longest()
    return [
        name for name in robot.carriers(link) if robot.joints[name].kind in MOVING and robot.joints[name].mimic is None
    ]
