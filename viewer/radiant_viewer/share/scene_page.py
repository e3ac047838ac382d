"""What a page shows beside the Gaussians: lines over the model, places, photographs. Once per page.

Coordinates are turned from the scene's (east, north, up) to the viewer's (east, up, south). Of a
run whose photographs stayed on their devices the page knows no camera, no name and no photograph:
only the model, and regions and borders under numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.palette import category_colors, rgb
from radiant_viewer.pictures.view_pose import ViewPose, camera_pose
from radiant_viewer.runs.border_figures import VISIBLE_LEVELS, BorderFigures, border_figures
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.seam_tour import SeamStop
from radiant_viewer.runs.shown_model import framed_box

MAX_STOPS, MAX_WORST = 8, 6
"""Borders and photographs that the page leads to."""
MAX_CAMERAS = 2000
"""Frusta drawn; of more, evenly many."""
FRUSTUM_SHARE = 0.02
"""Length of a frustum as a share of the diagonal of the cameras' box."""
OVERVIEW_ELEVATION_DEG, OVERVIEW_ANGLE_DEG = 35.0, 36.0
BORDER_COLOR, CAMERA_COLOR, CALM_COLOR, STEP_COLOR = "#ffffff", "#f0e442", "#56b4e9", "#d55e00"
_PAGE_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@dataclass(frozen=True, kw_only=True)
class PagePlace:
    """A place that the page leads to: title, text, and how it is looked at; the wider side of the
    picture over its height is what `ViewPose.angle_deg` is turned by."""

    title: str
    text: str
    view: ViewPose
    aspect: float = 16 / 9


def overview(low: FloatArray, high: FloatArray) -> PagePlace:
    """The whole of a box (3,), (3,) from the south, above its ground."""
    middle = (low + high) / 2
    away = max(float(np.linalg.norm((high - low)[:2])), 1e-6) * 0.9
    elevation = np.radians(OVERVIEW_ELEVATION_DEG)
    position = middle + away * np.array([0.0, -np.cos(elevation), np.sin(elevation)])
    view = ViewPose(position=position, focal_point=middle, up=np.array([0.0, 0, 1]), angle_deg=OVERVIEW_ANGLE_DEG)
    return PagePlace(title="Overview", text="", view=view)


def settings(start: PagePlace, places: Sequence[PagePlace]) -> dict[str, Any]:
    """The viewer's own settings: where it begins and where it leads to."""
    plain = {"enabled": False}
    effects = {
        "sharpness": {**plain, "amount": 0},
        "bloom": {**plain, "intensity": 1, "blurLevel": 2},
        "grading": {**plain, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": {**plain, "intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
        "fringing": {**plain, "intensity": 0.5},
    }
    return {
        "version": 2,
        "tonemapping": "none",
        "highPrecisionRendering": False,
        "background": {"color": [0, 0, 0]},
        "postEffectSettings": effects,
        "animTracks": [],
        "cameras": [{"initial": viewer_camera(start)}],
        "annotations": [
            {
                "position": page_points(place.view.focal_point),
                "title": place.title,
                "text": place.text,
                "camera": {"initial": viewer_camera(place)},
            }
            for place in places
        ],
        "startMode": "default",
    }


def page_points(points: FloatArray) -> list[Any]:
    """Points (...,3) of the scene as the page has them, to the millimetre."""
    return np.round(np.asarray(points, np.float64) @ _PAGE_FROM_WORLD.T, 3).tolist()


def run_overview(run: RunView) -> PagePlace:
    """The whole scene, on its ground."""
    low, high = framed_box(run.scene, run.cloud_plan)
    return overview(low, np.array([*high[:2], low[2]]))


def run_borders(run: RunView) -> tuple[BorderFigures, ...]:
    """The run's borders with their figures, worst first; none with one region or without a
    model."""
    regions = sum(len(border) >= 3 for border in run.cloud_plan.borders)
    return () if run.splats is None or regions < 2 else tuple(border_figures(run.scene, run.cloud_plan, run.splats))


def run_places(run: RunView, borders: Sequence[BorderFigures]) -> list[PagePlace]:
    """The worst seams and, where cameras may be shown, the worst photographs."""
    ground = ground_height(run.scene)
    names = region_names(run)
    places = [
        PagePlace(title=f"Seam {_title(figures, names)}", text=_step(figures), view=SeamStop(figures=figures).view(ground), aspect=1.0)
        for figures in borders[:MAX_STOPS]
    ]
    if run.in_field:
        return places
    cameras, diagonal = run.scene.cameras, _diagonal(run)
    for name in worst_photographs(run):
        index = cameras.names.index(name)
        width, height = cameras.sizes_wh[index]
        view = camera_pose(cameras, index, max(float(cameras.centers[index, 2]) - ground, 0.05 * diagonal, 1e-3))
        text = f"{(run.psnr_db or {})[name]:.1f} dB"
        places.append(PagePlace(title=name, text=text, view=view, aspect=float(width) / float(height)))
    return places


def worst_photographs(run: RunView) -> list[str]:
    """Names of the held-out photographs with the lowest PSNR, none of a run in the field."""
    figures = {} if run.in_field else run.placed_psnr_db
    return sorted(figures, key=lambda name: (figures[name], name))[:MAX_WORST]


def run_layers_of_page(run: RunView, borders: Sequence[BorderFigures]) -> list[dict[str, Any]]:
    """Regions, borders, seams and, where they may be shown, cameras, as lines of the page."""
    ground, names = ground_height(run.scene), region_names(run)
    layers = []
    if run.kind == "run":
        layers.append(_regions(run, names, ground))
    if borders:
        pieces = [(figures.ends, figures.levels_above_texture) for figures in borders]
        ends = np.concatenate([own for own, _ in pieces])
        levels = np.concatenate([own for _, own in pieces])
        layers.append(_layer("Borders", BORDER_COLOR, [_line(one, ground, BORDER_COLOR, 2.0) for one in ends]))
        stepping = np.nan_to_num(levels) >= VISIBLE_LEVELS
        colors = np.where(stepping, STEP_COLOR, CALM_COLOR)
        known = np.isfinite(levels)
        lines = [_line(one, ground, str(color), 5.0) for one, color in zip(ends[known], colors[known], strict=True)]
        layers.append(_layer("Seams: visible steps are red", STEP_COLOR, lines))
    if not run.in_field and len(run.scene.cameras):
        layers.append(_layer("Cameras", CAMERA_COLOR, _frusta(run)))
    return layers


def region_names(run: RunView) -> list[str]:
    """How the page names regions: as the plan does, or by numbers where names stay private."""
    return [f"region {index + 1}" if run.in_field else name for index, name in enumerate(run.cloud_plan.edge_ids)]


def _regions(run: RunView, names: Sequence[str], ground: float) -> dict[str, Any]:
    colors = category_colors(len(names))
    lines, labels = [], []
    for index, border in enumerate(run.cloud_plan.borders):
        if len(border) < 3:
            continue
        lines.append(_line(np.vstack([border, border[:1]]), ground, _hex(rgb(colors[index])), 3.0))
        labels.append({"at": page_points(np.array([*border.mean(axis=0), ground])), "text": names[index]})
    return {**_layer("Regions", _hex(rgb(colors[0])), lines), "labels": labels}


def frustum_line(run: RunView, index: int, color: str, width: float) -> dict[str, Any]:
    """The pyramid of a camera as one line of the page."""
    cameras, length = run.scene.cameras, FRUSTUM_SHARE * max(_diagonal(run), 1e-6)
    width_px, height_px = cameras.sizes_wh[index]
    corners_px = np.array([[0, 0, 1], [width_px, 0, 1], [width_px, height_px, 1], [0, height_px, 1]], np.float64)
    rays = corners_px @ np.linalg.inv(cameras.Ks[index]).T @ cameras.cam_from_world[index, :3, :3]
    center = cameras.centers[index]
    a, b, c, d = center + length * rays
    return {"points": page_points(np.stack([a, b, c, d, a, center, b, c, center, d])), "color": color, "width": width}


def _frusta(run: RunView) -> list[dict[str, Any]]:
    count = len(run.scene.cameras)
    chosen = np.unique(np.linspace(0, count - 1, min(count, MAX_CAMERAS)).round().astype(np.int64))
    return [frustum_line(run, int(index), CAMERA_COLOR, 1.0) for index in chosen]


def _layer(name: str, color: str, lines: list[dict[str, Any]]) -> dict[str, Any]:
    return {"name": name, "color": color, "lines": lines, "labels": [], "shown": False}


def _line(points: FloatArray, height: float, color: str, width: float) -> dict[str, Any]:
    raised = np.column_stack([points, np.full(len(points), height)])
    return {"points": page_points(raised), "color": color, "width": width}


def viewer_camera(place: PagePlace) -> dict[str, Any]:
    """A place as the viewer has it; its field of view goes across the wider side of its window."""
    half = np.tan(np.radians(place.view.angle_deg) / 2) * max(place.aspect, 1.0)
    angle_deg = float(np.clip(np.degrees(2 * np.arctan(half)), 10.0, 120.0))
    return {
        "position": page_points(place.view.position),
        "target": page_points(place.view.focal_point),
        "fov": round(angle_deg, 3),
    }


def _diagonal(run: RunView) -> float:
    centers = run.scene.cameras.centers
    return float(np.linalg.norm(np.ptp(centers, axis=0))) if len(centers) else 0.0


def _title(figures: BorderFigures, names: Sequence[str]) -> str:
    return f"{names[figures.border.first]} | {names[figures.border.second]}"


def _step(figures: BorderFigures) -> str:
    return f"step of {figures.step_levels:.1f} of 255 levels" if figures.has_verdict else "too little observed for a verdict"


def _hex(color: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in color)
