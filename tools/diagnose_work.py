"""Diagnose recordings that were read: what the command and the Python face both do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from galen_hw.diagnosis.bench import Progress
from galen_hw.diagnosis.engine import Work, diagnose
from galen_hw.errors import UsageError
from galen_hw.physics.observations import Observations
from galen_hw.physics.scene import Scene
from galen_hw.physics.table import scene_of
from galen_hw.physics.together import joined
from galen_hw.recording import Recording
from galen_hw.tools.diagnose_input import named_in, observations_of
from galen_hw.tools.recorded_robot import model_notes


@dataclass(frozen=True)
class Asked:
    """How a diagnosis is made.

    Args:
        share: of blocks that are set aside to judge on, where no other recording is given for that.
        seed: of the choice of these blocks.
        repair: put right what is certain; else the same is refused.
    """

    share: float = 0.3
    seed: int = 0
    repair: bool = True


def diagnose_recordings(
    recordings: Sequence[Recording],
    judges: Sequence[Recording] = (),
    asked: Asked | None = None,
    progress: Progress | None = None,
) -> Work:
    """Diagnose one recording, or several recordings of one machine as one.

    Args:
        recordings: at least one; judges: to be judged on, none: blocks of the recordings are set aside.
        asked: how; progress: told how far the work is.

    Raises:
        UsageError: they cannot be compared, or are not of one machine.
    """
    asked = asked or Asked()
    observations, notes = _joined(recordings)
    holdout = _judged_on(judges, observations) if judges else None
    with named_in(recordings[0]):
        scene = scene_of(observations)
    if holdout is not None and holdout.channels != scene.channels:
        todo = "judge on a recording that compares the same channels"
        what = f"does not compare the channels of {recordings[0].path}"
        raise UsageError(what, where=f"--holdout {judges[0].path}", todo=todo)
    name = ", ".join(str(recording.path) for recording in recordings)
    with named_in(recordings[0]):
        work: Work = diagnose(
            scene,
            name=name,
            holdout=holdout,
            share=asked.share,
            seed=asked.seed,
            progress=progress,
            repair=asked.repair,
        )
    work.diagnosis.units = dict(zip(scene.channels, scene.units, strict=True))
    concerned = [name for remark in work.diagnosis.premises for name in remark["columns"]]
    work.diagnosis.notes[:0] = [line for line in notes if not _said_better(line, concerned)]
    if holdout is not None:
        work.diagnosis.holdout = ", ".join(str(judge.path) for judge in judges)
    return work


def _judged_on(judges: Sequence[Recording], observations: Observations) -> Scene:
    """The recordings to be judged on, with their columns in the order of the ones that are learnt from."""
    other = _joined(judges)[0]
    with named_in(judges[0]):
        order = {k: other.columns[k] for k in observations.columns if k in other.columns}
        return scene_of(replace(other, columns=order | dict(other.columns)))


def _said_better(line: str, columns: list[str]) -> bool:
    """Whether a line of the reader is about cells of which a premise has said what they are."""
    name = line.partition(":")[0].partition(",")[0].strip()
    return any(column.startswith(name) for column in columns)


def _joined(recordings: Sequence[Recording]) -> tuple[Observations, list[str]]:
    """The recordings as one, and what is odd about each."""
    _same_machine(recordings)
    names = [str(recording.path) for recording in recordings]
    each = [observations_of(recording) for recording in recordings]
    odd = [
        [*r.warnings, *model_notes(r, one.belief.robot, r.info.predict)]
        for r, one in zip(recordings, each, strict=True)
    ]
    observations, begins = joined(each, names)
    if len(recordings) == 1:
        return observations, odd[0]
    notes = [f"{name}: {line}" for name, lines in zip(names, odd, strict=True) for line in lines]
    clock = "at {:.2f} s" if observations.time is not None else "with row {:.0f}"
    return observations, [*notes, *(f"{n} begins {clock.format(b)}" for n, b in zip(names, begins, strict=True))]


def _same_machine(recordings: Sequence[Recording]) -> None:
    """That all recordings are of one machine and one model, so that one set of parameters can stand for all."""
    first = recordings[0]
    for recording in recordings[1:]:
        for key in ("robot", "tool", "predict", "model", "distal_bodies"):
            if getattr(recording.info, key) != getattr(first.info, key):
                todo = f"make {key} agree, or diagnose them one by one"
                raise UsageError(f"{key} is not that of {first.path}", where=recording.about, todo=todo)
