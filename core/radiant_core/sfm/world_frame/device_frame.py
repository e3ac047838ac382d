"""The frame of a device's own structure from motion: fixed by GPS, with uncertainty, or refused.

The robust similarity of camera centres to east-north-up metres (`align.robust_sim3`) leaves
residuals of σ per axis, by their median and corrected for seven fitted numbers; over n positions
x_i about their mean, spread Q = Σ x_i x_iᵀ, it is then known to
    position σ/√n,   scale σ/√tr Q,   rotation  σ √λ_max((tr(Q) I − Q)⁻¹),
each times 1.09, the price of least distances instead of squares (the spatial median in three
dimensions keeps 8/(3π) of the information). Positions on a line leave the roll about it open. Then,
and where GPS altitudes would roll the photographs, up comes from the scene as in `world.py`, and
the rotation's uncertainty is how far level photographs were seen to be off. Once per device.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.frames import MAX_REACH_M, Frame, FrameUncertainty, Sim3, enu_from_geodetic
from radiant_core.geometry.align import Alignment, robust_sim3
from radiant_core.numerics import FloatArray, check_array
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.orient import level_fit
from radiant_core.sfm.world_frame.up import UpEstimate, estimate_up, roll_deg
from radiant_core.sfm.world_frame.world import MAX_GPS_ROLL_DEG

MIN_POSITIONS = 4
MAX_RESIDUAL_SHARE = 0.25
"""A residual per axis of more than this share of the positions' extent says nothing of scale and
heading."""
MAX_SCALE_UNCERTAINTY = 0.2
MAX_ROTATION_UNCERTAINTY_RAD = np.radians(15.0)
"""Beyond these the models of neighbours cannot be found in each other's renders; `frame_refinement`
asks more of a model without any."""
MIN_UP_UNCERTAINTY_RAD = np.radians(1.0)
"""Ground and photographs are level to no better than this."""
ROBUST_PRICE = 1.09
SIGMA_FROM_MEDIAN_3D = 1 / 1.538
"""As `align.SIGMA_FROM_MEDIAN`: the median length of three normal errors of σ = 1 is 1.538."""
NOISE_FLOOR_M = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class DeviceFrame:
    """A device's scene moved into metres east, north, up about the common origin."""

    scene: SfmScene
    common_from_device: Sim3
    uncertainty: FrameUncertainty
    num_inliers: int
    """GPS positions that count."""
    num_positions: int
    """All of its photographs'."""
    sigma_m: float
    """Standard deviation of GPS per axis, as the residuals show it."""
    up_source: str
    """"GPS", or what of the scene says where up is."""


@dataclass(frozen=True, kw_only=True)
class RefusedFrame:
    """Why a device's frame cannot be fixed: one sentence with the figures."""

    reason: str


def device_frame(
    scene: SfmScene, lat_lon_alt: Mapping[str, tuple[float, float, float]], origin_lat_lon_alt: ArrayLike, seed: int = 0
) -> DeviceFrame | RefusedFrame:
    """Fix a scene of any frame by the GPS `lat_lon_alt` [deg, deg, m] of its photographs, without
    those that have none. Raises BadInput when a position is not finite or off the globe."""
    names = [name for name in scene.cameras.names if name in lat_lon_alt]
    if len(names) < MIN_POSITIONS:
        reason = f"only {len(names)} of its {len(scene.cameras)} placed photographs have GPS with an altitude"
        return RefusedFrame(reason=f"{reason}, and a frame needs {MIN_POSITIONS}.")
    origin = check_array("origin_lat_lon_alt", origin_lat_lon_alt, (3,))
    positions_m = enu_from_geodetic([lat_lon_alt[name] for name in names], origin)
    centers = scene.cameras.named(names).centers
    extent_m = float(np.linalg.norm(np.ptp(positions_m, axis=0)))
    away_m = float(np.linalg.norm(np.median(positions_m, axis=0)))
    if away_m > MAX_REACH_M:
        reason = (
            f"its photographs lie {away_m / 1e3:,.0f} km from the middle of all, more than {MAX_REACH_M / 1e3:.0f} km: run it as a scene"
        )
        return RefusedFrame(reason=f"{reason} of its own.")
    fit = robust_sim3(centers, positions_m, seed)
    if fit.target_from_source is None:
        return RefusedFrame(reason="its camera centres or its GPS positions are all the same, which fixes no scale and no heading.")
    num_inliers = int(fit.inliers.sum())
    if num_inliers < MIN_POSITIONS:
        return RefusedFrame(
            reason=f"only {num_inliers} of {len(names)} GPS positions agree with one similarity, expected {MIN_POSITIONS} or more."
        )
    oriented = _with_up(scene, centers, positions_m, fit, seed)
    if oriented is None:
        return RefusedFrame(reason="its GPS positions do not differ horizontally, which leaves heading and scale open.")
    common_from_device, up_source, up_rad = oriented
    sigma_m = _sigma_m(common_from_device, centers, positions_m, fit.inliers)
    uncertainty = _uncertainty(common_from_device.apply(centers[fit.inliers]), sigma_m, up_rad)
    refusal = _refusal(uncertainty, sigma_m, extent_m)
    if refusal is not None:
        return refusal
    frame = Frame(kind="metric", origin_lat_lon_alt=origin, residual_m=_median_residual_m(common_from_device, centers, positions_m))
    return DeviceFrame(
        scene=_move(scene, common_from_device, frame),
        common_from_device=common_from_device,
        uncertainty=uncertainty,
        num_inliers=num_inliers,
        num_positions=len(names),
        sigma_m=sigma_m,
        up_source=up_source,
    )


def _with_up(
    scene: SfmScene, centers: FloatArray, positions_m: FloatArray, fit: Alignment, seed: int
) -> tuple[Sim3, str, float | None] | None:
    """The similarity, where its up comes from, and the uncertainty of an up not of GPS; or None."""
    assert fit.target_from_source is not None
    gps_roll = roll_deg(scene.cameras, fit.target_from_source.rotation[2])
    if fit.status != "collinear" and gps_roll <= MAX_GPS_ROLL_DEG:
        return fit.target_from_source, "GPS", None
    up = estimate_up(scene.cameras, scene.points, seed)
    if fit.status != "collinear" and gps_roll <= 2 * up.roll_deg:
        return fit.target_from_source, "GPS", None
    level = level_fit(centers[fit.inliers], positions_m[fit.inliers], up.up)
    return None if level is None else (level, up.source, _up_uncertainty_rad(up))


def _up_uncertainty_rad(up: UpEstimate) -> float:
    """Standard deviation of an estimated up; beyond all use where it is in doubt."""
    return max(MIN_UP_UNCERTAINTY_RAD, float(np.radians(90.0 if up.doubt else up.uncertainty_deg)))


def _sigma_m(fit: Sim3, centers: FloatArray, positions_m: FloatArray, inliers: NDArray[np.bool_]) -> float:
    """Standard deviation of one axis of GPS from the median residual of the inliers, corrected for
    the seven fitted numbers."""
    residuals = np.linalg.norm(fit.apply(centers[inliers]) - positions_m[inliers], axis=1)
    freedom = 3 * len(residuals)
    return max(NOISE_FLOOR_M, SIGMA_FROM_MEDIAN_3D * float(np.median(residuals)) * np.sqrt(freedom / (freedom - 7)))


def _uncertainty(centers_m: FloatArray, sigma_m: float, up_rad: float | None) -> FrameUncertainty:
    """Of a frame fitted at camera centres (n,3) m with errors σ per axis; `up_rad` replaces what
    GPS says of the tilt."""
    spread = centers_m - centers_m.mean(axis=0)
    Q = spread.T @ spread
    least = 1e-12 * max(float(np.trace(Q)), 1e-12)
    if up_rad is None:
        weakest = float(np.linalg.eigvalsh(np.trace(Q) * np.eye(3) - Q)[0])
        rotation_rad = ROBUST_PRICE * sigma_m / np.sqrt(max(weakest, least))
        scale_spread = float(np.trace(Q))
    else:
        # Heading, scale and shift come from the horizontal positions alone, up from the scene.
        scale_spread = float(np.trace(Q[:2, :2]))
        rotation_rad = max(up_rad, ROBUST_PRICE * sigma_m / np.sqrt(max(scale_spread, least)))
    return FrameUncertainty(
        position_m=ROBUST_PRICE * sigma_m / np.sqrt(len(centers_m)),
        scale=ROBUST_PRICE * sigma_m / np.sqrt(max(scale_spread, least)),
        rotation_rad=rotation_rad,
    )


def _refusal(uncertainty: FrameUncertainty, sigma_m: float, extent_m: float) -> RefusedFrame | None:
    if extent_m == 0 or sigma_m > MAX_RESIDUAL_SHARE * extent_m:
        reason = f"its GPS positions miss its cameras by {sigma_m:.1f} m per axis on an extent of {extent_m:.1f} m, more than a quarter."
        return RefusedFrame(reason=reason)
    if uncertainty.scale > MAX_SCALE_UNCERTAINTY or uncertainty.rotation_rad > MAX_ROTATION_UNCERTAINTY_RAD:
        return RefusedFrame(
            reason=(
                f"its GPS positions, off by {sigma_m:.1f} m per axis on an extent of {extent_m:.1f} m, fix its scale to "
                f"{100 * uncertainty.scale:.1f} % and its rotation to {np.degrees(uncertainty.rotation_rad):.1f}° only, "
                f"expected {100 * MAX_SCALE_UNCERTAINTY:.0f} % and {np.degrees(MAX_ROTATION_UNCERTAINTY_RAD):.0f}° or better."
            )
        )
    return None


def _median_residual_m(fit: Sim3, centers: FloatArray, positions_m: FloatArray) -> float:
    return float(np.median(np.linalg.norm(fit.apply(centers) - positions_m, axis=1)))


def _move(scene: SfmScene, similarity: Sim3, frame: Frame) -> SfmScene:
    cameras = scene.cameras
    return SfmScene(
        cameras=Cameras(
            names=cameras.names, Ks=cameras.Ks, cam_from_world=similarity.apply_to_poses(cameras.cam_from_world), sizes_wh=cameras.sizes_wh
        ),
        points=similarity.apply(scene.points),
        colors=scene.colors,
        observations=scene.observations,
        frame=frame,
    )
