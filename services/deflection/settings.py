"""What can be set about the deflection service."""

from pydantic import BaseModel, ConfigDict, Field


class DeflectionSettings(BaseModel):
    """Settings of the deflection service; seconds.

    Args:
        enabled: correct from the start.
        model: name of the saved model; empty for the one that `galen-hw deflection select` chose.
        max_joints_age_s: joint states older than this make the corrected pose not valid.
        max_gap_s: wrenches missed for longer are a gap: the memory is kept, the covariance grown.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = True
    model: str = Field(default="", max_length=40)
    max_joints_age_s: float = Field(default=0.08, gt=0.0, le=1.0)
    max_gap_s: float = Field(default=0.1, gt=0.0, le=60.0)
