"""Labels of a map stand above their marks at any zoom, whole inside the view, in any script, and can be removed."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from radiant_viewer.layers.layer import Label
from radiant_viewer.layers.map_labels import LIFT_PX, PLATE_PX, add_map_labels, label_corners
from radiant_viewer.layers.themes import LIGHT
from radiant_viewer.pictures.offscreen import egl_rendering

SIZE = 200


def test_a_label_keeps_off_its_mark_at_every_zoom() -> None:
    with egl_rendering():
        plotter = pv.Plotter(off_screen=True, window_size=[SIZE, SIZE])
    plotter.background_color = pv.Color("black")
    place, origin = np.array([5e5 + 3.0, 5e6 - 2.0, 0.0]), np.array([5e5, 5e6, 0.0])
    labels = [Label(text="Zürich, 30 m²\n12 cameras", position=place)]
    camera = plotter.camera
    camera.parallel_projection = True
    camera.focal_point, camera.position, camera.up = (3.0, -2.0, 0.0), (3.0, -2.0, 50.0), (0.0, 1.0, 0.0)
    actor = add_map_labels(plotter, labels, origin, 0.0, LIGHT, 11)
    plotter.show(auto_close=False, interactive=False)

    def lit_rows(half_height: float) -> np.ndarray:
        camera.parallel_scale = half_height
        plotter.render()
        image = plotter.screenshot(return_img=True)
        assert image is not None
        return np.flatnonzero(image.max(axis=(1, 2)) > 100)

    for half_height in (10.0, 1000.0):
        rows = lit_rows(half_height)
        # Rows count from the top, and the mark of 11 px is in the middle one.
        assert len(rows) > 8
        assert rows.max() < SIZE / 2 - 6
        assert rows.min() > SIZE / 2 - 3 * LIFT_PX
    plotter.remove_actor(actor, render=False)
    assert not len(lit_rows(20.0))
    plotter.close()


def test_labels_at_the_rims_are_whole_and_leave_with_their_marks() -> None:
    view, texts = np.array([SIZE, 120.0]), np.array([[90.0, 11], [90, 11], [90, 11], [300, 11]])
    marks = np.array([[40.0, 50], [195, 115], [201, 50], [20, 20]])
    corners = label_corners(marks, texts, view, LIFT_PX)
    assert corners[0].tolist() == [40, 50 + LIFT_PX]
    assert (corners[1] + texts[1] <= view - PLATE_PX).all()
    # The third mark is outside, and the fourth text wider than the view: it begins inside.
    assert corners[2].tolist() == [201, 50 + LIFT_PX]
    assert corners[3, 0] == PLATE_PX


def test_a_label_is_drawn_whole_at_the_right_rim() -> None:
    with egl_rendering():
        plotter = pv.Plotter(off_screen=True, window_size=[SIZE, SIZE])
    plotter.background_color = pv.Color("black")
    camera = plotter.camera
    camera.parallel_projection, camera.parallel_scale = True, SIZE / 2
    camera.focal_point, camera.position, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 50.0), (0.0, 1.0, 0.0)

    def lit_columns(x: float) -> np.ndarray:
        actor = add_map_labels(plotter, [Label(text="Path 113.3 m, area", position=np.array([x, 0.0, 0.0]))], np.zeros(3), 0.0, LIGHT, 11)
        plotter.show(auto_close=False, interactive=False)
        image = plotter.screenshot(return_img=True)
        assert image is not None
        plotter.remove_actor(actor, render=False)
        return np.flatnonzero(image.max(axis=(0, 2)) > 100)

    middle, rim = lit_columns(-60.0), lit_columns(SIZE / 2 - 5.0)
    assert np.ptp(rim) == np.ptp(middle) > 90
    assert rim.max() < SIZE - 1
    plotter.close()
