"""`PointDetail`: swaps what one plotter draws of large clouds, few points while its view moves and all that shows once it rests.

A window gives `later`, which calls back after some seconds; without it (pictures) the view is always at rest. What is drawn is
chosen in `detail.py`. An actor stays the same all the time, so that hiding, showing and removing it needs nothing from here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import vtkCommand

from radiant_core.numerics import FloatArray
from radiant_viewer.detail import MOVING_POINTS, WHOLE_POINTS, even_subset, visible_subset
from radiant_viewer.palette import ColorArray

REST_S = 0.25
"""A view that has not moved for so long is at rest."""
MOVING_HZ = 1.0
"""VTK asks for more frames a second than this while a mouse button drags, for far fewer otherwise."""
View = tuple[object, ...]
Later = Callable[[float, Callable[[], None]], object]


@dataclass(eq=False)
class _Cloud:
    """One large cloud: points (N,3) near the origin as they lie and as they are placed, colours (N,3), and its actor."""

    points: NDArray[np.float32]
    placed: NDArray[np.float32]
    colors: ColorArray
    actor: pv.Actor
    ends: NDArray[np.int64] = field(init=False)
    """The outermost points (6,) as placed; always drawn, since near and far planes are set by what an actor draws."""
    shown: object = None
    """What the actor draws: a limit of points, or a view."""
    subsets: dict[int, NDArray[np.int64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ends = np.concatenate([self.placed.argmin(axis=0), self.placed.argmax(axis=0)])


class PointDetail:
    """The large clouds of one plotter; `later(seconds, call)` runs a call on the window's own thread."""

    def __init__(self, plotter: pv.Plotter, later: Later | None = None) -> None:
        self._plotter, self._later = plotter, later
        self._clouds: list[_Cloud] = []
        self._seen: View | None = None
        self._num_moves = 0
        self.is_moving = False
        """Whether the last frame was drawn with few points."""
        plotter.renderer.AddObserver(vtkCommand.StartEvent, self._before_frame)

    def add(self, cloud_points: FloatArray, placed: NDArray[np.float32], colors: ColorArray, actor: pv.Actor) -> None:
        """Take over an actor that draws a cloud: points (N,3) relative to the origin, the same as placed on a map, colours (N,3)."""
        cloud = _Cloud(points=cloud_points.astype(np.float32), placed=placed, colors=colors, actor=actor)
        self._draw(cloud, np.zeros(0, np.int64), shown=None)
        self._clouds.append(cloud)

    def refine(self) -> None:
        """Bring every visible cloud to full detail for the camera as it stands, without drawing."""
        self._num_moves += 1
        self._seen = self._view()
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
        elif view != self._seen:
            self._seen, self.is_moving = view, True
            self._num_moves += 1
            self._wait(self._later, self._num_moves)
        if self.is_moving:
            for cloud in clouds:
                self._show_few(cloud, MOVING_POINTS // len(clouds))
        else:
            # One that was hidden when the view came to rest.
            for cloud in clouds:
                self._show_all(cloud)

    def _wait(self, later: Later, num_moves: int) -> None:
        def rest() -> None:
            if num_moves != self._num_moves or self._plotter.render_window is None:
                return
            if self._plotter.render_window.GetDesiredUpdateRate() > MOVING_HZ:
                later(REST_S, rest)
                return
            self.refine()
            self._plotter.render()

        later(REST_S, rest)

    def _visible(self) -> list[_Cloud]:
        present = self._plotter.renderer.GetViewProps()
        self._clouds = [cloud for cloud in self._clouds if present.IsItemPresent(cloud.actor)]
        return [cloud for cloud in self._clouds if cloud.actor.GetVisibility()]

    def _view(self) -> View:
        camera, size_wh = self._plotter.camera, tuple(self._plotter.window_size)
        return (*camera.position, *camera.focal_point, *camera.up, camera.parallel_scale, camera.view_angle, *size_wh)

    def _show_few(self, cloud: _Cloud, limit: int) -> None:
        if cloud.shown == limit:
            return
        if limit not in cloud.subsets:
            cloud.subsets[limit] = even_subset(cloud.points.astype(np.float64), limit)
        self._draw(cloud, cloud.subsets[limit], shown=limit)

    def _show_all(self, cloud: _Cloud) -> None:
        view = self._seen if len(cloud.points) > WHOLE_POINTS else "whole"
        if cloud.shown == view:
            return
        kept = self._in_view(cloud) if len(cloud.points) > WHOLE_POINTS else np.arange(len(cloud.points))
        self._draw(cloud, kept, shown=view)

    def _in_view(self, cloud: _Cloud) -> NDArray[np.int64]:
        width, height = self._plotter.window_size
        matrix = self._plotter.camera.GetCompositeProjectionTransformMatrix(width / height, -1, 1)
        clip_from_world = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
        # Half a point wide, so that what is left out lies under what is drawn.
        return visible_subset(cloud.points, clip_from_world, (width, height), max(1.0, cloud.actor.prop.point_size / 2))

    def _draw(self, cloud: _Cloud, kept: NDArray[np.int64], shown: object) -> None:
        drawn = np.append(kept, cloud.ends)
        cloud.actor.mapper.SetInputData(point_mesh(cloud.placed[drawn], cloud.colors[drawn]))
        cloud.shown = shown


def point_mesh(positions: NDArray[np.float32], colors: ColorArray) -> pv.PolyData:
    """Points (N,3) as one cell, each with a colour (N,3)."""
    mesh = pv.PolyData(positions, verts=np.append(len(positions), np.arange(len(positions))))
    mesh.point_data["colors"] = colors
    return mesh
