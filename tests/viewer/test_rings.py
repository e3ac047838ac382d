"""A mark that is a ring leaves what it marks visible, and differs from it by its shape."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv

from radiant_viewer.layers.drawing import RIM_PX, add_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import BLUE, INK, VERMILLION
from radiant_viewer.pictures.offscreen import egl_rendering

SIZE, RING_PX = 61, 30.0
NAMED = {"dot": BLUE, "ground": (255, 255, 255), "rim": INK, "ring": VERMILLION}


def dot(color: tuple[int, int, int], size_px: float, *, ring: bool) -> Layer:
    colors = np.array([color], np.uint8)
    return Layer(name=str(ring), points=np.zeros((1, 3)), point_colors=colors, point_size_px=size_px, point_rim=ring, ring_points=ring)


@pytest.mark.parametrize("line_scale", [1.0, 1.5])
def test_a_ring_shows_the_dot_inside_and_has_rims_on_both_sides(line_scale: float) -> None:
    with egl_rendering():
        plotter = pv.Plotter(off_screen=True, window_size=[SIZE, SIZE])
    plotter.background_color = pv.Color("white")
    for height, layer in ((0.0, dot(BLUE, 12.0, ring=False)), (10.0, dot(VERMILLION, RING_PX, ring=True))):
        add_layer(plotter, layer, np.zeros(3), line_scale=line_scale, flat_height=height)
    camera = plotter.camera
    camera.parallel_projection, camera.parallel_scale = True, SIZE / 2
    camera.focal_point, camera.position, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 50.0), (0.0, 1.0, 0.0)
    plotter.show(auto_close=False, interactive=False)
    image = plotter.screenshot(return_img=True)
    plotter.close()
    assert image is not None
    row = image[SIZE // 2].astype(int)
    # From the middle to the right: the dot, white, ink, the ring, ink, white.
    seen = [next((name for name, color in NAMED.items() if (np.abs(pixel - color) <= 3).all()), "between") for pixel in row[SIZE // 2 :]]
    order = [name for index, name in enumerate(seen) if name != "between" and name not in seen[max(0, index - 1) : index]]
    assert [name for index, name in enumerate(order) if index == 0 or name != order[index - 1]] == [
        "dot", "ground", "rim", "ring", "rim", "ground",
    ]  # fmt: skip
    edge = max(index for index, name in enumerate(seen) if name in ("ring", "rim"))
    assert edge == pytest.approx((RING_PX + RIM_PX) / 2 * line_scale, abs=1.5)
