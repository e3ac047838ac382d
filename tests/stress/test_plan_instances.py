"""Ten thousand random plans: at the lower bound with a certificate, exhaustive search and a linear program agree on small ones."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

from benchmarks.plan import camera_layout
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.regions.transport import deal_with_counts
from radiant_core.plan.system import System
from tests.core.plan.instances import LAYOUTS, random_system

KINDS = ("uniform", "clustered", "lawnmower", "street", "collinear", "duplicates", "one spot", "lattice")


def instance(seed: int) -> tuple[FloatArray, System]:
    """2-64 edges and up to 20,000 cameras, mostly hundreds; flat curves and tight memory leave edges empty or full."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    largest = 20_000 if seed % 50 == 0 else 600
    num_cameras, num_edges = int(np.exp(rng.uniform(0, np.log(largest)))), int(rng.integers(2, 65))
    positions = LAYOUTS[kind](rng, num_cameras) if kind in LAYOUTS else camera_layout(kind, num_cameras, rng)  # pyright: ignore[reportArgumentType]
    limits = (num_cameras // num_edges + 1, num_cameras) if seed % 3 == 0 else None
    return positions, random_system(rng, num_edges, limits)


@pytest.mark.stress
@pytest.mark.parametrize("block", range(20))
def test_every_plan_is_at_the_bound_with_a_certificate(block: int) -> None:
    for seed in range(500 * block, 500 * (block + 1)):
        positions, system = instance(seed)
        plan = plan_regions(positions, system)
        assert isinstance(plan, CloudPlan), seed
        assert plan.status == "optimal", seed
        assert plan.certified, seed
        assert plan.makespan_s == plan.lower_bound_s, seed
        assert plan.counts.sum() == len(positions), seed


@pytest.mark.stress
def test_exhaustive_search_agrees_on_300() -> None:
    for seed in range(300):
        rng = np.random.default_rng(seed)
        num_cameras, num_edges = int(rng.integers(1, 8)), int(rng.integers(2, 4))
        positions, system = LAYOUTS[list(LAYOUTS)[seed % len(LAYOUTS)]](rng, num_cameras), random_system(rng, num_edges)
        plan = plan_regions(positions, system)
        assert isinstance(plan, CloudPlan)
        assignments = np.array(list(product(range(num_edges), repeat=num_cameras)))
        counts = np.stack([(assignments == edge).sum(axis=1) for edge in range(num_edges)], axis=1)
        times_s = np.stack([t.edge_time_s[counts[:, m]] for m, t in enumerate(edge_tables(system, num_cameras))], axis=1)
        assert plan.makespan_s == times_s.max(axis=1).min()


@pytest.mark.stress
def test_a_linear_program_finds_no_nearer_dealing() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        num_cameras, num_edges = 400, 12
        positions = camera_layout(("uniform", "clustered", "lawnmower", "street")[seed % 4], num_cameras, rng)
        sites = rng.random((num_edges, 2)) * 400
        counts = rng.multinomial(num_cameras, rng.dirichlet(np.ones(num_edges)))
        squared_m2 = np.sum((positions[:, None] - sites) ** 2, axis=-1)
        rows = np.kron(np.eye(num_cameras), np.ones(num_edges)), np.kron(np.ones(num_cameras), np.eye(num_edges))
        program = linprog(squared_m2.ravel(), A_eq=np.vstack(rows), b_eq=np.concatenate([np.ones(num_cameras), counts]), method="highs")
        dealt = deal_with_counts(positions, sites, counts)
        own = squared_m2[np.arange(num_cameras), dealt.edge_of_position].sum()
        assert own == pytest.approx(program.fun, rel=1e-9)  # HiGHS' tolerance


@pytest.mark.stress
def test_or_tools_min_cost_flow_finds_no_nearer_dealing() -> None:
    """Costs are whole square millimetres there. OR-tools is no dependency: `pip install ortools` lets this run."""
    flow = pytest.importorskip("ortools.graph.python.min_cost_flow", reason="OR-tools is not installed: pip install ortools")
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        num_cameras, num_edges = 2000, 16
        positions = camera_layout(("uniform", "clustered", "lawnmower", "street")[seed % 4], num_cameras, rng)
        sites = rng.random((num_edges, 2)) * 400
        counts = rng.multinomial(num_cameras, rng.dirichlet(np.ones(num_edges)))
        squared_m2 = np.sum((positions[:, None] - sites) ** 2, axis=-1)
        costs = np.rint(squared_m2 * 1e6).astype(np.int64)
        solver = flow.SimpleMinCostFlow()
        camera, edge = np.repeat(np.arange(num_cameras), num_edges), np.tile(num_cameras + np.arange(num_edges), num_cameras)
        solver.add_arcs_with_capacity_and_unit_cost(camera, edge, np.ones(len(camera), np.int64), costs.ravel())
        solver.set_nodes_supplies(np.arange(num_cameras + num_edges), np.concatenate([np.ones(num_cameras, np.int64), -counts]))
        assert solver.solve() == solver.OPTIMAL
        dealt = deal_with_counts(positions, sites, counts)
        own = int(costs[np.arange(num_cameras), dealt.edge_of_position].sum())
        # Rounding moves each camera's cost by half a square millimetre at most.
        assert own <= solver.optimal_cost() + num_cameras
