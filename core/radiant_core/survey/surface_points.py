"""Points of the surface that at least three photographs, or views of the model, agree on. Once per
surface; 0.13 CPU seconds per photograph (docs/experiments/surface.md).

Photographs are matched as dense points for training are (`train.dense`): planes of inverse depth at
every fifth pixel. Here a point is asked of every `STRIDE_PX`-th pixel, on the plane of its nearest
node, and kept by the same test over partners: back to within 1 px, depths within 1 %. Without
photographs, depth rendered from the model goes the same way: haze that one view shows as a surface,
others do not agree on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.surface import sharpen_opacities, trusted_depth
from radiant_core.render.rendered_view import RenderedView, use_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.threads import in_order, usual_threads
from radiant_core.train.dense.depth_planes import DepthPlanes
from radiant_core.train.dense.fuse import DensePoints, agreed_points
from radiant_core.train.dense.points import NUM_CHECKED, depth_maps, smaller_views
from radiant_core.train.dense.sources import choose_sources
from radiant_core.train.stored_images import Images
from radiant_core.train.views import TrainingViews

STRIDE_PX = 2
MAX_DEPTH = 3.0
"""Rendered depth beyond so many usual depths is sky or horizon."""
Report = Callable[[int, int], None]
Used = TypeVar("Used")


def _as_they_are(points: DensePoints) -> DensePoints:
    return points


def points_of_photographs(scene: SfmScene, views: TrainingViews, *, num_threads: int, report: Report) -> Iterator[DensePoints]:
    """Agreed points of each of C photographs, whose cameras are the scene's; `report` gets
    photographs matched and then checked, and their total.

    Raises BadInput where no two photographs share points.
    """
    views = smaller_views(views)
    partners = choose_sources(scene, NUM_CHECKED)
    total = 2 * len(views)
    maps = depth_maps(scene, views, partners, seed=0, num_threads=num_threads, report=lambda num_done: report(num_done, total))
    matched = _Matched(maps=maps, cameras=views.cameras, partners=partners, images=views.images)
    for index in matched.rows:
        report(len(views) + index, total)
        yield matched.points(index)


def points_of_model(
    splats: Splats, scene: SfmScene, long_side_px: int, reach: float, report: Report, use: Callable[[DensePoints], Used] = _as_they_are
) -> Iterator[Used]:
    """Agreed points of the model seen by each of the scene's C cameras, or what `use` makes of
    them, in threads as they come; `reach` is the usual depth. Raises BadInput where no camera has a
    neighbour that sees the same."""
    cameras = scene.cameras.scaled(long_side_px)
    maps: list[DepthPlanes | None] = []
    images: list[NDArray[np.uint8]] = []

    def planes_of(index: int, view: RenderedView) -> tuple[DepthPlanes, NDArray[np.uint8]]:
        return planes_of_depth(trusted_depth(view, MAX_DEPTH * reach)), view.image_bytes

    for planes, image in use_views(sharpen_opacities(splats), cameras, planes_of):
        report(len(maps), 2 * len(cameras))
        maps.append(planes)
        images.append(image)
    matched = _Matched(maps=maps, cameras=cameras, partners=_partners(scene), images=tuple(images))
    used = in_order(lambda index: use(matched.points(index)), matched.rows, usual_threads())
    for index, part in zip(matched.rows, used, strict=True):
        report(len(cameras) + index, 2 * len(cameras))
        yield part


def planes_of_depth(depth: NDArray[np.float32]) -> DepthPlanes:
    """The planes of a depth map (H,W), 0 where nothing is known, at every STRIDE_PX-th pixel."""
    valid = depth > 0
    w = np.where(valid, 1 / np.where(valid, depth, 1), 0).astype(np.float32)
    slopes = [cv2.filter2D(w, cv2.CV_32F, kernel) for kernel in (np.array([[-0.5, 0, 0.5]]), np.array([[-0.5], [0], [0.5]]))]
    # A slope next to nothing known would be one into the sky.
    inner = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    planes = np.stack([w, *(np.where(inner, slope, 0) for slope in slopes)])[:, ::STRIDE_PX, ::STRIDE_PX]
    costs = np.where(valid, 0, 2).astype(np.float32)[::STRIDE_PX, ::STRIDE_PX]
    return DepthPlanes(planes=np.ascontiguousarray(planes, np.float32), costs=costs, first=0, step=STRIDE_PX)


def finer(planes: DepthPlanes, shape: tuple[int, int]) -> DepthPlanes:
    """The same planes at every STRIDE_PX-th pixel of an image (height, width): each pixel on the
    plane of its nearest node."""
    rows, columns = (np.arange(0, side, STRIDE_PX) for side in shape)
    at = [
        np.clip(np.rint((along - planes.first) / planes.step), 0, count - 1).astype(np.int64)
        for along, count in zip((rows, columns), planes.costs.shape, strict=True)
    ]
    w, a, b = planes.planes[:, at[0][:, None], at[1]]
    away_x, away_y = columns - (planes.first + planes.step * at[1]), rows - (planes.first + planes.step * at[0])
    moved = np.stack([w + a * away_x + b * away_y[:, None], a, b]).astype(np.float32)
    return DepthPlanes(planes=moved, costs=planes.costs[at[0][:, None], at[1]], first=0, step=STRIDE_PX)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Matched:
    """Photographs or views with a map each, None where there is none, and who checks whom. Raises
    BadInput where nobody checks anything."""

    maps: list[DepthPlanes | None]
    cameras: Cameras
    partners: Sequence[NDArray[np.int64]]
    images: Images

    def __post_init__(self) -> None:
        if not any(len(others) > 1 for others in self.partners):
            raise BadInput("no photograph shares points with two others, so no height can be checked: add photographs that overlap.")

    @property
    def rows(self) -> list[int]:
        """Those with a map."""
        return [index for index, planes in enumerate(self.maps) if planes is not None]

    def points(self, index: int) -> DensePoints:
        """What enough partners agree on."""
        width, height = self.cameras.sizes_wh[index].tolist()
        planes, maps = self.maps[index], list(self.maps)
        maps[index] = planes if planes is None or planes.step == STRIDE_PX else finer(planes, (height, width))
        return agreed_points(maps, self.cameras, index, self.partners[index], self.images[index])


def _partners(scene: SfmScene) -> Sequence[NDArray[np.int64]]:
    """Who checks whom: by shared points, or, where the scene has no tracks, the nearest cameras."""
    if len(scene.observations):
        return choose_sources(scene, NUM_CHECKED)
    count = min(NUM_CHECKED + 1, len(scene.cameras))
    near = KDTree(scene.cameras.centers).query(scene.cameras.centers, k=count)[1].reshape(len(scene.cameras), -1)
    return [row[row != index].astype(np.int64) for index, row in enumerate(near)]
