"""Layers before they are drawn: shapes refused, colours per role, seams, figures in legends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from radiant_core.errors import BadInput
from radiant_core.geometry.support import Support
from radiant_viewer.layers.camera_layer import camera_layer, pyramid_segments
from radiant_viewer.layers.camera_roles import NOBODY, camera_roles
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.layers.palette import BLUE, VERMILLION, category_colors, heat_colors
from radiant_viewer.layers.region_layer import duration_text, edge_site_layer, region_layer, strip_layer
from radiant_viewer.layers.seam_layer import color_steps, seam_layer, seam_pieces
from radiant_viewer.layers.splat_layer import sparse_point_layer, splat_layer
from radiant_viewer.layers.support_layer import LOOSE, MORE, TWO, support_layer
from radiant_viewer.pictures.measure import scale_bar_length
from tests.core.scenes import ground_splats
from tests.viewer.made_up_run import HALF_WH, made_up_town

TOWN = made_up_town()
ROLES = camera_roles(TOWN.scene.cameras, TOWN.cloud_plan, TOWN.edge_plans, TOWN.held_out)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_layer_refuses_coordinates_that_are_not_finite_and_names_itself(bad: float) -> None:
    with pytest.raises(BadInput, match="Sparse"):
        Layer(name="Sparse", points=np.array([[0, 0, bad]]), point_colors=np.zeros((1, 3), np.uint8))


def test_a_layer_refuses_colours_that_do_not_match_in_number() -> None:
    with pytest.raises(BadInput, match="point_colors"):
        Layer(name="Sparse", points=np.zeros((3, 3)), point_colors=np.zeros((2, 3), np.uint8))


def test_layers_without_geometry_are_nothing_to_draw() -> None:
    with pytest.raises(BadInput, match="nothing to draw"):
        framing_positions([Layer(name="empty")])


def test_strays_among_many_points_do_not_widen_the_picture_but_every_camera_counts() -> None:
    points = np.concatenate([TOWN.scene.points, [[1e6, 0, 0], [0, -1e6, 0]]])
    layer = Layer(name="points", points=points, point_colors=np.zeros((len(points), 3), np.uint8))
    assert np.abs(framing_positions([layer])).max() <= max(HALF_WH)
    few = Layer(name="cameras", points=points[-30:], point_colors=np.zeros((30, 3), np.uint8))
    assert np.abs(framing_positions([few])).max() == 1e6


def test_the_far_sky_of_a_model_does_not_shrink_borders_and_towers_stay_in_the_picture() -> None:
    directions = np.random.default_rng(0).normal(size=(400, 3))
    sky = 1000 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    tower = np.column_stack([np.zeros((50, 2)), np.linspace(0, 20, 50)])
    cloud = np.concatenate([TOWN.scene.points, tower, sky])
    model = Layer(name="model", points=cloud, point_colors=np.zeros((len(cloud), 3), np.uint8))
    border = np.array([[[-10.0, 0, 0], [10.0, 0, 0]]])
    seam = Layer(name="seam", segments=border, segment_colors=np.zeros((1, 3), np.uint8))
    assert np.abs(framing_positions([model])[:, :2]).max() <= max(HALF_WH)
    both = framing_positions([model, seam])
    assert np.ptp(both[:, 0]) <= 1.5 * 20
    assert both[:, 2].max() >= 4.5


def test_every_colour_of_a_category_is_its_own_up_to_21_regions() -> None:
    assert len(np.unique(category_colors(21), axis=0)) == 21


@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=20), st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_a_higher_value_is_never_darker_on_the_heat_scale(values: list[float], low: float, span: float) -> None:
    ordered = heat_colors(np.sort(values), low, low + span).astype(float)
    # 3 levels: neighbouring colours of the table are rounded to 8 bits, so their luminance may dip
    # by that.
    assert (np.diff(ordered @ [0.2126, 0.7152, 0.0722]) >= -3).all()


@given(st.floats(1e-6, 1e9))
def test_a_scale_bar_is_1_2_or_5_times_a_power_of_ten_and_fills_at_least_two_fifths_of_its_room(limit: float) -> None:
    length = scale_bar_length(limit)
    assert 0.4 * limit * (1 - 1e-6) <= length <= limit * (1 + 1e-6)
    assert f"{length:.0e}"[0] in "125"


@pytest.mark.parametrize(("seconds", "text"), [(0, "0 s"), (42, "42 s"), (190, "3.17 min"), (7200, "2 h")])
def test_durations_read_as_one_would_say_them(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_held_out_cameras_stay_out_of_the_roles_when_the_plan_counts_training_cameras_only() -> None:
    training = np.flatnonzero(~ROLES.held_out)
    plan = replace(TOWN.cloud_plan, edge_of_camera=TOWN.cloud_plan.edge_of_camera[training])
    roles = camera_roles(TOWN.scene.cameras, plan, (), TOWN.held_out)
    assert (roles.edge_of_camera[roles.held_out] == NOBODY).all()
    assert (roles.edge_of_camera[training] == TOWN.cloud_plan.edge_of_camera[training]).all()


def test_a_plan_of_another_scene_is_refused_with_both_counts() -> None:
    with pytest.raises(BadInput, match=r"24 cameras.*10|10.*24"):
        camera_roles(TOWN.scene.cameras.select(range(10)), TOWN.cloud_plan, TOWN.edge_plans, ())


def test_an_unknown_held_out_name_is_refused() -> None:
    with pytest.raises(BadInput, match=r"nowhere\.jpg"):
        camera_roles(TOWN.scene.cameras, TOWN.cloud_plan, TOWN.edge_plans, {"nowhere.jpg"})


def test_cameras_take_the_colour_of_their_region_and_held_out_ones_are_white() -> None:
    layer = camera_layer(TOWN.scene.cameras, ROLES, "region")
    expected = category_colors(3)[TOWN.cloud_plan.edge_of_camera]
    assert (layer.point_colors[~ROLES.held_out] == expected[~ROLES.held_out]).all()
    assert (layer.point_colors[ROLES.held_out] == 255).all()
    assert layer.points == pytest.approx(TOWN.scene.cameras.centers)


def test_every_device_has_a_shade_of_its_own() -> None:
    colors = camera_layer(TOWN.scene.cameras, ROLES, "device").point_colors[~ROLES.held_out]
    devices = ROLES.device_of_camera[~ROLES.held_out]
    assert len(np.unique(np.column_stack([devices, colors]), axis=0)) == len(np.unique(devices)) == len(np.unique(colors, axis=0))


def test_the_split_is_blue_and_vermillion() -> None:
    colors = camera_layer(TOWN.scene.cameras, ROLES, "split").point_colors
    assert (colors == np.where(ROLES.held_out[:, None], VERMILLION, BLUE)).all()


def test_colouring_by_psnr_needs_figures_and_an_unknown_colouring_names_the_known() -> None:
    with pytest.raises(BadInput, match="evaluate"):
        camera_layer(TOWN.scene.cameras, ROLES, "psnr", {})
    with pytest.raises(BadInput, match="region, device, split or psnr"):
        camera_layer(TOWN.scene.cameras, ROLES, "speed")  # pyright: ignore[reportArgumentType]


def test_pyramids_start_at_the_centre_and_end_where_the_image_corners_project() -> None:
    cameras = TOWN.scene.cameras.select([4, 9])
    lines = pyramid_segments(cameras, 7.0).reshape(2, 8, 2, 3)
    for index in range(2):
        assert lines[index, :4, 0] == pytest.approx(np.tile(cameras.centers[index], (4, 1)))
        in_camera = lines[index, :4, 1] @ cameras.cam_from_world[index, :3, :3].T + cameras.cam_from_world[index, :3, 3]
        pixels = (in_camera @ cameras.Ks[index].T)[:, :2] / in_camera[:, 2:]
        assert in_camera[:, 2] == pytest.approx(7.0)
        assert {tuple(pixel) for pixel in pixels.round(6)} == {(0, 0), (640, 0), (640, 480), (0, 480)}


def test_legends_state_counts_and_times() -> None:
    texts = [entry.text for entry in region_layer(TOWN.cloud_plan).legend]
    assert texts[1] == f"harbour: {TOWN.cloud_plan.counts[1]} cameras, 4.33 min"
    assert [entry.text.split(":")[0] for entry in strip_layer(TOWN.cloud_plan, TOWN.edge_plans).legend][:2] == [
        "north-1",
        "north-2",
    ]


def test_an_edge_far_away_is_counted_in_the_legend_instead_of_shrinking_the_map() -> None:
    far = replace(TOWN.cloud_plan, sites=TOWN.cloud_plan.sites + np.array([[0, 0], [0, 0], [0, 1e4]]))
    layer = edge_site_layer(far)
    assert len(layer.points) == len(layer.labels) == 2
    assert "1 outside the map" in layer.legend[0].text


def test_seams_are_the_inner_borders_once_each_and_never_the_outer_edge() -> None:
    pieces = seam_pieces(TOWN.cloud_plan, 5.0)
    lengths = np.linalg.norm(pieces.ends[:, 1] - pieces.ends[:, 0], axis=1)
    assert lengths.max() <= 5.0
    outer = 2 * sum(2 * side for side in HALF_WH)
    borders = sum(np.linalg.norm(np.roll(border, -1, axis=0) - border, axis=1).sum() for border in TOWN.cloud_plan.borders)
    # Both regions have an inner side, one has an outer side. The corner where three regions meet is
    # shared exactly.
    assert lengths.sum() == pytest.approx((borders - outer) / 2, rel=1e-9)
    middles = pieces.ends.mean(axis=1)
    distances = np.linalg.norm(middles[:, None] - TOWN.cloud_plan.sites, axis=2)
    first, second = (distances[np.arange(len(pieces.ends)), pieces.edge_pairs[:, side]] for side in range(2))
    assert first == pytest.approx(second)


def test_a_planted_seam_of_30_levels_is_found_and_the_border_without_one_is_not() -> None:
    town = made_up_town(step_levels=30)
    pieces = seam_pieces(town.cloud_plan, 10.0)
    steps = color_steps(town.splats, pieces, 10.0).levels
    beside_harbour = (pieces.edge_pairs == 1).any(axis=1)
    # Bands hold some 20 Gaussians of 12 levels noise: two means differ by 4 levels without any
    # seam.
    assert np.nanmedian(steps[beside_harbour]) == pytest.approx(30, abs=4)
    assert np.nanmedian(steps[~beside_harbour]) < 4


def test_where_no_gaussians_lie_a_seam_has_no_figure_and_the_legend_counts_it() -> None:
    pieces = seam_pieces(TOWN.cloud_plan, 10.0)
    west = TOWN.splats.select(TOWN.splats.means[:, 0] < -30)
    steps = color_steps(west, pieces, 10.0).levels
    assert np.isnan(steps).any()
    layer = seam_layer(pieces, steps, "Colour step (levels)")
    assert f"{int(np.isnan(steps).sum())} of {len(steps)}" in layer.legend[0].text


def test_a_seam_layer_refuses_another_number_of_values() -> None:
    with pytest.raises(BadInput, match="values of the seam"):
        seam_layer(seam_pieces(TOWN.cloud_plan, 10.0), [1.0, 2.0], "Colour step (levels)")


def test_point_layers_say_what_they_left_out() -> None:
    assert "1,000 of 9,000" in sparse_point_layer(TOWN.scene, max_points=1000).legend[0].text
    faint = replace(TOWN.splats, logit_opacities=np.linspace(-9, 9, len(TOWN.splats)))
    layer = splat_layer(faint, min_opacity=0.5)
    assert len(layer.points) == pytest.approx(len(TOWN.splats) / 2, abs=1)


def test_gaussians_are_coloured_by_their_support_and_the_loosest_lie_on_top() -> None:
    splats = ground_splats(5)
    support = Support(num_views=np.array([1, 2, 5, 9, 2]), parallax_deg=np.array([0.0, 20.0, 30.0, 1.0, 9.0]), shown_px=np.ones(5))
    layer = support_layer(splats, support, splats.means.astype(np.float64))
    assert layer.point_colors.tolist() == [list(color) for color in (MORE, TWO, TWO, LOOSE, LOOSE)]
    np.testing.assert_array_equal(layer.points, splats.means[[2, 1, 4, 0, 3]].astype(np.float64))
    assert [entry.text.split(" ")[0] for entry in layer.legend] == ["2", "2", "1"]
