"""The box of the cleaning: hides what lies outside it in all views while it is open, and makes a
step of that. The graphics card clips the clouds, so dragging the box copies no points. Needs the
`desktop` extra."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtWidgets import QCheckBox, QDoubleSpinBox, QFileDialog, QGridLayout, QHBoxLayout, QLabel, QPushButton, QWidget
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkRenderingCore import vtkActor

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import box_step
from radiant_core.numerics import FloatArray
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.layer import CLOUD_SIZE, framing_positions
from radiant_viewer.runs.cleaning_session import CleaningSession

SIDES = (("West", "East"), ("South", "North"), ("Low", "High"))
BUTTON_PX = 96
SHARE = 0.5
"""Share of the scene's extent that the first box holds, per horizontal axis."""


class BoxEditor(QWidget):
    """`box` (2,3): lower and upper corner in the world; it clips only while `active` is ticked."""

    def __init__(self, host: Host, session: CleaningSession | None, unit: str) -> None:
        super().__init__()
        self._host, self._session = host, session
        positions = framing_positions(host.layers)
        self._extent = np.stack([positions.min(axis=0), positions.max(axis=0)])
        self.active = QCheckBox("Box: hide what lies outside")
        self.active.setToolTip("Show and cut by the box; drag its handles in the 3D view, or type its sides (B)")
        self.active.toggled.connect(self._on_toggled)
        self._fields: list[list[QDoubleSpinBox]] = []
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.addWidget(self.active, 0, 0, 1, 4)
        for row, names in enumerate(SIDES):
            fields = [self._field(f"{name} side of the box ({unit})") for name in names]
            self._fields.append(fields)
            for column, (name, field) in enumerate(zip(names, fields, strict=True)):
                grid.addWidget(QLabel(f"{name} ({unit})"), row + 1, 2 * column)
                grid.addWidget(field, row + 1, 2 * column + 1)
        self.count = QLabel("")
        self.count.setProperty("soft", "true")
        self.reset = QPushButton("Reset")
        self.reset.clicked.connect(lambda: self.set_box(self._first_box()))
        self.export = QPushButton("Export PLY…")
        self.export.setToolTip("Save the Gaussians inside the box as a 3DGS PLY, and keep the model as it is")
        self.export.clicked.connect(self._ask_export)
        self.keep = QPushButton("Keep inside")
        self.keep.setToolTip("Leave out of the model what lies outside the box")
        self.keep.clicked.connect(lambda: host.attempt(self.keep_inside))
        for button in (self.export, self.keep):
            button.setEnabled(session is not None)
        buttons = QHBoxLayout()
        for button in (self.reset, self.export, self.keep):
            button.setMaximumWidth(BUTTON_PX)
            buttons.addWidget(button)
        grid.addLayout(buttons, 4, 0, 1, 4)
        grid.addWidget(self.count, 5, 0, 1, 4)
        grid.setRowStretch(6, 1)
        self._widget_box: FloatArray | None = None
        self.set_box(self._first_box())

    @property
    def box(self) -> FloatArray:
        """Lower and upper corner (2,3)."""
        return np.array([[field.value() for field in pair] for pair in self._fields]).T

    @property
    def active_box(self) -> FloatArray | None:
        """The box while it clips, else None."""
        return self.box if self.active.isChecked() else None

    def set_box(self, box: FloatArray) -> None:
        """Set the box from two opposite corners."""
        self._set_fields(np.sort(np.asarray(box, np.float64), axis=0))
        self._apply()

    def apply_to(self, canvas: Canvas) -> None:
        """Clip the clouds that a canvas draws now."""
        planes = self._planes(canvas) if self.active.isChecked() else []
        for layer in self._host.layers:
            if len(layer.points) < CLOUD_SIZE or layer.point_rim:
                continue
            # Labels have no place in space that could be cut.
            for actor in (actor for actor in canvas.actors.get(layer.name, []) if isinstance(actor, vtkActor)):
                mapper = actor.GetMapper()
                mapper.RemoveAllClippingPlanes()
                for plane in planes:
                    mapper.AddClippingPlane(plane)

    def save_inside(self, path: Path) -> int:
        """Write the Gaussians inside the box and return their number; BadInput without any, or if
        the file cannot be written."""
        if self._session is None:
            raise BadInput("this run has no model yet: there is nothing to export.")
        count = self._session.save_kept_by(box_step(self.box), path)
        self._host.show_status(f"Saved {count:,} Gaussians to {path}")
        return count

    def keep_inside(self) -> None:
        """Make a step of the cleaning of the box; BadInput where it holds no Gaussian."""
        if self._session is not None:
            self._session.add(box_step(self.box))
            self.active.setChecked(False)

    def show_count(self) -> None:
        """Say how many Gaussians the box holds."""
        if self._session is None:
            return
        count = len(self._session.model.splats)
        is_empty = bool((np.diff(self.box, axis=0) <= 0).any())
        inside = 0 if is_empty else count - self._session.count(box_step(self.box))
        self.count.setText(f"{inside:,} of {count:,} inside")

    def _first_box(self) -> FloatArray:
        middle, half = self._extent.mean(axis=0), np.ptp(self._extent, axis=0) / 2
        # All heights: a tower cut by the default box would look like a hole.
        shares = np.array([SHARE, SHARE, 1.0])
        return np.stack([middle - shares * half, middle + shares * half])

    def _field(self, tip: str) -> QDoubleSpinBox:
        field = QDoubleSpinBox()
        reach = 10 * float(np.abs(self._extent).max() + 1)
        field.setRange(-reach, reach)
        field.setDecimals(3 if float(np.ptp(self._extent, axis=0).max()) < 20 else 2)
        field.setSingleStep(max(0.01, float(np.ptp(self._extent, axis=0).max()) / 100))
        field.setToolTip(tip)
        field.valueChanged.connect(lambda _: self._apply())
        return field

    def _on_toggled(self, active: bool) -> None:
        self._show_widget(active)
        self._apply()

    def _apply(self) -> None:
        for canvas in (self._host.map, self._host.view):
            self.apply_to(canvas)
        if self.active.isChecked():
            self._show_widget(True)
        self.show_count()
        self._host.render_views()

    def _show_widget(self, active: bool) -> None:
        plotter = self._host.view.plotter
        box = self.box if active else None
        before = self._widget_box
        if (box is None and before is None) or (box is not None and before is not None and np.array_equal(box, before)):
            return
        plotter.clear_box_widgets()
        self._widget_box = box
        if box is not None:
            bounds = (box - self._host.origin).T.ravel()
            plotter.add_box_widget(
                self._on_dragged,
                bounds=bounds,
                factor=1.0,
                rotation_enabled=False,
                color="orange",
                outline_translation=True,
                interaction_event="end",
            )

    def _on_dragged(self, shape: Any) -> None:
        bounds = np.array(shape.bounds).reshape(3, 2).T + self._host.origin
        if self._widget_box is not None and not np.allclose(bounds, self._widget_box, atol=1e-3):
            # The widget is there already: creating it again under the pointer would end the drag.
            self._widget_box = bounds
            self._set_fields(bounds)
            self._widget_box = self.box
            self._apply()

    def _set_fields(self, corners: FloatArray) -> None:
        for pair, sides in zip(self._fields, corners.T, strict=True):
            for field, value in zip(pair, sides, strict=True):
                field.blockSignals(True)
                field.setValue(float(value))
                field.blockSignals(False)

    def _planes(self, canvas: Canvas) -> list[vtkPlane]:
        low, high = self.box - self._host.origin
        planes = []
        # On the map heights only order the layers.
        for axis in range(2 if canvas.is_map else 3):
            for corner, sign in ((low, 1.0), (high, -1.0)):
                plane = vtkPlane()
                plane.SetOrigin(*corner)
                plane.SetNormal(*(sign * np.eye(3)[axis]))
                planes.append(plane)
        return planes

    def _ask_export(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Export what is inside", str(Path.cwd() / "inside.ply"), "3DGS PLY (*.ply)")
        if path:
            self._host.attempt(lambda: self.save_inside(Path(path)))
