"""The linear delta: three vertical carriages and the platform that they carry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from galen_hw.spatial import Array, cross


@dataclass(frozen=True, slots=True)
class LinearDelta:
    """Three vertical carriages that carry a platform on rods of equal length, always parallel to the base.

    Source: `spec/galen-nominal`, carriage_i = z - sqrt(L^2 - (x - r cos a_i)^2 - (y - r sin a_i)^2) + sqrt(L^2 - r^2).

    Args:
        rod_length: L, m.
        radius: r, tower circle minus platform circle, m.
        azimuths: a_i of the towers from base x, rad.
    """

    rod_length: float = 0.400
    radius: float = 0.150
    azimuths: tuple[float, float, float] = (np.pi / 2, 7 * np.pi / 6, 11 * np.pi / 6)

    @property
    def _towers(self) -> Array:
        a = np.asarray(self.azimuths)
        return self.radius * np.stack([np.cos(a), np.sin(a)], axis=-1)

    @property
    def _home_height(self) -> float:
        return float(np.sqrt(self.rod_length**2 - self.radius**2))

    def carriages(self, platform: ArrayLike) -> Array:
        """Carriage positions (..., 3) in m of platform positions (..., 3) in m; NaN where a rod cannot reach."""
        p = np.asarray(platform, dtype=float)
        flat2 = np.sum((p[..., None, :2] - self._towers) ** 2, axis=-1)
        with np.errstate(invalid="ignore"):
            return np.asarray(p[..., 2:] - np.sqrt(self.rod_length**2 - flat2) + self._home_height)

    def platform(self, carriages: ArrayLike) -> Array:
        """Platform positions (..., 3) in m of carriages (..., 3) in m: the upper meeting point of three spheres.

        NaN where the rods do not meet.
        """
        c = np.asarray(carriages, dtype=float)
        centres = np.empty((*c.shape, 3))
        centres[..., :2], centres[..., 2] = self._towers, c - self._home_height
        e1, e2 = centres[..., 1, :] - centres[..., 0, :], centres[..., 2, :] - centres[..., 0, :]
        normal = cross(e1, e2)
        n2 = np.sum(normal**2, axis=-1, keepdims=True)
        # Circumcentre of the three carriages relative to the first; all three are at rod length from the platform.
        l1, l2 = np.sum(e1**2, axis=-1, keepdims=True), np.sum(e2**2, axis=-1, keepdims=True)
        centre = (l1 * cross(e2, normal) + l2 * cross(normal, e1)) / (2.0 * n2)
        with np.errstate(invalid="ignore"):
            height = np.sqrt((self.rod_length**2 - np.sum(centre**2, axis=-1, keepdims=True)) / n2)
        return np.asarray(centres[..., 0, :] + centre + np.sign(normal[..., 2:]) * height * normal)

    def _rods(self, platform: Array) -> Array:
        """Vectors (..., 3, 3) from each carriage's joint to the platform."""
        rods = np.empty((*platform.shape, 3))
        rods[..., :2] = platform[..., None, :2] - self._towers
        rods[..., 2] = np.sqrt(self.rod_length**2 - np.sum(rods[..., :2] ** 2, axis=-1))
        return rods

    def jacobian(self, platform: ArrayLike) -> Array:
        """Derivative of the platform by the carriages, (..., 3, 3), at platform positions (..., 3)."""
        rods = self._rods(np.asarray(platform, dtype=float))
        return np.asarray(np.linalg.inv(rods / rods[..., 2:]))

    def rates(self, platform: Array, d_carriages: Array, dd_carriages: Array) -> tuple[Array, Array]:
        """Velocity and acceleration (..., 3) of the platform, from |rod| = L differentiated twice."""
        rods = self._rods(platform)
        inv = np.linalg.inv(rods)
        velocity = (inv @ (rods[..., 2] * d_carriages)[..., None])[..., 0]
        relative = np.repeat(velocity[..., None, :], 3, axis=-2)
        relative[..., 2] -= d_carriages
        right = rods[..., 2] * dd_carriages - np.sum(relative**2, axis=-1)
        return velocity, (inv @ right[..., None])[..., 0]
