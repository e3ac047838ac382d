"""Who speaks for a place: against brute force, and on degenerate, poisoned and huge input."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.aggregate.ownership import ownership
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import coverage
from radiant_core.plan.regions.claims import claims_of_cells, claims_of_polygons
from tests.core.scenes import cameras_above

WEST, EAST = cameras_above([(-2, -1), (-2, 1)]), cameras_above([(2, -1), (2, 1)])
RNG = np.random.default_rng(0)
PLACES = np.c_[RNG.uniform(-6, 6, (300, 2)), RNG.uniform(-1, 1, 300)]


def plain_coverage(place: np.ndarray, cameras: Cameras) -> float:
    total = 0.0
    for index in range(len(cameras)):
        x, y, z = cameras.cam_from_world[index, :3, :3] @ place + cameras.cam_from_world[index, :3, 3]
        if z <= 0:
            continue
        (width, height), K = cameras.sizes_wh[index], cameras.Ks[index]
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        inside = min(u, width - u) / (width / 2), min(v, height - v) / (height / 2)
        if min(inside) > 0:
            total += min(1.0, 4 * min(inside)) * K[0, 0] / width / z
    return total


def test_coverage_is_the_formula() -> None:
    np.testing.assert_allclose(coverage(PLACES, WEST), [plain_coverage(place, WEST) for place in PLACES], rtol=1e-12)


def test_the_one_that_covers_best_owns_what_nobody_claims() -> None:
    found = ownership(PLACES, [WEST, EAST])
    west, east = coverage(PLACES, WEST), coverage(PLACES, EAST)
    np.testing.assert_array_equal(found.owner, (east > west).astype(int))
    np.testing.assert_array_equal(found.contested, (np.minimum(west, east) > 0) & (np.minimum(west, east) >= 0.1 * np.maximum(west, east)))
    assert found.contested.any() and not found.contested.all()


def test_a_claim_holds_unless_another_sees_clearly_better() -> None:
    claimed_by_east = claims_of_cells(np.array([[-100.0, 0.0], [0.0, 0.0]]), np.zeros(2))
    owner = ownership(PLACES, [WEST, EAST], claimed_by_east).owner
    west, east = coverage(PLACES, WEST), coverage(PLACES, EAST)
    np.testing.assert_array_equal(owner, np.where(east >= 0.8 * west, 1, 0))
    assert 0 < owner.mean() < 1


def test_places_that_nobody_sees_belong_to_the_region_and_are_not_contested() -> None:
    unseen = np.array([[-1e3, 0, 0], [1e3, 0, 0], [0.0, 0, 1e6], [1e8, -1e8, 1e8]])
    cells = claims_of_cells(np.array([[-2.0, 0.0], [2.0, 0.0]]), np.zeros(2))
    found = ownership(unseen, [WEST, EAST], cells)
    assert found.owner.tolist()[:2] == [0, 1] and not found.contested.any()
    assert ownership(unseen, [WEST, EAST]).owner.tolist() == [0, 0, 0, 0]
    alone = ownership(PLACES, [WEST])
    assert not alone.owner.any() and not alone.contested.any()
    assert ownership(np.zeros((0, 3)), [WEST, EAST], cells).owner.shape == (0,)


def test_polygons_claim_what_lies_in_them_or_nearest() -> None:
    squares = [np.array([[x, 0], [x + 1, 0], [x + 1, 1], [x, 1.0]]) for x in (0, 2)]
    claims = claims_of_polygons([squares[0], np.zeros((0, 2)), squares[1]])
    assert claims is not None
    assert claims(np.array([[0.5, 0.5], [2.5, 0.5], [1.4, 0.5], [1.6, 0.5], [1e9, 0], [-1e9, 5]])).tolist() == [0, 2, 0, 2, 2, 0]
    assert claims_of_polygons([np.zeros((0, 2))]) is None


def test_bad_input_is_one_sentence() -> None:
    with pytest.raises(BadInput, match="places"):
        ownership(np.array([[0.0, np.nan, 0.0]]), [WEST])
    with pytest.raises(BadInput, match="no cameras"):
        ownership(PLACES, [])
    with pytest.raises(BadInput, match="weights"):
        claims_of_cells(np.zeros((2, 2)), np.zeros(3))
