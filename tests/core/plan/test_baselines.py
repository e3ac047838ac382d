"""What the exact planner is compared with: each does what its name says, and none that owns all
cameras beats the bound."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.baselines import compare, halve_by_weight
from radiant_core.plan.counts.deadline import edge_tables, fastest_counts
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System
from tests.seeds import for_seeds

from .instances import LAYOUTS, linear_system, random_system


@for_seeds(10)
def test_only_exact_is_at_the_bound_and_nobody_below(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = linear_system(rng.random((5, 2)) * [500.0, 250.0], rng.uniform(1, 4, 5))
    rows = {row.method: row for row in compare(LAYOUTS["uniform"](rng, 200), system, max_iterations=60)}
    assert set(rows) == {"exact", "paper", "paper-halved", "paper-literal", "even"}, "nobody said what images hold"
    assert rows["exact"].over_bound == 1.0
    for row in rows.values():
        assert row.over_bound >= 1.0 or row.num_orphans > 0
        assert (row.edge_of_camera < 0).sum() == row.num_orphans
        assert row.method == "paper-literal" or row.num_orphans == 0


def test_moving_half_planes_leaves_cameras_in_no_region() -> None:
    # Two edges side by side, the left one slow: it alone shrinks, and nobody grows into what it
    # gives up at first.
    positions = np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=1)
    system = linear_system(np.array([[25.0, 0.0], [75.0, 0.0]]), np.array([5.0, 1.0]))
    rows = {row.method: row for row in compare(positions, system, max_iterations=5)}
    assert rows["paper-literal"].num_orphans > 0
    assert rows["paper"].num_orphans == 0


@pytest.mark.parametrize("num_edges", [1, 2, 3, 7, 16])
def test_halves_have_equal_counts_and_keep_apart(num_edges: int) -> None:
    rng = np.random.default_rng(num_edges)
    positions = rng.random((160 * num_edges, 2)) * [500.0, 250.0]
    cells = halve_by_weight(positions, rng.random((num_edges, 2)) * [500.0, 250.0], np.ones(len(positions)))
    counts = np.bincount(cells, minlength=num_edges)
    assert np.ptp(counts) <= 4  # a camera per level of the tree
    boxes = [(positions[cells == e].min(axis=0), positions[cells == e].max(axis=0)) for e in range(num_edges)]
    for i in range(num_edges):
        for j in range(i):
            assert (boxes[i][0] > boxes[j][1]).any() or (boxes[j][0] > boxes[i][1]).any()


@for_seeds(5)
def test_a_run_can_follow_alg_1_as_it_is_compared(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = LAYOUTS["uniform"](rng, 150)
    system = linear_system(rng.random((4, 2)) * [500.0, 250.0], rng.uniform(1, 4, 4))
    paper = PaperConfig(boundary_step=0.03, threshold=0.2, max_iterations=40)
    rows = {row.method: row for row in compare(positions, system, paper=paper, max_iterations=40)}
    plan = plan_regions(positions, system, method="paper-literal", paper=paper)
    assert isinstance(plan, CloudPlan) and plan.method == "paper-literal"
    owned = rows["paper-literal"].edge_of_camera >= 0
    np.testing.assert_array_equal(plan.edge_of_camera[owned], rows["paper-literal"].edge_of_camera[owned])
    # Nobody is left out of a run: an orphan goes to the nearest edge.
    sites = np.array([edge.position for edge in system.edges])
    nearest = np.sum((positions[:, None] - sites) ** 2, axis=2).argmin(axis=1)
    np.testing.assert_array_equal(plan.edge_of_camera[~owned], nearest[~owned])
    np.testing.assert_allclose(plan.sites, [positions[plan.edge_of_camera == edge].mean(axis=0) for edge in range(4)], atol=1e-9)
    assert len(split_edges(positions, plan, system)) == 4


def test_d_and_the_threshold_decide_where_the_literal_loop_ends() -> None:
    positions = np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=1)
    system = linear_system(np.array([[25.0, 0.0], [75.0, 0.0]]), np.array([5.0, 1.0]))
    orphans = {}
    for step in (0.01, 0.2):
        rows = {row.method: row for row in compare(positions, system, paper=PaperConfig(boundary_step=step), max_iterations=1)}
        orphans[step] = rows["paper-literal"].num_orphans
    # The left edge alone gives up d of its side, a camera per metre; the other has the first of
    # them, which stands on the border.
    assert orphans == {0.01: 0, 0.2: 19}
    wide = plan_regions(positions, system, method="paper-literal", paper=PaperConfig(threshold=100.0))
    assert isinstance(wide, CloudPlan)
    nearest = [abs(positions[:, 0] - x).tolist() for x in (25.0, 75.0)]
    np.testing.assert_array_equal(wide.edge_of_camera, np.argmin(nearest, axis=0))


def test_content_is_shared_instead_of_cameras() -> None:
    rng = np.random.default_rng(0)
    positions = rng.random((2000, 2)) * [2.0, 1.0]
    content = np.where(positions[:, 0] < 1.0, 9.0, 1.0)
    cells = halve_by_weight(positions, np.array([[0.4, 0.5], [1.6, 0.5]]), content)
    shares = np.bincount(cells, weights=content)
    assert shares[0] == pytest.approx(shares[1], rel=0.01)
    assert np.bincount(cells)[0] < 700


@pytest.mark.parametrize("content", [[-1.0, 1.0], [np.nan, 1.0], [1.0]])
def test_poisoned_content_is_refused(content: list[float]) -> None:
    with pytest.raises(BadInput):
        compare(np.eye(2), random_system(np.random.default_rng(0), 2), content=content)


def alg1(positions: np.ndarray, system: System, method: str, max_iterations: int) -> tuple[np.ndarray, list[float]]:
    """Lines 1-11 of Alg. 1 camera by camera: who is where, and max|T − T̄| / T̄ before every move
    and at the end; −1 in no region."""
    sites = np.array([edge.position for edge in system.edges])
    count, step_m = len(sites), 0.01 * max(np.ptp(positions, axis=0))
    tables = edge_tables(system, len(positions))
    apart = [[float(np.hypot(*(a - b))) for b in sites] for a in sites]
    nearest = [min((apart[i][j] for j in range(count) if j != i), default=0.0) for i in range(count)]
    bound_s = fastest_counts(tables, len(positions))[1]
    moved, lengths, turns, seen, history = [0.0] * count, 1.0, [0.0] * count, set(), []

    def owner(x: np.ndarray) -> int:
        squared = [float(np.sum((x - site) ** 2)) for site in sites]
        if method != "paper-literal":
            return min(range(count), key=lambda i: squared[i] - 2 * step_m * nearest[i] * moved[i])
        for i in range(count):
            if all((squared[i] - squared[j]) / (2 * apart[i][j]) <= moved[i] * step_m for j in range(count) if j != i):
                return i
        return -1

    while True:
        cells = np.array([owner(x) for x in positions])
        times = [float(table.edge_time_s[(cells == i).sum()]) for i, table in enumerate(tables)]
        mean = sum(times) / count
        gaps = [time - mean for time in times]
        worst = max(range(count), key=lambda i: (abs(gaps[i]), -i))
        history.append(abs(gaps[worst]) / mean)
        state = (tuple(moved), lengths)
        if abs(gaps[worst]) <= 0.05 * (bound_s if method == "paper-literal" else mean) or state in seen or len(history) > max_iterations:
            return cells, history
        seen.add(state)
        turn = -float(np.sign(gaps[worst]))
        if method == "paper-halved" and turns[worst] == -turn:
            lengths /= 2
        turns[worst] = turn
        moved[worst] += turn * lengths


@pytest.mark.parametrize("seed", range(5))
def test_the_papers_three_readings_are_those_written_out_camera_by_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.random((80, 2)) * [500.0, 250.0]
    system = linear_system(rng.random((4, 2)) * [500.0, 250.0], rng.uniform(1, 2, 4))
    for limit in (2, 40):
        rows = {row.method: row for row in compare(positions, system, max_iterations=limit)}
        for method in ("paper", "paper-halved", "paper-literal"):
            cells, history = alg1(positions, system, method, limit)
            np.testing.assert_array_equal(rows[method].edge_of_camera, cells, err_msg=method)
            np.testing.assert_allclose(rows[method].history, history, rtol=1e-9)


def test_every_figure_of_a_row_is_that_of_its_cameras() -> None:
    rng = np.random.default_rng(7)
    positions = rng.random((90, 2)) * [500.0, 250.0] + [1000.0, 2000.0]
    system = linear_system(rng.random((3, 2)) * [500.0, 250.0] + [1000.0, 2000.0], np.array([1.0, 2.0, 3.0]))
    sites = np.array([edge.position for edge in system.edges])
    bound_s = fastest_counts(edge_tables(system, 90), 90)[1]
    rows = {row.method: row for row in compare(positions, system, content=rng.random(90), max_iterations=20)}
    for row in rows.values():
        owned = row.edge_of_camera >= 0
        times = np.bincount(row.edge_of_camera[owned], minlength=3) * [1.0, 2.0, 3.0]
        np.testing.assert_allclose(row.edge_time_s, times, rtol=1e-12)
        assert row.makespan_s == times.max() and row.over_bound == pytest.approx(times.max() / bound_s)
        squared = np.sum((positions[owned] - sites[row.edge_of_camera[owned]]) ** 2)
        assert row.squared_distance_m2 == pytest.approx(squared, rel=1e-9)
        assert row.history[-1] == pytest.approx(np.abs(times - times.mean()).max() / times.mean(), rel=1e-12)
        if not row.method.startswith("paper"):
            assert len(row.history) == 1
    assert (halve_by_weight(positions, sites, np.ones(90)) != rows["content"].edge_of_camera).any()
    np.testing.assert_array_equal(np.bincount(rows["even"].edge_of_camera), [30, 30, 30])
    free = compare(positions, linear_system(sites, np.zeros(3)), max_iterations=2)
    assert all((row.makespan_s, row.over_bound, row.history) == (0.0, 1.0, (0.0,)) for row in free)


def test_even_takes_the_time_of_devices_with_equal_shares() -> None:
    rng = np.random.default_rng(2)
    positions, system = LAYOUTS["uniform"](rng, 120), random_system(rng, 4)
    even = {row.method: row for row in compare(positions, system, max_iterations=2)}["even"]
    plan = plan_regions(positions, system, method="even")
    assert isinstance(plan, CloudPlan)
    np.testing.assert_array_equal(even.edge_time_s, plan.edge_time_s)
    assert even.makespan_s >= max(own.device_time_s.max() for own in split_edges(positions, plan, system)), "of equal shares"


def test_cameras_without_room_or_number_are_refused() -> None:
    system = linear_system(np.eye(2), np.ones(2), 2)
    for positions, content, told in (
        (np.zeros((0, 2)), None, "at least one camera"),
        (np.zeros((5, 2)), None, "the devices cannot hold 5 cameras: raise max_cameras or add devices"),
        (np.zeros((2, 3)), None, "positions has shape"),
        (np.zeros((2, 2)), [1.0], "content has shape"),
        (np.zeros((2, 2)), [1.0, -0.1], "content of at least 0"),
    ):
        with pytest.raises(BadInput, match=told):
            compare(positions, system, content=content)
    assert len(compare(np.zeros((1, 2)), system, content=[0.0])) == 6


def test_halves_are_equal_where_shares_are_no_binary_fractions() -> None:
    positions = np.stack([np.arange(10.0), np.zeros(10)], axis=1)
    sites = np.array([[9.0, 0.0], [1.0, 0.0]])
    for weight in (0.1, 0.7, 1e-9, 3.0):
        np.testing.assert_array_equal(halve_by_weight(positions, sites, np.full(10, weight)), [1] * 5 + [0] * 5)
    np.testing.assert_array_equal(halve_by_weight(positions[:, ::-1], sites[:, ::-1], np.ones(10)), [1] * 5 + [0] * 5)
    three = np.array([[9.0, 0.0], [1.0, 0.0], [5.0, 0.0]])
    np.testing.assert_array_equal(halve_by_weight(positions[:9], three, np.full(9, 0.1)), [1] * 3 + [2] * 3 + [0] * 3)
