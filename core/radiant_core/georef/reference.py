"""A scene's frame in a coordinate reference system, as files hold it. Once per file.

    place = crs(geodetic(x)),  file coordinate = place − offset

float32 positions keep a centimetre only within 100 km, so the offset (whole hundreds in the plane)
stands beside the file and never in its numbers. Positions are moved one by one through the map,
which is no similarity: over a kilometre the earth bends by 8 cm. Rotations and sizes are moved by
the similarity that is nearest to the map at the origin: UTM stretches the plane by 4e-4 at most. A
map that stretches by over 1 % in one direction more than in another is refused: heights in metres
over a plane in feet would press a model to 0.30 of its height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, ecef_from_local, geodetic_from_enu
from radiant_core.geometry.similarity import move_splats
from radiant_core.georef.crs import Crs
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats

OFFSET_STEP = 100.0
STEP_M = 1.0
MAX_UNEVEN = 0.01
"""How much more a map may stretch along one direction than along another; UTM: 4e-4."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Georeference:
    """How a file's coordinates become places of `crs`: add `offset` (3,)."""

    crs: Crs
    frame: Frame
    offset: FloatArray
    file_from_model: Sim3
    """The nearest similarity at the origin."""

    def apply(self, points_m: FloatArray) -> FloatArray:
        """File coordinates (P,3) of points (P,3) m of the scene's frame."""
        return self.crs.from_geodetic(geodetic_from_enu(points_m, self.frame.origin_lat_lon_alt)) - self.offset

    def move(self, splats: Splats) -> Splats:
        """The Gaussians in the file's coordinates."""
        means = self.apply(splats.means.astype(np.float64))
        return replace(move_splats(splats, self.file_from_model), means=means.astype(np.float32))

    def move_scene(self, scene: SfmScene) -> SfmScene:
        """Cameras and points in the file's coordinates."""
        cameras = scene.cameras
        poses = self.file_from_model.apply_to_poses(cameras.cam_from_world)
        poses[:, :3, 3] = -np.einsum("cij,cj->ci", poses[:, :3, :3], self.apply(cameras.centers))
        moved = Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh)
        return replace(scene, cameras=moved, points=self.apply(scene.points))

    def comments(self) -> tuple[str, ...]:
        """Lines for the header of a PLY."""
        east, north, up = (f"{value:.10g}" for value in self.offset)
        units = f"units {self.crs.unit}, heights {self.crs.height_unit}"
        axes = f"axes {' '.join(self.crs.axes)} up"
        return (f"crs {self.crs.title}", f"offset {east} {north} {up}", axes, units, f"heights {self.crs.heights}")

    def record(self) -> dict[str, Any]:
        """The content of the JSON beside a file."""
        return {
            "schema": "radiant.georeference",
            "version": 1,
            "crs": self.crs.definition,
            "name": self.crs.name,
            "epsg": self.crs.horizontal_epsg,
            "vertical_epsg": self.crs.vertical_epsg,
            "unit": self.crs.unit,
            "unit_m": self.crs.unit_m,
            "heights": self.crs.heights,
            "height_unit": self.crs.height_unit,
            "height_unit_m": self.crs.height_unit_m,
            "axes": [*self.crs.axes, "up"],
            "offset": self.offset.tolist(),
            "origin_lat_lon_alt": self.frame.origin_lat_lon_alt.tolist(),
        }


def map_offset(origin: FloatArray, unit_m: float = 1.0) -> FloatArray:
    """What is taken off the coordinates (3,) of all files of a scene, so that they lie on each
    other; `origin` (3,) is that of the scene, on a map in units of unit_m metres: whole hundreds of
    them, or what is about as long."""
    step = 10.0 ** np.floor(np.log10(OFFSET_STEP / unit_m))
    return np.append(np.floor(np.asarray(origin, np.float64)[:2] / step) * step, 0.0)


def georeference(frame: Frame, crs: Crs) -> Georeference:
    """The scene's frame in `crs`, with the offset of its origin, the same for all files of a scene;
    BadInput without a place on the globe, in degrees, where heights have another unit than the
    plane or the map stretches unevenly or mirrors, or with a vertical datum for heights that count
    from none."""
    require_placed(frame)
    unit_m = crs.unit_m
    if unit_m is None:
        raise BadInput(f"{crs.title} counts in {crs.unit}s, which no model is measured in: name a projected system, such as a UTM zone.")
    require_heights(frame, crs)
    if not crs.equal_units:
        raise BadInput(
            f"{crs.title} counts the plane in units of 1 {crs.unit} and heights in units of 1 {crs.height_unit}, which would "
            f"{'press' if crs.height_unit_m > unit_m else 'stretch'} a model: name a vertical datum in units of 1 {crs.unit}, or none."
        )
    crs = crs.at(*frame.origin_lat_lon_alt[:2].tolist())

    def places(points_m: FloatArray) -> FloatArray:
        return crs.from_geodetic(geodetic_from_enu(points_m, frame.origin_lat_lon_alt))

    at = np.zeros(3)
    offset = map_offset(places(at[None])[0], unit_m)
    return Georeference(crs=crs, frame=frame, offset=offset, file_from_model=_nearest_similarity(places, at, offset, crs))


def require_heights(frame: Frame, crs: Crs) -> None:
    """Raise BadInput where a system has a datum of heights and the scene's heights count from
    none."""
    if crs.vertical_name and not frame.altitude_known:
        raise BadInput(f"the scene's heights count from no datum and {crs.title} has one: name the system without its vertical part.")


def local_record(frame: Frame) -> dict[str, Any]:
    """What stands beside a file in the scene's own frame: its origin and the matrix to the earth's
    own axes (ECEF), as 3D Tiles want it, rows first; BadInput without a place on the globe."""
    require_placed(frame)
    return {
        "schema": "radiant.georeference",
        "version": 1,
        "crs": "local",
        "unit": "metre",
        "axes": ["east", "north", "up"],
        "origin_lat_lon_alt": frame.origin_lat_lon_alt.tolist(),
        "ecef_from_file": ecef_from_local(frame.origin_lat_lon_alt).tolist(),
    }


def local_comments(frame: Frame) -> tuple[str, ...]:
    """Lines for the header of a PLY in the scene's own frame; none without a place on the globe."""
    if frame.kind != "metric":
        return ()
    lat, lon, alt = frame.origin_lat_lon_alt.tolist()
    return ("axes east north up, metres", f"origin {lat:.10f} {lon:.10f} {alt:.4f} (WGS84 latitude, longitude, height)")


def require_placed(frame: Frame) -> None:
    """Raise BadInput unless the frame has a place on the globe."""
    if frame.kind != "metric":
        raise BadInput(
            "the scene has no place on the globe, so it has no coordinates in any system: give it one with --gcp, or photographs with GPS."
        )


def _nearest_similarity(places: Callable[[FloatArray], FloatArray], at: FloatArray, offset: FloatArray, crs: Crs) -> Sim3:
    """The similarity of the map's derivative at a point (3,): its rotation by the polar part, its
    scale by the volume; BadInput where it is none."""
    steps = STEP_M * np.eye(3)
    jacobian = ((places(at + steps) - places(at - steps)) / (2 * STEP_M)).T
    if np.linalg.det(jacobian) <= 0:
        raise BadInput(f"{crs.title} counts {' and '.join(crs.axes)}, which mirrors a model: name a system that counts east and north.")
    U, singular, Vt = np.linalg.svd(jacobian)
    if singular[0] > (1 + MAX_UNEVEN) * singular[-1]:
        raise BadInput(
            f"{crs.title} stretches a model by {singular[0] / singular[-1]:.3g} along one direction more than along another here: "
            "name a system made for this place, such as its UTM zone."
        )
    rotation, scale = U @ Vt, float(np.cbrt(singular.prod()))
    return Sim3(scale=scale, rotation=rotation, translation=places(at[None])[0] - offset - scale * rotation @ at)
