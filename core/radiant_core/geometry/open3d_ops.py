"""What Open3D computes for core besides file formats: ICP with scale between two sets of surface points, once per pair of models; a mesh
from depth views by a truncated signed distance, and its heights, once per surface model.

    (s, R, t) = argmin Σ ‖s R x_i + t − y_c(i)‖²,  c(i) the nearest target within the radius, anew in each iteration; radii fall.
A free scale may collapse: a shrunken cloud has a near neighbour everywhere. So the result says how it fared both ways.
Sources: Besl and McKay, PAMI 14 (1992); Umeyama, PAMI 13 (1991).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.splats import Splats

MAX_ITERATIONS = 60
MAX_SCALE_CHANGE = 0.2
MIN_POINTS = 50
SURFACE_OPACITY = 0.4
TRUNCATION_VOXELS = 4.0
MIN_PIECE_VOXELS = 12.0
MIN_WEIGHT = 1.5
"""A voxel counts from two views on: what one view alone saw may be a floater."""
BLOCK_VOXELS, FIRST_BLOCKS = 16, 10_000
"""The grid's table grows by itself."""
RAYS_AT_ONCE = 1 << 20


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """image (H,W,3) uint8; depth (H,W) along the axis, 0 where nothing is known; K (3,3) px; cam_from_world (4,4)."""

    image: NDArray[np.uint8]
    depth: NDArray[np.float32]
    K: FloatArray
    cam_from_world: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class IcpFit:
    """Similarity target ← source, the share of source points that met a target within the last radius, and their RMS distance in m."""

    target_from_source: Sim3
    overlap: float
    residual_m: float


def surface_points(splats: Splats, largest_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Means (K,3) m of the Gaussians that make a surface, and which (N,) those are: opaque, and at most
    `largest_m` wide, so no sky and no haze."""
    opaque = splats.logit_opacities > np.log(SURFACE_OPACITY / (1 - SURFACE_OPACITY))
    chosen = opaque & (splats.log_scales.max(axis=1, initial=-np.inf) < np.log(largest_m))
    return splats.means[chosen].astype(np.float64), chosen


def icp_with_scale(source: ArrayLike, target: ArrayLike, start: Sim3, radii_m: Sequence[float]) -> IcpFit | None:
    """Align source (N,3) to target (M,3) from `start` with falling radii; None with under 50 points or when the scale runs away (20 %).

    Raises BadInput on shapes or values that are not finite.
    """
    import open3d as o3d

    source, target = checked_array("source", source, (None, 3)), checked_array("target", target, (None, 3))
    if min(len(source), len(target)) < MIN_POINTS:
        return None
    registration = o3d.pipelines.registration
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points))) for points in (source, target)]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = start.scale * start.rotation, start.translation
    overlap = residual_m = 0.0
    for radius_m in radii_m:
        result = registration.registration_icp(
            clouds[0],
            clouds[1],
            radius_m,
            matrix,
            registration.TransformationEstimationPointToPoint(True),
            registration.ICPConvergenceCriteria(max_iteration=MAX_ITERATIONS),
        )
        matrix, overlap, residual_m = np.array(result.transformation), float(result.fitness), float(result.inlier_rmse)
        determinant = float(np.linalg.det(matrix[:3, :3])) if np.isfinite(matrix).all() else 0.0
        if not abs(np.log(max(determinant, 1e-300)) / 3 - np.log(start.scale)) < MAX_SCALE_CHANGE:
            return None
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    U, _, Vt = np.linalg.svd(matrix[:3, :3])
    fit = Sim3(scale=scale, rotation=U @ Vt, translation=matrix[:3, 3])
    return IcpFit(target_from_source=fit, overlap=overlap, residual_m=residual_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """vertices (V,3) float64; triangles (T,3) int64; colors (V,3) uint8."""

    vertices: FloatArray
    triangles: NDArray[np.int64]
    colors: NDArray[np.uint8]


def fused_mesh(views: Iterable[DepthView], voxel: float, max_depth: float) -> Mesh:
    """The surface that depth views agree on: their truncated signed distances averaged in voxels, then marching cubes; pieces smaller than
    a square of `MIN_PIECE_VOXELS` are left out. May be empty. Source: Curless and Levoy, SIGGRAPH 1996; Open3D's voxel block grid."""
    import open3d as o3d

    # Its stubs know neither numpy arrays nor channels of several sizes.
    core: Any = o3d.core
    cpu, new_grid = core.Device("CPU:0"), cast(Any, o3d.t.geometry.VoxelBlockGrid)
    # The older ScalableTSDFVolume of open3d 0.20 gives an empty mesh.
    grid = new_grid(("tsdf", "weight", "color"), (core.float32,) * 3, ((1,), (1,), (3,)), voxel, BLOCK_VOXELS, FIRST_BLOCKS, cpu)
    for view in views:
        depth = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(view.depth[..., None], np.float32)))
        image = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(view.image, np.float32) / 255))
        # Open3D's first pixel centre is at 0, ours at 0.5.
        K = core.Tensor(view.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
        pose = core.Tensor(np.ascontiguousarray(view.cam_from_world))
        blocks = grid.compute_unique_block_coordinates(depth, K, pose, 1.0, max_depth, TRUNCATION_VOXELS)
        grid.integrate(blocks, depth, image, K, K, pose, 1.0, max_depth, TRUNCATION_VOXELS)
    mesh = grid.extract_triangle_mesh(weight_threshold=MIN_WEIGHT).to_legacy()
    if len(mesh.triangles):
        labels, _, areas = mesh.cluster_connected_triangles()
        small = np.asarray(areas)[np.asarray(labels)] < (MIN_PIECE_VOXELS * voxel) ** 2
        mesh.remove_triangles_by_mask(small.tolist())
        mesh.remove_unreferenced_vertices()
    return Mesh(
        vertices=np.array(mesh.vertices, np.float64).reshape(-1, 3),
        triangles=np.array(mesh.triangles, np.int64).reshape(-1, 3),
        colors=np.rint(255 * np.asarray(mesh.vertex_colors)).astype(np.uint8).reshape(-1, 3),
    )


def heights_from_above(mesh: Mesh, places: ArrayLike) -> FloatArray:
    """Height (P,) of the topmost surface over places (P,2); NaN where there is none. Rays in float32: keep coordinates near the origin."""
    import open3d as o3d

    places = checked_array("places", places, (None, 2))
    if not len(mesh.triangles):
        return np.full(len(places), np.nan)
    tensor = cast(Any, o3d.core.Tensor)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(np.ascontiguousarray(mesh.vertices, np.float32)), tensor(np.ascontiguousarray(mesh.triangles, np.uint32)))
    top = float(mesh.vertices[:, 2].max()) + 1.0
    heights = np.full(len(places), np.nan)
    for start in range(0, len(places), RAYS_AT_ONCE):
        rows = slice(start, start + RAYS_AT_ONCE)
        rays = np.zeros((len(places[rows]), 6), np.float32)
        rays[:, :2], rays[:, 2], rays[:, 5] = places[rows], top, -1.0
        distance = scene.cast_rays(tensor(rays))["t_hit"].numpy().astype(np.float64)
        heights[rows] = np.where(np.isfinite(distance), top - distance, np.nan)
    return heights
