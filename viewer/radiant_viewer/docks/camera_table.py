"""The cameras of a run as a sortable Qt table model, and as CSV. Needs the `desktop` extra."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt

from radiant_core.io.csv_cells import cell_of_text
from radiant_core.io.run_store import write_atomic
from radiant_viewer.runs.places import camera_heights, natural_key
from radiant_viewer.runs.run_figures import FIGURES, ImageFigures
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.words import tip

SORT_ROLE = Qt.ItemDataRole.UserRole
"""Role that gives the value to sort by instead of its text."""
TIPS = {"Region": tip("region", "edge"), "Device": tip("device"), "Use": tip("held out"), "PSNR (dB)": tip("PSNR")}
"""Heading → hover."""
Index = QModelIndex | QPersistentModelIndex


class CameraTable(QAbstractTableModel):
    """One row per camera of the scene, then per held-out photograph whose pose is with its device.
    Columns: name, region, device, use, PSNR, other measured figures, position, and the file where
    the name is a number."""

    def __init__(self, run: RunView, figures: ImageFigures | None = None) -> None:
        super().__init__()
        heading, _ = camera_heights(run.scene)
        axes = (f"East ({run.unit})", f"North ({run.unit})", heading)
        more = [figure for figure in FIGURES[1:] if any(figure.key in row for row in (figures or {}).values())]
        names = ("Photograph", "Region", "Device", "Use", "PSNR (dB)", *(figure.heading for figure in more))
        self.headings = (*names, *axes, *(["File"] if run.files else []))
        self._keys, self._figures = [figure.key for figure in more], figures or {}
        self.rows = _rows(run, self._keys, self._figures)

    def show_run(self, run: RunView) -> None:
        """Show the same cameras with another plan."""
        self.rows = _rows(run, self._keys, self._figures)
        self.dataChanged.emit(self.index(0, 0), self.index(len(self.rows) - 1, len(self.headings) - 1))

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own signature)
        """Number of cameras."""
        return 0 if parent.isValid() else len(self.rows)

    def columnCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own signature)
        """Number of columns."""
        return 0 if parent.isValid() else len(self.headings)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Headings with their units; plain numbers down the side."""
        if role == Qt.ItemDataRole.ToolTipRole and orientation == Qt.Orientation.Horizontal:
            return TIPS.get(self.headings[section])
        if role != Qt.ItemDataRole.DisplayRole:
            return None
        return self.headings[section] if orientation == Qt.Orientation.Horizontal else section + 1

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Text to show, value to sort by, or alignment."""
        value = self.rows[index.row()][index.column()]
        if role == SORT_ROLE:
            # A camera without a figure stands below every figure.
            return float("-inf") if value is None else natural_key(value) if isinstance(value, str) else value
        if role == Qt.ItemDataRole.TextAlignmentRole and not isinstance(value, str):
            return int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        if role != Qt.ItemDataRole.DisplayRole:
            return None
        if value is None or isinstance(value, str):
            return value or ""
        return f"{value:.3f}" if self.headings[index.column()] in ("SSIM", "FLIP", "LPIPS") else f"{value:.2f}".replace("-", "−")

    def save_csv(self, path: Path, order: Sequence[int]) -> None:
        """Write the rows `order` (indices) as CSV with all digits; BadInput where that fails."""
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(self.headings)
        writer.writerows([_csv_cell(cell) for cell in self.rows[index]] for index in order)
        write_atomic(path, text.getvalue().encode())


def _csv_cell(cell: str | float | None) -> str | float:
    return "" if cell is None else cell_of_text(cell) if isinstance(cell, str) else cell


def _rows(run: RunView, more: Sequence[str], figures: ImageFigures) -> list[tuple[str | float | None, ...]]:
    psnr_db, rows = run.psnr_db or {}, []
    places = np.column_stack([run.scene.cameras.centers[:, :2], camera_heights(run.scene)[1]])
    centers: list[tuple[float | None, ...]] = [tuple(map(float, place)) for place in places]
    for index, (name, center) in enumerate(zip(run.photographs, centers + [(None,) * 3] * len(run.unplaced), strict=True)):
        measured = (psnr_db.get(name), *(figures.get(name, {}).get(key) for key in more))
        file = [run.files.get(name, "")] if run.files else []
        rows.append((name, *_owner_cells(run, index), *measured, *center, *file))
    return rows


def _owner_cells(run: RunView, index: int) -> tuple[str, str, str]:
    """Region, device and use of a photograph."""
    roles, device = run.roles, run.owner(index)
    if index < len(run.scene.cameras):
        region = (*roles.edge_ids, "")[roles.edge_of_camera[index]]
        return region, device, "held out" if roles.held_out[index] else "training"
    edge = int(roles.edge_of_device[roles.device_ids.index(device)]) if device else -1
    return (*roles.edge_ids, "")[edge], device, "held out"
