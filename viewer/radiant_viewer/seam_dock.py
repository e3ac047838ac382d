"""The seam tour: all borders, worst first; each stop flies both views to its worst place. Needs the `desktop` extra."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QHBoxLayout, QHeaderView, QLabel, QPushButton, QTableWidget, QTableWidgetItem, QVBoxLayout, QWidget

from radiant_viewer.layers import Layer, LegendEntry
from radiant_viewer.measure import length_text
from radiant_viewer.palette import VERMILLION
from radiant_viewer.run_view import RunView
from radiant_viewer.seam_tour import SeamStop, seam_stops
from radiant_viewer.views import ground_height
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from radiant_viewer.window import InspectorWindow

HEADINGS = ("", "Border", "Colour step (levels)", "Worst piece (levels)", "Length")
MARK = "Border of the tour"


class SeamDock(QDockWidget):
    """A table of stops with previous and next; `at` is the index of the stop, None before the tour begins."""

    def __init__(self, window: InspectorWindow, run: RunView, stops: tuple[SeamStop, ...]) -> None:
        super().__init__("Seams", window)
        self.setObjectName("seams")
        self._window, self._unit = window, run.unit
        self._ground = ground_height(run.scene)
        self.stops = stops
        self.at: int | None = None
        self.previous, self.next, self.worst = QPushButton("‹ Previous"), QPushButton("Next ›"), QPushButton("Worst seam")
        self.worst.setToolTip("Begin at the border with the strongest colour step (T)")
        self.next.setToolTip("Fly to the next border, the next weaker step (N)")
        self.previous.setToolTip("Fly back to the stronger step (Shift+N)")
        self.worst.clicked.connect(lambda: self.go(0))
        self.next.clicked.connect(lambda: self.step(1))
        self.previous.clicked.connect(lambda: self.step(-1))
        self.text = QLabel("Colour steps across borders, beyond the scene's own texture, in 8-bit levels.")
        self.text.setProperty("soft", "true")
        self.table = self._table()
        row = QHBoxLayout()
        for button in (self.worst, self.previous, self.next):
            row.addWidget(button)
        row.addWidget(self.text, stretch=1)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(row)
        layout.addWidget(self.table)
        self.setWidget(body)

    def step(self, by: int) -> None:
        """Go `by` stops on, from the last to the first again."""
        self.go(0 if self.at is None else (self.at + by) % len(self.stops))

    def go(self, index: int) -> None:
        """Fly both views to stop `index` and mark its border."""
        self.at = index
        stop = self.stops[index]
        self._window.draw_mark(_mark(stop, self._ground))
        self._window.map.center_on(stop.worst, max(stop.length, 1e-6) * 0.4)
        self._window.view.set_pose(stop.view(self._ground))
        self._window.render_views()
        self.table.blockSignals(True)
        self.table.selectRow(index)
        self.table.blockSignals(False)
        self.text.setText(f"{index + 1} of {len(self.stops)}: {stop.title}, {_levels(stop.step_levels)} over its whole length")
        self._window.tell(f"Border {stop.title}: colour step {_levels(stop.step_levels)}, worst piece {_levels(stop.worst_levels)}")

    def _table(self) -> QTableWidget:
        table = QTableWidget(len(self.stops), len(HEADINGS))
        table.setHorizontalHeaderLabels(HEADINGS)
        table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        table.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        table.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        table.verticalHeader().setVisible(False)
        table.verticalHeader().setDefaultSectionSize(21)
        for row, stop in enumerate(self.stops):
            cells = (str(row + 1), stop.title, _number(stop.step_levels), _number(stop.worst_levels), length_text(stop.length, self._unit))
            for column, cell in enumerate(cells):
                item = QTableWidgetItem(cell)
                if column != 1:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                table.setItem(row, column, item)
        table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        table.horizontalHeader().setStretchLastSection(False)
        table.currentCellChanged.connect(lambda row, *_: self.go(row) if row >= 0 else None)
        return table


def seam_dock(window: InspectorWindow, run: RunView) -> SeamDock | None:
    """The dock of a run with a model and two regions or more; None where there is no seam to visit."""
    if run.splats is None or len(run.cloud_plan.edge_ids) < 2:
        return None
    stops = seam_stops(run.cloud_plan, run.splats)
    return SeamDock(window, run, stops) if stops else None


def _mark(stop: SeamStop, height: float) -> Layer:
    ends = np.column_stack([stop.ends, np.full(2, height)])
    return Layer(
        name=MARK,
        segments=ends[None],
        segment_colors=np.array([VERMILLION], np.uint8),
        line_width_px=4,
        points=np.array([[*stop.worst, height]]),
        point_colors=np.array([VERMILLION], np.uint8),
        point_size_px=13,
        point_rim=True,
        in_front=True,
        legend=(LegendEntry(text="Worst place of this border", color=VERMILLION, marker="ring"),),
    )


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "too few Gaussians"


def _levels(value: float) -> str:
    return f"{value:.1f} levels" if np.isfinite(value) else "unknown: too few Gaussians beside it"
