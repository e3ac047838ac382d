"""From the world of another program's alignment to the scene's: a place on the earth becomes metres
east, north, up about a point in its middle. Once per scene.

    enu, metres   the scene is the given world, but for a whole offset where that lies far out
    ecef          a rotation and a shift, exact
    crs           the similarity nearest to the map in the scene's middle; files in the given system
                  are written by its inverse, which is exact
"""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, ecef_from_local, geodetic_from_ecef
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.given_frame import MAX_EXACT, offset_of
from radiant_core.georef.reference import georeference
from radiant_core.io.poses.pose_file import GivenWorld
from radiant_core.numerics import FloatArray

EARTH_RADIUS_M = (6.2e6, 6.5e6)
"""Where geocentric places of photographs lie."""


def place_world(world: GivenWorld, centers: FloatArray) -> tuple[Sim3, Frame | None]:
    """given_from_scene and the scene's frame for camera centres (C,3) in the given world; no frame
    where the file does not say what its unit is. Raises BadInput where the centres cannot lie in
    that world."""
    middle = np.median(centers, axis=0)
    if world.kind == "unknown":
        return _shift(np.zeros(3)), None
    if world.kind == "metres":
        return _shift(offset_of(middle)), Frame(kind="scaled", origin_lat_lon_alt=np.zeros(3))
    if world.kind == "enu":
        origin = np.array(world.origin_lat_lon_alt, np.float64)
        if np.abs(middle).max() <= MAX_EXACT:
            return _shift(np.zeros(3)), Frame(kind="metric", origin_lat_lon_alt=origin)
        ecef_from_given = ecef_from_local(origin)
        ecef_from_scene, frame = _about((ecef_from_given @ np.append(middle, 1.0))[:3])
        return _sim3(np.linalg.inv(ecef_from_given) @ ecef_from_scene), frame
    if world.kind == "ecef":
        if not EARTH_RADIUS_M[0] < np.linalg.norm(middle) < EARTH_RADIUS_M[1]:
            raise BadInput(
                f"the alignment says that its coordinates are geocentric (ECEF), and its photographs lie {np.linalg.norm(middle):.4g} m "
                "from the earth's middle: export it in another system."
            )
        ecef_from_scene, frame = _about(middle)
        return _sim3(ecef_from_scene), frame
    crs = parse_crs(world.crs or "")
    step = np.array([100.0, 100.0, 0.0])
    place = np.where(step > 0, np.floor(middle / np.maximum(step, 1)) * step, 0.0)
    frame = Frame(kind="metric", origin_lat_lon_alt=crs.to_geodetic(place[None])[0])
    reference = georeference(frame, crs)
    near = reference.file_from_model
    given_from_scene = Sim3(scale=near.scale, rotation=near.rotation, translation=near.translation + reference.offset)
    return given_from_scene, frame


def _about(middle_ecef: FloatArray) -> tuple[FloatArray, Frame]:
    """ecef_from_scene (4,4) for a scene about a geocentric place, and its frame."""
    origin = geodetic_from_ecef(middle_ecef[None])[0]
    return ecef_from_local(origin), Frame(kind="metric", origin_lat_lon_alt=origin)


def _shift(offset: FloatArray) -> Sim3:
    return Sim3(scale=1.0, rotation=np.eye(3), translation=offset)


def _sim3(matrix: FloatArray) -> Sim3:
    return Sim3(scale=1.0, rotation=matrix[:3, :3], translation=matrix[:3, 3])
