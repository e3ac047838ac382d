"""What devices tell of where they were, what the cloud is told, and `radiant plan` from a raster."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.config.run_config import PlanOptions, RunConfig
from radiant_app.files.system_file import even_system
from radiant_app.report.progress import ProgressDisplay
from radiant_app.reporting import EventReporter
from radiant_app.run.cloud_planning import place_edges_by_raster
from radiant_app.workers.field_nodes import raster_record
from radiant_app.workers.regions import plan_from_raster, plan_regions_of_task, regions_task, run_regions
from radiant_app.workers.tasks import RegionsTask
from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.hierarchy.codec import load_task, message_record, save_task
from radiant_core.io.records import load_plan
from radiant_core.plan.counts.count_raster import DEFAULT_CELL_M, count_raster

ORIGIN = np.array([47.35, 8.51, 420.0])


def captured(count: int = 60) -> np.ndarray:
    """Positions (P,3) deg, deg, m over some 300 m."""
    rng = np.random.default_rng(0)
    return ORIGIN + rng.uniform(-1, 1, (count, 3)) * [1.3e-3, 2e-3, 20.0]


@pytest.mark.parametrize("cell_m", [1.0, 5.0, 100.0])
def test_a_device_tells_how_many_lie_in_a_cell_and_no_position(cell_m: float) -> None:
    places = captured()
    told = raster_record(places, cell_m)
    cells = np.array(told["cells"])
    assert cells[:, 2].sum() == 60 and told["altitude_m"] % 10 == 0
    middles = np.column_stack([cells[:, :2], np.full(len(cells), 420.0)])
    flat = np.column_stack([places[:, :2], np.full(60, 420.0)])
    away = np.abs(enu_from_geodetic(middles, ORIGIN)[None, :, :2] - enu_from_geodetic(flat, ORIGIN)[:, None, :2])
    # A metre on the sphere is up to 0.7 % off that on the ellipsoid.
    assert (away.max(axis=2).min(axis=1) <= 0.51 * cell_m + 1e-3).all(), "every position lies in a cell that is told"
    text = json.dumps(told)
    assert not any(repr(float(value)) in text for value in places[:, :2].ravel())
    # The same cells from any start: two devices at one place tell the same.
    assert {tuple(cell[:2]) for cell in raster_record(places[:7], cell_m)["cells"]} <= {tuple(cell[:2]) for cell in told["cells"]}
    assert raster_record(places[:0], cell_m) == {"cells": [], "altitude_m": None}


def test_the_cloud_answers_from_its_task_alone(tmp_path: Path) -> None:
    positions = enu_from_geodetic(captured(), ORIGIN)[:, :2]
    system = place_edges_by_raster(even_system(3, 2), positions, None, 20.0, 0)
    task = regions_task(count_raster(positions, 20.0), system, "exact")
    text = json.dumps(message_record(task))
    assert not any(device.id in text for device in system.devices) and "device" not in text
    save_task(tmp_path, task)
    told = load_task(RegionsTask, tmp_path)
    assert run_regions(tmp_path, told, EventReporter(stage="planning", emit=lambda event: None)) == ["regions.json"]
    regions, edges = load_plan(tmp_path / "regions.json")
    assert edges == () and regions.counts.sum() == 60
    again = plan_regions_of_task(told)
    np.testing.assert_array_equal(again.weights, regions.weights)
    plan = plan_from_raster(system, positions, 20.0, "exact")
    np.testing.assert_array_equal(plan.weights, regions.weights)
    assert plan.counts.sum() == 60 and plan.makespan_s >= plan.lower_bound_s


def test_what_the_edges_cannot_hold_is_refused_with_its_reason() -> None:
    positions = enu_from_geodetic(captured(), ORIGIN)[:, :2]
    system = place_edges_by_raster(even_system(2, 1), positions, None, 20.0, 0)
    task = regions_task(count_raster(positions, 20.0), system, "exact")
    full = tuple(replace(edge, max_cameras=20) for edge in task.edges)
    with pytest.raises(BadInput, match="can hold 40 of 60"):
        plan_regions_of_task(replace(task, edges=full))


def test_radiant_plan_from_a_raster_says_so_and_refuses_what_needs_positions(tmp_path: Path) -> None:
    rows = "\n".join(f"{name},{lat},{lon},{alt}" for name, (lat, lon, alt) in enumerate(captured()))
    (tmp_path / "way.csv").write_text(f"name,latitude,longitude,altitude\n{rows}\n")
    display = ProgressDisplay(Console(quiet=True))
    request = {"source": tmp_path / "way.csv", "out": tmp_path / "plan.json", "system": None, "method": "exact", "seed": 0}
    result = plan(PlanRequest(**request, raster_cell_m=10.0), display)
    assert "count raster of 10 m" in result["warnings"] and result["makespan_s"] >= result["lower_bound_s"]
    cloud, edges = load_plan(tmp_path / "plan.json")
    assert sum(len(edge.camera_indices) for edge in edges) == cloud.counts.sum() == 60
    with pytest.raises(BadInput, match="choose one"):
        plan(PlanRequest(**{**request, "out": tmp_path / "other.json"}, raster_cell_m=10.0, slack=1.1), display)
    assert not (tmp_path / "other.json").exists()


def test_who_plans_from_a_raster_by_itself(tmp_path: Path) -> None:
    given = {"source": tmp_path, "out": tmp_path / "run"}
    assert RunConfig(**given).cell_m is None and RunConfig(**given, plan=PlanOptions(raster_cell_m=7.0)).cell_m == 7.0
    assert RunConfig(**given, frames="gps").cell_m == DEFAULT_CELL_M == RunConfig(**given, frames="known").cell_m
    assert RunConfig(**given, frames="gps", plan=PlanOptions(raster_cell_m=0.0)).cell_m is None
    for wrong in (-1.0, float("nan"), float("inf")):
        with pytest.raises(BadInput, match="raster_cell_m"):
            PlanOptions(raster_cell_m=wrong)
