"""Two dates of made-up ground: what was planted is found, light and noise are not, and frames that differ by a tilt are levelled."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.survey.change import DateRasters, color_difference, find_change
from radiant_core.survey.dates import levelled
from radiant_core.survey.heights import HeightMap
from radiant_core.survey.map_grid import MapGrid

GRID = MapGrid(north_west=np.array([1000.0, 2000.0]), cell=0.25, rows=300, columns=400, epsg=None)
GSD = 0.12


def ground(seed: int = 0) -> DateRasters:
    rng = np.random.default_rng(seed)
    base = np.random.default_rng(7)
    texture = cv2.GaussianBlur(base.uniform(0, 255, (*GRID.shape, 3)).astype(np.float32), (0, 0), 3) * 3 - 250
    image = np.clip(texture + rng.normal(0, 4, texture.shape), 20, 235).astype(np.uint8)
    heights = 5 * np.sin(np.arange(400) / 60)[None] + np.zeros(GRID.shape) + rng.normal(0, 0.03, GRID.shape)
    surface = HeightMap(grid=GRID, heights=heights, sigma=np.full(GRID.shape, 0.05, np.float32), source=np.ones(GRID.shape, np.uint8))
    return DateRasters(heights=surface, image=image, is_known=np.ones(GRID.shape, bool))


def changed() -> DateRasters:
    """A house of 10 × 10 m at rows 40 … 80, columns 60 … 100, one painted at 160, 240, and a thin wall."""
    later = ground(1)
    heights, image = later.heights.heights.copy(), later.image.copy()
    heights[40:80, 60:100] += 6
    heights[200:290, 300:303] += 6
    image[160:200, 240:280] = [200, 40, 40]
    # Exposure of ±20 % that varies over the ground.
    light = np.linspace(0.8, 1.2, 400)[None, :, None]
    return DateRasters(
        heights=replace(later.heights, heights=heights), image=np.clip(image * light, 0, 255).astype(np.uint8), is_known=later.is_known
    )


def test_a_new_house_and_a_painted_one_are_found_and_nothing_else() -> None:
    found = find_change(ground(), changed(), GSD)
    assert [patch.kind for patch in found.patches] == ["height", "colour"] or [patch.kind for patch in found.patches] == [
        "colour",
        "height",
    ]
    house = next(patch for patch in found.patches if patch.kind == "height")
    # Borders of whole cells, closed by 7 of them.
    assert house.area == pytest.approx(100, rel=0.05) and house.height_change == pytest.approx(6, abs=0.05)
    assert house.volume == pytest.approx(600, rel=0.05)
    low, high = house.outline.min(axis=0), house.outline.max(axis=0)
    np.testing.assert_allclose([low, high], [[1015, 1980], [1025, 1990]], atol=0.3)
    back = find_change(changed(), ground(), GSD)
    assert next(patch for patch in back.patches if patch.kind == "height").height_change == pytest.approx(-6, abs=0.05)


def test_the_same_ground_under_other_light_has_not_changed() -> None:
    later = ground(1)
    for light in (0.8, 1.2):
        assert find_change(ground(), replace(later, image=np.clip(later.image * light, 0, 255).astype(np.uint8)), GSD).patches == ()


def test_what_one_date_did_not_see_is_not_compared() -> None:
    unseen = replace(changed(), is_known=np.zeros(GRID.shape, bool))
    assert [patch.kind for patch in find_change(ground(), unseen, GSD).patches] == ["height"]
    nothing = replace(unseen.heights, source=np.zeros(GRID.shape, np.uint8), heights=np.full(GRID.shape, np.nan))
    with pytest.raises(BadInput, match="no cell is known at both dates"):
        find_change(ground(), replace(unseen, heights=nothing), GSD)
    with pytest.raises(BadInput, match="one grid"):
        find_change(ground(), replace(ground(), image=np.zeros((3, 3, 3), np.uint8)), GSD)
    assert not color_difference(ground().image, changed().image, np.zeros(GRID.shape, bool)).any()


def test_a_tilted_frame_is_levelled_by_what_did_not_change() -> None:
    older, later = ground().heights, changed().heights
    rows, columns = np.indices(GRID.shape)
    tilt = 0.4 + 0.002 * 0.25 * (columns - 200) - 0.003 * 0.25 * (rows - 150)
    again, plane = levelled(older, replace(later, heights=later.heights + tilt))
    assert (np.abs(plane - [0.4, 0.002, 0.003]) < [5e-3, 1e-4, 1e-4]).all()
    assert np.abs(again.heights - later.heights).max() < 0.02
    with pytest.raises(BadInput, match="too few to compare"):
        levelled(older, replace(later, source=np.zeros(GRID.shape, np.uint8)))
