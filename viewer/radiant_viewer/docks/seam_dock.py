"""The seam tour: all borders, worst first; a stop moves both views to its worst place. Needs the
`desktop` extra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QDockWidget,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from radiant_core.plan.plans import CloudPlan
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.palette import GREY, VERMILLION, WHITE
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.seam_findings import excess_text, observed_text, step_text
from radiant_viewer.runs.seam_tour import SeamStop, seam_stops

HEADINGS = ("", "Border", "Step (levels)", "Texture", "Median piece", "Worst piece", "Observed", "Verdict")
TIPS = (
    "",
    "",
    "How far the mean colours of both sides differ over all that was observed, beyond the texture; levels of 255",
    "How far they usually differ at lines beside the border, where there is no seam",
    "The middle one of the pieces' steps",
    "The step of the piece that stands out most from the texture around it",
    "Length of the border that two photographs or more show on both sides, with points that they agree on, of its whole length",
    "A step is told where it is at least 10 levels and more than any line beside the border steps",
)
MARK = "Border of the tour"
EDITED_SHORT = "At the run's own borders: edits move no seam"
EDITED = "Measured in the model as it was trained, along the borders of its own plan: an edit moves no seam before the next run."


class SeamDock(QDockWidget):
    """A table of stops; `at` is the index of the present stop, None before the tour begins."""

    def __init__(self, host: Host, run: RunView, stops: tuple[SeamStop, ...]) -> None:
        super().__init__("Seams")
        self.setObjectName("seams")
        self._host, self._unit = host, run.unit
        self._ground = ground_height(run.scene)
        self._measured_borders = run.cloud_plan.borders
        self.stops = stops
        self.at: int | None = None
        self.previous, self.next, self.worst = QPushButton("‹ Previous"), QPushButton("Next ›"), QPushButton("Worst seam")
        self.worst.setToolTip("Begin at the border with the strongest colour step (T)")
        self.next.setToolTip("Fly to the next border, the next weaker step (N)")
        self.previous.setToolTip("Fly back to the stronger step (Shift+N)")
        self.worst.clicked.connect(lambda: self.go(0))
        self.next.clicked.connect(lambda: self.step(1))
        self.previous.clicked.connect(lambda: self.step(-1))
        self.text = QLabel(
            f"Colour steps where borders were observed, beyond the scene's own texture, in levels of 255. {excess_text(run.folder)}"
        )
        self.text.setProperty("soft", "true")
        # A long sentence must not widen the window.
        self.text.setWordWrap(True)
        self.table = self._table()
        self.edited = QLabel(EDITED)
        self.edited.setWordWrap(True)
        self.edited.hide()
        row = QHBoxLayout()
        for button in (self.worst, self.previous, self.next):
            row.addWidget(button)
        row.addWidget(self.text, stretch=1)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(row)
        layout.addWidget(self.edited)
        layout.addWidget(self.table)
        self.setWidget(body)

    def show_plan(self, plan: CloudPlan) -> list[Layer]:
        """Say whether a plan has other borders than those that the seams lie at; returns the layer
        of the seams with a legend that says so too."""
        is_unchanged = len(plan.borders) == len(self._measured_borders) and all(map(np.array_equal, plan.borders, self._measured_borders))
        self.edited.setVisible(not is_unchanged)
        note = () if is_unchanged else (LegendEntry(text=EDITED_SHORT, color=GREY, marker="line"),)
        return [replace(layer, legend=(*layer.legend, *note)) for layer in self._host.layers if layer.name == "Seams"]

    def step(self, by: int) -> None:
        """Move by `by` stops, round from the last to the first."""
        self.go(0 if self.at is None else (self.at + by) % len(self.stops))

    def go(self, index: int) -> None:
        """Move both views to stop `index` and mark its border."""
        self.at = index
        stop = self.stops[index]
        self._host.draw_mark(_mark(stop, self._ground))
        self._host.map.center_on(stop.worst, max(stop.length, 1e-6) * 0.4)
        self._host.view.set_pose(stop.view(self._ground))
        self._host.render_views()
        self.table.blockSignals(True)
        self.table.selectRow(index)
        self.table.blockSignals(False)
        figures = stop.figures
        self.text.setText(f"{index + 1} of {len(self.stops)}: {stop.title}. Verdict: {figures.verdict}")
        part = observed_text(figures.observed_length, stop.length, self._unit)
        self._host.show_status(f"Border {stop.title}: colour step {step_text(figures)}; observed: {part}")

    def _table(self) -> QTableWidget:
        table = QTableWidget(len(self.stops), len(HEADINGS))
        table.setHorizontalHeaderLabels(HEADINGS)
        for column, tip in enumerate(TIPS):
            item = table.horizontalHeaderItem(column)
            assert item is not None
            item.setToolTip(tip)
        table.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        table.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        table.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        table.verticalHeader().setVisible(False)
        table.verticalHeader().setDefaultSectionSize(21)
        for row, stop in enumerate(self.stops):
            for column, cell in enumerate((str(row + 1), *_cells(stop, self._unit))):
                item = QTableWidgetItem(cell)
                if column not in (1, len(HEADINGS) - 1):
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                table.setItem(row, column, item)
        table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        table.horizontalHeader().setStretchLastSection(False)
        table.currentCellChanged.connect(lambda row, *_: self.go(row) if row >= 0 else None)
        return table


def make_seam_dock(host: Host, run: RunView) -> SeamDock | None:
    """Return the dock of a run with a model and borders; None where there is no seam."""
    if run.splats is None or len(run.cloud_plan.edge_ids) < 2:
        return None
    stops = seam_stops(run.scene, run.cloud_plan, run.splats)
    return SeamDock(host, run, stops) if stops else None


def _mark(stop: SeamStop, height: float) -> Layer:
    """Return a disc at the worst place and white ones at the ends: a line would hide the seam."""
    places = np.column_stack([[stop.worst, *stop.ends], np.full(3, height)])
    return Layer(
        name=MARK,
        points=places,
        point_colors=np.array([VERMILLION, WHITE, WHITE], np.uint8),
        point_size_px=11,
        point_rim=True,
        in_front=True,
        legend=(LegendEntry(text="Worst place of this border", color=VERMILLION, marker="ring"),),
    )


def _cells(stop: SeamStop, unit: str) -> tuple[str, ...]:
    figures = stop.figures
    levels = (figures.step_levels, figures.texture_levels, figures.median_levels, stop.worst_levels)
    observed = observed_text(figures.observed_length, stop.length, unit)
    return (stop.title, *(f"{value:.1f}" if np.isfinite(value) else "–" for value in levels), observed, figures.verdict)
