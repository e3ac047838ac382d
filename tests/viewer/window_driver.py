"""What a process does to the real windows of a run, of one at work and of a PLY: `python -m
tests.viewer.window_driver OUT TASK=PATH …`, under an X server.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from PySide6.QtCore import Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QTabBar

from radiant_viewer.charts.charts import TimelineSpan
from radiant_viewer.charts.gantt_chart import GanttRow
from radiant_viewer.pictures.images import load_image
from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress, StageState
from radiant_viewer.window import inspector
from radiant_viewer.window.waiting_window import WaitingWindow
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_tour import (
    cameras,
    comparison,
    film_and_splats,
    layers,
    navigation,
    refused,
    seams,
    themes,
    tools,
    until,
)

AT_WORK = (StageState(stage="devices/a", state="running", completed=1, total=4),)
ROW = GanttRow(name="devices/a", predicted=(TimelineSpan(stage="train", start_s=0, stop_s=9),))
BEGUN = RunProgress(stages=(StageState(stage="sfm", state="running"),), is_running=True, status="running")
given = SimpleNamespace(
    out=Path(),
    what="",
    run_folder=Path(),
    progress=RunProgress(stages=AT_WORK, is_running=True, status="running", seconds_left=0.566),
)
"""Where files go, which session this is, of which folder, and what its run says of itself."""
failures = []
FEEDS = RunFeeds(gantt_rows=lambda: [ROW], progress=lambda: given.progress)
BEGUN_FEEDS = RunFeeds(progress=lambda: BEGUN)


def windows() -> list[Any]:
    return [widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow) and widget.isVisible()]


def drive():
    try:
        QTest.qWait(100)
        steps = {
            "run": steps_of_run,
            "begun": steps_of_begun_run,
            "model": steps_of_model,
            "film": steps_of_splat_film,
            "splats": steps_of_splats_of_model,
        }
        steps[given.what](next(iter(windows()), None))
    except BaseException as error:  # noqa: BLE001 (told below, once Qt has let go)
        traceback.print_exc()
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()


def steps_of_run(window):
    assert (window.width(), window.height()) == (1280, 800)
    assert "torch" not in sys.modules, "the window waits for torch"
    layers(window)
    cameras(window, given.out)
    comparison(window)
    seams(window)
    tools(window, given.out)
    themes(window)
    navigation(window)
    film_and_splats(window, given.out)
    live(window)


def steps_of_splat_film(window):
    fly = window.docks.fly
    for stop in (0, 1):
        window.docks.seams.go(stop)
        fly.add_view()
    fly.seconds.setValue(0.2)
    fly.write(given.out / "splats.gif", source="As the 3D view", size_wh=(96, 64))
    until(lambda: fly.job is None)
    assert fly.note.text().startswith("Saved 6 frames"), fly.note.text()


def steps_of_splats_of_model(window):
    until(lambda: window.model.shown_is_full)


def live(window):
    gantt, dock = window.docks.gantt, window.docks.progress
    window.raise_dock(gantt)
    until(lambda: gantt.image is not None)
    assert gantt.image.std() > 10
    assert dock.table.rowCount() == 1 and dock.table.cellWidget(0, 2).value() == 25
    assert dock.summary.text().endswith("about 1 s left")
    done = StageState(stage="devices/a", state="done", seconds=9.0)
    assert not dock.machines.isVisibleTo(dock)
    row = "edges/e: offline since 14:05, edges/e taken, 212 of 310 MB"
    machines = (row, "edges/f: joined")
    given.progress = RunProgress(stages=(done, StageState(stage="edges/e", state="done", seconds=2.0)), status="done", machines=machines)
    dock.refresh()
    assert dock.machines.isVisibleTo(dock) and dock.machines.text().splitlines() == list(machines)
    assert dock.table.rowCount() == 2 and "run ended (done)" in window.statusBar().currentMessage()
    window.save_screenshot(given.out / "shot.png")
    window.save_window_picture(given.out / "window.png")
    assert load_image(given.out / "window.png").shape == (800, 1280, 3)
    # A run that breaks while it is shown: what is shown stays.
    plan = given.run_folder / "plan.json"
    text = plan.read_bytes()
    plan.write_bytes(text[:100])
    window.reload()
    assert windows() == [window] and "plan.json" in window.statusBar().currentMessage()
    plan.write_bytes(text)
    window.reload()
    QTest.qWait(300)
    (fresh,) = windows()
    assert fresh is not window and fresh.screenshot().std() > 10
    # Closed in the middle of a film: no half of it stays.
    for _ in range(2):
        fresh.docks.fly.add_view()
    fresh.docks.fly.write(given.out / "closed.mp4", size_wh=(640, 360))
    fresh.close()
    assert not list(given.out.glob("*closed*"))


def steps_of_model(window):
    assert window.run is None and window.docks.cameras is None and window.docks.seams is None
    assert window.screenshot().std() > 5
    window.fly_to_selected()
    assert "No camera" in window.statusBar().currentMessage()
    window.docks.cleaning.box.active.setChecked(True)
    assert window.docks.cleaning.box.save_inside(given.out / "part.ply") > 0


def steps_of_begun_run(nothing):
    # There is no plan yet: what is at work is shown until there is one.
    assert nothing is None
    waiting = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, WaitingWindow))
    first = waiting.progress.table.item(0, 0)
    assert "no plan yet" in waiting.text.text() and first is not None and first.text() == "sfm"
    (given.out / "plan.json").rename(given.run_folder / "plan.json")
    until(windows)
    (window,) = windows()
    QTest.qWait(100)
    assert not [other for other in QApplication.topLevelWidgets() if isinstance(other, WaitingWindow)]
    assert window.model is None and window.docks.seams is None
    assert "no model yet" in window.statusBar().currentMessage()
    window.docks.photo.show_worst()
    assert "No photograph has figures yet" in window.statusBar().currentMessage()
    window.select_camera("DJI_0009.JPG")
    window.set_theme("dark")
    assert window.docks.progress.table.item(0, 1).text() == "running"
    refused(lambda: window.docks.cleaning.box.save_inside(given.out / "none.ply"))
    # New results of the training appear by themselves, but not while the user measures.
    window.set_layer_visible("Borders", False)
    window.docks.fly.add_view()
    window.view.plotter.camera.azimuth += 25
    window.docks.survey.click.setChecked(True)
    assert not window.docks.survey.visibleRegion().isEmpty(), "what is measured is not in sight"
    window.raise_dock(window.docks.fly)
    pose, keyframes = window.view.pose, window.docks.fly.keyframes
    (given.out / "scene.ply").rename(given.run_folder / "scene.ply")
    QTest.qWait(1500)
    assert windows() == [window], "the window was replaced under a measurement"
    window.docks.end_clicks()
    until(lambda: windows() and windows() != [window])
    (fresh,) = windows()
    QTest.qWait(100)
    assert fresh.model is not None and fresh.docks.seams is not None and fresh.theme.name == "dark"
    assert fresh.selected == 9 and not fresh.layer_dock.is_visible("Borders") and fresh.layer_dock.is_visible("Regions")
    assert np.allclose(fresh.view.pose.position, pose.position) and len(fresh.docks.fly.keyframes) == len(keyframes)
    assert not fresh.docks.fly.visibleRegion().isEmpty(), "another dock came to the front"
    floats(fresh)


def floats(window):
    dock = window.docks.cameras
    bar = next(bar for bar in window.findChildren(QTabBar) if bar.tabText(0) == "Cameras")
    QTest.mouseDClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(0).center())
    assert dock.isFloating() and dock.titleBarWidget() is None, "a floating dock cannot be taken hold of"
    action = next(action for action in window.panels.button.menu().actions() if action.text() == "Float Cameras")
    assert action.isChecked()
    action.trigger()
    assert not dock.isFloating() and dock.titleBarWidget() is not None and window.tabifiedDockWidgets(dock)


def main(out, tasks):
    given.out = Path(out)
    for given.what, folder in (task.split("=", 1) for task in tasks):
        given.run_folder = Path(folder)
        QTimer.singleShot(0, drive)
        code = inspector.open_window(given.run_folder, FEEDS if given.what != "begun" else BEGUN_FEEDS)
        assert not failures, (given.what, failures)
        assert code == 0, (given.what, code)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
