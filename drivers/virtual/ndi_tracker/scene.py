"""What the camera sees: markers on the tool and on the base, frame by frame, with noise and what goes wrong."""

from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from galen_hw.clock import NS_PER_S
from galen_hw.drivers.virtual.faults import parse_fault
from galen_hw.spatial import Array, rotation_exp, transform

Triple = tuple[float, float, float]
TOOL: Final = 0
REFERENCE: Final = 1


class SceneWorld(Protocol):
    """What the tracker needs of the world."""

    faults: set[str]

    def tip_pose(self, t_ns: int) -> Array:
        """(4, 4) true pose of the tool's tip in the base."""
        ...


class Placement(BaseModel):
    """A fixed pose: position in m, rotation vector in rad."""

    model_config = ConfigDict(extra="forbid")
    position_m: Triple = (0.0, 0.0, 0.0)
    rotation_rad: Triple = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Array:
        """(4, 4)."""
        return transform(rotation_exp(self.rotation_rad), self.position_m)


class SceneSettings(BaseModel):
    """Where camera and markers are, and how well the camera sees.

    Args:
        registration: base in the camera's frame (the camera looks along its own -z).
        tool_marker: in the frame of the tip; reference_marker: in the base.
        noise_m: one sigma, each axis; noise_rad: one sigma, each axis.
        latency_s: from exposure to the reply that carries the frame.
        moved_by: what a moved reference, camera or marker has moved by.
    """

    model_config = ConfigDict(extra="forbid")
    registration: Placement = Placement(position_m=(-0.08, 0.06, -1.72), rotation_rad=(-1.45, 0.12, 0.31))
    tool_marker: Placement = Placement(position_m=(0.012, -0.031, 0.094), rotation_rad=(0.2, -0.35, 0.6))
    reference_marker: Placement = Placement(position_m=(0.11, -0.19, -0.04), rotation_rad=(-0.1, 0.15, 1.2))
    moved_by: Placement = Placement(position_m=(0.004, -0.003, 0.002), rotation_rad=(0.01, 0.02, -0.015))
    noise_m: float = Field(default=7e-5, ge=0.0)
    noise_rad: float = Field(default=3e-4, ge=0.0)
    frame_rate_hz: float = Field(default=60.0, gt=0.0)
    latency_s: float = Field(default=0.018, ge=0.0)
    seed: int = 0


class Seen(NamedTuple):
    """One marker in one frame: pose in the camera's frame (None: missing), and whether outside of the volume."""

    pose: Array | None
    error_mm: float
    outside: bool
    partly: bool


@dataclass(slots=True)
class Scene:
    """Frames at a constant rate.

    Args:
        settings: see `SceneSettings`; world: whose tip moves, and whose faults strike.
    """

    settings: SceneSettings
    world: SceneWorld
    origin_ns: int = 0

    FAULTS: ClassVar[dict[str, str]] = {
        "tracker.missing": "the tool's marker is not seen",
        "tracker.missing_reference": "the reference marker is not seen",
        "tracker.moved_reference": "somebody moved the reference marker",
        "tracker.moved_camera": "somebody moved the camera",
        "tracker.moved_marker": "the tool's marker slipped on the tool",
        "tracker.swapped": "the two handles are swapped",
        "tracker.dropped": "frames are not taken: each, or @N each N-th",
        "tracker.repeated": "frames carry the pose of the one before: each, or @N",
        "tracker.outside": "the tool is outside of the measurement volume",
        "tracker.partly": "the tool is partly outside of the measurement volume",
    }

    def latest(self, now_ns: int) -> int:
        """Number of the newest frame that a reply can carry now; below 0 before the first."""
        period = NS_PER_S / self.settings.frame_rate_hz
        frame = int((now_ns - self.origin_ns - self.settings.latency_s * NS_PER_S) // period)
        while frame > 0 and self._strikes("tracker.dropped", frame):
            frame -= 1
        return frame

    def exposure_ns(self, frame: int) -> int:
        """When the frame was taken."""
        return self.origin_ns + round(frame * NS_PER_S / self.settings.frame_rate_hz)

    def see(self, marker: int, frame: int) -> Seen:
        """A marker in a frame; the same frame is always the same data."""
        if marker not in {TOOL, REFERENCE}:
            return Seen(None, 0.0, outside=False, partly=False)
        if self._strikes("tracker.swapped", frame):
            marker = REFERENCE if marker == TOOL else TOOL
        source = frame - 1 if self._strikes("tracker.repeated", frame) else frame
        pose = self._pose(marker, self.exposure_ns(source))
        outside = (marker == TOOL and self._on("tracker.outside")) or not in_volume(pose[:3, 3])
        hidden = {"tracker.missing", "tracker_missing"} if marker == TOOL else {"tracker.missing_reference"}
        if hidden & self.world.faults:
            return Seen(None, 0.0, outside=False, partly=False)
        return self._noisy(pose, marker, source, outside=outside)

    def _pose(self, marker: int, t_ns: int) -> Array:
        s = self.settings
        moved = s.moved_by.matrix
        camera = s.registration.matrix
        if self._on("tracker.moved_camera"):
            camera = moved @ camera
        if marker == TOOL:
            slip = moved if self._on("tracker.moved_marker") else np.eye(4)
            return np.asarray(camera @ self.world.tip_pose(t_ns) @ s.tool_marker.matrix @ slip)
        shift = moved if self._on("tracker.moved_reference") else np.eye(4)
        return np.asarray(camera @ shift @ s.reference_marker.matrix)

    def _noisy(self, pose: Array, marker: int, frame: int, *, outside: bool) -> Seen:
        # The same frame asked for twice must read the same: its noise is drawn from its number.
        rng = np.random.default_rng([self.settings.seed, marker, frame & 0xFFFFFFFF])
        noise = rng.standard_normal(7)
        turned = pose[:3, :3] @ rotation_exp(self.settings.noise_rad * noise[:3])
        placed = pose[:3, 3] + self.settings.noise_m * noise[3:6]
        error_mm = 1e3 * self.settings.noise_m * (1.0 + 0.2 * abs(noise[6]))
        partly = marker == TOOL and self._on("tracker.partly")
        return Seen(transform(turned, placed), error_mm, outside=outside, partly=partly)

    def _on(self, name: str) -> bool:
        return name in self.world.faults

    def _strikes(self, name: str, frame: int) -> bool:
        """A fault with `@N` strikes in each N-th frame."""
        for text in self.world.faults:
            stem, _, every = parse_fault(text)
            if stem == name:
                return frame % every == 0
        return False


def in_volume(position: Array) -> bool:
    """The pyramid of a passive tracker: 0.95 to 2.4 m before the camera, widening (m, camera frame)."""
    depth = -float(position[2])
    half = 0.24 + 0.29 * (depth - 0.95)
    return 0.95 <= depth <= 2.4 and abs(position[0]) <= half and abs(position[1]) <= half
