"""The cameras of a run as a Qt table model: sortable by every column, figures as numbers. Needs the `desktop` extra."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt

from radiant_viewer.run_view import RunView

SORT_ROLE = Qt.ItemDataRole.UserRole
"""Role that gives the value to sort by instead of its text."""
Index = QModelIndex | QPersistentModelIndex


class CameraTable(QAbstractTableModel):
    """One row per camera in the scene's order: name, region, device, use, PSNR, position."""

    def __init__(self, run: RunView) -> None:
        super().__init__()
        unit = run.unit
        self.headings = (
            "Photograph",
            "Region",
            "Device",
            "Use",
            "PSNR (dB)",
            f"East ({unit})",
            f"North ({unit})",
            f"Up ({unit})",
        )
        self.rows = _rows(run)

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own signature)
        """Number of cameras."""
        return 0 if parent.isValid() else len(self.rows)

    def columnCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own signature)
        """Number of columns."""
        return 0 if parent.isValid() else len(self.headings)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Headings with their units; plain numbers down the side."""
        if role != Qt.ItemDataRole.DisplayRole:
            return None
        return self.headings[section] if orientation == Qt.Orientation.Horizontal else section + 1

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Text to show, value to sort by, or alignment."""
        value = self.rows[index.row()][index.column()]
        if role == SORT_ROLE:
            # A camera without a figure stands below every figure.
            return float("-inf") if value is None else value
        if role == Qt.ItemDataRole.TextAlignmentRole and not isinstance(value, str):
            return int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        if role != Qt.ItemDataRole.DisplayRole:
            return None
        return "" if value is None else value if isinstance(value, str) else f"{value:.2f}".replace("-", "−")


def _rows(run: RunView) -> list[tuple[str | float | None, ...]]:
    roles, psnr_db = run.roles, run.psnr_db or {}
    edges, devices = (*roles.edge_ids, ""), (*roles.device_ids, "")
    return [
        (
            name,
            edges[roles.edge_of_camera[index]],
            devices[roles.device_of_camera[index]],
            "held out" if roles.held_out[index] else "training",
            psnr_db.get(name),
            *(float(value) for value in center),
        )
        for index, (name, center) in enumerate(zip(run.scene.cameras.names, run.scene.cameras.centers, strict=True))
    ]
