"""Counts from entries near the deadline alone against whole tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.counts import wide_deadline
from radiant_core.plan.counts.deadline import device_time_s, edge_table, edge_tables, fastest_counts
from radiant_core.plan.counts.wide_deadline import (
    _Fleet,
    _interpolate,
    _num_alone,
    cached_edge_counts,
    fastest_edge_counts,
    system_capacity,
    times_of_counts,
)
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import System
from tests.seeds import for_seeds

from .instances import linear_system, random_curve, random_device, random_edge, random_system


@pytest.fixture(autouse=True)
def _never_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wide_deadline, "SMALL_TABLE_ENTRIES", 0)


@for_seeds(120)
def test_the_makespan_is_that_of_whole_tables(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras = int(np.exp(rng.uniform(0, np.log(3000))))
    limits = (num_cameras // 3 + 1, 2 * num_cameras) if seed % 3 == 0 else None
    system = random_system(rng, int(rng.integers(3, 12)), limits)
    if seed % 2:
        edges = [replace(edge, aggregate_alone_s=random_curve(rng, 0.1) if rng.random() < 0.7 else None) for edge in system.edges]
        system = System(edges=tuple(edges))
    tables = edge_tables(system, num_cameras)
    if sum(table.capacity for table in tables) < num_cameras:
        return  # Memory cannot hold this instance, which the caller checks first.
    _, bound_s = fastest_counts(tables, num_cameras)
    found = fastest_edge_counts(system, num_cameras)
    assert found.counts.sum() == num_cameras
    # Bytes are added up from another start.
    assert found.edge_time_s.max() == pytest.approx(bound_s, rel=1e-12)
    np.testing.assert_allclose(times_of_counts(system, found.counts), found.edge_time_s, rtol=1e-12)


def test_flat_curves_share_a_million_cameras_evenly() -> None:
    edge = random_edge(np.random.default_rng(0), "e", 1)
    flat = CostCurve(constant=3.0)
    free = CostCurve()
    device = random_device(np.random.default_rng(0), "d", None)
    edges = [
        replace(edge, id=f"e{i}", aggregate_s=free, devices=(replace(device, id=f"d{i}", init_s=free, train_s=flat, model_bytes=free),))
        for i in range(100)
    ]
    found = fastest_edge_counts(System(edges=tuple(edges)), 1_000_000)
    assert found.counts.sum() == 1_000_000
    assert np.ptp(found.counts) <= 1
    assert (found.edge_time_s == 3.0).all()


def test_a_million_cameras_follow_the_speeds() -> None:
    seconds = np.random.default_rng(1).uniform(0.5, 2, 256)
    found = fastest_edge_counts(linear_system(np.random.default_rng(2).random((256, 2)), seconds), 1_000_000)
    assert found.counts.sum() == 1_000_000
    # No edge could take one more camera within the makespan that another would have to give up.
    assert ((found.counts + 1) * seconds >= found.edge_time_s.max()).all()


def test_capacity_counts_each_device_up_to_the_scene() -> None:
    assert system_capacity(linear_system(np.eye(2), np.ones(2), 30), 1000) == 60
    assert system_capacity(linear_system(np.eye(2), np.ones(2), 30), 20) == 40


def test_curves_that_overflow_are_refused() -> None:
    system = linear_system(np.eye(2), np.array([1e308, 1.0]))
    with pytest.raises(BadInput, match="not finite"):
        fastest_edge_counts(system, 1000)


def test_the_guess_is_so_near_that_the_first_window_proves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any guess leads to the optimum, a bad one over windows three times as wide each."""
    windows: list[int] = []
    solved = wide_deadline._Fleet.solve

    def counted(fleet: Any, low: np.ndarray, high: np.ndarray) -> Any:
        windows[-1] += 1
        return solved(fleet, low, high)

    monkeypatch.setattr(wide_deadline._Fleet, "solve", counted)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        system = random_system(rng, int(rng.integers(3, 12)))
        windows.append(0)
        fastest_edge_counts(system, int(np.exp(rng.uniform(np.log(500), np.log(20_000)))))
    assert windows.count(1) >= 35, windows  # where curves are flat a deadline says little


def test_devices_that_time_does_not_tell_apart_are_refused_before_memory_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    system = linear_system(np.random.default_rng(0).random((4, 2)), np.array([1.0, 1.5, 2.0, 3.0]))
    # Each window is 2 % of the quota and 4 cameras wide, rounded up.
    for entries, passes in ((70, True), (40, False)):
        monkeypatch.setattr(wide_deadline, "MAX_TABLE_ENTRIES", entries)
        if passes:
            assert fastest_edge_counts(system, 2000).counts.sum() == 2000
        else:
            with pytest.raises(BadInput, match="2000 cameras on 4 devices cannot be told apart by time: use fewer"):
                fastest_edge_counts(system, 2000)


def some_fleet(seed: int, num_cameras: int = 400) -> tuple[System, _Fleet]:
    rng = np.random.default_rng(seed)
    system = random_system(rng, int(rng.integers(2, 6)), (40, num_cameras) if seed % 2 else None)
    if seed % 3:
        system = System(edges=tuple(replace(edge, aggregate_alone_s=random_curve(rng, 0.1)) for edge in system.edges))
    return system, _Fleet(system, num_cameras)


@for_seeds(12)
def test_all_devices_at_once_cost_what_each_costs_by_itself(seed: int) -> None:
    system, fleet = some_fleet(seed)
    counts = np.array([0, 1, 2, 7, 40])
    table = np.tile(counts, (len(system.devices), 1))
    expected = np.array([device_time_s(device, counts) for device in system.devices])
    np.testing.assert_allclose(fleet.time_s(table), expected, rtol=1e-14)
    np.testing.assert_allclose(fleet.time_s(table[:, 3]), expected[:, 3], rtol=1e-14)
    np.testing.assert_allclose(fleet.time_s(counts, np.zeros(5, np.int64)), expected[0], rtol=1e-14)
    for index, edge in enumerate(system.edges):
        alone = _num_alone(edge, 400)
        joined = [edge.aggregation_s(count, 1 if count <= alone else 2) for count in counts.tolist()]
        np.testing.assert_allclose(fleet.aggregate(np.tile(counts, (len(system.edges), 1)))[index], joined, rtol=1e-14)
        np.testing.assert_allclose(fleet.aggregate(counts, np.full(5, index)), joined, rtol=1e-14)


@for_seeds(40)
def test_alone_is_the_fastest_device_until_the_next_could_do_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edge = random_edge(rng, "e", int(rng.integers(1, 4)), (0, 60) if seed % 2 else None)
    slots = edge_table(edge, 50).device_of_slot
    others = np.flatnonzero(slots != slots[0]) if len(slots) else slots
    # A tie at the very next camera goes to whoever has none yet, in the table as here.
    assert _num_alone(edge, 50) == (int(others[0]) if len(others) else len(slots))


def test_interpolated_is_numpys_row_by_row_and_0_before_the_first() -> None:
    rng = np.random.default_rng(0)
    rising = np.cumsum(rng.random((30, 8)) * (rng.random((30, 8)) < 0.7), axis=1)
    values = np.cumsum(rng.random((30, 8)), axis=1)
    for at in (rng.random(30) * 5, rising[:, 0], rising[:, 3] + 1e-9, rising[:, -1], np.full(30, 99.0)):
        # At a step of several nodes numpy may take any of them: only where they rise is there one
        # answer.
        steep = (np.diff(rising, axis=1) > 0).all(axis=1)
        expected = np.array([np.interp(t, xs, ys, left=0.0) for t, xs, ys in zip(at, rising, values, strict=True)])
        np.testing.assert_allclose(_interpolate(rising, values, at)[steep], expected[steep], rtol=1e-12)
    flat = np.array([[1.0, 2.0, 2.0, 3.0]])
    for at, value in ((0.5, 0.0), (1.0, 10.0), (1.5, 15.0), (2.0, 30.0), (2.5, 35.0), (3.0, 40.0), (9.0, 40.0)):
        assert _interpolate(flat, np.array([[10.0, 20.0, 30.0, 40.0]]), np.array([at])) == pytest.approx([value])
    assert _interpolate(np.array([[np.inf, np.inf]]), np.array([[1.0, 2.0]]), np.array([3.0])).tolist() == [0.0]


@for_seeds(30)
def test_quotas_of_the_guess_are_near_the_best_and_sum_to_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = linear_system(rng.random((6, 2)), rng.uniform(0.5, 5, 6), 900 if seed % 2 else None)
    fleet = _Fleet(system, 2000)
    guess = fleet.guess_quotas()
    best, _ = fastest_counts(edge_tables(system, 2000), 2000)
    assert guess.sum() == pytest.approx(2000, rel=1e-6)
    assert (np.abs(guess - best) <= 2 + 0.01 * best).all()
    crowded = np.minimum(fleet._of_all_cameras(np.full(6, 1.0)), fleet.limits)
    assert crowded.sum() == pytest.approx(2000, rel=1e-9) and np.ptp(crowded) < 1e-6
    assert not fleet._of_all_cameras(np.zeros(6)).any()


@for_seeds(60)
def test_any_window_gives_the_optimum_or_nothing(seed: int) -> None:
    """Windows about the best quotas, narrow, shifted or complete: what is proved is the optimum."""
    system, fleet = some_fleet(seed % 12, 150)
    tables = edge_tables(system, 150)
    if sum(table.capacity for table in tables) < 150:
        return  # Memory cannot hold this instance, which the caller checks first.
    counts, bound_s = fastest_counts(tables, 150)
    quotas = np.concatenate([table.quotas(int(count)) for table, count in zip(tables, counts, strict=True)])
    rng = np.random.default_rng(seed)
    low = np.clip(quotas - rng.integers(-2, 12, len(quotas)), 0, fleet.limits)
    high = np.clip(np.maximum(low, quotas + rng.integers(-2, 12, len(quotas))), 0, fleet.limits)
    found = fleet.solve(low, high)
    if found is not None:
        assert found.counts.sum() == 150 and found.edge_time_s.max() == pytest.approx(bound_s, rel=1e-12)
        np.testing.assert_allclose(found.edge_time_s, times_of_counts(system, found.counts), rtol=1e-12)
    whole = fleet.solve(np.zeros_like(low), fleet.limits)
    assert whole is not None
    np.testing.assert_array_equal(whole.counts, counts)
    if (low > quotas).any() or (high < quotas).any():
        return
    wide = fleet.solve(np.maximum(quotas - 25, 0), np.minimum(quotas + 25, fleet.limits))
    assert wide is None or wide.edge_time_s.max() == pytest.approx(bound_s, rel=1e-12)


def test_a_window_that_holds_the_optimum_with_a_camera_to_spare_proves_it() -> None:
    system = linear_system(np.eye(3, 2), np.array([1.0, 2.0, 4.0]))
    fleet = _Fleet(system, 70)  # 40, 20 and 10 cameras in 40 s
    best = np.array([40, 20, 10])
    for margin in (1, 2, 5):
        found = fleet.solve(best - margin, best + margin)
        assert found is not None and found.counts.tolist() == [40, 20, 10] and found.edge_time_s.tolist() == [40, 40, 40]
    assert fleet.solve(best, best) is None, "when the next camera would be done is not known"
    for low, high in ((-5, -1), (1, 5), ([-5, -5, -5], [5, 0, 5])):
        assert fleet.solve(best + low, best + high) is None


def test_more_than_the_best_taken_unseen_is_no_proof_though_all_cameras_are_dealt() -> None:
    """From 45, 20 and 5 on nothing is left to choose; 40, 20 and 10 are done 5 s earlier."""
    fleet = _Fleet(linear_system(np.eye(3, 2), np.array([1.0, 2.0, 4.0])), 70)
    assert fleet.solve(np.array([45, 20, 5]), np.array([50, 25, 9])) is None


def test_a_device_without_room_gets_nothing() -> None:
    system = linear_system(np.random.default_rng(0).random((3, 2)), np.array([1.0, 1.0, 2.0]))
    first, *rest = system.edges
    full = replace(first, devices=(replace(first.devices[0], max_cameras=0),))
    assert fastest_edge_counts(System(edges=(full, *rest)), 3000).counts.tolist() == [0, 2000, 1000]


def test_counts_remembered_for_a_drag_cannot_be_changed() -> None:
    system = linear_system(np.eye(2), np.ones(2))
    found = cached_edge_counts(system, 10)
    assert cached_edge_counts(system, 10) is found and found.counts.tolist() == [5, 5]
    for array in (found.counts, found.edge_time_s):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 3


def test_small_systems_are_tabulated_whole_up_to_sixty_thousand_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wide_deadline, "SMALL_TABLE_ENTRIES", 60_000)
    monkeypatch.setattr(wide_deadline, "_Fleet", None)
    system = linear_system(np.eye(2), np.ones(2))
    assert fastest_edge_counts(system, 30_000).counts.tolist() == [15_000, 15_000]
    with pytest.raises(TypeError, match="not callable"):
        fastest_edge_counts(system, 30_001)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e6])
def test_the_unit_of_time_changes_no_quota(scale: float) -> None:
    seconds = np.array([1.0, 1.5, 2.5, 4.0])
    plain, scaled = (_Fleet(linear_system(np.eye(4, 2), seconds * factor), 3000).guess_quotas() for factor in (1.0, scale))
    np.testing.assert_allclose(scaled, plain, rtol=1e-6, atol=1e-3)
    flat = CostCurve(constant=3.0 * scale)
    system = linear_system(np.eye(4, 2), seconds)
    same = [replace(edge, devices=(replace(edge.devices[0], train_s=flat),)) for edge in system.edges]
    np.testing.assert_allclose(_Fleet(System(edges=tuple(same)), 3000).guess_quotas(), 750, atol=1)
