"""What becomes of a plan that was cut where cameras look: kept, moved, captured, planned anew."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.evaluate.seam_excess import border_errors
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.buffers import BufferRule, plan_buffers
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.revision.captured import plan_captured
from radiant_core.plan.revision.replan import FleetChange, Replan, replan
from radiant_core.plan.system import System
from radiant_core.render.rendered_view import RenderedView
from tests.core.scenes import cameras_above

from .instances import random_system


def looking_across(count: int = 120) -> tuple[FloatArray, FloatArray, System]:
    """Where cameras stand (C,2) and look (C,2): on the other side of the field."""
    rng = np.random.default_rng(4)
    stands = rng.random((count, 2)) * [500.0, 250.0]
    return stands, np.array([500.0, 250.0]) - stands + rng.normal(size=(count, 2)), random_system(rng, 3)


def planned(places: FloatArray, system: System) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    cloud = plan_regions(places, system)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(places, cloud, system)


def require_equal(first: CloudPlan, second: CloudPlan) -> None:
    for name in ("sites", "weights", "edge_of_camera", "edge_time_s"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert (first.status, first.certified, first.lower_bound_s) == (second.status, second.certified, second.lower_bound_s)


def test_a_plan_is_written_and_read_with_where_cameras_look_and_without(tmp_path: Path) -> None:
    _, looks, system = looking_across()
    cloud, edges = planned(looks, system)
    for plan in (cloud, replace(cloud, looks=looks)):
        save_plan(tmp_path / "plan.json", plan, edges)
        read, _ = load_plan(tmp_path / "plan.json")
        assert read.cut_by == plan.cut_by
        np.testing.assert_array_equal(read.places_of(np.zeros((120, 2))), plan.places_of(np.zeros((120, 2))))
    record = read_json(tmp_path / "plan.json")
    del record["cloud"]["looks"]  # as earlier versions wrote it
    write_json(tmp_path / "earlier.json", record)
    assert load_plan(tmp_path / "earlier.json")[0].looks is None
    for poison in ([[0.0, 1.0]], [[float("nan"), 0.0]] * 120, "everywhere", [[1.0, 2.0, 3.0]] * 120):
        record["cloud"]["looks"] = poison
        (tmp_path / "poison.json").write_text(json.dumps(record))
        with pytest.raises((BadInput, StoreDamaged), match=r"poison\.json"):
            load_plan(tmp_path / "poison.json")


def test_where_cameras_look_belongs_to_the_cameras_of_the_plan_and_moves_with_it() -> None:
    stands, looks, system = looking_across()
    cloud = replace(planned(looks, system)[0], looks=looks)
    with pytest.raises(BadInput, match="positions of 119"):
        cloud.places_of(stands[1:])
    with pytest.raises(BadInput, match="looks"):
        replace(cloud, looks=looks[1:])
    moved = cloud.moved(np.array([1000.0, -500.0]))
    np.testing.assert_allclose(moved.places_of(stands), looks + np.array([1000.0, -500.0]))
    np.testing.assert_allclose(moved.sites, cloud.sites + np.array([1000.0, -500.0]))
    assert replace(cloud, looks=None).moved(np.ones(2)).looks is None


def test_a_re_plan_goes_by_where_cameras_look() -> None:
    stands, looks, system = looking_across()
    cloud, edges = planned(looks, system)
    gone = system.edges[0].id
    for change in (FleetChange(), FleetChange(dead=frozenset({gone})), FleetChange(slow={gone: 3.0})):
        expected = replan(cloud, edges, looks, system, change)
        found = replan(replace(cloud, looks=looks), edges, stands, system, change)
        assert isinstance(expected, Replan) and isinstance(found, Replan)
        require_equal(found.cloud, expected.cloud)
        np.testing.assert_array_equal(found.device_after, expected.device_after)
        np.testing.assert_array_equal(found.cloud.looks, looks)


def test_photographs_look_as_far_from_where_they_were_taken_as_their_waypoints() -> None:
    stands, looks, system = looking_across()
    cloud, edges = planned(looks, system)
    shuffle = np.random.default_rng(1).permutation(len(stands))
    new, _ = plan_captured(replace(cloud, looks=looks), edges, stands, stands[shuffle], system=system)
    np.testing.assert_array_equal(new.edge_of_camera, cloud.edge_of_camera[shuffle])
    # Added to where it was taken and taken away again.
    np.testing.assert_allclose(new.places_of(stands), looks[shuffle], rtol=0, atol=1e-9)
    assert new.status == "optimal"
    by_stands, _ = plan_captured(cloud, edges, stands, stands[shuffle], system=system)
    assert by_stands.looks is None and not by_stands.certified


def test_buffers_by_distance_count_from_where_cameras_look() -> None:
    stands, looks, system = looking_across()
    cloud, edges = planned(looks, system)
    rule = BufferRule(within_m=15.0)
    expected = plan_buffers(looks, None, cloud, edges, system, rule)
    found = plan_buffers(stands, None, replace(cloud, looks=looks), edges, system, rule)
    assert sum(len(each.camera_indices) for each in expected) > 0
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(own.camera_indices, other.camera_indices)


def test_a_photographs_own_side_of_a_border_is_the_one_it_looks_at() -> None:
    cameras = cameras_above([(x, y) for x in (-0.8, 0.8) for y in (-2.0, 0.0, 2.0)], height_m=5.0, size_wh=(96, 72))
    stands = cameras.centers[:, :2]
    plan = CloudPlan(
        method="exact",
        edge_ids=("west", "east"),
        sites=np.array([[-3.0, 0.0], [3.0, 0.0]]),
        weights=np.zeros(2),
        borders=(
            np.array([[-9.0, -9.0], [0.0, -9.0], [0.0, 9.0], [-9.0, 9.0]]),
            np.array([[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]]),
        ),
        edge_of_camera=(stands[:, 0] > 0).astype(np.int64),
        edge_time_s=np.ones(2),
        lower_bound_s=1.0,
        status="optimal",
        certified=True,
    )

    def sides(plan: CloudPlan) -> list[str]:
        views = [
            RenderedView(
                name=name,
                image=np.zeros((72, 96, 3), np.float32),
                alpha=np.ones((72, 96), np.float32),
                depth=np.full((72, 96), 5.0, np.float32),
            )
            for name in cameras.names
        ]
        return [error.side for error in border_errors(cameras, views, [np.full((72, 96, 3), 0.5)] * len(views), plan)]

    assert sides(plan) == ["west"] * 3 + ["east"] * 3
    across = replace(plan, edge_of_camera=1 - plan.edge_of_camera, looks=stands * [-1.0, 1.0])
    assert sides(across) == ["east"] * 3 + ["west"] * 3
    with pytest.raises(BadInput, match="positions of 2"):
        list(border_errors(cameras.select([0, 1]), [], [], across))
