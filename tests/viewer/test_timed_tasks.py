"""Five tasks of docs/inspector.md, done in the real window by keys, mouse and dialogs alone: at most five actions each, counted and timed.

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

from radiant_app.system_file import load_system
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene, save_plan
from radiant_core.plan.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.region_plan import PlanMethod, plan_regions
from radiant_core.splats import SH_C0
from tests.viewer.made_up_run import EDGE_IDS, SITES, Town, made_up_town, save_run
from tests.viewer.test_window import display, run_python  # noqa: F401 (a fixture)

MAX_ACTIONS = 5
MOVED = 20

DRIVER = """
import json, sys, time
from pathlib import Path
import numpy as np
from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QFileDialog, QLineEdit, QTabBar
from radiant_app.inspect_command import open_inspector
from radiant_core.plan.borders import shared_borders
from radiant_viewer.window import InspectorWindow

run, out, pictures = Path(sys.argv[1]), Path(sys.argv[2]), len(sys.argv) > 3
LEFT, SHIFT = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ShiftModifier
results, failures = {}, []

class User:
    # Does with a window what a person can, and counts it: a key, a click, a drag, or a name given to a dialog.
    def __init__(self, window):
        self.window, self.actions = window, ["radiant inspect RUN"]

    def press(self, keys):
        self.actions.append(f"press {keys}")
        QTest.keySequence(self.window, QKeySequence(keys))

    def click(self, widget, what, spot=QPoint()):
        self.actions.append(f"click {what}")
        QTest.mouseClick(widget, LEFT, pos=spot)

    def click_tab(self, title):
        bar, index = next(
            (bar, index) for bar in self.window.findChildren(QTabBar) for index in range(bar.count()) if bar.tabText(index) == title
        )
        self.click(bar, f"tab {title}", bar.tabRect(index).center())

    def choose(self, box, text):
        # The list opens by one click and is left by another.
        self.click(box, f"list of {box.currentText()}")
        view = box.view()
        until(view.isVisible, "the list never opened")
        # Qt takes what comes at once for the end of the click that opened the list.
        QTest.qWait(QApplication.doubleClickInterval() + 100)
        spot = view.visualRect(box.model().index(box.findText(text), 0)).center()
        self.click(view.viewport(), text, spot)

    def will_name(self, path):
        # Dialogs run their own loop: the answer must be on the way before they open.
        self.actions.append(f"name {path.name}")
        def answer():
            dialog = QApplication.activeModalWidget()
            if not isinstance(dialog, QFileDialog):
                QTimer.singleShot(20, answer)
                return
            field = dialog.findChild(QLineEdit, "fileNameEdit")
            dialog.activateWindow()
            until(dialog.isActiveWindow, "the dialog never got the keyboard")
            field.selectAll()
            QTest.keyClicks(field, str(path))
            while dialog.isVisible():
                # The list of completions takes a Return that comes while it opens.
                QTest.keyClick(field, Qt.Key.Key_Return)
                QTest.qWait(100)
        QTimer.singleShot(20, answer)

def until(condition, what):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, what
        QTest.qWait(10)

def pixel(canvas, place):
    x, y = canvas.pixels_of(np.array([[*place, 0.0]]))[0]
    return QPoint(round(x), round(canvas.size_wh[1] - 1 - y))

def find_worst_seam(user):
    user.press("T")
    dock = user.window.docks.seams
    until(lambda: dock.at is not None, "the tour never began")
    return {
        "title": dock.stops[dock.at].title,
        "status": user.window.statusBar().currentMessage(),
        "looks_at": user.window.view.pose.focal_point[:2].tolist(),
        "map_at": user.window.map.pose.focal_point[:2].tolist(),
    }

def move_twenty_cameras(user):
    planning, view = user.window.planning, user.window.map.plotter
    before = planning.session.editor.state.cloud
    user.press("E")
    slowest = int(before.edge_time_s.argmax())
    border = max((one for one in shared_borders(before) if slowest in (one.first, one.second)), key=lambda one: one.length_m)
    inward = border.toward_first if border.first == slowest else -border.toward_first
    grabbed = border.ends.mean(axis=0) + 0.5 * inward
    user.actions.append("drag the border into the slowest region until 20 cameras change hands")
    QTest.mousePress(view, LEFT, pos=pixel(user.window.map, grabbed))
    def moved():
        words = planning.dock.changes.text().split()
        return int(words[0]) if "hands" in words[:6] else 0
    frames = []
    planning.session.previewed.connect(frames.append)
    away = 0.0
    while moved() < 20:
        seen = len(frames)
        # As a hand does: fast first, then slowly.
        away += 3.0 if moved() < 14 else 0.6
        QTest.mouseMove(view, stop := pixel(user.window.map, grabbed + away * inward))
        until(lambda: len(frames) > seen, "no frame of the drag came")
    live = moved()
    QTest.mouseRelease(view, LEFT, pos=stop)
    until(lambda: planning.session.editor.edits and not planning.session.is_busy, "the drag never became an edit")
    return {"slowest": before.edge_ids[slowest], "live": live, "text": planning.dock.changes.text(), "owners": owners(planning),
            "frames": len(frames)}

def owners(planning):
    cloud = planning.session.editor.state.cloud
    return {"edges": cloud.edge_of_camera.tolist(), "time_s": cloud.edge_time_s.tolist(), "counts": cloud.counts.tolist()}

def find_worst_photograph(user):
    window, dock = user.window, user.window.docks.photo
    user.press("W")
    until(lambda: dock.picture.has_picture, "no photograph came")
    user.choose(dock.mode, "Difference")
    until(lambda: dock.mode.currentText() == "Difference", "nothing was chosen")
    user.press("Return")
    shown = dock.picture.grab().toImage()
    level = shown.pixelColor(shown.width() // 2, shown.height() // 2).red()
    eye = window.view.pose.camera((640, 480)).cam_from_world[0]
    return {"name": dock.name.text(), "figures": dock.figures_text.text(), "why": dock.reasons_text.text(), "level": level,
            "cam_from_world": eye.tolist()}

def export_regions(user):
    user.will_name(out / "regions.geojson")
    user.press("Ctrl+G")
    until((out / "regions.geojson").exists, "nothing was written")
    return {"status": user.window.statusBar().currentMessage()}

def compare_plans(user):
    planning = user.window.planning
    def vermillion():
        return int((np.abs(user.window.map.screenshot().astype(int) - (213, 94, 0)).max(axis=2) < 8).sum())
    before = vermillion()
    user.click_tab("Plan")
    user.will_name(out / "other.json")
    user.click(planning.dock.buttons["Compare…"], "Compare…")
    until(lambda: planning.comparison is not None, "nothing was compared")
    return {"text": planning.dock.changes.text(), "marked_px": vermillion() - before,
            "different": np.flatnonzero(planning.comparison.new_edge).tolist()}

TASKS = (find_worst_seam, move_twenty_cameras, find_worst_photograph, export_regions, compare_plans)

def drive(task, began):
    window = next(one for one in QApplication.topLevelWidgets() if isinstance(one, InspectorWindow) and one.isVisible())
    try:
        # What a window manager does with a new window.
        window.activateWindow()
        until(window.isActiveWindow, "the window never got the keyboard")
        QTest.qWait(100)
        opened = time.monotonic()
        user = User(window)
        found = task(user)
        results[task.__name__] = {**found, "actions": user.actions, "open_s": opened - began, "task_s": time.monotonic() - opened}
        if pictures:
            QTest.qWait(4000)
            window.save_window_picture(out / f"{task.__name__}.png")
    except BaseException as error:
        import traceback
        traceback.print_exc()
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

for task in TASKS:
    (run / "plan_edits.json").unlink(missing_ok=True)
    began = time.monotonic()
    QTimer.singleShot(0, lambda: drive(task, began))
    code = open_inspector(run)
    assert not failures and code == 0, (task.__name__, failures)
(out / "results.json").write_text(json.dumps(results))
"""


def town_of_the_tasks() -> Town:
    """144 cameras, three seams of different strength, and a worst photograph that saw few points."""
    town = made_up_town(step_levels=60, quarry_levels=20, grid=(16, 9))
    rng = np.random.default_rng(4)
    seen = np.concatenate(
        [
            np.column_stack([rng.choice(9000, 15 if one == 0 else 400, replace=False), np.full(15 if one == 0 else 400, one)])
            for one in range(len(town.scene.cameras))
        ]
    )
    return replace(town, scene=replace(town.scene, observations=seen.astype(np.int64)))


def planned(town: Town, system_file: Path, method: PlanMethod) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    system = load_system(system_file)
    placed = replace(
        system, edges=tuple(replace(edge, position=(float(x), float(y))) for edge, (x, y) in zip(system.edges, SITES, strict=True))
    )
    positions = town.scene.cameras.centers[:, :2]
    cloud = plan_regions(positions, placed, method=method)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(positions, cloud, placed)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, display: str) -> Any:  # noqa: F811 (the fixture)
    """The run, what was written beside it, and what the tasks came to."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    folder = tmp_path_factory.mktemp("tasks")
    run, out = folder / "run", folder / "out"
    out.mkdir()
    make_run(run, out)
    result = run_python(DRIVER, str(run), str(out), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    return run, out, json.loads((out / "results.json").read_text())


def make_run(run: Path, out: Path) -> None:
    """The run with every camera at its nearest edge, and the plan of least makespan as `other.json`."""
    town = town_of_the_tasks()
    lines = [f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2)) for edge in EDGE_IDS]
    run.mkdir()
    (run / "system.toml").write_text("".join(lines))
    cloud, edges = planned(town, run / "system.toml", "voronoi")
    save_run(run, replace(town, cloud_plan=cloud, edge_plans=edges))
    save_plan(out / "other.json", *planned(town, run / "system.toml", "exact"))


def test_no_task_takes_more_than_five_actions(done: Any) -> None:
    for name, result in done[2].items():
        print(f"{name}: {len(result['actions'])} actions, window {result['open_s']:.1f} s, task {result['task_s']:.2f} s")
        print("    " + "; ".join(result["actions"]))
    assert len(done[2]) == 5
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
