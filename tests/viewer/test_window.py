"""The real window under a real X server, in a process of its own: shows a run, hides a layer, marks a camera, saves a picture."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from radiant_core.errors import BadInput
from radiant_viewer.desktop import require_desktop
from tests.viewer.made_up_run import made_up_town, save_run

DRIVER = """
import sys
from pathlib import Path
import numpy as np
from PySide6.QtCore import QTimer, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QTableView
from radiant_core.errors import BadInput
from radiant_viewer import inspector
from radiant_viewer.window import InspectorWindow

run_folder, out = Path(sys.argv[1]), Path(sys.argv[2])
failures = []

def drive():
    try:
        steps(next(widget for widget in QApplication.topLevelWidgets() if isinstance(widget, InspectorWindow)))
    except BaseException as error:
        failures.append(repr(error))
    finally:
        QApplication.closeAllWindows()

def steps(window):
    QTest.qWait(300)
    before = window.screenshot()
    assert before.std() > 10, "the views are empty"
    window.set_layer_visible("Regions", False)
    without = window.screenshot()
    assert (before != without).any(axis=2).mean() > 0.005, "hiding the regions changed nothing"
    window.set_layer_visible("Regions", True)
    assert np.array_equal(before, window.screenshot()), "showing the regions again gave another picture"
    window.select_camera("DJI_0009.JPG")
    marked = window.screenshot()
    vermillion = lambda image: (np.abs(image.astype(int) - (213, 94, 0)).max(axis=2) < 8).sum()
    assert vermillion(marked) > vermillion(before) + 50, "the selected camera is not marked"
    assert "DJI_0009.JPG" in window.statusBar().currentMessage()
    window.select_camera("DJI_0010.JPG")
    assert abs(int(vermillion(window.screenshot())) - int(vermillion(marked))) < 0.5 * vermillion(marked), "an old mark stayed"
    window.table.sortByColumn(4, Qt.SortOrder.DescendingOrder)
    first = window.sorted_cameras.index(0, 0).data()
    assert first == "DJI_0016.JPG", f"the best photograph is {first}"
    for wrong in (lambda: window.select_camera("none.jpg"), lambda: window.set_layer_visible("none", True)):
        try:
            wrong()
            failures.append("an unknown name was accepted")
        except BadInput:
            pass
    window.save_screenshot(out)

QTimer.singleShot(0, drive)
code = inspector.open_window(run_folder)
assert not failures, failures
sys.exit(code)
"""


@pytest.fixture
def display() -> Iterator[str]:
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: apt-get install xvfb")
    read_end, write_end = os.pipe()
    command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write_end], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        number = pipe.readline().strip()
    assert number, "Xvfb ended without naming its display"
    yield f":{number}"
    server.terminate()
    server.wait(10)


def run_python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    env = {name: value for name, value in os.environ.items() if name not in hidden} | environment
    command = [sys.executable, "-W", "error", "-c", code, *arguments]
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=120, check=False)


def test_the_window_shows_hides_marks_and_saves(tmp_path: Path, display: str) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town())
    result = run_python(DRIVER, str(tmp_path / "run"), str(tmp_path / "shot.png"), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "shot.png").stat().st_size > 5000


def test_without_a_display_there_is_one_sentence_and_no_crash(tmp_path: Path) -> None:
    code = "import sys; from pathlib import Path; from radiant_viewer.inspector import open_window\n"
    code += "try: open_window(Path(sys.argv[1]))\nexcept ValueError as error: print(error); sys.exit(error.exit_code)"
    result = run_python(code, str(tmp_path))
    assert result.returncode == 2, result.stderr
    assert len(result.stdout.strip().splitlines()) == 1
    assert "DISPLAY" in result.stdout
    assert "--screenshot" in result.stdout


def test_without_the_extra_the_missing_package_and_the_way_out_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"PySide6.*'desktop'.*--screenshot"):
        require_desktop()
