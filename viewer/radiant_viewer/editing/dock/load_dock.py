"""The table of edges and their devices with a bar for each load. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRect, QSignalBlocker, Qt
from PySide6.QtGui import QColor, QPainter
from PySide6.QtWidgets import QDockWidget, QHeaderView, QStyledItemDelegate, QStyleOptionViewItem, QTreeWidget, QTreeWidgetItem

from radiant_viewer.editing.model.plan_report import LoadRow
from radiant_viewer.layers.palette import category_colors, tint
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.runs.words import tip

NAME, CAMERAS, TIME, LOAD, NOTE = range(5)
TERMS = {NAME: ("edge", "device"), TIME: ("makespan",), LOAD: ("load", "makespan"), NOTE: ("locked", "pinned", "holds")}
"""Column → the words that its hover explains."""
SHARE_ROLE, COLOR_ROLE = Qt.ItemDataRole.UserRole, Qt.ItemDataRole.UserRole + 1


class LoadDock(QDockWidget):
    """One row per edge, its devices below; `chosen` receives edge and device of a selected row."""

    def __init__(self, chosen: Callable[[str, str | None], None]) -> None:
        super().__init__("Edges and devices")
        self.setObjectName("loads")
        self._chosen = chosen
        self.tree = QTreeWidget()
        self.tree.setHeaderLabels(["Edge, device", "Cameras", "Time", "Load (share of the makespan)", "Note"])
        for column, terms in TERMS.items():
            self.tree.headerItem().setToolTip(column, tip(*terms))
        self.tree.setAlternatingRowColors(True)
        self.tree.setIndentation(16)
        self.tree.setItemDelegateForColumn(LOAD, _LoadBar(self.tree))
        header = self.tree.header()
        header.setStretchLastSection(True)
        header.setSectionResizeMode(NAME, QHeaderView.ResizeMode.ResizeToContents)
        header.resizeSection(LOAD, 300)
        self.tree.currentItemChanged.connect(self._on_current)
        self._rows: tuple[LoadRow, ...] = ()
        self._items: list[QTreeWidgetItem] = []
        self.setWidget(self.tree)

    def show_rows(self, rows: Sequence[LoadRow]) -> None:
        """Show these loads; expanded and selected rows are kept."""
        if [(row.name, row.is_edge) for row in rows] != [(row.name, row.is_edge) for row in self._rows]:
            self._rebuild(rows)
        self._rows = tuple(rows)
        # A signal per cell makes Qt measure all columns: 12 ms per frame of a drag with 16 edges.
        with QSignalBlocker(self.tree.model()):
            self._fill(rows)
        for column in (CAMERAS, TIME):
            self.tree.resizeColumnToContents(column)
            # Before the window is shown, Qt measures the headings in a narrower font.
            self.tree.setColumnWidth(column, self.tree.columnWidth(column) + 8)
        self.tree.viewport().update()

    def _fill(self, rows: Sequence[LoadRow]) -> None:
        colors = category_colors(sum(row.is_edge for row in rows))
        edge = -1
        for item, row in zip(self._items, rows, strict=True):
            edge += row.is_edge
            red, green, blue = (int(value) for value in (colors[edge] if row.is_edge else tint(colors[edge], (255, 255, 255), 0.45)))
            item.setText(CAMERAS, "" if row.time_s is None else f"{row.num_cameras:,}")
            item.setText(TIME, "" if row.time_s is None else duration_text(row.time_s))
            item.setText(NOTE, row.note)
            item.setData(LOAD, SHARE_ROLE, None if row.time_s is None else row.share)
            item.setData(LOAD, COLOR_ROLE, QColor(red, green, blue))

    def _rebuild(self, rows: Sequence[LoadRow]) -> None:
        self.tree.blockSignals(True)
        self.tree.clear()
        self._items = []
        top: QTreeWidgetItem | None = None
        many = sum(not row.is_edge for row in rows) > 40
        for row in rows:
            item = QTreeWidgetItem([row.name])
            self._items.append(item)
            for column in (CAMERAS, TIME):
                item.setTextAlignment(column, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            if row.is_edge or top is None:
                font = item.font(NAME)
                font.setBold(True)
                item.setFont(NAME, font)
                self.tree.addTopLevelItem(item)
                top = item
            else:
                top.addChild(item)
        for item in self._items:
            item.setExpanded(not many)
        self.tree.blockSignals(False)

    def _on_current(self, item: QTreeWidgetItem | None) -> None:
        if item is not None:
            parent = item.parent()
            self._chosen((parent or item).text(NAME), None if parent is None else item.text(NAME))


class _LoadBar(QStyledItemDelegate):
    """A bar from the left for the share, with its percentage."""

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> None:
        super().paint(painter, option, index)
        share, color = index.data(SHARE_ROLE), index.data(COLOR_ROLE)
        if share is None or color is None:
            return
        cell: QRect = option.rect.adjusted(6, 4, -52, -4)  # type: ignore[attr-defined]
        painter.save()
        painter.setPen(QColor(150, 156, 165))
        painter.drawRect(cell)
        painter.fillRect(cell.adjusted(1, 1, round((cell.width() - 1) * (min(1.0, share) - 1)), 0), color)
        painter.setPen(option.palette.text().color())  # type: ignore[attr-defined]
        place: QRect = option.rect.adjusted(0, 0, -8, 0)  # type: ignore[attr-defined]
        painter.drawText(place, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, f"{share:.0%}")
        painter.restore()
