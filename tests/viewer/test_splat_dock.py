"""The splat view comes to rest with a full picture, and then requests nothing more."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radiant_core.io.ply import save_ply
from tests.viewer.made_up_run import made_up_town
from tests.viewer.test_window import run_python

DOCK = """
import json, sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMainWindow, QWidget
from radiant_core.decisions import Decision
from radiant_core.io.ply import load_ply
from radiant_viewer.docks.splat_dock import SplatDock
from radiant_viewer.splats.splat_process import SplatProcess
from radiant_viewer.layers.themes import LIGHT, style_sheet
from radiant_viewer.pictures.view_pose import ViewPose

# A renderer that answers at once: the requests matter here, and the length of the note.
class Renderer(SplatProcess):
    def __init__(self, parent, kind, ply_path):
        from PySide6.QtCore import QObject
        QObject.__init__(self, parent)
        self.kind, self.is_ready, self.is_busy = kind, True, False
    def ask(self, request, camera, background, box):
        from PySide6.QtCore import QTimer
        from radiant_viewer.splats.splat_process import Frame
        self.is_busy = True
        width, height = camera.sizes_wh[0].tolist()
        asked.append((width, height))
        def answer():
            self.is_busy = False
            self.drawn.emit(Frame(request=request, image=np.zeros((height, width, 3), np.uint8), seconds=0.008 * (1 + len(asked) % 2)))
        QTimer.singleShot(5, answer)
    def end(self):
        pass

import radiant_viewer.docks.splat_dock as module
module.SplatProcess = Renderer

class Window(QMainWindow):
    pose = ViewPose(position=np.array([0.0, -200, 150]), focal_point=np.zeros(3), up=np.array([0.0, 0, 1]), angle_deg=30.0)
    view, theme, crop_box = SimpleNamespace(pose=pose), LIGHT, None

asked, found = [], []
application = QApplication([])
application.setStyle("Fusion")
window = Window()
window.setStyleSheet(style_sheet(LIGHT))
window.setCentralWidget(QWidget())
dock = SplatDock(window, load_ply(Path(sys.argv[1])))
window.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
dock._seconds = {"own": 0.018, "open3d": 1.208}
dock.decision = Decision(stage="inspector", topic="splat renderer", choice="Own renderer", figure=18.0, unit="ms", reason="it is faster")
window.show()
for width in (200, 260, 337):
    window.resize(800, 500 + width % 7)
    window.resizeDocks([dock], [width], Qt.Orientation.Horizontal)
    QTest.qWait(600)
    before = len(asked)
    QTest.qWait(350)
    found.append([dock.width(), dock.shown_is_full, len(asked) - before, dock.picture.height()])
dock.end()
print(json.dumps(found))
"""


def test_the_dock_rests_with_a_full_picture_at_every_width(tmp_path: Path) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    save_ply(tmp_path / "model.ply", made_up_town().splats)
    result = run_python(DOCK, str(tmp_path / "model.ply"), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-3000:]
    rests = json.loads(result.stdout)
    assert len({width for width, *_ in rests}) == 3, "the dock was not resized"
    assert [(width, full, asked) for width, full, asked, _ in rests] == [(width, True, 0) for width, *_ in rests]
