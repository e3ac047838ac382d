"""Whole flight lines: the exact fewest cuts against all ways of small cases, 2,000 waypoints, and flights that have no such order."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.flight.whole_lines import _deal, device_of_all, keep_lines, num_cut
from radiant_core.plan.plans import CloudPlan, require_plan_of
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System
from tests.seeds import for_seeds


def lawn_mower(num_lines: int, per_line: int, turn_deg: float = 0.0) -> FloatArray:
    """Lines to and fro, 25 m apart, a photograph every 20 m."""
    places = [(20.0 * (k if line % 2 == 0 else per_line - 1 - k), 25.0 * line) for line in range(num_lines) for k in range(per_line)]
    turn = np.radians(turn_deg)
    return np.array(places) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


def system_of(speeds: list[list[float]]) -> System:
    def device(name: str, seconds: float) -> Device:
        return Device(
            id=name,
            init_s=CostCurve(constant=5.0),
            train_s=CostCurve(linear=seconds),
            model_bytes=CostCurve(linear=1e5),
            uplink_bytes_per_s=1e7,
        )

    return System(
        edges=tuple(
            Edge(
                id=f"e{e}",
                devices=tuple(device(f"e{e}d{d}", seconds) for d, seconds in enumerate(own)),
                aggregate_s=CostCurve(linear=0.05),
                uplink_bytes_per_s=2e7,
                position=(300.0 + e, 300.0 * e),
            )
            for e, own in enumerate(speeds)
        )
    )


def planned(positions: FloatArray, system: System) -> tuple[CloudPlan, tuple]:
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(positions, cloud, system)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 90.0])
def test_no_line_of_2000_waypoints_is_cut_that_five_percent_could_keep(turn_deg: float) -> None:
    positions, system = lawn_mower(40, 50, turn_deg), system_of([[1.0, 1.3], [0.9, 2.0], [1.1, 1.1]])
    cloud, edges = planned(positions, system)
    found = keep_lines(positions, cloud, edges, system, 1.05)
    assert found.reason is None and found.num_lines == 40
    assert found.cut_before > 5, "the plan before follows the land alone"
    # Whole lines of 50 fit into 5 % of some 330 photographs a device, or the exact search says not.
    assert found.cut <= 1 and found.slack <= 1.05 + 1e-9
    require_plan_of(len(positions), found.cloud, found.edges)
    assert found.cloud.makespan_s <= 1.05 * cloud.lower_bound_s * (1 + 1e-9)
    _require_power_diagram(found.cloud, positions)


def _require_power_diagram(cloud: CloudPlan, positions: FloatArray) -> None:
    """Cameras lie in the cells of sites and weights, but those that are said to be outside."""
    power = ((positions[:, None] - cloud.sites) ** 2).sum(axis=2) - cloud.weights
    own = power[np.arange(len(positions)), cloud.edge_of_camera]
    assert int((own > power.min(axis=1) + 1e-6).sum()) <= cloud.num_outside


@for_seeds(60)
def test_the_fewest_cuts_are_those_of_trying_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    line = np.repeat(np.arange(4), rng.integers(1, 4, 4))
    line[rng.random(len(line)) < 0.2] = -1
    capacities = rng.integers(0, 6, 3)
    inside = [at not in (0, len(line)) and line[at] == line[at - 1] >= 0 for at in range(len(line) + 1)]
    ways = [
        int(inside[a]) + int(inside[b])
        for a, b in product(range(len(line) + 1), repeat=2)
        if a <= b and all(end - start <= capacity for start, end, capacity in zip((0, a, b), (a, b, len(line)), capacities, strict=True))
    ]
    found = _deal(line, capacities.astype(np.int64))
    if not ways:
        assert found is None
        return
    assert found is not None
    cuts, ends = found
    starts = np.concatenate([[0], ends[:-1]])
    assert cuts == min(ways)
    assert (ends - starts <= capacities).all() and (ends >= starts).all() and ends[-1] == len(line)
    assert sum(inside[end] for end in ends[:-1].tolist()) == cuts


def test_more_slack_cuts_no_more_lines_and_one_is_the_bound() -> None:
    positions, system = lawn_mower(12, 17), system_of([[1.0, 3.0], [2.0]])
    cloud, edges = planned(positions, system)
    cuts = [keep_lines(positions, cloud, edges, system, slack).cut for slack in (1.0, 1.02, 1.1, 1.5)]
    assert cuts == sorted(cuts, reverse=True) and cuts[-1] == 0
    assert keep_lines(positions, cloud, edges, system, 1.0).cloud.makespan_s <= cloud.lower_bound_s * (1 + 1e-6)


def test_flights_without_one_way_stay_as_they_were() -> None:
    rng = np.random.default_rng(0)
    system = system_of([[1.0], [1.0]])
    scattered, crossed = rng.random((60, 2)) * 200, np.concatenate([lawn_mower(6, 12), lawn_mower(6, 12, 90.0)])
    for positions, said in ((scattered, "flight lines"), (crossed, "one way")):
        cloud, edges = planned(positions, system)
        found = keep_lines(positions, cloud, edges, system, 1.05)
        assert found.reason is not None and said in found.reason and found.reason.endswith(".")
        assert found.cloud is cloud and found.edges is edges


def test_a_slack_below_one_is_refused() -> None:
    positions, system = lawn_mower(4, 6), system_of([[1.0]])
    cloud, edges = planned(positions, system)
    for slack in (0.9, float("nan"), 1e9):
        with pytest.raises(BadInput, match="--whole-lines"):
            keep_lines(positions, cloud, edges, system, slack)
    assert num_cut([np.arange(6)], device_of_all(edges, len(positions))) == 0
