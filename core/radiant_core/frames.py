"""World frames: their origin, latitude and longitude as metres, and similarity transforms.

Computed once per scene. WGS84 constants: NIMA TR8350.2. ECEF ↔ ENU as in Hofmann-Wellenhof et al.,
GNSS (2008), ch. 8; latitude of a geocentric position by Bowring's iteration (Survey Review 1976).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

WGS84_SEMI_MAJOR_M = 6378137.0
WGS84_FLATTENING = 1 / 298.257223563
SETTLED_RAD = 1e-13
"""A round that moves a latitude by less, some 0.6 µm, is the last."""
MAX_REACH_M = 300e3
"""Farthest that a position of one site may lie from the middle of all: generous for drones and
aeroplanes, small against the globe."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """What the world coordinates mean.

    kind "metric": metres, x east, y north, z up from `origin_lat_lon_alt` (3,) degrees and metres.
    kind "scaled": metres by a known length, z up, no place on the globe; the origin is zero. kind
    "unscaled": no GPS; z up as estimated, an arbitrary unit, the origin is zero. `residual_m`:
    median distance of the camera centres to GPS, None without GPS. `altitude_known`: whether the
    origin has an altitude; without one z counts from the middle of the scene's points.
    """

    kind: Literal["metric", "scaled", "unscaled"]
    origin_lat_lon_alt: FloatArray
    residual_m: float | None = None
    altitude_known: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_lat_lon_alt", check_array("origin_lat_lon_alt", self.origin_lat_lon_alt, (3,)))
        if self.kind not in ("metric", "scaled", "unscaled"):
            raise BadInput(f"frame kind {self.kind!r} is unknown: use 'metric', 'scaled' or 'unscaled'.")
        if self.residual_m is not None and not (np.isfinite(self.residual_m) and self.residual_m >= 0):
            raise BadInput(f"the residual of a frame is {self.residual_m}, expected a distance or None without GPS.")

    @property
    def unit(self) -> str:
        """Metres ("m") or, where nothing fixes the scale, "units"."""
        return "units" if self.kind == "unscaled" else "m"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sim3:
    """Similarity y = scale · rotation · x + translation; rotation (3,3), translation (3,)."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", check_array("rotation", self.rotation, (3, 3)))
        object.__setattr__(self, "translation", check_array("translation", self.translation, (3,)))
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise BadInput(f"the scale of a similarity is {self.scale}, expected a positive number.")
        rotation = np.clip(self.rotation, -10, 10)
        # 1e-6: an estimate in float64 is orthonormal to 1e-12, one through float32 to 1e-7; a
        # scaled one misses by far more.
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
            raise BadInput("the rotation of a similarity is not orthonormal or mirrors: put its scale into `scale`.")

    def apply(self, points: ArrayLike) -> FloatArray:
        """Points (P,3) moved into the target frame (P,3)."""
        return self.scale * np.asarray(points, np.float64) @ self.rotation.T + self.translation

    def apply_to_poses(self, cam_from_world: ArrayLike) -> FloatArray:
        """Poses (C,4,4) of the same cameras seen from the target frame, in its unit (C,4,4)."""
        poses = np.array(cam_from_world, dtype=np.float64)
        rotations = poses[:, :3, :3] @ self.rotation.T
        poses[:, :3, 3] = self.scale * poses[:, :3, 3] - rotations @ self.translation
        poses[:, :3, :3] = rotations
        return poses

    def inverse(self) -> Sim3:
        """The similarity that undoes this one."""
        return Sim3(scale=1 / self.scale, rotation=self.rotation.T, translation=-(self.rotation.T @ self.translation) / self.scale)


def compose(c_from_b: Sim3, b_from_a: Sim3) -> Sim3:
    """The similarity c_from_a: first `b_from_a`, then `c_from_b`."""
    return Sim3(
        scale=c_from_b.scale * b_from_a.scale,
        rotation=c_from_b.rotation @ b_from_a.rotation,
        translation=c_from_b.apply(b_from_a.translation[None])[0],
    )


@dataclass(frozen=True, kw_only=True)
class FrameUncertainty:
    """Standard deviations of a model's frame, all positive and finite: of the middle of its cameras
    in m per axis, of its scale as a share, of its rotation in rad about the axis that is known
    worst."""

    position_m: float
    scale: float
    rotation_rad: float

    def __post_init__(self) -> None:
        if not all(np.isfinite(value) and value > 0 for value in (self.position_m, self.scale, self.rotation_rad)):
            raise BadInput(
                f"the uncertainty of a frame is {self}, expected three positive numbers: give what GPS or the poses are good for."
            )

    @property
    def sigmas(self) -> FloatArray:
        """The standard deviations (7,) of ξ."""
        return np.array([self.position_m] * 3 + [self.rotation_rad] * 3 + [self.scale])


def enu_from_geodetic(lat_lon_alt: ArrayLike, origin_lat_lon_alt: ArrayLike) -> FloatArray:
    """Metres east, north, up (P,3) of positions (P,3) [deg, deg, m] about an origin (3,), float64.
    Raises BadInput off the globe."""
    positions = check_array("lat_lon_alt", lat_lon_alt, (None, 3))
    origin = check_array("origin_lat_lon_alt", origin_lat_lon_alt, (3,))
    _require_on_globe(positions)
    return (_ecef_from_geodetic(positions) - _ecef_from_geodetic(origin[None])) @ _ecef_from_enu(origin)


def geodetic_from_enu(positions_m: ArrayLike, origin_lat_lon_alt: ArrayLike) -> FloatArray:
    """Latitude, longitude in ±180° and altitude (P,3) of metres (P,3) about an origin (3,).

    The inverse of `enu_from_geodetic`, within 1e-6 m up to 10,000 km from the origin. Raises
    BadInput for an origin off the globe and for positions outside 1e6 to 1e8 m from the centre of
    the earth, below which latitude loses its meaning.
    """
    positions = check_array("positions_m", positions_m, (None, 3))
    origin = check_array("origin_lat_lon_alt", origin_lat_lon_alt, (3,))
    _require_on_globe(origin[None])
    with np.errstate(over="ignore", invalid="ignore"):
        ecef = _ecef_from_geodetic(origin[None]) + positions @ _ecef_from_enu(origin).T
        radius_m = np.sqrt(np.sum(ecef**2, axis=1))
    if not ((radius_m > 1e6) & (radius_m < 1e8)).all():
        raise BadInput("a position is farther than 1e8 m from the earth or deep inside it: give metres east, north, up of an origin.")
    return _geodetic_from_ecef(ecef)


def _require_on_globe(lat_lon_alt: FloatArray) -> None:
    if (np.abs(lat_lon_alt[:, 0]) > 90).any() or (np.abs(lat_lon_alt[:, 1]) > 180).any():
        raise BadInput("a latitude exceeds 90° or a longitude 180°: give latitude, longitude, altitude in degrees and metres.")


def enu_change(from_lat_lon_alt: ArrayLike, to_lat_lon_alt: ArrayLike) -> Sim3:
    """The rigid move from east-north-up about one origin (3,) to another, degrees and metres."""
    start, end = (check_array("origin", origin, (3,)) for origin in (from_lat_lon_alt, to_lat_lon_alt))
    rotation = _ecef_from_enu(end).T @ _ecef_from_enu(start)
    return Sim3(scale=1.0, rotation=rotation, translation=enu_from_geodetic(start[None], end)[0])


def ecef_from_local(origin_lat_lon_alt: ArrayLike) -> FloatArray:
    """The rigid move (4,4) from metres east, north, up about an origin (3,) [deg, deg, m] to the
    earth's own axes (ECEF), as the root of 3D Tiles has it, rows first."""
    origin = check_array("origin_lat_lon_alt", origin_lat_lon_alt, (3,))
    _require_on_globe(origin[None])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = _ecef_from_enu(origin), _ecef_from_geodetic(origin[None])[0]
    return matrix


def geodetic_from_ecef(ecef: ArrayLike) -> FloatArray:
    """Latitude, longitude, altitude (P,3) of geocentric places (P,3) m; raises as
    `geodetic_from_enu`."""
    places = check_array("ecef", ecef, (None, 3))
    radius_m = np.linalg.norm(places, axis=1)
    if not ((radius_m > 1e6) & (radius_m < 1e8)).all():
        raise BadInput("a geocentric place is farther than 1e8 m from the earth or deep inside it: give metres of WGS84's own axes.")
    return _geodetic_from_ecef(places)


def _ecef_from_enu(origin: FloatArray) -> FloatArray:
    """Rotation (3,3) whose columns are east, north and up at the origin (3,)."""
    lat, lon = np.radians(origin[:2])
    return np.array(
        [
            [-np.sin(lon), -np.sin(lat) * np.cos(lon), np.cos(lat) * np.cos(lon)],
            [np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat) * np.sin(lon)],
            [0.0, np.cos(lat), np.sin(lat)],
        ]
    )


def _ecef_from_geodetic(positions: FloatArray) -> FloatArray:
    lat, lon, alt = np.radians(positions[:, 0]), np.radians(positions[:, 1]), positions[:, 2]
    eccentricity2 = WGS84_FLATTENING * (2 - WGS84_FLATTENING)
    normal_m = WGS84_SEMI_MAJOR_M / np.sqrt(1 - eccentricity2 * np.sin(lat) ** 2)
    radius_m = (normal_m + alt) * np.cos(lat)
    z_m = (normal_m * (1 - eccentricity2) + alt) * np.sin(lat)
    return np.stack([radius_m * np.cos(lon), radius_m * np.sin(lon), z_m], axis=1)


def _geodetic_from_ecef(ecef: FloatArray) -> FloatArray:
    """tan φ = (z + e'² b sin³ β) / (p − e² a cos³ β), tan β = (1 − f) tan φ: near the
    ground each round shrinks the error to 1e-5."""
    eccentricity2 = WGS84_FLATTENING * (2 - WGS84_FLATTENING)
    semi_minor_m = WGS84_SEMI_MAJOR_M * (1 - WGS84_FLATTENING)
    from_axis_m, z_m = np.hypot(ecef[:, 0], ecef[:, 1]), ecef[:, 2]
    reduced = np.arctan2(z_m, (1 - WGS84_FLATTENING) * from_axis_m)
    lat = reduced
    for _ in range(4):
        before = lat
        lat = np.arctan2(
            z_m + eccentricity2 / (1 - eccentricity2) * semi_minor_m * np.sin(reduced) ** 3,
            from_axis_m - eccentricity2 * WGS84_SEMI_MAJOR_M * np.cos(reduced) ** 3,
        )
        reduced = np.arctan2((1 - WGS84_FLATTENING) * np.sin(lat), np.cos(lat))
        if np.abs(lat - before).max(initial=0) < SETTLED_RAD:
            break
    # This form of the altitude has no division by cos φ, which fails at the poles.
    alt_m = from_axis_m * np.cos(lat) + z_m * np.sin(lat) - WGS84_SEMI_MAJOR_M * np.sqrt(1 - eccentricity2 * np.sin(lat) ** 2)
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(ecef[:, 1], ecef[:, 0])), alt_m], axis=1)
