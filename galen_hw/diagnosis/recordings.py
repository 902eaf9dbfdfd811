"""Recordings into a diagnosis: read, and joined where they are several runs of one machine."""

from collections.abc import Sequence
from dataclasses import replace

from galen_hw.config.tool_file import terms_in
from galen_hw.diagnosis.pipeline import Progress, diagnose
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.work import Work
from galen_hw.errors import UsageError
from galen_hw.physics.concatenate import joined
from galen_hw.physics.effects.registry import scene_of
from galen_hw.physics.observations import Observations
from galen_hw.recording import Recording
from galen_hw.recording.observations import named_in, observations_of
from galen_hw.recording.robot import model_notes


def diagnose_recordings(
    recordings: Sequence[Recording],
    *,
    holdout: Sequence[Recording] = (),
    share: float = 0.3,
    seed: int = 0,
    repair: bool = True,
    progress: Progress | None = None,
    names: Sequence[str] = (),
    holdout_names: Sequence[str] = (),
    time_limit: float = LIMITS.seconds,
) -> Work:
    """Diagnose one recording, or several of one machine as one.

    Args:
        recordings: at least one, all of one machine and model.
        holdout: of the same machine, to be judged on; without any `share` of contiguous blocks is held out.
        share: of the blocks, from 0 to 0.9.
        seed: of the choice of blocks.
        repair: put right in memory what is certain; else the same is refused.
        progress: told how far the work is.
        time_limit: s, after which the search for better models stops.
        names: how the recordings are called in the answer, and holdout_names: the same of what is held out; else by their paths.

    Raises:
        UsageError: a recording cannot be compared, or they are not of one machine.
    """
    paths = list(names) or [str(recording.path) for recording in recordings]
    judges = list(holdout_names) or [str(recording.path) for recording in holdout]
    observations, notes = _joined(recordings, paths)
    other = None
    if holdout:
        seen = _joined(holdout, judges)[0]
        with named_in(holdout[0]):
            order = {k: seen.columns[k] for k in observations.columns if k in seen.columns}
            other = scene_of(replace(seen, columns=order | dict(seen.columns)))
    with named_in(recordings[0]):
        scene = scene_of(observations)
    if other is not None and other.channels != scene.channels:
        todo = "judge on a recording that compares the same channels"
        raise UsageError(f"does not compare the channels of {paths[0]}", where=f"--holdout {judges[0]}", todo=todo)
    with named_in(recordings[0]):
        work: Work = diagnose(
            scene,
            name=", ".join(paths),
            holdout=other,
            share=share,
            seed=seed,
            progress=progress,
            repair=repair,
            time_limit=time_limit,
        )
    work.diagnosis.units = dict(zip(scene.channels, scene.units, strict=True))
    concerned = [name for remark in work.diagnosis.premises for name in remark["columns"]]
    work.diagnosis.notes[:0] = [line for line in notes if not _said_better(line, concerned)]
    if other is not None:
        work.diagnosis.holdout = ", ".join(judges)
    return work


def observed(recording: Recording) -> Observations:
    """Return what the effects read of a recording, with the further effects of the tool in hand.

    Raises:
        UsageError: it does not say what is compared, or its tool's file is damaged.
    """
    with named_in(recording):
        return observations_of(recording, terms_in(recording.tool_file, f"{recording.path}: tool's file"))


def _said_better(line: str, columns: list[str]) -> bool:
    """Return whether a line of the reader is about cells of which a premise has said what they are."""
    name = line.partition(":")[0].partition(",")[0].strip()
    return any(column.startswith(name) for column in columns)


def _joined(recordings: Sequence[Recording], names: list[str]) -> tuple[Observations, list[str]]:
    """Return the recordings joined to one, with notes on each."""
    _same_machine(recordings, names)
    each = [observed(recording) for recording in recordings]
    odd = [
        [*r.warnings, *model_notes(r, one.belief.robot, r.info.predict)]
        for r, one in zip(recordings, each, strict=True)
    ]
    observations, begins = joined(each, names)
    if len(names) == 1:
        return observations, odd[0]
    notes = [f"{name}: {line}" for name, lines in zip(names, odd, strict=True) for line in lines]
    clock = "at {:.2f} s" if observations.time is not None else "with row {:.0f}"
    return observations, [*notes, *(f"{n} begins {clock.format(b)}" for n, b in zip(names, begins, strict=True))]


def _same_machine(recordings: Sequence[Recording], names: list[str]) -> None:
    """Raise unless all recordings are of one machine and one model, so that one set of parameters holds for all."""
    first = recordings[0]
    for recording in recordings[1:]:
        for key in ("robot", "tool", "predict", "model", "distal_bodies"):
            if getattr(recording.info, key) != getattr(first.info, key):
                todo = f"make {key} agree, or diagnose them one by one"
                raise UsageError(f"{key} is not that of {names[0]}", where=recording.about, todo=todo)
