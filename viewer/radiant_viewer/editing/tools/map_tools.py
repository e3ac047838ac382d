"""Mouse tools on the map while a plan is edited. Needs the `desktop` extra.

    drag an edge's square   moves the edge
    drag a border           moves the grabbed region's rim: it owns the inside, others are replanned
    Shift and drag          selects the cameras inside the box; with Ctrl adds them
    Escape while dragging   cancels the drag

All other events go to the view, which pans and zooms. Hit tests are pure functions of places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPoint, QPointF, QRect, QSize, Qt
from PySide6.QtGui import QKeyEvent, QMouseEvent
from PySide6.QtWidgets import QRubberBand

from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border, shared_borders
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_viewer.editing.model.edited_plan import border_weight_m2
from radiant_viewer.editing.model.plan_edits import Edit, FixWeight, MoveEdge
from radiant_viewer.editing.tools.plan_actions import PlanActions

EDGE_PX, BORDER_PX = 12, 7
"""Largest distance of a press from an edge or a border."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeGrip:
    """An edge that was grabbed `offset` (2,) from its site."""

    edge: str
    offset: FloatArray

    def edit(self, place: FloatArray, _: CloudPlan) -> Edit:
        """Return the edit for a drag to `place` (2,)."""
        x, y = (place + self.offset).tolist()
        return MoveEdge(edge=self.edge, position=(x, y))


@dataclass(frozen=True, kw_only=True, eq=False)
class BorderGrip:
    """The rim of region `edge`, grabbed at `place` (2,); `outward` (2,): unit normal to
    `neighbour`."""

    edge: str
    neighbour: str
    place: FloatArray
    outward: FloatArray

    def edit(self, place: FloatArray, cloud: CloudPlan) -> Edit:
        """Return the edit for a drag to `place` (2,), given the plan at the time of the press."""
        distance = float((place - self.place) @ self.outward)
        return FixWeight(edge=self.edge, weight_m2=border_weight_m2(cloud, self.edge, self.neighbour, distance))


def grip_at(
    place: FloatArray, cloud: CloudPlan, constraints: PlanConstraints, borders: tuple[Border, ...], meters_per_px: float
) -> EdgeGrip | BorderGrip | None:
    """Return the edge, else the border, under a press at `place` (2,), else None."""
    away = np.linalg.norm(cloud.sites - place, axis=1)
    nearest = int(away.argmin())
    if away[nearest] <= EDGE_PX * meters_per_px:
        return EdgeGrip(edge=cloud.edge_ids[nearest], offset=cloud.sites[nearest] - place)
    distances = [float(border.distances_m(place[None])[0]) for border in borders]
    if not distances or min(distances) > BORDER_PX * meters_per_px:
        return None
    border = borders[int(np.argmin(distances))]
    is_in_first = bool((place - border.ends[0]) @ border.toward_first >= 0)
    first, second = cloud.edge_ids[border.first], cloud.edge_ids[border.second]
    # A border that was dragged before keeps its region, whichever side is grabbed.
    dragged = [name in constraints.fixed_weights_m2 for name in (first, second)]
    if dragged[0] != dragged[1]:
        is_in_first = dragged[0]
    # A locked region's border is its neighbour's rim.
    if (first if is_in_first else second) in constraints.locked:
        is_in_first = not is_in_first
    edge, neighbour = (first, second) if is_in_first else (second, first)
    outward = -border.toward_first if is_in_first else border.toward_first
    return BorderGrip(edge=edge, neighbour=neighbour, place=place, outward=outward)


class MapTools(QObject):
    """Filters the mouse events of the map while `is_active`."""

    def __init__(self, actions: PlanActions) -> None:
        super().__init__(actions)
        self._actions = actions
        self._canvas = actions.host.map
        self._widget = self._canvas.plotter
        self.is_active = False
        self._grip: EdgeGrip | BorderGrip | None = None
        self._pressed_on: CloudPlan | None = None
        self._box_from: QPoint | None = None
        self._band = QRubberBand(QRubberBand.Shape.Rectangle, self._widget)
        self._last_place: FloatArray | None = None
        self._borders: tuple[CloudPlan, tuple[Border, ...]] | None = None
        self._widget.setMouseTracking(True)
        self._widget.installEventFilter(self)

    @property
    def is_dragging(self) -> bool:
        """Whether an edge or a border is held."""
        return self._grip is not None

    def set_active(self, active: bool) -> None:
        """Start or stop using the mouse."""
        self.is_active = active
        self._release()
        self._widget.unsetCursor()

    def close(self) -> None:
        """Remove the filter before the view is destroyed."""
        self.is_active = False
        self._widget.removeEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Handle an event before the view; True consumes it."""
        if not self.is_active or watched is not self._widget:
            return False
        if isinstance(event, QKeyEvent) and event.type() == QEvent.Type.KeyPress and event.key() == Qt.Key.Key_Escape and self._grip:
            self._release()
            self._actions.drop_preview()
            return True
        if not isinstance(event, QMouseEvent):
            return False
        if event.type() == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
            return self._on_press(event)
        if event.type() == QEvent.Type.MouseMove:
            return self._on_move(event)
        if event.type() == QEvent.Type.MouseButtonRelease and event.button() == Qt.MouseButton.LeftButton:
            return self._on_release(event)
        return False

    def end_drag(self) -> Edit | None:
        """End the drag and return its edit, None where nothing was dragged."""
        grip, cloud, place = self._grip, self._pressed_on, self._last_place
        self._release()
        if grip is None or cloud is None or place is None:
            return None
        return grip.edit(place, cloud)

    def _on_press(self, event: QMouseEvent) -> bool:
        if event.modifiers() & Qt.KeyboardModifier.ShiftModifier:
            self._box_from = event.position().toPoint()
            self._band.setGeometry(QRect(self._box_from, QSize()))
            self._band.show()
            return True
        session = self._actions.session
        grip = None if session is None else self._grip_under(event.position())
        if session is None or grip is None:
            return False
        if session.is_busy:
            self._actions.host.show_status("The plan is being solved: wait a moment.")
            return True
        self._widget.setFocus()
        self._grip, self._pressed_on = grip, session.editor.state.cloud
        self._last_place = None
        return True

    def _on_move(self, event: QMouseEvent) -> bool:
        if self._box_from is not None:
            self._band.setGeometry(QRect(self._box_from, event.position().toPoint()).normalized())
            return True
        if self._grip is not None and self._pressed_on is not None:
            self._last_place = self._place(event.position())
            self._actions.drag_to(self._grip.edit(self._last_place, self._pressed_on))
            return True
        if not event.buttons():
            self._show_cursor(event.position())
        return False

    def _on_release(self, event: QMouseEvent) -> bool:
        if self._box_from is not None:
            box = QRect(self._box_from, event.position().toPoint()).normalized()
            self._release()
            corners = np.stack([self._place(QPointF(box.topLeft())), self._place(QPointF(box.bottomRight()))])
            adds = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
            self._actions.select_box(corners.min(axis=0), corners.max(axis=0), add=adds)
            return True
        if self._grip is None:
            return False
        if self._last_place is not None:
            self._last_place = self._place(event.position())
        edit = self.end_drag()
        if edit is not None:
            self._actions.do(edit)
        return True

    def _release(self) -> None:
        self._grip = self._pressed_on = self._box_from = None
        self._band.hide()

    def _show_cursor(self, position: QPointF) -> None:
        grip = self._grip_under(position)
        if grip is None:
            self._widget.unsetCursor()
        elif isinstance(grip, EdgeGrip):
            self._widget.setCursor(Qt.CursorShape.SizeAllCursor)
        else:
            across = abs(grip.outward[0]) > abs(grip.outward[1])
            self._widget.setCursor(Qt.CursorShape.SplitHCursor if across else Qt.CursorShape.SplitVCursor)

    def _grip_under(self, position: QPointF) -> EdgeGrip | BorderGrip | None:
        session = self._actions.session
        if session is None:
            return None
        state = session.editor.state
        if self._borders is None or self._borders[0] is not state.cloud:
            self._borders = (state.cloud, shared_borders(state.cloud))
        per_px = 2 * self._canvas.plotter.camera.parallel_scale / max(self._widget.height(), 1)
        return grip_at(self._place(position), state.cloud, state.wishes.constraints, self._borders[1], per_px)

    def _place(self, position: QPointF) -> FloatArray:
        """Return the place (2,) of the world under a device-independent pixel of the widget."""
        width, height = max(self._widget.width(), 1), max(self._widget.height(), 1)
        camera = self._canvas.plotter.camera
        per_px = 2 * camera.parallel_scale / height
        offset = np.array([position.x() - width / 2, height / 2 - position.y()]) * per_px
        return np.array(camera.focal_point[:2]) + offset + self._canvas.origin[:2]
