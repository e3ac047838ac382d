"""What clicked places measure before there is a surface: by the depth of the rendered picture.

    gsd of a place = least depth / focal length of the cameras that have it in their picture
    σ_z = RENDERING gsd,  σ_xy = PLACE_GSD gsd      (core/survey/heights.py, measures.py)

Some milliseconds a click; C cameras, P places.
"""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import RENDERING
from radiant_core.survey.measures import PLACE_GSD, Accuracy, Figure, measure_places

WITHOUT_SCALE = "σ without that of the scale"


def quick_text(kind: str, points: FloatArray, cameras: Cameras | None, unit: str) -> str:
    """The figures of places (P,3), NaN heights for those of the map, in a line; empty while they
    are too few, or why nothing can be said of them. Without cameras there is no σ."""
    if len(points) < 2:
        return ""
    measured_kind: MeasureKind = "area" if kind in ("area", "volume") and len(points) > 2 else "height" if kind == "height" else "distance"
    heights_known = bool(np.isfinite(points).all())
    if measured_kind == "height" and not heights_known:
        return "a height takes places clicked in the 3D view: on the map they have none before the surface"
    gsd = None if cameras is None or not len(cameras) else float(sampling_distance(cameras, points).max())
    sigma = 0.0 if gsd is None else RENDERING * gsd
    places = points if heights_known else np.column_stack([points[:, :2], np.zeros(len(points))])
    try:
        accuracy = Accuracy(place=0.0 if gsd is None else PLACE_GSD * gsd, scale=0.0)
        figures = measure_places(measured_kind, places, np.full(len(points), sigma), accuracy).figures
    except BadInput as error:
        return str(error)
    if not heights_known and measured_kind == "distance":
        figures = figures[1:]
    caveat = "" if gsd is None else f"; {WITHOUT_SCALE}"
    return "; ".join(_figure(figure, unit, has_sigma=gsd is not None) for figure in figures) + caveat


def sampling_distance(cameras: Cameras, points: FloatArray) -> FloatArray:
    """Width (P,) of a photograph's pixel at places (P,3), NaN heights at the lowest camera's
    ground: of the camera that shows each best, else of the median camera."""
    centers = cameras.centers
    with_height = points[np.isfinite(points[:, 2])]
    usual = float(with_height[:, 2].mean()) if len(with_height) else float(centers[:, 2].min() - np.ptp(centers[:, 2]))
    places = np.column_stack([points[:, :2], np.where(np.isfinite(points[:, 2]), points[:, 2], usual)])
    in_camera = np.einsum("cij,pj->cpi", cameras.cam_from_world[:, :3, :3], places) + cameras.cam_from_world[:, None, :3, 3]
    depth = np.where(in_camera[..., 2] > 0, in_camera[..., 2], np.nan)
    with np.errstate(invalid="ignore"):
        pixel = np.einsum("cij,cpj->cpi", cameras.Ks, in_camera)[..., :2] / depth[..., None]
        inside = ((pixel >= 0) & (pixel <= cameras.sizes_wh[:, None])).all(axis=2)
    sizes = np.where(inside, depth, np.inf) / cameras.Ks[:, None, 0, 0]
    best = sizes.min(axis=0)
    away = np.linalg.norm(places[None] - centers[:, None], axis=2) / cameras.Ks[:, None, 0, 0]
    return np.where(np.isfinite(best), best, np.median(away, axis=0))


def _figure(figure: Figure, unit: str, *, has_sigma: bool) -> str:
    sigma = f" ± {figure.sigma:.2f}" if has_sigma else ""
    return f"{figure.name} {figure.value:.2f}{sigma} {unit}{('', '²', '³')[figure.power - 1]}"
