"""The machines of a run: this one, those of a system file, or a form that writes one. Needs the
`desktop` extra.

The form's file lies in a folder of the window's until the run begins or its line is copied; only
then it is written where the line names it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QPushButton,
    QStackedWidget,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from radiant_viewer.start.choices import COLUMNS, FILE, FIRST_ROW, FORM, HERE, KIND, NO_KIND, ListedMachines, list_path

SETTLE_MS = 400
FORM_PX = 150


class MachinePane(QWidget):
    """`changed` is emitted when another choice holds; `wants_file` carries rows of the form and the
    path of the system file to be written of them."""

    changed = Signal()
    wants_file = Signal(object, object)

    def __init__(self) -> None:
        super().__init__()
        self._profiles: dict[str, str] = {}
        self._listed = ListedMachines()
        self._is_written = False
        self.kind = QComboBox()
        self.kind.addItems([HERE, FILE, FORM])
        self.file, self.browse = QLineEdit(), QPushButton("Browse…")
        self.file.setPlaceholderText("system.toml")
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setHorizontalHeaderLabels(list(COLUMNS))
        self.table.verticalHeader().hide()
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setStretchLastSection(True)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setFixedHeight(FORM_PX)
        self.add, self.remove, self.form_file = QPushButton("Add line"), QPushButton("Remove line"), QLineEdit()
        self.form_file.setToolTip("The system file that is written of this list, for radiant run --system")
        self.message = QLabel("")
        self.message.setWordWrap(True)
        self.message.setProperty("soft", "true")
        self._pages = QStackedWidget()
        self._settle = QTimer(self, singleShot=True, interval=SETTLE_MS)
        self._settle.timeout.connect(self._ask_for_file)
        self._lay_out()
        self.kind.currentIndexChanged.connect(self._on_kind)
        self.file.textChanged.connect(lambda _: self.changed.emit())
        self.browse.clicked.connect(self._ask_name)
        self.add.clicked.connect(self.add_row)
        self.remove.clicked.connect(self._remove_row)
        self.table.itemChanged.connect(lambda _: self._settle.start())
        self.form_file.textChanged.connect(lambda _: self._settle.start())
        self._on_kind(0)

    @property
    def system(self) -> Path | None:
        """The system file that is chosen or written; None for this machine."""
        if self.kind.currentText() == FILE:
            return Path(self.file.text().strip()) if self.file.text().strip() else None
        return self._listed.tried if self.kind.currentText() == FORM and self._is_written else None

    @property
    def system_as(self) -> Path | None:
        """How the command line names the system file."""
        name = self.form_file.text().strip()
        return Path(name) if self.kind.currentText() == FORM and name else self.system

    @property
    def is_ready(self) -> bool:
        """Whether the choice is whole."""
        return self.kind.currentText() == HERE or self.system is not None

    def show_profiles(self, profiles: dict[str, str]) -> None:
        """Offer kinds of machines, name → machine."""
        self._profiles = profiles

    def propose(self, out: Path) -> None:
        """Keep the form's file beside a result, unless a name was given."""
        if not self.form_file.isModified():
            self.form_file.setText(str(list_path(out)))
            self.form_file.setModified(False)

    def keep(self) -> None:
        """Write the form's file where the command line names it; BadInput where another lies
        there."""
        if self.kind.currentText() == FORM and self.system_as is not None:
            self._listed.keep(self.system_as)

    def end(self) -> None:
        """Forget what was not kept."""
        self._listed.end()

    def add_row(self) -> None:
        """A further line, like the first."""
        row = self.table.rowCount()
        self.table.blockSignals(True)
        self.table.insertRow(row)
        for column, text in enumerate(FIRST_ROW):
            if column == KIND:
                self.table.setCellWidget(row, column, self._kinds())
            else:
                self.table.setItem(row, column, QTableWidgetItem(f"{text}-{row + 1}" if column == 1 else text))
        self.table.blockSignals(False)
        self._settle.start()

    def rows(self) -> list[dict[str, Any]]:
        """The lines as `start_forecast.MachineRow` has them; text that is no number stays text."""
        return [
            {
                "site": self._cell(row, 0),
                "machine": self._cell(row, 1),
                "count": _number(self._cell(row, 2), whole=True),
                "profile": self._profile(row),
                "memory_gb": _number(self._cell(row, 4)),
                "uplink_mbit_per_s": _number(self._cell(row, 5)),
            }
            for row in range(self.table.rowCount())
        ]

    def on_written(self) -> None:
        """The form's list makes a system file."""
        self._is_written = True
        self.message.setText("")
        self.message.hide()
        self.changed.emit()

    def show_error(self, sentence: str) -> None:
        """Why the form's file could not be written."""
        self._is_written = False
        self.message.setText(sentence)
        self.message.show()
        self.changed.emit()

    def _profile(self, row: int) -> str:
        box = self.table.cellWidget(row, KIND)
        assert isinstance(box, QComboBox)
        return "" if box.currentText() == NO_KIND else box.currentText()

    def _cell(self, row: int, column: int) -> str:
        item = self.table.item(row, column)
        return "" if item is None else item.text().strip()

    def _kinds(self) -> QComboBox:
        box = QComboBox()
        box.addItem(NO_KIND)
        for name, machine in self._profiles.items():
            box.addItem(name)
            box.setItemData(box.count() - 1, machine, Qt.ItemDataRole.ToolTipRole)
        box.currentIndexChanged.connect(lambda _: self._settle.start())
        return box

    def _remove_row(self) -> None:
        if self.table.rowCount() > 1:
            self.table.removeRow(self.table.currentRow() if self.table.currentRow() >= 0 else self.table.rowCount() - 1)
            self._settle.start()

    def _ask_for_file(self) -> None:
        if self.kind.currentText() == FORM and self.form_file.text().strip():
            self._is_written = False
            self.wants_file.emit(self.rows(), self._listed.tried)

    def _ask_name(self) -> None:
        name, _ = QFileDialog.getOpenFileName(self, "System file", str(Path.cwd()), "System files (*.toml)")
        if name:
            self.file.setText(name)

    def _on_kind(self, index: int) -> None:
        self._pages.setCurrentIndex(index)
        self._pages.setVisible(index > 0)
        page = self._pages.widget(index)
        self._pages.setFixedHeight(page.sizeHint().height() if index and page is not None else 0)
        if self.kind.currentText() == FORM and not self.table.rowCount():
            self.add_row()
        elif self.kind.currentText() == FORM:
            self._settle.start()
        self.changed.emit()

    def _lay_out(self) -> None:
        here, file, form = QWidget(), QWidget(), QWidget()
        row = QHBoxLayout(file)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.file)
        row.addWidget(self.browse)
        column, buttons = QVBoxLayout(form), QHBoxLayout()
        column.setContentsMargins(0, 0, 0, 0)
        for widget in (self.add, self.remove):
            buttons.addWidget(widget)
        buttons.addWidget(self.form_file, stretch=1)
        column.addWidget(self.table)
        column.addLayout(buttons)
        column.addWidget(self.message)
        for page in (here, file, form):
            self._pages.addWidget(page)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.kind)
        layout.addWidget(self._pages)


def _number(text: str, *, whole: bool = False) -> object:
    """A number of a cell, None for an empty one; the text where it is none, to be refused by
    name."""
    try:
        return (int(text) if whole else float(text)) if text else (1 if whole else None)
    except ValueError:
        return text
