"""Measuring by clicks and the orthophoto behind the map, offscreen; what measures is a stand-in process of its own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.export.geotiff import TiledRaster, cut_tiles, save_tiles
from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.crs import parse_crs
from radiant_core.io.measures_file import load_measures
from radiant_core.survey.map_grid import MapGrid
from radiant_viewer.layers.drawing import has_same_structure
from radiant_viewer.layers.layer import LayerPicture
from radiant_viewer.layers.ortho_layer import ORTHO, ortho_layer
from radiant_viewer.layers.region_layer import region_layer
from radiant_viewer.pictures.offscreen import draw_map
from radiant_viewer.window.subject import load_subject
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python

SYSTEM, EPSG, CELL = "EPSG:32631", 32631, 0.5
ORIGIN = np.zeros(3)
RED_M = np.array([[30.0, 20.0, 0.0]])


def save_ortho(path: Path, *, epsg: int | None = EPSG) -> None:
    """Grey ground of 120 × 80 m about the origin, red within 5 m of `RED_M`."""
    crs = parse_crs(SYSTEM)
    middle = crs.from_geodetic(geodetic_from_enu(np.zeros((1, 3)), ORIGIN))[0]
    red = crs.from_geodetic(geodetic_from_enu(RED_M, ORIGIN))[0]
    grid = MapGrid(north_west=np.round(middle[:2]) + np.array([-60, 40]), cell=CELL, rows=160, columns=240, epsg=epsg)
    east, north = np.meshgrid(*grid.centers())
    image = np.full((*grid.shape, 5), (128, 128, 128, 255, 3), np.uint8)
    image[np.hypot(east - red[0], north - red[1]) < 5, :3] = (255, 0, 0)
    path.parent.mkdir(exist_ok=True)
    raster = TiledRaster(place=grid, shape=grid.shape, bands=("r", "g", "b", "a", "n"), tile_px=64, dtype=np.uint8, colors=True)
    save_tiles(path, raster, cut_tiles(image, 64))


def test_an_orthophoto_lies_where_it_belongs_under_the_regions(tmp_path: Path) -> None:
    town, run = made_up_town(), tmp_path / "run"
    save_run(run, town)
    assert load_subject(run).layers[0].name != "Orthophoto"
    save_ortho(run / ORTHO)
    subject = load_subject(run)
    assert subject.layers[0].name == "Orthophoto", "all other layers lie over it"
    drawing = draw_map([subject.layers[0]], size_wh=(600, 400))
    west, east, south, north = drawing.extent or (0, 0, 0, 0)
    rows, columns = np.nonzero(np.abs(drawing.image.astype(int) - (255, 0, 0)).max(axis=2) < 60)
    height, width = drawing.image.shape[:2]
    place = west + (columns.mean() + 0.5) / width * (east - west), north - (rows.mean() + 0.5) / height * (north - south)
    # A pixel of the picture is 0.2 m, one of the orthophoto 0.5 m.
    np.testing.assert_allclose(place, RED_M[0, :2], atol=0.3)
    ortho = subject.layers[0]
    assert ortho.picture is not None and has_same_structure(ortho, replace(ortho))
    darker = replace(ortho, picture=LayerPicture(image=ortho.picture.image // 2, corners=ortho.picture.corners))
    assert not has_same_structure(ortho, darker), "another picture is put on the graphics card anew"
    covered = draw_map([subject.layers[0], region_layer(town.cloud_plan, 0.0)], size_wh=(600, 400)).image
    assert np.abs(covered.astype(int) - drawing.image).max() > 20


def test_orthophotos_that_do_not_fit_are_named_and_the_run_is_shown(tmp_path: Path) -> None:
    town, run = made_up_town(), tmp_path / "run"
    save_run(run, town)
    save_ortho(run / ORTHO, epsg=None)
    with pytest.raises(BadInput, match="do not both have a place"):
        ortho_layer(run, town.scene.frame, 0.0)
    (run / ORTHO).write_bytes(b"none")
    subject = load_subject(run)
    assert "cannot be read as an orthophoto" in subject.summary and all(layer.picture is None for layer in subject.layers)


WORKER = """
import json, signal, sys
from pathlib import Path
run = Path(sys.argv[1])
def end(*_):
    (run / "tidied").touch()
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
path = run / "survey/measures.json"
for line in sys.stdin:
    request = json.loads(line)
    print("surface: 1 of 2", file=sys.stderr, flush=True)
    if "prepare" in request:
        print(json.dumps({"prepared": True}), flush=True)
        continue
    (run / "requests.jsonl").open("a").write(line)
    if "measure" not in request or request["name"] == "bad":
        print(json.dumps({"error": "it cannot be"}), flush=True)
        continue
    path.parent.mkdir(exist_ok=True)
    row = {"kind": request["measure"], "places": [[166021.4 + x, y, 0.5] for x, y, z in request["points"]],
           "figures": {"distance": {"value": 12.5, "sigma": 0.25, "unit": "m"}}, "filled": 0.5}
    kept = json.loads(path.read_text()) if path.is_file() else {}
    path.write_text(json.dumps({**kept, request["name"]: row}))
    print(json.dumps({"name": request["name"]}), flush=True)
end()
"""
ORTHO_MAKER = """
import shutil, sys, time
time.sleep(0.2)
shutil.copy(sys.argv[1], sys.argv[2])
"""
DOCK = """
import sys
from pathlib import Path
import numpy as np
from PySide6.QtGui import QAction
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QPushButton
from radiant_viewer.docks.survey_dock import SurveyDock
from radiant_viewer.host.one_tool import keep_one_on
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.run_feeds import SurveyCommands
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.dock_host import DockHost

class View:
    # Looks straight down from 50 m onto ground at 0, north up; 100 px high, 90 degrees wide.
    is_map, size_wh = False, (100, 100)
    pose = ViewPose(position=np.array([0.0, 0, 50]), focal_point=np.zeros(3), up=np.array([0.0, 1, 0]), angle_deg=90.0)
    def __init__(self):
        self.click_takers = []
    def depth_at(self, pixel, reach):
        return 50.0 if pixel[0] < 90 else None

class Map(View):
    is_map = True
    def ground_place(self, pixel):
        return np.array([float(pixel[0]), float(pixel[1])])

def until(done):
    for _ in range(600):
        if done():
            return
        QTest.qWait(50)
    raise AssertionError("nothing came")

application, run, folder = QApplication([]), Path(sys.argv[1]), Path(sys.argv[2])
window = DockHost()
window.map, window.view = Map(), View()
python = sys.executable
maker = (python, str(folder / "maker.py"), str(folder / "ortho.tif"))
commands = SurveyCommands(measuring=(python, str(folder / "worker.py"), str(run)), ortho=lambda out: (*maker, str(out)))
dock = SurveyDock(window, load_run_view(run), commands, 0.0, "m")
def click(canvas, pixel):
    return any(taker(canvas, pixel) for taker in canvas.click_takers)
assert not click(window.view, (75, 49)), "nobody asked for places yet"
dock.click.click()
assert click(window.view, (75, 49)) and click(window.view, (95, 49)) and "no model under" in window.said[-1]
window.attempt(dock.take)
assert click(window.map, (3, 4))
# From (25.5, -0.5) to (3, 4); of 60 m and 500 px of focal length a pixel is 0.12 m, and σ of a place half of it.
assert dock.text.text().startswith("distance on the map 22.95 ± 0.08 m"), dock.text.text()
assert window.layers_drawn["Measure at work"].labels[0].text in dock.text.text()
dock.name.setText("street")
dock.measure.click()
assert dock.is_busy
window.attempt(dock.take)
until(lambda: dock.table.rowCount() == 1)
print(dock.text.text())
assert len(dock.tool.points) == 0, dock.tool.points
assert window.layers_drawn["Measures"].labels[0].text == "street: 12.50 ± 0.25 m", window.layers_drawn["Measures"].labels[0].text
assert dock.name.text() == "" and window.layers_drawn["Measures"].labels[0].text == "street: 12.50 ± 0.25 m"
for pixel in ((10, 10), (20, 20), (30, 30)):
    click(window.view, pixel)
dock.tool.undo()
assert len(dock.tool.points) == 2 == len(dock.tool.eyes)
dock.kind.setCurrentText("volume")
window.attempt(dock.take)
click(window.view, (30, 10))
dock.base.setText("x")
window.attempt(dock.take)
dock.base.setText("1.5")
dock.name.setText("bad")
dock.measure.click()
until(lambda: dock.text.text() == "it cannot be")
assert len(dock.tool.points) == 3, "they can be mended"
dock.table.setCurrentCell(-1, -1)
window.attempt(dock.remove_chosen)
dock.click.click()
assert not dock.is_busy
dock.ortho.button.click()
until(lambda: window.said[-1].startswith("The orthophoto is"))
assert not window.reloads, "a measure at work would end: the window reads it when it may"
assert (run / "survey/ortho.tif").read_bytes() == (folder / "ortho.tif").read_bytes() and not (run / "survey/ortho_next.tif").exists()
(folder / "maker.py").write_text("import sys; sys.exit('no room')")
dock.ortho.button.click()
until(lambda: window.said[-1].startswith("No orthophoto"))
print(window.said[-1])
(folder / "maker.py").write_text("import pathlib, sys, time; out = pathlib.Path(sys.argv[2]); "
    "(out.parent / f'.{out.name}.1a.part').touch(); time.sleep(600)")
dock.ortho.button.click()
until(lambda: any((run / "survey").glob(".ortho_next*")))
dock.ortho.end()
assert not any((run / "survey").glob(".ortho_next*")), "what was begun is taken away"
(run / "survey/measures.json").write_text('{"a": {"kind": "area", "places": "x", "figures": {}}}')
dock.show_kept()
print(dock.text.text())
dock.end()
assert (run / "tidied").exists(), "it had no time to take away what it had begun to write"
action, button = QAction(), QPushButton()
for switch in (action, button):
    switch.setCheckable(True)
keep_one_on([action, dock.click, button])
for switch, others in ((action, (dock.click, button)), (dock.click, (action, button)), (button, (action, dock.click))):
    switch.setChecked(True)
    assert switch.isChecked() and not any(other.isChecked() for other in others), "two tools take the clicks"
    assert dock.tool.is_active == (switch is dock.click)
"""


def test_a_user_clicks_places_and_keeps_measures(tmp_path: Path) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    run = tmp_path / "run"
    save_run(run, made_up_town())
    for name, text in (("worker.py", WORKER), ("maker.py", ORTHO_MAKER)):
        (tmp_path / name).write_text(text)
    save_ortho(tmp_path / "ortho.tif")
    result = run_python(DOCK, str(run), str(tmp_path), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-2000:]
    too_few, busy, kept, volume, base, chosen, failed, broken = result.stdout.strip().splitlines()
    assert "distance takes 2 places or more, and 1 are clicked" in too_few and "being measured" in busy
    assert kept == "street: distance 12.500 ± 0.250 m (50 % filled)"
    assert "volume takes 3" in volume and "no height of a base" in base and "no measure is chosen" in chosen
    assert failed == "No orthophoto was made: no room" and "does not hold measures" in broken
    first, second = (json.loads(line) for line in (run / "requests.jsonl").read_text().splitlines())
    # Pixel 75 of 100 from 50 m, 90° wide: (75.5 − 50) m east; row 49 from below is 50 from above: 0.5 m south.
    np.testing.assert_allclose(first["points"][0], [25.5, -0.5, 0], atol=1e-9)
    assert first["points"][1] == [3, 4, None] and first["eyes"][0] == [0, 0, 50] and first["base"] is None
    assert second["base"] == 1.5 and len(second["points"]) == 3
    with pytest.raises(BadInput, match="does not hold measures"):
        load_measures(run)
