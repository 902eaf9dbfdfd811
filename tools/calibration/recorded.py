"""A calibration from a recording: what `galen-hw calibrate --from` and the Python face both do."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from galen_hw.config.tool_file import ToolFile
from galen_hw.config.tool_store import ToolStore
from galen_hw.documents import load_json
from galen_hw.errors import UsageError
from galen_hw.identification.sense import contradictions
from galen_hw.premises import Remark
from galen_hw.recording import Recording
from galen_hw.tools.calibration.poses import poses_of
from galen_hw.tools.calibration.result import Result, Setting, analyse, tool_file, with_terms


@dataclass(frozen=True)
class Recorded:
    """What came of it.

    Args:
        result: of the fit; tool: the file that results, not saved; premises: what was said before the fit.
    """

    result: Result
    tool: ToolFile
    premises: Sequence[Remark]


def calibrate_recording(
    recording: Recording, store: ToolStore | None, name: str | None = None, *, repair: bool = True
) -> Recorded:
    """Fit a tool's weight, centre of mass and the sensor's bias to a recording.

    Args:
        recording: continuous, or static poses.
        store: of the tools whose geometry is known; None: that of the recording alone.
        name: of the tool; else the recording's own.
        repair: put right what is certain; else the same is refused.

    Raises:
        UsageError: the recording cannot be fitted, or has no name that a tool may have.
    """
    named = recording.info.tool
    name = name or _slug(named.name if named else "") or _slug(recording.path.stem)
    if not name:
        raise UsageError("no tool's name can be made of it", where=str(recording.path), todo="give one with --tool")
    if store is not None and name in store.names():
        nominal = store.nominal(name)
    else:
        nominal = ToolFile(name=name, tip=(named.tip if named and named.tip else None) or (0.0, 0.0, 0.0))
    found = poses_of(recording, repair=repair)
    result = analyse(name, found.poses, str(recording.path), found.notes)
    if named is not None:
        more = tuple(contradictions(result.estimate, named.mass, named.com))
        result = replace(result, remarks=(*result.remarks, *more))
    tool = tool_file(result, with_terms(nominal, found.terms), setting_of(recording))
    return Recorded(result, tool, found.premises)


def setting_of(recording: Recording) -> Setting:
    """Return on what a recording was made, as far as it says."""
    about = _about(recording.path)
    info = recording.info
    zeroed: Any = info.zeroed_at
    if isinstance(zeroed, tuple) and len(zeroed) != 4:
        zeroed = dict(zip(recording.joint_names, zeroed, strict=True))
    robot = str(about.get("robot") or info.robot or "")
    sweep = str(recording.path.resolve())
    return Setting(robot, info.sensor_serial, sweep, zeroed, about.get("date"), virtual=info.virtual)


def _about(folder: Path) -> dict[str, Any]:
    """`sweep.json` beside a sweep of our own."""
    try:
        found = load_json((folder / "sweep.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _slug(text: str) -> str:
    """A tool's name out of any text; empty if there is none in it."""
    return re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-_")[:40]
