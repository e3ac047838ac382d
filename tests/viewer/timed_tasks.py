"""Five tasks of docs/inspector.md, done in the real window; what each came to is what the window
shows, as JSON.

DISPLAY=:1 python -m tests.viewer.timed_tasks RUN OUT    OUT holds other.json, another plan
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

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
        "figures": dock.figures_text.text(),
        "why": dock.reasons_text.text(),
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


TASKS = (find_worst_seam, move_twenty_cameras, find_worst_photograph, export_regions, compare_plans)


def main(run: Path, out: Path) -> None:
    """Every task in a window of its own on the run as it was; writes OUT/results.json."""
    results: dict[str, Any] = {}
    for task in TASKS:
        (run / "plan_edits.json").unlink(missing_ok=True)
        began = time.monotonic()

        def act(window: InspectorWindow, task: Any = task, began: float = began) -> None:
            opened = time.monotonic()
            user = User(window)
            found = task(user, out)
            results[task.__name__] = {**found, "actions": user.actions, "open_s": opened - began, "task_s": time.monotonic() - opened}

        use_window(run, act)
    (out / "results.json").write_text(json.dumps(results))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
