"""`Marks`: layers over all others in both views, of a selection, a comparison or a tool. *Solo*
hides those that were there before it. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Sequence

from radiant_viewer.host.canvas import TOP_SLOT, Canvas
from radiant_viewer.host.polygon_tool import PolygonTool
from radiant_viewer.layers.layer import Layer


class Marks:
    """Draws marks on all canvases; `shown` answers which of them are not hidden."""

    def __init__(self, canvases: Sequence[Canvas]) -> None:
        self._canvases = canvases
        self._layers: dict[str, Layer] = {}
        self._is_solo = False
        self._before_solo: frozenset[str] = frozenset()

    @property
    def visible_names(self) -> list[str]:
        """The names of the marks that are shown."""
        return [name for name in self._layers if name not in self._before_solo]

    def draw(self, layer: Layer) -> None:
        """Draw a mark in place of the one of its name; it is new, so *Solo* does not hide it."""
        self._layers[layer.name] = layer
        self._before_solo -= {layer.name}
        for canvas in self._canvases:
            canvas.draw(layer, TOP_SLOT)

    def remove(self, name: str) -> None:
        """Remove the mark of this name, if there is one."""
        self._layers.pop(name, None)
        for canvas in self._canvases:
            canvas.remove(name)

    def redraw(self) -> None:
        """Draw all marks again, hidden ones too, as after a change of theme."""
        for name, layer in self._layers.items():
            for canvas in self._canvases:
                canvas.draw(layer, TOP_SLOT, visible=name not in self._before_solo)

    def follow_solo(self, is_solo: bool, tools: Sequence[PolygonTool]) -> None:
        """Hide the marks when *Solo* begins, but those of tools at work; show all when it ends."""
        if is_solo and not self._is_solo:
            self._before_solo = frozenset(self._layers) - {tool.mark for tool in tools if tool.is_active}
        elif not is_solo:
            self._before_solo = frozenset()
        self._is_solo = is_solo
        for name in self._layers:
            for canvas in self._canvases:
                canvas.show(name, name not in self._before_solo)
