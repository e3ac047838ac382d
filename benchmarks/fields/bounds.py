"""Where a radiance field lies: its sphere, and where rays enter and leave the scene. Once a scene.

    unit coordinates      u = (x − centre) / radius
    inside the sphere     c = u                              |u| ≤ 1
    background            c = (1 + b − b / |u|) u / |u|      |u| > 1, an inverted sphere
    grid                  g = ½ + c / (2 (1 + b))            in 0..1

The background is the inverted sphere of NeRF++ and Mega-NeRF, laid as a shell of thickness b around
the same grid, where theirs has a network of its own. Rays begin at the plane over the highest and
end at the one under the lowest points, as Mega-NeRF bounds them by altitudes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.scene import SfmScene

SHELL = 0.25
"""b: all that lies beyond the sphere has so much of its radius in the grid."""
RADIUS_FACTOR = 1.1
"""The sphere beyond the points, as Mega-NeRF widens its ellipsoid."""
QUANTILE = 0.005
"""Stray points beyond it on either side do not count."""
HEIGHT_MARGIN = 0.25
"""How far the planes lie outside the points, as a share of their span."""
MAX_FAR = 4.0
"""In radii: where a ray ends that does not come down."""
MIN_NEAR = 0.01
"""In radii: where a ray begins whose camera is below the upper plane."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldBounds:
    """A sphere and two horizontal planes around a scene, z up. BadInput unless all is finite,
    radius_m > 0 and the planes are in order."""

    center: FloatArray
    """(3,) m."""
    radius_m: float
    low_m: float
    """Height of the lower plane."""
    high_m: float
    """Height of the upper plane."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", check_array("center", self.center, (3,)))
        if not (0 < self.radius_m < np.inf and -np.inf < self.low_m < self.high_m < np.inf):
            raise BadInput(f"a field has radius {self.radius_m} m between {self.low_m} and {self.high_m} m: give a scene with points.")

    @staticmethod
    def of(scene: SfmScene) -> FieldBounds:
        """Around the points of a scene. BadInput without at least 8 of them."""
        if len(scene.points) < 8:
            raise BadInput(f"the scene has {len(scene.points)} points, a field needs at least 8 to lie around: reconstruct it first.")
        low, high = np.quantile(scene.points, [QUANTILE, 1 - QUANTILE], axis=0)
        margin_m = max(HEIGHT_MARGIN * (high[2] - low[2]), 1e-3 * float(np.max(high - low)), 1e-9)
        return FieldBounds(
            center=(low + high) / 2,
            radius_m=RADIUS_FACTOR * max(float(np.linalg.norm(high - low)) / 2, 1e-9),
            low_m=float(low[2] - margin_m),
            high_m=float(high[2] + margin_m),
        )

    def unit(self, places_m: FloatArray) -> FloatArray:
        """Unit coordinates of places (...,3) m."""
        return (np.asarray(places_m, np.float64) - self.center) / self.radius_m

    def span(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Near and far (R,) of rays in unit coordinates, 0 < near < far ≤ `MAX_FAR`."""
        low, high = ((height_m - self.center[2]) / self.radius_m for height_m in (self.low_m, self.high_m))
        heights, slopes = origins[:, 2], directions[:, 2]
        steep = torch.where(slopes.abs() < 1e-6, torch.full_like(slopes, 1e-6).copysign(slopes), slopes)
        ends = torch.stack([(low - heights) / steep, (high - heights) / steep])
        near = ends.amin(dim=0).clamp(MIN_NEAR, MAX_FAR / 2)
        far = ends.amax(dim=0).clamp(max=MAX_FAR)
        # A ray that leaves the scene from above it has all of the way before it.
        missed = far <= near
        near = torch.where(missed, torch.full_like(near, MIN_NEAR), near)
        return near, torch.where(missed, torch.full_like(far, MAX_FAR), far)


def grid_places(units: Tensor) -> Tensor:
    """Places (N,3) in 0..1 of a grid for unit coordinates (N,3), the background in its shell."""
    length = units.norm(dim=1, keepdim=True)
    beyond = length.clamp(min=1)
    contracted = torch.where(length > 1, (1 + SHELL - SHELL / beyond) * units / beyond, units)
    return 0.5 + contracted / (2 * (1 + SHELL))
