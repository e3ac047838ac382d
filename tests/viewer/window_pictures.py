"""The pictures of the window in the docs, taken of a run that `radiant demo` made.

    xvfb-run -a -s "-screen 0 1280x800x24" python -m tests.viewer.window_pictures RUN docs/pictures

The run itself stays as it is: a copy of it is worked on. Take them on a free machine: the 3D
view notes how long it drew.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from radiant_core.errors import BadInput
from radiant_viewer.pictures.images import load_image
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.timed_tasks import MOVED, compare_plans, export_regions, find_worst_seam
from tests.viewer.window_user import User, until, use_window

SIZE_WH = (1280, 800)
"""Size of the windows in the pictures."""

JPEG = [cv2.IMWRITE_JPEG_QUALITY, 62, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
"""Some 140 kB a picture, texts still sharp."""
REST_MS = 2500
"""So long after the last action splats, points and labels are drawn in full."""


def seam(user: User, out: Path) -> None:
    """The worst seam and the model there."""
    find_worst_seam(user, out)


def compare(user: User, out: Path) -> None:
    """The worst photograph beside its render, from where its camera stood."""
    user.press("W")
    user.press("Return")
    user.window.raise_dock(user.window.docks.photo)


def move(user: User, out: Path) -> None:
    """Cameras that changed hands by one drag; the plan is kept for `two_plans`."""
    user.press("E")
    user.drag_border(MOVED)
    user.will_name(out / "other.json")
    user.press("Ctrl+Shift+P")
    user.window.raise_dock(user.window.planning.loads if user.window.planning else None)
    assert user.window.planning is not None
    user.window.show_status(f"Drag of a border: {user.window.planning.dock.changes.text()}")


def two_plans(user: User, out: Path) -> None:
    """The plan of the run against the one of `move`."""
    compare_plans(user, out)
    user.window.raise_dock(user.window.planning.loads if user.window.planning else None)


def gis(user: User, out: Path) -> None:
    """Regions and strips, written for a GIS."""
    user.window.set_layer_visible("Device strips", True)
    export_regions(user, out)


def plan(user: User, out: Path) -> None:
    """A border was dragged and a camera pinned."""
    planning = user.window.planning
    assert planning is not None and planning.session is not None
    session = planning.session
    user.press("E")
    user.drag_border(4)
    cloud = session.editor.state.cloud
    chosen = session.editor.subject.names[0]
    planning.actions.select((chosen,))
    planning.actions.pin(cloud.edge_ids[1 - int(cloud.edge_of_camera[0])])
    until(lambda: len(session.editor.edits) == 2 and not session.is_busy, "the pin never came")
    planning.actions.select(())
    user.window.raise_dock(planning.loads)


def timeline(user: User, out: Path) -> None:
    """What was planned and what happened, dark."""
    user.press("Ctrl+D")
    gantt = user.window.docks.gantt
    assert gantt is not None
    user.window.raise_dock(gantt)
    # As the border between views and tables is dragged up, until every machine is seen.
    user.window.resizeDocks([gantt], [400], Qt.Orientation.Vertical)


PICTURES: tuple[Callable[[User, Path], None], ...] = (seam, compare, move, two_plans, gis, plan, timeline)


def main(run: Path, folder: Path, names: list[str]) -> None:
    """Write window_<name>.jpg of every picture, or of the named ones, into a folder."""
    with TemporaryDirectory() as temporary:
        out = Path(temporary)
        copy = out / run.name
        shutil.copytree(run, copy)
        for picture in PICTURES:
            if names and picture.__name__ not in names:
                continue
            (copy / "plan_edits.json").unlink(missing_ok=True)
            png = out / f"window_{picture.__name__}.png"

            def act(window: InspectorWindow, picture: Callable[[User, Path], None] = picture, png: Path = png) -> None:
                if (window.width(), window.height()) != SIZE_WH:
                    raise BadInput(
                        f"the screen leaves the window {window.width()} x {window.height()} px: give it {SIZE_WH[0]} x {SIZE_WH[1]}."
                    )
                picture(User(window), out)
                said = window.statusBar().currentMessage()
                model = window.model
                QTest.qWait(REST_MS)
                until(lambda: model is None or model.shown_is_full, "the model was never drawn in full")
                window.show_status(said)
                window.save_window_picture(png)

            use_window(copy, act)
            cv2.imwrite(str(folder / f"{png.stem}.jpg"), load_image(png)[:, :, ::-1], JPEG)
            print(folder / f"{png.stem}.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
