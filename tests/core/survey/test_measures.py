"""Measures on surfaces whose figures are known, their σ against many trials, and what cannot be measured."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput
from radiant_core.survey.heights import HeightMap
from radiant_core.survey.map_grid import MapGrid
from radiant_core.survey.measures import Accuracy, Measured, measure

CORNER = np.array([465_000.0, 5_246_100.0])
GRID = MapGrid(north_west=CORNER, cell=0.25, rows=400, columns=480, epsg=32632)
SQUARE = CORNER + np.array([[20.0, -20], [60, -20], [60, -50], [20, -50]])
NOTHING = Accuracy(place=0.0, scale=0.0)


def surface(heights: np.ndarray, sigma: float = 0.05) -> HeightMap:
    return HeightMap(grid=GRID, heights=heights, sigma=np.full(GRID.shape, sigma, np.float32), source=np.ones(GRID.shape, np.uint8))


def middles() -> tuple[np.ndarray, np.ndarray]:
    east, north = np.meshgrid(*GRID.centers())
    return east - CORNER[0], north - CORNER[1]


def slope() -> HeightMap:
    """A plane that rises by 0.3 per metre east and 0.4 per metre north."""
    east, north = middles()
    return surface(400 + 0.3 * east + 0.4 * north)


def figure(found: Measured, name: str) -> tuple[float, float]:
    return next((row.value, row.sigma) for row in found.figures if row.name == name)


def test_distances_heights_areas_and_volumes_of_planes_are_exact() -> None:
    ends = CORNER + np.array([[10.125, -60.125], [40.125, -20.125]])
    found = measure("distance", ends, slope(), NOTHING)
    rise = 0.3 * 30 + 0.4 * 40
    assert figure(found, "distance")[0] == pytest.approx(np.hypot(50, rise), abs=1e-9)
    assert figure(found, "distance on the map")[0] == pytest.approx(50, abs=1e-9)
    assert figure(measure("height", ends, slope(), NOTHING), "height")[0] == pytest.approx(rise, abs=1e-9)
    area = measure("area", SQUARE, slope(), NOTHING)
    assert figure(area, "area")[0] == pytest.approx(1200, abs=1e-6)
    assert figure(area, "area over the surface")[0] == pytest.approx(1200 * np.sqrt(1 + 0.3**2 + 0.4**2), rel=1e-9)
    # The plane through its own corners leaves nothing but the height within the corner cells.
    assert abs(figure(measure("volume", SQUARE, slope(), NOTHING), "volume")[0]) < 1200 * 0.13
    level = figure(measure("volume", SQUARE, slope(), NOTHING, base=398.0), "volume")[0]
    # Mean height over the square: 400 + 0.3 · 40 − 0.4 · 35; an eighth of a cell of cover at its rim.
    assert level == pytest.approx(1200 * (400 + 12 - 14 - 398), abs=1.0)


def test_a_cut_pyramid_counts_above_and_its_pit_below() -> None:
    east, north = middles()
    cone = np.maximum(0, 5 - np.hypot(east - 40, north + 35) / 2)
    heap, pit = surface(100 + cone), surface(100 - cone)
    true = np.pi * 10**2 * 5 / 3
    for found, sign in ((heap, 1), (pit, -1)):
        measured = measure("volume", SQUARE, found, NOTHING)
        assert figure(measured, "volume")[0] == pytest.approx(sign * true, rel=2e-3)
        assert figure(measured, "above the plane" if sign > 0 else "below the plane")[0] == pytest.approx(true, rel=2e-3)


def test_a_profile_follows_the_surface_and_its_length() -> None:
    line = CORNER + np.array([[10.0, -10], [10, -50], [50, -50]])
    found = measure("profile", line, slope(), NOTHING)
    along, heights, sigmas = found.profile.T
    assert figure(found, "length")[0] == pytest.approx(80) and along[-1] == pytest.approx(80)
    east, north = np.where(along < 40, 10, along - 30), np.where(along < 40, -10 - along, -50)
    # Half a cell along either axis.
    assert np.abs(heights - (400 + 0.3 * east + 0.4 * north)).max() < 0.125 * 0.7 + 1e-9 and (sigmas > 0).all()


@pytest.mark.parametrize("kind", ["distance", "height", "area"])
def test_sigma_is_what_many_trials_scatter_by(kind: MeasureKind) -> None:
    """Corners and scale are moved at random; heights are given, so that the surface plays no part."""
    rng = np.random.default_rng(0)
    accuracy, sigma_z = Accuracy(place=0.06, scale=0.004), 0.05
    flat = surface(np.full(GRID.shape, 0.0), sigma_z)
    places = np.column_stack([SQUARE, [0.0, 3, 5, 2]])[: 2 if kind == "height" else 4]
    told = measure(kind, places, flat, accuracy).figures[0]
    values = []
    for _ in range(300):
        scale = 1 + rng.normal(0, accuracy.scale)
        moved = (places - places.mean(axis=0)) * scale + places.mean(axis=0)
        moved = moved + rng.normal(0, 1, moved.shape) * [accuracy.place, accuracy.place, sigma_z]
        values.append(measure(kind, moved, flat, NOTHING).figures[0].value)
    # 300 trials know a standard deviation to 4 %: three times as much, and first order.
    assert told.sigma == pytest.approx(np.std(values), rel=0.15)
    assert told.value == pytest.approx(np.mean(values), abs=4 * told.sigma / np.sqrt(300) + 1e-3 * abs(told.value))


def test_filled_ground_is_said_and_unknown_ground_is_not_measured() -> None:
    ground = surface(np.full(GRID.shape, 10.0))
    half = HeightMap(
        grid=GRID,
        heights=ground.heights,
        sigma=ground.sigma,
        source=np.where(np.arange(480) < 160, 2, 1)[None].repeat(400, 0).astype(np.uint8),
    )
    assert measure("area", SQUARE, half, NOTHING).filled == pytest.approx(0.5, abs=0.01)
    heights = np.full(GRID.shape, 10.0)
    heights[:, :160] = np.nan
    unknown = HeightMap(
        grid=GRID,
        heights=heights,
        sigma=np.where(np.isfinite(heights), 0.1, np.nan).astype(np.float32),
        source=np.isfinite(heights).astype(np.uint8),
    )
    with pytest.raises(BadInput, match="not known in 50 % of the outline"):
        measure("volume", np.column_stack([SQUARE, np.zeros(4)]), unknown, NOTHING)
    with pytest.raises(BadInput, match="not known at place 1"):
        measure("distance", SQUARE, unknown, NOTHING)
    found = measure("profile", np.column_stack([SQUARE[:2], [0, 0]]), unknown, NOTHING)
    assert np.isnan(found.profile[:, 1]).mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "places", "sentence"),
    [
        ("distance", [[1.0, 2.0]], "two or more"),
        ("height", SQUARE[:3], "takes two"),
        ("area", SQUARE[:2], "three or more"),
        ("area", SQUARE[[0, 2, 1, 3]], "crosses itself"),
        ("area", SQUARE[[0, 1, 0]], "crosses itself or spans no area"),
        ("volume", SQUARE + 1e6, "not known at place"),
        ("volume", np.column_stack([SQUARE + np.array([90, 0]), np.zeros(4)]), "beyond the ground"),
        ("distance", [[np.nan, 0], [1, 1]], "finite"),
        ("distance", [[np.inf, 0], [1, 1]], "finite"),
        ("distance", [], "finite"),
        ("distance", [[1, 2, 3, 4], [1, 2, 3, 4]], "finite"),
        ("profile", np.array([[0.0, 0, 0], [1e9, 0, 0]]), "shorter line"),
    ],
)
def test_what_cannot_be_measured_is_said_in_one_sentence(kind: MeasureKind, places: np.ndarray, sentence: str) -> None:
    with pytest.raises(BadInput, match=sentence):
        measure(kind, places, slope(), NOTHING)
    for value in (-1.0, np.nan, np.inf):
        with pytest.raises(BadInput, match="accuracy"):
            Accuracy(place=value, scale=0.0)
    with pytest.raises(BadInput, match="base"):
        measure("distance", SQUARE, slope(), NOTHING, base=3.0)
