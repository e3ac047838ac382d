"""Greedy choice against its plain twin, safe places and safe ways."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.next_flight.candidates import FlightRules, air_over, candidate_views, usual_take_off
from radiant_core.next_flight.choosing import Coverage, choose_views
from radiant_core.next_flight.sightings import Knowledge, Sights, known_by
from radiant_core.next_flight.way import HEADROOM, length_low_over_unknown, low_over_unknown, safe_way, shortest_order
from tests.core.next_flight.block import FRAME, LENS, block_facets, block_sights, looks

RULES = FlightRules(safe=3.0, take_off=0.0, lowest=2.0, highest=60.0)


def test_lazy_greedy_is_greedy() -> None:
    sights = block_sights()
    flown = looks((0.0, 0.0, 40.0))
    seen = sights.all_of(flown)
    known = known_by(sights, flown, seen)
    candidates = candidate_views(air_over(sights.facets, RULES), FRAME, LENS, 30.0)
    sightings = sights.all_of(candidates.cameras)
    chosen = choose_views(sights.facets, known, seen, sightings, 6)
    coverage, rows, left = Coverage(sights.facets, float(np.median(seen[0].gsd))), list[int](), set(range(len(sightings)))
    coverage.add(seen[0])
    for _ in range(6):
        best = max(left, key=lambda row: (float(coverage.gain_of(sightings[row]).sum()), -row))
        coverage.add(sightings[best])
        rows.append(best)
        left.discard(best)
    assert [view.row for view in chosen] == rows
    # Each gains less than the one before, and shares are of one gain.
    gains = [view.gain for view in chosen]
    assert gains == sorted(gains, reverse=True)
    assert all(view.from_unseen + view.from_weak + view.from_finer == pytest.approx(1.0) for view in chosen)


def test_four_views_after_a_nadir_one_open_all_four_walls() -> None:
    sights = block_sights()
    flown = looks((0.0, 0.0, 40.0))
    seen = sights.all_of(flown)
    known = known_by(sights, flown, seen)
    candidates = candidate_views(air_over(sights.facets, RULES), FRAME, LENS, 30.0)
    sightings = sights.all_of(candidates.cameras)
    chosen = choose_views(sights.facets, known, seen, sightings, 4)
    opened = np.zeros(len(sights.facets), bool)
    for view in chosen:
        opened[sightings[view.row].rows] = True
    walls = sights.facets.is_wall
    assert opened[walls].mean() > 0.95
    assert chosen[0].from_unseen > 0
    assert "no photograph shows" in chosen[0].reason("m")


def test_a_second_look_from_one_side_adds_nothing_and_one_from_another_side_does() -> None:
    sights = block_sights()
    looking = sights.all_of(looks((0.0, 0.0, 40.0), (25.0, 0.0, 30.0)))
    coverage = Coverage(sights.facets, float(np.median(looking[0].gsd)))
    assert (coverage.gain_of(looking[0]) > 0).all()
    # No more than what it sees, from all sides, and nothing a second time.
    assert coverage.gain_of(looking[0]).sum() < sights.facets.areas[looking[0].rows].sum()
    alone = coverage.gain_of(looking[1]).sum()
    coverage.add(looking[0])
    assert coverage.gain_of(looking[0]).max() == 0.0
    assert 0.5 * alone < coverage.gain_of(looking[1]).sum() < alone
    assert (coverage.covered >= 0).all() and (coverage.covered <= 1).all()


def test_a_sample_of_facets_stands_for_all() -> None:
    sights = block_sights()
    whole = sights.facets
    sample = whole.sample(len(whole) // 3)
    assert len(sample) == len(whole) // 3
    assert sample.areas.sum() == pytest.approx(whole.areas.sum())
    assert whole.sample(len(whole)) is whole
    # Each camera sees about as much of the sample as of all.
    for position in ((0.0, 0.0, 40.0), (25.0, 0.0, 30.0)):
        cameras = looks(position)
        seen = whole.areas[sights.all_of(cameras)[0].rows].sum() / whole.areas.sum()
        seen_of_sample = sample.areas[Sights(sample, FRAME).all_of(cameras)[0].rows].sum() / sample.areas.sum()
        assert seen_of_sample == pytest.approx(seen, abs=0.05)


def test_no_view_is_nearer_than_asked() -> None:
    facets = block_facets(0.5)
    air = air_over(facets, RULES)
    candidates = candidate_views(air, FRAME, LENS, 15.0)
    away = np.linalg.norm(candidates.places[:, None] - facets.places[None], axis=2)
    assert away.min() >= RULES.safe
    assert candidates.places[:, 2].min() >= RULES.lowest
    # Half a cell lower than allowed is refused, the bound itself is not.
    above = np.array([[0.25, 0.25, 8.0 + RULES.safe + 0.01], [0.25, 0.25, 8.0 + RULES.safe - 0.01]])
    assert air.is_safe(above).tolist() == [True, False]


def test_a_way_keeps_its_distance_and_goes_around_forbidden_land() -> None:
    facets = block_facets(0.5)
    land = shapely.box(-30.0, 8.0, 5.0, 12.0)
    air = air_over(facets, FlightRules(safe=3.0, take_off=0.0, lowest=2.0, highest=60.0, no_fly=(land,)))
    places = np.array([[-15.0, 0.0, 6.0], [15.0, 0.0, 6.0], [-10.0, 16.0, 20.0]])
    assert air.is_safe(places).all()
    way, owner = safe_way(air, places)
    assert owner[owner >= 0].tolist() == [0, 1, 2]
    assert np.array_equal(way[owner >= 0], places)
    # Over the block, which is between the first two, and around the land before the third.
    assert way[:, 2].max() >= 8.0 + 3.0
    for start, end in pairwise(way):
        points = start + np.linspace(0, 1, 200)[:, None] * (end - start)
        away = np.linalg.norm(points[:, None] - facets.places[None], axis=2)
        assert away.min() >= 3.0
        assert not shapely.intersects(land, shapely.LineString([start[:2], end[:2]]))


def test_land_is_known_where_all_within_the_safe_distance_is() -> None:
    air = air_over(block_facets(0.5), RULES)
    # The ground ends at 20 m; a cell's corners count, so that up to two cells more are doubted.
    places = np.array([[0.0, 0.0, 20.0], [15.5, 3.0, 20.0], [17.2, 3.0, 20.0], [0.0, -17.5, 20.0], [90.0, 0.0, 20.0]])
    assert air.knows(places).tolist() == [True, True, False, False, False]


def test_a_way_over_unknown_land_counts_where_it_is_low() -> None:
    air = air_over(block_facets(0.5), RULES)
    # Above what is 1.5 times as tall as the block, by the safe distance.
    high = HEADROOM * 8.0 + RULES.safe
    assert low_over_unknown(air, np.array([[0.0, 0.0, 1.0], [30.0, 0.0, high - 0.01], [30.0, 0.0, high]])).tolist() == [False, True, False]
    assert length_low_over_unknown(air, np.array([[-10.0, 0.0, 12.0], [10.0, 0.0, 12.0]])) == 0.0
    # The ground ends at 20 m and is doubted from 16 m.
    assert length_low_over_unknown(air, np.array([[0.0, 0.0, 12.0], [40.0, 0.0, 12.0]])) == pytest.approx(24.0, abs=0.8)
    assert length_low_over_unknown(air, np.array([[0.0, 0.0, high], [40.0, 0.0, high]])) == 0.0
    # Climbing a metre each metre it is high enough from 20 m on.
    assert length_low_over_unknown(air, np.array([[0.0, 0.0, high - 20.0], [40.0, 0.0, high + 20.0]])) == pytest.approx(4 * 2**0.5, abs=0.8)


def test_a_leg_beyond_the_highest_is_refused() -> None:
    air = air_over(block_facets(0.5), FlightRules(safe=3.0, take_off=0.0, lowest=2.0, highest=10.0))
    with pytest.raises(BadInput, match="above take-off"):
        safe_way(air, np.array([[-15.0, 0.0, 6.0], [15.0, 0.0, 6.0]]))


def test_rules_that_no_flight_can_keep_are_refused() -> None:
    with pytest.raises(BadInput, match="safe distance"):
        FlightRules(safe=0.0, take_off=0.0)
    with pytest.raises(BadInput, match="raise the upper limit"):
        FlightRules(safe=1.0, take_off=0.0, lowest=50.0, highest=40.0)
    facets = block_facets()
    everywhere = FlightRules(safe=3.0, take_off=0.0, no_fly=(shapely.box(-100, -100, 100, 100),))
    with pytest.raises(BadInput, match="none of"):
        candidate_views(air_over(facets, everywhere), FRAME, LENS, 30.0)
    assert usual_take_off(facets) == 0.0


def test_a_round_trip_is_no_longer_than_a_grid_needs() -> None:
    places = np.array([[x, y, 0.0] for x in range(5) for y in range(4)], np.float64)
    order = shortest_order(np.random.default_rng(1).permutation(places))
    assert sorted(order.tolist()) == list(range(20))
    shuffled = np.random.default_rng(1).permutation(places)[order]
    closed = np.linalg.norm(shuffled - np.roll(shuffled, -1, axis=0), axis=1).sum()
    # 20 is the least; 2-opt ends within a tenth of it here.
    assert closed <= 22.0


def test_nothing_known_is_all_unseen() -> None:
    sights = block_sights()
    known = known_by(sights, looks((0.0, 0.0, 40.0)).select([]), ())
    assert isinstance(known, Knowledge)
    assert known.unseen.all()
    assert not known.weak.any()
