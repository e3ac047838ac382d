"""A scene as files that other programs open: GeoJSON, a COLMAP model, SPZ. Once per export.

GeoJSON is WGS84 (RFC 7946); cameras stand at their reconstructed centres. The COLMAP model is text,
in the scene's own frame (metres east, north, up of its origin where GPS fixed it); 2D points are
where the cameras project the points, so their errors are zero by construction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.choices import SpzVersion
from radiant_core.errors import BadInput
from radiant_core.export.plan import land_features, point_feature, write_features
from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.crs import Crs
from radiant_core.georef.reference import require_heights
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, check_model
from radiant_core.io.open3d_formats import SPZ_MAX_LOG_SCALE, SPZ_MAX_MEAN, spz_bytes
from radiant_core.io.run_store import write_atomic
from radiant_core.io.spz import SPZ_FRACTION_BITS, gzip_spz_bytes
from radiant_core.io.spz_cuts import SpzCuts, fraction_bits_of, spz_cuts, within_reach
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats, morton_order

DEFAULT_SPZ_VERSION: SpzVersion = 2


def save_spz(path: Path, splats: Splats, version: SpzVersion = DEFAULT_SPZ_VERSION) -> SpzCuts:
    """Write a model as SPZ in its own coordinates, atomically, and return what it lost; BadInput
    when no Gaussian lies within its reach."""
    bits = fraction_bits_of(splats)
    inside = within_reach(splats, bits)
    result = splats.select(inside)
    if not len(result):
        raise BadInput(
            f"cannot write {path}: none of {len(splats)} Gaussians lies within {SPZ_MAX_MEAN * 2.0 ** (SPZ_FRACTION_BITS - bits):.0f} units"
            " of the origin, as far as SPZ places Gaussians of this size: write PLY, or SOG."
        )
    result = replace(result, log_scales=np.minimum(result.log_scales, np.float32(SPZ_MAX_LOG_SCALE)))
    # Along a Z curve neighbours share their high bytes, which gzip finds.
    write_atomic(
        path, spz_bytes(result, bits) if version == 4 else gzip_spz_bytes(result.select(morton_order(result.means)), version, bits)
    )
    return spz_cuts(splats, bits)


def save_scene_geojson(
    path: Path,
    scene: SfmScene,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    about_camera: Mapping[str, Mapping[str, Any]],
    crs: Crs | None = None,
) -> None:
    """Regions and strips as polygons, cameras as points that `about_camera` describes by name, in
    `crs` or else longitude and latitude; BadInput without GPS."""
    if scene.frame.kind != "metric":
        raise BadInput(f"cannot write {path}: no GPS fixed where the scene lies, and GeoJSON knows only longitude and latitude.")
    if crs is not None:
        require_heights(scene.frame, crs)
        crs = crs.at(*scene.frame.origin_lat_lon_alt[:2].tolist())
    write_features(path, _scene_features(scene, cloud_plan, edge_plans, about_camera), crs)


def colmap_model(scene: SfmScene) -> ColmapModel:
    """The scene as COLMAP's records, one PINHOLE camera per distinct size and K."""
    cameras = scene.cameras
    kinds, kind_of_image = np.unique(_intrinsics(scene), axis=0, return_inverse=True)
    kind_of_image = kind_of_image.ravel()
    colmap_cameras = [
        ColmapCamera(camera_id=index + 1, model="PINHOLE", size_wh=(int(kind[0]), int(kind[1])), params=tuple(kind[2:].tolist()))
        for index, kind in enumerate(kinds)
    ]
    # By camera, then by point: the order of an image's 2D points, which tracks refer to.
    points_of = [np.unique(rows) for rows in scene.points_of_cameras()]
    images, tracks = [], [np.zeros((0, 3), np.int64)]
    for index, points in enumerate(points_of):
        pose = cameras.cam_from_world[index]
        in_camera = scene.points[points] @ pose[:3, :3].T + pose[:3, 3]
        depths = np.where(np.abs(in_camera[:, 2:]) > 1e-12, in_camera[:, 2:], 1e-12)
        images.append(
            ColmapImage(
                image_id=index + 1,
                name=cameras.names[index],
                camera_id=int(kind_of_image[index]) + 1,
                quat_wxyz=_quat_wxyz(pose[:3, :3]),
                translation=pose[:3, 3],
                points2d=(in_camera @ cameras.Ks[index].T)[:, :2] / depths,
                point3d_ids=points + 1,
            )
        )
        tracks.append(np.column_stack([points, np.full(len(points), index + 1), np.arange(len(points))]))
    joined = np.concatenate(tracks)
    count = len(scene.points)
    points3d = ColmapPoints(
        ids=np.arange(count) + 1,
        xyz=scene.points,
        colors=scene.colors,
        errors_px=np.zeros(count),
        tracks=joined[np.lexsort((joined[:, 1], joined[:, 0]))],
    )
    return check_model(colmap_cameras, images, points3d, "the exported model")


def _intrinsics(scene: SfmScene) -> np.ndarray:
    Ks = scene.cameras.Ks
    return np.column_stack([scene.cameras.sizes_wh, Ks[:, 0, 0], Ks[:, 1, 1], Ks[:, 0, 2], Ks[:, 1, 2]])


def _quat_wxyz(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)


def _scene_features(
    scene: SfmScene, cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], about_camera: Mapping[str, Mapping[str, Any]]
) -> Iterator[dict[str, Any]]:
    origin = scene.frame.origin_lat_lon_alt
    yield from land_features(cloud_plan, edge_plans, origin)
    places = geodetic_from_enu(scene.cameras.centers, origin)
    for name, place in zip(scene.cameras.names, places, strict=True):
        about = {"kind": "camera", "name": name, **about_camera.get(name, {})}
        yield point_feature(place, about, altitude_known=scene.frame.altitude_known)
