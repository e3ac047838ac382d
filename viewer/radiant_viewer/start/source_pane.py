"""What is chosen or dropped, what it is, and where its photographs were taken. Needs the `desktop`
extra."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFileDialog, QFrame, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from radiant_viewer.host.canvas import Canvas
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.themes import Theme

NOTHING = (
    "Drop a folder here: photographs, a film, an alignment of another program, a run. "
    "Or a file: a film, waypoints of a flight (CSV, GeoJSON, KML), a model."
)
FILES = "Films, waypoints, models, plans (*)"
HERE = "Places of photographs are shown here"
NO_PLACES = "Nothing says yet where the photographs were taken: the run places them."


class SourcePane(QFrame):
    """`chosen` carries the path that was dropped or named."""

    chosen = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.path: Path | None = None
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setAcceptDrops(False)
        self.folder, self.file = QPushButton("Choose folder…"), QPushButton("Choose file…")
        self.folder.setToolTip("Photographs, a COLMAP project, an alignment, films or a run (Ctrl+O)")
        self.folder.clicked.connect(self.ask_folder)
        self.file.clicked.connect(self.ask_file)
        self.text, self.notes = QLabel(NOTHING), QLabel("")
        self.notes.setProperty("soft", "true")
        for label in (self.text, self.notes):
            label.setWordWrap(True)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setTextFormat(Qt.TextFormat.PlainText)
        row = QHBoxLayout()
        row.addWidget(self.folder)
        row.addWidget(self.file)
        row.addStretch(1)
        layout = QVBoxLayout(self)
        layout.addLayout(row)
        layout.addWidget(self.text)
        layout.addWidget(self.notes)
        self.notes.hide()

    def choose(self, path: Path) -> None:
        """Take a path, whatever it is."""
        self.path = path
        self.text.setText(f"Looking at {path} …")
        self.notes.hide()
        self.chosen.emit(path)

    def ask_folder(self) -> None:
        """Ask for a folder."""
        if name := QFileDialog.getExistingDirectory(self, "Photographs", str(Path.cwd())):
            self.choose(Path(name))

    def ask_file(self) -> None:
        """Ask for a file."""
        name, _ = QFileDialog.getOpenFileName(self, "Film, waypoints or model", str(Path.cwd()), FILES)
        if name:
            self.choose(Path(name))

    def show_found(self, source: dict[str, Any]) -> None:
        """Say what the chosen path is."""
        self.text.setText(f"{self.path}: {source['title']}.")
        notes = "\n".join(source["notes"])
        self.notes.setText(notes)
        self.notes.setVisible(bool(notes))

    def show_error(self, sentence: str) -> None:
        """Say why nothing can be done with it."""
        self.text.setText(sentence)
        self.notes.hide()


class PlacesMap(QWidget):
    """A map of the places where photographs were or will be taken."""

    def __init__(self) -> None:
        super().__init__()
        self.canvas = Canvas(self, "Map", is_map=True, origin=np.zeros(3))
        self._places, self._places_are = np.zeros((0, 3)), ""
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.canvas.frame)
        self._show_scale(is_shown=False)
        self.canvas.note.setText(HERE)

    def show_places(self, places: np.ndarray, places_are: str, unit: str) -> None:
        """Show places (P,2) and fit them; nothing for none of them."""
        self._places = np.column_stack([places, np.zeros(len(places))]) if len(places) else np.zeros((0, 3))
        self._places_are = places_are
        if not len(places):
            self.canvas.remove("Places")
            self.canvas.note.setText(NO_PLACES if places_are else HERE)
            self._show_scale(is_shown=False)
            self.canvas.plotter.update()
            return
        spread = f"{np.ptp(places[:, 0]):,.0f} × {np.ptp(places[:, 1]):,.0f} {unit}"
        self.canvas.note.setText(f"{len(places):,} places by the {places_are}, {spread}")
        self._draw()
        self._show_scale(is_shown=True)
        self.fit()

    def set_theme(self, theme: Theme) -> None:
        """Draw the places in the accent of a theme, which stands out from its ground."""
        self.canvas.set_theme(theme)
        if len(self._places):
            self._draw()
            self.canvas.plotter.update()

    def _draw(self) -> None:
        color = self.canvas.theme.accent
        layer = Layer(
            name="Places",
            points=self._places,
            point_colors=np.tile(np.array(color, np.uint8), (len(self._places), 1)),
            point_size_px=8,
            point_rim=len(self._places) < 2000,
            legend=(LegendEntry(text=self._places_are, color=color, marker="dot"),),
        )
        self.canvas.draw(layer, 0)

    def fit(self) -> None:
        """Fit the places into the map."""
        if len(self._places):
            self.canvas.fit(self._places)
            self.canvas.plotter.update()

    def _show_scale(self, *, is_shown: bool) -> None:
        """A map of nothing has no scale."""
        self.canvas.scale_bar.setVisible(is_shown)

    def close_view(self) -> None:
        """Close the view before Qt destroys its window under VTK."""
        self.canvas.plotter.close()
