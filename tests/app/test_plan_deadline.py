"""How many photographs machines do by a deadline, held against every plan there is."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from radiant_app.commands.plan.costs import InTime, views_in_time
from radiant_core.errors import BadInput
from radiant_core.plan.counts.deadline import edge_tables
from radiant_core.plan.counts.slack import capacities_within
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System
from tests.core.plan.instances import LAYOUTS, random_system
from tests.seeds import for_seeds

MOST = 7


def least_makespan_s(system: System, count: int) -> float:
    """The least of all ways to give so many cameras to the edges."""
    tables = edge_tables(system, count)
    splits = [split for split in product(range(count + 1), repeat=len(tables)) if sum(split) == count]
    return min(max(float(table.edge_time_s[n]) for table, n in zip(tables, split, strict=True)) for split in splits)


@for_seeds(20)
def test_as_many_as_any_plan_does_by_the_deadline_and_no_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system, positions = random_system(rng, 3), LAYOUTS["uniform"](rng, MOST)
    times_s = [least_makespan_s(system, count) for count in range(MOST + 1)]
    for deadline_s in {*times_s[1:], 0.5 * times_s[1], 1.1 * times_s[-1]}:
        most = max(count for count, time_s in enumerate(times_s) if time_s <= deadline_s)
        if not most:
            with pytest.raises(BadInput, match="give a longer one"):
                views_in_time(system, MOST, deadline_s, asked=True)
            continue
        in_time = views_in_time(system, MOST, deadline_s, asked=True)
        assert in_time.num_views == most
        assert most == min(MOST, int(capacities_within(system, MOST, deadline_s).sum()))
        assert (in_time.left_out is None) == (most == MOST)
        plan = plan_regions(positions[:most], in_time.system)
        assert isinstance(plan, CloudPlan) and plan.certified
        assert plan.makespan_s <= deadline_s
        # Two sums of the same seconds.
        assert plan.makespan_s == pytest.approx(times_s[most], rel=1e-12)


def plain_system(*linear_s: float, max_cameras: int | None = None) -> System:
    """An edge per device, which takes 10 s and so many a photograph, joins in none and sends in
    none."""
    nothing = CostCurve()
    devices = [
        Device(
            id=f"d{index}", init_s=nothing, train_s=CostCurve(constant=10.0, linear=linear), model_bytes=nothing, uplink_bytes_per_s=1e6,
            max_cameras=max_cameras,
        )
        for index, linear in enumerate(linear_s)
    ]  # fmt: skip
    edges = [
        Edge(id=f"e{index}", position=(0.0, 0.0), aggregate_s=nothing, uplink_bytes_per_s=1e6, devices=(device,))
        for index, device in enumerate(devices)
    ]
    return System(edges=tuple(edges))


def test_what_is_left_out_is_said_with_the_deadline_that_it_needs() -> None:
    # 60 s: 50 photographs of 1 s, 25 of 2 s; of 90, 60 and 30 in 70 s.
    in_time = views_in_time(plain_system(1.0, 2.0), 90, 60.0, asked=True)
    assert in_time.num_views == 75
    assert in_time.choice == "15 of 90 views, those of least gain, are left out"
    assert in_time.left_out == "75 take 60.0 s of 60 s to train, join and send, one more takes edge 'e0' 61.0 s, all take 70.0 s"
    # The deadline that is named is enough.
    assert views_in_time(plain_system(1.0, 2.0), 90, 70.0, asked=True).left_out is None
    filled = views_in_time(plain_system(1.0, 2.0), 500, 60.0, asked=False)
    assert (filled.num_views, filled.choice) == (75, "75 views")
    with pytest.raises(BadInput, match=r"--deadline is 5 s, and one photograph takes edge 'e0', the fastest, 11\.0 s: give a longer one"):
        views_in_time(plain_system(1.0, 2.0), 90, 5.0, asked=True)


def test_memory_is_no_deadline() -> None:
    system = plain_system(1.0, 1.0, max_cameras=10)
    # Asked for: the plan refuses them. Filled: as many as there is room for, and no deadline is blamed.
    assert views_in_time(system, 30, 60.0, asked=True) == InTime(system=system, num_views=30)
    assert views_in_time(system, 30, 60.0, asked=False) == InTime(system=system, num_views=20)
    assert views_in_time(system, 30, 15.0, asked=False).num_views == 10
