"""Ground control, marked in the photographs as they are stored. Needs the `desktop` extra.

Choose a point, then a photograph that should show it; a click marks it, and the next photograph can
be chosen. Marks are kept at once in RUN/gcp_list.txt, which `--gcp` reads.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDockWidget,
    QFileDialog,
    QHBoxLayout,
    QInputDialog,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from radiant_core.errors import BadInput
from radiant_core.georef.control_list import ListedPoint
from radiant_viewer.host.picture_label import PictureLabel, PictureMark
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.layer import Label, Layer
from radiant_viewer.layers.palette import BLUE, VERMILLION
from radiant_viewer.runs.control_session import ControlSession, Sight
from radiant_viewer.runs.run_view import RunView

MARK = "Ground control"
CLOSE_ZOOM = 2.0
"""At which a photograph is shown around a mark or a guess."""
HINT = "Open a list of surveyed points: a system such as EPSG:32632 on its first line, then name, east, north, up; or gcp_list.txt."


class ControlDock(QDockWidget):
    """`session` is None where the run's photographs cannot be marked; then `text` says why."""

    def __init__(self, host: Host, run: RunView) -> None:
        super().__init__("Ground control")
        self.setObjectName("ground control")
        self._host = host
        self.session: ControlSession | None = None
        self.points, self.check = QComboBox(), QCheckBox("Check point")
        self.check.setToolTip("Kept out of the adjustment; its residual is reported instead")
        self.photographs, self.picture, self.text = QListWidget(), PictureLabel(), QLabel(HINT)
        self.photographs.setToolTip("Marked photographs first, then those that should show the point")
        self.text.setWordWrap(True)
        self.open, self.add, self.unmark = QPushButton("Open points…"), QPushButton("Add point…"), QPushButton("Take mark back")
        self.picture.message, self.picture.picks = "Choose a point, then a photograph.", True
        self.picture.setToolTip("Click: mark the point. Wheel: closer. Right button: move. The ring is where the point should be")
        self._sight: Sight | None = None
        self._lay_out()
        try:
            self.session = ControlSession(run, self._on_changed)
        except BadInput as error:
            self._say(str(error))
        for widget in (self.open, self.add, self.unmark, self.points, self.check, self.photographs):
            widget.setEnabled(self.session is not None)
        self._connect()
        if self.session is not None and self.session.list is not None:
            self._on_changed()

    @property
    def point(self) -> str:
        """Name of the chosen point, empty without one."""
        return str(self.points.currentData() or "")

    @property
    def photograph(self) -> str:
        """Name of the photograph on show, empty without one."""
        return "" if self._sight is None else self._sight.photograph

    def choose(self, point: str, photograph: str | None = None) -> None:
        """Show a point, and one of its photographs; BadInput for unknown names."""
        index = self.points.findData(point)
        if index < 0:
            raise BadInput(f"there is no point {point!r}: open a list that has it.")
        self.points.setCurrentIndex(index)
        if photograph is None:
            return
        names = [str(self.photographs.item(row).data(Qt.ItemDataRole.UserRole)) for row in range(self.photographs.count())]
        if photograph not in names:
            raise BadInput(f"there is no photograph {photograph!r} in this run: check its name.")
        self.photographs.setCurrentRow(names.index(photograph))

    def mark_at(self, column: float, row: float) -> None:
        """Mark the point in the photograph on show, px as it is stored."""
        if self.session is None or not self.point or not self.photograph:
            raise BadInput("no point and photograph are chosen: choose both, then click the point in the picture.")
        self.session.mark(self.point, self.photograph, (column, row))

    def open_points(self, path: Path) -> None:
        """Take the points of a file; BadInput where it has none."""
        assert self.session is not None
        self.session.open(path)

    def _take_back(self) -> None:
        assert self.session is not None
        self.session.unmark(self.point, self.photograph)

    def _on_changed(self) -> None:
        """Show the list as it is now; the chosen point and photograph stay."""
        session = self.session
        if session is None or session.list is None:
            return
        at, photograph = self.point, self.photograph
        self.points.blockSignals(True)
        self.points.clear()
        for point in session.list.points:
            count = len(session.list.marks_of(point.name))
            self.points.addItem(f"{point.name}{' (check)' * point.is_check}   {count} mark{'s' * (count != 1)}", point.name)
        self.points.setCurrentIndex(max(0, self.points.findData(at)))
        self.points.blockSignals(False)
        self._show_point(photograph)
        self._draw_points()
        self._say(session.summary())
        self.text.setToolTip(session.command)

    def _show_point(self, photograph: str = "") -> None:
        session = self.session
        if session is None or session.list is None or not self.point:
            return
        self.check.blockSignals(True)
        self.check.setChecked(session.list.point(self.point).is_check)
        self.check.blockSignals(False)
        sights = self._host.attempt(lambda: session.sights(self.point)) or ()
        self.photographs.blockSignals(True)
        self.photographs.clear()
        for sight in sights:
            item = QListWidgetItem(_sight_text(sight))
            item.setData(Qt.ItemDataRole.UserRole, sight.photograph)
            self.photographs.addItem(item)
        rows = [row for row, sight in enumerate(sights) if sight.photograph == photograph]
        self.photographs.setCurrentRow(rows[0] if rows else -1)
        self.photographs.blockSignals(False)
        self._sights = sights
        if rows:
            self._sight = sights[rows[0]]
            self._show_marks()
        else:
            self._sight = None
            self.picture.show_picture(None, message="Choose a photograph.")

    def _show_photograph(self, row: int) -> None:
        session = self.session
        if session is None or not 0 <= row < len(self._sights):
            return
        sight = self._sights[row]
        image = self._host.attempt(lambda: session.photograph(sight.photograph))
        if image is None:
            return
        self._sight = sight
        self.picture.show_picture(image, names=(sight.photograph, ""))
        at = sight.mark or (None if sight.guess is None else (sight.guess[0] * image.shape[1], sight.guess[1] * image.shape[0]))
        if at is not None:
            self.picture.look_at(*at, CLOSE_ZOOM)
        self._size_wh = image.shape[1], image.shape[0]
        self._show_marks()

    def _show_marks(self) -> None:
        sight = self._sight
        assert sight is not None
        marks = [] if sight.mark is None else [PictureMark(*sight.mark)]
        if sight.guess is not None and sight.mark is None:
            marks.append(PictureMark(sight.guess[0] * self._size_wh[0], sight.guess[1] * self._size_wh[1], is_guess=True))
        self.picture.show_marks(marks)
        self.unmark.setEnabled(sight.mark is not None)

    def _draw_points(self) -> None:
        """The points in both views, where their places are known."""
        assert self.session is not None and self.session.list is not None
        places = self.session.places()
        rows = np.flatnonzero(np.isfinite(places).all(axis=1))
        if not len(rows):
            self._host.remove_mark(MARK)
            return
        points = [self.session.list.points[row] for row in rows]
        layer = Layer(
            name=MARK,
            points=places[rows],
            point_colors=np.array([BLUE if point.is_check else VERMILLION for point in points], np.uint8),
            point_size_px=9,
            point_rim=True,
            in_front=True,
            labels=tuple(Label(text=point.name, position=place) for point, place in zip(points, places[rows], strict=True)),
        )
        self._host.draw_mark(layer)
        self._host.render_views()

    def _say(self, text: str) -> None:
        self.text.setText(text)

    def _connect(self) -> None:
        self.points.currentIndexChanged.connect(lambda _: self._show_point())
        self.photographs.currentRowChanged.connect(self._show_photograph)
        self.picture.picked.connect(lambda column, row: self._host.attempt(lambda: self.mark_at(column, row)))
        self.unmark.clicked.connect(lambda: self._host.attempt(self._take_back))
        self.check.toggled.connect(lambda on: self._host.attempt(lambda: self._set_check(on)))
        self.open.clicked.connect(self._ask_points)
        self.add.clicked.connect(self._ask_point)

    def _set_check(self, is_check: bool) -> None:
        assert self.session is not None
        self.session.set_check(self.point, is_check)

    def _ask_points(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Surveyed points", str(Path.cwd()), "Lists (*.txt *.csv);;All files (*)")
        if path:
            self._host.attempt(lambda: self.open_points(Path(path)))

    def _ask_point(self) -> None:
        assert self.session is not None
        listed = self.session.list
        system = listed.system if listed is not None else QInputDialog.getText(self, "Add point", "System, such as EPSG:32632, or LOCAL")[0]
        if not system.strip():
            return
        text, is_given = QInputDialog.getText(self, "Add point", f"Name, east, north, up in {system}")
        if is_given:
            self._host.attempt(lambda: self.add_point(system.strip(), text))

    def add_point(self, system: str, text: str) -> None:
        """Add the point of "name east north up"; BadInput where it is none."""
        assert self.session is not None
        words = text.replace(",", " ").split()
        try:
            name, (east, north, up) = words[0], (float(word) for word in words[1:])
        except (ValueError, IndexError):
            raise BadInput(f"{text!r} is no point: give its name, east, north and up.") from None
        self.session.add(system, ListedPoint(name, (east, north, up)))

    def _lay_out(self) -> None:
        top, buttons = QHBoxLayout(), QHBoxLayout()
        top.addWidget(self.points, stretch=1)
        top.addWidget(self.check)
        for button in (self.open, self.add, self.unmark):
            buttons.addWidget(button)
        across = QSplitter(Qt.Orientation.Vertical)
        across.addWidget(self.photographs)
        across.addWidget(self.picture)
        across.setStretchFactor(0, 1)
        across.setStretchFactor(1, 3)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(top)
        layout.addLayout(buttons)
        layout.addWidget(across, stretch=1)
        layout.addWidget(self.text)
        self.setWidget(body)
        self._sights: tuple[Sight, ...] = ()
        self._size_wh = (1, 1)


def _sight_text(sight: Sight) -> str:
    if sight.mark is not None:
        return f"✓ {sight.photograph}   {sight.mark[0]:.1f}, {sight.mark[1]:.1f}"
    return f"{'○' if sight.guess is not None else '  '} {sight.photograph}"
