"""What Open3D computes: ICP with scale of surface points, once per pair of models; a mesh from
depth views by a truncated signed distance and its heights, once per surface model.

    (s, R, t) = argmin Σ ‖s R x_i + t − y_c(i)‖², c(i) the nearest target within a falling radius,
    anew in each iteration.
A free scale may collapse: a shrunken cloud has a near neighbour everywhere. So the result says how
it fared both ways. Sources: Besl and McKay, PAMI 14 (1992); Umeyama, PAMI 13 (1991).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

MAX_ITERATIONS = 60
MAX_SCALE_CHANGE = 0.2
MIN_POINTS = 50
SURFACE_OPACITY = 0.4
TRUNCATION_VOXELS = 4.0
MIN_PIECE_VOXELS = 12.0
MIN_WEIGHT = 1.5
"""A voxel counts from two views on: what one view alone saw may be a floater."""
BLOCK_VOXELS = 16
MAX_BLOCKS = 160_000
"""The most that a fusion may take; coarser voxels need fewer."""
BLOCKS_AT_ONCE = 8_192
"""Of a mesh made in one call; larger ones are made in parts, which bounds the memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthView:
    """image (H,W,3) uint8; depth (H,W) along the axis, 0 where nothing is known; K (3,3) px;
    cam_from_world (4,4)."""

    image: NDArray[np.uint8]
    depth: NDArray[np.float32]
    K: FloatArray
    cam_from_world: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class IcpFit:
    """Similarity target ← source, the share of source points that met a target within the last
    radius, and their RMS distance in m."""

    target_from_source: Sim3
    overlap: float
    residual_m: float


def surface_points(splats: Splats, largest_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Means (K,3) m of the Gaussians that make a surface, and which (N,) those are: opaque, and at
    most `largest_m` wide, so no sky and no haze."""
    opaque = splats.logit_opacities > np.log(SURFACE_OPACITY / (1 - SURFACE_OPACITY))
    chosen = opaque & (splats.log_scales.max(axis=1, initial=-np.inf) < np.log(largest_m))
    return splats.means[chosen].astype(np.float64), chosen


def icp_with_scale(source: ArrayLike, target: ArrayLike, start: Sim3, radii_m: Sequence[float]) -> IcpFit | None:
    """Align source (N,3) to target (M,3) from `start` with falling radii; None with fewer than 50
    points or when the scale runs away (20 %). BadInput on shapes or values that are not finite."""
    import open3d as o3d

    source, target = check_array("source", source, (None, 3)), check_array("target", target, (None, 3))
    if min(len(source), len(target)) < MIN_POINTS:
        return None
    registration = o3d.pipelines.registration
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points))) for points in (source, target)]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = start.scale * start.rotation, start.translation
    overlap = residual_m = 0.0
    convergence = registration.ICPConvergenceCriteria(max_iteration=MAX_ITERATIONS)
    estimation = registration.TransformationEstimationPointToPoint(True)
    for radius_m in radii_m:
        result = registration.registration_icp(*clouds, radius_m, matrix, estimation, convergence)
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


def count_blocks(views: Iterable[DepthView], voxel: float, max_depth: float) -> int:
    """For how many blocks of 16³ voxels `fused_mesh` needs room; some 20 ms a view.

    These are all that views see, and once more those of the largest view: Open3D adds a view's
    blocks to what it holds before it checks which of them are new.
    """
    import open3d as o3d

    core: Any = o3d.core
    grid = cast(Any, o3d.t.geometry.VoxelBlockGrid)(("tsdf",), (core.float32,), ((1,),), voxel, BLOCK_VOXELS, 1, core.Device("CPU:0"))
    block_keys, largest = np.zeros(0, np.int64), 0
    for view in views:
        keys = _seen_blocks(grid, view, max_depth).numpy().astype(np.int64) + (1 << 20)
        block_keys = np.union1d(block_keys, (keys[:, 0] << 42) + (keys[:, 1] << 21) + keys[:, 2])
        largest = max(largest, len(keys))
    return len(block_keys) + largest


def fused_mesh(
    views: Iterable[DepthView], voxel: float, max_depth: float, num_blocks: int = 10_000, blocks_at_once: int = BLOCKS_AT_ONCE
) -> Mesh:
    """The surface that depth views agree on: truncated signed distances averaged in voxels, then
    marching cubes, without pieces below a square of `MIN_PIECE_VOXELS`. May be empty. Source:
    Curless and Levoy, SIGGRAPH 1996; Open3D's voxel block grid.

    `num_blocks` of `count_blocks` keeps the grid from growing, which would double it; the mesh is
    made of `blocks_at_once` and less.
    """
    import open3d as o3d

    grid = _empty_grid(voxel, num_blocks)
    for view in views:
        blocks = _seen_blocks(grid, view, max_depth)
        image = o3d.t.geometry.Image(_tensor(np.asarray(view.image, np.float32) / 255))
        depth, pose = _depth_tensors(view)
        # A voxel takes the pixel whose number is its place rounded down: centres at 0.5, as ours.
        K = _tensor(view.K)
        grid.integrate(blocks, depth, image, K, K, pose, 1.0, max_depth, TRUNCATION_VOXELS)
    mesh = _weld_mesh(_pieces(grid, voxel, blocks_at_once))
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


def _tensor(values: NDArray[Any]) -> Any:
    import open3d as o3d

    # Its stubs leave out numpy arrays.
    return cast(Any, o3d.core.Tensor)(np.ascontiguousarray(values))


def _empty_grid(voxel: float, num_blocks: int) -> Any:
    import open3d as o3d

    core: Any = o3d.core
    # The older ScalableTSDFVolume of open3d 0.20 gives an empty mesh.
    new_grid = cast(Any, o3d.t.geometry.VoxelBlockGrid)
    attributes = (("tsdf", "weight", "color"), (core.float32,) * 3, ((1,), (1,), (3,)))
    return new_grid(*attributes, voxel, BLOCK_VOXELS, max(1, num_blocks), core.Device("CPU:0"))


def _depth_tensors(view: DepthView) -> tuple[Any, Any]:
    """A view's depth and cam_from_world as Open3D takes them."""
    import open3d as o3d

    return o3d.t.geometry.Image(_tensor(view.depth[..., None].astype(np.float32))), _tensor(view.cam_from_world)


def _seen_blocks(grid: Any, view: DepthView, max_depth: float) -> Any:
    depth, pose = _depth_tensors(view)
    # Where Open3D turns depth into points, the first pixel centre is at 0, ours at 0.5.
    K = _tensor(view.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    return grid.compute_unique_block_coordinates(depth, K, pose, 1.0, max_depth, TRUNCATION_VOXELS)


def _pieces(grid: Any, voxel: float, blocks_at_once: int) -> Iterator[tuple[FloatArray, NDArray[np.int32], FloatArray]]:
    """The mesh in boxes of blocks: vertices (V,3), triangles (T,3), colors (V,3). Each is made with
    the blocks around its box and holds the triangles whose middle lies in it, so that the next
    box goes on at the very same vertices."""
    rows = grid.hashmap().active_buf_indices().numpy().astype(np.int64)
    keys = grid.hashmap().key_tensor().numpy()[rows].astype(np.int64)
    for low, high in _boxes(keys, blocks_at_once):
        near = _within(keys, low - 1, high + 1)
        mesh = _copy_blocks(grid, voxel, rows[near]).extract_triangle_mesh(weight_threshold=MIN_WEIGHT)
        if "indices" not in mesh.triangle:
            continue
        vertices, triangles = mesh.vertex.positions.numpy(), mesh.triangle.indices.numpy()
        middles = np.floor(vertices[triangles].mean(axis=1) / (BLOCK_VOXELS * voxel))
        used, numbered = np.unique(triangles[_within(middles, low, high)], return_inverse=True)
        yield vertices[used], numbered.reshape(-1, 3).astype(np.int32), mesh.vertex.colors.numpy()[used]


def _boxes(keys: NDArray[np.int64], blocks_at_once: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Boxes, lower corner inclusive and upper one exclusive, that hold all blocks `keys` (B,3),
    each with those around it no more than so many, or a single block."""
    if not len(keys):
        return
    waiting = [(keys.min(axis=0), keys.max(axis=0) + 1)]
    while waiting:
        low, high = waiting.pop()
        inside = keys[_within(keys, low, high)]
        if not len(inside):
            continue
        axis = int(np.argmax(high - low))
        if _within(keys, low - 1, high + 1).sum() <= blocks_at_once or high[axis] - low[axis] == 1:
            yield low, high
            continue
        cut = np.clip(int(np.median(inside[:, axis])), low[axis] + 1, high[axis] - 1)
        edge = np.eye(3, dtype=bool)[axis]
        waiting += [(low, np.where(edge, cut, high)), (np.where(edge, cut, low), high)]


def _within(places: NDArray[Any], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(((places >= low) & (places < high)).all(axis=1))


def _copy_blocks(grid: Any, voxel: float, rows: NDArray[np.int64]) -> Any:
    """A grid of the blocks at `rows` alone."""
    if len(rows) == grid.hashmap().size():
        return grid
    part = _empty_grid(voxel, len(rows))
    row_tensor, _ = part.hashmap().activate(_tensor(grid.hashmap().key_tensor().numpy()[rows]))
    part_rows = row_tensor.numpy().astype(np.int64)
    for name in ("tsdf", "weight", "color"):
        part.attribute(name).numpy()[part_rows] = grid.attribute(name).numpy()[rows]
    return part


def _weld_mesh(pieces: Iterator[tuple[FloatArray, NDArray[np.int32], FloatArray]]) -> Any:
    """Pieces as one mesh of Open3D, with every vertex once."""
    import open3d as o3d

    parts = list(pieces)
    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    mesh = o3d.geometry.TriangleMesh()
    if not parts:
        return mesh
    vertices, colors = (np.concatenate([part[place] for part in parts]).astype(np.float64) for place in (0, 2))
    triangles = np.concatenate([part[1] + start for part, start in zip(parts, starts[:-1], strict=True)])
    mesh.vertices, mesh.vertex_colors = o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3dVector(colors)
    mesh.triangles = o3d.utility.Vector3iVector(triangles.astype(np.int32))
    return mesh if len(parts) == 1 else mesh.remove_duplicated_vertices()
