"""Deflection models fitted to recordings: what `galen-hw deflection fit` and the Python face both do."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from galen_hw.errors import UsageError
from galen_hw.identification.deflection.data import check
from galen_hw.identification.deflection.table import MODELS
from galen_hw.recording import Recording
from galen_hw.services.deflection.store import DeflectionFile
from galen_hw.tools.deflection.data import Sets, sets_of, split
from galen_hw.tools.deflection.fit import Comparison, compare, file_of, require_served


@dataclass(frozen=True)
class Fitted:
    """What came of it.

    Args:
        sets: that were read; remarks: what they cannot show, one line each with what to record next.
        comparison: the models; None where the remarks forbid any.
    """

    sets: Sets
    remarks: list[str]
    comparison: Comparison | None

    def file(self, name: str | None = None) -> DeflectionFile:
        """Return the recommended model's file under a name, by default the tool's.

        Raises:
            UsageError: nothing was fitted.
        """
        if self.comparison is None:
            raise UsageError("; ".join(self.remarks), where="deflection")
        first = self.sets.sets[0]
        robot = first.observations.belief.robot
        name = name or re.sub(r"[^a-z0-9_-]", "-", (first.tool or "arm").lower())
        return file_of(self.comparison, name, "" if robot is None else robot.name, virtual=self.sets.virtual)


def fit_recordings(
    recordings: Sequence[Recording],
    *,
    holdout: Sequence[str] = (),
    models: Sequence[str] = (),
    say: Callable[[str], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> Fitted:
    """Fit the models, judge them on held-out sets and recommend one.

    Args:
        recordings: of pushes, with the tracker; holdout: names of the sets to judge on, none: they are chosen.
        models: parts of the names of those to fit, none: all.
        say: told the name of each model before it is fitted; warn: told each remark at once.

    Raises:
        UsageError: no deflection recordings, sets that do not go together, no such set or model, none to recommend.
    """
    names = [n for n in MODELS if not models or any(part.lower() in n.lower() for part in models)]
    if not names:
        raise UsageError("no such model", where="--models", todo=f"parts of: {', '.join(MODELS)}")
    require_served(names)
    sets = sets_of(recordings)
    remarks = check(sets.sets)
    for line in (*sets.notes, *remarks):
        warn(line)
    if remarks and not _fit_to_be_fitted(remarks):
        return Fitted(sets, remarks, None)
    learn, held = split(sets.sets, sets.days, holdout)
    out = compare(learn, held, names, say)
    out.notes += remarks
    return Fitted(sets, remarks, out)


def _fit_to_be_fitted(remarks: list[str]) -> bool:
    """Too few configurations and forces at their limit spoil every model; the rest only leaves things unseen."""
    return not any("configuration(s)" in line or "limit" in line or "hardly any force" in line for line in remarks)
