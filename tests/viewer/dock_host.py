"""A window that stands in for the real one around a dock: it keeps what is drawn and said, and prints
what is refused.

Imported only in processes that show a dock: pytest's own keep clear of Qt.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtWidgets import QMainWindow

from radiant_core.errors import RadiantError
from radiant_viewer.layers.layer import Layer


class DockHost(QMainWindow):
    """See `radiant_viewer.host.protocols.Host`; without views."""

    def __init__(self) -> None:
        super().__init__()
        self.layers_drawn: dict[str, Layer] = {}
        self.said: list[str] = []
        self.reloads = 0

    def attempt(self, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except RadiantError as error:
            print("refused:", error)

    def draw_mark(self, layer: Layer) -> None:
        self.layers_drawn[layer.name] = layer

    def remove_mark(self, name: str) -> None:
        self.layers_drawn.pop(name, None)

    def render_views(self) -> None:
        pass

    def show_status(self, text: str) -> None:
        self.said.append(text)

    def reload(self) -> None:
        self.reloads += 1
