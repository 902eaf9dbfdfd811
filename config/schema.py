"""The configuration: what may stand in the TOML file, with units in the keys and bounds that catch a wrong unit.

`devices.NAME.transport`, `devices.NAME.settings` and `services.NAME` are checked by the classes that they configure.
"""

import math
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Self

from annotated_types import Len
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from galen_hw.config.paths import VIEWERS_ADDRESS
from galen_hw.units import STANDARD_GRAVITY

Metres = Annotated[float, Field(ge=-2.0, le=2.0)]
"""A length of this robot's size; millimetres by mistake are out of bounds."""
Vector = tuple[Metres, Metres, Metres]


def _within_a_turn(value: float) -> float:
    if abs(value) > 2.0 * math.pi:
        raise ValueError(f"{value:g} rad is more than a turn: is it in degrees?")
    return value


Radians = Annotated[float, AfterValidator(_within_a_turn)]
"""An angle of at most one turn; what is beyond is degrees by mistake."""
LARGEST_PORT = 65535
NAME_PATTERN = r"^[a-z][a-z0-9_]*$"


class Section(BaseModel):
    """A table of the file: unknown keys are errors, values never change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DeltaSection(Section):
    """The linear delta; defaults are the nominal Galen.

    Args:
        rod_length_m: between the joints of a carriage and of the platform.
        radius_m: of the circle of the rails, less that of the platform's joints.
        azimuths_rad: of the three rails about the base's z axis.
    """

    rod_length_m: float = Field(default=0.400, gt=0.0, le=2.0)
    radius_m: float = Field(default=0.150, gt=0.0, le=2.0)
    azimuths_rad: tuple[Radians, Radians, Radians] = (1.5707963267948966, 3.6651914291880923, 5.759586531581287)

    @model_validator(mode="after")
    def _rods_reach(self) -> Self:
        if self.radius_m >= self.rod_length_m:
            raise ValueError("radius_m must be less than rod_length_m, or the rods cannot reach the platform")
        return self


class RobotSection(Section):
    """The robot that carries the sensor: the Galen's geometry, or a URDF file.

    Args:
        name: that messages bear.
        urdf: file of another robot, instead of the Galen.
        sensor_link: of the URDF, whose frame is the sensor's.
        base_link: of the URDF, whose frame is the base's; its root if left out.
        gravity_m_per_s2: in the base frame.
        delta: a table of its own, below.
        platform_to_roll_m: from the platform's frame to the roll axis, in the platform's axes.
        roll_to_tilt_m: from the roll axis to the tilt axis, both at 0.
        tilt_to_sensor_m: from the tilt axis to the sensor's origin, at 0.
        carriage_lower_m, carriage_upper_m: travel of the three carriages.
        roll_limits_rad, tilt_limits_rad: lowest and highest angle.
    """

    name: str = Field(default="galen", pattern=NAME_PATTERN)
    urdf: Path | None = Field(default=None, examples=["/etc/galen-hw/robot.urdf"])
    sensor_link: str | None = Field(default=None, examples=["ft_sensor"])
    base_link: str | None = Field(default=None, examples=["base_link"])
    gravity_m_per_s2: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    delta: DeltaSection = DeltaSection()
    platform_to_roll_m: Vector = (0.0, 0.0, 0.045)
    roll_to_tilt_m: Vector = (0.210, 0.0, 0.035)
    tilt_to_sensor_m: Vector = (0.055, 0.0, 0.0)
    carriage_lower_m: Vector = (-0.233, -0.272, -0.237)
    carriage_upper_m: Vector = (0.263, 0.241, 0.254)
    roll_limits_rad: tuple[Radians, Radians] = (-1.57, 1.57)
    tilt_limits_rad: tuple[Radians, Radians] = (-1.04, 0.96)

    @field_validator("gravity_m_per_s2")
    @classmethod
    def _earthly(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        size = sum(x * x for x in value) ** 0.5
        if not 9.7 <= size <= 9.9:
            raise ValueError(f"gravity of {size:.4g} m/s^2 is not the earth's (9.76 to 9.84)")
        return value

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        pairs = [
            *zip(self.carriage_lower_m, self.carriage_upper_m, strict=True),
            self.roll_limits_rad,
            self.tilt_limits_rad,
        ]
        if any(low >= high for low, high in pairs):
            raise ValueError("each lower limit must be below its upper limit")
        if self.urdf is None and (self.sensor_link or self.base_link):
            raise ValueError("sensor_link and base_link belong to a URDF: give urdf too")
        return self


class DeviceSection(Section):
    """One device: its driver, its wire, and the driver's own settings.

    Args:
        driver: of the table of drivers.
        optional: the daemon is ready without it.
        transport: keys of its wire, below.
        settings: keys of its driver, below.
    """

    driver: str = Field(examples=["ati_netcanoem"])
    optional: bool = False
    transport: dict[str, Any] = Field(default={}, examples=[{"interface": "socketcan", "channel": "can0"}])
    settings: dict[str, Any] = {}


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


_FROM_HERE = (
    "viewers may connect from this machine only (tcp://127.0.0.1:PORT; use ssh -L from afar, "
    "or give keys: galen-hw keys)"
)


class BusSection(Section):
    """Addresses beside the runtime directory's own.

    Args:
        keys: folder of the viewers' keys, without which none may connect; viewers may then be on other machines.
        viewers: address of the copy of the bus for viewers; port 0: any free one; empty: none.
        queue_messages: kept for a slow subscriber before it loses messages.
    """

    keys: Path | None = Field(default=None, examples=["/etc/galen-hw/keys"])
    viewers: str = Field(default=VIEWERS_ADDRESS, examples=[VIEWERS_ADDRESS])
    queue_messages: int = Field(default=5000, ge=10, le=1_000_000)

    @field_validator("viewers")
    @classmethod
    def _address(cls, value: str, others: ValidationInfo) -> str:
        host, _, port = value.removeprefix("tcp://").rpartition(":")
        from_here = _is_loopback(host.strip("[]")) or others.data.get("keys") is not None
        if value and not (value.startswith("tcp://") and from_here):
            raise ValueError(_FROM_HERE)
        if value and not (port.isascii() and port.isdigit() and int(port[:6]) <= LARGEST_PORT):
            raise ValueError(f"{port!r} is no port: 1 to {LARGEST_PORT}, or 0 for any free one")
        return value


class DaemonSection(Section):
    """The process tree.

    Args:
        start_timeout_s: all devices but optional ones must answer within.
        optional_wait_s: "ready" waits so long for an optional device that says nothing.
        command_timeout_s: a command that nobody answers ends with an error after.
        realtime_priority: SCHED_FIFO of the core (motion: 5 less) where permitted; 0 for none.
        blind_after_s: silence of the sensor, or of the core process, that stops the arm.
        garbage_interval_s: Python's garbage is collected so often, between samples.
    """

    start_timeout_s: float = Field(default=20.0, gt=0.0, le=600.0)
    optional_wait_s: float = Field(default=5.0, ge=0.0, le=600.0)
    command_timeout_s: float = Field(default=30.0, gt=0.0, le=600.0)
    realtime_priority: int = Field(default=20, ge=0, le=80)
    blind_after_s: float = Field(default=0.08, ge=0.06, le=5.0)
    garbage_interval_s: float = Field(default=10.0, gt=0.0, le=3600.0)


class Config(Section):
    """The whole file."""

    robot: RobotSection = RobotSection()
    devices: Annotated[dict[str, DeviceSection], Len(1)] = Field(examples=["[devices.ft] with driver and transport"])
    services: dict[str, dict[str, Any]] = {}
    bus: BusSection = BusSection()
    daemon: DaemonSection = DaemonSection()
