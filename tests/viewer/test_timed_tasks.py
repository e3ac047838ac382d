"""Tasks of docs/inspector.md, done in the real window by keys, mouse and dialogs alone: at most five
actions each, counted and timed.

What came of them is checked here, from the files and by other means than the window's.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely import get_coordinates
from shapely.geometry import Point, Polygon, shape

from radiant_app.files.system_file import load_system
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene, save_plan
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.splats import SH_C0
from tests.viewer.made_up_run import EDGE_IDS, SITES, Town, made_up_town, save_run
from tests.viewer.window_kit import patient, run_python

MAX_ACTIONS = 5
MOVED = 20
FIRST_MEASURE_S = 5.0


def town_of_the_tasks() -> Town:
    """144 cameras, three seams of different strength, a worst photograph that saw few points."""
    town = made_up_town(step_levels=60, quarry_levels=20, grid=(16, 9))
    rng = np.random.default_rng(4)
    seen = np.concatenate(
        [
            np.column_stack([rng.choice(9000, 15 if one == 0 else 400, replace=False), np.full(15 if one == 0 else 400, one)])
            for one in range(len(town.scene.cameras))
        ]
    )
    return replace(town, scene=replace(town.scene, observations=seen.astype(np.int64)))


def planned(town: Town, system_file: Path, tolerance: float) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    system = load_system(system_file)
    placed = replace(
        system, edges=tuple(replace(edge, position=(float(x), float(y))) for edge, (x, y) in zip(system.edges, SITES, strict=True))
    )
    positions = town.scene.cameras.centers[:, :2]
    cloud = plan_regions(positions, placed, tolerance=tolerance)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(positions, cloud, placed)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, display: str) -> Any:
    """The run, what was written beside it, and what the tasks came to."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    folder = tmp_path_factory.mktemp("tasks")
    run, out = folder / "run", folder / "out"
    out.mkdir()
    make_run(run, out)
    command = ["-m", "tests.viewer.timed_tasks", str(run), str(out)]
    result = run_python(command, DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    return run, out, json.loads((out / "results.json").read_text())


def make_run(run: Path, out: Path) -> None:
    """The run with all cameras at the nearest edge; the plan of least makespan as `other.json`."""
    town = town_of_the_tasks()
    lines = [f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2)) for edge in EDGE_IDS]
    run.mkdir()
    (run / "system.toml").write_text("".join(lines))
    cloud, edges = planned(town, run / "system.toml", tolerance=1e12)
    save_run(run, replace(town, cloud_plan=cloud, edge_plans=edges))
    save_plan(out / "other.json", *planned(town, run / "system.toml", tolerance=0.0))


def test_no_task_takes_more_than_five_actions(done: Any) -> None:
    """The fixture's session alone does nine tasks of a user, from an open window to the answer."""
    for name, result in done[2].items():
        print(f"{name}: {len(result['actions'])} actions, window {result['open_s']:.1f} s, task {result['task_s']:.2f} s")
        print("    " + "; ".join(result["actions"]))
    assert len(done[2]) == 9
    assert max(len(result["actions"]) for result in done[2].values()) <= MAX_ACTIONS


def test_the_seam_that_is_shown_is_the_worst(done: Any) -> None:
    run, _, results = done
    splats = load_ply(run / "scene.ply")
    levels = 255 * (0.5 + SH_C0 * splats.sh0[:, 0].mean(axis=1))
    away = np.linalg.norm(splats.means[:, None, :2] - SITES, axis=2)
    order = np.argsort(away, axis=1)[:, :2]
    steps = {}
    for pair in combinations(range(3), 2):
        # Beside the line of equal distance to both, which no third site is nearer to.
        beside = (np.sort(order, axis=1) == pair).all(axis=1) & (np.ptp(away[:, pair], axis=1) < 8)
        sides = [levels[beside & (order[:, 0] == side)].mean() for side in pair]
        steps[" | ".join(EDGE_IDS[side] for side in pair)] = abs(sides[0] - sides[1])
    found = results["find_worst_seam"]
    worst = max(steps, key=lambda title: steps[title])
    assert found["title"] == worst, (found["title"], steps)
    assert f"Border {worst}" in found["status"]
    shown = float(found["status"].split("colour step ")[1].split()[0])
    assert shown == pytest.approx(steps[worst], abs=8)
    first, second = (EDGE_IDS.index(name) for name in worst.split(" | "))
    for place in (found["looks_at"], found["map_at"]):
        distances = np.linalg.norm(np.array(place) - SITES, axis=1)
        assert distances[first] == pytest.approx(distances[second], abs=0.5)


def test_twenty_cameras_left_the_overloaded_edge(done: Any) -> None:
    run, _, results = done
    before, _ = load_plan(run / "plan.json")
    found = results["move_twenty_cameras"]
    slowest = before.edge_ids.index(found["slowest"])
    assert slowest == int(before.counts.argmax()), "the plan of the test has no overloaded edge"
    after = np.array(found["owners"]["edges"])
    changed = int((after != before.edge_of_camera).sum())
    assert MOVED <= changed <= MOVED + 3 and found["live"] == changed
    assert f"{changed} cameras change hands" in found["text"]
    assert np.bincount(after, minlength=3)[slowest] == found["owners"]["counts"][slowest] < before.counts[slowest]
    assert found["owners"]["time_s"][slowest] < before.edge_time_s[slowest]
    assert max(found["owners"]["time_s"]) < before.makespan_s
    np.testing.assert_array_equal(load_plan(run / "plan.json")[0].edge_of_camera, before.edge_of_camera)


def test_the_worst_photograph_and_why(done: Any) -> None:
    run, _, results = done
    rows = json.loads((run / "metrics.json").read_text())["images"]
    worst = min(rows, key=lambda row: row["psnr_db"])
    found = results["find_worst_photograph"]
    assert found["name"] == worst["name"]
    assert found["figures"].startswith("worst of") and f"PSNR {worst['psnr_db']:.2f} dB" in found["figures"]
    scene = load_scene(run / "sfm/scene.safetensors")
    index = scene.cameras.names.index(worst["name"])
    own = int((scene.observations[:, 1] == index).sum())
    assert own < 20
    assert f"{own} sparse points seen (median 400)" in found["why"]
    assert found["level"] == pytest.approx(60, abs=8), "the difference is not shown"
    np.testing.assert_allclose(found["cam_from_world"], scene.cameras.cam_from_world[index], atol=1e-4)


def test_the_regions_are_where_and_as_large_as_planned(done: Any) -> None:
    run, out, results = done
    cloud, _ = load_plan(run / "plan.json")
    features = json.loads((out / "regions.geojson").read_text())["features"]
    regions = {one["properties"]["name"]: shape(one["geometry"]) for one in features if one["properties"]["kind"] == "region"}
    assert set(regions) == set(EDGE_IDS)
    assert "regions.geojson" in results["export_regions"]["status"]
    # The town lies at 0° N: radii of curvature of WGS84 there, metres per degree east and north.
    per_degree = np.radians(1) * np.array([6378137.0, 6378137.0 * (1 - 0.00669437999014)])
    for edge, border in zip(cloud.edge_ids, cloud.borders, strict=True):
        region = Polygon(get_coordinates(regions[edge]) * per_degree)
        assert region.is_valid
        assert region.area == pytest.approx(Polygon(border).area, rel=1e-4)
        assert region.symmetric_difference(Polygon(border)).area < 1e-3 * region.area
    points = [one for one in features if one["properties"]["kind"] == "waypoint"]
    assert len(points) == len(cloud.edge_of_camera)
    inside = [regions[one["properties"]["edge"]].buffer(1e-7).contains(Point(one["geometry"]["coordinates"][:2])) for one in points]
    assert all(inside)


def test_both_plans_are_beside_each_other(done: Any) -> None:
    run, out, results = done
    mine, other = load_plan(run / "plan.json")[0], load_plan(out / "other.json")[0]
    found = results["compare_plans"]
    different = np.flatnonzero(mine.edge_of_camera != other.edge_of_camera)
    assert len(different) > 5
    assert found["different"] == different.tolist()
    assert f"{len(different)} cameras change hands" in found["text"]
    for plan in (mine, other):
        for count in plan.counts:
            assert f"<td>{count} in " in found["text"].replace("&nbsp;", "")
        assert f"{plan.makespan_s / plan.lower_bound_s:.3f} ×" in found["text"]
    assert found["marked_px"] > 20 * len(different), "the cameras that are elsewhere are not marked"


def test_a_measure_stands_there_at_the_second_click(done: Any) -> None:
    found = done[2]["measure_distance"]
    first, second = (np.array(point) for point in found["points"])
    # The ground of the town lies between 0 and 1 m.
    assert -1 < first[2] < 2 and -1 < second[2] < 2
    name, value, plus, sigma, unit = found["text"].split(";")[0].split()
    assert (name, plus, unit) == ("distance", "±", "m") and float(value) == pytest.approx(np.linalg.norm(second - first), abs=0.01)
    # A pixel is 0.12 m from 60 m with 500 px of focal length: σ_xy 0.06 m at either end, the heights' 0.19 m hardly count.
    assert 0.05 < float(sigma) < 0.4
    print(f"first measure: {found['figure_s']:.2f} s")
    assert found["figure_s"] <= patient(FIRST_MEASURE_S)


def test_a_lasso_leaves_out_what_lies_in_it_and_nothing_else(done: Any) -> None:
    run, _, results = done
    found = results["leave_out_by_lasso"]
    means = load_ply(run / "scene.ply").means.astype(np.float64)
    pose, K = np.array(found["cam_from_world"]), np.array(found["K"])
    seen = means @ pose[:3, :3].T + pose[:3, 3]
    away = np.hypot(*((seen[:, :2] / seen[:, 2:] * K[0, 0]).T))
    inside, near = (seen[:, 2] > 0) & (away < 59), (seen[:, 2] > 0) & (away < 61)
    # All lie on one ground, so that none is hidden by another; the lasso is a polygon of pixels.
    assert inside.sum() <= found["chosen"] <= near.sum() and found["chosen"] > 50
    assert found["left"] == len(means) - found["chosen"] and found["undone"] == len(means) and found["redone"] == found["left"]
    assert found["changed_inside"] > 0.5 and found["changed_outside"] < 0.02, found
    (step,) = found["file"]["steps"]
    assert step["kind"] == "selection" and step["keep"] == "outside" and step["strokes"][0]["front"] is not None


def test_from_above_and_along_a_border(done: Any) -> None:
    # Half a degree from straight down, where north is up.
    np.testing.assert_allclose(done[2]["see_from_above"]["looks"], [0, 0, -1], atol=0.01)
    assert done[2]["film_a_border"]["keyframes"] == 2
