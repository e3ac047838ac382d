"""The real window changes a plan: borders dragged, undone by keys, cameras pinned, closed early."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.plan.borders.borders import shared_borders
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_viewer.editing.model.plan_edits import FixWeight, MoveEdge, PinCameras
from radiant_viewer.editing.solver.plan_editor import PlanEditor
from radiant_viewer.editing.store.plan_files import plan_subject
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.test_plan_editor import editor_of
from tests.viewer.window_kit import run_python

DRIVER = """
import sys, time
from pathlib import Path
import numpy as np
from PySide6.QtCore import QPoint, QTimer, Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from radiant_app.commands.inspect.window import run_setting
from radiant_core.plan.borders.borders import shared_borders
from radiant_viewer.editing.solver import plan_session
from radiant_viewer.editing.model.plan_edits import FixWeight, MoveEdge
from radiant_viewer.window.inspector import open_window
from radiant_viewer.window.window import InspectorWindow

run, out = Path(sys.argv[1]), Path(sys.argv[2])
failures = []

def drive():
    try:
        steps(next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow)))
    except BaseException as error:
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

def until(condition, what):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, what
        QTest.qWait(20)

def press(window, keys):
    # Through the shortcut itself: without a window manager Qt sends no keys to a window.
    next(short for short in window.findChildren(QShortcut) if short.key() == QKeySequence(keys)).activated.emit()

def steps(window):
    QTest.qWait(200)
    planning, session = window.planning, window.planning.session
    editor, view = session.editor, window.map.plotter
    planning.set_active(True)
    # Beside the docks of a small window the map is too narrow to tell one border from the next.
    window.splitter.setSizes([3, 1])
    QTest.qWait(300)
    first = editor.state.cloud

    def pixel(place):
        camera = view.camera
        offset = (place - window.map.origin[:2] - np.array(camera.focal_point[:2])) * view.height() / (2 * camera.parallel_scale)
        return QPoint(round(view.width() / 2 + offset[0]), round(view.height() / 2 - offset[1]))

    border = next(one for one in shared_borders(first) if (one.first, one.second) == (0, 1))
    grabbed = border.ends.mean(axis=0) + 0.5 * border.toward_first
    start, stop = pixel(grabbed), pixel(grabbed - 25 * border.toward_first)
    before = window.screenshot()
    previews = []
    session.previewed.connect(lambda plan: previews.append(plan))
    QTest.mousePress(view, Qt.MouseButton.LeftButton, pos=start)
    assert planning.tools.is_dragging, "the border was not grabbed"
    for share in (0.3, 0.6, 1.0):
        count = len(previews)
        QTest.mouseMove(view, start + (stop - start) * share)
        until(lambda: len(previews) > count, "no frame of the drag came")
    assert editor.edits == () and previews[-1].cloud.counts[0] > first.counts[0], "the drag shows nothing, or is an edit already"
    QTest.mouseRelease(view, Qt.MouseButton.LeftButton, pos=stop)
    until(lambda: editor.edits and not session.is_busy, "the dragged border never became an edit")
    assert isinstance(editor.edits[0], FixWeight) and editor.edits[0].edge == "north"
    assert editor.state.cloud.counts[0] > first.counts[0], "north did not grow"
    assert "× bound" in planning.dock.headline.text() and "→ north" in planning.dock.changes.text()
    rows = {row[0]: row[1] for row in window.docks.cameras.cameras.rows}
    owners = dict(zip(editor.subject.names, np.array(editor.state.cloud.edge_ids)[editor.state.cloud.edge_of_camera]))
    assert rows == owners, "the table of cameras shows another plan"
    changed = window.screenshot()
    assert (before != changed).any(axis=2).mean() > 0.003, "the views show the old plan"
    press(window, "Ctrl+Z")
    assert editor.state.cloud is first and np.array_equal(window.run.cloud_plan.weights, first.weights), "undo is not exact"
    press(window, "Ctrl+Shift+Z")
    assert editor.state.cloud.counts[0] > first.counts[0], "redo did nothing"

    low, high = pixel(np.array([-95.0, -50.0])), pixel(np.array([-35.0, 50.0]))
    QTest.mousePress(view, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ShiftModifier, low)
    QTest.mouseMove(view, high)
    QTest.mouseRelease(view, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.ShiftModifier, high)
    assert len(planning.actions.selected) == 9, f"{len(planning.actions.selected)} cameras lie in the box"
    planning.dock.target.setCurrentText("quarry")
    planning.dock.buttons["Pin to"].click()
    until(lambda: len(editor.edits) == 2 and not session.is_busy, "the pins never came")
    held = [editor.state.cloud.edge_of_camera[editor.subject.names.index(name)] for name in planning.actions.selected]
    assert (np.array(editor.state.cloud.edge_ids)[held] == "quarry").all()
    planning.actions.select_filtered("region = quarry and height > 1")
    assert len(planning.actions.selected) >= 9
    planning.actions.set_slack(1.2)
    until(lambda: not session.is_busy, "slack hangs")
    assert "slack is for a plan in which nothing is fixed" in planning.dock.changes.text() and len(editor.edits) == 2
    planning.actions.save(out / "edited.json")
    assert planning.actions.compare(out / "edited.json").new_edge.sum() == 0
    window.save_screenshot(out / "shot.png")

    solve = plan_session.apply_edit
    plan_session.apply_edit = lambda *args, **kwargs: (time.sleep(0.8), solve(*args, **kwargs))[1]
    session.edit(MoveEdge(edge="harbour", position=(60.0, 20.0)))
    session.edit(MoveEdge(edge="north", position=(-50.0, 0.0)))
    assert session.is_busy and len(editor.edits) == 2

QTimer.singleShot(0, drive)
code = open_window(run, setting=lambda: run_setting(run))
assert not failures, failures
sys.exit(code)
"""


def test_the_window_drags_pins_undoes_saves_and_loses_nothing(
    tmp_path: Path,
    display: str,
) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    from radiant_app.commands.inspect.window import run_setting

    save_run(tmp_path / "run", made_up_town())
    lines = [
        f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2))
        for edge in ("north", "harbour", "quarry")
    ]
    (tmp_path / "run" / "system.toml").write_text("".join(lines))
    result = run_python(DRIVER, str(tmp_path / "run"), str(tmp_path), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "shot.png").stat().st_size > 5000
    # Closed while two edits were on the way: all four are there at the next opening.
    run, setting = load_run_view(tmp_path / "run"), run_setting(tmp_path / "run")
    assert setting.system is not None
    editor = PlanEditor(plan_subject(run), setting.system, (run.cloud_plan, run.edge_plans), setting.edits_path)
    assert editor.restore() == ()
    assert [type(edit) for edit in editor.edits] == [FixWeight, PinCameras, MoveEdge, MoveEdge]
    assert editor.state.cloud.sites[1].tolist() == [60.0, 20.0]


def test_a_press_finds_edges_then_borders_and_never_a_locked_rim() -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    from radiant_viewer.editing.tools.map_tools import BorderGrip, EdgeGrip, grip_at

    cloud = editor_of(num_edges=4).state.cloud
    borders = shared_borders(cloud)
    border = borders[0]
    first, second = cloud.edge_ids[border.first], cloud.edge_ids[border.second]
    middle = border.ends.mean(axis=0)

    def grip(place: np.ndarray, **constraints: object) -> EdgeGrip | BorderGrip | None:
        wishes = PlanConstraints(**constraints)  # type: ignore[arg-type]
        return grip_at(place, cloud, wishes, borders, 0.5)

    site = grip(cloud.sites[2] + [3.0, 2.0])
    assert isinstance(site, EdgeGrip) and site.edge == cloud.edge_ids[2]
    moved = site.edit(np.array([10.0, 20.0]), cloud)
    assert isinstance(moved, MoveEdge) and np.allclose(moved.position, (7.0, 18.0))
    assert grip(cloud.sites[2] + [12.0, 0.0]) is None
    for side, edge in ((1, first), (-1, second)):
        found = grip(middle + side * border.toward_first)
        assert isinstance(found, BorderGrip) and found.edge == edge
        pushed = found.edit(found.place + 10 * found.outward, cloud)
        pulled = found.edit(found.place - 10 * found.outward, cloud)
        assert isinstance(pushed, FixWeight) and isinstance(pulled, FixWeight)
        own = cloud.weights[cloud.edge_ids.index(edge)]
        assert pushed.weight_m2 > own > pulled.weight_m2
        assert pushed.weight_m2 - own == pytest.approx(own - pulled.weight_m2)
    locked = grip(middle + border.toward_first, locked=(first,))
    assert isinstance(locked, BorderGrip) and locked.edge == second
    dragged = grip(middle - border.toward_first, fixed_weights_m2={first: 0.0})
    assert isinstance(dragged, BorderGrip) and dragged.edge == first
