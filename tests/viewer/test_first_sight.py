"""What a window shows at once: its size, the place under the mouse, its keys, the words on hover."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python, virtual_display

DRIVER = """
import json, sys
from pathlib import Path
from PySide6.QtCore import QPoint, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMessageBox
from radiant_viewer.window.inspector import open_window
from radiant_viewer.window.shortcuts import show_shortcuts
from radiant_viewer.window.window import InspectorWindow

run, resized, picture = Path(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3]
seen, failures = {}, []

def drive():
    try:
        window = next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow))
        QTest.qWait(500)
        seen["size"] = [window.width(), window.height()]
        view = window.map.plotter
        middle = QPoint(view.width() // 2, view.height() // 2)
        for offset in (0, 20):
            QTest.mouseMove(view, middle + QPoint(offset, offset))
            QTest.qWait(100)
            seen[f"place {offset}"] = window.place.label.text()
        show_shortcuts(window, window.shortcuts)
        boxes = [widget for widget in QApplication.topLevelWidgets() if isinstance(widget, QMessageBox)]
        seen["keys"] = boxes[0].text()
        boxes[0].close()
        if window.planning is not None:
            seen["headline"] = window.planning.dock.headline.toolTip()
        model = window.docks.cameras.sorted_cameras
        seen["names"] = [model.index(row, 0).data() for row in range(model.rowCount())]
        tree = window.layer_dock
        window.select_index(0)
        tree.set_solo("Borders")
        seen["marks in solo"] = window._marks.visible_names
        window.select_index(1)
        seen["selected in solo"] = window._marks.visible_names
        grey = [name for name, item in tree._items.items() if item.foreground(0).style().value]
        seen["grey in solo"] = len(grey) == len(tree._items) - 1 and "Borders" not in grey
        tree.set_solo(None)
        seen["marks afterwards"] = window._marks.visible_names
        seen["grey afterwards"] = any(item.foreground(0).style().value for item in tree._items.values())
        window.save_window_picture(Path(picture))
        if resized:
            window.resize(*resized)
            QTest.qWait(200)
    except BaseException as error:
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

QTimer.singleShot(0, drive)
code = open_window(run)
assert not failures, failures
print(json.dumps(seen))
"""


def test_a_window_fills_the_screen_and_comes_back_as_it_was_left(tmp_path: Path) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town())
    seen = []
    with virtual_display("1600x900x24") as display:
        for resized in ([1000, 700], []):
            arguments = (str(tmp_path / "run"), json.dumps(resized), str(tmp_path / "window.png"))
            result = run_python(DRIVER, *arguments, DISPLAY=display, QT_QPA_PLATFORM="xcb", XDG_CONFIG_HOME=str(tmp_path / "home"))
            assert result.returncode == 0, result.stderr[-3000:]
            seen.append(json.loads(result.stdout.splitlines()[-1]))
    first, second = seen
    assert first["size"] == [1600, 900] and second["size"] == [1000, 700]
    assert first["place 0"] != first["place 20"] and "(EPSG:" in first["place 0"]
    assert "Wheel" in first["keys"] and "Ctrl+G" in first["keys"]
    assert first["headline"].startswith("makespan: ") and "\nbound: " in first["headline"]
    # What is selected meanwhile is shown.
    assert first["marks in solo"] == [] and first["selected in solo"] == first["marks afterwards"] == ["Selected camera"]
    assert first["grey in solo"] and not first["grey afterwards"]
    assert len(first["names"]) > 10
