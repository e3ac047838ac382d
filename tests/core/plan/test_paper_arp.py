"""Alg. 1 as a baseline: it ends, keeps the best partition it saw, and moves borders by its step."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.regions.paper_arp import PaperRegions, estimated_times_s, paper_regions
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import assign

from .instances import linear_system

SITES = np.array([[100.0, 100.0], [400.0, 100.0], [250.0, 220.0]])


def run(seconds_per_camera: list[float], config: PaperConfig, num_edges: int = 3) -> tuple[PaperRegions, np.ndarray]:
    positions = np.random.default_rng(0).random((300, 2)) * [500.0, 250.0]
    tables = edge_tables(linear_system(SITES[:num_edges], np.array(seconds_per_camera)), 300)
    regions = paper_regions(positions, SITES[:num_edges], tables, 5.0, config)
    times_s = estimated_times_s(tables, np.bincount(regions.edge_of_camera, minlength=num_edges))
    np.testing.assert_array_equal(regions.edge_of_camera, assign(positions, SITES[:num_edges], regions.weights))
    return regions, times_s


def test_the_best_partition_seen_is_kept() -> None:
    regions, times_s = run([1.0, 2.0, 3.0], PaperConfig(threshold=1e-6))
    assert times_s.max() == min(regions.history)
    assert min(regions.history) < regions.history[0]


def test_it_starts_from_the_voronoi_diagram() -> None:
    regions, _ = run([1.0, 2.0, 3.0], PaperConfig(max_iterations=1, threshold=1e-6))
    positions = np.random.default_rng(0).random((300, 2)) * [500.0, 250.0]
    counts = np.bincount(assign(positions, SITES, np.zeros(3)))
    assert regions.history[0] == (counts * [1.0, 2.0, 3.0]).max()


def test_a_wide_threshold_converges_at_once_and_moves_nothing() -> None:
    regions, _ = run([1.0, 1.0, 1.0], PaperConfig(threshold=100.0))
    assert regions.converged
    assert len(regions.history) == 1
    assert not regions.weights.any()


def test_a_fixed_step_that_cycles_is_noticed_and_stops() -> None:
    # No whole number of cameras makes three unequal times equal to one part in a million, so it
    # must cycle.
    regions, _ = run([1.0, 1.37, 2.11], PaperConfig(threshold=1e-6, max_iterations=100_000))
    assert not regions.converged
    assert len(regions.history) < 1000


def test_the_iteration_limit_holds() -> None:
    regions, _ = run([1.0, 2.0, 3.0], PaperConfig(threshold=1e-6, max_iterations=7))
    assert len(regions.history) <= 8  # the start and seven moves


def test_one_step_moves_the_border_to_the_nearest_edge_by_d() -> None:
    regions, _ = run([1.0, 3.0], PaperConfig(threshold=1e-6, max_iterations=1), num_edges=2)
    moved_m = np.abs(regions.weights[0] - regions.weights[1]) / (2 * 300.0)
    assert moved_m == pytest.approx(5.0, abs=1e-9)


def test_a_single_edge_has_all_cameras() -> None:
    regions, times_s = run([2.0], PaperConfig(), num_edges=1)
    assert regions.converged
    assert times_s.tolist() == [600.0]


@pytest.mark.parametrize("knob", ["threshold", "boundary_step", "max_iterations"])
@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
def test_knobs_must_be_positive_numbers(knob: str, value: float) -> None:
    with pytest.raises(BadInput, match=knob):
        PaperConfig(**{knob: value})  # pyright: ignore[reportArgumentType]
