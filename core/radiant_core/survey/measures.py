"""Distance, height, area, volume and profile on a surface, each with its standard deviation.

    place σ:  σ_xy along each axis on the map, σ_z of its cell;  scale: s as a share
    distance d = |b − a|      σ² = uᵀ (Σ_a + Σ_b) u + (s d)²,   u = (b − a) / d
    height   h = z_b − z_a    σ² = σ_za² + σ_zb² + (s h)²
    area     A of the outline (K,2) on the map, and over the surface
             σ² = σ_xy² Σ_k |p_{k+1} − p_{k−1}|² / 4 + (2 s A)²
    volume   V = Σ cells (z − plane) · cell², above and below apart
             σ² = (σ̄_z A)² ρ + (3 s V)²,   ρ = `SHARED`: errors of near cells are alike
Corners err independently of each other, and all share the scale. Units are those of the map.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import MEASURED, UNKNOWN, HeightMap

SHARED = 0.25
"""Variance of a mean over an area as a share of that of one cell: what matching is off by is alike
over metres."""
NUM_PLACES: dict[MeasureKind, tuple[int, str]] = {
    "distance": (2, "two or more"),
    "height": (2, "two"),
    "area": (3, "three or more"),
    "volume": (3, "three or more"),
    "profile": (2, "two or more"),
}
MAX_SAMPLES = 100_000
PLACE_GSD = 0.5
"""σ of a feature in the orthophoto along each axis, in GSD: half of the edges of the town's lie
within 0.3 px of the truth, nine of ten within 1.3 px (docs/survey.md)."""


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """σ of a place on the map along each axis, and of the scale as a share; both ≥ 0."""

    place: float
    scale: float

    def __post_init__(self) -> None:
        if not all(np.isfinite(value) and value >= 0 for value in (self.place, self.scale)):
            raise BadInput(f"an accuracy of {self} came, expected finite numbers from zero on.")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A value with its standard deviation and unit exponent: 1 m, 2 m², 3 m³."""

    name: str
    value: float
    sigma: float
    power: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """One measure: its places (P,3) on the map and its figures, the first of which it is called by;
    profile (S,3): distance along the line, height, σ, NaN where unknown; share of it that is
    filled, not measured."""

    kind: MeasureKind
    places: FloatArray
    figures: tuple[Figure, ...]
    filled: float
    profile: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def require_measure(kind: MeasureKind, places: ArrayLike, base: float | None = None) -> FloatArray:
    """The places (P,2 or 3) of a measure, before there is a surface: BadInput for what `measure`
    refuses of them and of its base on any surface."""
    coords = np.asarray(places, np.float64)
    if coords.ndim != 2 or coords.shape[1] not in (2, 3) or not np.isfinite(coords[:, :2]).all() or np.isinf(coords).any():
        raise BadInput(f"places of shape {coords.shape} came, expected (P, 2) or (P, 3) of finite numbers: east, north and perhaps height.")
    least, words = NUM_PLACES[kind]
    if len(coords) < least or (kind == "height" and len(coords) != 2):
        raise BadInput(f"{len(coords)} places were given, and {kind} takes {words}.")
    if base is not None and not (np.isfinite(base) and kind == "volume"):
        raise BadInput(f"a base of {base} came with {kind}: it is the finite height of the plane of a volume.")
    return coords


def measure(
    kind: MeasureKind,
    places: ArrayLike,
    surface: HeightMap,
    accuracy: Accuracy,
    base: float | None = None,
    sigmas: ArrayLike | None = None,
) -> Measured:
    """Measure at places (P,2 or 3) of the map: east, north and, where given and not NaN, height;
    else the surface's. `base`: height of the level plane that a volume stands on, by default the
    plane that fits the outline best; `sigmas` (P,): σ of the heights that are given, by default
    that of the surface there.

    Raises BadInput for too few places, places that are not finite, off the surface or where it is
    unknown, and outlines that cross themselves or span nothing.
    """
    coords = require_measure(kind, places, base)
    points, deviations = _on_surface(coords, surface, None if sigmas is None else np.asarray(sigmas, np.float64))
    if kind == "distance":
        return _distance(points, deviations, accuracy)
    if kind == "height":
        return _height(points, deviations, accuracy)
    if kind == "profile":
        return _profile(points, surface, accuracy)
    outline = Outline.of(points, surface)
    return _area(outline, surface, accuracy) if kind == "area" else _volume(outline, surface, accuracy, base)


def measure_places(kind: MeasureKind, places: ArrayLike, sigmas: ArrayLike, accuracy: Accuracy) -> Measured:
    """A distance, height or area by places (P,3) alone, whose heights have σ (P,), before there is
    a surface; the area is that on the map. BadInput as `measure`, and for what needs a surface."""
    points, deviations = require_measure(kind, places), np.asarray(sigmas, np.float64)
    if kind == "distance":
        return _distance(points, deviations, accuracy)
    if kind == "height":
        return _height(points, deviations, accuracy)
    if kind != "area":
        raise BadInput(f"a {kind} is of the surface, which places alone do not say: measure it on a finished run.")
    from shapely.geometry import Polygon

    shape = Polygon(points[:, :2] - points[0, :2])
    if not shape.is_valid or shape.area <= 0:
        raise BadInput("the outline crosses itself or spans no area: give its corners in order around it.")
    area = float(shape.area)
    return Measured(
        kind=kind,
        places=points,
        figures=(Figure(name="area", value=area, sigma=_area_sigma(points, area, accuracy), power=2),),
        filled=0.0,
    )


def _on_surface(coords: FloatArray, surface: HeightMap, of_given: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Places (P,3) and σ (P,) of their heights; a given height has its own, else that of the
    surface there, or its usual one."""
    heights, sigmas = surface.at(coords[:, :2])
    listed_heights = coords[:, 2] if coords.shape[1] == 3 else np.full(len(coords), np.nan)
    is_given = np.isfinite(listed_heights)
    unknown = ~is_given & ~np.isfinite(heights)
    if unknown.any():
        row = int(np.argmax(unknown))
        raise BadInput(
            f"the surface is not known at place {row + 1}, {coords[row, 0]:.3f}, {coords[row, 1]:.3f}: give its height, or another place."
        )
    if of_given is None:
        usual = float(np.nanmedian(surface.sigma)) if (surface.source != UNKNOWN).any() else 0.0
        of_given = np.where(np.isfinite(sigmas), sigmas, usual)
    elif of_given.shape != (len(coords),) or not (np.isfinite(of_given[is_given]).all() and (of_given[is_given] >= 0).all()):
        raise BadInput(f"σ of heights of shape {of_given.shape} came, expected ({len(coords)},) from zero on.")
    return np.column_stack([coords[:, :2], np.where(is_given, listed_heights, heights)]), np.where(is_given, of_given, sigmas)


def _height(points: FloatArray, sigmas: FloatArray, accuracy: Accuracy) -> Measured:
    rise = points[1, 2] - points[0, 2]
    sigma = float(np.sqrt(np.square(sigmas).sum() + (accuracy.scale * rise) ** 2))
    return Measured(kind="height", places=points, figures=(Figure(name="height", value=float(rise), sigma=sigma, power=1),), filled=0.0)


def _area_sigma(points: FloatArray, area: float, accuracy: Accuracy) -> float:
    across = np.roll(points[:, :2], -1, axis=0) - np.roll(points[:, :2], 1, axis=0)
    return float(np.sqrt(accuracy.place**2 * np.square(across).sum() / 4 + (2 * accuracy.scale * area) ** 2))


def _distance(points: FloatArray, sigmas: FloatArray, accuracy: Accuracy) -> Measured:
    steps = np.diff(points, axis=0)
    figures = []
    for name, axes in (("distance", 3), ("distance on the map", 2)):
        lengths = np.linalg.norm(steps[:, :axes], axis=1)
        units = steps[:, :axes] / np.maximum(lengths, 1e-12)[:, None]
        # A corner between two steps moves both: the gradient of the sum is the difference of units.
        gradient = np.concatenate([-units[:1], units[:-1] - units[1:], units[-1:]])
        deviations = np.column_stack([np.full((len(points), 2), accuracy.place), sigmas])[:, :axes]
        variance = float(np.square(gradient * deviations).sum())
        total = float(lengths.sum())
        figures.append(Figure(name=name, value=total, sigma=float(np.sqrt(variance + (accuracy.scale * total) ** 2)), power=1))
    return Measured(kind="distance", places=points, figures=tuple(figures), filled=0.0)


def _profile(points: FloatArray, surface: HeightMap, accuracy: Accuracy) -> Measured:
    lengths = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = int(np.ceil(along[-1] / surface.grid.cell)) + 1
    if count > MAX_SAMPLES:
        raise BadInput(f"a profile of {along[-1]:.3g} takes {count:,} cells, more than {MAX_SAMPLES:,}: give a shorter line.")
    at = np.linspace(0, along[-1], max(2, count))
    places = np.column_stack([np.interp(at, along, points[:, axis]) for axis in (0, 1)])
    heights, sigmas = surface.at(places)
    is_finite = np.isfinite(heights)
    if not is_finite.any():
        raise BadInput("the surface is not known anywhere along the line: draw it over the ground that was seen.")
    rise, length = float(np.ptp(heights[is_finite])), float(along[-1])
    figures = (
        Figure(name="length", value=length, sigma=float(np.hypot(np.sqrt(2) * accuracy.place, accuracy.scale * length)), power=1),
        Figure(
            name="highest above lowest",
            value=rise,
            sigma=float(np.hypot(np.sqrt(2) * np.median(sigmas[is_finite]), accuracy.scale * rise)),
            power=1,
        ),
    )
    return Measured(
        kind="profile",
        places=points,
        figures=figures,
        filled=_filled_share(surface, places),
        profile=np.column_stack([at, heights, sigmas]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """A polygon's corners (K,3), its area, and the share of each cell (H,W) of a part of the raster
    that it covers, from the cell `corner` on."""

    points: FloatArray
    area: float
    cover: FloatArray
    corner: tuple[int, int]

    @staticmethod
    def of(points: FloatArray, surface: HeightMap) -> Outline:
        """The outline over a surface; BadInput where it crosses itself or spans nothing."""
        from shapely.geometry import Polygon

        shape = Polygon(points[:, :2] - points[0, :2])
        if not shape.is_valid or shape.area <= 0:
            raise BadInput("the outline crosses itself or spans no area: give its corners in order around it.")
        cells = surface.grid.cells_of(points[:, :2])
        low = np.maximum(np.floor(cells.min(axis=0)), 0).astype(np.int64)
        high = np.minimum(np.ceil(cells.max(axis=0)), surface.grid.shape).astype(np.int64)
        if (cells < 0).any() or (cells > np.array(surface.grid.shape)).any():
            raise BadInput("the outline reaches beyond the ground that was seen: draw it within.")
        # Eight by eight parts of each cell: the area of the cells is the outline's to a thousandth.
        fine = np.zeros(tuple(8 * np.maximum(high - low, 1)), np.uint8)
        cv2.fillPoly(fine, [np.rint(16 * (8 * (cells - low) - 0.5))[:, ::-1].astype(np.int32)], 1, shift=4)
        rows, columns = np.maximum(high - low, 1)
        cover = fine.reshape(rows, 8, columns, 8).mean(axis=(1, 3))
        scale = shape.area / max(cover.sum() * surface.grid.cell**2, 1e-300)
        return Outline(points=points, area=float(shape.area), cover=cover * scale, corner=(int(low[0]), int(low[1])))

    def part(self, raster: NDArray) -> NDArray:
        """The part of a raster (H,W) that `cover` is of."""
        rows, columns = self.cover.shape
        return raster[self.corner[0] : self.corner[0] + rows, self.corner[1] : self.corner[1] + columns]

    def sigma(self, accuracy: Accuracy) -> float:
        """σ of the area."""
        return _area_sigma(self.points, self.area, accuracy)


def _area(outline: Outline, surface: HeightMap, accuracy: Accuracy) -> Measured:
    heights = outline.part(surface.heights)
    rows, columns = np.gradient(heights, surface.grid.cell) if min(heights.shape) > 1 else (np.zeros_like(heights),) * 2
    slant = np.sqrt(1 + rows**2 + columns**2)
    usual = float(np.nanmean(slant)) if np.isfinite(slant).any() else 1.0
    over = float((np.where(np.isfinite(slant), slant, usual) * outline.cover).sum() * surface.grid.cell**2)
    sigma = outline.sigma(accuracy)
    figures = (
        Figure(name="area", value=outline.area, sigma=sigma, power=2),
        Figure(name="area over the surface", value=over, sigma=sigma * over / outline.area, power=2),
    )
    return Measured(kind="area", places=outline.points, figures=figures, filled=_filled_within(outline, surface))


def _volume(outline: Outline, surface: HeightMap, accuracy: Accuracy, base: float | None) -> Measured:
    heights, sigmas = outline.part(surface.heights), outline.part(surface.sigma)
    is_finite = np.isfinite(heights) & (outline.cover > 0)
    unknown = float(outline.cover[~np.isfinite(heights)].sum() / outline.cover.sum())
    if unknown > 0.05:
        raise BadInput(f"the surface is not known in {100 * unknown:.2g} % of the outline, at most 5 % may be open: draw another one.")
    above = heights - _plane(outline, surface, base)
    # What little is open counts as the mean of the rest.
    scale = outline.cover.sum() / outline.cover[is_finite].sum()
    cell_area = scale * surface.grid.cell**2 * outline.cover[is_finite]
    raised, sunk = float((np.maximum(above[is_finite], 0) * cell_area).sum()), float((np.maximum(-above[is_finite], 0) * cell_area).sum())
    spread = float(np.sqrt(SHARED) * np.average(sigmas[is_finite], weights=outline.cover[is_finite]))
    figures = []
    for name, value, area in (
        ("volume", raised - sunk, outline.area),
        ("above the plane", raised, float(cell_area[above[is_finite] > 0].sum())),
        ("below the plane", sunk, float(cell_area[above[is_finite] < 0].sum())),
    ):
        figures.append(Figure(name=name, value=value, sigma=float(np.hypot(spread * area, 3 * accuracy.scale * value)), power=3))
    return Measured(kind="volume", places=outline.points, figures=tuple(figures), filled=_filled_within(outline, surface))


def _plane(outline: Outline, surface: HeightMap, base: float | None) -> FloatArray | float:
    """Heights of the base under the cells: level, or the plane through the outline's corners."""
    if base is not None:
        return base
    middle = outline.points[:, :2].mean(axis=0)
    design = np.column_stack([np.ones(len(outline.points)), outline.points[:, :2] - middle])
    # Corners on one slope or line may leave a tilt open: the shortest solution has none.
    plane = np.linalg.lstsq(design, outline.points[:, 2], rcond=None)[0]
    east, north = surface.grid.centers()
    rows, columns = outline.cover.shape
    x, y = np.meshgrid(east[outline.corner[1] : outline.corner[1] + columns], north[outline.corner[0] : outline.corner[0] + rows])
    return plane[0] + plane[1] * (x - middle[0]) + plane[2] * (y - middle[1])


def _filled_within(outline: Outline, surface: HeightMap) -> float:
    return float(outline.cover[outline.part(surface.source) != MEASURED].sum() / outline.cover.sum())


def _filled_share(surface: HeightMap, places: FloatArray) -> float:
    cells = np.clip(np.floor(surface.grid.cells_of(places)), 0, np.array(surface.grid.shape) - 1).astype(np.int64)
    return float((surface.source[cells[:, 0], cells[:, 1]] != MEASURED).mean())
