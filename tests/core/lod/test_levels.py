"""Chunks of a model: every Gaussian in one of them, and what changes elsewhere moves nothing."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.lod.cells import FAR, LodRegion, divide, region_of_polygon, regions_of_splats, whole_region
from radiant_core.lod.levels import Chunk, LodLimits, chunks_of, far_field, lay_out
from radiant_core.splats import Splats, concatenate_splats
from tests.core.lod.test_merging import made_up

SMALL = LodLimits(num_levels=3, chunk_count=150, leaf_side_m=2.0, leaf_count=20)


def square(east: float, side: float = 20.0) -> LodRegion:
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * side + [east, -side / 2]
    return region_of_polygon(corners, 2.0)


def at(splats: Splats, offset: tuple[float, float, float]) -> Splats:
    return Splats(**{**splats.arrays(), "means": splats.means + np.array(offset, np.float32)})


def chunks(splats: Splats, regions: list[LodRegion], limits: LodLimits = SMALL) -> list[Chunk]:
    return list(chunks_of(splats, lay_out(splats, regions, limits)))


def test_every_gaussian_is_in_one_chunk_or_far_and_chunks_keep_their_limits() -> None:
    sky = at(made_up(30, 5), (4000, 0, 900))
    splats = concatenate_splats([made_up(700), sky])
    layout = lay_out(splats, [square(-20.0), square(0.0)], SMALL)
    found = list(chunks_of(splats, layout))
    far = far_field(splats, layout)
    assert len(far) == 30 and layout.num_chunks == len(found) > 4
    rows = np.concatenate([far.means, *(chunk.levels[0].means for chunk in found)])
    assert np.array_equal(np.unique(rows, axis=0), np.unique(splats.means, axis=0))
    for chunk in found:
        sizes = [len(level) for level in chunk.levels]
        assert sizes[0] <= 150
        spans = np.stack([leaf.spans for leaf in chunk.leaves])
        assert spans[:, :, 1].sum(axis=0).tolist() == sizes
        for level, model in enumerate(chunk.levels):
            ends = 0
            for leaf in chunk.leaves:
                offset, count = leaf.spans[level]
                assert offset == ends, "leaf after leaf without gaps"
                ends += count
                own = model.means[offset : offset + count]
                assert (own >= leaf.box[0] - 1e-4).all() and (own <= leaf.box[1] + 1e-4).all()
        finest = spans[:, 0, 1]
        assert (spans[:, 1, 1] <= finest).all() and sizes[1] <= -(-sizes[0] // 2) + len(chunk.leaves), "half, but for what has no neighbour"


def test_what_changes_in_one_region_leaves_all_chunks_of_the_others() -> None:
    regions = [square(-20.0), square(0.0)]
    west, east = made_up(400, 1), at(made_up(400, 2), (0, 0, 0))
    west = at(west.select(west.means[:, 0] < -1), (0, 0, 0))
    east = east.select(east.means[:, 0] > 1)
    more = at(made_up(90, 3), (45, 0, 0))
    before = {(chunk.region, chunk.number): chunk for chunk in chunks(concatenate_splats([west, east]), regions)}
    changed = concatenate_splats([west, east.select(np.arange(0, len(east), 2)), more])
    after = {(chunk.region, chunk.number): chunk for chunk in chunks(changed, [*regions, square(20.0, 60.0)])}
    assert any(region == 2 for region, _ in after)
    for key in (key for key in before if key[0] == 0):
        for old, new in zip(before[key].levels, after[key].levels, strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(old.arrays().values(), new.arrays().values(), strict=True))
    assert sum(region == 0 for region, _ in before) == sum(region == 0 for region, _ in after) > 1


def test_a_far_gaussian_does_not_move_the_planes_of_cells() -> None:
    means = np.random.default_rng(0).normal(0, 20, (500, 3))

    def sets(points: np.ndarray) -> set[frozenset[int]]:
        tree = divide(points, np.arange(len(points)), lambda rows: len(rows) <= 40)
        return {frozenset(leaf.rows.tolist()) for leaf in tree.leaves()}

    alone = sets(means)
    assert sets(np.vstack([means, [3e5, 3e5, -3e5]])) - {frozenset([500])} == alone


def test_where_polygons_overlap_the_last_one_has_the_place() -> None:
    splats = at(made_up(1), (5, 0, 2))
    place = int(regions_of_splats(splats, [square(0.0), square(0.0)])[0])
    assert place == 1
    assert regions_of_splats(at(splats, (0, 0, 500)), [square(0.0)]).tolist() == [FAR]


@pytest.mark.parametrize("count", [1, 2, 50])
def test_models_in_one_place_and_of_a_few_gaussians(count: int) -> None:
    same = made_up(1).select(np.zeros(count, int))
    found = chunks(same, [whole_region(same.means)], LodLimits(num_levels=8, chunk_count=4, leaf_count=1))
    assert sum(len(chunk.levels[0]) for chunk in found) == count
    assert all(len(level) for chunk in found for level in chunk.levels)


def test_where_all_is_far_all_is_near_and_huge_coordinates_are_divided() -> None:
    splats = at(made_up(64), (1e7, -1e7, 0))
    layout = lay_out(splats, [square(0.0)], SMALL)
    assert not len(layout.far)
    assert sum(len(chunk.levels[0]) for chunk in chunks_of(splats, layout)) == 64


def test_levels_follow_the_count() -> None:
    assert [LodLimits().levels_of(count) for count in (0, 30_000, 30_001, 1_000_000, 10**9)] == [1, 1, 2, 7, 8]


def test_bad_limits_give_one_sentence() -> None:
    with pytest.raises(BadInput, match="1 to 8"):
        LodLimits(num_levels=9)
    with pytest.raises(BadInput, match="limited"):
        LodLimits(leaf_side_m=0)
    with pytest.raises(BadInput, match="no Gaussians"):
        whole_region(np.zeros((0, 3)))
    with pytest.raises(BadInput, match="no regions"):
        regions_of_splats(made_up(1), [])
