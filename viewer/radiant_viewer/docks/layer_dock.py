"""The layer tree: per layer a box to show it, a box to show it alone, and its legend. Needs the
`desktop` extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from textwrap import fill

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QBrush, QColor, QIcon, QImage, QPainter, QPen, QPixmap
from PySide6.QtWidgets import QDockWidget, QHeaderView, QTreeWidget, QTreeWidgetItem

from radiant_core.errors import BadInput
from radiant_viewer.layers.detail import moving_note
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.palette import GREY, INK, PALE, heat_table
from radiant_viewer.runs.words import LAYER_TERMS, tip

NAME, SOLO = 0, 1
MAX_OPEN_ROWS = 8
ICON_PX, HEAT_PX = 14, 64
LEGEND_COLUMNS = 36
"""Longer legend texts are wrapped: the dock holds some 40 letters in a window of 1280 px."""


class LayerDock(QDockWidget):
    """Calls `changed` when the set of visible layers changes; `is_visible` answers for one."""

    def __init__(self, layers: Sequence[Layer], hidden: frozenset[str], changed: Callable[[], None]) -> None:
        super().__init__("Layers")
        self.setObjectName("layers")
        self._changed = changed
        self.tree = QTreeWidget()
        self.tree.setHeaderLabels(["Layer", "Solo"])
        self.tree.header().setStretchLastSection(False)
        self.tree.header().setSectionResizeMode(NAME, QHeaderView.ResizeMode.Stretch)
        self.tree.header().setSectionResizeMode(SOLO, QHeaderView.ResizeMode.ResizeToContents)
        self.tree.headerItem().setToolTip(SOLO, "Show this layer alone; clear the box to see the others again")
        self.tree.setIndentation(12)
        self.tree.setIconSize(QSize(HEAT_PX, ICON_PX))
        self.tree.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._items: dict[str, QTreeWidgetItem] = {}
        for layer in reversed(layers):
            self._add(layer, visible=layer.name not in hidden)
        self.tree.itemChanged.connect(self._on_item_changed)
        self.setWidget(self.tree)

    def is_visible(self, name: str) -> bool:
        """Whether a layer is shown; marks, which are not in the tree, always are."""
        if name not in self._items:
            return True
        solo = self.solo
        return name == solo if solo is not None else self._items[name].checkState(NAME) == Qt.CheckState.Checked

    @property
    def solo(self) -> str | None:
        """The layer that is shown alone, or None."""
        return next((name for name, item in self._items.items() if item.checkState(SOLO) == Qt.CheckState.Checked), None)

    def checked(self) -> dict[str, bool]:
        """Return for each layer whether its box is ticked."""
        return {name: item.checkState(NAME) == Qt.CheckState.Checked for name, item in self._items.items()}

    def set_visible(self, name: str, visible: bool) -> None:
        """Show or hide a layer, as its check box does; BadInput for an unknown name."""
        self._item(name).setCheckState(NAME, _check_state(visible))

    def set_solo(self, name: str | None) -> None:
        """Show one layer alone, or with None all ticked layers."""
        for layer_name, item in self._items.items():
            if layer_name != name:
                item.setCheckState(SOLO, Qt.CheckState.Unchecked)
        if name is not None:
            self._item(name).setCheckState(SOLO, Qt.CheckState.Checked)

    def update_legend(self, layer: Layer) -> None:
        """Replace the legend of a layer, or add a new layer on top of the tree."""
        if layer.name not in self._items:
            self._add(layer, visible=True, on_top=True)
            return
        item = self._items[layer.name]
        item.takeChildren()
        _add_legend(item, layer)

    def _add(self, layer: Layer, *, visible: bool, on_top: bool = False) -> None:
        item = QTreeWidgetItem([layer.name, ""])
        item.setFlags(item.flags() | Qt.ItemFlag.ItemIsUserCheckable)
        item.setCheckState(NAME, _check_state(visible))
        item.setCheckState(SOLO, Qt.CheckState.Unchecked)
        item.setToolTip(NAME, "\n".join([f"Show or hide {layer.name}", *filter(None, [tip(*LAYER_TERMS.get(layer.name, ()))])]))
        item.setToolTip(SOLO, f"Show {layer.name} alone")
        self._items[layer.name] = item
        # Rows span both columns only once they are in the tree.
        self.tree.insertTopLevelItem(0 if on_top else self.tree.topLevelItemCount(), item)
        _add_legend(item, layer)
        item.setExpanded(visible and len(layer.legend) <= MAX_OPEN_ROWS)

    def _item(self, name: str) -> QTreeWidgetItem:
        if name not in self._items:
            raise BadInput(f"there is no layer {name!r}: use one of {', '.join(self._items)}.")
        return self._items[name]

    def _on_item_changed(self, item: QTreeWidgetItem, column: int) -> None:
        if item.parent() is not None:
            return
        if column == SOLO and item.checkState(SOLO) == Qt.CheckState.Checked:
            self.tree.blockSignals(True)
            for tree_item in self._items.values():
                if tree_item is not item:
                    tree_item.setCheckState(SOLO, Qt.CheckState.Unchecked)
            self.tree.blockSignals(False)
        if column == NAME and item.checkState(NAME) == Qt.CheckState.Checked:
            item.setExpanded(item.childCount() <= MAX_OPEN_ROWS)
        self._grey_out_hidden()
        self._changed()

    def _grey_out_hidden(self) -> None:
        """Write names of layers that are hidden by another one's *Solo* in grey: their ticks stay,
        for they count again afterwards."""
        solo = self.solo
        self.tree.blockSignals(True)
        for name, item in self._items.items():
            item.setForeground(NAME, QBrush() if solo in (None, name) else QColor(*GREY))
        self.tree.blockSignals(False)
        self.tree.viewport().update()


def _add_legend(item: QTreeWidgetItem, layer: Layer) -> None:
    rows = [(entry.text, marker_icon(entry)) for entry in layer.legend]
    if layer.heat is not None:
        rows += [
            (f"{layer.heat.low:.4g} to {layer.heat.high:.4g}", heat_icon(layer.heat.start)),
            (fill(layer.heat.label, LEGEND_COLUMNS), QIcon()),
        ]
    rows += [(note, QIcon()) for note in [moving_note(layer)] if note]
    for text, icon in rows:
        row = QTreeWidgetItem(item, [text])
        row.setIcon(NAME, icon)
        row.setToolTip(NAME, text)
        row.setFirstColumnSpanned(True)


def _check_state(checked: bool) -> Qt.CheckState:
    return Qt.CheckState.Checked if checked else Qt.CheckState.Unchecked


def marker_icon(entry: LegendEntry) -> QIcon:
    """Return the marker of a legend entry: a fill, a stroke, a dot, or a dot with a dark rim."""
    picture = QPixmap(ICON_PX, ICON_PX)
    picture.fill(Qt.GlobalColor.transparent)
    painter = QPainter(picture)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    color, place = QColor(*entry.color), QRectF(1.5, 1.5, ICON_PX - 3, ICON_PX - 3)
    # A grey rim is seen on light and on dark ground.
    painter.setPen(QPen(QColor(*(INK if entry.marker in ("ring", "square") else GREY)), 1.5))
    painter.setBrush(color)
    if entry.marker == "line":
        if min(entry.color) > PALE:
            painter.setPen(QPen(QColor(*GREY), 5))
            painter.drawLine(QPointF(0, ICON_PX / 2), QPointF(ICON_PX, ICON_PX / 2))
        painter.setPen(QPen(color, 3))
        painter.drawLine(QPointF(1, ICON_PX / 2), QPointF(ICON_PX - 1, ICON_PX / 2))
    elif entry.marker in ("dot", "ring"):
        painter.drawEllipse(place.adjusted(1, 1, -1, -1))
    else:
        painter.drawRect(place if entry.marker == "area" else place.adjusted(1.5, 1.5, -1.5, -1.5))
    painter.end()
    return QIcon(picture)


def heat_icon(start: float) -> QIcon:
    """Return the colours of a heat scale from left to right, with a grey rim."""
    icon = np.tile(np.array(GREY, np.uint8), (ICON_PX, HEAT_PX, 1))
    columns = np.linspace(0, 255, HEAT_PX - 2).round().astype(int)
    icon[1:-1, 1:-1] = heat_table(start)[columns]
    return QIcon(QPixmap.fromImage(QImage(icon.tobytes(), HEAT_PX, ICON_PX, 3 * HEAT_PX, QImage.Format.Format_RGB888)))
