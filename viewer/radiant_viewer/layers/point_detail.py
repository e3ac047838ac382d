"""`PointDetail`: few points of large clouds while a view moves, and all visible ones at rest.

A window passes `later`, which calls back after some seconds; without it (pictures) the view is
always at rest. `detail.py` chooses the points. Actors are reused, so that hiding, showing and
removing them needs nothing from here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import vtkCommand

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.detail import MOVING_POINTS, WHOLE_POINTS, even_subset, visible_subset
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import ColorArray

REST_S = 0.25
"""Time without movement after which a view is at rest."""
MOVING_HZ = 1.0
"""VTK requests more frames per second than this while a mouse button drags, far fewer otherwise."""
_BLOCK = 1 << 16
"""Points moved at a time, so that they stay in the cache."""
View = tuple[object, ...]
Later = Callable[[float, Callable[[], None]], object]


@dataclass(eq=False)
class LocalCloud:
    """A layer's points (N,3) relative to an origin, shared by map and 3D view, with subsets."""

    points: NDArray[np.float32]
    ends: NDArray[np.int64] = field(init=False)
    """Indices of the outermost points (6,); always drawn: they set near and far planes."""
    subsets: dict[int, NDArray[np.int64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        columns = [self.points[:, axis] for axis in range(3)]
        self.ends = np.array([*(column.argmin() for column in columns), *(column.argmax() for column in columns)], np.int64)

    def even(self, limit: int) -> NDArray[np.int64]:
        """Return indices of at most `limit` evenly spread points; computed once."""
        if limit not in self.subsets:
            self.subsets[limit] = even_subset(self.points, limit)
        return self.subsets[limit]


_LOCAL: WeakKeyDictionary[Layer, tuple[bytes, LocalCloud]] = WeakKeyDictionary()


def local_cloud(layer: Layer, origin: FloatArray) -> LocalCloud:
    """Return a layer's points relative to `origin` (3,), float32; cached for two views. O(N)."""
    key = np.asarray(origin, np.float64).tobytes()
    cached = _LOCAL.get(layer)
    if cached is not None and cached[0] == key:
        return cached[1]
    local = np.empty((len(layer.points), 3), np.float32)
    for start in range(0, len(local), _BLOCK):
        np.subtract(layer.points[start : start + _BLOCK], origin, out=local[start : start + _BLOCK], casting="same_kind")
    cloud = LocalCloud(points=local)
    _LOCAL[layer] = (key, cloud)
    return cloud


@dataclass(eq=False)
class _Cloud:
    """A large cloud in one view; height: on a map, None for its own heights; colours (N,3)."""

    local: LocalCloud
    height: float | None
    colors: ColorArray
    actor: pv.Actor
    content: object = None
    """What the actor draws now: a limit of points, or a view."""


class PointDetail:
    """Large clouds of one plotter; `later(seconds, call)` delays a call, `redraw` draws a frame."""

    def __init__(self, plotter: pv.Plotter, later: Later | None = None, redraw: Callable[[], object] | None = None) -> None:
        self._plotter, self._later, self._redraw = plotter, later, redraw or plotter.render
        self._clouds: list[_Cloud] = []
        self._last_view: View | None = None
        self._num_moves = 0
        self.is_moving = False
        """Whether the last frame was drawn with few points."""
        plotter.renderer.AddObserver(vtkCommand.StartEvent, self._before_frame)

    def add(self, local: LocalCloud, height: float | None, colors: ColorArray, actor: pv.Actor) -> None:
        """Manage an actor that draws a cloud with colours (N,3), on a map at one height."""
        cloud = _Cloud(local=local, height=height, colors=colors, actor=actor)
        self._draw(cloud, np.zeros(0, np.int64), content=None)
        self._clouds.append(cloud)

    def coarsen(self) -> None:
        """Draw the next frames with few points although the view is at rest, as during a drag."""
        self._last_view = None

    def refine(self) -> None:
        """Choose all points of every visible cloud that the camera sees, without drawing."""
        self._num_moves += 1
        self._last_view = self._view()
        self.is_moving = False
        for cloud in self._visible():
            self._show_all(cloud)

    def _before_frame(self, *_: object) -> None:
        clouds = self._visible()
        if not clouds:
            return
        view = self._view()
        if self._later is None:
            self.refine()
        elif view != self._last_view:
            self._last_view, self.is_moving = view, True
            self._num_moves += 1
            self._wait(self._later, self._num_moves)
        if self.is_moving:
            for cloud in clouds:
                self._show_few(cloud, MOVING_POINTS // len(clouds))
        else:
            # A cloud that was hidden when the view came to rest.
            for cloud in clouds:
                self._show_all(cloud)

    def _wait(self, later: Later, num_moves: int) -> None:
        def refine_at_rest() -> None:
            if num_moves != self._num_moves or self._plotter.render_window is None:
                return
            if self._plotter.render_window.GetDesiredUpdateRate() > MOVING_HZ:
                later(REST_S, refine_at_rest)
                return
            self.refine()
            self._redraw()

        later(REST_S, refine_at_rest)

    def _visible(self) -> list[_Cloud]:
        present = self._plotter.renderer.GetViewProps()
        self._clouds = [cloud for cloud in self._clouds if present.IsItemPresent(cloud.actor)]
        return [cloud for cloud in self._clouds if cloud.actor.GetVisibility()]

    def _view(self) -> View:
        camera, size_wh = self._plotter.camera, tuple(self._plotter.window_size)
        return (*camera.position, *camera.focal_point, *camera.up, camera.parallel_scale, camera.view_angle, *size_wh)

    def _show_few(self, cloud: _Cloud, limit: int) -> None:
        if cloud.content != limit:
            self._draw(cloud, cloud.local.even(limit), content=limit)

    def _show_all(self, cloud: _Cloud) -> None:
        count = len(cloud.local.points)
        view = self._last_view if count > WHOLE_POINTS else "whole"
        if cloud.content != view:
            rows = self._in_view(cloud) if count > WHOLE_POINTS else np.arange(count)
            self._draw(cloud, rows, content=view)

    def _in_view(self, cloud: _Cloud) -> NDArray[np.int64]:
        width, height = self._plotter.window_size
        matrix = self._plotter.camera.GetCompositeProjectionTransformMatrix(width / height, -1, 1)
        clip_from_world = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
        # Cells of half a point's width, so that drawn points cover dropped ones.
        return visible_subset(cloud.local.points, clip_from_world, (width, height), max(1.0, cloud.actor.prop.point_size / 2))

    def _draw(self, cloud: _Cloud, rows: NDArray[np.int64], content: object) -> None:
        drawn_rows = np.append(rows, cloud.local.ends)
        positions = cloud.local.points[drawn_rows]
        if cloud.height is not None:
            positions[:, 2] = cloud.height
        cloud.actor.mapper.SetInputData(point_mesh(positions, cloud.colors[drawn_rows]))
        cloud.content = content


def point_mesh(positions: NDArray[np.float32], colors: ColorArray) -> pv.PolyData:
    """Return points (N,3) with colours (N,3) as one cell."""
    mesh = pv.PolyData(positions, verts=np.append(len(positions), np.arange(len(positions))))
    mesh.point_data["colors"] = colors
    return mesh
