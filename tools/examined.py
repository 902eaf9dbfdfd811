"""A recording after its premises were asked, for commands that fit it as a whole: what was repaired, what is refused."""

from dataclasses import dataclass, replace

from galen_hw.config.tool_file import terms_in
from galen_hw.errors import UsageError
from galen_hw.physics.observations import Group
from galen_hw.premises import Claim, Examination, examined
from galen_hw.premises.load import LoadChange
from galen_hw.recording import Recording
from galen_hw.recording.observations import observations_of
from galen_hw.spatial import Array


@dataclass(frozen=True)
class Examined:
    """What the premises made of a recording.

    Args:
        recording: with columns and gravity as repaired.
        examination: what was said.
        sensor_turn: (3, 3) by which the sensor is turned on its link, in its own axes.
    """

    recording: Recording
    examination: Examination
    sensor_turn: Array

    @property
    def notes(self) -> tuple[str, ...]:
        """Return one line for each remark that does not refuse."""
        refused = self.examination.refused
        return tuple(r.line for r in self.examination.remarks if r not in refused)

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Return what was repaired and is physics with a name."""
        return self.examination.claims


def examine_recording(recording: Recording, group: Group, *, repair: bool = True, one_load: bool = False) -> Examined:
    """Ask all premises of a recording whose `group` is about to be fitted.

    Args:
        recording: as read.
        group: that is fitted.
        repair: put right what is certain; else the same is refused.
        one_load: one tool and one zeroing are fitted to the whole of it, so that another one from some row on is refused.

    Raises:
        UsageError: a premise refuses it: what, where, what to do.
    """
    info = recording.info.model_copy(update={"predict": group})
    terms = terms_in(recording.tool_file, f"{recording.path}: tool's file")
    seen = observations_of(replace(recording, info=info), terms)
    found = examined(seen, repair=repair)
    refused = list(found.refused)
    if one_load:
        refused += [r for r in found.remarks if r.premise == LoadChange.KEY and r not in refused]
    if refused:
        first = refused[0]
        more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise UsageError(
            f"{first.what}{more}", where=str(recording.path), todo=first.todo or "put it right in the file"
        )
    belief = found.observations.belief
    gravity = tuple(float(g) for g in belief.gravity)
    columns = dict(found.observations.columns)
    repaired = replace(recording, columns=columns, info=recording.info.model_copy(update={"gravity": gravity}))
    return Examined(repaired, found, belief.sensor_turn)
