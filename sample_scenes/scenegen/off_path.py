"""Views of the town that a survey never flew, with the truth beside them. Once per scene.

    lower   the point that a nadir photograph looks at, from as far, 30 degrees lower
    half    between the flight lines at half the height above the ground, looking down
    across  at the flown height between the lines, heading across them, 45 degrees downwards
    street  on a street at the height of a head, looking along it or 45 degrees aside

By turns, at places drawn anew until nothing is within 2 m (street: 1 m) of the camera. Lens and
light are those of the photographs, without distortion, noise or drift of exposure. Beside each
picture lie `depth_m` (H,W), and `num_views` (H,W), how many flown photographs see the surface
there: of what none or one saw, nothing can be learnt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from scenegen.config import SceneConfig
from scenegen.flight import EYE_HEIGHT_M, Shot, look_pose, plan_flight, survey_lines
from scenegen.known_model import write_cameras
from scenegen.layout import BLOCK_U_M, BLOCK_V_M, Layout
from scenegen.photo_file import jpeg_bytes
from scenegen.raycast import Photographer, project, world_rays

KINDS = ("lower", "half", "across", "street")
LOWER_DEG, ACROSS_PITCH_DEG, STREET_TURN_DEG = 30.0, 45.0, 45.0
INNER = 0.4
"""Places are within this share of the area's width and height around its middle."""
MAX_DRAWS = 200
DEPTH_AGREEMENT = 2e-3
"""A photograph sees a surface whose depth there is its own to this share."""
CELL_PX = 4
UP = np.array([0.0, 0.0, 1.0])


def write_off_path(folder: Path, photographer: Photographer, on_view: Callable[[], None] = lambda: None) -> None:
    """Write images/, depth/, known/ (the flown cameras, to align a scene by) and a COLMAP text
    model of the views off the path of the photographer's survey into folder."""
    config = photographer.config
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    flown, shots = plan_flight(config), plan_off_path(config, photographer)
    # The mesh is the same: only the lens and the sensor differ.
    ideal = photographer.with_config(replace(config, distortion_k1=0.0, noise_sigma=0.0))
    for number, shot in enumerate(shots):
        (folder / "images" / shot.name).write_bytes(jpeg_bytes(ideal.config, ideal.photograph(shot, number), shot))
        depth = ideal.depth(shot)
        num_views = count_views(photographer, shot, depth, flown)
        np.savez_compressed(folder / "depth" / f"{Path(shot.name).stem}.npz", depth_m=depth, num_views=num_views)
        on_view()
    (folder / "known").mkdir()
    write_cameras(folder / "known", config, flown)
    write_cameras(folder, ideal.config, shots)


def plan_off_path(config: SceneConfig, photographer: Photographer) -> list[Shot]:
    """The views, by turns of each of `KINDS`; BadInput where a kind finds no free place."""
    rng = np.random.default_rng([config.seed, 4])
    layout = photographer.layout
    shots = []
    for number in range(config.off_path):
        kind = KINDS[number % len(KINDS)]
        shots.append(_free_shot(f"{kind}_{number:04d}.jpg", _POSES[kind], photographer, layout, rng))
    return shots


def count_views(photographer: Photographer, shot: Shot, depth: NDArray, flown: list[Shot]) -> NDArray[np.uint8]:
    """How many of the `flown` photographs of the photographer see what the shot of an ideal lens
    sees (H,W), of which `depth` (H,W) is known; 0 in the sky, at most 255. Counted at the middle of
    every `CELL_PX` × `CELL_PX` pixels."""
    height, width = depth.shape
    rows, columns = (np.minimum(np.arange(0, side, CELL_PX) + CELL_PX // 2, side - 1) for side in (height, width))
    pixels = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), axis=-1).reshape(-1, 2)
    depths = depth[np.ix_(rows, columns)].ravel()
    met = np.isfinite(depths)
    ideal = replace(photographer.config, distortion_k1=0.0)
    origins, directions = world_rays(ideal, shot, pixels[met])
    points = origins.astype(np.float64) + directions * depths[met, None]
    size_wh = np.array([photographer.config.width_px, photographer.config.height_px])
    counts = np.zeros(len(points), np.int64)
    for photograph in flown:
        there, far = project(photographer.config, photograph, points)
        inside = np.flatnonzero(((there >= 0) & (there <= size_wh)).all(axis=1) & (far > 0))
        counts[inside] += np.abs(photographer.depth_at(photograph, there[inside]) - far[inside]) < DEPTH_AGREEMENT * far[inside]
    cells = np.zeros(len(depths), np.uint8)
    cells[met] = np.minimum(counts, 255)
    whole = cells.reshape(len(rows), len(columns)).repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)[:height, :width]
    return np.where(np.isfinite(depth), whole, np.uint8(0))


def _free_shot(
    name: str,
    pose_of: Callable[[SceneConfig, Layout, np.random.Generator], NDArray[np.float64]],
    photographer: Photographer,
    layout: Layout,
    rng: np.random.Generator,
) -> Shot:
    clearance_m = 1.0 if name.startswith("street") else 2.0
    for _ in range(MAX_DRAWS):
        pose = pose_of(photographer.config, layout, rng)
        center = -pose[:3, :3].T @ pose[:3, 3]
        if photographer.clearance_m(center) >= clearance_m:
            return Shot(name=name, cam_from_world=pose, gps_position_m=center, time_s=0.0, exposure_ev=0.0)
    raise BadInput(f"no free place was found for the view {name} in {MAX_DRAWS} draws; take a larger extent_m or off_path 0")


def _ground(layout: Layout, x: float, y: float) -> float:
    return float(layout.height_m(np.array([x]), np.array([y]))[0])


def _inner_place(config: SceneConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    return rng.uniform(-INNER, INNER, 2) * np.array(config.extent_m)


def _between_lines(config: SceneConfig, rng: np.random.Generator) -> tuple[float, float]:
    """A place halfway between two neighbouring rows of the flight; of one row, beside it."""
    width, height = config.extent_m
    num_rows = survey_lines(config)[0]
    gap = int(rng.integers(1, max(2, num_rows)))
    return float(rng.uniform(-INNER, INNER) * width), (gap / num_rows - 0.5) * height


def _lower_pose(config: SceneConfig, layout: Layout, rng: np.random.Generator) -> NDArray[np.float64]:
    x, y = _inner_place(config, rng)
    target = np.array([x, y, _ground(layout, x, y)])
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(90.0 - LOWER_DEG)
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return look_pose(target + away * (config.altitude_m - target[2]), -away, UP)


def _half_pose(config: SceneConfig, layout: Layout, rng: np.random.Generator) -> NDArray[np.float64]:
    x, y = _between_lines(config, rng)
    low = _ground(layout, x, y)
    tilt = np.tan(np.deg2rad(rng.uniform(-6.0, 6.0, 2)))
    center = np.array([x, y, low + 0.5 * (config.altitude_m - low)])
    return look_pose(center, np.array([*tilt, -1.0]), np.array([1.0, 0.0, 0.0]))


def _across_pose(config: SceneConfig, layout: Layout, rng: np.random.Generator) -> NDArray[np.float64]:
    del layout
    x, y = _between_lines(config, rng)
    # Towards the middle, so that the picture shows what was flown over.
    sense = -np.sign(y) if y else 1.0
    pitch = np.deg2rad(ACROSS_PITCH_DEG)
    return look_pose(np.array([x, y, config.altitude_m]), np.array([0.0, sense * np.cos(pitch), -np.sin(pitch)]), UP)


def _street_pose(config: SceneConfig, layout: Layout, rng: np.random.Generator) -> NDArray[np.float64]:
    """On one of the streets that cross the inner area, 1.5 m or less from its middle line."""
    place = np.array(layout.town_from_world(*(np.array([axis]) for axis in _inner_place(config, rng))))[:, 0]
    block, along = np.array([BLOCK_U_M, BLOCK_V_M]), int(rng.integers(2))
    across = 1 - along
    place[across] = np.rint(place[across] / block[across]) * block[across] + rng.uniform(-1.5, 1.5)
    x, y = layout.world_from_town(*place)
    heading = layout.heading_rad(*place) + (np.pi / 2 if along else 0.0) + np.pi * int(rng.integers(2))
    heading += np.deg2rad(rng.choice([0.0, STREET_TURN_DEG, -STREET_TURN_DEG]))
    center = np.array([x, y, _ground(layout, x, y) + EYE_HEIGHT_M])
    return look_pose(center, np.array([np.cos(heading), np.sin(heading), 0.0]), UP)


_POSES = {"lower": _lower_pose, "half": _half_pose, "across": _across_pose, "street": _street_pose}
