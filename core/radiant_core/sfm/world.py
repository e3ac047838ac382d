"""A pinhole model in the project's world: metric and z up by GPS where GPS can carry it, unscaled with z up otherwise.

Once per scene. A robust similarity to GPS fixes the frame, unless GPS cannot say where up is: the positions lie on a line,
or the photographs would all be rolled if it were right (altitudes drift by a hundred metres in some cameras). Then up comes
from the scene (`orient.py`) and GPS gives only heading, scale and shift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.frames import Frame, Sim3
from radiant_core.io.colmap import ColmapModel
from radiant_core.io.photos import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.align import Alignment, AlignStatus, robust_sim3
from radiant_core.sfm.altitudes import with_heights
from radiant_core.sfm.orient import UpEstimate, estimate_up, level_fit, roll_deg, unscaled_from_world
from radiant_core.sfm.pairs import gps_positions

MAX_GPS_ROLL_DEG = 15.0
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
    gps_m = positions_m, origin
    positions_m, origin, heights = with_heights(
        cameras.centers, model.points.xyz, gps_m, lambda: estimate_up(cameras, model.points.xyz, seed).up
    )
    known = np.isfinite(positions_m[:, 0])
    fit = robust_sim3(cameras.centers[known], positions_m[known], seed)
    up = estimate_up(cameras, model.points.xyz, seed)
    gps = _judged(fit, cameras, up)
    metric, warnings = _metric_from_model(cameras.centers[known], positions_m[known], gps, up)
    observations = model.observations()
    if metric is None:
        world_from_model = unscaled_from_world(cameras, model.points.xyz, observations, up.up)
        frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    else:
        world_from_model = metric
        residuals = np.linalg.norm(metric.apply(cameras.centers[known]) - positions_m[known], axis=1)
        frame = Frame(kind="metric", origin_lat_lon_alt=origin, residual_m=float(np.median(residuals)))
    scene = moved_scene(model, cameras, world_from_model, frame)
    return scene, (_frame_decision(frame, gps, up, int(known.sum())),), (*heights, *warnings)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _JudgedGps:
    """What GPS is good for; roll_deg is the RMS roll of the photographs if its up were right."""

    fit: Alignment
    verdict: AlignStatus | Literal["tilted"]
    roll_deg: float


def _judged(fit: Alignment, cameras: Cameras, up: UpEstimate) -> _JudgedGps:
    if fit.target_from_source is None:
        return _JudgedGps(fit=fit, verdict=fit.status, roll_deg=0.0)
    roll = roll_deg(cameras, fit.target_from_source.rotation[2])
    tilted = fit.status == "ok" and roll > MAX_GPS_ROLL_DEG and roll > 2 * up.roll_deg
    return _JudgedGps(fit=fit, verdict="tilted" if tilted else fit.status, roll_deg=roll)


def _metric_from_model(
    centers: FloatArray, positions_m: FloatArray, gps: _JudgedGps, up: UpEstimate
) -> tuple[Sim3 | None, tuple[str, ...]]:
    """The similarity to metres, or None, and what to warn of."""
    if gps.verdict == "ok":
        return gps.fit.target_from_source, ()
    if gps.verdict == "too few":
        told = f"only {len(centers)} registered photographs have GPS" if len(centers) else "the photographs have no GPS"
        return None, (f"{told}, so the scene has no metric scale: lengths are in arbitrary units.",)
    level = level_fit(centers[gps.fit.inliers], positions_m[gps.fit.inliers], up.up) if gps.verdict != "inconsistent" else None
    if level is None:
        return None, (
            "the GPS positions do not fit the photographs' geometry (all alike, or too rough for this site), so the scene has "
            "no metric scale: lengths are in arbitrary units.",
        )
    if gps.verdict == "tilted":
        return level, (
            f"the GPS altitudes would tilt the scene (photographs rolled by {gps.roll_deg:.0f}° on average): up comes from the "
            f"{up.source} ({up.roll_deg:.0f}°), GPS gives heading, scale and place only.",
        )
    return level, (
        f"the GPS positions lie on a line, which leaves the roll about it open: up comes from the {up.source}, "
        "and on sloping ground the scene is tilted by that slope.",
    )


def _frame_decision(frame: Frame, gps: _JudgedGps, up: UpEstimate, num_gps: int) -> Decision:
    if frame.kind == "unscaled":
        choice, figure, unit = f"unscaled, up from the {up.source}", float(num_gps), "photographs with GPS"
        reason = f"the fit to GPS is {gps.verdict}"
    elif gps.verdict == "collinear":
        choice, figure, unit = (
            f"metric, up from the {up.source}",
            float(np.degrees(gps.fit.tilt_error_rad)),
            "deg roll uncertainty",
        )
        reason = "the GPS positions lie on a line"
    elif gps.verdict == "tilted":
        choice, figure, unit = f"metric, up from the {up.source}", gps.roll_deg, "deg roll of the photographs under GPS"
        reason = f"with up from the {up.source} the photographs are rolled by {up.roll_deg:.1f}° only"
    else:
        choice, figure, unit = "metric, from GPS", frame.residual_m, "m median residual"
        reason = f"{int(gps.fit.inliers.sum())} of {num_gps} GPS positions agree with a similarity"
    return Decision(stage="sfm", topic="frame", choice=choice, figure=figure, unit=unit, reason=reason)
