"""`galen-hw check RECORDING`: what the premises say of a recording, before anything is fitted to it."""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from galen_hw.errors import GalenError, UsageError
from galen_hw.formats.remote import Place, at_hand, place, recordings_in
from galen_hw.tools.answer import print_stamped
from galen_hw.tools.robot_given import keys_given, robot_given

if TYPE_CHECKING:
    from galen_hw.kinematics.xacro import RobotFile
    from galen_hw.premises import Observations, Remark
    from galen_hw.recording import Recording


def check_recordings(args: argparse.Namespace) -> int:
    """Ask all premises of each recording, or of each in a folder of them; print what they say.

    Returns:
        0 if nothing forbids a fit, 1 if a premise refuses a recording, 2 if one cannot be read.
    """
    answers, status, robot = [], 0, robot_given(args)
    for path in [inside for given in args.recordings for inside in recordings_in(place(given))]:
        try:
            answer = _asked(path, robot, keys_given(args))
        except GalenError as error:
            print(f"galen-hw check: {error}", file=sys.stderr)
            status = 2
            continue
        answers.append(answer)
        status = max(status, int(any(p["action"] == "refused" for p in answer["premises"])))
        if not args.json:
            print("\n".join(_lines(answer)))
    if args.json:
        print_stamped({"recordings": answers})
    return status


def _asked(where: Place, robot: "RobotFile | None", info: dict[str, Any]) -> dict[str, Any]:
    """What is said of one recording.

    Raises:
        GalenError: it cannot be read.
    """
    from galen_hw.formats import read
    from galen_hw.premises import examined
    from galen_hw.recording.observations import named_in, observations_of
    from galen_hw.tools.progress import working

    with working(f"reading {where.name}") as progress, at_hand([where]) as (path,):
        recording = read(path, robot=robot, info=info)
        progress(f"examining {where.name}", 0.5)
        with named_in(recording):
            seen = observations_of(recording)
            found = examined(seen)
        remarks = _with_model(found.remarks, _of_model(recording, seen))
    return {
        "recording": str(where),
        "predict": seen.predict,
        "rows": len(seen),
        "premises": [r.to_json() for r in remarks],
        "lines": [r.line for r in remarks],
    }


def _of_model(recording: "Recording", seen: "Observations") -> list["Remark"]:
    """What is said of the robot's model."""
    from galen_hw.premises import Action, Remark
    from galen_hw.recording.robot import model_notes

    try:
        return [Remark("model", line) for line in model_notes(recording, seen.belief.robot, seen.predict)]
    except UsageError as error:
        return [Remark("model", f"{error.where}: {error.what}", error.todo, (), Action.REFUSED)]


def _with_model(remarks: Sequence["Remark"], model: list["Remark"]) -> list["Remark"]:
    """All remarks in the order of their stages; a model that is refused silences what is only its consequence."""
    from galen_hw.premises import Action, Stage, premises

    early = {p.KEY for p in premises() if p.STAGE in (Stage.CELLS, Stage.UNITS)}
    before = [r for r in remarks if r.premise in early]
    if any(r.action is Action.REFUSED for r in before):
        return before
    later = [r for r in remarks if r.premise not in early]
    return [*before, *model, *([] if any(r.action is Action.REFUSED for r in model) else later)]


def _lines(answer: dict[str, Any]) -> list[str]:
    head = f"{answer['recording']}: {answer['rows']} rows, {answer['predict']} compared"
    each = zip(answer["premises"], answer["lines"], strict=True)
    said = [f"  {p['action']:9} {line.removesuffix('; repaired')}" for p, line in each]
    right = all(p["action"] == "note" for p in answer["premises"])
    return [head, *said, *(["  ok        nothing that was looked for is wrong with it"] if right else [])]
