"""A painted floor under cameras that look down, with the fields that are small enough to learn it in a test."""

from __future__ import annotations

import numpy as np

from benchmarks.fields.bounds import FieldBounds
from benchmarks.fields.field import FieldConfig
from benchmarks.fields.fit import FitFieldConfig
from benchmarks.fields.hash_grid import GridConfig
from benchmarks.fields.render import Sampling
from radiant_core.frames import Frame
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above

SIZES = FieldConfig(grid=GridConfig(num_levels=6, log2_entries=10, coarsest=4, finest=64), width=16, num_codes=7)
FIT = FitFieldConfig(num_steps=30, rays_a_step=256, sampling=Sampling(num_coarse=16, num_fine=16))


def paint(xy: FloatArray) -> FloatArray:
    """Colours (…,3) of places (…,2) m of the floor."""
    x, y = xy[..., 0], xy[..., 1]
    return 0.5 + 0.4 * np.stack([np.sin(1.3 * x), np.cos(1.7 * y), np.sin(x + 0.8 * y)], axis=-1)


def floor_scene(num_side: int = 3, *, offset_m: float = 0.0) -> tuple[SfmScene, TrainingViews]:
    """The floor at z = 0 between −4 and 4 m, with points on it, and its photographs from above; their poses are all off by
    `offset_m` along x."""
    places = np.linspace(-2.5, 2.5, num_side)
    cameras = cameras_above([(x, y) for x in places for y in places], size_wh=(24, 18))
    images = []
    for index, center in enumerate(cameras.centers):
        rows, columns = np.mgrid[:18, :24] + 0.5
        K = cameras.Ks[index]
        along = np.stack([(columns - K[0, 2]) / K[0, 0], -(rows - K[1, 2]) / K[1, 1]], axis=-1)
        images.append(np.rint(255 * paint(center[:2] + center[2] * along)).astype(np.uint8))
    side = np.linspace(-4, 4, 9)
    points = np.array([(x, y, 0.4 * np.sin(3 * x + y)) for x in side for y in side])
    seen = [(point, camera) for camera in range(len(cameras)) for point in np.flatnonzero(cameras.select([camera]).any_sees(points))]
    poses = cameras.cam_from_world.copy()
    poses[:, :3, 3] -= poses[:, :3, :3] @ [offset_m, 0, 0]
    moved = type(cameras)(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh)
    scene = SfmScene(
        cameras=moved,
        points=points,
        colors=np.rint(255 * paint(points[:, :2])).astype(np.uint8),
        observations=np.array(seen, np.int64),
        frame=Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3)),
    )
    return scene, TrainingViews(cameras=moved, images=tuple(images))


def bounds_of(scene: SfmScene) -> FieldBounds:
    """The field's place around the floor."""
    return FieldBounds.of(scene)
