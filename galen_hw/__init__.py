"""Hardware interface of the Galen surgical robot: drivers, calibration, compensation, deflection, diagnosis.

What a notebook or a script needs is here: `read_recording`, `calibrate`, `diagnose`, `fit_deflection`, `load_tool`,
`Client`, `Subscriber`, `virtual_robot`, the results and the errors that they give (`docs/python.md`). Each is loaded when it
is first used, so that the daemon, which imports this package too, carries none of it.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

from galen_hw import version

if TYPE_CHECKING:
    from galen_hw.api.calibration import CalibrationResult, calibrate
    from galen_hw.api.deflection import DeflectionResult, fit_deflection
    from galen_hw.api.diagnosis import DiagnosisResult, diagnose
    from galen_hw.api.live import Client, Subscriber
    from galen_hw.api.tool import load_tool
    from galen_hw.api.virtual import LiveRobot, virtual_robot
    from galen_hw.config.tool_file import ToolFile
    from galen_hw.errors import CommandRejectedError, GalenError, HardwareError, UsageError
    from galen_hw.extras import MissingExtraError
    from galen_hw.recording import Recording, RecordingInfo, read_recording, write_table

__version__ = version.VERSION

_FACE: Final = {
    "CalibrationResult": "api.calibration",
    "Client": "api.live",
    "CommandRejectedError": "errors",
    "DeflectionResult": "api.deflection",
    "DiagnosisResult": "api.diagnosis",
    "GalenError": "errors",
    "HardwareError": "errors",
    "LiveRobot": "api.virtual",
    "MissingExtraError": "extras",
    "Recording": "recording",
    "RecordingInfo": "recording",
    "Subscriber": "api.live",
    "ToolFile": "config.tool_file",
    "UsageError": "errors",
    "calibrate": "api.calibration",
    "diagnose": "api.diagnosis",
    "fit_deflection": "api.deflection",
    "load_tool": "api.tool",
    "read_recording": "recording",
    "virtual_robot": "api.virtual",
    "write_table": "recording",
}
"""Name of the face: module below `galen_hw` that holds it."""

__all__ = [
    "CalibrationResult",
    "Client",
    "CommandRejectedError",
    "DeflectionResult",
    "DiagnosisResult",
    "GalenError",
    "HardwareError",
    "LiveRobot",
    "MissingExtraError",
    "Recording",
    "RecordingInfo",
    "Subscriber",
    "ToolFile",
    "UsageError",
    "__version__",
    "calibrate",
    "diagnose",
    "fit_deflection",
    "load_tool",
    "read_recording",
    "virtual_robot",
    "write_table",
]


def __getattr__(name: str) -> Any:
    """Load a name of the face at its first use.

    Raises:
        AttributeError: there is no such name.
        MissingExtraError: a library that it needs is not installed.
    """
    if name not in _FACE:
        raise AttributeError(f"module 'galen_hw' has no attribute {name!r}")
    try:
        found = getattr(importlib.import_module(f"galen_hw.{_FACE[name]}"), name)
    except ModuleNotFoundError as error:
        from galen_hw.extras import explained

        if (missing := explained(error, f"galen_hw.{name}")) is not None:
            raise missing from None
        raise
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """List the face, for completion in a notebook."""
    return sorted({*globals(), *__all__})
