"""Clicks in the 3D view and on the map as places of the world. Needs the `desktop` extra.

In 3D a click is at the depth of the model under it; on the map its height is not known (NaN), so
that it is the surface's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.view_motion import place_at

REACH = 3
"""Pixels of the picture in which a click that met a hole looks for the model."""
NOTHING = "There is no model under that pixel: click on the ground or a house, with Gaussians shown in the layers."


class PlaceTool:
    """Takes the clicks in both views while `is_active`, and calls `changed`; points (P,3), and the
    eyes (P,3) from where they were clicked."""

    def __init__(self, host: Host, ground: float, changed: Callable[[], None]) -> None:
        self._host, self._ground, self._changed = host, ground, changed
        self.is_active = False
        self.points: FloatArray = np.zeros((0, 3))
        self.eyes: FloatArray = np.zeros((0, 3))
        for canvas in (host.map, host.view):
            canvas.click_takers.insert(0, self._on_click)

    def set_active(self, active: bool) -> None:
        """Begin without a point, or end."""
        self.is_active = active
        self.clear()

    def clear(self) -> None:
        """Forget all points."""
        self.points = self.eyes = np.zeros((0, 3))
        self._changed()

    def undo(self) -> None:
        """Forget the last point."""
        if self.is_active and len(self.points):
            self.points, self.eyes = self.points[:-1], self.eyes[:-1]
            self._changed()

    def add(self, point: FloatArray, eye: FloatArray) -> None:
        """Add a place (3,) seen from an eye (3,)."""
        self.points, self.eyes = np.concatenate([self.points, point[None]]), np.concatenate([self.eyes, eye[None]])
        self._changed()

    @property
    def grounded_points(self) -> FloatArray:
        """The points (P,3) with the height of the ground where theirs is not known."""
        return np.where(np.isnan(self.points), self._ground, self.points)

    def _on_click(self, canvas: Canvas, pixel: tuple[int, int]) -> bool:
        if not self.is_active:
            return False
        if canvas.is_map:
            self.add(np.array([*canvas.ground_place(pixel), np.nan]), np.zeros(3))
            return True
        # Depths count from the upper left, clicks from the lower left; pixels have their middle.
        from_top = (pixel[0] + 0.5, canvas.size_wh[1] - 1 - pixel[1] + 0.5)
        depth = canvas.depth_at(from_top, REACH)
        if depth is None:
            self._host.show_status(NOTHING)
        else:
            self.add(place_at(canvas.pose, from_top, canvas.size_wh, depth), canvas.pose.position)
        return True
