"""`Lens`: the two families of lenses that other programs write, in one order. Once per camera.

    brown:    x' = x (1 + k₁r² + k₂r⁴ + k₃r⁶ + k₄r⁸) + 2 p₁xy + p₂(r² + 2x²),   x = X/Z, y = Y/Z
              y' = y (…) + p₁(r² + 2y²) + 2 p₂xy
    fisheye:  (x', y') = θ (1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸) (X, Y) / ρ,   θ = atan2(ρ, Z)
    sphere:   an equirectangular panorama (`panoramas.py`), which is cut into faces before all else
    pixel:    u = cₓ + fₓx' + s y',   v = c_y + f_y y',   the first pixel's middle at (0.5, 0.5)

These are OpenCV's equations with one coefficient more, k₄, and skew s. What COLMAP has a model for
becomes that model; the rest is undistorted by these equations (`sfm/colmap/other_lenses.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import MAX_SIDE_PX, ColmapCamera
from radiant_core.numerics import FloatArray
from radiant_core.panoramas import pixels_of_rays, rays_of_pixels

MAX_VALUE = 1e6
"""Of a focal length or principal point in px, and of a coefficient."""
NUM_NEWTON = 40
EXACT = 1e-13


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Intrinsics of one camera; raises BadInput for a size or number that no camera has."""

    size_wh: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    kind: Literal["brown", "fisheye", "sphere"] = "brown"
    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    p1: float = 0.0
    p2: float = 0.0
    skew: float = 0.0

    def __post_init__(self) -> None:
        if not all(isinstance(side, int) and 0 < side <= MAX_SIDE_PX for side in self.size_wh):
            raise BadInput(f"a lens has the size {self.size_wh[0]} × {self.size_wh[1]}, expected 1 to {MAX_SIDE_PX} px a side.")
        numbers = np.array([self.fx, self.fy, self.cx, self.cy, *self.k, self.p1, self.p2, self.skew], np.float64)
        if not (np.abs(numbers) <= MAX_VALUE).all() or min(self.fx, self.fy) <= 0:
            raise BadInput(f"a lens has the numbers {numbers.tolist()}, expected focal lengths above 0 and nothing beyond {MAX_VALUE:g}.")
        if self.kind == "fisheye" and (self.p1, self.p2) != (0, 0):
            raise BadInput("a fisheye lens has tangential coefficients, which no lens here has: undistort the photographs with it first.")

    def camera(self, camera_id: int) -> ColmapCamera | None:
        """The same in COLMAP's terms; None where it has no such model (k₄ or skew). Raises BadInput
        for a panorama, of which faces have to be cut first."""
        if self.kind == "sphere":
            raise BadInput(
                "the alignment is of panoramas, which become flat photographs where all are in one folder: use --frames shared, or cut "
                "them in the program that aligned them."
            )
        head = (self.fx, self.fy, self.cx, self.cy)
        k1, k2, k3, k4 = self.k
        if self.skew != 0 or (self.kind == "brown" and k4 != 0):
            return None
        if self.kind == "fisheye":
            model, params = "OPENCV_FISHEYE", (*head, *self.k)
        elif k3 != 0:
            model, params = "FULL_OPENCV", (*head, k1, k2, self.p1, self.p2, k3, 0.0, 0.0, 0.0)
        elif (k1, k2, self.p1, self.p2) != (0, 0, 0, 0):
            model, params = "OPENCV", (*head, k1, k2, self.p1, self.p2)
        else:
            model, params = "PINHOLE", head
        return ColmapCamera(camera_id=camera_id, model=model, size_wh=self.size_wh, params=tuple(float(value) for value in params))

    def scaled(self, size_wh: tuple[int, int]) -> Lens:
        """The same lens over a picture of another size in px."""
        across, down = size_wh[0] / self.size_wh[0], size_wh[1] / self.size_wh[1]
        return replace(
            self,
            size_wh=size_wh,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=self.cx * across,
            cy=self.cy * down,
            skew=self.skew * across,
        )

    def img_from_cam(self, rays: FloatArray) -> FloatArray:
        """Pixels (N,2) of points (N,3) in the camera's frame; NaN behind a lens that is no
        fisheye."""
        rays = np.asarray(rays, np.float64)
        if self.kind == "sphere":
            return pixels_of_rays(rays, self.size_wh)
        with np.errstate(all="ignore"):
            bent = self._bend(self._flat(rays))
        return np.column_stack([self.cx + self.fx * bent[:, 0] + self.skew * bent[:, 1], self.cy + self.fy * bent[:, 1]])

    def cam_from_img(self, pixels: FloatArray) -> FloatArray:
        """Rays (N,3) with z = 1, or of length 1 for a fisheye and a panorama, that `img_from_cam`
        puts at pixels (N,2); NaN where none does."""
        if self.kind == "sphere":
            return rays_of_pixels(pixels, self.size_wh)
        y = (pixels[:, 1] - self.cy) / self.fy
        target = np.column_stack([(pixels[:, 0] - self.cx - self.skew * y) / self.fx, y])
        flat, step = target.copy(), 1e-6
        right, below = np.array([step, 0.0]), np.array([0.0, step])
        with np.errstate(all="ignore"):
            for _ in range(NUM_NEWTON):
                off = self._bend(flat) - target
                # Central differences: Newton's end is decided by the function alone.
                dx = (self._bend(flat + right) - self._bend(flat - right)) / (2 * step)
                dy = (self._bend(flat + below) - self._bend(flat - below)) / (2 * step)
                det = dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]
                moved = np.column_stack([off[:, 0] * dy[:, 1] - off[:, 1] * dy[:, 0], dx[:, 0] * off[:, 1] - dx[:, 1] * off[:, 0]])
                flat = flat - np.clip(moved / det[:, None], -0.5, 0.5)
                if np.nanmax(np.abs(off), initial=0.0) < EXACT:
                    break
            lost = np.abs(self._bend(flat) - target).max(axis=1) > 1e-9
        flat[lost] = np.nan
        if self.kind == "brown":
            return np.column_stack([flat, np.ones(len(flat))])
        theta = np.linalg.norm(flat, axis=1)
        return np.column_stack([flat * np.sinc(theta / np.pi)[:, None], np.cos(theta)])

    def _flat(self, rays: FloatArray) -> FloatArray:
        """What distortion acts on (N,2): X/Z, Y/Z; of a fisheye θ in the direction of X, Y."""
        if self.kind == "brown":
            return np.where(rays[:, 2:] > 0, rays[:, :2] / rays[:, 2:], np.nan)
        radius = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan2(radius, rays[:, 2])
        return rays[:, :2] * np.where(radius > 0, theta / radius, 1.0)[:, None]

    def _bend(self, flat: FloatArray) -> FloatArray:
        x, y = flat[:, 0], flat[:, 1]
        r2 = x * x + y * y
        k1, k2, k3, k4 = self.k
        factor = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
        bent_x = x * factor + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        bent_y = y * factor + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.column_stack([bent_x, bent_y])


def sphere_lens(size_wh: tuple[int, int]) -> Lens:
    """That of a whole equirectangular panorama; BadInput for a size that is not twice as wide as
    high."""
    width, height = size_wh
    if abs(width - 2 * height) > 0.02 * height:
        raise BadInput(f"a panorama has the size {width} × {height}, expected one twice as wide as high: export whole panoramas.")
    pixels_per_radian = width / (2 * np.pi)
    return Lens(size_wh=size_wh, fx=pixels_per_radian, fy=pixels_per_radian, cx=width / 2, cy=height / 2, kind="sphere")


_TERMS = {
    "SIMPLE_PINHOLE": "",
    "PINHOLE": "",
    "SIMPLE_RADIAL": "k1",
    "RADIAL": "k1 k2",
    "OPENCV": "k1 k2 p1 p2",
    "FULL_OPENCV": "k1 k2 p1 p2 k3",
    "SIMPLE_FISHEYE": "",
    "FISHEYE": "",
    "SIMPLE_RADIAL_FISHEYE": "k1",
    "RADIAL_FISHEYE": "k1 k2",
    "OPENCV_FISHEYE": "k1 k2 k3 k4",
}
"""COLMAP's models that have these equations, and what follows the principal point."""


def lens_of(camera: ColmapCamera) -> Lens | None:
    """The lens of a COLMAP camera; None of one with other equations."""
    head = (camera.params[0], *camera.params)[:4] if camera.num_focals == 1 else camera.params[:4]
    terms = _TERMS.get(camera.model)
    if terms is None:
        return None
    coefficients = camera.params[camera.num_focals + 2 :]
    value = dict(zip(terms.split(), coefficients, strict=False))
    if any(coefficients[len(value) :]):
        # FULL_OPENCV's denominator.
        return None
    fx, fy, cx, cy = head
    k = (value.get("k1", 0.0), value.get("k2", 0.0), value.get("k3", 0.0), value.get("k4", 0.0))
    kind = "fisheye" if "FISHEYE" in camera.model else "brown"
    p1, p2 = value.get("p1", 0.0), value.get("p2", 0.0)
    return Lens(size_wh=camera.size_wh, fx=fx, fy=fy, cx=cx, cy=cy, kind=kind, k=k, p1=p1, p2=p2)
