"""Trees, synthetic views, retraining and crop-merge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.retrain import known_parts, retrain_on_synthetic_views, teacher_views
from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

SITES = np.array([[-2.0, 0.0], [2.0, 0.0]])
WEST, EAST = cameras_above([(-2, -1), (-2, 1)]), cameras_above([(2, -1), (2, 1)])


def halves() -> tuple[Splats, Splats]:
    """Two models of the same ground, each good where its cameras were and grey beyond the middle."""
    truth = ground_splats()
    parts = []
    for sign in (-1, 1):
        sh0 = np.where((sign * truth.means[:, 0] > -1)[:, None, None], truth.sh0, 0)
        parts.append(Splats(**{**truth.arrays(), "sh0": sh0}))
    return parts[0], parts[1]


def known_together(west: Splats, east: Splats) -> Splats:
    masks = known_parts([west, east], [WEST, EAST])
    return concatenate_splats([west.select(masks[0]), east.select(masks[1])])


def test_a_model_speaks_of_what_it_saw_and_of_what_nobody_else_saw() -> None:
    model = ground_splats(400)
    west_knows, east_knows = known_parts([model, model], [WEST, EAST])
    west_sees, east_sees = WEST.any_sees(model.means), EAST.any_sees(model.means)
    assert west_knows[west_sees].all() and not west_knows[east_sees & ~west_sees].any()
    assert (west_knows | east_knows).all() and west_knows[~west_sees & ~east_sees].all()


class TestTree:
    tree = Tree(
        id="cloud",
        tier="cloud",
        children=tuple(Tree(id=e, tier="edge", children=(Tree(id=e + "1", tier="device"), Tree(id=e + "2", tier="device"))) for e in "ab"),
    )

    def test_children_come_before_parents(self) -> None:
        order = [node.id for node in self.tree]
        assert all(order.index(child.id) < order.index(node.id) for node in self.tree for child in node.children)
        assert len(order) == len(set(order)) == 7

    def test_fold_counts_the_leaves(self) -> None:
        assert self.tree.fold(lambda node, results: sum(results) if results else 1) == 4

    def test_renaming_twice_is_renaming_once_with_both(self) -> None:
        assert self.tree.map_ids(str.upper).map_ids(lambda i: i + "!") == self.tree.map_ids(lambda i: i.upper() + "!")

    def test_idle_devices_and_edges_are_left_out(self) -> None:
        cloud = CloudPlan(
            method="exact", edge_ids=("a", "b"), sites=SITES, weights=[0, 0], borders=(np.zeros((0, 2)),) * 2,
            edge_of_camera=[0, 0], edge_time_s=[1, 0], lower_bound_s=1.0, status="optimal", certified=True,
        )  # fmt: skip
        strips = (np.zeros((0, 2)),) * 2
        plans = [
            EdgePlan(
                edge_id="a", device_ids=("x", "y"), camera_indices=[0, 1], device_of_camera=[1, 1], strips=strips, device_time_s=[0, 1]
            ),
            EdgePlan(edge_id="b", device_ids=("u", "v"), camera_indices=[], device_of_camera=[], strips=strips, device_time_s=[0, 0]),
        ]
        assert [node.id for node in tree_of_plan(cloud, plans)] == ["devices/y", "edges/a", "cloud"]


def test_synthetic_views_are_the_models_own_pictures_weighted_by_alpha() -> None:
    model = ground_splats(100)
    views = synthetic_views(model, WEST)
    assert views.weights is not None
    for index, view in enumerate(render_views(model, WEST)):
        # Half a step of 8 bits is the rounding.
        assert np.abs(views.images[index] / 255 - view.image).max() <= 0.5 / 255 + 1e-6
        assert np.abs(views.weights[index] / 255 - view.alpha).max() <= 0.5 / 255 + 1e-6


def test_retraining_heals_what_a_blind_neighbour_covers() -> None:
    west, east = halves()
    train = replace(train_preset("draft"), long_side_px=48)
    views = teacher_views([west, east], [WEST, EAST], 48)

    def mean_psnr_db(splats: Splats) -> float:
        pairs = zip(render_views(splats, views.cameras), views.images, strict=True)
        return float(np.mean([psnr_db(view.image, image / 255) for view, image in pairs]))

    before = mean_psnr_db(concatenate_splats([west, east]))
    result = retrain_on_synthetic_views([west, east], [WEST, EAST], train, AggregateConfig(num_epochs=10), FitOptions())
    assert result.num_steps == 40
    assert mean_psnr_db(result.splats) > before + 3
    np.testing.assert_array_equal(result.splats.means, known_together(west, east).means)


def test_paper_preset_moves_the_centres() -> None:
    west, east = halves()
    config = AggregateConfig(preset="paper", max_num_steps=3)
    result = retrain_on_synthetic_views([west, east], [WEST, EAST], replace(train_preset("draft"), long_side_px=48), config, FitOptions())
    assert result.num_steps == 3
    assert (result.splats.means != known_together(west, east).means).any()


def test_a_single_model_comes_back_unchanged() -> None:
    model = ground_splats(50)
    result = retrain_on_synthetic_views([model], [WEST], train_preset("draft"), AggregateConfig(), FitOptions())
    np.testing.assert_array_equal(result.splats.sh0, model.sh0)


class TestCropMerge:
    def test_two_copies_of_one_model_merge_into_that_model(self) -> None:
        model = ground_splats()
        merged = crop_merge([model, model], SITES, np.zeros(2))
        assert merged.num_filled == 0 and len(merged.splats) == len(model) == merged.num_dropped
        np.testing.assert_array_equal(np.sort(merged.splats.means[:, 0]), np.sort(model.means[:, 0]))

    def test_a_weight_moves_the_border_by_the_documented_step(self) -> None:
        west = ground_splats(2000)
        east = replace(west, logit_opacities=west.logit_opacities + 1)  # the same places, so nobody is blind
        shift_m = 1.0
        merged = crop_merge([west, east], SITES, np.array([2 * 4.0 * shift_m, 0.0]))
        from_west = np.isin(merged.splats.logit_opacities, west.logit_opacities)
        assert merged.num_filled == 0
        assert merged.splats.means[from_west, 0].max() <= shift_m < merged.splats.means[~from_west, 0].min() + 0.05

    def test_a_neighbour_fills_where_the_owner_is_blind(self) -> None:
        everything = ground_splats()
        blind = everything.select(everything.means[:, 0] > 2)  # owner of the east has nothing near the border
        merged = crop_merge([everything, blind], SITES, np.zeros(2))
        assert merged.num_filled > 20
        gap = (merged.splats.means[:, 0] > 0.2) & (merged.splats.means[:, 0] < 1.2)
        assert gap.sum() > 20

    def test_nothing_is_lost_or_doubled_in_the_count(self) -> None:
        west, east = ground_splats(seed=1), ground_splats(seed=2)
        merged = crop_merge([west, east], SITES, np.zeros(2))
        assert merged.num_own + merged.num_filled == len(merged.splats)
        assert len(merged.splats) + merged.num_dropped == len(west) + len(east)

    def test_no_models_or_poisoned_borders_are_refused(self) -> None:
        with pytest.raises(BadInput, match="no models"):
            crop_merge([], np.zeros((0, 2)), np.zeros(0))
        with pytest.raises(BadInput, match="weights has 1 values that are not finite"):
            crop_merge([ground_splats(10)] * 2, SITES, np.array([0, np.nan]))
