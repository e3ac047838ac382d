"""The truth beside the photographs: a COLMAP text model with exact cameras and surface points, and
the frame's origin.

Points are what randomly chosen pixels see; a point's track is every photograph whose depth there
agrees within 0.2 %. Once per scene: P · C projections and as many rays.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenegen.alterations import houses_of
from scenegen.config import SceneConfig
from scenegen.flight import Shot
from scenegen.photo_file import ORIGIN_ALT_M, ORIGIN_LAT_DEG, ORIGIN_LON_DEG
from scenegen.raycast import Photographer, project, world_rays

DEPTH_AGREEMENT = 2e-3
BORDER_PX = 1.0
MIN_CONTRAST, TRIED_PER_POINT = 8.0, 4
"""Levels of 255 by which a textured point differs from what is 1.5 px to the right and below."""


def write_known_model(folder: Path, photographer: Photographer, shots: list[Shot]) -> None:
    """Write cameras.txt, images.txt, points3D.txt and frame.json into folder."""
    config = photographer.config
    points, colors = _surface_points(photographer, shots)
    views = [_visible(photographer.of_shot(shot), shot, points) for shot in shots]
    num_views = np.zeros(len(points), np.int64)
    for seen, _ in views:
        num_views[seen] += 1
    ids = np.where(num_views >= 2, np.cumsum(num_views >= 2), 0)
    views = [(seen[ids[seen] > 0], pixels[ids[seen] > 0]) for seen, pixels in views]
    (folder / "cameras.txt").write_text(_camera_texts(config))
    images = [_image_text(k, shot, ids[seen], pixels) for k, (shot, (seen, pixels)) in enumerate(zip(shots, views, strict=True))]
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text(_points_text(points, colors, ids, [seen for seen, _ in views]))
    origin = {"origin_lat_deg": ORIGIN_LAT_DEG, "origin_lon_deg": ORIGIN_LON_DEG, "origin_alt_m": ORIGIN_ALT_M}
    (folder / "frame.json").write_text(json.dumps({**origin, "axes": "east-north-up", "config": asdict(config)}, indent=1) + "\n")
    if config.altered_houses:
        houses = [asdict(house) for house in houses_of(photographer.layout, config.altered_houses)]
        (folder / "houses.json").write_text(json.dumps(houses, indent=1) + "\n")


def write_cameras(folder: Path, config: SceneConfig, shots: list[Shot]) -> None:
    """Write a COLMAP text model of exact cameras without points into folder."""
    nothing = np.zeros(0, np.int64), np.zeros((0, 2))
    (folder / "cameras.txt").write_text(_camera_texts(config))
    (folder / "images.txt").write_text("".join(_image_text(k, shot, *nothing) for k, shot in enumerate(shots)))
    (folder / "points3D.txt").write_text("")


def _surface_points(photographer: Photographer, shots: list[Shot]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (P,3) within reach of the flight that random pixels of all photographs see, with their
    colours (P,3)."""
    config = photographer.config
    rng = np.random.default_rng([config.seed, 2])
    # An eighth more than asked for: points beyond the area and points seen once fall away.
    per_shot = -(-config.num_known_points * 9 // (8 * len(shots)))
    points, colors = [], []
    for shot in shots:
        own = photographer.of_shot(shot)
        pixels = _chosen_pixels(own, shot, per_shot, rng)
        depth = own.depth_at(shot, pixels).astype(np.float64)
        near = np.isfinite(depth) & (depth < 3.0 * config.altitude_m)
        origins, directions = world_rays(own.config, shot, pixels[near])
        points.append(origins.astype(np.float64) + directions.astype(np.float64) * depth[near, None])
        colors.append(own.color_at(shot, pixels[near]))
    return np.concatenate(points)[: config.num_known_points], np.concatenate(colors)[: config.num_known_points]


def _chosen_pixels(photographer: Photographer, shot: Shot, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Random pixels (K,2) of a shot: `count`, or where textured points are asked for those of
    several times as many that have contrast, at most `count`."""
    config = photographer.config
    size = np.array([config.width_px, config.height_px])
    if not config.textured_points:
        return rng.uniform(0.0, 1.0, (count, 2)) * size
    pixels = rng.uniform(0.0, 1.0, (TRIED_PER_POINT * count, 2)) * size
    color = photographer.color_at(shot, pixels).astype(np.float64)
    aside = [photographer.color_at(shot, pixels + step).astype(np.float64) for step in (np.array([1.5, 0.0]), np.array([0.0, 1.5]))]
    contrast = np.min([np.abs(other - color).max(axis=1) for other in aside], axis=0)
    return pixels[contrast >= MIN_CONTRAST][:count]


def _visible(photographer: Photographer, shot: Shot, points: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers (K,) of the points that the shot sees, with their pixels (K,2)."""
    config = photographer.config
    pixels, depth = project(config, shot, points)
    size = np.array([config.width_px, config.height_px])
    inside = np.all((pixels > BORDER_PX) & (pixels < size - BORDER_PX), axis=1)
    candidates = np.flatnonzero(inside)
    surface = photographer.depth_at(shot, pixels[candidates])
    seen = np.abs(surface - depth[candidates]) < DEPTH_AGREEMENT * depth[candidates]
    return candidates[seen], pixels[candidates[seen]]


def _camera_texts(config: SceneConfig) -> str:
    return "".join(_camera_text(number + 1, config.of_camera(number)) for number in range(config.num_lenses))


def _camera_text(number: int, config: SceneConfig) -> str:
    middle = f"{config.width_px / 2.0} {config.height_px / 2.0}"
    focal = repr(float(config.focal_px))
    if config.distortion_k1 == 0.0:
        return f"{number} PINHOLE {config.width_px} {config.height_px} {focal} {focal} {middle}\n"
    return f"{number} SIMPLE_RADIAL {config.width_px} {config.height_px} {focal} {middle} {config.distortion_k1!r}\n"


def _image_text(number: int, shot: Shot, ids: NDArray, pixels: NDArray) -> str:
    x, y, z, w = Rotation.from_matrix(shot.cam_from_world[:3, :3]).as_quat()
    pose = " ".join(f"{value:.12g}" for value in (w, x, y, z, *shot.cam_from_world[:3, 3]))
    observations = " ".join(f"{u:.2f} {v:.2f} {point}" for (u, v), point in zip(pixels, ids, strict=True))
    return f"{number + 1} {pose} {shot.camera + 1} {shot.name}\n{observations}\n"


def _points_text(points: NDArray, colors: NDArray, ids: NDArray, seen_by_shot: list[NDArray]) -> str:
    """Lines of id, position, colour, error 0, and the track as (image, observation) pairs."""
    tracks: list[list[str]] = [[] for _ in points]
    for number, seen in enumerate(seen_by_shot):
        for observation, point in enumerate(seen):
            tracks[point].append(f"{number + 1} {observation}")
    lines = []
    for k in np.flatnonzero(ids):
        position, color = " ".join(f"{value:.4f}" for value in points[k]), " ".join(map(str, colors[k]))
        lines.append(f"{ids[k]} {position} {color} 0 {' '.join(tracks[k])}\n")
    return "".join(lines)
