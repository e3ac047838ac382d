"""Measuring in the 3D view with σ, and the map's orthophoto. Needs the `desktop` extra.

Clicks make the places of a measure, and what they measure by the rendered picture stands there at
once (`quick_measure`). `radiant measure` keeps it with a finished run by the run's surface, which a
process of its own makes once, from the first click on. The table shows all that is kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QDockWidget,
    QFileDialog,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.measures_file import figures_text, load_measures
from radiant_core.survey.run_map import map_of_run
from radiant_viewer.docks.ortho_job import OrthoJob
from radiant_viewer.host.line_process import LineProcess
from radiant_viewer.host.place_tool import PlaceTool
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.layer import Label
from radiant_viewer.layers.measure_layer import CLICKED, CLOSED, SAVED, clicked_layer, kept_layer
from radiant_viewer.runs.quick_measure import quick_text
from radiant_viewer.runs.run_feeds import SurveyCommands
from radiant_viewer.runs.run_view import RunView

LEAST: dict[str, int] = {"distance": 2, "height": 2, "area": 3, "volume": 3, "profile": 2}
HINT = "Choose what to measure, click places in the 3D view or on the map; 'Measure' (Shift+M) keeps it with σ by the surface."
WITHOUT_MODEL = "Lengths and areas are shown as you click; a finished run keeps measures, with σ by its surface."
PREPARING = "Preparing the surface"
FIELD_PX = 110


class SurveyDock(QDockWidget):
    """Measures of a run, None of a model alone; kept where it has a finished model. Clicks on the
    map are at the height `ground`, lengths in `unit`."""

    def __init__(self, host: Host, run: RunView | None, commands: SurveyCommands | None, ground: float, unit: str) -> None:
        super().__init__("Measures")
        self.setObjectName("measures")
        self._host, self._run, self._unit = host, run, unit
        self._map = None if run is None else map_of_run(run.folder, run.scene.frame)
        self._sent: list[str] = []
        """What is not answered yet, in order."""
        self._quick = ""
        self._is_prepared = False
        can_measure = self._can_measure = commands is not None and run is not None and run.model is not None and not run.is_growing
        self.process = LineProcess(self, commands.measuring if commands is not None else ())
        self.ortho = OrthoJob(host, self, Path() if run is None else run.folder, commands)
        self.tool = PlaceTool(host, ground, self._on_points)
        self.kind, self.name, self.base = QComboBox(), QLineEdit(), QLineEdit()
        self.kind.addItems(get_args(MeasureKind))
        self.name.setPlaceholderText("name")
        self.base.setPlaceholderText("base height")
        self.base.setToolTip("Of a volume: a level plane at this height, else the plane that fits its corners")
        self.click, self.measure = QPushButton("Click places"), QPushButton("Measure")
        self.remove, self.export = QPushButton("Remove"), QPushButton("Export…")
        self.click.setCheckable(True)
        self.click.setToolTip("Clicks in both views add places; Backspace takes the last one back")
        self.text = QLabel(HINT if can_measure else WITHOUT_MODEL)
        self.text.setWordWrap(True)
        self.table = QTableWidget(0, 2)
        self.table.setHorizontalHeaderLabels(["Measure", "Figures with their standard deviation"])
        self._lay_out()
        for widget in (self.name, self.base, self.measure, self.remove, self.export, self.ortho.button):
            widget.setEnabled(can_measure)
        self._connect()
        self.show_kept()

    @property
    def is_measuring(self) -> bool:
        """Whether the answer to a measure, a removal or an export is awaited."""
        return any(doing != PREPARING for doing in self._sent)

    @property
    def is_busy(self) -> bool:
        """Whether places are being clicked, or something is being made."""
        return self.tool.is_active or self.is_measuring or self.ortho.is_running

    def show_kept(self) -> None:
        """Show the measures that are kept now, in the table and in both views."""
        if self._run is None or self._map is None:
            return
        try:
            measures = load_measures(self._run.folder)
        except RadiantError as error:
            self.text.setText(str(error))
            measures = {}
        self.table.setRowCount(len(measures))
        for number, (name, row) in enumerate(measures.items()):
            for column, cell in enumerate((name, figures_text(row))):
                self.table.setItem(number, column, QTableWidgetItem(cell))
        if measures:
            self._host.draw_mark(kept_layer(measures, self._map))
        else:
            self._host.remove_mark(SAVED)
        self._host.render_views()

    def take(self) -> None:
        """Measure at the clicked places; BadInput where there are too few or too many, or nothing
        is kept."""
        if not self._can_measure:
            raise BadInput(WITHOUT_MODEL)
        kind, points = self.kind.currentText(), self.tool.points
        if len(points) < LEAST[kind]:
            raise BadInput(f"{kind} takes {LEAST[kind]} places or more, and {len(points)} are clicked so far.")
        if kind == "height" and len(points) > LEAST[kind]:
            raise BadInput(f"height is from one place to another, and there are {len(points)}: Backspace takes the last one back.")
        request = {
            "measure": kind,
            "points": [[None if value != value else value for value in point] for point in points.tolist()],
            "eyes": self.tool.eyes.tolist(),
            "name": self.name.text().strip() or None,
            "base": self._base_height() if kind == "volume" else None,
        }
        self._send(request, f"Measuring: {kind}…")

    def remove_chosen(self) -> None:
        """Take the measure of the chosen row out; BadInput without one."""
        item = self.table.item(self.table.currentRow(), 0)
        if item is None:
            raise BadInput("no measure is chosen: click its row in the table.")
        self._send({"remove": item.text()}, "Removing…")

    def export_to(self, path: Path) -> None:
        """Write all that is kept as .geojson or .csv."""
        self._send({"export": str(path)}, f"Writing {path.name}…")

    def end(self) -> None:
        """Stop the processes."""
        self.process.end()
        self.ortho.end()

    def _base_height(self) -> float | None:
        text = self.base.text().strip()
        try:
            return float(text) if text else None
        except ValueError:
            raise BadInput(f"{text!r} is no height of a base: give a number, or nothing.") from None

    def _send(self, request: dict[str, Any], doing: str) -> None:
        if self.is_measuring:
            raise BadInput("something is being measured: wait for it.")
        self._sent.append(doing)
        self.text.setText(doing)
        self.process.send(request)

    def _prepare(self, active: bool) -> None:
        """Make the surface while places are being clicked: half a minute for the first measure."""
        if active and self._can_measure and not self._is_prepared:
            self._is_prepared = True
            self._sent.append(PREPARING)
            self.process.send({"prepare": True})

    def _on_answer(self, answer: dict[str, Any]) -> None:
        # They come in the order of their requests.
        doing = self._sent.pop(0) if self._sent else ""
        if doing == PREPARING:
            # What is wrong with the surface the first measure says.
            return
        if "error" in answer:
            self.text.setText(answer["error"])
            self._host.show_status(answer["error"])
            return
        self.show_kept()
        self.name.clear()
        if doing.startswith("Measuring"):
            self.tool.clear()
            rows = [row for row in range(self.table.rowCount()) if self._cell(row, 0) == answer["name"]]
            self.table.selectRow(rows[-1] if rows else -1)
            self.text.setText("; ".join(f"{self._cell(row, 0)}: {self._cell(row, 1)}" for row in rows))
            self._host.show_status(self.text.text())
        else:
            self.text.setText(f"{doing.removesuffix('…')}: done.")

    def _cell(self, row: int, column: int) -> str:
        item = self.table.item(row, column)
        return "" if item is None else item.text()

    def _on_ended(self, _: bool, words: str) -> None:
        self._sent.clear()
        self._is_prepared = False
        self.text.setText(f"Measuring ended: {words}")

    def _on_said(self, words: str) -> None:
        if self.is_measuring:
            self.text.setText(" ".join(filter(None, (self._quick, self._sent[-1], words))))

    def _on_points(self) -> None:
        # Asked for while the dock is made.
        kind = self.kind.currentText() if hasattr(self, "kind") else ""
        self._quick = ""
        if len(self.tool.points):
            cameras = None if self._run is None else self._run.scene.cameras
            self._quick = quick_text(kind, self.tool.points, cameras, self._unit)
            label = (Label(text=self._quick.partition(";")[0], position=self.tool.grounded_points[-1]),) if self._quick else ()
            self._host.draw_mark(clicked_layer(self.tool.grounded_points, closed=kind in CLOSED, labels=label))
            words = self._quick or f"{len(self.tool.points)} places of {kind}"
            self.text.setText(words)
            keeps = ", Shift+M keeps it" if self._can_measure else ""
            self._host.show_status(f"{words}. Backspace takes the last place back{keeps}")
        else:
            self._host.remove_mark(CLICKED)
        self._host.render_views()

    def _connect(self) -> None:
        self.click.toggled.connect(self.tool.set_active)
        self.click.toggled.connect(self._prepare)
        self.kind.currentIndexChanged.connect(lambda _: self._on_points())
        self.measure.clicked.connect(lambda: self._host.attempt(self.take))
        self.remove.clicked.connect(lambda: self._host.attempt(self.remove_chosen))
        self.export.clicked.connect(self._ask_export)
        self.process.answered.connect(self._on_answer)
        self.process.message.connect(self._on_said)
        self.process.ended.connect(self._on_ended)

    def _ask_export(self) -> None:
        path, _ = QFileDialog.getSaveFileName(
            self, "Export measures", str(Path.cwd() / "measures.geojson"), "GeoJSON (*.geojson);;CSV (*.csv)"
        )
        if path:
            self._host.attempt(lambda: self.export_to(Path(path)))

    def _lay_out(self) -> None:
        row = QHBoxLayout()
        for widget in (self.kind, self.click, self.name, self.base, self.measure, self.remove, self.export):
            row.addWidget(widget)
        for field in (self.name, self.base):
            field.setMaximumWidth(FIELD_PX)
        row.addStretch(1)
        row.addWidget(self.ortho.button)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.verticalHeader().hide()
        self.table.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        self.table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeMode.Stretch)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(row)
        layout.addWidget(self.text)
        layout.addWidget(self.table, stretch=1)
        self.setWidget(body)
