"""A model from straight above along a border: a strip of pixels. One small render per border.

A pinhole `ALTITUDE` strip lengths above the ground stands for an orthographic camera, which the
rasterizer lacks: rays are off the vertical by at most 1 / (2 · `ALTITUDE`). Gaussians are moved to
the middle of the border in float64 first, so that a far origin or altitude costs no digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_core.render.contract import Backend

ALTITUDE = 100.0
MAX_STRIP_PX = 20_000_000
CEILING_M = 40.0
"""What stands higher over the middle ground than roofs and trees is sky or haze: left out."""
_REACH_SIGMAS = 3.5
"""Beyond this a Gaussian's α is below 1/255 whatever its opacity."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BorderStrip:
    """T rows across, S columns along a border between rows T/2 − 1 and T/2, its left side above.

    image (T,S,3) in 0..1 over black; alpha (T,S); height_m (T,S) in the world, NaN where nothing
    was hit; density (T,S) opacities per m² of the centres of Gaussians; px_m metres per pixel;
    ends (2,2) m.
    """

    image: NDArray[np.float32]
    alpha: NDArray[np.float32]
    height_m: FloatArray
    density: FloatArray
    px_m: float
    ends: FloatArray


def render_border_strip(splats: Splats, ends: ArrayLike, *, half_width_m: float, px_m: float, backend: Backend = "auto") -> BorderStrip:
    """The strip within `half_width_m` of the border between `ends` (2,2) m, in whole pixels.

    BadInput where the border is shorter than a pixel, a width or pixel is not positive and finite,
    or the strip would have more than 20 million pixels.
    """
    ends = check_array("ends", ends, (2, 2))
    if not (0 < px_m < np.inf and px_m <= half_width_m < np.inf):
        raise BadInput(f"px_m is {px_m} and half_width_m {half_width_m}, expected 0 < px_m ≤ half_width_m: give metres.")
    length_m = float(np.hypot(*(ends[1] - ends[0])))
    half_rows, columns = int(half_width_m / px_m), int(length_m / px_m + 1e-9)
    if columns < 1 or 2.0 * half_rows * columns > MAX_STRIP_PX:
        raise BadInput(
            f"a border of {length_m:.3g} m at {px_m} m per pixel gives a strip of {2 * half_rows} × {columns} pixels:"
            " expected 1 to 20 million; choose other pixels."
        )
    along = (ends[1] - ends[0]) / length_m
    left = np.array([-along[1], along[0]])
    local = splats.means[:, :2].astype(np.float64) - ends.mean(axis=0)
    places = np.stack([local @ along, local @ left], axis=1)
    reach_m = np.array([columns, 2 * half_rows]) * px_m / 2
    sizes_m = np.exp(np.minimum(splats.log_scales.max(axis=1, initial=-np.inf).astype(np.float64), 50.0))
    near = (np.abs(places) <= 1.02 * reach_m + _REACH_SIGMAS * sizes_m[:, None]).all(axis=1)
    inside = np.asarray((np.abs(places) < reach_m).all(axis=1))
    ground_m = float(np.median(splats.means[inside, 2])) if inside.any() else 0.0
    low = low_gaussians(splats, inside)
    near, inside = near & low, inside & low
    moved = _move(splats.select(np.flatnonzero(near)), local[near], ground_m)
    camera = _camera_above(along, columns, 2 * half_rows, px_m)
    # Here, since it brings torch, which other measures need not wait for.
    from radiant_core.render.rendered_view import render_views

    (view,) = render_views(moved, camera, backend)
    altitude_m = camera.cam_from_world[0, 2, 3]
    height_m = np.where(view.alpha > 0, ground_m + altitude_m - view.depth.astype(np.float64), np.nan)
    density = _density(splats, places, inside, (2 * half_rows, columns), px_m)
    return BorderStrip(image=view.image, alpha=view.alpha, height_m=height_m, density=density, px_m=px_m, ends=ends)


def low_gaussians(splats: Splats, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask (N,) of those at most `CEILING_M` above the middle height of those `inside` (N,)."""
    ground_m = float(np.median(splats.means[inside, 2])) if inside.any() else 0.0
    return splats.means[:, 2] < ground_m + CEILING_M


def _move(splats: Splats, local_xy: FloatArray, ground_m: float) -> Splats:
    means = np.column_stack([local_xy, splats.means[:, 2].astype(np.float64) - ground_m])
    return replace(splats, means=means.astype(np.float32))


def _camera_above(along: FloatArray, columns: int, rows: int, px_m: float) -> Cameras:
    """Straight down on the origin, columns along the border, rows from its left to its right."""
    altitude_m = ALTITUDE * max(columns, rows) * px_m
    left = np.array([-along[1], along[0]])
    pose = np.eye(4)
    pose[:3, :3] = [[*along, 0], [*-left, 0], [0, 0, -1]]
    pose[2, 3] = altitude_m
    focal_px = altitude_m / px_m
    K = [[focal_px, 0, columns / 2], [0, focal_px, rows / 2], [0, 0, 1]]
    return Cameras(names=("border",), Ks=np.array([K]), cam_from_world=pose[None], sizes_wh=np.array([[columns, rows]]))


def _density(splats: Splats, places: FloatArray, inside: NDArray[np.bool_], shape: tuple[int, int], px_m: float) -> FloatArray:
    rows = ((shape[0] / 2) - places[inside, 1] / px_m).astype(np.int64).clip(0, shape[0] - 1)
    columns = (shape[1] / 2 + places[inside, 0] / px_m).astype(np.int64).clip(0, shape[1] - 1)
    opacities = splats.opacities[inside]
    density = np.zeros(shape)
    np.add.at(density, (rows, columns), opacities)
    return density / px_m**2
