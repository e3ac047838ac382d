"""The photograph of the selected camera; if held out, with render and difference under a wipe.

A render is as the photograph would have been, in the light that is predicted for it; "Canonical" is
the same in the model's own light, where light is modelled.

Held-out photographs are visited worst first. For a photograph that is not on this machine, a
sentence names its device. Needs the `desktop` extra.
"""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QDockWidget, QHBoxLayout, QLabel, QSlider, QToolButton, QVBoxLayout, QWidget

from radiant_core.errors import BadInput
from radiant_viewer.host.picture_label import PictureLabel
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.images import Image, load_image
from radiant_viewer.runs.photo_access import find_photograph
from radiant_viewer.runs.photo_reasons import reason_text
from radiant_viewer.runs.run_figures import FIGURES, ImageFigures
from radiant_viewer.runs.run_view import RunView, canonical_path, comparison_paths

PAIRS = (("Photograph", "Render"), ("Photograph", "Difference"), ("Render", "Difference"), ("Render", "Canonical"))
SINGLES = ("Photograph", "Render", "Difference", "Canonical")
NO_FIGURES = "No photograph has figures yet: finish the run, or evaluate it."
STEPS = 1000
ZOOM_PX = 46
SEPARATOR, WHOLE = "   ·   ", 40
"""Parts of a line of figures, up to this many characters, are not broken: a figure stays beside its
name."""


class PhotoDock(QDockWidget):
    """Shows the selected photograph."""

    def __init__(self, host: Host, run: RunView, figures: ImageFigures) -> None:
        super().__init__("Photograph")
        self.setObjectName("photograph")
        self._host, self._run, self._figures = host, run, figures
        psnr_db = run.psnr_db or {}
        self.worst_first = sorted(psnr_db, key=lambda name: psnr_db[name])
        self._pictures: dict[str, Image] = {}
        self.at = ""
        """Name of the photograph on show."""
        self.name = QLabel("No camera selected")
        self.name.setStyleSheet("font-weight: 600")
        self.name.setSizePolicy(self.name.sizePolicy().horizontalPolicy().Ignored, self.name.sizePolicy().verticalPolicy())
        self.previous, self.next, self.worst = QToolButton(), QToolButton(), QToolButton()
        for button, text in ((self.previous, "‹ Worse"), (self.next, "Better ›"), (self.worst, "Worst")):
            button.setText(text)
        self.previous.setToolTip("The next worse held-out photograph (Alt+Left)")
        self.next.setToolTip("The next better held-out photograph (Alt+Right)")
        self.worst.setToolTip("The held-out photograph with the lowest PSNR (W)")
        self.previous.clicked.connect(lambda: self.step(-1))
        self.next.clicked.connect(lambda: self.step(1))
        self.worst.clicked.connect(self.show_worst)
        self.mode = QComboBox()
        self.mode.addItems([*(" | ".join(pair) for pair in PAIRS), *SINGLES])
        self.mode.setToolTip(
            "Which pictures are wiped against each other, or which one is shown alone. Render: as the photograph would have been; "
            "canonical: in the light of the model"
        )
        self.mode.currentIndexChanged.connect(self._show)
        self.picture = PictureLabel()
        self.picture.message = "Select a camera in the table or in a view."
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, STEPS)
        self.slider.setValue(STEPS // 2)
        self.slider.setToolTip("Where the left picture ends; it can be dragged in the picture too")
        self.slider.valueChanged.connect(lambda value: self.picture.set_share(value / STEPS))
        self.picture.wiped.connect(lambda share: self.slider.setValue(round(share * STEPS)))
        self.zoom = QToolButton()
        self.zoom.setText("–")
        self.zoom.setToolTip(
            "How large the photograph is shown. Click, or a double click in it: the whole picture, or 100 %, a pixel of the photograph "
            "for one of the screen. The wheel zooms to the pointer, the right button moves"
        )
        # A text that grows would widen the dock, and move the views.
        self.zoom.setFixedWidth(ZOOM_PX)
        self.zoom.clicked.connect(self.picture.toggle_zoom)
        self.picture.zoomed.connect(lambda zoom: self.zoom.setText(f"{100 * zoom:.0f} %"))
        self.figures_text = QLabel("")
        self.figures_text.setWordWrap(True)
        self.reasons_text = QLabel("")
        self.reasons_text.setWordWrap(True)
        self.reasons_text.setProperty("soft", "true")
        self.reasons_text.setToolTip("What this camera saw, beside the middle one of all: few points or a rare tilt make a render worse")
        self._lay_out()
        self._set_enabled(False)

    def show_camera(self, index: int) -> None:
        """Show photograph `index` of `RunView.photographs`, with its comparison if there is one."""
        name = self._run.photographs[index]
        self.at = name
        file = self._run.files.get(name)
        self.name.setText(name if file is None else f"{file} ({name})")
        self.name.setToolTip(self.name.text())
        self._pictures, apart = self._comparison(name)
        message = ""
        if not self._pictures:
            answer = find_photograph(self._run, index)
            message = " ".join(sentence for sentence in (answer.reason, apart) if sentence)
            if answer.path is not None:
                try:
                    self._pictures = {"Photograph": load_image(answer.path)}
                except BadInput as error:
                    message = str(error)
        self.picture.message = message
        self._set_enabled(len(self._pictures) > 1)
        self._show()
        self.figures_text.setText(_unbroken(self._text(name)))
        self.reasons_text.setText(_unbroken(self._reasons(index, apart if self._pictures else "")))

    def show_worst(self) -> None:
        """Select the held-out photograph with the lowest PSNR and show why it is the worst."""
        if not self.worst_first:
            self._host.show_status(NO_FIGURES)
            return
        self._host.select_camera(self.worst_first[0])
        self.show()
        self.raise_()

    def step(self, by: int) -> None:
        """Move by `by` held-out photographs towards better ones."""
        if not self.worst_first:
            self._host.show_status(NO_FIGURES)
            return
        at = self.worst_first.index(self.at) + by if self.at in self.worst_first else 0
        self._host.select_camera(self.worst_first[int(np.clip(at, 0, len(self.worst_first) - 1))])

    def _comparison(self, name: str) -> tuple[dict[str, Image], str]:
        """Return the three pictures by name, none for a training camera; with a sentence where they
        are on another machine."""
        if name not in (self._run.psnr_db or {}):
            return {}, ""
        try:
            paths = comparison_paths(self._run, name)
            canonical = canonical_path(self._run, name)
            # Where light is not modelled, a render is canonical.
            kinds = zip(SINGLES, (*paths, canonical or paths[1]), strict=True)
            return {kind: load_image(path) for kind, path in kinds}, ""
        except BadInput as error:
            # Where photographs are pooled, the preview names the device.
            return {}, f"{str(error)[0].upper()}{str(error)[1:]}" if self._run.in_field else ""

    def _reasons(self, index: int, apart: str) -> str:
        if index < len(self._run.scene.cameras):
            return reason_text(self._run.scene, index)
        return f"{apart} The place of its camera stayed with device {self._run.owner(index)}, too.".strip()

    def _show(self) -> None:
        mode = self.mode.currentIndex()
        wanted = PAIRS[mode] if mode < len(PAIRS) else (SINGLES[mode - len(PAIRS)],)
        pictures = self._pictures
        if not pictures:
            self.picture.show_picture(None, message=self.picture.message)
        elif len(pictures) == 1:
            self.picture.show_picture(pictures["Photograph"], names=("Photograph", ""))
        elif len(wanted) == 1:
            self.picture.show_picture(pictures[wanted[0]], names=(wanted[0], ""))
        else:
            self.picture.show_picture(pictures[wanted[0]], pictures[wanted[1]], names=(wanted[0], wanted[1]))
        self.slider.setEnabled(len(pictures) > 1 and len(wanted) == 2)

    def _text(self, name: str) -> str:
        values = self._figures.get(name, {})
        parts = [
            f"{figure.heading.replace(' (dB)', '')} {values[figure.key]:.{figure.decimals}f}{' dB' * ('(dB)' in figure.heading)}"
            for figure in FIGURES
            if figure.key in values
        ]
        if name in self.worst_first:
            parts.insert(0, f"{_rank_text(self.worst_first.index(name) + 1)} of {len(self.worst_first)}")
        return SEPARATOR.join(parts) or "Trained on: figures are measured on held-out photographs."

    def _set_enabled(self, compares: bool) -> None:
        self.mode.setEnabled(compares)
        self.slider.setEnabled(compares)

    def _lay_out(self) -> None:
        top, bottom = QHBoxLayout(), QHBoxLayout()
        top.addWidget(self.name, stretch=1)
        for button in (self.worst, self.previous, self.next):
            top.addWidget(button)
        bottom.addWidget(self.mode)
        bottom.addWidget(self.zoom)
        bottom.addWidget(self.slider, stretch=1)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(4, 2, 4, 4)
        layout.addLayout(top)
        layout.addWidget(self.picture, stretch=1)
        layout.addLayout(bottom)
        layout.addWidget(self.figures_text)
        layout.addWidget(self.reasons_text)
        self.setWidget(body)
        self.figures_text.setToolTip("\n".join(f"{figure.heading}: {figure.meaning}" for figure in FIGURES))


def _unbroken(text: str) -> str:
    """A line whose short parts stay whole where it is wrapped."""
    return SEPARATOR.join(part.replace(" ", "\u00a0") if len(part) <= WHOLE else part for part in text.split(SEPARATOR))


def _rank_text(rank: int) -> str:
    return "worst" if rank == 1 else f"{rank}. worst"
