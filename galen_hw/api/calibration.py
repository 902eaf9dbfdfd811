"""`calibrate`: a tool's weight, centre of mass and the sensor's bias out of a recording."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from galen_hw.api.given import Given, recording_of
from galen_hw.config.paths import state_dir
from galen_hw.config.tool_file import ToolFile
from galen_hw.config.tool_store import ToolStore, check_name, write_atomic
from galen_hw.extras import need
from galen_hw.spatial import Array
from galen_hw.tools.answer import stamped
from galen_hw.tools.calibration.recorded import Recorded, calibrate_recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class CalibrationResult:
    """What a calibration found. Nothing is in use because of it: `save`, then `galen-hw tool import`.

    Args:
        tool: the tool's file that results, with covariance and bias.
        mass: kg; mass_std: its standard deviation.
        com: (3,) centre of mass in the sensor frame, m; com_std: (3,) standard deviations.
        bias: (6,) constant offset of the sensor, N and N m.
        residual: (6,) rms over the fitted poses; held_out_error: (6,) rms over poses that the fit has not seen.
        candidate: the fit that is recommended; reason: why.
        remarks: what a person should know, one line each.
        date: of the recording, else when it was fitted (ISO 8601, UTC).
    """

    tool: ToolFile
    mass: float
    mass_std: float
    com: Array
    com_std: Array
    bias: Array
    residual: Array
    held_out_error: Array
    candidate: str
    reason: str
    remarks: tuple[str, ...]
    date: str
    _found: Recorded = field(repr=False, compare=False)

    def __str__(self) -> str:
        """Return the result in two lines, with standard deviations."""
        com = ", ".join(f"{1e3 * x:.2f} +- {1e3 * s:.2f}" for x, s in zip(self.com, self.com_std, strict=True))
        text = f"{self.tool.name}: {1e3 * self.mass:.2f} +- {1e3 * self.mass_std:.2f} g at ({com}) mm"
        return f"{text}\n{self.candidate}: {self.reason}"

    def to_json(self) -> dict[str, Any]:
        """Return plain values as `galen-hw calibrate --json` prints them; `json.dumps` takes them as they are."""
        from galen_hw.tools.calibration.answer import answer_of

        answer = answer_of(self._found.result, self.tool)
        return stamped(answer | {"premises": [remark.to_json() for remark in self._found.premises]}, date=self.date)

    def plot(self) -> "Figure":
        """Draw the held-out poses, raw and compensated.

        Raises:
            MissingExtraError: matplotlib is not installed.
        """
        need("reports", "plot")
        import matplotlib as mpl

        from galen_hw.tools.calibration.figures import STYLE, verification_figure

        with mpl.rc_context(STYLE):
            figure = verification_figure(self._found.result)
        _forget(figure)
        return figure

    def save(self, target: Path | str) -> Path:
        """Write the tool's file, which `galen-hw tool import` takes up.

        Raises:
            UsageError: it cannot be written.
        """
        write_atomic(Path(target), self.tool.to_json() + "\n")
        return Path(target)


def calibrate(recording: Given, *, tool: str | None = None, repair: bool = True) -> CalibrationResult:
    """Fit a tool's weight, centre of mass and the sensor's bias, and verify them on poses that were held out.

    Args:
        recording: a recording or its path: raw wrench, and joints of a known robot or the sensor's orientation; continuous
            with rests of half a second, or a row a pose.
        tool: its name, if not the recording's own; a tool of this machine's store gives its tip.
        repair: put right in memory what is certain (units, axes, clocks); else the same is refused.

    Raises:
        UsageError: the recording cannot be read or fitted: what, where, what to do.
    """
    if tool is not None:
        check_name(tool)
    found = calibrate_recording(recording_of(recording), ToolStore(state_dir()), tool, repair=repair)
    estimate, result = found.result.estimate, found.result
    assert found.tool.origin is not None
    return CalibrationResult(
        tool=found.tool,
        mass=float(estimate.mass),
        mass_std=float(estimate.std[0]),
        com=np.array(estimate.com),
        com_std=np.array(estimate.std[1:4]),
        bias=np.array(estimate.bias),
        residual=result.best.rms,
        held_out_error=result.verification.rms,
        candidate=result.comparison.recommended,
        reason=result.comparison.reason,
        remarks=result.remarks,
        date=found.tool.origin.date,
        _found=found,
    )


def _forget(figure: "Figure") -> None:
    """Have pyplot forget the figure, so that a notebook shows it once."""
    from matplotlib import pyplot as plt

    plt.close(figure)
