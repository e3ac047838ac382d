"""A pinhole model in the project's world: metric and z up by GPS where GPS can carry it, unscaled with z up otherwise.

Once per scene. A robust similarity to GPS fixes the frame. Where the flight line is straight GPS says nothing about the roll
about it: then up comes from the scene (`orient.py`) and GPS gives only heading, scale and shift.
"""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.frames import Frame, Sim3
from radiant_core.io.colmap import ColmapModel
from radiant_core.io.photos import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.align import Alignment, robust_sim3
from radiant_core.sfm.orient import UpEstimate, estimate_up, level_fit, unscaled_from_world
from radiant_core.sfm.pairs import gps_positions

Findings = tuple[SfmScene, tuple[Decision, ...], tuple[str, ...]]


def cameras_of(model: ColmapModel) -> Cameras:
    """The pinhole cameras of a model in its own frame, in the order of their names."""
    cameras = [model.cameras[image.camera_id] for image in model.images]
    return Cameras(
        names=tuple(image.name for image in model.images),
        Ks=np.array([camera.K for camera in cameras]).reshape(-1, 3, 3),
        cam_from_world=np.array([image.cam_from_world for image in model.images]).reshape(-1, 4, 4),
        sizes_wh=np.array([camera.size_wh for camera in cameras], np.int64).reshape(-1, 2),
    )


def scene_in_world(model: ColmapModel, photographs: tuple[Photograph, ...], seed: int) -> Findings:
    """The scene of a pinhole model in the world frame, with what was decided and what the user should know."""
    cameras = cameras_of(model)
    by_name = {photo.name: photo for photo in photographs}
    positions_m, origin = gps_positions(tuple(by_name[name] for name in cameras.names))
    known = np.isfinite(positions_m[:, 0])
    fit = robust_sim3(cameras.centers[known], positions_m[known], seed)
    up = estimate_up(cameras, model.points.xyz, seed)
    metric, warnings = _metric_from_model(cameras.centers[known], positions_m[known], fit, up)
    observations = model.observations()
    if metric is None:
        world_from_model = unscaled_from_world(cameras, model.points.xyz, observations, up.up)
        frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    else:
        world_from_model = metric
        residuals = np.linalg.norm(metric.apply(cameras.centers[known]) - positions_m[known], axis=1)
        frame = Frame(kind="metric", origin_lat_lon_alt=origin, residual_m=float(np.median(residuals)))
    scene = moved_scene(model, cameras, world_from_model, frame)
    return scene, (_frame_decision(frame, fit, up, int(known.sum())),), warnings


def moved_scene(model: ColmapModel, cameras: Cameras, world_from_model: Sim3, frame: Frame) -> SfmScene:
    """Cameras and points of a model after a similarity."""
    moved = Cameras(
        names=cameras.names,
        Ks=cameras.Ks,
        cam_from_world=world_from_model.apply_to_poses(cameras.cam_from_world),
        sizes_wh=cameras.sizes_wh,
    )
    return SfmScene(
        cameras=moved,
        points=world_from_model.apply(model.points.xyz),
        colors=model.points.colors,
        observations=model.observations(),
        frame=frame,
    )


def _metric_from_model(
    centers: FloatArray, positions_m: FloatArray, fit: Alignment, up: UpEstimate
) -> tuple[Sim3 | None, tuple[str, ...]]:
    """The similarity to metres, or None, and what to warn of."""
    if fit.status == "ok":
        return fit.target_from_source, ()
    if fit.status == "too few":
        told = f"{len(centers)} registered photographs have GPS" if len(centers) else "the photographs have no GPS"
        return None, (f"{told}, so the scene has no metric scale: lengths are in arbitrary units.",)
    if fit.status == "inconsistent":
        return None, (
            "the GPS positions do not fit the photographs' geometry (all alike, or too rough for this site), so the scene has "
            "no metric scale: lengths are in arbitrary units.",
        )
    level = level_fit(centers[fit.inliers], positions_m[fit.inliers], up.up)
    return level, (
        f"the GPS positions lie on a line, which leaves the roll about it open: up comes from the {up.source}, "
        "and on sloping ground the scene is tilted by that slope.",
    )


def _frame_decision(frame: Frame, fit: Alignment, up: UpEstimate, num_gps: int) -> Decision:
    if frame.kind == "unscaled":
        choice, figure, unit = f"unscaled, up from the {up.source}", float(num_gps), "photographs with GPS"
        reason = f"the fit to GPS is {fit.status}"
    elif fit.status == "collinear":
        choice, figure, unit = f"metric, up from the {up.source}", float(np.degrees(fit.tilt_error_rad)), "deg roll uncertainty"
        reason = "the GPS positions lie on a line"
    else:
        choice, figure, unit = "metric, from GPS", frame.residual_m, "m median residual"
        reason = f"{int(fit.inliers.sum())} of {num_gps} GPS positions agree with a similarity"
    return Decision(stage="sfm", topic="frame", choice=choice, figure=figure, unit=unit, reason=reason)
