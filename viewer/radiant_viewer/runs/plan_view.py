"""A plan without a run: the file of `radiant plan` as a `RunView`. Once per window.

Before capture cameras stand at their waypoints, in the flight plan's direction or straight down.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.io.records import load_plan_file
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.footprints import Optics, views_before_capture
from radiant_core.plan.plans import require_plan_of
from radiant_core.plan.waypoints import HIGHEST_FLIGHT_M, Waypoints
from radiant_core.scene import SfmScene
from radiant_viewer.layers.camera_roles import camera_roles
from radiant_viewer.runs.run_view import RunView

IMAGE_WIDTH_PX = 4000
USUAL_OVERLAP, LARGEST_OVERLAP = 0.8, 0.95
"""Overlap of consecutive images in a flight: the usual one, and more than any flight has."""


def load_plan_view(path: Path, scene: SfmScene | None = None) -> RunView:
    """Read a plan without a run.

    Args:
        path: the file that `radiant plan` wrote.
        scene: the plan's cameras in the plan's order, for a plan without waypoints.

    Returns:
        The plan with the cameras at its waypoints or of the scene, without model and figures.

    Raises:
        BadInput: the plan has neither waypoints nor a scene, or they do not fit to it, or the file
            holds no plan.
        StoreDamaged: the file is broken.
    """
    plan_file = load_plan_file(path)
    cloud_plan, edge_plans = plan_file.cloud, plan_file.edges
    if plan_file.waypoints is not None:
        scene = scene_before_capture(plan_file.waypoints, plan_file.ground_m)
    if scene is None:
        raise BadInput(f"{path} was made from a scene and holds no positions: name the scene's folder by --scene.")
    require_plan_of(len(scene.cameras), cloud_plan, edge_plans)
    return RunView(
        folder=path,
        scene=scene,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        model=None,
        held_out=frozenset(),
        psnr_db=None,
        roles=camera_roles(scene.cameras, cloud_plan, edge_plans, ()),
    )


def scene_before_capture(waypoints: Waypoints, ground_m: float | None = None) -> SfmScene:
    """The cameras that waypoints will become, without points, in metres about the waypoints'
    origin; z counts from the ground, at `ground_m` of the waypoints' altitudes, or at
    `estimate_ground_m`."""
    optics = Optics()
    positions = waypoints.positions_m.copy()
    positions[:, 2] += waypoints.origin[2] - (estimate_ground_m(waypoints, optics) if ground_m is None else ground_m)
    views = views_before_capture(positions[:, :2], np.ones(len(positions)), optics, waypoints.heading_pitch_deg)
    return SfmScene(
        cameras=_cameras_along(waypoints.names, positions, views.corner_rays, optics),
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="metric", origin_lat_lon_alt=waypoints.origin, altitude_known=waypoints.altitude_known),
    )


def estimate_ground_m(waypoints: Waypoints, optics: Optics) -> float:
    """Estimate the altitude (m) of the ground in the waypoints' datum: 0 if that gives a plausible
    flight height and an overlap of at most `LARGEST_OVERLAP`, else so far below the lowest waypoint
    that the overlap is `USUAL_OVERLAP`."""
    altitudes = waypoints.lat_lon_alt[:, 2]
    low, high = float(altitudes.min()), float(altitudes.max())
    positions = waypoints.positions_m[:, :2]
    apart = float(np.median(KDTree(positions).query(positions, k=2)[0][:, 1])) if len(positions) > 1 else 0.0
    seen_per_height = 2 * np.tan(np.radians(optics.field_of_view_deg / 2))
    if (
        not waypoints.absolute
        and low > 0
        and high <= HIGHEST_FLIGHT_M
        and (apart == 0 or apart >= (1 - LARGEST_OVERLAP) * seen_per_height * low)
    ):
        return 0.0
    return low - apart / ((1 - USUAL_OVERLAP) * seen_per_height)


def _cameras_along(names: Sequence[str], positions: FloatArray, corner_rays: FloatArray, optics: Optics) -> Cameras:
    """Return cameras at positions (P,3) whose corners, clockwise from the upper left, see along the
    rays (P,4,3)."""
    left_up, right_up, right_down, left_down = (corner_rays[:, corner] for corner in range(4))
    forward = _normalize(corner_rays.sum(axis=1))
    right = _normalize(right_up + right_down - left_up - left_down)
    rotations = np.stack([right, np.cross(forward, right), forward], axis=1)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = -np.einsum("pij,pj->pi", rotations, positions)
    width, height = IMAGE_WIDTH_PX, round(IMAGE_WIDTH_PX * optics.aspect)
    focal = 0.5 * width / np.tan(np.radians(optics.field_of_view_deg / 2))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    count = len(positions)
    return Cameras(names=tuple(names), Ks=np.tile(K, (count, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([width, height], (count, 1)))


def _normalize(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
