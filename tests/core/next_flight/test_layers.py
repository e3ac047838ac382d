"""Layers and shapes of the block: walls that no photograph shows are lines of their area."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.geometry.support import Support
from radiant_core.next_flight.layers import BANDS, HOLE, WEAK, KnownMap, support_raster, weak_features
from radiant_core.next_flight.sightings import known_by
from tests.core.next_flight.block import FRAME, HEIGHT, SIDE, block_sights, looks
from tests.core.scenes import ground_splats


@pytest.fixture(scope="module")
def seen_from_above() -> KnownMap:
    sights = block_sights()
    cameras = looks((0.0, 0.0, 40.0))
    known = known_by(sights, cameras, sights.all_of(cameras))
    error_db = np.where(known.unseen, np.nan, 25.0)
    support = np.full(sights.facets.surface.grid.shape, 0.5)
    return KnownMap(facets=sights.facets, knowledge=known, support=support, error_db=error_db, margin_db=2.0)


def hidden_around(found: KnownMap) -> int:
    """How many cells of the ground touch the block: 4 · 10 beside its sides, fewer or more by its
    rounded corners, whose cells the middle of the picture sees past."""
    tops = found.facets.places[~found.facets.is_wall]
    hidden = found.knowledge.unseen[~found.facets.is_wall]
    assert (np.abs(tops[hidden, :2]).max(axis=1) < SIDE / 2 + 1).all()
    assert (tops[hidden, 2] == 0).all()
    assert 36 <= hidden.sum() <= 44
    return int(hidden.sum())


def test_bands_say_what_is_known(seen_from_above: KnownMap) -> None:
    bands = seen_from_above.bands(-9999.0)
    assert bands.shape == (40, 40, len(BANDS))
    # One view: no depth. It sees all but the metre around the block that lies behind its roof's edge.
    seen = bands[..., 0] == 1
    assert seen.sum() == 1600 - hidden_around(seen_from_above)
    assert (bands[seen, 4] == 25).all() and (bands[seen, 5] == 23).all()
    assert (bands[seen, 6] == WEAK).all()
    assert (bands[~seen, 6] == HOLE).all() and (bands[~seen, 4] == -9999).all()
    assert bands[..., 7].sum() == pytest.approx(4 * SIDE * HEIGHT)
    assert np.array_equal(bands[..., 7], bands[..., 8])


def test_walls_that_nothing_shows_are_one_line_around_the_block(seen_from_above: KnownMap) -> None:
    features = weak_features(seen_from_above, FRAME)
    holes = [feature for feature in features if feature["properties"]["kind"] == "hole" and feature["properties"]["on"] == "wall"]
    assert len(holes) == 1
    assert holes[0]["properties"]["area"] == pytest.approx(4 * SIDE * HEIGHT)
    assert holes[0]["properties"]["lowest"] == 0.0 and holes[0]["properties"]["highest"] == HEIGHT
    length = sum(np.linalg.norm(np.diff(np.array(part), axis=0), axis=1).sum() for part in holes[0]["geometry"]["coordinates"])
    assert length == pytest.approx(4 * SIDE)
    ground = [feature for feature in features if feature["geometry"]["type"] == "Polygon"]
    assert sum(feature["properties"]["area"] for feature in ground) == pytest.approx(1600.0)
    assert seen_from_above.area_of(HOLE, walls=True) == pytest.approx(4 * SIDE * HEIGHT)


def test_support_is_weighed_by_pixels() -> None:
    splats = ground_splats(2)
    splats = type(splats)(**{**splats.arrays(), "means": np.array([[0.5, 0.5, 0.0], [0.6, 0.6, 0.0]], np.float32)})
    support = Support(num_views=np.array([5, 1]), parallax_deg=np.array([9.0, 0.0]), shown_px=np.array([3.0, 1.0]))
    raster = support_raster(block_sights().facets, FRAME, splats, support)
    assert np.nanmax(raster) == pytest.approx(0.75)
    assert np.isfinite(raster).sum() == 1
