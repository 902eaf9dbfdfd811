"""The table of services: the section under `services` in the configuration, and the class that it runs.

To add a service: one file with a `Service` subclass (with `Settings`, `consumes`, `produces`), one line here, and, for
a new kind of message, a struct and a row in `TOPICS`. The conformance checks then run on it.
"""

from typing import Final

SERVICES: Final[dict[str, str]] = {
    "compensation": "galen_hw.services.compensation.service:CompensationService",
    "calibration": "galen_hw.services.calibration.service:CalibrationService",
    "deflection": "galen_hw.services.deflection.service:DeflectionService",
    "admittance": "galen_hw.services.admittance:AdmittanceService",
    "health": "galen_hw.services.health.service:HealthService",
    "recorder": "galen_hw.services.recorder:RecorderService",
}
