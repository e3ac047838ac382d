"""Titles and notes of the bookmarked views, for the page that is sent. Needs the `desktop`
extra."""

from __future__ import annotations

from functools import partial

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QDialogButtonBox, QGridLayout, QLabel, QLineEdit, QPlainTextEdit, QPushButton, QVBoxLayout, QWidget

from radiant_core.errors import RadiantError
from radiant_viewer.runs.bookmarks import MAX_NOTE, MAX_TITLE, NUMBERS, Bookmark
from radiant_viewer.window.bookmark_keys import BookmarkKeys

NONE_YET = "No view is bookmarked yet: move the 3D view to what is worth a look, then press Ctrl+Alt+1 … 9, or Add."
HINT = "Places of the page that is sent, in this order. A note stands below its title."
WIDTH_PX, NOTE_PX = 720, 54


class PlacesDialog(QDialog):
    """A row per bookmarked view; `rows` are title and note by number. Save writes all of them."""

    def __init__(self, window: QWidget, keys: BookmarkKeys) -> None:
        super().__init__(window)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("Places")
        self.setMinimumWidth(WIDTH_PX)
        self._keys = keys
        self._views: dict[int, Bookmark] = dict(keys.bookmarks.load())
        self.rows: dict[int, tuple[QLineEdit, QPlainTextEdit]] = {}
        self.message, self._grid, self._fields = QLabel(""), QGridLayout(), QWidget()
        self.message.setWordWrap(True)
        self.message.setProperty("soft", "true")
        self._fields.setLayout(self._grid)
        self.add = QPushButton("Add the 3D view")
        self.add.clicked.connect(self._add)
        self.buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Save | QDialogButtonBox.StandardButton.Cancel)
        self.buttons.addButton(self.add, QDialogButtonBox.ButtonRole.ActionRole)
        self.buttons.accepted.connect(self._save)
        self.buttons.rejected.connect(self.reject)
        layout = QVBoxLayout(self)
        for widget in (self._fields, self.message, self.buttons):
            layout.addWidget(widget)
        self._fill()

    def _fill(self) -> None:
        while (item := self._grid.takeAt(0)) is not None:
            if (old := item.widget()) is not None:
                old.setParent(None)
                old.deleteLater()
        self.rows = {}
        for row, (number, view) in enumerate(sorted(self._views.items())):
            title, note = QLineEdit(view.title), QPlainTextEdit(view.note)
            title.setMaxLength(MAX_TITLE)
            title.setPlaceholderText(f"Title of view {number}")
            note.setPlaceholderText("Note")
            note.setFixedHeight(NOTE_PX)
            note.setTabChangesFocus(True)
            see, remove = QPushButton("See"), QPushButton("Remove")
            see.clicked.connect(partial(self._keys.show_pose, view.pose))
            see.setObjectName(f"see {number}")
            remove.setObjectName(f"remove {number}")
            remove.clicked.connect(partial(self._remove, number))
            for column, widget in enumerate((QLabel(f"Alt+{number}"), title, note, see, remove)):
                self._grid.addWidget(widget, row, column)
            self.rows[number] = title, note
        self._grid.setColumnStretch(2, 1)
        self.add.setEnabled(len(self._views) < len(NUMBERS))
        self.message.setText(HINT if self._views else NONE_YET)
        self.adjustSize()

    def _read(self) -> None:
        for number, (title, note) in self.rows.items():
            text = " ".join(note.toPlainText().split())
            self._views[number] = Bookmark(pose=self._views[number].pose, title=title.text().strip(), note=text)

    def _add(self) -> None:
        self._read()
        number = next(number for number in NUMBERS if number not in self._views)
        self._views[number] = Bookmark(pose=self._keys.pose)
        self._fill()
        self.rows[number][0].setFocus()

    def _remove(self, number: int) -> None:
        self._read()
        del self._views[number]
        self._fill()

    def _save(self) -> None:
        self._read()
        too_long = [number for number, view in self._views.items() if len(view.note) > MAX_NOTE]
        if too_long:
            number = too_long[0]
            self.message.setText(f"The note of view {number} has {len(self._views[number].note)} characters: at most {MAX_NOTE} fit.")
            return
        try:
            self._keys.save(self._views)
        except RadiantError as error:
            self.message.setText(str(error))
            return
        self.accept()
