"""Settings of the health service."""

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class HealthSettings(BaseModel):
    """When an alarm comes, and when it goes: each pair is a hysteresis.

    Args:
        felt_force_n, felt_torque_nm: of the compensated wrench at rest, what a hand feels: the dead band of the control.
        advise_share, clear_share: of what is felt; a tare is advised from the first on, until it is below the second.
        ahead_s: a drift is said when it would be felt within so long; until it would take twice as long.
        noise_ratio, noise_clear_ratio: noise over that of the calibration.
        lost_share: of the samples of a topic that were lost on the way.
        bus_load_share, bus_load_clear_share: of what the bus can carry.
        late_s, late_clear_s: age of a compensated wrench when it is published, 99th percentile.
        disk_free_mb, disk_clear_mb: below which the disk is said to be full.
        machine_c, machine_clear_c: hottest sensor of the machine, degrees Celsius.
        old_calibration_days: after which a new calibration is advised; 0 for never.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    felt_force_n: float = Field(default=0.3, gt=0.0, le=20.0)
    felt_torque_nm: float = Field(default=0.02, gt=0.0, le=5.0)
    advise_share: float = Field(default=0.5, gt=0.0, le=1.0)
    clear_share: float = Field(default=0.3, gt=0.0, le=1.0)
    ahead_s: float = Field(default=600.0, gt=0.0, le=86400.0)
    noise_ratio: float = Field(default=3.0, gt=1.0, le=1000.0)
    noise_clear_ratio: float = Field(default=2.0, gt=0.0, le=1000.0)
    lost_share: float = Field(default=0.001, gt=0.0, le=1.0)
    bus_load_share: float = Field(default=0.85, gt=0.0, le=1.0)
    bus_load_clear_share: float = Field(default=0.75, gt=0.0, le=1.0)
    late_s: float = Field(default=0.02, gt=0.0, le=1.0)
    late_clear_s: float = Field(default=0.01, gt=0.0, le=1.0)
    disk_free_mb: float = Field(default=500.0, ge=0.0, le=1e9)
    disk_clear_mb: float = Field(default=1000.0, ge=0.0, le=1e9)
    machine_c: float = Field(default=95.0, gt=0.0, le=150.0)
    machine_clear_c: float = Field(default=85.0, gt=0.0, le=150.0)
    old_calibration_days: float = Field(default=90.0, ge=0.0, le=36500.0)

    @model_validator(mode="after")
    def _apart(self) -> Self:
        falling = (
            ("advise_share", "clear_share"),
            ("noise_ratio", "noise_clear_ratio"),
            ("bus_load_share", "bus_load_clear_share"),
            ("late_s", "late_clear_s"),
            ("disk_clear_mb", "disk_free_mb"),
            ("machine_c", "machine_clear_c"),
        )
        for high, low in falling:
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low} must not be above {high}, or the alarm would come and go")
        return self
