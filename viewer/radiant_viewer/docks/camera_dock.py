"""The table of cameras: sorted, filtered by words, saved as CSV. Needs the `desktop` extra."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QItemSelection, QSortFilterProxyModel, Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QDockWidget,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from radiant_viewer.docks.camera_table import SORT_ROLE, CameraTable
from radiant_viewer.host.protocols import Host
from radiant_viewer.runs.run_figures import ImageFigures
from radiant_viewer.runs.run_view import RunView

COLORINGS = {
    "Region": "Cameras by region",
    "Device": "Cameras by device",
    "Held-out": "Cameras by split",
    "PSNR": "Cameras by PSNR",
}
"""Choice of colouring → the layer that shows it."""


class CameraDock(QDockWidget):
    """Emits `chosen` with the index of the photograph of a row; a double click flies there."""

    chosen = Signal(int)

    def __init__(self, host: Host, run: RunView, figures: ImageFigures) -> None:
        super().__init__("Cameras")
        self.setObjectName("cameras")
        self._host, self._run = host, run
        self.cameras = CameraTable(run, figures)
        self.sorted_cameras = QSortFilterProxyModel(self)
        self.sorted_cameras.setSourceModel(self.cameras)
        self.sorted_cameras.setSortRole(SORT_ROLE)
        self.sorted_cameras.setFilterKeyColumn(-1)
        self.sorted_cameras.setFilterCaseSensitivity(Qt.CaseSensitivity.CaseInsensitive)
        self.table = self._table()
        self.filter = QLineEdit()
        self.filter.setPlaceholderText("Filter: a name, region, device, held out…")
        self.filter.setClearButtonEnabled(True)
        self.filter.textChanged.connect(self._on_filter)
        self.count = QLabel()
        self.count.setProperty("soft", "true")
        self.coloring = QComboBox()
        present = [layer.name for layer in host.layers]
        self.coloring.addItems([name for name, layer in COLORINGS.items() if layer in present])
        self.coloring.setToolTip("What the colours of the cameras say in both views")
        self.coloring.currentTextChanged.connect(self.color_by)
        self.fly = QPushButton("Fly to")
        self.fly.setToolTip("See the scene from the selected camera (Return, or double click)")
        self.fly.clicked.connect(host.fly_to_selected)
        export = QPushButton("CSV…")
        export.setToolTip("Save the rows as they are filtered and sorted")
        export.clicked.connect(self._ask_csv)
        row = QHBoxLayout()
        for widget in (self.filter, self.count, QLabel("Colour by"), self.coloring, self.fly, export):
            row.addWidget(widget, stretch=int(widget is self.filter))
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.setSpacing(3)
        layout.addLayout(row)
        layout.addWidget(self.table)
        self.setWidget(body)
        self._on_filter("")

    def select(self, index: int) -> None:
        """Select the row of camera `index`; where the filter hides it, the filter is cleared."""
        row = self.sorted_cameras.mapFromSource(self.cameras.index(index, 0))
        if not row.isValid():
            self.filter.clear()
            row = self.sorted_cameras.mapFromSource(self.cameras.index(index, 0))
        self.table.selectRow(row.row())
        self.table.scrollTo(row, QAbstractItemView.ScrollHint.PositionAtCenter)

    def show_run(self, run: RunView) -> None:
        """Show the same cameras with another plan; sorting, filter and selection are kept."""
        self._run = run
        self.cameras.show_run(run)

    def color_by(self, coloring: str) -> None:
        """Colour the cameras by a key of `COLORINGS`; the layers of the others are hidden."""
        for name, layer in COLORINGS.items():
            if self.coloring.findText(name) >= 0:
                self._host.set_layer_visible(layer, name == coloring)
        self.coloring.setCurrentText(coloring)

    def shown_order(self) -> list[int]:
        """Return the indices of the cameras as they are filtered and sorted."""
        model = self.sorted_cameras
        return [model.mapToSource(model.index(row, 0)).row() for row in range(model.rowCount())]

    def save_csv(self, path: Path) -> None:
        """Write the shown rows; BadInput where the file cannot be written."""
        order = self.shown_order()
        self.cameras.save_csv(path, order)
        self._host.show_status(f"Saved {len(order)} cameras to {path}")

    def _table(self) -> QTableView:
        table = QTableView()
        table.setModel(self.sorted_cameras)
        table.setSortingEnabled(True)
        table.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        table.setAlternatingRowColors(True)
        table.verticalHeader().setDefaultSectionSize(21)
        table.verticalHeader().setVisible(False)
        table.resizeColumnsToContents()
        table.selectionModel().selectionChanged.connect(self._on_selection)
        table.doubleClicked.connect(lambda _: self._host.fly_to_selected())
        return table

    def _on_selection(self, selected: QItemSelection) -> None:
        if selected.indexes():
            self.chosen.emit(self.sorted_cameras.mapToSource(selected.indexes()[0]).row())

    def _on_filter(self, words: str) -> None:
        self.sorted_cameras.setFilterFixedString(words)
        self.count.setText(f"{self.sorted_cameras.rowCount()} of {len(self.cameras.rows)}")

    def _ask_csv(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save cameras", str(Path.cwd() / "cameras.csv"), "CSV (*.csv)")
        if path:
            self._host.attempt(lambda: self.save_csv(Path(path)))
