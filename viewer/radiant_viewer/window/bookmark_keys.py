"""The keys of bookmarked views. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QWidget

from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.bookmarks import NUMBERS, Bookmark, Bookmarks

BOOKMARK_KEYS = {"Ctrl+Alt+1 … 9": "Bookmark the 3D view, beside the run", "Alt+1 … 9": "See a bookmarked view again"}


class BookmarkKeys:
    """Lets the keys of a window keep and show views of `host`."""

    def __init__(self, window: QWidget, host: Host, bookmarks: Bookmarks) -> None:
        self._host, self.bookmarks = host, bookmarks
        for number in NUMBERS:
            QShortcut(QKeySequence(f"Ctrl+Alt+{number}"), window).activated.connect(partial(self.keep, number))
            QShortcut(QKeySequence(f"Alt+{number}"), window).activated.connect(partial(self.see, number))

    def keep(self, number: int) -> None:
        """Bookmark the 3D view."""
        self._host.attempt(lambda: self._host.show_status(self.bookmarks.keep(number, self._host.view.pose)))

    def see(self, number: int) -> None:
        """See a bookmarked view again."""
        pose = self._host.attempt(lambda: self.bookmarks.view(number))
        if pose is not None:
            self.show_pose(pose)

    @property
    def pose(self) -> ViewPose:
        """What the 3D view shows."""
        return self._host.view.pose

    def show_pose(self, pose: ViewPose, _: bool = False) -> None:
        """Move the 3D view to a pose."""
        self._host.view.set_pose(pose)
        self._host.render_views()

    def save(self, views: Mapping[int, Bookmark]) -> None:
        """Keep these views and no others; raises as `Bookmarks.save`."""
        self.bookmarks.save(views)
        number = len(views)
        self._host.show_status(f"{number} place{'s' * (number != 1)} in {self.bookmarks.path.name}, for the page that is made next")
