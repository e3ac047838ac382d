"""Ground control marked in photographs: what the dock keeps is what `--gcp` reads. Offscreen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import geodetic_from_enu
from radiant_core.georef.control_points import control_request, parse_control
from radiant_core.georef.crs import parse_crs
from radiant_core.io.run_store import write_json
from radiant_viewer.runs.control_session import ControlSession
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.made_up_run import Town, made_up_town, save_run
from tests.viewer.window_kit import run_python

PLACES_M = np.array([[-20.0, 5.0, 0.5], [30.0, -8.0, 0.5], [0.0, 30.0, 0.5], [5.0, -35.0, 0.5]])
NAMES = ("north-1", "north-2", "far", "near")
SYSTEM = "EPSG:32631"


def projected(town: Town, place_m: np.ndarray, photograph: str) -> np.ndarray:
    """Where a photograph shows a place, px of the stored one, which is twice as large as the camera's."""
    row = town.scene.cameras.names.index(photograph)
    local = town.scene.cameras.cam_from_world[row] @ [*place_m, 1.0]
    return 2 * (town.scene.cameras.Ks[row] @ local[:3])[:2] / local[2]


@pytest.fixture
def marked_town(tmp_path: Path) -> tuple[Path, Town]:
    """A run whose photographs are twice as large as its cameras, and a table of four points."""
    town, run, photographs = made_up_town(), tmp_path / "run", tmp_path / "photographs"
    save_run(run, town)
    photographs.mkdir()
    for name in town.scene.cameras.names:
        cv2.imwrite(str(photographs / name), np.full((960, 1280, 3), 90, np.uint8))
    write_json(run / "sfm/task.json", {"source": str(photographs)})
    places = parse_crs(SYSTEM).from_geodetic(geodetic_from_enu(PLACES_M, np.zeros(3)))
    lines = [f"{name},{','.join(repr(float(value)) for value in place)}" for name, place in zip(NAMES, places, strict=True)]
    (tmp_path / "points.csv").write_text("\n".join([SYSTEM, *lines]))
    return run, town


def test_photographs_that_should_see_a_point_come_first_with_its_place(marked_town: tuple[Path, Town]) -> None:
    run, town = marked_town
    session = ControlSession(load_run_view(run))
    session.open(run.parent / "points.csv")
    sights = session.sights("north-1")
    assert len(sights) == 24 and sights[0].mark is None
    for sight in (one for one in sights if one.guess is not None):
        np.testing.assert_allclose(
            np.array(sight.guess) * (1280, 960), projected(town, PLACES_M[0], sight.photograph), atol=1e-3
        )  # 0.1 mm of the map
    # 500 px from 60 m show 76.8 × 57.6 m: cameras stand 25.7 and 45 m apart.
    assert sum(one.guess is not None for one in sights) == 3
    np.testing.assert_allclose(session.places(), PLACES_M, atol=1e-3)


def test_marks_move_a_point_that_was_surveyed_wrongly(marked_town: tuple[Path, Town]) -> None:
    run, town = marked_town
    session = ControlSession(load_run_view(run))
    session.open(run.parent / "points.csv")
    there = PLACES_M[0] + [4.0, 3.0, 0.0]
    for sight in [one for one in session.sights("north-1") if one.guess is not None][:2]:
        column, row = projected(town, there, sight.photograph)
        session.mark("north-1", sight.photograph, (column, row))
    np.testing.assert_allclose(session.places()[0], there, atol=1e-6)
    # A photograph that is gone cannot say how large it was: the survey's place stands again.
    first = session.sights("north-1")[0].photograph
    (session.folder / first).unlink()
    np.testing.assert_allclose(ControlSession(load_run_view(run)).places()[0], PLACES_M[0], atol=1e-3)


def test_a_list_changed_elsewhere_is_gone_on_with(marked_town: tuple[Path, Town]) -> None:
    run, town = marked_town
    first, second = town.scene.cameras.names[:2]
    session = ControlSession(load_run_view(run))
    session.open(run.parent / "points.csv")
    other = ControlSession(load_run_view(run))
    other.mark("far", first, (100.0, 200.0))
    session.mark("near", second, (10.0, 20.0))
    assert session.list is not None and set(session.list.marks) == {("far", first), ("near", second)}
    again = ControlSession(load_run_view(run)).list
    assert again is not None and again.marks == session.list.marks
    # What cannot be read is not written over.
    session.path.write_text("EPSG:32631\nnone of it\n")
    with pytest.raises(BadInput, match="line 2"):
        session.mark("near", first, (1.0, 2.0))
    assert session.path.read_text() == "EPSG:32631\nnone of it\n"
    # Moved away, as the window says, other points can be opened.
    session.path.unlink()
    with pytest.raises(BadInput, match="no points are listed yet"):
        session.mark("near", first, (1.0, 2.0))
    session.open(run.parent / "points.csv")
    assert session.list is not None and not session.list.marks


def test_runs_without_their_photographs_say_why(marked_town: tuple[Path, Town]) -> None:
    run, _ = marked_town
    (run.parent / "photographs").rename(run.parent / "moved")
    with pytest.raises(BadInput, match="not there any more"):
        ControlSession(load_run_view(run))
    (run / "sfm/task.json").unlink()
    with pytest.raises(BadInput, match="not made by structure from motion"):
        ControlSession(load_run_view(run))


DOCK = """
import sys
from pathlib import Path
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QInputDialog
from radiant_viewer.docks.control_dock import ControlDock
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.dock_host import DockHost

application, run = QApplication([]), Path(sys.argv[1])
window = DockHost()
dock = ControlDock(window, load_run_view(run))
window.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
window.resize(500, 800)
window.show()
dock.picture.picked.emit(5, 5)
asked = []
QInputDialog.getText = staticmethod(lambda _, title, text: asked.append(text) or ("", False))
dock.add.click()
assert len(asked) == 1, "who gives no system is not asked for a point"
dock.open_points(run.parent / "points.csv")
assert dock.points.count() == 4 and dock.text.text().startswith("0 marks"), dock.text.text()
for point in ("north-1", "north-2", "far", "near"):
    dock.choose(point)
    sights = [one for one in dock.session.sights(point) if one.guess is not None]
    for sight in sights[:2]:
        dock.choose(point, sight.photograph)
        picture = dock.picture
        # The guess is in the middle of what is shown, at twice its size: click there.
        assert abs(picture.zoom - 2) < 1e-9
        QTest.mouseClick(picture, Qt.MouseButton.LeftButton, pos=picture.rect().center())
        assert dock.session.list.marks_of(point)[sight.photograph], "the click marked nothing"
        assert dock.photograph == sight.photograph and dock.unmark.isEnabled()
dock.choose("near")
dock.check.click()
assert dock.session.list.point("near").is_check and "(check)" in dock.points.currentText()
first = dock.session.sights("far")[0].photograph
dock.choose("far", first)
dock.unmark.click()
assert first not in dock.session.list.marks_of("far")
QTest.mouseClick(dock.picture, Qt.MouseButton.LeftButton, pos=dock.picture.rect().center())
print(dock.text.text())
assert len(window.layers_drawn["Ground control"].labels) == 4
dock.add_point("EPSG:32631", "extra 166021 10 0")
window.attempt(lambda: dock.add_point("EPSG:32631", "extra 166021 20 0"))
window.attempt(lambda: dock.add_point("EPSG:32631", "nowhere 1 2 3"))
window.attempt(lambda: dock.add_point("EPSG:32631", "extra 1 2"))
window.attempt(lambda: dock.open_points(run.parent / "points.csv"))
dock.grab().save(sys.argv[2])
again = ControlDock(window, load_run_view(run))
assert again.points.count() == 5 and again.session.list.marks == dock.session.list.marks
"""


def test_a_user_marks_points_in_photographs(marked_town: tuple[Path, Town]) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    run, town = marked_town
    result = run_python(DOCK, str(run), str(run.parent / "dock.png"), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-2000:]
    first, summary, *refusals = result.stdout.strip().splitlines()
    assert "no point and photograph are chosen" in first
    assert summary.startswith("8 marks; 3 control and 1 check points are marked twice or more. They are in gcp_list.txt")
    said = ("already", "no UTM zone has", "is no point", "marks already")
    assert len(refusals) == 4 and all(part in refusal for part, refusal in zip(said, refusals, strict=True))
    control = parse_control(control_request(run / "gcp_list.txt", None, None))
    # The point without a mark is not among them.
    assert control.names == NAMES and control.is_check.tolist() == [False, False, False, True]
    for point, photograph, pixel in zip(control.mark_points, control.mark_images, control.mark_pixels, strict=True):
        # A pixel of the screen is half of one of the photograph, and a widget's middle is between two.
        np.testing.assert_allclose(pixel, projected(town, PLACES_M[point], photograph), atol=1.0)
