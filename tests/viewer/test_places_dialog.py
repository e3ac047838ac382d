"""The dialog that gives bookmarked views titles and notes, for the page that is sent."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.viewer.window_kit import run_python

DIALOG = """
import sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from PySide6.QtWidgets import QApplication, QDialogButtonBox, QPushButton, QWidget
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.bookmarks import Bookmarks
from radiant_viewer.window.bookmark_keys import BookmarkKeys
from radiant_viewer.window.places_dialog import PlacesDialog

app = QApplication([])
folder = Path(sys.argv[1])


def pose(east):
    return ViewPose(position=np.array([east, -8.0, 6]), focal_point=np.zeros(3), up=np.array([0.0, 0, 1]), angle_deg=40.0)


class View:
    pose = pose(5.0)

    def set_pose(self, pose):
        self.pose = pose


words = []
host = SimpleNamespace(view=View(), render_views=lambda: None, show_status=words.append, attempt=lambda act: act())
window, bookmarks = QWidget(), Bookmarks(folder)
keys = BookmarkKeys(window, host, bookmarks)
assert "no view is bookmarked" in PlacesDialog(window, keys).message.text().lower()
bookmarks.keep(3, pose(1.0))
dialog = PlacesDialog(window, keys)
dialog.open()
dialog.rows[3][0].setText("The church")
dialog.rows[3][1].setPlainText("Its roof was\\nrenewed in May.")
dialog.add.click()
dialog.rows[1][1].setPlainText("x" * 401)
save = dialog.buttons.button(QDialogButtonBox.StandardButton.Save)
save.click()
assert dialog.isVisible() and "401 characters" in dialog.message.text(), dialog.message.text()
dialog.rows[1][1].setPlainText("")
dialog.rows[1][0].setText("The gate")
(see,) = dialog.findChildren(QPushButton, "see 3")
see.click()
assert host.view.pose.position[0] == 1.0
dialog.grab().save(str(folder / "dialog.png"))
save.click()
assert not dialog.isVisible() and "2 places in views.json" in words[-1], words
print((folder / "views.json").read_text().replace("\\n", " "))
again = PlacesDialog(window, keys)
again.findChildren(QPushButton, "remove 1")[0].click()
again.reject()
assert len(bookmarks.load()) == 2, "Cancel wrote"
again = PlacesDialog(window, keys)
again.findChildren(QPushButton, "remove 1")[0].click()
again.buttons.button(QDialogButtonBox.StandardButton.Save).click()
assert list(bookmarks.load()) == [3]
"""


def test_titles_and_notes_are_kept_beside_the_views_and_a_long_note_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    result = run_python(DIALOG, str(tmp_path), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-3000:]
    views = json.loads(result.stdout)["views"]
    assert {number: (view["title"], view.get("note", "")) for number, view in views.items()} == {
        "1": ("The gate", ""),
        "3": ("The church", "Its roof was renewed in May."),
    }
    assert views["1"]["position"] == [5.0, -8.0, 6.0]
