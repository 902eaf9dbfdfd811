"""`diagnose`: what did the model leave out? As the command, without files and without a screen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.api.given import Given, recordings_of
from galen_hw.api.tool import Tool, load_tool
from galen_hw.diagnosis.recordings import diagnose_recordings
from galen_hw.diagnosis.report.summary import summary
from galen_hw.diagnosis.result import Diagnosis, Finding, Verdict
from galen_hw.diagnosis.settings import LIMITS
from galen_hw.diagnosis.work import Work
from galen_hw.errors import UsageError
from galen_hw.extras import need
from galen_hw.recording import Recording
from galen_hw.tools.answer import stamped
from galen_hw.tools.diagnose_tool import model_to_save, with_tool

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class DiagnosisResult:
    """What a diagnosis found.

    Args:
        recording: what was diagnosed; holdout: what it was judged on.
        verdict: "agrees", "explained", "partly_explained" or "unexplained".
        findings: one effect each, with its `parameters` (SI, with standard deviations) and its `evidence`.
        fit: held-out error of each channel before and after, and its noise floor, SI.
        next_experiment: what to record next, one sentence.
        notes: what is odd about the recording, one line each.
        seed: of the blocks that were set aside; date: when it was made (ISO 8601, UTC).
    """

    recording: str
    holdout: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    fit: dict[str, dict[str, float]]
    next_experiment: str
    notes: tuple[str, ...]
    seed: int
    date: str
    _work: Work = field(repr=False, compare=False)
    _recording: Recording = field(repr=False, compare=False)

    def __str__(self) -> str:
        """Return the summary that the command prints, a line each."""
        return summary(self._work.diagnosis)

    def to_json(self) -> dict[str, Any]:
        """Return plain values as `galen-hw diagnose --json` prints them; `json.dumps` takes them as they are."""
        return stamped(self._work.diagnosis.to_json(), seed=self.seed, date=self.date)

    def plot(self) -> "Figure":
        """Draw the residual of each channel over time, before and after the effects found.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        need("reports", "plot")
        from galen_hw.api.residuals import residual_figure
        from galen_hw.diagnosis.report.collect import traces_of

        return residual_figure(traces_of(self._work))

    def write_report(self, page: Path | str) -> Path:
        """Write the page with all figures, one self-contained HTML file.

        Raises:
            MissingExtraError: matplotlib or Jinja2 is not installed.
            UsageError: the file cannot be written.
        """
        need("reports", "write_report")
        from galen_hw.diagnosis.report.collect import traces_of
        from galen_hw.diagnosis.report.page import write_page

        path = Path(page)
        try:
            write_page(path, self._work.diagnosis, traces_of(self._work))
        except OSError as error:
            raise UsageError(f"cannot be written ({error.strerror})", where=str(path)) from error
        return path

    def save_model(self, target: Path | str) -> tuple[str, ...]:
        """Write the model found, for `galen-hw tool import`; what was written and what was left out, one line each.

        Raises:
            UsageError: the file cannot be written.
        """
        from galen_hw.config.tool_store import write_atomic

        saved = model_to_save(self._work, self._recording, Path(target))
        if saved.text:
            write_atomic(Path(target), saved.text)
        return saved.lines


def diagnose(
    recording: Given | Sequence[Given],
    *,
    simulation: Given | None = None,
    holdout: float | Given | Sequence[Given] = 0.3,
    tool: Tool | None = None,
    seed: int = 0,
    repair: bool = True,
    progress: Callable[[str, float], None] | None = None,
    time_limit: float = LIMITS.seconds,
) -> DiagnosisResult:
    """Locate, name, model and judge what a model left out of a recording.

    Args:
        recording: a recording or its path; several are fitted as one: the same machine, several runs.
        simulation: a recording that someone else simulated, to be compared instead of the program's own model.
        holdout: the share of contiguous blocks to set aside and judge on, or other recordings.
        tool: the tool in hand, if not as recorded.
        seed: of the blocks that are set aside.
        repair: put right in memory what is certain (units, axes, clocks); else the same is refused.
        progress: told the stage and its share (0 to 1) of the whole.
        time_limit: s, after which the search for better models stops and the best so far is judged; `math.inf`: never.

    Raises:
        UsageError: a recording cannot be read or compared: what, where, what to do.
    """
    held = None if tool is None else load_tool(tool)

    def prepared(given: Given | Sequence[Given]) -> list[Recording]:
        found = recordings_of(given)
        return found if held is None else [with_tool(one, held) for one in found]

    recordings = prepared(recording)
    if not recordings:
        raise UsageError("no recording is given", where="diagnose", todo="give one, or its path")
    if simulation is not None:
        from galen_hw.recording import beside

        (simulated,) = recordings_of(simulation)
        recordings = [beside(one, simulated) for one in recordings]
    share, judges = (float(holdout), []) if isinstance(holdout, (int, float)) else (0.0, prepared(holdout))
    if not 0.0 <= share < 0.9:
        raise UsageError(f"{share:g} is no share", where="holdout", todo="give a number from 0 to 0.9, or recordings")
    if not time_limit > 0.0:
        raise UsageError(f"{time_limit:g} s is no time", where="time_limit", todo="give seconds above 0, or math.inf")
    work = diagnose_recordings(
        recordings, holdout=judges, share=share, seed=seed, repair=repair, progress=progress, time_limit=time_limit
    )
    return _result(work, recordings[0], seed)


def _result(work: Work, recording: Recording, seed: int) -> DiagnosisResult:
    answer: Diagnosis = work.diagnosis
    return DiagnosisResult(
        recording=answer.recording,
        holdout=answer.holdout,
        verdict=answer.verdict,
        findings=tuple(answer.findings),
        fit=answer.fit,
        next_experiment=answer.next_experiment,
        notes=tuple(answer.notes),
        seed=seed,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        _work=work,
        _recording=recording,
    )
