"""Photographs and depth maps of the town by casting rays (Embree, through Open3D).

    colour = albedo · (ambient + sun · max(0, n·l) · visible · clouds)
             then haze 1 - exp(-t / 2.6 km)

Per photograph: samples² rays per pixel and one shadow ray per hit, in strips of some 30,000 rays so
that every array stays in the cache. A ray's direction has z = 1 in the camera, so the distance
Embree returns is the depth itself.
"""

from __future__ import annotations

from copy import copy
from functools import lru_cache

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from scenegen.alterations import alterations_of
from scenegen.config import SceneConfig
from scenegen.facade import facade_mesh
from scenegen.flight import Shot
from scenegen.ground import linear
from scenegen.layout import Layout
from scenegen.mesh import Mesh
from scenegen.noise import Floats, gaussian_noise, value_noise
from scenegen.room import ROOM_AMBIENT, lamp_light, room_mesh
from scenegen.surfaces import Hits, paint, ruffle_leaves, sky_color
from scenegen.town import build_town
from scenegen.turntable import AMBIENT, LAMP, lamp_direction, turntable_mesh, wall_radiance

STRIP_RAYS = 30_000
SUN_DIRECTION = np.array([0.52, -0.42, 0.74], np.float32) / np.float32(np.sqrt(0.52**2 + 0.42**2 + 0.74**2))
SUN, AMBIENT_SKY, AMBIENT_GROUND = (
    np.array([1.22, 1.14, 1.00], np.float32), np.array([0.36, 0.42, 0.52], np.float32), np.array([0.20, 0.19, 0.17], np.float32),
)  # fmt: skip
HAZE, HAZE_LENGTH_M = linear(0.78, 0.84, 0.90), 2600.0
SHADOW_OFFSET_M = 0.03
CLOUD_CELL_M, WIND_M_PER_S = 45.0, np.array([4.0, 2.5])
SHAKE_SAMPLES = 7


def layout_of(config: SceneConfig) -> Layout:
    """The plan of the scene's ground."""
    return Layout(extent_m=config.extent_m, seed=config.seed, scenery=config.scenery)


def town_of(config: SceneConfig) -> Mesh:
    """The mesh of the scene, with its altered houses; flights over one town share it."""
    if config.flight in _STAGES:
        return _STAGES[config.flight](config.seed)
    return town_mesh(layout_of(config), config.altered_houses)


@lru_cache(maxsize=4)
def town_mesh(layout: Layout, num_altered: int) -> Mesh:
    """The mesh of a town: 1 to 3 s of CPU time, and some 20 MB."""
    return build_town(layout, alterations_of(layout, num_altered))


_STAGES = {"facade": facade_mesh, "room": room_mesh, "turntable": turntable_mesh}
"""Flights over a mesh of their own, and that mesh."""


class Photographer:
    """Holds the town and takes photographs of it with one lens; `of_shot` has that of a shot."""

    def __init__(self, config: SceneConfig) -> None:
        self.config = config
        self.layout = layout_of(config)
        self._mesh: Mesh = town_of(config)
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(o3d.core.Tensor.from_numpy(self._mesh.vertices), o3d.core.Tensor.from_numpy(self._mesh.triangles))

    def with_config(self, config: SceneConfig) -> Photographer:
        """A photographer of the same town with another lens and sensor."""
        other = copy(self)
        other.config = config
        return other

    def of_shot(self, shot: Shot) -> Photographer:
        """The photographer with the camera of the shot."""
        return self if shot.camera == 0 else self.with_config(self.config.of_camera(shot.camera))

    def clearance_m(self, place: NDArray) -> float:
        """Distance from a place (3,) to the nearest surface."""
        return float(np.linalg.norm(self.closest(place[None])[0] - place))

    def closest(self, places: NDArray) -> NDArray[np.float64]:
        """The surface's point (P,3) nearest to each place (P,3)."""
        nearest = self._scene.compute_closest_points(o3d.core.Tensor.from_numpy(places.astype(np.float32)))
        return nearest["points"].numpy().astype(np.float64)

    def photograph(self, shot: Shot, number: int) -> NDArray[np.uint8]:
        """The photograph (H,W,3) sRGB; number selects its sensor noise."""
        config = self.config
        samples, width = config.samples_per_axis, config.width_px
        rows_per_strip = max(1, STRIP_RAYS // (width * samples * samples))
        strips = []
        for top in range(0, config.height_px, rows_per_strip):
            rows = min(rows_per_strip, config.height_px - top)
            x, y = np.meshgrid(
                (np.arange(width * samples) + 0.5) / samples, top + (np.arange(rows * samples) + 0.5) / samples
            )  # fmt: skip
            radiance = self._shaken(shot, np.column_stack([x.ravel(), y.ravel()]))
            strips.append(radiance.reshape(rows, samples, width, samples, 3).mean(axis=(1, 3)))
        return self._develop(np.concatenate(strips), shot.exposure_ev, number)

    def depth(self, shot: Shot) -> Floats:
        """Depth along the viewing axis (H,W) in metres at every pixel's centre; infinite in the
        sky."""
        x, y = np.meshgrid(np.arange(self.config.width_px) + 0.5, np.arange(self.config.height_px) + 0.5)
        return self.depth_at(shot, np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)

    def depth_at(self, shot: Shot, pixels: NDArray) -> Floats:
        """Depth along the viewing axis (N,) in metres at pixels (N,2); infinite in the sky."""
        origins, directions = world_rays(self.config, shot, pixels)
        return self._scene.cast_rays(_rays(origins, directions))["t_hit"].numpy()

    def color_at(self, shot: Shot, pixels: NDArray) -> NDArray[np.uint8]:
        """sRGB colours (N,3) seen at pixels (N,2), without sensor noise."""
        return _encode(self._radiance(shot, pixels))

    def _shaken(self, shot: Shot, pixels: NDArray) -> Floats:
        if shot.shake_px == (0.0, 0.0):
            return self._radiance(shot, pixels)
        places = np.linspace(-0.5, 0.5, SHAKE_SAMPLES)[:, None] * np.array(shot.shake_px)
        return np.mean([self._radiance(shot, pixels + place) for place in places], axis=0).astype(np.float32)

    def _radiance(self, shot: Shot, pixels: NDArray) -> Floats:
        origins, directions = world_rays(self.config, shot, pixels)
        if self.config.flight == "turntable":
            return self._radiance_before_wall(shot, origins, directions)
        return self.radiance_along(origins, directions, shot.time_s)

    def _radiance_before_wall(self, shot: Shot, origins: Floats, directions: Floats) -> Floats:
        answer = {key: value.numpy() for key, value in self._scene.cast_rays(_rays(origins, directions)).items()}
        met = np.isfinite(answer["t_hit"])
        radiance = wall_radiance(shot.cam_from_world, directions, self.layout.salt(71))
        if met.any():
            picked = {key: value[met] for key, value in answer.items()}
            hits = self._hits(origins[met] + directions[met] * picked["t_hit"][:, None], directions[met], picked)
            facing = np.maximum(ruffle_leaves(self.layout, hits) @ lamp_direction(shot.cam_from_world), 0.0)
            radiance[met] = paint(self.layout, hits) * (AMBIENT + LAMP * facing[:, None])
        return radiance

    def developed(self, radiance: Floats) -> NDArray[np.uint8]:
        """sRGB (…,3) of linear radiance, at the middle exposure and without sensor noise."""
        return _encode(radiance)

    def radiance_along(self, origins: Floats, directions: Floats, time_s: float = 0.0) -> Floats:
        """Linear light (N,3) that comes along rays (N,3) from origins (N,3)."""
        answer = {key: value.numpy() for key, value in self._scene.cast_rays(_rays(origins, directions)).items()}
        length = np.linalg.norm(directions, axis=1)
        met = np.isfinite(answer["t_hit"])
        radiance = np.empty((len(directions), 3), np.float32)
        if not met.all():
            radiance[~met] = sky_color(self.layout, directions[~met] / length[~met, None])
        if met.any():
            picked = {key: value[met] for key, value in answer.items()}
            hits = self._hits(origins[met] + directions[met] * picked["t_hit"][:, None], directions[met], picked)
            seen = np.exp(-picked["t_hit"] * length[met] / HAZE_LENGTH_M)[:, None]
            lit = self._lit_by_lamps(hits) if self.config.flight == "room" else self._lit(hits, time_s)
            radiance[met] = lit * seen + HAZE * (1.0 - seen)
        return radiance

    def _hits(self, points: Floats, directions: Floats, answer: dict[str, NDArray]) -> Hits:
        """Interpolate the attributes of the triangles that were hit; normals face the camera."""
        triangle = answer["primitive_ids"].astype(np.int64)
        second, third = answer["primitive_uvs"].T
        weights = np.stack([1.0 - second - third, second, third], axis=1)
        corners = self._mesh.triangles[triangle].astype(np.int64)
        normals = np.einsum("nk,nkc->nc", weights, self._mesh.normals[corners])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        toward = np.einsum("nc,nc->n", normals, directions) / np.linalg.norm(directions, axis=1)
        normals = np.where((toward > 0.0)[:, None], -normals, normals)
        pixel_m = answer["t_hit"] / self.config.focal_px / np.maximum(np.abs(toward), 0.12)
        return Hits(
            points=points, normals=normals, uvs=np.einsum("nk,nkc->nc", weights, self._mesh.uvs[corners]),
            materials=self._mesh.materials[triangle], tints=self._mesh.tints[triangle],
            numbers=self._mesh.numbers[triangle], footprint_m=pixel_m.astype(np.float32),
        )  # fmt: skip

    def _lit_by_lamps(self, hits: Hits) -> Floats:
        """Light of a room's lamps reflected by hits (N,3)."""
        normals = ruffle_leaves(self.layout, hits)
        from_points = hits.points + hits.normals * np.float32(SHADOW_OFFSET_M)
        light = np.tile(ROOM_AMBIENT, (len(from_points), 1))
        for to_lamp, strength in lamp_light(from_points, normals):
            # A direction as long as the way, so that nothing beyond the lamp is in it.
            shadowed = self._scene.test_occlusions(_rays(from_points, to_lamp), tfar=1.0).numpy()
            light += strength * ~shadowed[:, None]
        return paint(self.layout, hits) * light

    def _through_clouds(self, points: Floats, time_s: float) -> Floats:
        """Share (N,) of the sun that clouds leave at points (N,3): they are as wide as a few houses
        and drift with the wind."""
        if self.config.cloud_shadow == 0.0:
            return np.ones(len(points), np.float32)
        x, y = (points[:, :2] - WIND_M_PER_S * time_s).T.astype(np.float32)
        cover = value_noise(x, y, CLOUD_CELL_M, self.layout.salt(72))
        return 1.0 - np.float32(self.config.cloud_shadow) * np.clip(4.0 * (cover - 0.4), 0.0, 1.0)

    def _lit(self, hits: Hits, time_s: float) -> Floats:
        """Light of sky, ground and sun reflected by hits (N,3)."""
        normals = ruffle_leaves(self.layout, hits)
        facing = np.maximum(normals @ SUN_DIRECTION, 0.0)
        from_points = hits.points + hits.normals * np.float32(SHADOW_OFFSET_M)
        shadowed = self._scene.test_occlusions(_rays(from_points, np.broadcast_to(SUN_DIRECTION, hits.points.shape))).numpy()
        upward = (0.5 + 0.5 * normals[:, 2])[:, None]
        ambient = AMBIENT_SKY * upward + AMBIENT_GROUND * (1.0 - upward)
        return paint(self.layout, hits) * (ambient + SUN * (facing * ~shadowed * self._through_clouds(hits.points, time_s))[:, None])

    def _develop(self, radiance: Floats, exposure_ev: float, number: int) -> NDArray[np.uint8]:
        """Exposure, sRGB curve, sensor noise, rounding."""
        encoded = _encode(radiance * np.float32(2.0**exposure_ev))
        if self.config.noise_sigma == 0.0:
            return encoded
        noise = gaussian_noise(encoded.size, self.layout.salt(63) + 7919 * number).reshape(encoded.shape)
        return np.clip(np.rint(encoded + self.config.noise_sigma * noise), 0, 255).astype(np.uint8)


def project(config: SceneConfig, shot: Shot, points_m: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (N,2) and depths (N,) of world points (N,3); pixels are NaN behind the camera or where
    the lens folds."""
    in_camera = points_m @ shot.cam_from_world[:3, :3].T + shot.cam_from_world[:3, 3]
    depth = in_camera[:, 2]
    plane = in_camera[:, :2] / np.where(depth > 0.0, depth, np.nan)[:, None]
    bend = config.distortion_k1 * np.sum(plane**2, axis=1, keepdims=True)
    bent = plane * np.where(1.0 + 3.0 * bend > 0.0, 1.0 + bend, np.nan)
    return bent * config.focal_px + np.array([config.width_px, config.height_px]) / 2.0, depth


def world_rays(config: SceneConfig, shot: Shot, pixels: NDArray) -> tuple[Floats, Floats]:
    """Origins and directions (N,3) through pixels (N,2), with length 1 along the camera's axis."""
    bent = (pixels - np.array([config.width_px, config.height_px]) / 2.0) / config.focal_px
    plane = undistort(bent, config.distortion_k1)
    in_camera = np.column_stack([plane, np.ones(len(plane))])
    directions = in_camera @ shot.cam_from_world[:3, :3]
    return np.broadcast_to(shot.center_m, directions.shape).astype(np.float32), directions.astype(np.float32)


def undistort(bent: NDArray, k1: float) -> NDArray[np.float64]:
    """The plane coordinates x (N,2) with x (1 + k1 |x|²) = bent, by Newton's method on the radius;
    exact to rounding."""
    if k1 == 0.0:
        return bent
    target = np.linalg.norm(bent, axis=1)
    radius = target.copy()
    for _ in range(20):
        radius -= (radius * (1.0 + k1 * radius**2) - target) / (1.0 + 3.0 * k1 * radius**2)
    return bent * np.divide(radius, target, out=np.ones_like(target), where=target > 0.0)[:, None]


def _rays(origins: NDArray, directions: NDArray) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(np.concatenate([origins, directions], axis=1).astype(np.float32))


def _encode(radiance: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB (…,3) of linear radiance, with a soft shoulder above 0.8 as a camera's tone curve
    has."""
    bright = np.maximum(radiance - np.float32(0.8), 0.0)
    toned = np.minimum(radiance, np.float32(0.8)) + np.float32(0.2) * (np.float32(1.0) - np.exp(-bright / np.float32(0.2)))
    curve = np.where(toned <= 0.0031308, 12.92 * toned, 1.055 * np.power(np.maximum(toned, 1e-6), 1.0 / 2.4) - 0.055)
    return np.rint(255.0 * np.clip(curve, 0.0, 1.0)).astype(np.uint8)
