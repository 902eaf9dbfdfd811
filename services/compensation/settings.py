"""What can be set about the compensation."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class CompensationSettings(BaseModel):
    """Settings of the compensation; seconds and counts.

    Args:
        enabled: compensate from the start on.
        alignment: "extrapolate" answers at once, with the joints carried on by their velocity; "interpolate" waits for
            the next joint state: exact, but late by up to its period.
        max_extrapolation_s: joint states older than this make the wrench not valid.
        dynamic: predict inertial forces too, from accelerations.
        dynamic_window: joint states that an acceleration is taken from.
        blend_s: a change of tool, tare or toggle takes this long.
        tare_samples: averaged by a tare.
        tare_timeout_s: a tare that has not got them by then is refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = True
    alignment: Literal["extrapolate", "interpolate"] = "extrapolate"
    max_extrapolation_s: float = Field(default=0.08, gt=0.0, le=1.0)
    dynamic: bool = False
    dynamic_window: int = Field(default=5, ge=3, le=25)
    blend_s: float = Field(default=0.3, ge=0.0, le=10.0)
    tare_samples: int = Field(default=200, ge=1, le=10_000)
    tare_timeout_s: float = Field(default=2.0, gt=0.0, le=60.0)
