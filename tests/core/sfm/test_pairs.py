"""Which pairs are matched: each once, neighbours first, nobody left out."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.sfm.colmap.pairs import choose_pairs, gps_positions, neighbor_pairs, pairs_with
from radiant_core.sfm.config import SfmConfig


def photos(count: int, with_gps: int) -> tuple[Photograph, ...]:
    key = CameraKey(make="", model="", focal_mm=None, size_wh=(4, 3))
    rng = np.random.default_rng(0)
    places = [(46 + 0.001 * rng.random(), 7 + 0.001 * rng.random(), 500.0) for _ in range(count)]
    return tuple(
        Photograph(name=f"{i}.jpg", path=Path(f"{i}.jpg"), size_wh=(4, 3), lat_lon_alt=places[i] if i < with_gps else None, camera=key)
        for i in range(count)
    )


@pytest.mark.parametrize("num_neighbors", [1, 5, 100])
def test_each_has_its_nearest_and_each_pair_comes_once(num_neighbors: int) -> None:
    rng = np.random.default_rng(1)
    positions_m = rng.uniform(0, 100, (40, 3))
    names = [f"{i}" for i in range(40)]
    pairs = neighbor_pairs(names, positions_m, num_neighbors)
    found = {frozenset(pair) for pair in pairs}
    assert len(found) == len(pairs)
    assert all(len(pair) == 2 for pair in found)
    distances = np.linalg.norm(positions_m[:, None, :2] - positions_m[None, :, :2], axis=2)
    for i in range(40):
        for j in np.argsort(distances[i])[1 : num_neighbors + 1]:
            assert frozenset((names[i], names[j])) in found


def test_height_does_not_choose_neighbours() -> None:
    rng = np.random.default_rng(2)
    positions_m = rng.uniform(0, 100, (20, 3))
    names = [f"{i}" for i in range(20)]
    assert neighbor_pairs(names, positions_m, 4) == neighbor_pairs(names, positions_m * (1, 1, 1000), 4)


def test_a_photograph_without_position_is_matched_with_everybody() -> None:
    positions_m = np.random.default_rng(3).uniform(0, 100, (10, 3))
    positions_m[4] = np.nan
    pairs = neighbor_pairs([f"{i}" for i in range(10)], positions_m, 1)
    assert {frozenset(("4", f"{i}")) for i in range(10) if i != 4} <= {frozenset(pair) for pair in pairs}


def test_many_photographs_at_one_place_still_get_partners() -> None:
    pairs = neighbor_pairs([f"{i}" for i in range(6)], np.zeros((6, 3)), 2)
    assert {name for pair in pairs for name in pair} == {f"{i}" for i in range(6)}
    assert all(first != second for first, second in pairs)


@pytest.mark.parametrize(("with_gps", "choice"), [(20, "spatial"), (18, "spatial"), (17, "exhaustive"), (0, "exhaustive")])
def test_neighbours_are_used_where_nine_in_ten_have_gps(with_gps: int, choice: str) -> None:
    pairs, decision = choose_pairs(photos(20, with_gps), SfmConfig(num_neighbors=3))
    assert decision.choice.startswith(choice)
    assert decision.figure == pytest.approx(100 * with_gps / 20)
    assert not decision.forced
    if choice == "exhaustive":
        assert pairs == list(combinations([f"{i}.jpg" for i in range(20)], 2))
    else:
        assert len(pairs) < 20 * 19 / 2


def test_a_choice_that_was_asked_for_is_marked_and_an_impossible_one_refused() -> None:
    assert choose_pairs(photos(5, 5), SfmConfig(matching="exhaustive"))[1].forced
    with pytest.raises(BadInput, match="no photograph has a GPS position"):
        choose_pairs(photos(5, 0), SfmConfig(matching="spatial"))


def test_what_is_left_is_paired_with_all_that_it_has_not_met() -> None:
    names = ["a", "b", "c", "d"]
    done = [("a", "b"), ("c", "d")]
    assert set(pairs_with(names, ("d",), done)) == {("a", "d"), ("b", "d")}
    assert pairs_with(names, (), done) == []


def test_positions_are_metres_about_the_median_and_unknown_without_gps() -> None:
    positions_m, origin = gps_positions(photos(9, 7))
    assert np.isnan(positions_m[7:]).all()
    # 0.001° is under 112 m; the median position is the origin.
    assert np.abs(positions_m[:7]).max() < 112
    assert np.allclose(np.median(positions_m[:7], axis=0)[:2], 0, atol=0.01)
    assert origin[2] == 500
