"""Tasks of docs/inspector.md, done in the real window; what each came to is what the window shows,
as JSON.

DISPLAY=:1 python -m tests.viewer.timed_tasks RUN OUT [TASK …]    OUT holds other.json, another plan
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QPoint
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest

from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_user import User, until, use_window

MOVED = 20


def find_worst_seam(user: User, out: Path) -> dict[str, Any]:
    """One key."""
    user.press("T")
    dock = user.window.docks.seams
    assert dock is not None
    until(lambda: dock.at is not None, "the tour never began")
    assert dock.at is not None
    return {
        "title": dock.stops[dock.at].title,
        "status": user.window.statusBar().currentMessage(),
        "looks_at": user.window.view.pose.focal_point[:2].tolist(),
        "map_at": user.window.map.pose.focal_point[:2].tolist(),
    }


def move_twenty_cameras(user: User, out: Path) -> dict[str, Any]:
    """A key and a drag."""
    planning = user.window.planning
    assert planning is not None and planning.session is not None
    before = planning.session.editor.state.cloud
    user.press("E")
    live, frames = user.drag_border(MOVED)
    cloud = planning.session.editor.state.cloud
    owners = {"edges": cloud.edge_of_camera.tolist(), "time_s": cloud.edge_time_s.tolist(), "counts": cloud.counts.tolist()}
    slowest = before.edge_ids[int(before.edge_time_s.argmax())]
    return {"slowest": slowest, "live": live, "frames": frames, "text": planning.dock.changes.text(), "owners": owners}


def find_worst_photograph(user: User, out: Path) -> dict[str, Any]:
    """A key, an entry of a list, a key."""
    window, dock = user.window, user.window.docks.photo
    assert dock is not None
    user.press("W")
    until(lambda: dock.picture._left is not None, "no photograph came")
    user.choose(dock.mode, "Difference")
    until(lambda: dock.mode.currentText() == "Difference", "nothing was chosen")
    user.press("Return")
    shown = dock.picture.grab().toImage()
    level = shown.pixelColor(shown.width() // 2, shown.height() // 2).red()
    eye = window.view.pose.camera((640, 480)).cam_from_world[0]
    return {
        "name": dock.name.text(),
        "figures": dock.figures_text.text().replace("\u00a0", " "),
        "why": dock.reasons_text.text().replace("\u00a0", " "),
        "level": level,
        "cam_from_world": eye.tolist(),
    }


def export_regions(user: User, out: Path) -> dict[str, Any]:
    """A key and a name."""
    user.will_name(out / "regions.geojson")
    user.press("Ctrl+G")
    until((out / "regions.geojson").exists, "nothing was written")
    return {"status": user.window.statusBar().currentMessage()}


def compare_plans(user: User, out: Path) -> dict[str, Any]:
    """A tab, a button and a name."""
    planning = user.window.planning
    assert planning is not None

    def vermillion() -> int:
        return int((np.abs(user.window.map.screenshot().astype(int) - VERMILLION).max(axis=2) < 8).sum())

    before = vermillion()
    user.click_tab("Plan")
    user.will_name(out / "other.json")
    user.click(planning.dock.buttons["Compare…"], "Compare…")
    until(lambda: planning.actions.comparison is not None, "nothing was compared")
    assert planning.actions.comparison is not None
    return {
        "text": planning.dock.changes.text(),
        "marked_px": vermillion() - before,
        "different": np.flatnonzero(planning.actions.comparison.new_edge).tolist(),
    }


def see_from_above(user: User, out: Path) -> dict[str, Any]:
    """A key."""
    user.press("Ctrl+1")
    return {"looks": user.window.view.pose.rotation[2].tolist()}


def measure_distance(user: User, out: Path) -> dict[str, Any]:
    """A key and two clicks in the 3D view; when the figure stands there."""
    window = user.window
    model = window.model
    assert model is not None
    until(lambda: model.shown_is_full, "the model never came")
    began = time.monotonic()
    user.press("M")
    for share in (0.42, 0.58):
        view = window.view.plotter
        user.click(view, f"at {share:.2f}", QPoint(round(share * view.width()), view.height() // 2))
    tool = window.docks.survey.tool
    measured = {"text": window.docks.survey.text.text(), "points": tool.points.tolist(), "figure_s": time.monotonic() - began}
    QTest.keySequence(window, QKeySequence("Escape"))
    assert not tool.is_active, "a key does not end the measuring"
    return measured


def leave_out_by_lasso(user: User, out: Path) -> dict[str, Any]:
    """A key, a drag and a key."""
    window, select = user.window, user.window.docks.cleaning.select
    model = window.model
    assert model is not None and select is not None
    until(lambda: model.shown_is_full, "the model never came")
    before = window.view.screenshot().astype(int)
    user.press("L")
    view = window.view.plotter
    turn = np.linspace(0, 2 * np.pi, 40)
    path = np.array([view.width() / 2, view.height() / 2]) + 60 * np.column_stack([np.cos(turn), np.sin(turn)])
    user.drag(view, path, "around the middle")
    chosen, camera = select.tool.chosen, window.view.pose.camera(window.view.size_wh)
    user.press("Delete")
    until(lambda: model.shown_is_full, "the model never came without them")
    after = window.view.screenshot().astype(int)
    session = window.docks.cleaning.session
    assert session is not None
    changed = np.abs(before - after).max(axis=2) > 30
    rows, columns = np.nonzero(changed)
    result = {
        "chosen": int(chosen.sum()),
        "left": len(session.model.splats),
        "K": camera.Ks[0].tolist(),
        "cam_from_world": camera.cam_from_world[0].tolist(),
        "changed_inside": float(changed[_disc(changed.shape, 50)].mean()),
        "changed_outside": float(changed[~_disc(changed.shape, 75)].mean()),
        "middle": [float(columns.mean()), float(rows.mean())],
        "file": json.loads((window.subject.path / "cleaning.json").read_text()),
    }
    # Keys of no task, which are not counted.
    sizes = []
    for keys in ("Ctrl+Z", "Ctrl+Shift+Z", "Ctrl+Z"):
        QTest.keySequence(window, QKeySequence(keys))
        sizes.append(len(session.model.splats))
    undone, redone, _ = sizes
    return {**result, "undone": undone, "redone": redone}


def film_a_border(user: User, out: Path) -> dict[str, Any]:
    """Two keyframes and the flight between them."""
    window = user.window
    user.press("K")
    user.press("T")
    user.press("K")
    user.click_tab("Fly-through")
    return {"keyframes": len(window.docks.fly.keyframes)}


def _disc(shape: tuple[int, ...], radius: float) -> np.ndarray:
    rows, columns = np.indices(shape[:2])
    return np.hypot(rows + 0.5 - shape[0] / 2, columns + 0.5 - shape[1] / 2) < radius


WINDOWS = (
    (measure_distance, leave_out_by_lasso),
    (export_regions, compare_plans, find_worst_seam, find_worst_photograph, see_from_above, film_a_border),
    (move_twenty_cameras,),
)
"""Tasks that follow each other in one window: none needs what another changes."""


def main(run: Path, out: Path, *names: str) -> None:
    """Every task, or those named, in as few windows as leave each the run as it was; writes
    OUT/results.json and a line a task."""
    results: dict[str, Any] = {}
    for tasks in WINDOWS:
        wanted = [task for task in tasks if not names or task.__name__ in names]
        (run / "plan_edits.json").unlink(missing_ok=True)
        began = time.monotonic()

        def act(window: InspectorWindow, wanted: list[Any] = wanted, began: float = began) -> None:
            open_s = time.monotonic() - began
            for task in wanted:
                # A dialog of the task before took the keyboard, and no window manager gives it back.
                window.activateWindow()
                until(window.isActiveWindow, "the window never got the keyboard")
                user, task_began = User(window), time.monotonic()
                found = task(user, out)
                task_s = time.monotonic() - task_began
                results[task.__name__] = {**found, "actions": user.actions, "open_s": open_s, "task_s": task_s}
                print(f"{task.__name__}: {len(user.actions)} actions, window {open_s:.1f} s, task {task_s:.1f} s", flush=True)

        if wanted:
            use_window(run, act)
    (out / "results.json").write_text(json.dumps(results))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
