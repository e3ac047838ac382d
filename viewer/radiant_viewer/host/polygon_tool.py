"""A polygon drawn on the map: clicks add corners; the status bar shows its length and area."""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.host.protocols import Host
from radiant_viewer.layers.layer import Label
from radiant_viewer.layers.measure_layer import clicked_layer
from radiant_viewer.pictures.measure import area_text, length_text, path_length, polygon_area


class PolygonTool:
    """Takes the clicks on the map while `is_active`; `corners` (K,2) are the clicked places, `mark`
    names what shows them."""

    def __init__(self, host: Host, unit: str, height: float, *, mark: str, hint: str) -> None:
        self._host, self._unit, self._height = host, unit, height
        self.mark, self._hint = mark, hint
        self.is_active = False
        self.corners: FloatArray = np.zeros((0, 2))
        host.map.click_takers.insert(0, self._on_click)

    def set_active(self, active: bool) -> None:
        """Start with no corner, or end and remove the mark."""
        self.is_active = active
        self.corners = np.zeros((0, 2))
        self._host.remove_mark(self.mark)
        self._host.render_views()
        self._host.show_status(self._hint if active else "")

    def undo(self) -> None:
        """Remove the last corner."""
        if self.is_active and len(self.corners):
            self.corners = self.corners[:-1]
            self._draw()

    def add(self, corner: FloatArray) -> None:
        """Add a corner (2,) of the map."""
        self.corners = np.concatenate([self.corners, np.asarray(corner, np.float64)[None]])
        self._draw()

    @property
    def text(self) -> str:
        """Length, and from three corners on the area."""
        length = length_text(path_length(self.corners), self._unit)
        if len(self.corners) < 3:
            return f"Distance {length}"
        try:
            return f"Path {length}   ·   area {area_text(polygon_area(self.corners), self._unit)}"
        except BadInput as error:
            return f"Path {length}   ·   {error}"

    def _on_click(self, canvas: Canvas, pixel: tuple[int, int]) -> bool:
        if self.is_active:
            self.add(canvas.ground_place(pixel))
        return self.is_active

    def _draw(self) -> None:
        if not len(self.corners):
            self._host.remove_mark(self.mark)
        else:
            places = np.column_stack([self.corners, np.full(len(self.corners), self._height)])
            label = Label(text=self.text.replace("   ·   ", ", "), position=places[-1])
            self._host.draw_mark(clicked_layer(places, closed=True, name=self.mark, labels=(label,)))
        self._host.render_views()
        self._host.show_status(self.text)
