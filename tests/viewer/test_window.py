"""The real windows under a real X server, in a process of their own: of a run for all that it does,
of one at work from before its plan to its model, and of a PLY."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pictures

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.render.rendered_view import render_views
from radiant_viewer.window.desktop import require_desktop
from tests.viewer.made_up_run import made_up_town, save_run

ROOT = Path(__file__).parents[2]
DRIVER = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from PySide6.QtCore import QPoint, QTimer, Qt
from PySide6.QtGui import QAction
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMessageBox, QTabBar
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from radiant_viewer.window import inspector
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.pictures.images import load_image
from radiant_viewer.runs.run_feeds import RunFeeds, RunProgress, StageState
from radiant_viewer.charts.charts import TimelineSpan
from radiant_viewer.charts.gantt_chart import GanttRow
from radiant_viewer.window.waiting_window import WaitingWindow
from radiant_viewer.window.window import InspectorWindow

out, tasks = Path(sys.argv[1]), [task.split("=", 1) for task in sys.argv[2:]]
failures = []
stages = (StageState(stage="devices/a", state="running", done=1, total=4),)
progress = RunProgress(stages=stages, is_running=True, status="running", seconds_left=0.566)
begun = RunProgress(stages=(StageState(stage="sfm", state="running"),), is_running=True, status="running")
begun_feeds = RunFeeds(progress=lambda: begun)
row = GanttRow(name="devices/a", predicted=(TimelineSpan(stage="train", start_s=0, stop_s=9),))
feeds = RunFeeds(gantt_rows=lambda: [row], progress=lambda: progress)

def windows():
    return [widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow) and widget.isVisible()]

def until(done, seconds=30):
    for _ in range(20 * seconds):
        if done():
            return
        QTest.qWait(50)
    raise AssertionError(f"nothing came within {seconds} s")

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
        steps[what](next(iter(windows()), None))
    except BaseException as error:
        import traceback
        traceback.print_exc()
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

def steps_of_run(window):
    assert (window.width(), window.height()) == (1280, 800)
    assert "torch" not in sys.modules, "the window waits for torch"
    layers(window)
    cameras(window)
    comparison(window)
    seams(window)
    tools(window)
    themes(window)
    navigation(window)
    film_and_splats(window)
    live(window)

def layers(window):
    before = window.screenshot()
    assert before.std() > 10, "the views are empty"
    window.set_layer_visible("Regions", False)
    without = window.screenshot()
    assert (before != without).any(axis=2).mean() > 0.005, "hiding the regions changed nothing"
    window.set_layer_visible("Regions", True)
    assert np.array_equal(before, window.screenshot()), "showing the regions again gave another picture"
    window.layer_dock.set_solo("Borders")
    assert [layer.name for layer in window.visible_layers()] == ["Borders"]
    alone = window.screenshot()
    assert (alone == 255).all(axis=2).mean() > 0.9 > (before == 255).all(axis=2).mean(), "more than one layer is left"
    window.layer_dock.set_solo(None)
    assert np.array_equal(before, window.screenshot()), "ending solo gave another picture"
    refused(window, lambda: window.set_layer_visible("none", True))

def refused(window, wrong):
    try:
        wrong()
    except BadInput:
        return
    failures.append("something wrong was accepted")

def said_by(wrong):
    try:
        wrong()
    except BadInput as error:
        return str(error)
    return "nothing"

def vermillion(image):
    return int((np.abs(image.astype(int) - VERMILLION).max(axis=2) < 8).sum())

def cameras(window):
    before = vermillion(window.screenshot())
    dock = window.docks.cameras
    # A click into the 3D view, where that view itself draws the camera's centre.
    index = window.run.scene.cameras.names.index("DJI_0009.JPG")
    for canvas, name, at in ((window.view, "DJI_0009.JPG", index), (window.map, "DJI_0010.JPG", index + 1)):
        x, y = canvas.pixels_of(window.run.scene.cameras.centers[[at]])[0]
        spot = QPoint(round(x), round(canvas.size_wh[1] - 1 - y))
        QTest.mouseClick(canvas.plotter, Qt.MouseButton.LeftButton, pos=spot)
        assert window.selected == at, f"a click on {name} selected {window.selected}"
        assert name in window.statusBar().currentMessage()
        assert dock.table.selectionModel().selectedRows()[0].data() == name
    marked = vermillion(window.screenshot())
    assert marked > before + 50, "the selected camera is not marked"
    window.select_camera("DJI_0011.JPG")
    assert abs(vermillion(window.screenshot()) - marked) < 0.5 * marked, "an old mark stayed"
    refused(window, lambda: window.select_camera("none.jpg"))
    dock.table.sortByColumn(4, Qt.SortOrder.DescendingOrder)
    assert dock.sorted_cameras.index(0, 0).data() == "DJI_0016.JPG", "the best photograph is not first"
    dock.filter.setText("held out")
    dock.save_csv(out / "cameras.csv")
    lines = (out / "cameras.csv").read_text().splitlines()
    assert len(lines) == 4 and lines[1].startswith("DJI_0016.JPG,"), lines
    center = window.run.scene.cameras.centers[16] - [0, 0, window.subject.ground]
    assert np.allclose([float(cell) for cell in lines[1].split(",")[-3:]], center, atol=1e-12), "the table lost digits"
    window.select_camera("DJI_0009.JPG")
    assert dock.filter.text() == "" and window.selected == index, "a filter hid what was selected"
    window.fly_to_selected()
    eye = window.view.pose.camera((640, 480))
    assert np.allclose(eye.cam_from_world[0], window.run.scene.cameras.cam_from_world[index], atol=1e-4)
    window.reset_views()

def comparison(window):
    dock = window.docks.photo
    window.select_camera("DJI_0009.JPG")
    owner = window.run.roles.device_ids[window.run.roles.device_of_camera[9]]
    assert dock.picture._left is None and f"stays with device {owner}" in dock.picture.message, dock.picture.message
    window.raise_dock(dock)
    dock.show_worst()
    QTest.qWait(50)
    assert dock.name.text() == "DJI_0000.JPG" and "PSNR 20.00 dB" in dock.figures_text.text()
    def mean_level():
        picture = dock.picture.grab().toImage()
        colors = [picture.pixelColor(picture.width() * k // 20, picture.height() // 2).red() for k in range(5, 16)]
        return sum(colors) / len(colors)
    dock.slider.setValue(1000)
    photograph = mean_level()
    dock.slider.setValue(0)
    render = mean_level()
    assert abs(photograph - 200) < 8 and abs(render - 180) < 8, (photograph, render)
    dock.mode.setCurrentText("Difference")
    assert abs(mean_level() - 60) < 8
    # 80 × 60 px in a wider panel: 100 % is smaller than the whole, and the wheel comes nearer to the pointer.
    picture = dock.picture
    whole = picture.zoom
    dock.zoom.click()
    assert picture.zoom == 1.0 and picture._place().width() == 80 and dock.zoom.text() == "100 %", (whole, picture.zoom)
    spot = picture._place().topLeft() + QPoint(20, 15)
    place = picture._share_at(spot.toPointF())
    picture.zoom_to(6.0, spot.toPointF())
    assert picture.zoom == 6.0 and (picture._share_at(spot.toPointF()) - place).manhattanLength() < 0.05
    dock.zoom.click()
    assert picture.zoom == whole
    dock.step(1)
    assert dock.name.text() == "DJI_0008.JPG"
    dock.step(-5)
    assert dock.name.text() == "DJI_0000.JPG"

def seams(window):
    dock = window.docks.seams
    dock.go(0)
    worst = dock.stops[0]
    assert "harbour" in worst.title, worst.title
    for canvas in (window.map, window.view):
        x, y = canvas.pixels_of(np.array([[*worst.worst, window.subject.ground]]))[0]
        width, height = canvas.size_wh
        assert abs(x - width / 2) < 3 and abs(y - height / 2) < 3, (canvas.is_map, x, y)
    for expected in (1, 2, 0):
        dock.step(1)
        assert dock.at == expected
    dock.step(-1)
    assert dock.at == 2 and dock.table.currentRow() == 2
    plan = window.run.cloud_plan
    for moved in (3.0, 0.0):
        (layer,) = dock.show_plan(replace(plan, borders=tuple(border + moved for border in plan.borders)))
        assert dock.edited.isHidden() == (moved == 0), moved
        assert any("edits move no seam" in entry.text for entry in layer.legend) == (moved > 0), layer.legend

def tools(window):
    window.reset_views()
    window.measure.set_active(True)
    for x, y in ((-60, -30), (60, -30), (60, 30)):
        pixel = window.map.pixels_of(np.array([[x, y, 0.0]]))[0]
        spot = QPoint(round(pixel[0]), round(window.map.size_wh[1] - 1 - pixel[1]))
        QTest.mouseClick(window.map.plotter, Qt.MouseButton.LeftButton, pos=spot)
    assert np.allclose(window.measure.corners, [[-60, -30], [60, -30], [60, 30]], atol=2), window.measure.corners
    assert "area" in window.statusBar().currentMessage(), window.statusBar().currentMessage()
    length, area = (float(part.split()[-2]) for part in window.statusBar().currentMessage().split("·"))
    assert abs(length - 180) < 4 and abs(area - 3600) < 250, (length, area)
    window.measure.undo()
    assert window.statusBar().currentMessage().startswith("Distance 1")
    window.measure.set_active(False)
    measure, drawing = next(action for action in window.findChildren(QAction) if action.text() == "Measure"), window.docks.cleaning
    measure.trigger()
    drawing.draw.setChecked(True)
    assert drawing.polygon.is_active and not window.measure.is_active, "two tools take the clicks"
    measure.trigger()
    assert window.measure.is_active and not drawing.polygon.is_active and not drawing.draw.isChecked()
    measure.trigger()
    assert not window.measure.is_active
    before = window.screenshot()
    crop = window.docks.cleaning.box
    crop.active.setChecked(True)
    crop.set_box(np.array([[-50, -30, -5], [50, 30, 70.0]]))
    assert (before != window.screenshot()).any(axis=2).mean() > 0.02, "the crop box hid nothing"
    count = crop.save_inside(out / "inside.ply")
    inside = load_ply(out / "inside.ply").means
    assert len(inside) == count > 100 and (abs(inside) <= (50, 30, 70)).all()
    drags_the_box(window, crop)
    crop.set_box(np.full((2, 3), 1e4))
    refused(window, lambda: crop.save_inside(out / "nothing.ply"))
    window.attempt(lambda: crop.save_inside(out / "nothing.ply"))
    boxes = window.findChildren(QMessageBox)
    assert len(boxes) == 1 and "no Gaussian" in boxes[0].text() and not (out / "nothing.ply").exists()
    boxes[0].close()
    crop.active.setChecked(False)
    crop.reset.click()
    assert np.array_equal(before, window.screenshot()), "the crop box left something behind"
    cleaning(window, before)

def cleaning(window, before):
    dock = window.docks.cleaning
    window.raise_dock(dock)
    file = window.subject.path / "cleaning.json"
    dock.draw.click()
    # Around the town's south-west.
    for x, y in ((-100, -60), (0, -60), (0, 0), (-100, 0)):
        pixel = window.map.pixels_of(np.array([[x, y, 0.0]]))[0]
        spot = QPoint(round(pixel[0]), round(window.map.size_wh[1] - 1 - pixel[1]))
        QTest.mouseClick(window.map.plotter, Qt.MouseButton.LeftButton, pos=spot)
    dock.keep_inside("outside")
    assert not dock.polygon.is_active and file.exists()
    kept = window.run.splats.means
    quarter = (kept[:, 0] > -95) & (kept[:, 0] < -5) & (kept[:, 1] > -55) & (kept[:, 1] < -5)
    assert 1000 < len(kept) < 9000 and not quarter.any(), "the polygon kept its inside"
    assert f"{9000 - len(kept):,} of 9,000 Gaussians left out" in window.statusBar().currentMessage()
    assert (before != window.screenshot()).any(axis=2).mean() > 0.02, "the cleaning changed no picture"
    dock.width_limit.setValue(0.61)
    assert dock.count.text() == "0 more would be left out", dock.count.text()
    dock.opacity.setValue(0.9)
    assert dock.count.text() == f"{len(kept):,} more would be left out", dock.count.text()
    dock.keep_opacity.click()
    boxes = window.findChildren(QMessageBox)
    assert "leaves nothing" in boxes[-1].text() and len(window.run.splats) == len(kept)
    boxes[-1].close()
    dock.undo.click()
    assert np.array_equal(before, window.screenshot()), "undo did not bring everything back"
    assert dock.steps.count() == 1 and dock.redo.isEnabled() and not dock.undo.isEnabled()
    dock.redo.click()
    assert len(window.run.splats) == len(kept)
    dock.reset.click()
    assert np.array_equal(before, window.screenshot()) and not dock.keep_support.isEnabled()

def drags_the_box(window, crop):
    # By the handle in the middle of its east side, in the 3D view.
    before, plotter = crop.box, window.view.plotter
    def spot(east):
        x, y = window.view.pixels_of(np.array([[east, *before.mean(axis=0)[1:]]]))[0]
        return QPoint(round(x), round(window.view.size_wh[1] - 1 - y))
    count = crop.count.text()
    QTest.mouseMove(plotter, spot(50))
    QTest.mousePress(plotter, Qt.MouseButton.LeftButton, pos=spot(50))
    for east in (45, 40, 35, 30):
        QTest.mouseMove(plotter, spot(east))
        QTest.qWait(20)
    QTest.mouseRelease(plotter, Qt.MouseButton.LeftButton, pos=spot(30))
    moved = crop.box - before
    # The mouse moves in the picture's plane: in perspective that is a little less along the axis.
    assert -26 < moved[1, 0] < -14, crop.box
    moved[1, 0] = 0
    assert np.abs(moved).max() < 0.02, "another side moved as well"
    assert crop.count.text() != count
    crop.save_inside(out / "dragged.ply")
    dragged = load_ply(out / "dragged.ply").means
    assert 20 < dragged[:, 0].max() <= crop.box[1, 0] + 1e-3

def themes(window):
    light = window.screenshot()
    window.set_theme("dark")
    dark = window.screenshot()
    assert dark.mean() < 0.6 * light.mean(), (dark.mean(), light.mean())
    for widget in (window.docks.cameras.table, window.layer_dock.tree, window.docks.photo.name):
        colors = widget.grab().toImage()
        assert colors.pixelColor(1 + colors.width() // 2, colors.height() - 3).lightness() < 90, "a panel stayed light"
    window.set_theme("light")
    assert np.array_equal(window.screenshot(), light), "light again gave another picture"

def navigation(window):
    view, start = window.view, window.view.pose
    plotter, left, right = view.plotter, Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton
    until(lambda: window.model.shown_is_full)
    middle, samples = plotter.rect().center(), []
    plotter.renderer.AddObserver("StartEvent", lambda *_: samples.append(plotter.render_window.GetMultiSamples()))
    def level():
        return abs(view.pose.rotation[0][2]) < 1e-9
    QTest.mousePress(plotter, left, pos=middle)
    QTest.mouseMove(plotter, middle + QPoint(60, -20))
    QTest.mouseRelease(plotter, left, pos=middle + QPoint(60, -20))
    orbited = view.pose
    assert np.linalg.norm(orbited.position - start.position) > 5 and level(), "nothing was orbited"
    until(lambda: window.model.shown_is_full and samples[-1] == 4)
    assert 0 in samples, "a moving view was drawn with all samples"
    QTest.mouseDClick(plotter, left, pos=middle)
    # A double click of QTest ends with the button down.
    QTest.mouseRelease(plotter, left, pos=middle)
    assert abs(view.pose.distance / orbited.distance - 0.5) < 0.3 and level(), "nothing came into focus"
    before, chosen = view.pose, window.docks.photo.at
    QTest.mousePress(plotter, right, pos=middle)
    QTest.keyPress(plotter, Qt.Key.Key_W)
    QTest.qWait(200)
    QTest.keyRelease(plotter, Qt.Key.Key_W)
    QTest.mouseRelease(plotter, right, pos=middle)
    flown = view.pose.position - before.position
    assert flown @ before.rotation[2] > 0.99 * np.linalg.norm(flown) > 0.1, "W did not fly forward"
    assert window.docks.photo.at == chosen, "the window took the key of a flight"
    window.bookmarks.keep(3)
    bookmarked = view.pose
    window._see_from("top")
    assert view.pose.rotation[2][2] < -0.999
    window.bookmarks.see(3)
    assert np.allclose(view.pose.position, bookmarked.position) and np.allclose(view.pose.rotation, bookmarked.rotation)
    assert "bookmarked: 3" in said_by(lambda: window.bookmarks.bookmarks.view(4)) and (window.subject.path / "views.json").exists()
    (window.subject.path / "views.json").write_text('{"schema": "radiant.views", "version": 1, "views": {"1": {"position": [0, 0]}}}')
    assert "holds no views" in said_by(window.bookmarks.bookmarks.load)
    view.set_pose(start)
    window.render_views()

def film_and_splats(window):
    fly, model = window.docks.fly, window.model
    window.attempt(fly.poses)
    window.findChildren(QMessageBox)[-1].close()
    fly.add_view()
    window.docks.seams.go(0)
    fly.add_view()
    kept = json.loads((window.subject.path / "flight.json").read_text())["keyframes"]
    assert np.allclose([row["position"] for row in kept], [pose.position for pose in fly.keyframes]) and len(kept) == 2
    fly.seconds.setValue(0.2)
    fly.write(out / "layers.gif", source="Layers alone", size_wh=(96, 64))
    until(lambda: fly.job is None)
    assert fly.note.text().startswith("Saved 6 frames"), fly.note.text()
    fly.write(out / "given_up.gif", size_wh=(96, 64))
    fly.stop()
    assert fly.job is None and not list(out.glob("*given_up*"))
    until(lambda: model.shown_is_full)
    window.view.plotter.camera.azimuth += 20
    QTest.qWait(20)
    until(lambda: model.shown_is_full, 5)
    # Drawn again where torch is loaded already.
    image = np.rint(255 * window.view.backdrop.picture[..., :3]).astype(np.uint8)
    camera = window.view.pose.camera(image.shape[1::-1])
    np.savez(out / "ours.npz", image=image, K=camera.Ks, cam_from_world=camera.cam_from_world)

def steps_of_splat_film(window):
    fly = window.docks.fly
    for stop in (0, 1):
        window.docks.seams.go(stop)
        fly.add_view()
    fly.seconds.setValue(0.2)
    fly.write(out / "splats.gif", source="As the 3D view", size_wh=(96, 64))
    until(lambda: fly.job is None)
    assert fly.note.text().startswith("Saved 6 frames"), fly.note.text()

def steps_of_splats_of_model(window):
    until(lambda: window.model.shown_is_full)

def live(window):
    global progress
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
    progress = RunProgress(stages=(done, StageState(stage="edges/e", state="done", seconds=2.0)), status="done", machines=machines)
    dock.read()
    assert dock.machines.isVisibleTo(dock) and dock.machines.text().splitlines() == list(machines)
    assert dock.table.rowCount() == 2 and "run ended (done)" in window.statusBar().currentMessage()
    window.save_screenshot(out / "shot.png")
    window.save_window_picture(out / "window.png")
    assert load_image(out / "window.png").shape == (800, 1280, 3)
    # A run that breaks while it is shown: what is shown stays.
    plan = run_folder / "plan.json"
    text = plan.read_bytes()
    plan.write_bytes(text[:100])
    window.reload()
    assert windows() == [window] and "plan.json" in window.statusBar().currentMessage()
    plan.write_bytes(text)
    window.reload()
    QTest.qWait(300)
    fresh, = windows()
    assert fresh is not window and fresh.screenshot().std() > 10
    # Closed in the middle of a film: no half of it stays.
    for _ in range(2):
        fresh.docks.fly.add_view()
    fresh.docks.fly.write(out / "closed.mp4", size_wh=(640, 360))
    fresh.close()
    assert not list(out.glob("*closed*"))

def steps_of_model(window):
    assert window.run is None and window.docks.cameras is None and window.docks.seams is None
    assert window.screenshot().std() > 5
    window.fly_to_selected()
    assert "No camera" in window.statusBar().currentMessage()
    window.docks.cleaning.box.active.setChecked(True)
    assert window.docks.cleaning.box.save_inside(out / "part.ply") > 0

def steps_of_begun_run(nothing):
    # There is no plan yet: what is at work is shown until there is one.
    assert nothing is None
    waiting = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, WaitingWindow))
    assert "no plan yet" in waiting.text.text() and waiting.progress.table.item(0, 0).text() == "sfm"
    (out / "plan.json").rename(run_folder / "plan.json")
    until(windows)
    window, = windows()
    QTest.qWait(100)
    assert not [other for other in QApplication.topLevelWidgets() if isinstance(other, WaitingWindow)]
    assert window.model is None and window.docks.seams is None
    assert "no model yet" in window.statusBar().currentMessage()
    window.docks.photo.show_worst()
    assert "No photograph has figures yet" in window.statusBar().currentMessage()
    window.select_camera("DJI_0009.JPG")
    window.set_theme("dark")
    assert window.docks.progress.table.item(0, 1).text() == "running"
    refused(window, lambda: window.docks.cleaning.box.save_inside(out / "none.ply"))
    # New results of the training appear by themselves, but not while the user measures.
    window.set_layer_visible("Borders", False)
    window.docks.fly.add_view()
    window.view.plotter.camera.azimuth += 25
    window.raise_dock(window.docks.fly)
    window.measure.set_active(True)
    pose, keyframes = window.view.pose, window.docks.fly.keyframes
    (out / "scene.ply").rename(run_folder / "scene.ply")
    QTest.qWait(1500)
    assert windows() == [window], "the window was replaced under a measurement"
    window.measure.set_active(False)
    until(lambda: windows() and windows() != [window])
    fresh, = windows()
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

for what, run_folder in tasks:
    run_folder = Path(run_folder)
    QTimer.singleShot(0, drive)
    code = inspector.open_window(run_folder, feeds if what != "begun" else begun_feeds)
    assert not failures, (what, failures)
    assert code == 0, (what, code)
"""


@contextmanager
def virtual_display(size: str) -> Iterator[str]:
    """A display of its own, "width x height x depth" large; skips where there is no Xvfb."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: apt-get install xvfb")
    read_end, write_end = os.pipe()
    command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", size, "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write_end], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        number = pipe.readline().strip()
    assert number, "Xvfb ended without naming its display"
    yield f":{number}"
    server.terminate()
    server.wait(10)


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    with virtual_display("1280x800x24") as name:
        yield name


def run_python(code: str | list[str], *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code, or a module named by `["-m", …]`, in a process with every warning as an error."""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    command = [sys.executable, "-W", "error", *(["-c", code] if isinstance(code, str) else code), *arguments]
    # A home of its own: windows remember their size there.
    with tempfile.TemporaryDirectory() as home:
        env = {name: value for name, value in os.environ.items() if name not in hidden} | {"XDG_CONFIG_HOME": home} | environment
        return subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)


def test_the_windows_of_a_run_of_one_at_work_and_of_a_ply_from_elsewhere(tmp_path: Path, display: str) -> None:
    """The one test of the real windows: three sessions under one X server, mostly imports."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town(step_levels=60))
    save_run(tmp_path / "begun", made_up_town())
    save_ply(tmp_path / "model.ply", made_up_town().splats)
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "begun/scene.ply").rename(out / "scene.ply")
    (tmp_path / "begun/plan.json").rename(out / "plan.json")
    (tmp_path / "begun/metrics.json").unlink()
    tasks = [f"run={tmp_path / 'run'}", f"begun={tmp_path / 'begun'}", f"model={tmp_path / 'model.ply'}"]
    result = run_python(DRIVER, str(out), *tasks, DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-4000:]
    written = ["cameras.csv", "dragged.ply", "inside.ply", "layers.gif", "ours.npz", "part.ply", "shot.png", "window.png"]
    assert sorted(path.name for path in out.iterdir()) == written
    assert (out / "shot.png").stat().st_size > 5000
    with Pictures.open(out / "layers.gif") as film:
        assert getattr(film, "n_frames", 1) == 6, "the film of the layers stands still"
    ours = np.load(out / "ours.npz")
    height, width = ours["image"].shape[:2]
    camera = Cameras(names=("view",), Ks=ours["K"], cam_from_world=ours["cam_from_world"], sizes_wh=np.array([[width, height]]))
    exact = next(render_views(load_ply(tmp_path / "run/scene.ply"), camera))
    over = 255 * (exact.image + 1 - exact.alpha[..., None])
    assert np.abs(ours["image"] - over).mean() < 1, "the splat view does not follow the 3D view"


def test_without_a_display_there_is_one_sentence_and_no_crash(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from radiant_viewer.window.inspector import open_window\n"
    code += "try: open_window(Path(sys.argv[1]))\nexcept ValueError as error: print(error); sys.exit(error.exit_code)"
    result = run_python(code, str(tmp_path))
    assert result.returncode == 2, result.stderr
    assert len(result.stdout.strip().splitlines()) == 1
    assert "DISPLAY" in result.stdout
    assert "--screenshot" in result.stdout


def test_without_the_extra_the_missing_package_and_the_way_out_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radiant_core.extras.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"PySide6.*install.*'radiant-splats\[desktop\]'.*--screenshot"):
        require_desktop()
