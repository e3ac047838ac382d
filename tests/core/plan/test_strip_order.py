"""The order of devices along the strips: against all permutations; cuts against shapely."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
import shapely

from radiant_core.numerics import FloatArray
from radiant_core.plan.devices import strip_order
from radiant_core.plan.devices.device_split import long_axis, split_edge
from radiant_core.plan.devices.strip_order import MAX_EXCHANGED, chords_across, shortest_order
from radiant_core.plan.regions.power_diagram import polygon_area_m2
from tests.seeds import for_seeds

from .instances import random_edge


def seams_m(order: np.ndarray, quotas: np.ndarray, chords_m: FloatArray) -> float:
    """Length of all seams between devices in this order."""
    return float(chords_m[np.cumsum(quotas[order])[:-1]].sum())


def names(count: int) -> list[str]:
    return [f"d{index:03d}" for index in range(count)]


def convex_border(rng: np.random.Generator, size_m: float = 300.0, shift_m: float = 0.0) -> FloatArray:
    hull = shapely.MultiPoint(rng.random((12, 2)) * [size_m, size_m / 2] + shift_m).convex_hull
    return shapely.get_coordinates(shapely.orient_polygons(hull))[:-1]


def shortest_of_all(quotas: np.ndarray, chords_m: FloatArray) -> float:
    return min(seams_m(np.array(order), quotas, chords_m) for order in permutations(np.flatnonzero(quotas)))


@for_seeds(40)
def test_no_permutation_has_shorter_seams(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_devices = int(rng.integers(1, 8))
    quotas = rng.integers(0, 9 if seed % 2 else 4, num_devices)  # small ones come twice
    chords_m = rng.random(int(quotas.sum()) + 1) * 100.0
    order = shortest_order(quotas, names(num_devices), chords_m)
    np.testing.assert_array_equal(np.sort(order), np.flatnonzero(quotas))
    if quotas.any():
        # Lengths are compared to a billionth of the longest.
        assert seams_m(order, quotas, chords_m) == pytest.approx(shortest_of_all(quotas, chords_m), abs=1e-6)


def test_twelve_devices_with_quotas_of_their_own_are_ordered_exactly() -> None:
    """One cut is far shorter: of twelve quotas, the order that cuts there after six is best."""
    quotas = 2 ** np.arange(12)
    chords_m = np.full(int(quotas.sum()) + 1, 100.0)
    inside = [0, 3, 4, 7, 8, 11]
    chords_m[quotas[inside].sum()] = 1.0
    order = shortest_order(quotas, names(12), chords_m)
    assert seams_m(order, quotas, chords_m) == pytest.approx(10 * 100.0 + 1.0)
    assert sorted(order[:6].tolist()) == inside


def test_ties_go_to_the_order_of_the_names() -> None:
    assert shortest_order(np.array([5, 3, 4]), ["c", "a", "b"], np.full(13, 10.0)).tolist() == [1, 2, 0]
    assert shortest_order(np.array([4, 4, 0, 4]), ["c", "a", "x", "b"], np.full(13, 10.0)).tolist() == [1, 3, 0]
    # Land without width.
    assert shortest_order(np.array([4, 5]), ["b", "a"], np.zeros(10)).tolist() == [1, 0]


@pytest.mark.parametrize("num_devices", [13, 30, MAX_EXCHANGED + 5])
def test_more_devices_than_can_be_searched_are_never_worse_than_by_name(num_devices: int) -> None:
    rng = np.random.default_rng(num_devices)
    quotas = rng.choice(np.arange(5, 5000), num_devices, replace=False)
    at = np.linspace(0, 1, int(quotas.sum()) + 1)
    chords_m = 100.0 * np.sqrt(at * (1 - at))  # land that is widest in the middle
    order = shortest_order(quotas, names(num_devices), chords_m)
    assert sorted(order.tolist()) == list(range(num_devices))
    assert seams_m(order, quotas, chords_m) < seams_m(np.arange(num_devices), quotas, chords_m)
    np.testing.assert_array_equal(order, shortest_order(quotas, names(num_devices), chords_m))


@pytest.mark.parametrize(("seed", "shift_m"), [(0, 0.0), (1, 0.0), (2, 0.0), (3, 1e6)])
def test_a_cut_is_as_long_as_shapely_says(seed: int, shift_m: float) -> None:
    rng = np.random.default_rng(seed)
    border, angle = convex_border(rng, shift_m=shift_m), rng.uniform(0, np.pi)
    axis, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    heights = border @ axis
    at = np.linspace(heights.min() - 1, heights.max() + 1, 50)
    centre = border.mean(axis=0)
    for height, length_m in zip(at, chords_across(border, axis, at), strict=True):
        foot = centre + (height - centre @ axis) * axis
        line = shapely.LineString([foot - 1e4 * across, foot + 1e4 * across])
        # In metres; steps of 1e-10 at 1e6.
        assert length_m == pytest.approx(shapely.Polygon(border).intersection(line).length, abs=1e-6)


def test_land_without_area_has_no_seams() -> None:
    assert chords_across(np.zeros((0, 2)), np.array([1.0, 0.0]), np.array([0.0, 1.0])).tolist() == [0.0, 0.0]
    assert chords_across(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array([1.0, 0.0]), np.array([0.5])).tolist() == [0.0]


@for_seeds(15)
def test_strips_of_a_plan_have_the_shortest_seams_of_all_orders(seed: int) -> None:
    rng = np.random.default_rng(seed)
    border = convex_border(rng)
    inside = border.mean(axis=0) + (rng.random((60, 2)) - 0.5) * 60.0
    plan = split_edge(random_edge(rng, "e", 4), inside, np.arange(60), border)
    assert sum(polygon_area_m2(strip) for strip in plan.strips) == pytest.approx(polygon_area_m2(border))
    quotas = np.bincount(plan.device_of_camera, minlength=4)
    along = (inside - inside.mean(axis=0)) @ long_axis(inside)
    order = np.array(sorted(np.flatnonzero(quotas), key=lambda device: along[plan.device_of_camera == device].max()))
    sorted_along = np.sort(along)
    cuts = np.concatenate([sorted_along[:1], (sorted_along[:-1] + sorted_along[1:]) / 2, sorted_along[-1:]])
    chords_m = chords_across(border - inside.mean(axis=0), long_axis(inside), cuts)
    assert seams_m(order, quotas, chords_m) == pytest.approx(shortest_of_all(quotas, chords_m), abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_exchanging_any_two_of_many_devices_shortens_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    quotas = rng.choice(np.arange(5, 500), 16, replace=False)
    chords_m = rng.random(int(quotas.sum()) + 1) * 100.0
    order = shortest_order(quotas, names(16), chords_m)
    found_m = seams_m(order, quotas, chords_m)
    for first, second in combinations(range(16), 2):
        changed = order.copy()
        changed[[first, second]] = changed[[second, first]]
        # Lengths are compared to a billionth.
        assert seams_m(changed, quotas, chords_m) >= found_m - 1e-5, (first, second)


def test_a_cut_along_a_side_is_as_long_as_the_side() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [0.0, 3.0]])
    assert chords_across(square, np.array([1.0, 0.0]), np.array([-0.1, 0.0, 1.0, 2.0, 2.1])).tolist() == [0, 3, 3, 3, 0]
    assert chords_across(square, np.array([0.0, 1.0]), np.array([0.0, 3.0])).tolist() == [2, 2]


@pytest.mark.parametrize("scale", [1e-6, 0.5, 1e7])
def test_the_unit_of_length_changes_no_order(scale: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        quotas = rng.integers(0, 9, 6)
        chords = rng.random(int(quotas.sum()) + 1) * 100
        np.testing.assert_array_equal(shortest_order(quotas, names(6), chords * scale), shortest_order(quotas, names(6), chords))


def test_seams_of_an_order_are_the_cuts_behind_all_but_the_last() -> None:
    chords = np.array([9.0, 1, 2, 3, 4, 5, 8])
    assert seams_m(np.array([1, 0, 2]), np.array([1, 2, 3]), chords) == 2 + 3
    assert seams_m(np.array([0]), np.array([6]), chords) == 0
    assert shortest_order(np.array([0, 6]), names(2), chords).tolist() == [1]
    assert shortest_order(np.array([3, 3]), ["b", "a"], np.zeros(7)).tolist() == [1, 0]
    assert shortest_order(np.array([0, 0]), names(2), np.array([0.0])).tolist() == []


def test_classes_of_equal_quotas_are_searched_up_to_4096_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eleven equal devices and one of another quota are 24 states; whoever comes first by name
    takes the first of equal places."""
    rng = np.random.default_rng(0)
    quotas = np.array([2] * 11 + [5])
    chords = rng.random(28) * 10
    order = shortest_order(quotas, names(12), chords)
    equal = [device for device in order.tolist() if device < 11]
    assert equal == sorted(equal)
    best = min(seams_m(np.array([*range(at), 11, *range(at, 11)]), quotas, chords) for at in range(12))
    assert seams_m(order, quotas, chords) == pytest.approx(best)
    monkeypatch.setattr(strip_order, "MAX_STATES", 24)
    np.testing.assert_array_equal(shortest_order(quotas, names(12), chords), order)
    monkeypatch.setattr(strip_order, "_exact", None)
    with pytest.raises(TypeError, match="not callable"):
        shortest_order(quotas, names(12), chords)
    monkeypatch.setattr(strip_order, "MAX_STATES", 23)
    assert seams_m(shortest_order(quotas, names(12), chords), quotas, chords) >= best - 1e-9


def test_too_many_devices_for_exchanges_keep_the_best_of_three_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strip_order, "MAX_STATES", 1)
    rng = np.random.default_rng(1)
    for _ in range(10):
        quotas = rng.integers(1, 9, 7)
        chords = rng.random(int(quotas.sum()) + 1) * 10
        starts = [np.arange(7), np.argsort(quotas, kind="stable"), np.argsort(-quotas, kind="stable")]
        best = min(seams_m(start, quotas, chords) for start in starts)
        for most, exchanged in ((6, False), (7, True)):
            monkeypatch.setattr(strip_order, "MAX_EXCHANGED", most)
            found = seams_m(shortest_order(quotas, names(7), chords), quotas, chords)
            assert found <= best + 1e-8 if exchanged else found == pytest.approx(best)
