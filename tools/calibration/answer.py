"""A calibration as plain values."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from galen_hw.config.tool_file import ToolFile
from galen_hw.tools.calibration.result import Result

if TYPE_CHECKING:
    from galen_hw.tools.calibration.check import LiveCheck


def answer_of(
    result: Result,
    tool: ToolFile,
    check: "LiveCheck | None" = None,
    page: Path | None = None,
    *,
    accepted: bool = False,
) -> dict[str, Any]:
    """Return the result for machines, SI units: what `galen-hw calibrate --json` prints."""
    data = tool.model_dump(by_alias=True, exclude_none=True, mode="json")
    candidates = [
        {
            "key": c.key,
            "title": c.title,
            "unknowns": c.unknowns,
            "mass": c.mass,
            "com": list(map(float, c.com)),
            "residual": c.rms.tolist(),
            "left_out": c.left_out_rms.tolist(),
            "bic": c.bic,
            "p_value": c.p_value if c.p_value == c.p_value else None,
        }
        for c in result.comparison.candidates
    ]
    live = None
    if check is not None:
        live = {
            "rms": check.rms.tolist(),
            "noise_floor": check.noise.tolist(),
            "ratio": check.ratios,
            "samples": check.samples,
            "left_out_braking": check.braked,
            "passed": check.passed,
        }
    return {
        "accepted": accepted,
        "tool": data,
        "recommended": result.comparison.recommended,
        "reason": result.comparison.reason,
        "interval95": (result.estimate.t95 * result.estimate.std[:4]).tolist(),
        "residual": result.best.rms.tolist(),
        "candidates": candidates,
        "remarks": list(result.remarks),
        "check": live,
        "report": None if page is None else str(page),
    }
