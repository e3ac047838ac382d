"""Plans read off from who captured what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_app.files.system_file import even_system
from radiant_core.errors import BadInput
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import regions_around
from radiant_core.plan.revision.assigned import assigned_plan
from radiant_core.plan.system import System

SYSTEM = even_system(2, 2)
OWNERS = [device.id for device in SYSTEM.devices]


def test_counts_times_and_regions_follow_the_owners() -> None:
    rng = np.random.default_rng(0)
    corners = np.array([[0, 0], [0, 40], [100, 0], [100, 40]])
    owners = [OWNERS[index % 4] for index in range(41)]
    positions = corners[[OWNERS.index(owner) for owner in owners]] + rng.uniform(-8, 8, (41, 2))
    cloud, edges = assigned_plan(positions, owners, SYSTEM)
    assert cloud.counts.tolist() == [21, 20] and cloud.method == "captured"
    for plan in edges:
        for index, device in enumerate(plan.device_ids):
            assert [owners[camera] for camera in plan.cameras_of(device)] == [device] * len(plan.cameras_of(device))
            assert 0 < _area(plan.strips[index]) < 300
    assert (assign(positions, cloud.sites, cloud.weights) == cloud.edge_of_camera).all()
    assert cloud.makespan_s >= cloud.lower_bound_s > 0


def test_the_bound_is_that_of_free_dealing_and_0_where_memory_forbids_it() -> None:
    positions = np.random.default_rng(1).random((30, 2)) * 100
    owners = np.repeat([0, 1], [20, 10])
    assert regions_around(positions, owners, SYSTEM).lower_bound_s == pytest.approx(
        float(fastest_edge_counts(SYSTEM, 30).edge_time_s.max())
    )
    for most, has_bound in ((7, False), (8, True)):
        edges = [replace(e, devices=tuple(replace(d, max_cameras=most) for d in e.devices)) for e in SYSTEM.edges]
        found = regions_around(positions, owners, System(edges=tuple(edges)))
        assert (found.lower_bound_s > 0) is has_bound and found.counts.tolist() == [20, 10]


def _area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def test_one_edge_alone_and_a_line_of_positions() -> None:
    positions = np.stack([np.arange(6.0), np.zeros(6)], axis=1)
    cloud, edges = assigned_plan(positions, OWNERS[:1] * 6, SYSTEM)
    assert cloud.counts.tolist() == [6, 0] and edges[0].strips[0].shape == (0, 2)
    assert len(cloud.borders[1]) == 0, "an edge without cameras owns no land"


def test_strangers_and_poison_are_named() -> None:
    with pytest.raises(BadInput, match="no device 'ghost'"):
        assigned_plan(np.zeros((1, 2)), ["ghost"], SYSTEM)
    with pytest.raises(BadInput, match="positions"):
        assigned_plan(np.full((1, 2), np.nan), OWNERS[:1], SYSTEM)
