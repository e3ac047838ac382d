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
import numpy as np
from PySide6.QtCore import QPoint, QSettings, Qt
from PySide6.QtTest import QTest

from radiant_core.errors import BadInput
from radiant_core.survey.map_grid import map_frame_of
from radiant_viewer.layers.layer import framing_positions
from radiant_viewer.pictures.images import load_image
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.timed_tasks import MOVED, compare_plans, export_regions, find_worst_seam
from tests.viewer.window_user import User, until, use_window

SIZE_WH = (1280, 800)
"""Size of the windows in the pictures."""

JPEG = [cv2.IMWRITE_JPEG_QUALITY, 62, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
"""Some 140 kB a picture, texts still sharp."""
REST_MS = 2500
"""So long after the last action splats, points and labels are drawn in full."""
EYE_M, SEEN_M = (10.0, -70.0, 60.0), (10.0, -15.0, -40.0)
"""From where `survey` looks at what, in the town."""
MEASURED = (
    ("distance", ((0.45, 0.62), (0.62, 0.52))),
    ("height", ((0.3, 0.45), (0.38, 0.6))),
    ("area", ((0.62, 0.66), (0.8, 0.66), (0.8, 0.8), (0.62, 0.8))),
)
"""Clicks, as shares of the 3D view."""


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


def survey(user: User, out: Path) -> None:
    """Points marked in photographs, measures, and the orthophoto behind the map, which the run has
    from `radiant export RUN RUN/survey/ortho.tif --format ortho`."""
    window = user.window
    control, measures, run = window.docks.control, window.docks.survey, window.run
    assert control is not None and control.session is not None and measures is not None and run is not None
    for name in ("Borders", "Seams", "Cameras by region", "Edge loads", "Edges"):
        window.set_layer_visible(name, False)
    window.splitter.setSizes([470, 330])
    window.view.set_pose(ViewPose(position=np.array(EYE_M), focal_point=np.array(SEEN_M), up=np.array([0.0, 0, 1]), angle_deg=40))
    window.map.fit(framing_positions(window.layers))
    window.render_views()
    window.raise_dock(measures)
    until(lambda: window.model is not None and window.model.shown_is_full, "the model was never drawn in full")
    measures.click.click()
    for kind, spots in MEASURED:
        measures.kind.setCurrentText(kind)
        for across, down in spots:
            width, height = window.view.size_wh
            user.click(window.view.plotter, kind, QPoint(round(across * width), round(down * height)))
        measures.measure.click()
        until(lambda: not measures.is_measuring, "nothing was measured", 600)
    measures.click.click()
    (out / "points.txt").write_text(_surveyed_points(run))
    window.raise_dock(control)
    control.open_points(out / "points.txt")
    for point in control.session.list.points if control.session.list is not None else ():
        for sight in [one for one in control.session.sights(point.name) if one.guess is not None][:3]:
            control.choose(point.name, sight.photograph)
            user.click(control.picture, f"{point.name} in {sight.photograph}", control.picture.rect().center())


def _surveyed_points(run: RunView) -> str:
    """A table of the sparse points that most photographs share, one for each quarter of the map."""
    scene = run.scene
    counts = np.bincount(scene.observations[:, 0], minlength=len(scene.points))
    middle = scene.cameras.centers[:, :2].mean(axis=0)
    quarters = (scene.points[:, :2] > middle) @ [1, 2]
    chosen = [int(np.argmax(np.where(quarters == quarter, counts, 0))) for quarter in range(4)]
    frame = map_frame_of(scene.frame)
    places = frame.from_world(scene.points[chosen])
    lines = [f"gcp-{number} {' '.join(f'{value:.3f}' for value in place)}" for number, place in enumerate(places, 1)]
    return "\n".join([f"EPSG:{frame.epsg}", *lines])


PICTURES: tuple[Callable[[User, Path], None], ...] = (seam, compare, move, two_plans, gis, plan, timeline, survey)


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
            # A window remembers its size: that of the one before, without its frame.
            QSettings.setPath(QSettings.Format.IniFormat, QSettings.Scope.UserScope, str(out / f"settings_{picture.__name__}"))
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
            if not cv2.imwrite(str(folder / f"{png.stem}.jpg"), load_image(png)[:, :, ::-1], JPEG):
                raise BadInput(f"{folder} takes no pictures: name a folder that exists.")
            print(folder / f"{png.stem}.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
