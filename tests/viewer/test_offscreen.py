"""Pictures without a window obey the geometry: areas, places, colours, whatever the origin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon

from radiant_core.errors import BadInput
from radiant_viewer.layers.camera_layer import camera_layer
from radiant_viewer.layers.camera_roles import camera_roles
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import WHITE, ColorArray, category_colors, tint
from radiant_viewer.layers.region_layer import FILL_TINT, region_layer
from radiant_viewer.pictures.images import Drawing, Image, load_image, save_png
from radiant_viewer.pictures.offscreen import draw_map, draw_view, render_map, render_view
from radiant_viewer.runs.run_layers import plan_layers
from radiant_viewer.runs.run_pictures import plan_picture
from tests.viewer.made_up_run import made_up_town

SIZE_WH = (320, 220)
TOWN = made_up_town()
ROLES = camera_roles(TOWN.scene.cameras, TOWN.cloud_plan, TOWN.edge_plans, TOWN.held_out)


def colors(*rgb: list[int]) -> ColorArray:
    return np.array(rgb, np.uint8)


def share_of_color(image: Image, color: np.ndarray) -> float:
    return float((np.abs(image.astype(int) - color).max(axis=2) <= 1).mean())


def test_a_regions_share_of_the_pixels_is_its_share_of_the_area() -> None:
    drawing = draw_map([region_layer(TOWN.cloud_plan)], SIZE_WH)
    fills = tint(category_colors(3), WHITE, FILL_TINT)
    counted = np.array([share_of_color(drawing.image, fill) for fill in fills])
    areas = np.array([Polygon(border).area for border in TOWN.cloud_plan.borders])
    # 2 %: the border line hides a strip along each region's rim, longer for its area in smaller
    # regions.
    assert counted / counted.sum() == pytest.approx(areas / areas.sum(), rel=0.02)


def test_a_camera_is_drawn_in_its_colour_at_its_place_on_the_map() -> None:
    layer = camera_layer(TOWN.scene.cameras, ROLES, "region")
    drawing = draw_map([layer], SIZE_WH)
    columns, rows = np.floor(drawing.mark_px).astype(int).T
    # 2 levels: the colour is averaged over four equal samples and rounded.
    assert np.abs(drawing.image[rows, columns].astype(int) - layer.point_colors).max() <= 2


def test_a_camera_is_drawn_in_its_colour_where_the_perspective_projects_it() -> None:
    layer = camera_layer(TOWN.scene.cameras, ROLES, "split")
    dots = Layer(name="dots", points=layer.points, point_colors=layer.point_colors, point_size_px=6, point_rim=True)
    drawing = draw_view([dots], SIZE_WH)
    assert ((drawing.mark_px > 0) & (drawing.mark_px < SIZE_WH)).all()
    columns, rows = np.floor(drawing.mark_px).astype(int).T
    assert np.abs(drawing.image[rows, columns].astype(int) - layer.point_colors).max() <= 2


def test_later_layers_lie_over_earlier_ones_whatever_their_height() -> None:
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    high = Layer(name="high", polygons=(square + np.array([0, 0, 1000]),), polygon_colors=colors([200, 0, 0]))
    low = Layer(name="low", polygons=(square,), polygon_colors=colors([0, 0, 200]))
    assert draw_map([high, low], (64, 64)).image[32, 32].tolist() == [0, 0, 200]
    assert draw_map([low, high], (64, 64)).image[32, 32].tolist() == [200, 0, 0]


def test_borders_show_through_what_stands_before_them_in_a_view() -> None:
    wall = Layer(name="wall", polygons=(np.array([[-2.0, 0, -1], [2, 0, -1], [2, 0, 1], [-2, 0, 1]]),), polygon_colors=colors([255, 0, 0]))
    line = np.array([[[-2.0, 1, 0], [2, 1, 0]]])
    for in_front in (False, True):
        layer = Layer(name="line", segments=line, segment_colors=colors([0, 0, 0]), line_width_px=5, in_front=in_front)
        image = draw_view([wall, layer], (120, 90), (180, 0)).image
        # A region is see-through by 0.6, so a black line behind it is red at full depth and black
        # in front.
        darkest = image[..., 0].min()
        assert (darkest < 20) == in_front


@pytest.mark.parametrize("draw", [draw_map, draw_view])
def test_utm_coordinates_draw_the_same_picture(draw: Callable[[Sequence[Layer], tuple[int, int]], Drawing]) -> None:
    pictures = []
    for shift in ((0.0, 0.0), (431_204.5, 5_640_123.25)):
        town = made_up_town(shift)
        layers = plan_layers(town.scene, town.cloud_plan, town.edge_plans, ROLES)
        pictures.append(draw(layers, SIZE_WH).image.astype(int))
    # In float32 a northing of 5,640 km has steps of 50 cm, most of a pixel here: edges would jump.
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 8).mean() < 5e-4


def test_pictures_are_the_same_each_time() -> None:
    layers = plan_layers(TOWN.scene, TOWN.cloud_plan, TOWN.edge_plans, ROLES)
    assert np.array_equal(render_map(layers, (640, 420)), render_map(layers, (640, 420)))
    assert np.array_equal(render_view(layers, (640, 420)), render_view(layers, (640, 420)))


def test_the_page_has_the_size_asked_for_and_nothing_touches_its_rim() -> None:
    for size_wh in ((640, 420), (900, 700)):
        image = plan_picture(TOWN.scene, TOWN.cloud_plan, TOWN.edge_plans, TOWN.held_out, size_wh)
        assert image.shape == (size_wh[1], size_wh[0], 3)
        rim = [image[:3], image[-3:], image[:, :3], image[:, -3:]]
        assert all((strip == 255).all() for strip in rim)


@pytest.mark.parametrize("size_wh", [(0, 300), (300, -1), (100_000, 300)])
def test_a_size_beyond_reason_is_refused(size_wh: tuple[int, int]) -> None:
    with pytest.raises(BadInput, match="expected"):
        draw_map([region_layer(TOWN.cloud_plan)], size_wh)
    with pytest.raises(BadInput, match="expected"):
        render_map([region_layer(TOWN.cloud_plan)], size_wh)


def test_one_point_alone_can_be_drawn() -> None:
    alone = Layer(name="one", points=np.full((1, 3), 5.0), point_colors=colors([0, 0, 200]), point_size_px=9)
    for drawing in (draw_map([alone], (64, 48)), draw_view([alone], (64, 48))):
        assert drawing.image[24, 32].tolist() == [0, 0, 200]


def test_a_png_comes_back_as_it_was(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    save_png(tmp_path / "a.png", image)
    assert np.array_equal(load_image(tmp_path / "a.png"), image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_what_is_no_picture_is_not_written(tmp_path: Path) -> None:
    for path, image in (
        ("a.png", np.zeros((4, 4), np.uint8)),
        ("a.png", np.zeros((0, 4, 3), np.uint8)),
        ("a.jpg", np.zeros((4, 4, 3), np.uint8)),
    ):
        with pytest.raises(BadInput):
            save_png(tmp_path / path, image)
    with pytest.raises(BadInput, match="missing or broken"):
        load_image(tmp_path / "none.png")
    assert not list(tmp_path.iterdir())
