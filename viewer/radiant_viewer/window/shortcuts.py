"""The list of keys and of what the mouse does (F1). Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Mapping

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QMessageBox, QWidget

MOUSE = {
    "Drag": "Map: move it. 3D: orbit about what is under the pointer",
    "Shift or middle, drag": "3D: move it. Map, while editing: select cameras",
    "Wheel, right drag": "Nearer and farther. Right drag in 3D: look around, with W A S D Q E: fly",
    "Click": "Select the camera there; with Measure: a corner",
    "Double click": "3D: come nearer to it. A row: fly to its camera. A panel's tab: float it",
}
"""What the mouse does, for F1."""


def show_shortcuts(window: QWidget, shortcuts: Mapping[str, str]) -> None:
    """Show what the mouse and each key does."""
    pairs = [*MOUSE.items(), *shortcuts.items()]
    rows = "".join(f"<tr><td><b>{key}</b>&nbsp;&nbsp;</td><td>{tip}</td></tr>" for key, tip in pairs)
    box = QMessageBox(QMessageBox.Icon.NoIcon, "Keys and mouse", f"<table>{rows}</table>", QMessageBox.StandardButton.Close, window)
    box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    box.open()
