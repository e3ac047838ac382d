"""Clicks all marks of a list in the inspector's photographs, as a surveyor would, and tells how far off its rings were.

    python sample_scenes/control_points.py --scene sample_scenes/town --out gcp_list.txt --seed 0
    xvfb-run -a -s "-screen 0 1280x800x24" python -m tests.viewer.marked_control RUN gcp_list.txt
    radiant sfm sample_scenes/town/images --gcp RUN/gcp_list.txt --out scene

Each point is taken from the list, each click lands on the pixel of the screen that is nearest to
its mark, at twice the photograph's size. RUN gets the list that the clicks made.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPoint

from radiant_core.georef.control_list import ControlList, load_control_list
from radiant_viewer.docks.control_dock import ControlDock
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.window_user import User, use_window

ZOOM = 2.0


def main(run: Path, listed: Path) -> None:
    """Mark every point of the list where it has it."""
    truth = load_control_list(listed)

    def act(window: InspectorWindow) -> None:
        dock = window.docks.control
        assert dock is not None
        window.raise_dock(dock)
        blank = ControlList(system=truth.system, points=truth.points, marks={})
        blank.save(listed.with_name("unmarked.txt"))
        dock.open_points(listed.with_name("unmarked.txt"))
        rings = [(count, off) for name in (point.name for point in truth.points) for count, off in _mark(User(window), dock, name, truth)]
        for said, chosen in (("survey", (0, 1)), ("marks", range(2, 1000))):
            print(f"rings by the {said}: median {np.median([off for count, off in rings if count in chosen]):.2f} px")
        print(dock.text.text())

    use_window(run, act)


def _mark(user: User, dock: ControlDock, name: str, truth: ControlList) -> list[tuple[int, float]]:
    """Mark one point; for each photograph how many marks it had before, and how far off its ring was, px."""
    rings = []
    for photograph, pixel in truth.marks_of(name).items():
        dock.choose(name, photograph)
        assert dock.session is not None and dock.session.list is not None
        sight = next(one for one in dock.session.sights(name) if one.photograph == photograph)
        height, width = dock.session.photograph(photograph).shape[:2]
        if sight.guess is not None:
            off = np.hypot(sight.guess[0] * width - pixel[0], sight.guess[1] * height - pixel[1])
            rings.append((len(dock.session.list.marks_of(name)), float(off)))
        # To a whole pixel of the photograph, so that the click is off by what a hand is.
        column, row = np.round(pixel)
        dock.picture.look_at(column, row, ZOOM)
        middle = dock.picture.rect().center()
        away = [round(ZOOM * (value - rounded)) for value, rounded in zip(pixel, (column, row), strict=True)]
        user.click(dock.picture, f"{name} in {photograph}", middle + QPoint(*away))
    return rings


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
