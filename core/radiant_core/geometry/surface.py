"""A model's surface: depth of many cameras fused into a mesh.

    reach R = median over views of the median depth
    box = the cameras', R wider on each side, and in it depth up to `MAX_DEPTH` · R
    o' = 1 / (1 + exp(−4 (logit o − logit 0.3)))
Rendered depth is a mean over all that a ray meets, haze before the surface included, so it is
rendered with opacities o' that are nearly 0 or 1: then it is that of the first surface. A pixel
counts where the model is opaque and where depth does not jump: at an edge the mean lies between the
surfaces, where there is none. Once per surface. C renders of `long_side_px`, then some 0.2 s of
fusion each, in a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.fusion import FusionSettings, blocks_within, fuse_apart
from radiant_core.geometry.open3d_ops import MAX_BLOCKS, DepthView, Mesh
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.splats import Splats

SHARPENING, MIDDLE_OPACITY = 4.0, 0.3
"""Of the demo's town, 320 px: median error of depth at its sparse points 0.35 % in 0.82 of the
pixels; with opacities as they are 1.14 % in 0.82; without the Gaussians below 0.3 0.32 % in 0.41
(docs/experiments/surface.md)."""
MIN_ALPHA = 0.5
MAX_JUMP = 0.04
"""Greatest range of depth among a pixel's neighbours, as a share of it: seen from straight above,
640 px in 60°, a slope of 85°."""
MAX_DEPTH = 3.0
PIXELS_PER_CELL = 2.0
_REACH_VIEWS, _REACH_PX = 12, 96


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The mesh in the model's frame, of num_views; voxel, its resolution, in the model's unit.

    finest_voxel: what was asked for, below `voxel` where that did not fit; num_blocks of 16³ voxels
    that it took.
    """

    mesh: Mesh
    voxel: float
    num_views: int
    finest_voxel: float
    num_blocks: int

    @property
    def most_covered(self) -> float:
        """Most of its box on the map that the mesh can cover: area of triangles over the box's."""
        corners = self.mesh.vertices[self.mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        box = np.ptp(self.mesh.vertices[:, :2], axis=0)
        return float(min(1.0, np.linalg.norm(normals, axis=1).sum() / 2 / max(float(box.prod()), 1e-300)))


def extract_surface(  # noqa: PLR0913
    splats: Splats,
    cameras: Cameras,
    *,
    resolution: float | None = None,
    long_side_px: int = 640,
    memory_bytes: int | None = None,
    scratch: Path | None = None,
    report: Callable[[int, int], None] = lambda num_done, total: None,
) -> Surface:
    """The surface that C cameras see of a model; `resolution` by default two pixels on the ground
    at the usual depth, or what `memory_bytes` allow. `scratch` is the folder for temporary files,
    some 2 MB per camera. `report` gets views done, rendered and then fused, and their total.

    Raises BadInput without cameras, for a resolution that is no positive number, finer than 2,000
    voxels across the reach or more than fits, and where no camera sees the model.
    """
    if not len(cameras):
        raise BadInput("there is no camera to look at the model from: give those of its scene.")
    small = cameras.scaled(long_side_px)
    reach = _reach(sharpen_opacities(splats), cameras)
    voxel = PIXELS_PER_CELL * reach / float(np.median(small.Ks[:, 0, 0])) if resolution is None else resolution
    if not (np.isfinite(voxel) and voxel > reach / 2000):
        raise BadInput(f"a resolution of {voxel} was asked for, expected a number above {reach / 2000:.3g}: choose a coarser one.")
    centers = cameras.centers
    # Open3D and the rasterizer keep float32: near the middle its steps are below a micrometre.
    middle = np.round(centers.mean(axis=0))
    local, moved = _move(sharpen_opacities(splats), small, middle)
    low, high = (centers.min(axis=0) - middle - reach)[:2], (centers.max(axis=0) - middle + reach)[:2]
    num_views = 0

    def views() -> Iterator[DepthView]:
        nonlocal num_views
        for index, view in enumerate(render_views(local, moved)):
            depth = depth_in_box(trusted_depth(view, MAX_DEPTH * reach), moved.select([index]), low - voxel, high + voxel)
            if depth.any():
                num_views += 1
                yield DepthView(image=view.image_bytes, depth=depth, K=moved.Ks[index], cam_from_world=moved.cam_from_world[index])
            report(index + 1, 2 * len(moved))

    settings = FusionSettings(
        voxel=voxel,
        is_fixed=resolution is not None,
        max_depth=MAX_DEPTH * reach,
        max_blocks=MAX_BLOCKS if memory_bytes is None else blocks_within(memory_bytes),
    )
    fusion = fuse_apart(
        views(), settings, lambda num_done, total: report(len(moved) + len(moved) * num_done // total, 2 * len(moved)), scratch
    )
    mesh = _crop(fusion.mesh, low, high)
    if not len(mesh.triangles):
        raise BadInput(
            f"none of {len(cameras)} cameras sees a surface of {fusion.voxel:.3g}: choose a coarser resolution, or a model that is trained."
        )
    shifted = replace(mesh, vertices=mesh.vertices + middle)
    return Surface(mesh=shifted, voxel=fusion.voxel, num_views=num_views, finest_voxel=voxel, num_blocks=fusion.num_blocks)


def depth_in_box(depth: NDArray[np.float32], camera: Cameras, low: FloatArray, high: FloatArray) -> NDArray[np.float32]:
    """Depth (H,W) of one camera, 0 where its pixel lies outside a box on the map: what would be cut
    off the mesh takes no memory then."""
    height, width = depth.shape
    K, pose = camera.Ks[0], camera.cam_from_world[0]
    x, y = (np.arange(width) + 0.5 - K[0, 2]) / K[0, 0], (np.arange(height) + 0.5 - K[1, 2]) / K[1, 1]
    inside = np.ones((height, width), bool)
    for axis in (0, 1):
        along = pose[0, axis] * x + (pose[1, axis] * y)[:, None] + pose[2, axis]
        place = depth * along + camera.centers[0, axis]
        inside &= (place >= low[axis]) & (place <= high[axis])
    return np.where(inside, depth, 0).astype(np.float32)


def sharpen_opacities(splats: Splats) -> Splats:
    """The model with opacities that are nearly 0 or 1, for depth."""
    middle = np.log(MIDDLE_OPACITY / (1 - MIDDLE_OPACITY))
    logits = np.clip(SHARPENING * (splats.logit_opacities.astype(np.float64) - middle), -20, 20)
    return replace(splats, logit_opacities=logits.astype(np.float32))


def trusted_depth(view: RenderedView, max_depth: float) -> NDArray[np.float32]:
    """Depth (H,W) of a view, 0 where it is too far or jumps, or where the model is not opaque."""
    depth = np.where((view.alpha >= MIN_ALPHA) & (view.depth < max_depth), view.depth, 0).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel)
    return np.where(jump <= MAX_JUMP * depth, depth, 0).astype(np.float32)


def _reach(splats: Splats, cameras: Cameras) -> float:
    """The usual depth of what cameras see, from small renders of some of them."""
    chosen = cameras.select(np.unique(np.linspace(0, len(cameras) - 1, _REACH_VIEWS).astype(np.int64))).scaled(_REACH_PX)
    depths = [np.median(view.depth[view.alpha >= 0.5]) for view in render_views(splats, chosen) if (view.alpha >= 0.5).any()]
    if not depths:
        raise BadInput(f"none of {len(chosen)} cameras sees the model: are model and cameras of one run?")
    return float(np.median(depths))


def _move(splats: Splats, cameras: Cameras, middle: FloatArray) -> tuple[Splats, Cameras]:
    poses = cameras.cam_from_world.copy()
    poses[:, :3, 3] += poses[:, :3, :3] @ middle
    means = (splats.means.astype(np.float64) - middle).astype(np.float32)
    return replace(splats, means=means), replace(cameras, cam_from_world=poses)


def _crop(mesh: Mesh, low: FloatArray, high: FloatArray) -> Mesh:
    """Triangles whose corners all lie within a box on the map."""
    inside = np.asarray(((mesh.vertices[:, :2] >= low) & (mesh.vertices[:, :2] <= high)).all(axis=1))
    triangles = mesh.triangles[inside[mesh.triangles].all(axis=1)] if len(mesh.triangles) else mesh.triangles
    used, numbered = np.unique(triangles, return_inverse=True)
    return Mesh(vertices=mesh.vertices[used], triangles=numbered.reshape(-1, 3), colors=mesh.colors[used])
