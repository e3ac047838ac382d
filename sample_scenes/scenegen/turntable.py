"""An object on a turntable: a house on a plate turns before a still camera, lamp and wall.

In the object's frame, which is the scene's, cameras ring the house; the lamp goes with the camera,
and the wall is the same picture behind every photograph of one camera height. Brightness that
changes because a side turns away from the lamp is no exposure, and the wall is nowhere.

    colour = albedo · (ambient + lamp · max(0, n·l)),  l towards a lamp beside the camera
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenegen.buildings import add_house
from scenegen.config import SceneConfig
from scenegen.ground import linear
from scenegen.mesh import Look, Material, Mesh, MeshBuilder, Placement, add_lid, add_prism
from scenegen.noise import Floats, value_noise
from scenegen.props import add_bush, add_car

PLATE_RADIUS_M, PLATE_HEIGHT_M = 9.0, 0.6
CAMERA_DISTANCE_M = 15.0
TARGET_M = np.array([0.0, 0.0, 2.4])
ELEVATIONS_DEG = (12.0, 28.0, 45.0)
LAMP_ASIDE, LAMP_ABOVE = 1.1, 0.6
"""Where the lamp is beside the camera, in shares of the distance to the object."""
LAMP, AMBIENT = np.array([1.15, 1.10, 1.02], np.float32), np.array([0.10, 0.11, 0.12], np.float32)
PLATE, WALL = linear(0.42, 0.40, 0.38), linear(0.60, 0.61, 0.62)


def turntable_mesh(seed: int) -> Mesh:
    """A house with a car and bushes on a round plate around the origin."""
    rng = np.random.default_rng([seed, 77])
    builder = MeshBuilder()
    angles = 2 * np.pi * np.arange(48) / 48
    rim = PLATE_RADIUS_M * np.column_stack([np.cos(angles), np.sin(angles)])
    under, look = Placement(x=0.0, y=0.0, z=-PLATE_HEIGHT_M, heading_rad=0.0), Look(material=Material.PLAIN, tint=PLATE)
    add_prism(builder, under, (rim, rim), (0.0, PLATE_HEIGHT_M), look)
    add_lid(builder, under, rim, PLATE_HEIGHT_M, look)
    add_house(builder, Placement(x=0.0, y=0.0, z=0.0, heading_rad=0.3), (9.0, 7.0), rng)
    add_car(builder, Placement(x=0.5, y=-6.3, z=0.0, heading_rad=0.2), rng)
    for x, y in ((6.6, 2.6), (-6.4, 3.1), (-5.9, -4.0)):
        add_bush(builder, Placement(x=x, y=y, z=0.0, heading_rad=0.0), rng)
    return builder.build()


def turntable_centers(config: SceneConfig) -> NDArray[np.float64]:
    """Where the camera stands beside the object (C,3): rounds at its heights, one after another."""
    turns = [np.arange(part.size) for part in np.array_split(np.arange(config.num_cameras), len(ELEVATIONS_DEG))]
    centers = []
    for which, (turn, elevation_deg) in enumerate(zip(turns, ELEVATIONS_DEG, strict=True)):
        angles, elevation = 2 * np.pi * (turn + which / 3) / max(1, len(turn)), np.deg2rad(elevation_deg)
        ring = np.column_stack(
            [np.cos(angles) * np.cos(elevation), np.sin(angles) * np.cos(elevation), np.full(len(turn), np.sin(elevation))]
        )
        centers.append(TARGET_M + CAMERA_DISTANCE_M * ring)
    return np.concatenate(centers)


def lamp_direction(cam_from_world: NDArray[np.float64]) -> Floats:
    """Unit direction (3,) from the object to the lamp, in the world."""
    right, down, forward = cam_from_world[:3, :3]
    toward = -forward + LAMP_ASIDE * right - LAMP_ABOVE * down
    return (toward / np.linalg.norm(toward)).astype(np.float32)


def wall_radiance(cam_from_world: NDArray[np.float64], directions: Floats, salt: int) -> Floats:
    """Linear light (N,3) of the wall along world directions (N,3): the same for the camera whatever
    turns before it, darker away from the lamp."""
    in_camera = directions @ cam_from_world[:3, :3].T.astype(np.float32)
    x, y = (in_camera[:, :2] / in_camera[:, 2:]).T
    stains = value_noise(x, y, 0.35, salt) + 0.5 * value_noise(x, y, 0.09, salt + 1) - 0.75
    boards = np.where(np.abs(x / 0.4 - np.floor(x / 0.4) - 0.5) < 0.46, 0.0, -0.35)
    falloff = 1.0 / (1.0 + (x - 0.2) ** 2 + (y + 0.15) ** 2)
    return WALL * (falloff * (0.75 + 0.55 * stains + boards))[:, None].astype(np.float32)
