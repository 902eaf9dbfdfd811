"""`fit_deflection`: how the arm gives under load, as models side by side and judged on sets that none has seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.api.given import Given, recording_of
from galen_hw.config.tool_store import write_atomic
from galen_hw.errors import UsageError
from galen_hw.extras import need
from galen_hw.recording import Recording
from galen_hw.services.deflection.store import DeflectionFile
from galen_hw.tools.answer import stamped
from galen_hw.tools.deflection.data import recordings_in
from galen_hw.tools.deflection.fit import Comparison, summary
from galen_hw.tools.deflection.recorded import fit_recordings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class DeflectionResult:
    """Deflection models, judged. Nothing is in use because of it: `save`, then `galen-hw deflection import`.

    Args:
        recommended: name of the model; reason: why.
        held_out_error: rms (m) of each model on the held-out sets that decide, by name.
        tracker_noise: rms (m), three axes together.
        doubts: why the recommendation is not to be relied on, and what to record next; empty when it is.
        notes: what is odd about the recordings, one line each.
        model: the recommended model's file.
    """

    recommended: str
    reason: str
    held_out_error: dict[str, float]
    tracker_noise: float
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    model: DeflectionFile
    _comparison: Comparison = field(repr=False, compare=False)

    def __str__(self) -> str:
        """Return the recommendation and its doubts, a line each."""
        return "\n".join([f"{self.recommended}: {self.reason}", *self.doubts])

    def to_json(self) -> dict[str, Any]:
        """Return plain values as `galen-hw deflection fit --json` prints them; `json.dumps` takes them as they are."""
        return stamped(summary(self._comparison), date=self.model.date)

    def plot(self) -> "Figure":
        """Draw the held-out error of all models.

        Raises:
            MissingExtraError: matplotlib is not installed, or no set was held out.
        """
        need("reports", "plot")
        from galen_hw.tools.deflection.figures import errors_figure

        if not self._comparison.held:
            raise UsageError("no set was held out", where="plot", todo="record a second set at each of four places")
        return errors_figure(self._comparison)

    def save(self, target: Path | str) -> Path:
        """Write the recommended model's file, which `galen-hw deflection import` takes up.

        Raises:
            UsageError: it cannot be written.
        """
        write_atomic(Path(target), self.model.model_dump_json(by_alias=True, indent=1) + "\n")
        return Path(target)


def fit_deflection(
    recordings: Given | Sequence[Given],
    *,
    holdout: Sequence[str] = (),
    models: Sequence[str] = (),
    name: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> DeflectionResult:
    """Fit all deflection models to recordings of pushes, judge them on held-out sets, recommend one.

    Args:
        recordings: recordings or paths; the path of a folder stands for all recordings in it.
        holdout: names of sets to judge on; none: they are chosen.
        models: parts of the names of those to fit; none: all.
        name: of the model; the tool's if None.
        progress: told the name of each model before it is fitted.

    Raises:
        UsageError: a recording cannot be read or used, or all of them cannot show how the arm gives: what to record next.
    """
    given = [recordings] if isinstance(recordings, (Recording, Path, str)) else recordings
    found: list[Recording] = []
    for one in given:
        found += [recording_of(one)] if isinstance(one, Recording) else recordings_in([Path(one)])
    fitted = fit_recordings(found, holdout=holdout, models=models, say=progress or _silent)
    model, out = fitted.file(name), fitted.comparison
    assert out is not None
    return DeflectionResult(
        recommended=out.best,
        reason=out.reason,
        held_out_error={name: out.figure(name) for name in out.scores},
        tracker_noise=out.noise_m,
        doubts=tuple(out.doubts),
        notes=(*fitted.sets.notes, *out.notes),
        model=model,
        _comparison=out,
    )


def _silent(name: str) -> None:
    del name
