"""Panoramas of a town's street with their true poses, by a writer that shares nothing with the reader.

A photographer's rays (sample_scenes) render six faces of a cube at each place; cv2.remap makes one equirectangular picture
of them from headings and elevations, as the panorama's own description (GPano) counts them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_scenes"))

from scenegen.config import SceneConfig
from scenegen.flight import Shot
from scenegen.photo_file import geodetic_from_enu
from scenegen.raycast import Photographer

WIDE_DEG = 94.0
"""Of a rendered face: more than its share of the sphere, so that no border shows."""
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="equirectangular" '
    'GPano:FullPanoWidthPixels="{0}" GPano:CroppedAreaImageWidthPixels="{1}"/></rdf:RDF></x:xmpmeta>'
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """Names, centres (N,3) in metres east, north, up, and axes (N,3,3) of panoramas: rows right, down, forward of the middle."""

    names: list[str]
    centers: np.ndarray
    axes: np.ndarray
    width: int


def walk(num: int, width: int, *, step_m: float = 1.5, seed: int = 3) -> Walk:
    """Places to and fro along the middle street, held upright to a few degrees, turned as one walks."""
    config = street(width)
    photographer, rng = Photographer(config), np.random.default_rng(seed)
    layout, centers, axes = photographer.layout, [], []
    half = (num + 1) // 2
    for number in range(num):
        along, side = (number % half - (half - 1) / 2) * step_m, -1.3 if number < half else 1.3
        x, y = layout.world_from_town(along + rng.uniform(-0.2, 0.2), side + rng.uniform(-0.2, 0.2))
        ground = float(layout.height_m(np.array([x]), np.array([y]))[0])
        heading = layout.heading_rad(along, side) + np.deg2rad(rng.uniform(-40, 40))
        forward = np.array([np.cos(heading), np.sin(heading), np.tan(np.deg2rad(rng.uniform(-3, 3)))])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [np.sin(np.deg2rad(rng.uniform(-3, 3))), 0, 1])
        right /= np.linalg.norm(right)
        centers.append([x, y, ground + 2.2 + rng.uniform(-0.2, 0.2)])
        axes.append(np.stack([right, np.cross(forward, right), forward]))
    return Walk(
        names=[f"pano_{number:03d}.jpg" for number in range(num)],
        centers=np.array(centers),
        axes=np.array(axes),
        width=width,
    )


def street(width: int, samples: int = 1) -> SceneConfig:
    """The town; a photograph of it is one square face."""
    side = max(64, width // 3)
    lens_mm = 18 / np.tan(np.deg2rad(WIDE_DEG / 2))
    return SceneConfig(
        flight="street", width_px=side, height_px=side, lens_mm=float(lens_mm), samples_per_axis=samples, num_cameras=2, gps=False
    )


def write_walk(folder: Path, made: Walk, *, samples: int = 1, xmp: bool = True, gps: bool = False) -> None:
    """The panoramas as JPEG files in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    photographer = Photographer(street(made.width, samples))
    for number, name in enumerate(made.names):
        picture = panorama(photographer, made.centers[number], made.axes[number], made.width)
        jpeg = cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        head = xmp_segment(made.width, made.width) if xmp else b""
        if gps:
            from radiant_core.io.film.exif import with_position

            jpeg = with_position(jpeg, geodetic_from_enu(made.centers[number]))
        (folder / name).write_bytes(jpeg[:2] + head + jpeg[2:])


def seen_points(made: Walk, per_panorama: int = 60, seed: int = 5) -> tuple[np.ndarray, np.ndarray, list[dict[int, tuple[float, float]]]]:
    """Surface points (P,3), their colours (P,3), and what each panorama shows of them: point to column and row in px."""
    photographer, rng = Photographer(street(made.width)), np.random.default_rng(seed)
    points, colors = [], []
    for center, axes in zip(made.centers, made.axes, strict=True):
        rays = rng.normal(size=(4 * per_panorama, 3)) * (1, 1, 0.5)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        distance_m = distances(photographer, center, rays)
        near = np.flatnonzero(distance_m < 25)[:per_panorama]
        points.append(center + rays[near] * distance_m[near, None])
        lit = photographer.radiance_along(np.tile(center, (len(near), 1)).astype(np.float32), rays[near].astype(np.float32))
        colors.append(photographer.developed(lit))
        del axes
    joined, seen = np.concatenate(points), []
    for center, axes in zip(made.centers, made.axes, strict=True):
        way = joined - center
        far_m = np.linalg.norm(way, axis=1)
        shown = np.abs(distances(photographer, center, way / far_m[:, None]) - far_m) < 0.02
        across, below, ahead = (way @ axes.T).T
        heading, drop = np.degrees(np.arctan2(across, ahead)), np.degrees(np.arcsin(below / far_m))
        columns, rows = (heading / 360 + 0.5) * made.width, (drop / 180 + 0.5) * made.width / 2
        seen.append({int(row): (columns[row], rows[row]) for row in np.flatnonzero(shown)})
    return joined, np.concatenate(colors), seen


def distances(photographer: Photographer, center: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Metres (N,) to what rays (N,3) of length 1 meet first."""
    import open3d as o3d

    cast = np.concatenate([np.tile(center, (len(rays), 1)), rays], axis=1).astype(np.float32)
    return photographer._scene.cast_rays(o3d.core.Tensor.from_numpy(cast))["t_hit"].numpy()


def xmp_segment(full: int, shown: int) -> bytes:
    content = b"http://ns.adobe.com/xap/1.0/\0" + XMP.format(full, shown).encode()
    return b"\xff\xe1" + (len(content) + 2).to_bytes(2, "big") + content


def panorama(photographer: Photographer, center: np.ndarray, axes: np.ndarray, width: int) -> np.ndarray:
    """(W/2,W,3) RGB."""
    right, down, forward = axes
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(width // 2) + 0.5)
    heading, elevation = np.deg2rad(column / width * 360 - 180), np.deg2rad(90 - row / (width // 2) * 180)
    level = np.cos(elevation)
    rays = level[..., None] * (np.cos(heading)[..., None] * forward + np.sin(heading)[..., None] * right)
    rays = rays - np.sin(elevation)[..., None] * down
    views = [(forward, -down), (-forward, -down), (right, -down), (-right, -down), (down, forward), (-down, forward)]
    ahead = np.stack([rays @ look for look, _ in views])
    nearest, picture = ahead.argmax(axis=0), np.zeros((width // 2, width, 3), np.uint8)
    side = photographer.config.width_px
    focal = side / 2 / np.tan(np.deg2rad(WIDE_DEG / 2))
    for number, (look, top) in enumerate(views):
        across = np.cross(look, top)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([across, -top, look])
        pose[:3, 3] = -pose[:3, :3] @ center
        shot = Shot(name="", cam_from_world=pose, gps_position_m=center, time_s=0.0, exposure_ev=0.0)
        face = photographer.photograph(shot, number)
        depth = np.maximum(ahead[number], 1e-6)
        at = [(focal * (rays @ axis) / depth + side / 2 - 0.5).astype(np.float32) for axis in (across, -top)]
        shown = cv2.remap(face, at[0], at[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        picture[nearest == number] = shown[nearest == number]
    return picture
