"""The part of the cleaning that chooses Gaussians in the 3D view by lasso and brush. Needs the
`desktop` extra."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtWidgets import QCheckBox, QHBoxLayout, QLabel, QPushButton, QSpinBox, QWidget

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import SelectionStep
from radiant_viewer.host.one_tool import keep_one_on
from radiant_viewer.host.protocols import Host
from radiant_viewer.host.select_tool import USUAL_RADIUS_PX, Mode, SelectTool
from radiant_viewer.layers.layer import Layer
from radiant_viewer.runs.cleaning_session import CleaningSession

CHOSEN, COLOR, MOST_SHOWN = "Chosen", (255, 140, 0), 30_000
BUTTON_PX = 84
HINT = "drag in the 3D view to choose, Ctrl and drag to take away, right button and wheel move the view; Backspace takes a stroke back"


class SelectRow(QWidget):
    """`add` makes a step of the cleaning of what is chosen."""

    def __init__(self, host: Host, session: CleaningSession, add: Callable[[SelectionStep], None]) -> None:
        super().__init__()
        self._host, self._session, self._add = host, session, add
        self.tool = SelectTool(host.view, lambda: session.model.whole.means)
        self.tool.changed.connect(self.show_chosen)
        self.lasso, self.brush = QPushButton("Lasso"), QPushButton("Brush")
        self.radius, self.through = QSpinBox(), QCheckBox("Through")
        self.clear, self.keep, self.leave_out = QPushButton("Clear"), QPushButton("Keep only"), QPushButton("Leave out")
        self.count = QLabel("")
        self.count.setProperty("soft", "true")
        self.lasso.setToolTip(f"Lasso (L): {HINT}")
        self.brush.setToolTip(f"Brush (Shift+L): {HINT}")
        self.through.setToolTip("Choose through the whole depth, not only what is seen in front")
        self.clear.setToolTip("Choose nothing (Escape)")
        self.leave_out.setToolTip("A step that leaves the chosen ones out (Delete)")
        self.keep.setToolTip("A step that leaves all others out: the selection inverted")
        self.radius.setRange(2, 300)
        self.radius.setValue(USUAL_RADIUS_PX)
        self.radius.setSuffix(" px")
        self._connect()
        self._lay_out()
        self.show_chosen()

    @property
    def is_active(self) -> bool:
        """Whether drags choose."""
        return bool(self.tool.mode)

    def make_step(self, *, keeps: bool = False) -> None:
        """Leave out what is chosen, or all else; BadInput where nothing is chosen."""
        if not self.tool.chosen.any():
            raise BadInput("nothing is chosen: press Lasso or Brush and drag in the 3D view.")
        step = SelectionStep(strokes=self.tool.strokes, keep="inside" if keeps else "outside")
        self._add(step)
        self.tool.clear()

    def end(self) -> None:
        """Choose nothing, and leave drags to the view."""
        for button in (self.lasso, self.brush):
            button.setChecked(False)
        self.tool.clear()

    def show_chosen(self) -> None:
        """Mark what is chosen in both views, and count it."""
        chosen = self.tool.chosen
        keep_mask = self._session.model.cleaned.kept
        rows = np.flatnonzero(chosen & keep_mask) if len(chosen) == len(keep_mask) else np.zeros(0, np.int64)
        for button in (self.clear, self.keep, self.leave_out):
            button.setEnabled(len(rows) > 0)
        self.count.setText(f"{len(rows):,} chosen" if self.tool.strokes else "")
        if not len(rows):
            self._host.remove_mark(CHOSEN)
        else:
            marked_rows = rows[:: 1 + len(rows) // MOST_SHOWN]
            places = self._session.model.whole.means[marked_rows].astype(np.float64)
            colors = np.tile(np.array(COLOR, np.uint8), (len(marked_rows), 1))
            self._host.draw_mark(Layer(name=CHOSEN, points=places, point_colors=colors, point_size_px=3, in_front=True))
        self._host.render_views()

    def _set_mode(self) -> None:
        mode: Mode = "lasso" if self.lasso.isChecked() else "brush" if self.brush.isChecked() else ""
        self.tool.set_mode(mode)
        if mode:
            self._host.show_status(f"{mode.capitalize()}: {HINT}")

    def _connect(self) -> None:
        for button in (self.lasso, self.brush):
            button.setCheckable(True)
            button.toggled.connect(lambda _: self._set_mode())
        keep_one_on([self.lasso, self.brush])
        self.radius.valueChanged.connect(lambda radius: setattr(self.tool, "radius_px", radius))
        self.through.toggled.connect(lambda on: setattr(self.tool, "is_through", on))
        self.clear.clicked.connect(self.tool.clear)
        self.keep.clicked.connect(lambda: self._host.attempt(lambda: self.make_step(keeps=True)))
        self.leave_out.clicked.connect(lambda: self._host.attempt(self.make_step))

    def _lay_out(self) -> None:
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(4)
        for widget in (QLabel("In 3D"), self.lasso, self.brush, self.radius, self.through, self.count):
            row.addWidget(widget)
        row.addStretch(1)
        for widget in (self.clear, self.leave_out, self.keep):
            row.addWidget(widget)
        for button in (self.lasso, self.brush, self.clear, self.leave_out, self.keep):
            button.setMaximumWidth(BUTTON_PX)
