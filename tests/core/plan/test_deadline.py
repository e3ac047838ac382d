"""Quotas and counts against exhaustive search, and the laws of the time tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.counts import deadline
from radiant_core.plan.counts.deadline import device_time_s, edge_table, edge_tables, fastest_counts
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Edge, System
from tests.seeds import for_seeds

from .instances import linear_system, random_curve, random_edge, random_system

# Sums of a handful of seconds in another order: a few roundings, far below a microsecond.
SECONDS_TOLERANCE = 1e-9


def compositions(total: int, limits: list[int]) -> list[tuple[int, ...]]:
    return [parts for parts in product(*(range(limit + 1) for limit in limits)) if sum(parts) == total]


def slowest_device_s(edge: Edge, quotas: Sequence[int] | np.ndarray) -> float:
    return max(float(device_time_s(device, quota)) for device, quota in zip(edge.devices, quotas, strict=True))


@for_seeds(150)
def test_quotas_are_as_fast_as_the_best_of_all_quotas(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras = int(rng.integers(1, 9))
    edge = random_edge(rng, "e", int(rng.integers(1, 4)), limits=(0, 6) if seed % 2 else None)
    limits = [num_cameras if device.max_cameras is None else device.max_cameras for device in edge.devices]
    table = edge_table(edge, num_cameras)
    assert table.capacity == min(num_cameras, sum(limits))
    for count in range(1, table.capacity + 1):
        slowest_s = [slowest_device_s(edge, parts) for parts in compositions(count, limits)]
        quotas = table.quotas(count)
        assert quotas.sum() == count
        assert (quotas <= limits).all()
        assert slowest_device_s(edge, quotas) == pytest.approx(min(slowest_s), abs=SECONDS_TOLERANCE)


@for_seeds(50)
def test_edge_time_is_training_plus_aggregation_plus_sending(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edge = random_edge(rng, "e", 3, limits=(2, 30))
    table = edge_table(edge, 40)
    for count in range(table.capacity + 1):
        quotas = table.quotas(count)
        model_bytes = sum(float(d.model_bytes(k)) for d, k in zip(edge.devices, quotas, strict=True))
        expected_s = slowest_device_s(edge, quotas) + float(edge.aggregate_s(count)) + model_bytes / edge.uplink_bytes_per_s
        assert table.edge_time_s[count] == pytest.approx(expected_s, rel=1e-12, abs=SECONDS_TOLERANCE)


@for_seeds(50)
def test_an_edge_whose_cameras_one_device_has_pays_for_no_retraining(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edge = random_edge(rng, "e", int(rng.integers(1, 4)), limits=(0, 30))
    edge = replace(edge, aggregate_s=CostCurve(constant=5, linear=1), aggregate_alone_s=random_curve(rng))
    table = edge_table(edge, 40)
    for count in range(1, table.capacity + 1):
        quotas = table.quotas(count)
        model_bytes = sum(float(d.model_bytes(k)) for d, k in zip(edge.devices, quotas, strict=True))
        joining_s = edge.aggregation_s(count, int((quotas > 0).sum()))
        assert joining_s == 5 + count or ((quotas > 0).sum() == 1 and joining_s < 5 + count)
        expected_s = slowest_device_s(edge, quotas) + joining_s + model_bytes / edge.uplink_bytes_per_s
        assert table.edge_time_s[count] == pytest.approx(expected_s, rel=1e-12, abs=SECONDS_TOLERANCE)


@for_seeds(20)
def test_tables_never_fall_and_quotas_only_grow(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = edge_table(random_edge(rng, "e", 4), 300)
    assert table.edge_time_s[0] == 0
    assert (np.diff(table.edge_time_s) >= 0).all()
    quotas = np.array([table.quotas(count) for count in range(301)])
    assert (np.diff(quotas, axis=0) >= 0).all()


@for_seeds(150)
def test_counts_are_as_fast_as_the_best_of_all_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras = int(rng.integers(1, 10))
    tables = edge_tables(random_system(rng, int(rng.integers(1, 4)), limits=(3, 9)), num_cameras)
    limits = [table.capacity for table in tables]
    if sum(limits) < num_cameras:
        num_cameras = sum(limits)
    counts, bound_s = fastest_counts(tables, num_cameras)
    makespans_s = [
        max(table.edge_time_s[part] for table, part in zip(tables, parts, strict=True)) for parts in compositions(num_cameras, limits)
    ]
    assert counts.sum() == num_cameras
    assert bound_s == min(makespans_s)  # both read the same table
    assert max(table.edge_time_s[count] for table, count in zip(tables, counts, strict=True)) == bound_s


def test_shares_are_proportional_to_speed_for_linear_costs() -> None:
    # 1200 cameras at 1, 2 and 3 s each: 654.5, 327.3 and 218.2 at equal time, so whole numbers
    # within one of those.
    system = linear_system(np.zeros((3, 2)), np.array([1.0, 2.0, 3.0]))
    counts, bound_s = fastest_counts(edge_tables(system, 1200), 1200)
    np.testing.assert_allclose(counts, [7200 / 11, 3600 / 11, 2400 / 11], atol=1)
    assert 7200 / 11 <= bound_s <= 7200 / 11 + 3


def test_devices_whose_time_does_not_depend_on_cameras_share_them_evenly() -> None:
    edge = random_edge(np.random.default_rng(0), "e", 3)
    flat = [
        replace(d, init_s=CostCurve(), train_s=CostCurve(constant=20.0), model_bytes=CostCurve(), max_cameras=None) for d in edge.devices
    ]
    np.testing.assert_array_equal(edge_table(replace(edge, devices=tuple(flat)), 30).quotas(30), [10, 10, 10])


@for_seeds(20)
def test_the_order_of_edges_does_not_change_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, 5)
    mirrored = System(edges=system.edges[::-1])
    _, bound_s = fastest_counts(edge_tables(system, 60), 60)
    _, mirrored_s = fastest_counts(edge_tables(mirrored, 60), 60)
    assert bound_s == mirrored_s


def test_a_full_memory_takes_the_device_out_and_none_exceeds_it() -> None:
    edge = random_edge(np.random.default_rng(3), "e", 4, limits=(5, 5))
    table = edge_table(edge, 100)
    assert table.capacity == 20
    np.testing.assert_array_equal(table.quotas(20), [5, 5, 5, 5])
    with pytest.raises(BadInput, match="given 21 cameras, its devices can hold 20"):
        table.quotas(21)


def test_no_cameras_take_no_time() -> None:
    tables = edge_tables(random_system(np.random.default_rng(0), 3), 0)
    counts, bound_s = fastest_counts(tables, 0)
    assert counts.tolist() == [0, 0, 0]
    assert bound_s == 0


def test_curves_that_overflow_are_refused() -> None:
    edge = random_edge(np.random.default_rng(0), "huge", 1)
    device = replace(edge.devices[0], train_s=CostCurve(power_coefficient=1e308, exponent=4.0))
    with pytest.raises(BadInput, match=r"edge 'huge' against cameras has .* not finite"):
        edge_table(replace(edge, devices=(device,)), 100)


def test_tables_beyond_memory_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deadline, "MAX_TABLE_ENTRIES", 99)
    with pytest.raises(BadInput, match="at most 99"):
        edge_tables(linear_system(np.zeros((2, 2)), np.ones(2)), 50)


@pytest.mark.parametrize(
    ("terms", "told"),
    [
        ({"exponent": 4.0}, None),
        ({"exponent": 0.0}, None),
        ({"exponent": 4.01}, "exponent is 4.01, expected at most 4"),
        ({"exponent": -0.01}, "exponent is -0.01"),
        ({"constant": -1.0}, "constant is -1.0"),
        ({"linear": float("inf")}, "linear is inf"),
        ({"power_coefficient": float("nan")}, "power_coefficient is nan"),
    ],
)
def test_terms_of_a_curve_are_costs(terms: dict[str, float], told: str | None) -> None:
    if told is None:
        assert float(CostCurve(power_coefficient=3.0, **terms)(1)) == 3.0
    else:
        with pytest.raises(BadInput, match=told):
            CostCurve(**terms)
