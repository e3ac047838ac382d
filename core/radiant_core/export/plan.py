"""A plan as files that flight planners and maps open: CSV of waypoints, GeoJSON. Once per plan.

CSV: `latitude,longitude,altitude(m),name` are the columns that Litchi's hub names so, and that
UgCS, QGIS and `read_waypoints` find by their names; QGroundControl takes no CSV. Flight planners
fly `altitude(m)` as height above take-off, so it is one: as it came in, or above the ground where
that is known. Every other kind of height has a column of its own (`COLUMNS`), empty for waypoints
whose height is of another: flown as heights above take-off they would be hundreds of metres off.
What is beyond the waypoints' limits stands in none. Names are never formulas (`csv_cells`).
GeoJSON (RFC 7946): WGS84, longitude first, the third number above the ellipsoid, other heights as
properties `height_m` and `height_from`, as all in a system without a vertical datum; outer rings
counter-clockwise, cut at the 180th meridian; straight in longitude and latitude, so sides are
divided every 500 m, where a straight line of the plan differs by 1 cm at most up to latitude 60°.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Point, Polygon, box, get_coordinates, get_parts, make_valid, segmentize, union_all
from shapely.affinity import translate
from shapely.geometry import mapping

from radiant_core.choices import HeightFrom
from radiant_core.frames import enu_from_geodetic, geodetic_from_enu
from radiant_core.georef.crs import Crs
from radiant_core.georef.features import crs_member, in_crs
from radiant_core.io.csv_cells import cell_of_text
from radiant_core.io.run_store import atomic_writer, write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.heights import HEIGHT_KINDS
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.waypoints import Waypoints
from radiant_core.waypoints.geojson_reader import HEIGHT_FROM, HEIGHT_M

HEIGHT, ABSOLUTE = "altitude(m)", "altitude_absolute(m)"
COLUMNS: dict[HeightFrom, str] = {
    "takeoff": HEIGHT,
    "ground": "altitude_agl(m)",
    "sea": "altitude_amsl(m)",
    "ellipsoid": "altitude_ellipsoid(m)",
    "absolute": ABSOLUTE,
}
"""The column of each kind of height."""
CSV_HEADER = ("latitude", "longitude", HEIGHT, "name")
ANGLE_HEADER = ("heading(deg)", "gimbalpitchangle")
MAX_SIDE_M = 500.0
NEAR_POLE_M, POLE_PIECES = 50_000.0, 500
"""Nearer to a pole than this a polygon as wide as so many pieces is divided into these."""


def save_device_waypoints(
    folder: Path,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    waypoints: Waypoints,
    buffers: Sequence[EdgeBuffer] = (),
    *,
    only: NDArray[np.bool_] | None = None,
) -> tuple[Path, ...]:
    """One `<device>.csv` per device in the existing `folder`, its waypoints in their order.

    A device without waypoints gets the header alone. Of an edge that deals its waypoints itself,
    later, `edges/<edge>.csv` for a plan of its own. Degrees have 9 decimals (0.1 mm), metres 3;
    headings and pitches follow where known, then absolute altitudes beside heights. With `buffers`
    a last column `role` says own or buffer. With `only` (P,) waypoints where it is false are in no
    list. Raises BadInput when the plan is not of these waypoints, or as `write_atomic`.
    """
    require_plan_of(len(waypoints), cloud_plan, edge_plans)
    wanted = np.ones(len(waypoints), bool) if only is None else only
    written: list[Path] = []
    of_edge = {buffer.edge_id: buffer for buffer in buffers}
    for plan in edge_plans:
        for device_id in plan.device_ids:
            written.append(folder / f"{device_id}.csv")
            extra = None if plan.edge_id not in of_edge else of_edge[plan.edge_id].cameras_of(device_id)
            write_atomic(written[-1], waypoints_csv(waypoints, _keep_wanted(plan.cameras_of(device_id), wanted), extra).encode())
        if not plan.dealt:
            (folder / "edges").mkdir(exist_ok=True)
            written.append(folder / "edges" / f"{plan.edge_id}.csv")
            write_atomic(written[-1], waypoints_csv(waypoints, _keep_wanted(plan.camera_indices, wanted), None).encode())
    return tuple(written)


def _keep_wanted(rows: NDArray[np.int64], wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
    return rows[wanted[rows]]


def save_regions_geojson(
    path: Path,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    waypoints: Waypoints,
    buffers: Sequence[EdgeBuffer] = (),
    crs: Crs | None = None,
) -> None:
    """One FeatureCollection: a polygon per region and device strip with land, a point per waypoint
    and per device that takes it as a buffer; in `crs`, else longitude and latitude. Memory does not
    grow with the waypoints.

    Properties: kind (region, strip, waypoint, buffer), name, edge, device, cameras, planned_s.
    Raises BadInput when the plan is not of these waypoints, or as `atomic_writer`.
    """
    require_plan_of(len(waypoints), cloud_plan, edge_plans)
    placed = None if crs is None else crs.at(*waypoints.origin[:2].tolist())
    third = () if crs is not None and not crs.vertical_name else ("ellipsoid",)
    write_features(path, _features(cloud_plan, edge_plans, waypoints, buffers, (*third, "unknown")), placed)


def write_features(path: Path, features: Iterable[dict[str, Any]], crs: Crs | None = None) -> None:
    """Write a GeoJSON FeatureCollection, atomically, a feature a line; raises as `atomic_writer`.

    With `crs` the features, in longitude and latitude, are written in that system, named as GeoJSON
    of 2008 did: RFC 7946 knows longitude and latitude alone, GDAL and QGIS read both.
    """
    named = b""
    if crs is not None:
        features = in_crs(features, crs)
        named = f'"crs": {json.dumps(crs_member(crs))}, '.encode()
    with atomic_writer(path) as file:
        file.write(b'{"type": "FeatureCollection", ' + named + b'"features": [\n')
        between = b""
        for feature in features:
            file.write(between + json.dumps(feature, ensure_ascii=False, allow_nan=False).encode())
            between = b",\n"
        file.write(b"\n]}\n")


def waypoints_csv(waypoints: Waypoints, rows: NDArray[np.int64], extra: NDArray[np.int64] | None = None) -> str:
    """`rows` (K,) of waypoints as CSV, with `extra` ones as buffers, in their order."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")  # RFC 4180
    angles, (flown, absolute) = waypoints.heading_pitch_deg, _height_columns(waypoints)
    header = (*CSV_HEADER[:2], *flown, CSV_HEADER[3], *(() if angles is None else ANGLE_HEADER), *absolute)
    writer.writerow((*header, *(() if extra is None else ("role",))))
    buffered = set() if extra is None else set(extra.tolist())
    indices = np.sort(rows if extra is None else np.concatenate([rows, extra]))
    for index, (lat, lon, _) in zip(indices.tolist(), waypoints.lat_lon_alt[indices].tolist(), strict=True):
        looks = () if angles is None else tuple("" if np.isnan(angle) else f"{angle:.3f}" for angle in angles[index])
        role = () if extra is None else ("buffer" if index in buffered else "own",)
        name = cell_of_text(waypoints.names[index])
        before, behind = ([_metres(float(column[index])) for column in columns.values()] for columns in (flown, absolute))
        writer.writerow((f"{lat:.9f}", f"{lon:.9f}", *before, name, *looks, *behind, *role))
    return text.getvalue()


def _height_columns(waypoints: Waypoints) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Columns of heights (P,), NaN where a cell is empty: those in the place where planners look,
    and absolute ones kept beside heights above the ground."""
    altitudes = waypoints.lat_lon_alt[:, 2]
    kinds: list[HeightFrom] = [kind for kind in waypoints.height_kinds if kind in COLUMNS]
    by_kind = {COLUMNS[kind]: np.where(waypoints.counting_from(kind), altitudes, np.nan) for kind in kinds}
    within = waypoints.height_problem is None
    if waypoints.ground_m is None:
        return ({name: column for name, column in by_kind.items() if within or name not in (HEIGHT, COLUMNS["ground"])}, {})
    heights_m = waypoints.heights_m
    return ({} if heights_m is None or not within else {HEIGHT: heights_m}), {
        name: column for name, column in by_kind.items() if name != HEIGHT
    }


def _metres(height: float) -> str:
    return "" if np.isnan(height) else f"{height:.3f}"


def _features(
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    waypoints: Waypoints,
    buffers: Sequence[EdgeBuffer],
    unsaid: Sequence[HeightFrom],
) -> Iterator[dict[str, Any]]:
    """All features; kinds of heights that are `unsaid` have no property, for the third number says
    them, or nothing is known."""
    yield from land_features(cloud_plan, edge_plans, waypoints.origin)
    kinds = [("waypoint", plan) for plan in edge_plans] + [("buffer", buffer) for buffer in buffers]
    codes = waypoints.height_codes
    for kind, plan in kinds:
        for camera, device in zip(plan.camera_indices.tolist(), plan.device_of_camera.tolist(), strict=True):
            about: dict[str, Any] = {"kind": kind, "name": waypoints.names[camera], "edge": plan.edge_id}
            if device >= 0:
                about["device"] = plan.device_ids[device]
            counts_from = HEIGHT_KINDS[codes[camera]]
            if counts_from not in unsaid:
                about |= {HEIGHT_M: round(float(waypoints.lat_lon_alt[camera, 2]), 3), HEIGHT_FROM: counts_from}
            yield point_feature(waypoints.lat_lon_alt[camera], about, altitude_known=counts_from == "ellipsoid")


def land_features(cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], origin: FloatArray) -> Iterator[dict[str, Any]]:
    """A GeoJSON feature per region and per device strip that has land, about the origin (3,) [deg,
    deg, m] of the plan's metres."""
    for index, (edge_id, border) in enumerate(zip(cloud_plan.edge_ids, cloud_plan.borders, strict=True)):
        cameras, planned_s = int(cloud_plan.counts[index]), float(cloud_plan.edge_time_s[index])
        about = {"kind": "region", "name": edge_id, "edge": edge_id, "cameras": cameras, "planned_s": planned_s}
        yield from _polygon_feature(border, origin, about)
    for plan in edge_plans:
        counts = [len(plan.cameras_of(device_id)) for device_id in plan.device_ids]
        for device_id, strip, count, time_s in zip(plan.device_ids, plan.strips, counts, plan.device_time_s.tolist(), strict=True):
            about: dict[str, Any] = {
                "kind": "strip",
                "name": device_id,
                "edge": plan.edge_id,
                "device": device_id,
                "cameras": count,
                "planned_s": time_s,
            }
            yield from _polygon_feature(strip, origin, about)


def point_feature(lat_lon_alt: ArrayLike, about: dict[str, Any], *, altitude_known: bool = True) -> dict[str, Any]:
    """A GeoJSON point at (3,) [deg, deg, m] with its properties; altitude where known."""
    lat, lon, alt = np.asarray(lat_lon_alt, np.float64).tolist()
    altitude = [round(alt, 3)] if altitude_known else []
    return _feature({"type": "Point", "coordinates": [round(lon, 9), round(lat, 9), *altitude]}, about)


def _feature(geometry: dict[str, Any], about: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "properties": about, "geometry": geometry}


def _polygon_feature(polygon: FloatArray, origin: FloatArray, about: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if len(polygon) >= 3:
        yield _feature(_geometry(polygon, origin), about)


def _geometry(polygon: FloatArray, origin: FloatArray) -> dict[str, Any]:
    """A polygon (V,2) m, counter-clockwise, about the origin (3,), as GeoJSON: Polygon, or
    MultiPolygon across the 180th meridian."""
    ring = _unwrap_ring(_lon_lat(get_coordinates(segmentize(Polygon(polygon), _side_m(polygon, origin))), origin), origin)
    shape = Polygon(np.round(ring, 9))
    if not shape.is_valid:
        # A side that runs through a pole has every longitude there.
        shape = make_valid(shape)
    elif ring[:, 0].min() >= -180 and ring[:, 0].max() <= 180:
        return mapping(shape)
    # One turn east and west, so that what stands out on one side comes in on the other.
    cut = [translate(shape, xoff=turn).intersection(box(-180, -90, 180, 90)) for turn in (-360, 0, 360)]
    # Around a pole the first and the last meridian are one.
    parts = [part for part in get_parts(union_all(cut)) if isinstance(part, Polygon) and not part.is_empty]
    rings = [mapping(part.normalize().reverse())["coordinates"] for part in parts]
    return {"type": "MultiPolygon", "coordinates": rings}


def _side_m(polygon: FloatArray, origin: FloatArray) -> float:
    """How long a piece of a side may be: beside a pole a long one passes all longitudes."""
    pole_m = enu_from_geodetic(np.array([[np.copysign(90.0, origin[0]), origin[1], origin[2]]]), origin)[0, :2]
    near = Polygon(polygon).distance(Point(pole_m)) < NEAR_POLE_M
    return float(np.hypot(*np.ptp(polygon, axis=0)) / POLE_PIECES) if near else MAX_SIDE_M


def _unwrap_ring(ring: FloatArray, origin: FloatArray) -> FloatArray:
    """A closed ring (V,2) of longitude and latitude without jumps at the 180th meridian, near the
    origin's longitude; one around a pole goes on along that, a line in longitude and latitude."""
    lons = np.unwrap(ring[:, 0], period=360)
    lons += 360 * np.round((origin[1] - lons.mean()) / 360)
    ring = np.column_stack([lons, ring[:, 1]])
    if abs(lons[-1] - lons[0]) < 180:
        return ring
    pole = np.copysign(90.0, origin[0])
    return np.vstack([ring, [lons[-1], pole], [lons[0], pole], ring[0]])


def _lon_lat(positions: FloatArray, origin: FloatArray) -> FloatArray:
    """Longitude and latitude (V,2) of positions (V,2) m at the origin's altitude: the plane of the
    plan leaves the globe with distance."""
    level = np.column_stack([positions, np.zeros(len(positions))])
    level[:, 2] = origin[2] - geodetic_from_enu(level, origin)[:, 2]
    return geodetic_from_enu(level, origin)[:, 1::-1]
