"""The scene from straight above, everywhere: tiles of an orthophoto. N Gaussians, tiles of T px.

A camera `DISTANCE` above the middle of a tile looks down with f = DISTANCE / cell. What is h higher
than the ground and x from the middle leans outwards by
    x h / DISTANCE,   below 0.003 cells for x = 30 m, h = 100 m, cells of 1 cm
so this is an orthographic projection, without one of its own in the rasterizer: centres and order
of depth go through float64 there (tests/core/survey/test_orthophoto.py compares it with plain
float64 orthographic splatting). Each tile stands on the map by a similarity at its middle, which
misses a UTM zone by less than 1e-5 cells at its corners, so tiles meet without a seam.

From above one sees what no photograph saw: sky, haze over the cameras, which `from_above` leaves
out. Gaussians of a single view, which may hang at any depth, fill only cells that without them
would stay open. Rendered twice per tile: colours, then how many photographs saw what is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.support import Support
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_C0, Splats
from radiant_core.survey.map_grid import MapFrame, MapGrid

DISTANCE = 1e8
"""In the world's unit; float64 still tells 15 nm apart there."""
MIN_ALPHA = 0.5
"""A cell counts as seen where the model is opaque by so much."""
REACH_SIGMAS = 3.4
"""α of an opaque Gaussian falls below 1/255 at 3.33 σ."""
MARGIN_PX = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class OrthoTile:
    """image (H,W,3) uint8, 0 where masked; known (H,W): whether the model is opaque; views (H,W)
    uint8: how many photographs saw what is shown, at most 255, and below 2 no more than one
    vouches for its place; height (H,W) float32 of the world, NaN where not known."""

    image: NDArray[np.uint8]
    is_known: NDArray[np.bool_]
    views: NDArray[np.uint8]
    height: NDArray[np.float32]

    def bands(self) -> NDArray[np.uint8]:
        """Red, green, blue, alpha (0 or 255) and views (H,W,5)."""
        return np.dstack([self.image, np.where(self.is_known, 255, 0).astype(np.uint8), self.views])


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenSplats:
    """Gaussians that may be seen from above, how many photographs (N,) saw each, and which (N,)
    several of them constrain."""

    splats: Splats
    num_views: NDArray[np.int64]
    constrained: NDArray[np.bool_]

    def select(self, chosen: NDArray[np.bool_]) -> SeenSplats:
        """Some of them."""
        return SeenSplats(splats=self.splats.select(chosen), num_views=self.num_views[chosen], constrained=self.constrained[chosen])


def from_above(splats: Splats, support: Support, cameras: Cameras) -> SeenSplats:
    """The Gaussians lower than the camera nearest to them on the map: nothing that was photographed
    from above is higher. Raises BadInput where none is, or no photograph saw them."""
    means = splats.means.astype(np.float64)
    nearest = KDTree(cameras.centers[:, :2]).query(means[:, :2])[1]
    visible = (support.num_views > 0) & (means[:, 2] < cameras.centers[nearest, 2])
    if not visible.any():
        raise BadInput("no Gaussian lies below the cameras: an orthophoto needs the run of a flight, with its own model.")
    return SeenSplats(splats=splats, num_views=support.num_views, constrained=support.constrained()).select(visible)


def ortho_camera(grid: MapGrid, map_frame: MapFrame, level: float, corner: tuple[int, int], size_px: tuple[int, int]) -> Cameras:
    """The camera above the cells from `corner` (row, column) on, `size_px` (height, width) of them;
    `level`: height of the ground in the world."""
    height, width = size_px
    middle = grid.north_west + grid.cell * np.array([corner[1] + width / 2, -(corner[0] + height / 2)])
    # A place `level` high in the world: the map's height of it does not matter to a map's x, y.
    steps = grid.cell * max(height, width) / 4 * np.array([[0.0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    at = map_frame.to_world(np.column_stack([middle + steps, np.full(5, _map_height(map_frame, level))]))
    across, along = (at[1] - at[2])[:2] / (2 * steps[1, 0]), (at[3] - at[4])[:2] / (2 * steps[1, 0])
    # A conformal map: north is east turned by 90°; the mean of both halves the rounding.
    east = (across + np.array([along[1], -along[0]])) / 2
    scale = float(np.hypot(*east))
    c, s = east / scale
    rotation = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array([at[0, 0], at[0, 1], level + DISTANCE])
    focal = DISTANCE / (grid.cell * scale)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Cameras(names=("above",), Ks=K[None], cam_from_world=pose[None], sizes_wh=np.array([[width, height]], np.int64))


def render_tile(seen_splats: SeenSplats, camera: Cameras) -> OrthoTile:
    """One tile of the orthophoto by its camera."""
    near = _within(seen_splats, camera)
    layers = _layers(near.select(near.constrained), camera)
    if (layers.alpha < MIN_ALPHA).any() and not near.constrained.all():
        layers = _filled(layers, _layers(near, camera))
    is_known = layers.alpha >= MIN_ALPHA
    solid = np.maximum(layers.alpha, 1e-6)
    image = np.clip(np.rint(255 * layers.colors / solid[..., None]), 0, 255)
    return OrthoTile(
        image=np.where(is_known[..., None], image, 0).astype(np.uint8),
        is_known=is_known,
        views=np.where(is_known, np.clip(np.rint(255 * layers.views / solid), 0, 255), 0).astype(np.uint8),
        height=np.where(is_known, layers.low + layers.span * layers.heights / solid, np.nan).astype(np.float32),
    )


def ortho_tiles(seen_splats: SeenSplats, grid: MapGrid, map_frame: MapFrame, level: float, tile_px: int) -> Iterator[OrthoTile]:
    """The tiles of a grid, row by row from the north-west, each `tile_px` wide and high: those at
    the east and the south reach beyond the grid."""
    for row in range(0, grid.rows, tile_px):
        for column in range(0, grid.columns, tile_px):
            yield render_tile(seen_splats, ortho_camera(grid, map_frame, level, (row, column), (tile_px, tile_px)))


def painted(splats: Splats, figures: FloatArray) -> Splats:
    """The same Gaussians with figures (N,3) in 0 … 1 for colours, from wherever one looks."""
    sh0 = ((figures - 0.5) / SH_C0).astype(np.float32)[:, None]
    return replace(splats, sh0=sh0, shN=np.zeros((len(splats), 0, 3), np.float32))


def _map_height(map_frame: MapFrame, level: float) -> float:
    return float(map_frame.from_world([[0.0, 0.0, level]])[0, 2])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Layers:
    """Sums over Gaussians of weight times: colours (H,W,3), 1 (alpha), views / 255, and heights
    above `low` (H,W) as shares of `span` (H,W); all float32."""

    colors: NDArray[np.float32]
    alpha: NDArray[np.float32]
    views: NDArray[np.float32]
    heights: NDArray[np.float32]
    low: NDArray[np.float32]
    span: NDArray[np.float32]


def _filled(layers: _Layers, others: _Layers) -> _Layers:
    """`others` where `layers` are not opaque."""
    open_ = layers.alpha < MIN_ALPHA

    def chosen(name: str) -> NDArray[np.float32]:
        values, other_values = getattr(layers, name), getattr(others, name)
        return np.where(open_[..., None] if values.ndim == 3 else open_, other_values, values)

    return _Layers(**{field.name: chosen(field.name) for field in fields(_Layers)})


def _layers(near: SeenSplats, camera: Cameras) -> _Layers:
    width, height = camera.sizes_wh[0].tolist()
    nothing = np.zeros((height, width), np.float32)
    if not len(near.splats):
        return _Layers(colors=np.dstack([nothing] * 3), alpha=nothing, views=nothing, heights=nothing, low=nothing, span=nothing)
    colors, alpha = _render(near.splats, camera)
    heights = near.splats.means[:, 2].astype(np.float64)
    low, span = float(heights.min()), max(float(np.ptp(heights)), 1e-6)
    figures = np.column_stack([np.minimum(near.num_views, 255) / 255, (heights - low) / span, np.zeros(len(heights))])
    rendered, _ = _render(painted(near.splats, figures), camera)
    return _Layers(colors=colors, alpha=alpha, views=rendered[..., 0], heights=rendered[..., 1], low=nothing + low, span=nothing + span)


def _within(seen_splats: SeenSplats, camera: Cameras) -> SeenSplats:
    """The Gaussians that may reach the picture: all others would only be looked at for nothing."""
    focal, (width, height) = float(camera.Ks[0, 0, 0]), camera.sizes_wh[0].tolist()
    pose = camera.cam_from_world[0]
    away_px = (seen_splats.splats.means.astype(np.float64) @ pose[:2, :3].T + pose[:2, 3]) * focal / DISTANCE
    radius_px = REACH_SIGMAS * np.exp(seen_splats.splats.log_scales.max(axis=1).astype(np.float64)) * focal / DISTANCE + MARGIN_PX
    near = np.asarray((np.abs(away_px) <= np.array([width / 2, height / 2]) + radius_px[:, None]).all(axis=1))
    return seen_splats.select(near)


def _render(splats: Splats, camera: Cameras) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours times alpha (H,W,3) and alpha (H,W). On the CPU: centres need its float64."""
    width, height = camera.sizes_wh[0].tolist()
    with torch.no_grad():
        output = rasterize(
            SplatTensors.from_splats(splats),
            torch.tensor(camera.cam_from_world),
            torch.tensor(camera.Ks),
            width,
            height,
            sh_degree=splats.sh_degree,
            backend="native",
        )
    return output.images[0].numpy(), output.alphas[0].numpy()
