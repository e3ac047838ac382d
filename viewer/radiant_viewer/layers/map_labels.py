"""Labels on the maps of window and page: each stays above its mark at every zoom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkCommand, vtkStringArray
from vtkmodules.vtkRenderingCore import vtkProp

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.layer import Label
from radiant_viewer.layers.themes import Theme, hex_color

LIFT_PX = 20
"""Distance between the centres of a mark and its label."""


def add_map_labels(
    plotter: pv.Plotter, labels: Sequence[Label], origin: FloatArray, height: float, theme: Theme, font_size: int
) -> vtkProp:
    """Draw labels on a map relative to `origin` (3,) at one height, and return their actor."""
    places = np.array([label.position for label in labels]) - origin
    places[:, 2] = height
    marks = pv.PolyData(places)
    # Names only: VTK does not keep labels inside the view, and the legend has the figures.
    names = vtkStringArray()
    names.SetName("text")
    for label in labels:
        names.InsertNextValue(label.text.splitlines()[0])
    # Not by pyvista, which accepts ASCII only: an edge may be named Zürich, and areas are in m².
    marks.GetPointData().AddArray(names)
    actor = plotter.add_point_labels(
        marks,
        "text",
        font_size=font_size,
        bold=False,
        text_color=hex_color(theme.text),
        shape_color=hex_color(theme.panel) if theme.name == "dark" else "white",
        shape_opacity=0.8,
        show_points=False,
        always_visible=True,
        reset_camera=False,
        render=False,
    )
    _keep_above(plotter, actor, marks, places)
    return actor


def _keep_above(plotter: pv.Plotter, actor: vtkProp, marks: pv.PolyData, places: FloatArray) -> None:
    """Move the labels at every frame with a new scale, until they are removed."""
    lifted: list[float] = []

    def lift(*_: object) -> None:
        if not plotter.renderer.HasViewProp(actor):
            plotter.renderer.RemoveObserver(tag)
            return
        per_px = 2 * plotter.camera.parallel_scale / max(plotter.window_size[1], 1)
        if lifted != [per_px]:
            lifted[:] = [per_px]
            marks.points = (places + np.array([0.0, LIFT_PX * per_px, 0.0])).astype(np.float32)

    tag = plotter.renderer.AddObserver(vtkCommand.StartEvent, lift)
