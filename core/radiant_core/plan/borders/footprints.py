"""Footprints: the ground an image sees, and its shares in regions. P images, E regions.

    corner ray d of an image at height h above flat ground meets it at   x + d_xy · h / (−d_z)

Rays that look too flat are cut where the ground is `horizon` heights away along or across the view:
u · d_xy + horizon · d_z ≤ 0 for the four directions u, linear in d, so that a view at the sky has a
footprint as well, with 8 corners at most. Once per plan, vectorised over images: those whose
corners all lie in one region are not clipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

HORIZON_HEIGHTS = 5.0
"""Ground farther away than this many heights covers few pixels: it lies under 11° of depression."""
MAX_CORNERS = 8
NADIR_DEG = -90.0
_BLOCK = 65_536


def is_flat_angle(angle_deg: float) -> bool:
    """Whether a flat image can be so wide."""
    return 1 <= angle_deg <= 170


def is_usual_aspect(aspect: float) -> bool:
    """Whether a camera takes images of that height over width."""
    return 0.1 <= aspect <= 10


@dataclass(frozen=True, kw_only=True)
class Optics:
    """What a camera that has not flown yet will see. BadInput for angles no flat image has."""

    field_of_view_deg: float = 73.7
    """Across the image; 73.7° is a 24 mm lens on full frame, close to that of most drones."""
    aspect: float = 0.75
    """Height of the image over its width."""

    def __post_init__(self) -> None:
        if not is_flat_angle(self.field_of_view_deg):
            raise BadInput(f"the field of view is {self.field_of_view_deg}°, expected 1 to 170 degrees across the image.")
        if not is_usual_aspect(self.aspect):
            raise BadInput(f"the image's height over width is {self.aspect}, expected 0.1 to 10.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """positions (P,2) m; heights_m (P,) above the ground, below 0 where a camera is under it;
    corner_rays (P,4,3), z up, any length, around the image."""

    positions: FloatArray
    heights_m: FloatArray
    corner_rays: FloatArray

    def __post_init__(self) -> None:
        positions = check_array("positions", self.positions, (None, 2))
        rays = check_array("corner_rays", self.corner_rays, (len(positions), 4, 3))
        lengths = np.linalg.norm(rays, axis=2, keepdims=True)
        if (lengths == 0).any():
            raise BadInput("corner_rays has rays without a direction: check the cameras.")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "heights_m", check_array("heights_m", self.heights_m, (len(positions),)))
        object.__setattr__(self, "corner_rays", rays / lengths)

    def __len__(self) -> int:
        return len(self.heights_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Footprints:
    """polygons (P,8,2) m, convex, counter-clockwise, one corner repeated; areas_m2 (P,). Where no
    ground is seen: 0, and all corners below the camera."""

    polygons: FloatArray
    areas_m2: FloatArray

    def __len__(self) -> int:
        return len(self.areas_m2)


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionShares:
    """A sparse (P,E) matrix: shares (K,) > 0 of images (K,) in regions (K,), by region, image."""

    images: NDArray[np.int64]
    regions: NDArray[np.int64]
    shares: FloatArray
    num_images: int
    num_regions: int

    def __post_init__(self) -> None:
        size = (len(self.shares),)
        for name, limit in (("images", self.num_images), ("regions", self.num_regions)):
            indices = check_array(name, getattr(self, name), size, np.int64)
            if len(indices) and not 0 <= indices.min() <= indices.max() < limit:
                raise BadInput(f"{name} of shares run from {indices.min()} to {indices.max()}, expected 0 to {limit - 1}.")
            object.__setattr__(self, name, indices)
        shares = check_array("shares", self.shares, size)
        if len(shares) and not 0 < shares.min() <= shares.max() <= 1:
            raise BadInput(f"shares run from {shares.min()} to {shares.max()}, expected above 0 and at most 1.")
        if (np.diff(self.regions * self.num_images + self.images) <= 0).any():
            raise BadInput("shares must come by region, then image, each pair once: sort them.")
        object.__setattr__(self, "shares", shares)

    def of_region(self, region: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Images (K,) that see into one region, and their shares (K,)."""
        part = slice(*np.searchsorted(self.regions, [region, region + 1]))
        return self.images[part], self.shares[part]


def views_before_capture(positions: ArrayLike, heights_m: ArrayLike, optics: Optics, heading_pitch_deg: ArrayLike | None = None) -> Views:
    """Views from positions (P,2) m at heights (P,) m above the ground; heading_pitch_deg (P,2):
    degrees clockwise from north, and −90 straight down to 0 level; NaN for what is not known: an
    unknown pitch is straight down, an unknown heading along the way to the next position, as a
    drone flies."""
    positions = check_array("positions", positions, (None, 2))
    count = len(positions)
    angles = np.full((count, 2), np.nan) if heading_pitch_deg is None else np.array(heading_pitch_deg, np.float64)
    if angles.shape != (count, 2) or np.isinf(angles).any() or (np.abs(angles[:, 1]) > -NADIR_DEG).any():
        raise BadInput("headings and pitches need two angles per position in degrees, pitch −90 (down) to 90, NaN where unknown.")
    heading = np.radians(np.where(np.isnan(angles[:, 0]), _headings_deg(positions), angles[:, 0]))
    pitch = np.radians(np.where(np.isnan(angles[:, 1]), NADIR_DEG, angles[:, 1]))
    level = np.zeros(count)
    forward = np.stack([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)], axis=1)
    right = np.stack([np.cos(heading), -np.sin(heading), level], axis=1)
    up = np.stack([-np.sin(heading) * np.sin(pitch), -np.cos(heading) * np.sin(pitch), np.cos(pitch)], axis=1)
    half = np.tan(np.radians(optics.field_of_view_deg / 2))
    corners = [(-half, half), (half, half), (half, -half), (-half, -half)]
    rays = np.stack([forward + x * right + y * optics.aspect * up for x, y in corners], axis=1)
    return Views(positions=positions, heights_m=np.asarray(heights_m, np.float64), corner_rays=rays)


def views_of_cameras(cameras: Cameras, ground_m: float) -> Views:
    """Views of posed cameras over flat ground at the height `ground_m` of their frame."""
    sizes = cameras.sizes_wh.astype(np.float64)
    zero = np.zeros(len(cameras))
    corners = [(zero, zero), (sizes[:, 0], zero), (sizes[:, 0], sizes[:, 1]), (zero, sizes[:, 1])]
    pixels = np.stack([np.stack([x, y, np.ones(len(cameras))], axis=1) for x, y in corners], axis=1)
    in_camera = np.einsum("pij,pkj->pki", np.linalg.inv(cameras.Ks), pixels)
    rays = np.einsum("pji,pkj->pki", cameras.cam_from_world[:, :3, :3], in_camera)
    centers = cameras.centers
    return Views(positions=centers[:, :2], heights_m=centers[:, 2] - ground_m, corner_rays=rays)


def ground_footprints(views: Views, horizon: float = HORIZON_HEIGHTS) -> Footprints:
    """The ground seen up to `horizon` heights away. BadInput unless that is positive and finite."""
    if not (np.isfinite(horizon) and horizon > 0):
        raise BadInput(f"the horizon is {horizon} heights away, expected a positive number.")
    polygons = np.repeat(views.positions[:, None], MAX_CORNERS, axis=1)
    for start in range(0, len(views), _BLOCK):
        rows = np.flatnonzero(views.heights_m[start : start + _BLOCK] > 0) + start
        rays, sees_ground = _cut_at_horizon(views.corner_rays[rows], horizon)
        rows, rays = rows[sees_ground], rays[sees_ground]
        polygons[rows] += rays[..., :2] * (views.heights_m[rows, None, None] / -rays[..., 2:])
    areas = signed_areas_m2(polygons - views.positions[:, None])
    polygons[areas < 0] = polygons[areas < 0][:, ::-1]
    return Footprints(polygons=polygons, areas_m2=np.abs(areas))


def region_shares(footprints: Footprints, polygons: Sequence[FloatArray]) -> RegionShares:
    """Share (P,E) of each footprint's area in each of E convex counter-clockwise polygons (V,2) m.
    Rows sum to less than 1 where land belongs to no region, to 0 where no ground is seen."""
    if not len(polygons):
        raise BadInput("there is no region: give at least one polygon.")
    corners = [check_array("a region", polygon, (None, 2)) for polygon in polygons]
    order, lows, highs = sort_from_west(footprints)
    widest_m = float((highs[:, 0] - lows[:, 0]).max(initial=0.0))
    parts: list[tuple[FloatArray, NDArray[np.int64], int]] = []
    for region, polygon in enumerate(corners):
        if len(polygon) < 3:
            continue
        low, high = polygon.min(axis=0), polygon.max(axis=0)
        near = slice(*np.searchsorted(lows[:, 0], [low[0] - widest_m, high[0]]))
        near_rows = np.arange(len(order))[near]
        met = (highs[near] >= low).all(axis=1) & (lows[near] <= high).all(axis=1)
        images = np.sort(order[near_rows[met]])
        areas = common_areas_m2(footprints.polygons[images], polygon)
        some = areas > 0
        parts.append((np.minimum(1.0, areas[some] / footprints.areas_m2[images[some]]), images[some], region))
    columns = np.repeat(np.array([region for _, _, region in parts], np.int64), [len(images) for _, images, _ in parts])
    return RegionShares(
        images=np.concatenate([np.zeros(0, np.int64), *(images for _, images, _ in parts)]),
        regions=columns,
        shares=np.concatenate([np.zeros(0), *(shares for shares, _, _ in parts)]),
        num_images=len(footprints),
        num_regions=len(polygons),
    )


def sort_from_west(footprints: Footprints) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Images (K,) that see ground, from west to east, and corners (K,2) of their bounding boxes."""
    images = np.flatnonzero(footprints.areas_m2 > 0)
    lows, highs = footprints.polygons[images].min(axis=1), footprints.polygons[images].max(axis=1)
    order = np.argsort(lows[:, 0], kind="stable")
    return images[order], lows[order], highs[order]


def common_areas_m2(footprints: FloatArray, polygon: FloatArray) -> FloatArray:
    """Areas (K,) that footprints (K,8,2) share with one convex counter-clockwise polygon (V,2)."""
    origin: FloatArray = polygon[0]
    sides: FloatArray = np.roll(polygon, -1, axis=0) - polygon
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)  # outward
    offsets = ((polygon - origin) * normals).sum(axis=1)
    local = footprints - origin
    areas = np.zeros(len(local))
    heights = local @ normals.T - offsets
    met = ~(heights >= 0).all(axis=1).any(axis=1)
    inside = (heights <= 0).all(axis=(1, 2))
    areas[inside & met] = signed_areas_m2(local[inside & met])
    rows = np.flatnonzero(met & ~inside)
    parts = np.concatenate([local[rows], np.ones((len(rows), MAX_CORNERS, 1))], axis=2)
    counts = np.full(len(rows), MAX_CORNERS)
    # Points of the plane as rays (x, y, 1), so that one routine clips both.
    for plane in np.column_stack([normals, -offsets]):
        cut = np.flatnonzero((parts @ plane > 0).any(axis=1))
        if not len(cut):
            continue
        clipped, counts[cut] = _clip(parts[cut], counts[cut], np.broadcast_to(plane, (len(cut), 3)))
        if clipped.shape[1] > parts.shape[1]:
            parts = np.concatenate([parts, parts[:, -1:]], axis=1)
        parts[cut] = clipped
    areas[rows] = np.where(counts >= 3, signed_areas_m2(parts[..., :2]), 0.0)
    return areas


def _headings_deg(positions: FloatArray) -> FloatArray:
    """Direction (P,) from each position to the next, of the last from the one before; north where
    neither moves."""
    if len(positions) < 2:
        return np.zeros(len(positions))
    steps = np.diff(positions, axis=0)
    east, north = np.concatenate([steps, steps[-1:]]).T
    return np.degrees(np.arctan2(east, north))


def _cut_at_horizon(rays: FloatArray, horizon: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Corner rays (P,8,3) of the views (P,4,3) where they meet ground within the horizon, and which
    (P,) do at all."""
    middle = rays.sum(axis=1)[:, :2]
    length = np.linalg.norm(middle, axis=1, keepdims=True)
    # A view straight down has no direction: north does.
    along = np.where(length > 1e-9, middle / np.maximum(length, 1e-9), [0.0, 1.0])
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)
    cut, counts = rays, np.full(len(rays), 4)
    for direction in (along, -along, across, -across):
        cut, counts = _clip(cut, counts, np.column_stack([direction, np.full(len(rays), horizon)]))
    return cut[:, np.minimum(np.arange(MAX_CORNERS), cut.shape[1] - 1)], counts >= 3


def _clip(rays: FloatArray, counts: NDArray[np.int64], normals: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Cones (P,V,3), the last ray repeated, clipped to normal · d ≤ 0: (P,V+1,3) and numbers of
    rays (Sutherland, Hodgman)."""
    heights = np.einsum("pvi,pi->pv", rays, normals)
    if not (heights > 0).any():
        return rays, counts
    following, next_heights = np.roll(rays, -1, axis=1), np.roll(heights, -1, axis=1)
    crossing = (np.minimum(heights, next_heights) < 0) & (np.maximum(heights, next_heights) > 0)
    share = np.divide(heights, heights - next_heights, out=np.zeros_like(heights), where=crossing)
    slots = np.stack([rays, rays + share[..., None] * (following - rays)], axis=2).reshape(len(rays), 2 * rays.shape[1], 3)
    is_used = np.stack([heights <= 0, crossing], axis=2).reshape(len(rays), 2 * rays.shape[1]) & (counts > 0)[:, None]
    # Repeated last rays stay repeated: only the first of them opens a side.
    size = int(rays.shape[1]) + 1
    order = np.argsort(~is_used, axis=1, kind="stable")[:, :size]
    numbers = np.minimum(is_used.sum(axis=1), size)
    filled = np.minimum(np.arange(size), np.maximum(numbers, 1)[:, None] - 1)
    return np.take_along_axis(slots, np.take_along_axis(order, filled, axis=1)[..., None], axis=1), numbers


def signed_areas_m2(polygons: FloatArray) -> FloatArray:
    """Areas (P,) of polygons (P,V,2), positive counter-clockwise."""
    following = np.concatenate([polygons[:, 1:], polygons[:, :1]], axis=1)
    doubled: FloatArray = polygons[..., 0] * following[..., 1] - polygons[..., 1] * following[..., 0]
    return doubled.sum(axis=1) / 2
