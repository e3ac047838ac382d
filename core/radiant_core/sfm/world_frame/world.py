"""A pinhole model in the project's world: metric and z up by GPS where it can, else unscaled.

Once per scene. A robust similarity to GPS fixes the frame, unless GPS cannot say where up is: the
positions lie on a line, or the photographs would all be rolled if it were right (altitudes drift by
a hundred metres in some cameras), or the scene fixes it better and says otherwise. Then up comes
from the scene (`up.py`), only heading, scale and shift from GPS. What a user says of up and of a
length (`placement.py`) goes before both, unless it contradicts GPS (`contradictions.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.frames import Frame, Sim3
from radiant_core.geometry.align import Alignment, AlignStatus, robust_sim3
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.pairs import gps_positions
from radiant_core.sfm.world_frame.altitudes import fill_heights
from radiant_core.sfm.world_frame.contradictions import (
    MAX_INDEPENDENT,
    Contradiction,
    contradicting_north,
    contradicting_scale,
    contradicting_up,
    heading_sigma_deg,
    scale_sigma,
    settle,
)
from radiant_core.sfm.world_frame.known_sizes import agreeing_north, rescale, turn_to_north
from radiant_core.sfm.world_frame.orient import kept_from_world, level_fit, unscaled_from_world
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.position_count import PositionCount, count_positions
from radiant_core.sfm.world_frame.up import UpEstimate, estimate_up, roll_deg

MAX_GPS_ROLL_DEG = 15.0
MAX_GPS_LEAN_DEG = 3.0
"""GPS and the scene may put up so far apart: a usual slope."""
MAX_FORCED_LEAN_DEG = 0.01
UNPLACED = Placement()
UNSCALED = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedScene:
    """A scene in the world frame, how it got there, and what there is to say of it."""

    scene: SfmScene
    world_from_model: Sim3
    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    """Those of the warnings after which place, scale or up may be wrong."""
    positions: PositionCount | None = None
    """Of GPS, where it was asked."""


def with_warnings(placed: PlacedScene, doubts: tuple[str, ...]) -> PlacedScene:
    """The scene with more that puts its place in doubt."""
    return replace(placed, warnings=(*doubts, *placed.warnings), doubts=(*doubts, *placed.doubts))


def cameras_of(model: ColmapModel) -> Cameras:
    """The pinhole cameras of a model in its own frame, in the order of their names."""
    cameras = [model.cameras[image.camera_id] for image in model.images]
    return Cameras(
        names=tuple(image.name for image in model.images),
        Ks=np.array([camera.K for camera in cameras]).reshape(-1, 3, 3),
        cam_from_world=np.array([image.cam_from_world for image in model.images]).reshape(-1, 4, 4),
        sizes_wh=np.array([camera.size_wh for camera in cameras], np.int64).reshape(-1, 2),
    )


def scene_in_world(
    model: ColmapModel, photographs: tuple[Photograph, ...], seed: int, placement: Placement = UNPLACED, *, keeps_frame: bool = False
) -> PlacedScene:
    """The scene of a pinhole model in the world frame, with what was decided and the warnings;
    `keeps_frame`: without GPS it stays in its own frame where z is up in that."""
    cameras = cameras_of(model)
    by_name = {photo.name: photo for photo in photographs}
    positions_m, origin = gps_positions(tuple(by_name[name] for name in cameras.names))
    given_up = placement.given_up(cameras, model.points.xyz, seed)
    forced = given_up is not None
    up = given_up or estimate_up(cameras, model.points.xyz, seed)
    heights = fill_heights(cameras.centers, model.points.xyz, (positions_m, origin), lambda: up.up)
    positions_m = heights.positions_m
    has_gps = np.isfinite(positions_m[:, 0])
    fit = robust_sim3(cameras.centers[has_gps], positions_m[has_gps], seed)
    gps = _judge(fit, cameras, up, forced=forced)
    metric, warnings = _metric_from_model(cameras.centers[has_gps], positions_m[has_gps], gps, up, scaled=placement.gives_scale)
    as_given = kept_from_world(cameras, model.points.xyz, model.observations(), _lean_deg(up, forced)) if keeps_frame else None
    world_from_model = metric or as_given or unscaled_from_world(cameras, model.points.xyz, model.observations(), up.up)
    world_from_model, scaled = rescale(world_from_model, move_scene(model, cameras, world_from_model, UNSCALED), placement)
    frame = Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3)) if scaled else UNSCALED
    world_from_turned, turned = turn_to_north(world_from_model, cameras, placement)
    against: tuple[str, ...] = ()
    residuals_m = None
    if metric is not None:
        contradictions = _against_gps(placement, gps, scaled, turned)
        against = settle(contradictions, placement.contradictions)
        if turned and not any("--north" in contradiction.outcome for contradiction in contradictions):
            world_from_turned, turned = world_from_model, (agreeing_north(turned[0]),)
        residuals_m = np.linalg.norm(world_from_turned.apply(cameras.centers[has_gps]) - positions_m[has_gps], axis=1)
        frame = Frame(
            kind="metric",
            origin_lat_lon_alt=heights.origin,
            residual_m=float(np.median(residuals_m)),
            altitude_known=heights.altitude_known,
        )
    world_from_model = world_from_turned
    count = count_positions(cameras.names, positions_m, fit, residuals_m)
    by_gps = metric is not None and gps.verdict == "ok"
    doubts = () if by_gps or forced or up.doubt is None else (_doubt_warning(up),)
    return PlacedScene(
        scene=move_scene(model, cameras, world_from_model, frame),
        world_from_model=world_from_model,
        decisions=(
            *(() if by_gps else (_up_decision(up, forced),)),
            *scaled,
            *turned,
            _frame_decision(frame, gps, up, int(has_gps.sum()), forced=forced),
        ),
        warnings=(*heights.warnings, *warnings, *count.warning, *against, *doubts),
        doubts=(*count.warning, *against, *doubts),
        positions=count,
    )


def scene_as_given(model: ColmapModel, frame: Frame) -> PlacedScene:
    """The scene of a pinhole model whose coordinates are those of `frame` already."""
    decision = Decision(
        stage="sfm",
        topic="frame",
        choice="metric, as the alignment has it" if frame.kind == "metric" else "metres without a place, as the alignment has them",
        figure=None,
        unit="",
        reason="the alignment says what its coordinates are: neither GPS nor the scene changes place, scale or up",
    )
    identity = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
    scene = move_scene(model, cameras_of(model), identity, frame)
    return PlacedScene(scene=scene, world_from_model=identity, decisions=(decision,), warnings=())


def _against_gps(
    placement: Placement, gps: _JudgedGps, scaled: tuple[Decision, ...], turned: tuple[Decision, ...]
) -> tuple[Contradiction, ...]:
    """What the user says that contradicts a frame by GPS; decisions as `rescale` and
    `turn_to_north`."""
    contradictions: list[Contradiction | None] = []
    for decision in scaled:
        factor = decision.figure or 1.0
        contradictions.append(contradicting_scale(factor, scale_sigma(gps.fit), placement.length_option, placement.length_by(factor)))
    for decision in turned:
        turn_deg = decision.figure or 0.0
        option = f"--north {placement.north}"
        contradictions.append(contradicting_north(turn_deg, heading_sigma_deg(gps.fit), option, placement.north_deg + turn_deg))
    if gps.verdict == "overruled" and gps.fit.status == "ok" and not gps.is_rolled:
        contradictions.append(contradicting_up(gps.lean_deg, gps.up_deg, f"--up {placement.up}"))
    return tuple(contradiction for contradiction in contradictions if contradiction is not None)


def _lean_deg(up: UpEstimate, forced: bool) -> float:
    """How far z of a given model is from up: what is asked for is not to be rounded."""
    lean_deg = float(np.degrees(np.arccos(np.clip(up.up[2], -1, 1))))
    return np.inf if forced and lean_deg > MAX_FORCED_LEAN_DEG else lean_deg


def move_scene(model: ColmapModel, cameras: Cameras, world_from_model: Sim3, frame: Frame) -> SfmScene:
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
    """What GPS is good for; roll_deg: RMS roll of the photographs if its up were right, lean_deg:
    from the scene's up, up_deg: how well GPS fixes it, is_rolled: whether that roll shows that its
    altitudes drift."""

    fit: Alignment
    verdict: AlignStatus | Literal["tilted", "overruled"]
    roll_deg: float = 0.0
    lean_deg: float = 0.0
    up_deg: float = 90.0
    is_rolled: bool = False


def _judge(fit: Alignment, cameras: Cameras, up: UpEstimate, *, forced: bool) -> _JudgedGps:
    if fit.target_from_source is None:
        return _JudgedGps(fit=fit, verdict=fit.status)
    gps_up = fit.target_from_source.rotation[2]
    roll = roll_deg(cameras, gps_up)
    lean_deg = float(np.degrees(np.arccos(np.clip(gps_up @ up.up, -1, 1))))
    up_deg = float(np.degrees(fit.tilt_error_rad * np.sqrt(max(1.0, fit.inliers.sum() / MAX_INDEPENDENT))))
    rolled = roll > MAX_GPS_ROLL_DEG and roll > 2 * up.roll_deg
    leans = up.doubt is None and lean_deg > MAX_GPS_LEAN_DEG and up_deg > up.uncertainty_deg
    tilted = fit.status == "ok" and (rolled or leans)
    verdict = "overruled" if forced and fit.status in ("ok", "collinear") else "tilted" if tilted else fit.status
    return _JudgedGps(fit=fit, verdict=verdict, roll_deg=roll, lean_deg=lean_deg, up_deg=up_deg, is_rolled=rolled)


def _metric_from_model(
    centers: FloatArray, positions_m: FloatArray, gps: _JudgedGps, up: UpEstimate, *, scaled: bool
) -> tuple[Sim3 | None, tuple[str, ...]]:
    """The similarity to metres, or None, and what to warn of."""
    if gps.verdict == "ok":
        return gps.fit.target_from_source, ()
    lost = (
        "so the scene has no place on the globe."
        if scaled
        else "so the scene has no metric scale: lengths are in arbitrary units (--distance or --height give one)."
    )
    if gps.verdict == "too few":
        subject = f"only {len(centers)} registered photographs have GPS" if len(centers) else "the photographs have no GPS"
        return None, (f"{subject}, {lost}",)
    level = level_fit(centers[gps.fit.inliers], positions_m[gps.fit.inliers], up.up) if gps.verdict != "inconsistent" else None
    if level is None:
        why = "(positions all alike, too rough for this site, or photographs placed wrongly)"
        return None, (f"GPS and the photographs' geometry do not fit each other {why}, {lost}",)
    if gps.verdict == "overruled":
        return level, ()
    if gps.verdict == "tilted":
        return level, (
            f"the GPS altitudes would tilt the scene by {gps.lean_deg:.0f}° (the photographs would be rolled by {gps.roll_deg:.0f}° on "
            f"average): up comes from the scene ({up.source}; {up.roll_deg:.0f}°), GPS gives heading, scale and place only.",
        )
    return level, (
        f"the GPS positions lie on a line, which leaves the roll about it open: up comes from the {up.source}, "
        "and on sloping ground the scene is tilted by that slope.",
    )


def _doubt_warning(up: UpEstimate) -> str:
    return (
        f"up comes from the {up.source} and may be wrong: {up.doubt}. Look at it (radiant inspect), and where it is wrong give --up: "
        "ground, level, down, or a photograph whose top edge is up."
    )


def _up_decision(up: UpEstimate, forced: bool) -> Decision:
    against = ", ".join(f"the {name} would put it {angle_deg:.0f}° away" for name, angle_deg in up.left_out)
    return Decision(
        stage="sfm",
        topic="up",
        choice=f"up from the {up.source}" + ("" if forced else f", known to {up.uncertainty_deg:.1f}°"),
        figure=up.uncertainty_deg,
        unit="deg standard deviation",
        reason="asked for by --up" if forced else f"left out: {against}" if against else "nothing in the scene contradicts",
        forced=forced,
    )


def _frame_decision(frame: Frame, gps: _JudgedGps, up: UpEstimate, num_gps: int, *, forced: bool) -> Decision:
    up_of = "as asked for" if forced else "from the scene"
    if frame.kind != "metric":
        kind = "unscaled" if frame.kind == "unscaled" else "metric without a place"
        choice, figure, unit = f"{kind}, up {up_of}", float(num_gps), "photographs with GPS"
        reason = f"the fit to GPS is {gps.verdict}"
    elif gps.verdict == "collinear":
        choice, figure, unit = (f"metric, up {up_of}", float(np.degrees(gps.fit.tilt_error_rad)), "deg roll uncertainty")
        reason = "the GPS positions lie on a line"
    elif gps.verdict == "overruled":
        choice, figure, unit = f"metric, up {up_of}", gps.lean_deg, "deg between that and up by GPS"
        reason = "asked for by --up"
    elif gps.verdict == "tilted":
        choice, figure, unit = f"metric, up {up_of}", gps.roll_deg, "deg roll of the photographs under GPS"
        reason = (
            f"with up {up_of} the photographs are rolled by {up.roll_deg:.1f}° only; up by GPS is {gps.lean_deg:.1f}° away "
            f"and known to {gps.up_deg:.1f}° (altitudes drift), this to {up.uncertainty_deg:.1f}°"
        )
    else:
        choice, figure, unit = "metric, from GPS", frame.residual_m, "m median residual"
        reason = f"{int(gps.fit.inliers.sum())} of {num_gps} GPS positions agree with a similarity"
    return Decision(stage="sfm", topic="frame", choice=choice, figure=figure, unit=unit, reason=reason, forced=gps.verdict == "overruled")
