"""The size of the window: the screen's at first, later what its user left. Needs the `desktop`
extra."""

from __future__ import annotations

from PySide6.QtCore import QByteArray, QRect, QSettings
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QMainWindow

KEY = "inspector/geometry"


def fit_to_screen(window: QMainWindow) -> None:
    """Give a window that has just been shown the geometry it was closed with, where that lies on a
    screen that is there; else all of its screen but the frame."""
    saved = _settings().value(KEY)
    if isinstance(saved, QByteArray) and window.restoreGeometry(saved) and _is_on_a_screen(window.geometry()):
        return
    available = window.screen().availableGeometry()
    # Only a shown window has a frame; without a window manager it has none.
    frame, inner = window.frameGeometry(), window.geometry()
    window.setGeometry(
        available.adjusted(
            max(0, inner.left() - frame.left()),
            max(0, inner.top() - frame.top()),
            -max(0, frame.right() - inner.right()),
            -max(0, frame.bottom() - inner.bottom()),
        )
    )


def remember_size(window: QMainWindow) -> None:
    """Keep the geometry of a window for the next one."""
    _settings().setValue(KEY, window.saveGeometry())


def _is_on_a_screen(geometry: QRect) -> bool:
    return any(screen.availableGeometry().contains(geometry.center()) for screen in QGuiApplication.screens())


def _settings() -> QSettings:
    return QSettings(QSettings.Format.IniFormat, QSettings.Scope.UserScope, "radiant", "inspector")
