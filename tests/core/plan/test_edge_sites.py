"""Sites of edges among the cameras: the same for a seed, inside their box, given ones untouched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.regions.edge_sites import distant_edges, place_edges, separate_sites
from radiant_core.plan.system import System
from tests.seeds import for_seeds

from .instances import LAYOUTS, linear_system

ORIGIN = (47.37, 8.54, 400.0)


def unplaced(num_edges: int) -> System:
    system = linear_system(np.zeros((num_edges, 2)), np.ones(num_edges))
    return System(edges=tuple(replace(edge, position=None) for edge in system.edges))


def test_an_edge_far_from_the_photographs_is_named_with_its_distance_and_key() -> None:
    places = {"here": (47.37, 8.54), "near": (48.26, 8.54), "far": (48.28, 8.54), "antipodes": (-47.37, -171.46)}
    system = unplaced(4)
    edges = [replace(edge, id=name, lat_lon_deg=place) for edge, (name, place) in zip(system.edges, places.items(), strict=True)]
    placed = place_edges(System(edges=tuple(edges[:3])), np.zeros((3, 2)), ORIGIN, seed=0)
    # 0.91 degrees of latitude are 101 km, 0.89 are 99 km.
    (told,) = distant_edges(placed, ORIGIN)
    assert told.startswith("Edge 'far' stands 101 km from the photographs: change lat_lon_deg")
    # Half of the globe's circumference, which a plane on the ground would show as none.
    assert "stands 20,015 km" in distant_edges(System(edges=tuple(edges[3:])), ORIGIN)[0]
    assert distant_edges(placed, None) == distant_edges(system, ORIGIN) == ()


def sites_of(system: System) -> FloatArray:
    return np.array([edge.position for edge in system.edges], dtype=np.float64)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("num_edges", [1, 2, 7, 60])
def test_seeded_edges_stand_inside_the_cameras_box_and_repeat(layout: str, num_edges: int) -> None:
    positions = LAYOUTS[layout](np.random.default_rng(0), 40)
    sites = sites_of(place_edges(unplaced(num_edges), positions, None, seed=3))
    assert (sites >= positions.min(axis=0)).all()
    assert (sites <= positions.max(axis=0)).all()
    np.testing.assert_array_equal(sites, sites_of(place_edges(unplaced(num_edges), positions, None, seed=3)))


@for_seeds(12)
def test_clusters_far_apart_get_an_edge_each(seed: int) -> None:
    rng = np.random.default_rng(1)
    centres = np.array([[0.0, 0.0], [1000.0, 0.0], [0.0, 1000.0], [1000.0, 1000.0]])
    positions = np.repeat(centres, 25, axis=0) + rng.normal(size=(100, 2))
    sites = sites_of(place_edges(unplaced(4), positions, None, seed=seed))
    nearest_m = np.hypot(*np.moveaxis(centres[:, None] - sites, -1, 0)).min(axis=1)
    assert (nearest_m < 1.0).all()  # the mean of 25 cameras spread by 1 m


def test_given_positions_stay_and_the_others_keep_away_from_them() -> None:
    positions = np.concatenate([np.zeros((50, 2)), np.full((50, 2), 100.0)]) + np.random.default_rng(2).normal(size=(100, 2))
    system = linear_system(np.zeros((2, 2)), np.ones(2))
    system = System(edges=(replace(system.edges[0], position=(1.0, -2.0)), replace(system.edges[1], position=None)))
    given, placed = sites_of(place_edges(system, positions, None, seed=0))
    np.testing.assert_array_equal(given, [1.0, -2.0])
    np.testing.assert_allclose(placed, [100.0, 100.0], atol=1.0)


def test_an_edge_beside_a_given_one_settles_in_the_middle_of_its_own_share() -> None:
    # Cameras on 0…100 m, one edge fixed at 0: the other at x serves x/2…100, whose middle is x at
    # 66.7 m.
    positions = np.stack([np.linspace(0.0, 100.0, 1001), np.zeros(1001)], axis=1)
    edges = unplaced(2).edges
    _, free = sites_of(place_edges(System(edges=(replace(edges[0], position=(0.0, 0.0)), edges[1])), positions, None, seed=0))
    np.testing.assert_allclose(free, [200 / 3, 0.0], atol=0.2)  # cameras stand 0.1 m apart


def test_latitude_and_longitude_become_metres_about_the_origin() -> None:
    system = unplaced(2)
    edges = (replace(system.edges[0], lat_lon_deg=(47.37, 8.54)), replace(system.edges[1], lat_lon_deg=(47.371, 8.54)))
    here, north = sites_of(place_edges(System(edges=edges), np.zeros((1, 2)), ORIGIN, seed=0))
    np.testing.assert_allclose(here, 0.0, atol=1e-6)
    # A thousandth of a degree on the meridian at 47.37° is 111.18 m, 400 m up 0.007 m more.
    np.testing.assert_allclose(north, [0.0, 111.18], atol=0.02)


def test_latitude_and_longitude_without_gps_are_refused() -> None:
    system = unplaced(1)
    with pytest.raises(BadInput, match="scene has no GPS"):
        place_edges(System(edges=(replace(system.edges[0], lat_lon_deg=(47.0, 8.0)),)), np.zeros((1, 2)), None, seed=0)


@pytest.mark.parametrize("positions", [np.empty((0, 2)), np.array([[np.nan, 0.0]])])
def test_poisoned_cameras_are_refused(positions: FloatArray) -> None:
    with pytest.raises(BadInput):
        place_edges(unplaced(2), positions, None, seed=0)


@for_seeds(10)
def test_separated_sites_differ_and_those_apart_do_not_move(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sites = rng.choice([0.0, 50.0, 100.0, 150.0], (30, 2))
    apart = separate_sites(sites, 200.0)
    distances_m = np.hypot(*np.moveaxis(apart[:, None] - apart, -1, 0)) + np.diag(np.full(30, np.inf))
    assert distances_m.min() > 1e-6 * 200.0
    _, first = np.unique(sites, axis=0, return_index=True)
    np.testing.assert_array_equal(apart[first], sites[first])
    assert np.hypot(*(apart - sites).T).max() <= 1e-3 * 200.0 * np.sqrt(60)


@pytest.mark.parametrize("num_given", [0, 2])
def test_seeding_and_ten_rounds_are_those_written_out(num_given: int) -> None:
    """k-means++ with the generator's own draws, then ten times every free site to the mean of its
    cameras; camera by camera."""
    rng = np.random.default_rng(5)
    positions = rng.random((60, 2)) * [300.0, 100.0]
    given = [(10.0, 20.0), (250.0, 80.0)][:num_given]
    edges = unplaced(num_given + 3).edges
    system = System(edges=tuple(replace(edge, position=spot) for edge, spot in zip(edges, [*given, None, None, None], strict=True)))
    draws, sites = np.random.default_rng(9), [np.array(spot) for spot in given]
    for _ in range(3):
        if not sites:
            sites.append(positions[draws.integers(60)])
            continue
        squared = np.array([min(float(np.sum((x - site) ** 2)) for site in sites) for x in positions])
        sites.append(positions[draws.choice(60, p=squared / squared.sum())])
    for _ in range(10):
        nearest = [min(range(len(sites)), key=lambda index: float(np.sum((x - sites[index]) ** 2))) for x in positions]
        own = [positions[np.array(nearest) == index] for index in range(len(sites))]
        sites = [site if index < num_given or not len(own[index]) else own[index].mean(axis=0) for index, site in enumerate(sites)]
    np.testing.assert_allclose(sites_of(place_edges(system, positions, None, seed=9)), sites, rtol=1e-9)


def test_more_edges_than_spots_and_an_altitude_of_the_origin() -> None:
    placed = sites_of(place_edges(unplaced(3), np.array([[5.0, 5.0], [5.0, 5.0]]), None, seed=0))
    np.testing.assert_array_equal(placed, np.full((3, 2), 5.0))
    edge = replace(unplaced(1).edges[0], lat_lon_deg=(47.371, 8.54))
    for altitude in (0.0, 4000.0):
        (site,) = sites_of(place_edges(System(edges=(edge,)), np.zeros((1, 2)), (47.37, 8.54, altitude), seed=0))
        assert site[1] == pytest.approx(111.178 * (1 + altitude / 6.37e6), abs=0.02)
    with pytest.raises(BadInput, match="no camera positions were given to place the edges among: give at least one"):
        place_edges(unplaced(1), np.zeros((0, 2)), None, seed=0)
    told = r"edge 'e0' stands at latitude and longitude \(47\.371, 8\.54\), but the scene has no GPS: give the edge position_m"
    with pytest.raises(BadInput, match=told):
        place_edges(System(edges=(replace(edge, id="e0"),)), np.zeros((1, 2)), None, seed=0)
    with pytest.raises(BadInput, match="origin_lat_lon_alt has shape"):
        place_edges(System(edges=(edge,)), np.zeros((1, 2)), (47.37, 8.54), seed=0)


@pytest.mark.parametrize("far", [1.01e8, 1e154, 1e300])
def test_an_edge_on_another_planet_is_refused_wherever_the_others_stand(far: float) -> None:
    free, given = unplaced(2).edges
    system = System(edges=(replace(given, position=(far, far)), free))
    with pytest.raises(BadInput, match=r"a camera or edge is .* m from the origin, expected at most 1e\+08 m"):
        place_edges(system, np.eye(2), None, seed=0)
