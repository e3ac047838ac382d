"""Lasso and brush over a view that stands in for the real one, offscreen: what is chosen is what lies there and is seen."""

from __future__ import annotations

import pytest

from tests.viewer.window_kit import run_python

TOOL = """
import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
from radiant_viewer.host.select_tool import SelectTool
from radiant_viewer.pictures.view_pose import ViewPose

class Backdrop:
    # The floor is 50 m away; over the right half a roof is seen 40 m away.
    picture = np.full((100, 100, 4), 50.0, np.float32)

Backdrop.picture[:, 50:, 3] = 40.0

class View:
    # Straight down from 50 m, north up; 100 px high and wide, 90 degrees: a pixel is 1 m of the floor.
    size_wh, backdrop = (100, 100), Backdrop()
    pose = ViewPose(position=np.array([0.0, 0, 50]), focal_point=np.zeros(3), up=np.array([0.0, 1, 0]), angle_deg=90.0)

application = QApplication([])
view = View()
view.plotter = QWidget()
view.plotter.resize(100, 100)
view.plotter.show()
floor = np.array([(x, y, 0.0) for x in range(-45, 46, 2) for y in range(-45, 46, 2)], np.float32)
roof = floor * (0.8, 0.8, 1) + (0, 0, 10)
means = np.concatenate([floor, roof[roof[:, 0] > 0]]).astype(np.float32)
on_floor = np.arange(len(means)) < len(floor)
tool = SelectTool(view, lambda: means)
heard = []
tool.changed.connect(lambda: heard.append(int(tool.chosen.sum())))

def pixels(places):
    depth = 50 - places[:, 2]
    return np.column_stack([50 + 50 * places[:, 0] / depth, 50 - 50 * places[:, 1] / depth])

def drag(path, keys=Qt.KeyboardModifier.NoModifier):
    QTest.mousePress(view.plotter, Qt.MouseButton.LeftButton, keys, QPoint(*path[0]))
    for place in path[1:]:
        QTest.mouseMove(view.plotter, QPoint(*place))
    QTest.mouseRelease(view.plotter, Qt.MouseButton.LeftButton, keys, QPoint(*path[-1]))

drag([(20, 20), (80, 20), (80, 80), (20, 80)])
assert not heard, "nobody asked for a lasso"
tool.set_mode("lasso")
drag([(20, 20), (80, 20), (80, 80), (20, 80)])
at = pixels(means)
inside = ((at > 20) & (at < 80)).all(axis=1)
seen = ~on_floor | (at[:, 0] < 50)
rim = (np.abs(at - 20) < 0.01).any(axis=1) | (np.abs(at - 80) < 0.01).any(axis=1) | (np.abs(at[:, 0] - 50) < 1)
assert (tool.chosen == (inside & seen))[~rim].all(), "the floor below the roof is not seen"
assert 200 < tool.chosen.sum() < inside.sum()
first = tool.chosen.copy()
tool.set_mode("brush")
tool.radius_px = 10
drag([(30, 30), (70, 30)], Qt.KeyboardModifier.ControlModifier)
at_path = np.hypot(np.maximum(np.maximum(30 - at[:, 0], at[:, 0] - 70), 0), at[:, 1] - 30)
assert not tool.chosen[(at_path < 9.9) & seen & ~rim].any() and (tool.chosen == first)[at_path > 10.1].all()
tool.undo()
assert (tool.chosen == first).all()
tool.redo()
assert heard[-1] == tool.chosen.sum() < first.sum() and len(tool.strokes) == 2
tool.clear()
tool.is_through = True
drag([(60, 60)])
assert len(tool.strokes) == 1 and tool.strokes[0].front is None
disc = np.hypot(*(at - 60).T) < 9.9
assert tool.chosen[disc].all() and on_floor[tool.chosen].any() and (~on_floor[tool.chosen]).any(), "not through"
tool.set_mode("lasso")
drag([(10, 10), (12, 12)])
assert len(tool.strokes) == 1, "a line is no area"
tool.set_mode("")
drag([(20, 20), (80, 20), (80, 80)])
assert len(tool.strokes) == 1
print("ok", int(first.sum()))
"""


def test_lasso_and_brush_choose_what_is_seen_there() -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    result = run_python(TOOL, QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-3000:]
    assert result.stdout.startswith("ok")
