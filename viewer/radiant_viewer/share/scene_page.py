"""What a page shows beside the Gaussians: lines over the model, places, photographs. Once per page.

Coordinates are turned from the scene's (east, north, up) to the viewer's (east, up, south). Of a
run whose photographs stayed on their devices the page knows no camera, no name and no photograph:
only the model, and regions and borders under numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.palette import category_colors, rgb
from radiant_viewer.pictures.view_pose import ViewPose, camera_pose
from radiant_viewer.runs.bookmarks import Bookmarks
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
PLACES, WEAK = "Places", "Where to look twice"
"""Headings of places."""
ABOVE_DEG = 89.0
"""Elevation of the view from above: straight down no direction is up."""
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
    group: str = PLACES
    """The heading that it stands under."""
    marked: bool = True
    """Whether a number stands over the model where it is."""


@dataclass(frozen=True, kw_only=True)
class PageScale:
    """What lengths on a page are in, and how well they are known.

    unit: "m" or "units"; scale_sigma: σ of the scale as a share; place_sigma: σ of a place that is
    pointed at along each axis, in the unit; note: what there is to say of it; ground: height of the
    ground in the scene, along which the scale bar lies.
    """

    unit: str = "units"
    scale_sigma: float = 0.0
    place_sigma: float = 0.0
    note: str = "lengths in the model's own units"
    ground: float = 0.0

    def record(self) -> dict[str, Any]:
        """As the page has it."""
        sigmas = {"scaleSigma": round(self.scale_sigma, 9), "placeSigma": round(self.place_sigma, 9)}
        return {"unit": self.unit, **sigmas, "said": self.note, "ground": round(self.ground, 3)}


def overview(low: FloatArray, high: FloatArray, title: str = "Overview", elevation_deg: float = OVERVIEW_ELEVATION_DEG) -> PagePlace:
    """The whole of a box (3,), (3,) from the south, above its ground."""
    middle = (low + high) / 2
    away = max(float(np.linalg.norm((high - low)[:2])), 1e-6) * 0.9
    elevation = np.radians(elevation_deg)
    position = middle + away * np.array([0.0, -np.cos(elevation), np.sin(elevation)])
    view = ViewPose(position=position, focal_point=middle, up=np.array([0.0, 0, 1]), angle_deg=OVERVIEW_ANGLE_DEG)
    return PagePlace(title=title, text="", view=view, marked=False)


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
            if place.marked
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


def listed_places(places: Sequence[PagePlace]) -> list[dict[str, Any]]:
    """What the page lists, in order: of a marked place the number of its annotation in `settings`,
    of any other where to look from."""
    marked = iter(range(len(places)))
    return [
        {
            "title": place.title,
            "text": place.text,
            "group": place.group,
            "annotation": next(marked) if place.marked else None,
            "camera": None if place.marked else viewer_camera(place),
        }
        for place in places
    ]


def run_places(run: RunView, borders: Sequence[BorderFigures]) -> list[PagePlace]:
    """The whole from two sides, the bookmarked views and the regions; then the worst seams and,
    where cameras may be shown, the worst photographs."""
    return [*_whole(run), *_bookmarked(run), *_of_regions(run), *_seams(run, borders), *_weakest(run)]


def _whole(run: RunView) -> Iterator[PagePlace]:
    low, high = framed_box(run.scene, run.cloud_plan)
    high = np.array([*high[:2], low[2]])
    yield overview(low, high)
    yield overview(low, high, "From above", ABOVE_DEG)


def _bookmarked(run: RunView) -> Iterator[PagePlace]:
    """The views that somebody has kept for others to see, as they are named."""
    for number, view in Bookmarks(run.folder).load().items():
        # A view's angle is over its height; the page's goes across a window of 16:9.
        yield PagePlace(title=view.title or f"View {number}", text=view.note, view=view.pose)


def _of_regions(run: RunView) -> Iterator[PagePlace]:
    """Each region, where there are some."""
    borders = [border for border in run.cloud_plan.borders if len(border) >= 3]
    if not 2 <= len(borders) <= MAX_STOPS:
        return
    names, ground, unit = region_names(run), ground_height(run.scene), run.unit
    for index, border in enumerate(run.cloud_plan.borders):
        if len(border) >= 3:
            low, high = border.min(axis=0), border.max(axis=0)
            place = overview(np.array([*low, ground]), np.array([*high, ground]), names[index])
            text = f"a region of {high[0] - low[0]:.0f} × {high[1] - low[1]:.0f} {unit}, trained by itself and joined with the others"
            yield replace(place, text=text)


def _seams(run: RunView, borders: Sequence[BorderFigures]) -> Iterator[PagePlace]:
    ground, names = ground_height(run.scene), region_names(run)
    for figures in borders[:MAX_STOPS]:
        view = SeamStop(figures=figures).view(ground)
        yield PagePlace(title=f"Border {_title(figures, names)}", text=_step(figures), view=view, aspect=1.0, group=WEAK)


def _weakest(run: RunView) -> Iterator[PagePlace]:
    if run.in_field:
        return
    ground, cameras, diagonal = ground_height(run.scene), run.scene.cameras, _diagonal(run)
    for number, name in enumerate(worst_photographs(run)):
        index = cameras.names.index(name)
        width, height = cameras.sizes_wh[index]
        view = camera_pose(cameras, index, max(float(cameras.centers[index, 2]) - ground, 0.05 * diagonal, 1e-3))
        title, text = weak_view(number, name, (run.psnr_db or {})[name])
        yield PagePlace(title=title, text=text, view=view, aspect=float(width) / float(height), group=WEAK)


def weak_view(number: int, name: str, psnr_db: float) -> tuple[str, str]:
    """Title and text of the view, from 0, at which the model is that far from a photograph."""
    order = ("Weakest view", "Second weakest view", "Third weakest view")
    title = order[number] if number < len(order) else f"{number + 1}th weakest view"
    return title, f"of {name}, which took no part in the training: {psnr_db:.1f} dB"


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
        ends = np.concatenate([piece_ends for piece_ends, _ in pieces])
        levels = np.concatenate([piece_levels for _, piece_levels in pieces])
        layers.append(_layer("Borders", BORDER_COLOR, [_line(one, ground, BORDER_COLOR, 2.0) for one in ends]))
        stepping = np.nan_to_num(levels) >= VISIBLE_LEVELS
        colors = np.where(stepping, STEP_COLOR, CALM_COLOR)
        has_levels = np.isfinite(levels)
        lines = [_line(one, ground, str(color), 5.0) for one, color in zip(ends[has_levels], colors[has_levels], strict=True)]
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


def drawn_cameras(num_cameras: int) -> NDArray[np.int64]:
    """The cameras of a scene that a page draws, evenly chosen where there are too many."""
    return np.unique(np.linspace(0, num_cameras - 1, min(num_cameras, MAX_CAMERAS)).round().astype(np.int64))


def _frusta(run: RunView) -> list[dict[str, Any]]:
    return [frustum_line(run, int(index), CAMERA_COLOR, 1.0) for index in drawn_cameras(len(run.scene.cameras))]


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
    if not figures.has_verdict:
        return "too few photographs show both sides to judge it"
    visibility = "to be seen" if figures.step_levels >= VISIBLE_LEVELS else "hardly to be seen"
    return f"colours step by {figures.step_levels:.1f} of 255 levels where the parts meet, {visibility}"


def _hex(color: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in color)
