"""The menu that shows, hides and floats docks; a double click on a tab floats its dock. A floating
dock has its title bar as a handle; among tabs the tab repeats it. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QDockWidget, QMainWindow, QMenu, QTabBar, QToolButton, QWidget

SIZE_WH = (520, 420)
"""Least size of a floating dock."""


class Panels(QObject):
    """`button` opens the menu; make it after all docks are placed."""

    def __init__(self, window: QMainWindow, docks: Sequence[QDockWidget]) -> None:
        super().__init__(window)
        self._window, self._docks = window, tuple(docks)
        # Tabs can be dragged out as well.
        window.setDockOptions(window.dockOptions() | QMainWindow.DockOption.GroupedDragging)
        self.button = QToolButton()
        self.button.setText("Panels")
        self.button.setToolTip("Show, hide or float a panel; a double click on its tab floats it, too")
        self.button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        menu = QMenu(self.button)
        for dock in docks:
            menu.addAction(dock.toggleViewAction())
        menu.addSeparator()
        for dock in docks:
            float_action = menu.addAction(f"Float {dock.windowTitle()}")
            float_action.setCheckable(True)
            float_action.toggled.connect(partial(self.set_floating, dock))
            dock.topLevelChanged.connect(partial(self._on_moved, dock))
            dock.topLevelChanged.connect(float_action.setChecked)
        self.button.setMenu(menu)
        window.installEventFilter(self)

    def set_floating(self, dock: QDockWidget, floating: bool) -> None:
        """Float a dock, or put it back in its place."""
        if dock.isFloating() == floating:
            return
        dock.show()
        dock.setFloating(floating)
        if floating:
            dock.resize(max(dock.width(), SIZE_WH[0]), max(dock.height(), SIZE_WH[1]))
        else:
            dock.raise_()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Float the dock of a tab on a double click; tab bars are watched as Qt creates them."""
        if event.type() == QEvent.Type.ChildAdded and watched is self._window:
            for bar in self._window.findChildren(QTabBar):
                bar.installEventFilter(self)
        if isinstance(watched, QTabBar) and isinstance(event, QMouseEvent) and event.type() == QEvent.Type.MouseButtonDblClick:
            title = watched.tabText(watched.tabAt(event.position().toPoint()))
            for dock in self._docks:
                if dock.windowTitle() == title:
                    self.set_floating(dock, True)
                    return True
        return False

    def _on_moved(self, dock: QDockWidget, floating: bool) -> None:
        is_bare = dock.titleBarWidget() is not None
        if floating and is_bare:
            dock.setTitleBarWidget(None)  # type: ignore[arg-type]
        elif not floating and not is_bare and self._window.tabifiedDockWidgets(dock):
            dock.setTitleBarWidget(QWidget())
