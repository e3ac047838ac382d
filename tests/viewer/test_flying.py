"""A flight of the 3D view slows down before what is ahead, stays over the ground, and one key leads back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from radiant_viewer.runs.ground_map import GroundMap
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python, virtual_display

SESSION = """
import json, sys
from pathlib import Path
import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from radiant_viewer.pictures.view_pose import ViewPose
from tests.viewer.window_user import until, use_window

seen = {}

def act(window):
    view, plotter, right = window.view, window.view.plotter, Qt.MouseButton.RightButton
    middle = plotter.rect().center()
    until(lambda: window.model.shown_is_full, "never sharp")

    def fly(name, key, seconds, height, down):
        view.set_pose(ViewPose(position=np.array([0.0, 0, height]), focal_point=np.array([0.0, 1, height - down]),
                               up=np.array([0.0, 0, 1]), angle_deg=40.0))
        until(lambda: window.model.shown_is_full, "never sharp")
        QTest.qWait(900)
        plotter.setFocus()
        QTest.mouseMove(plotter, middle)
        QTest.qWait(50)
        start, lowest = view.pose.position, [height]
        plotter.renderer.AddObserver("StartEvent", lambda *_: lowest.append(float(view.pose.position[2])))
        QTest.mousePress(plotter, right, pos=middle)
        QTest.keyPress(plotter, key)
        QTest.qWait(int(1000 * seconds))
        QTest.keyRelease(plotter, key)
        QTest.mouseRelease(plotter, right, pos=middle)
        lowest.append(float(view.pose.position[2]))
        seen[name] = {"flown": float(np.linalg.norm(view.pose.position - start)), "lowest": min(lowest)}
        QTest.keySequence(window, QKeySequence("V"))
        seen[name]["back"] = float(np.linalg.norm(view.pose.position - start))

    fly("far", Qt.Key.Key_W, 0.6, 60.0, 2.0)
    fly("near", Qt.Key.Key_W, 0.6, 12.0, 2.0)
    fly("into the ground", Qt.Key.Key_W, 4.0, 8.0, 0.6)
    fly("sunk", Qt.Key.Key_Q, 2.5, 3.0, 0.6)

use_window(Path(sys.argv[1]), act)
print(json.dumps(seen))
"""


def test_a_flight_goes_by_the_distance_stays_over_the_ground_and_a_key_leads_back(tmp_path: Path) -> None:
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(tmp_path / "run", made_up_town())
    with virtual_display("1280x800x24") as display:
        result = run_python(SESSION, str(tmp_path / "run"), DISPLAY=display, QT_QPA_PLATFORM="xcb")
    assert result.returncode == 0, result.stderr[-3000:]
    seen = json.loads(result.stdout.splitlines()[-1])
    # Five times as far away, some five times as fast; frames of a busy machine come late.
    assert 0.5 < seen["near"]["flown"] < 8 and 2 < seen["far"]["flown"] / seen["near"]["flown"] < 12, seen
    # Before this a flight of four seconds ended far below the ground, whose points lie between 0 and 1 m.
    assert seen["into the ground"]["lowest"] > 0, seen
    assert seen["sunk"]["lowest"] < seen["into the ground"]["lowest"], "Q does not sink"
    assert all(flight["back"] < 1e-6 for flight in seen.values()), seen


def test_the_ground_under_a_place_is_that_of_low_points_and_of_the_nearest_that_are_known() -> None:
    rng = np.random.default_rng(5)
    flat = rng.uniform(-50, 50, (20_000, 2))
    slope = np.column_stack([flat, 0.1 * flat[:, 0]])
    roofs = slope[::4] + np.array([0, 0, 8])
    ground = GroundMap.of(np.concatenate([slope, roofs]))
    assert ground is not None
    for east in (-40.0, 0.0, 40.0):
        # A cell is some 2 m wide, of which the lowest tenth counts.
        assert abs(ground.under(np.array([east, 5.0, 99.0])) - 0.1 * east) < 0.25
    assert ground.under(np.array([500.0, 0, 0])) == pytest.approx(5.0, abs=0.4)
    hole = GroundMap.of(slope[(np.abs(slope[:, :2]) > 10).any(axis=1)])
    assert hole is not None and abs(hole.under(np.zeros(3))) < 1.2
    assert GroundMap.of(np.zeros((2, 3))) is None
