"""A plan without a run, for the eye: what `radiant plan` wrote, opened as a `RunView` without model and figures. Once per window.

Before capture nobody knows a pose: cameras stand at their waypoints and look where the flight plan says, straight down where it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.io.records import load_plan, load_plan_waypoints
from radiant_core.numerics import FloatArray
from radiant_core.plan.footprints import Optics, views_before_capture
from radiant_core.plan.plans import require_plan_of
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene
from radiant_viewer.camera_roles import camera_roles
from radiant_viewer.run_view import RunView

IMAGE_WIDTH_PX = 4000
HIGHEST_FLIGHT_M = 500.0
"""Larger altitudes are heights above the sea, as for `radiant plan`."""


def load_plan_view(path: Path, scene: SfmScene | None = None) -> RunView:
    """The plan in a file; `scene`: the cameras it deals, in its order, where it was made from a scene and holds no waypoints.

    Raises BadInput when it has neither or they do not fit, and as `load_plan`.
    """
    cloud_plan, edge_plans = load_plan(path)
    waypoints = load_plan_waypoints(path)
    if waypoints is not None:
        scene = scene_before_capture(waypoints)
    if scene is None:
        raise BadInput(f"{path} was made from a scene and holds no positions: name the scene's folder by --scene.")
    require_plan_of(len(scene.cameras), cloud_plan, edge_plans)
    return RunView(
        folder=path,
        scene=scene,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        splats=None,
        held_out=frozenset(),
        psnr_db=None,
        roles=camera_roles(scene.cameras, cloud_plan, edge_plans, ()),
    )


def scene_before_capture(waypoints: Waypoints, optics: Optics | None = None) -> SfmScene:
    """The cameras that waypoints will become, without points, in metres about the waypoints' origin; z counts from the ground, which is
    at altitude 0 where flights may be that high, and else from the lowest waypoint."""
    optics = optics or Optics()
    positions = _above_ground(waypoints)
    views = views_before_capture(positions[:, :2], np.ones(len(positions)), optics, waypoints.heading_pitch_deg)
    return SfmScene(
        cameras=_looking(waypoints.names, positions, views.corner_rays, optics),
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="metric", origin_lat_lon_alt=waypoints.origin),
    )


def _above_ground(waypoints: Waypoints) -> FloatArray:
    positions = waypoints.positions_m.copy()
    altitudes = waypoints.lat_lon_alt[:, 2]
    is_above_ground = altitudes.min() > 0 and altitudes.max() <= HIGHEST_FLIGHT_M
    positions[:, 2] += waypoints.origin[2] - (0.0 if is_above_ground else float(altitudes.min()))
    return positions


def _looking(names: Sequence[str], positions: FloatArray, corner_rays: FloatArray, optics: Optics) -> Cameras:
    """Cameras at positions (P,3) through whose corners, from the left upper one on clockwise, the rays (P,4,3) go."""
    left_up, right_up, right_down, left_down = (corner_rays[:, corner] for corner in range(4))
    forward = _unit(corner_rays.sum(axis=1))
    right = _unit(right_up + right_down - left_up - left_down)
    rotations = np.stack([right, np.cross(forward, right), forward], axis=1)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = -np.einsum("pij,pj->pi", rotations, positions)
    width, height = IMAGE_WIDTH_PX, round(IMAGE_WIDTH_PX * optics.aspect)
    focal = 0.5 * width / np.tan(np.radians(optics.field_of_view_deg / 2))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    count = len(positions)
    return Cameras(names=tuple(names), Ks=np.tile(K, (count, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([width, height], (count, 1)))


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
