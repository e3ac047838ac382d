"""Labels on the maps of window and page: each stays above its mark at every zoom, and whole inside
the view."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pyvista as pv
from vtkmodules.vtkCommonCore import vtkCommand, vtkStringArray
from vtkmodules.vtkRenderingCore import vtkProp, vtkTextProperty, vtkTextRenderer
from vtkmodules.vtkRenderingLabel import vtkPointSetToLabelHierarchy

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.layer import Label
from radiant_viewer.layers.themes import Theme, hex_color

USUAL_DPI = 72
"""VTK's dots per inch; a screen of twice the density has twice as many."""
LIFT_PX = 20
"""Distance between the centres of a mark and its label at the usual density."""
PLATE_PX = 4
"""How far a label's plate reaches beyond its text, and a rim beyond that."""


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
    hierarchy = actor.GetMapper().GetInputAlgorithm(0, 0)
    assert isinstance(hierarchy, vtkPointSetToLabelHierarchy)
    texts = [label.text.splitlines()[0] for label in labels]
    _keep_in_place(
        plotter, actor, marks, places, lambda dpi: np.array([_size_px(text, hierarchy.GetTextProperty(), dpi) for text in texts])
    )
    return actor


def _size_px(text: str, style: vtkTextProperty, dots_per_inch: int) -> tuple[int, int]:
    box = [0, 0, 0, 0]
    vtkTextRenderer.GetInstance().GetBoundingBox(style, text, box, dots_per_inch)
    return box[1] - box[0], box[3] - box[2]


def _keep_in_place(
    plotter: pv.Plotter, actor: vtkProp, marks: pv.PolyData, places: FloatArray, sizes_px: Callable[[int], FloatArray]
) -> None:
    """Move the labels at every frame that shows another part of the map, until they are removed."""
    last_state: list[tuple[float, ...]] = []

    def lift(*_: object) -> None:
        if not plotter.renderer.HasViewProp(actor):
            plotter.renderer.RemoveObserver(tag)
            return
        assert plotter.render_window is not None
        size_wh, dpi = np.array(plotter.window_size), plotter.render_window.GetDPI()
        per_px = 2 * plotter.camera.parallel_scale / max(int(size_wh[1]), 1)
        middle = np.array(plotter.camera.focal_point[:2])
        state = (per_px, dpi, *middle.tolist(), *size_wh.tolist())
        if last_state != [state]:
            last_state[:] = [state]
            marks_px = (places[:, :2] - middle) / per_px + size_wh / 2
            corners_px = label_corners(marks_px, sizes_px(dpi), size_wh, LIFT_PX * dpi / USUAL_DPI)
            moved = np.column_stack([(corners_px - size_wh / 2) * per_px + middle, places[:, 2]])
            marks.points = moved.astype(np.float32)

    tag = plotter.renderer.AddObserver(vtkCommand.StartEvent, lift)


def label_corners(marks_px: FloatArray, sizes_px: FloatArray, view_px: FloatArray, lift_px: float) -> FloatArray:
    """Return the lower left corners (L,2) of texts of sizes (L,2) above marks (L,2), all px from
    the lower left of a view (2,): as far to the left and down as they have to be to lie inside.
    Marks outside the view keep theirs outside."""
    corners = marks_px + np.array([0.0, lift_px])
    inside = ((marks_px >= 0) & (marks_px <= view_px)).all(axis=1, keepdims=True)
    most = np.maximum(view_px - sizes_px - PLATE_PX, PLATE_PX)
    return np.where(inside, np.clip(corners, PLATE_PX, most), corners)
