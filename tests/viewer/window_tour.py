"""What is done to the real window of a finished run, part by part (`window_driver.py`).

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QAction
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QDialogButtonBox, QMessageBox

from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.window.places_dialog import PlacesDialog
from tests.viewer.window_kit import patient


def until(done, seconds=30):
    for _ in range(round(20 * patient(seconds))):
        if done():
            return
        QTest.qWait(50)
    raise AssertionError(f"nothing came within {seconds} s")


def refused(wrong):
    try:
        wrong()
    except BadInput:
        return
    raise AssertionError("something wrong was accepted")


def said_by(wrong):
    try:
        wrong()
    except BadInput as error:
        return str(error)
    return "nothing"


def vermillion(image):
    return int((np.abs(image.astype(int) - VERMILLION).max(axis=2) < 8).sum())


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
    refused(lambda: window.set_layer_visible("none", True))


def cameras(window, out: Path):
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
    refused(lambda: window.select_camera("none.jpg"))
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
    assert dock.name.text() == "DJI_0000.JPG" and "PSNR\u00a020.00\u00a0dB" in dock.figures_text.text()

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


def tools(window, out: Path):
    window.reset_views()
    measure = next(action for action in window.findChildren(QAction) if action.text() == "Measure")
    survey, drawing = window.docks.survey, window.docks.cleaning
    measure.trigger()
    survey.kind.setCurrentText("area")
    for x, y in ((-60, -30), (60, -30), (60, 30)):
        pixel = window.map.pixels_of(np.array([[x, y, 0.0]]))[0]
        spot = QPoint(round(pixel[0]), round(window.map.size_wh[1] - 1 - pixel[1]))
        QTest.mouseClick(window.map.plotter, Qt.MouseButton.LeftButton, pos=spot)
    assert np.allclose(survey.tool.points[:, :2], [[-60, -30], [60, -30], [60, 30]], atol=2), survey.tool.points
    words = window.statusBar().currentMessage().split()
    assert words[0] == "area" and words[2] == "±" and abs(float(words[1]) - 3600) < 250, words
    # At 60 m with 500 px of focal length a pixel is 0.12 m, and a corner half of that.
    assert 2 < float(words[3]) < 15, words
    window.docks.undo_corner()
    words = window.statusBar().currentMessage()
    assert words.startswith("distance on the map 1") and abs(float(words.split()[4]) - 120) < 3, words
    measure.trigger()
    assert not survey.tool.is_active and not len(survey.tool.points)
    measure.trigger()
    drawing.draw.setChecked(True)
    assert drawing.polygon.is_active and not survey.tool.is_active and not measure.isChecked(), "two tools take the clicks"
    measure.trigger()
    assert survey.tool.is_active and not drawing.polygon.is_active and not drawing.draw.isChecked()
    drawing.select.lasso.click()
    assert drawing.select.is_active and not survey.tool.is_active, "two tools take the drags"
    window.docks.end_clicks()
    assert not drawing.select.is_active
    for switch in (drawing.draw, survey.click):
        switch.setChecked(True)
        window.docks.end_clicks()
        assert not (drawing.polygon.is_active or survey.tool.is_active or measure.isChecked()), "a tool still takes the clicks"
    before = window.screenshot()
    crop = window.docks.cleaning.box
    crop.active.setChecked(True)
    crop.set_box(np.array([[-50, -30, -5], [50, 30, 70.0]]))
    assert (before != window.screenshot()).any(axis=2).mean() > 0.02, "the crop box hid nothing"
    count = crop.save_inside(out / "inside.ply")
    inside = load_ply(out / "inside.ply").means
    assert len(inside) == count > 100 and (abs(inside) <= (50, 30, 70)).all()
    drags_the_box(window, crop, out)
    crop.set_box(np.full((2, 3), 1e4))
    refused(lambda: crop.save_inside(out / "nothing.ply"))
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


def drags_the_box(window, crop, out: Path):
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
    until(lambda: window.model.shown_is_full and samples[-1:] == [4])
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
    window.see_from("top")
    assert view.pose.rotation[2][2] < -0.999
    window.bookmarks.see(3)
    assert np.allclose(view.pose.position, bookmarked.position) and np.allclose(view.pose.rotation, bookmarked.rotation)
    assert "bookmarked: 3" in said_by(lambda: window.bookmarks.bookmarks.view(4)) and (window.subject.path / "views.json").exists()
    window.show_places()
    (dialog,) = [one for one in window.findChildren(PlacesDialog) if one.isVisible()]
    assert list(dialog.rows) == [3]
    dialog.rows[3][0].setText("The church")
    dialog.buttons.button(QDialogButtonBox.StandardButton.Save).click()
    assert window.bookmarks.bookmarks.load()[3].title == "The church"
    (window.subject.path / "views.json").write_text('{"schema": "radiant.views", "version": 1, "views": {"1": {"position": [0, 0]}}}')
    assert "holds no views" in said_by(window.bookmarks.bookmarks.load)
    view.set_pose(start)
    window.render_views()


def film_and_splats(window, out: Path):
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
