"""Who speaks for a place: against brute force, and on degenerate, poisoned and huge input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.ownership import KNOWN_SHARE, NUM_CELLS, find_owners, ownership
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.coverage import coverage
from radiant_core.plan.regions.claims import claims_of_cells, claims_of_polygons
from radiant_core.splats import Splats, concatenate_splats
from tests.core.scenes import cameras_above, ground_splats

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


def moved(splats: Splats, xyz: tuple[float, float, float]) -> Splats:
    return replace(splats, means=splats.means + np.array(xyz, np.float32))


def test_what_only_one_model_has_stays_its_own_though_another_one_covers_it() -> None:
    ground = [moved(ground_splats(4000, seed=seed), (x, 0, 0)) for seed, x in ((1, -2.0), (2, 2.0))]
    # Far away, better covered by the eastern cameras, but known to the west alone: as a sky is.
    deep = moved(ground_splats(40, seed=3, half_side_m=1.0), (21.0, 0.0, -40.0))
    models = [concatenate_splats([ground[0], deep]), ground[1]]
    cameras = [WEST, EAST]
    assert (coverage(deep.means, EAST) > coverage(deep.means, WEST)).all()
    owner = find_owners(models, cameras)[0].owner
    assert not owner[len(ground[0]) :].any()
    both = [models[0], concatenate_splats([ground[1], deep])]
    assert find_owners(both, cameras)[0].owner[len(ground[0]) :].all(), "the one that covers it better has it too"
    on_ground = find_owners(models, cameras)
    for found, model in zip(on_ground, ground, strict=True):
        by_coverage = ownership(model.means, cameras)
        np.testing.assert_array_equal(found.contested[: len(model)], by_coverage.contested)
        middle = np.abs(model.means[:, 0]) < 1.0
        np.testing.assert_array_equal(found.owner[: len(model)][middle], by_coverage.owner[middle])


def test_owners_who_have_something_are_those_of_a_plain_count() -> None:
    rng = np.random.default_rng(5)
    far = replace(ground_splats(200, seed=4), means=(rng.normal(size=(200, 3)) * rng.uniform(0.1, 400, (200, 1))).astype(np.float32))
    models, cameras = [far, moved(ground_splats(200, seed=6), (1.0, 0, 0))], [WEST, EAST]
    centers = np.concatenate([WEST.centers, EAST.centers])
    radius = np.linalg.norm(np.ptp(centers, axis=0)) / 2

    def cell(place: np.ndarray) -> list[int]:
        x = (place.astype(np.float64) - centers.mean(axis=0)) / radius
        length = np.linalg.norm(x)
        c = x if length <= 1 else (2 - 1 / length) * x / length
        return [min(NUM_CELLS - 1, int((value + 2) / 4 * NUM_CELLS)) for value in c]

    cells = [[cell(mean) for mean in model.means] for model in models]

    def present(asked: list[int], model: int) -> float:
        near = [max(abs(a - b) for a, b in zip(asked, own, strict=True)) <= 1 for own in cells[model]]
        return float(models[model].opacities[near].sum())

    for index, found in enumerate(find_owners(models, cameras)):
        by_coverage = ownership(models[index].means, cameras).owner
        for row, owner in enumerate(by_coverage):
            has = present(cells[index][row], owner) >= KNOWN_SHARE * present(cells[index][row], index)
            assert found.owner[row] == (owner if has else index)


def test_cameras_in_one_place_and_places_far_beyond_float32_squares_find_owners() -> None:
    one = cameras_above([(0, 0)])
    huge = replace(ground_splats(20), means=np.full((20, 3), 3e37, np.float32))
    for found in find_owners([ground_splats(30), huge], [one, one]):
        assert set(found.owner.tolist()) <= {0, 1}
    empty = ground_splats(10).select(np.arange(0))
    assert [len(found.owner) for found in find_owners([empty, ground_splats(5)], [WEST, EAST])] == [0, 5]
