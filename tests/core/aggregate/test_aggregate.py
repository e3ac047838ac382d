"""Trees, synthetic views, retraining and crop-merge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from radiant_core.aggregate.config import CLOUD_EPOCHS, Join
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.join import Joined, cut_at_borders, join_models, teacher_views
from radiant_core.aggregate.retrain import retraining_config
from radiant_core.aggregate.synthetic_views import Teacher, synthetic_views
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.geometry.coverage import reached_by
from radiant_core.hierarchy.decisions import join_decisions
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.claims import Claims, claims_of_cells
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

SITES = np.array([[-2.0, 0.0], [2.0, 0.0]])
WEST, EAST = cameras_above([(-2, -1), (-2, 1)]), cameras_above([(2, -1), (2, 1)])


def halves() -> tuple[Splats, Splats]:
    """Two models of one ground, each good where its cameras were and grey beyond the middle."""
    truth = ground_splats()
    parts = []
    for sign in (-1, 1):
        sh0 = np.where((sign * truth.means[:, 0] > -1)[:, None, None], truth.sh0, 0)
        parts.append(Splats(**{**truth.arrays(), "sh0": sh0}))
    return parts[0], parts[1]


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


TRAIN = replace(train_preset("draft"), long_side_px=48)
CELLS = claims_of_cells(SITES, np.zeros(2))


def teachers(models: list[Splats], cameras: list[Cameras]) -> list[Teacher]:
    return [Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)]


def joined(models: list[Splats], cameras: list[Cameras], **settings: Any) -> Joined:
    return join_models(teachers(models, cameras), TRAIN, Join(**settings), FitOptions(), CELLS)


def mean_psnr_db(splats: Splats, views: TrainingViews) -> float:
    pairs = zip(render_views(splats, views.cameras), views.images, strict=True)
    return float(np.mean([psnr_db(view.image, image / 255) for view, image in pairs]))


@pytest.mark.parametrize("claims", [CELLS, None])
def test_joining_heals_what_a_blind_neighbour_covers(claims: Claims | None) -> None:
    west, east = halves()
    views = teacher_views(teachers([west, east], [WEST, EAST]), 48)
    before = mean_psnr_db(concatenate_splats([west, east]), views)
    result = join_models(teachers([west, east], [WEST, EAST]), TRAIN, Join(), FitOptions(), claims)
    assert (result.trained.num_steps, result.num_shown, result.num_views) == (4 * CLOUD_EPOCHS, 4, 4)
    assert result.agreement_db is not None and before + 3 < result.agreement_db < 48
    assert mean_psnr_db(result.splats, views) > before + 3


def test_in_no_epoch_models_fade_and_the_cut_comes_beside() -> None:
    west, east = halves()
    result = joined([west, east], [WEST, EAST], epochs=0, faint_opacity=0.0)
    cut = cut_at_borders(teachers([west, east], [WEST, EAST]), CELLS).splats
    assert result.is_unfitted and result.trained.num_steps == 0 and result.check is None
    assert result.cut is not None and len(result.cut) == len(cut) < len(result.splats) == len(west) + len(east)
    owned = np.flatnonzero(result.splats.logit_opacities == concatenate_splats([west, east]).logit_opacities)
    np.testing.assert_array_equal(result.splats.means[owned], result.cut.means)
    (decision,) = [one for one in join_decisions("cloud", Join(epochs=0), 2, result) if one.topic == "retraining"]
    assert decision.choice.startswith("models fade where others own the place") and not decision.changes_nothing


def test_models_that_agree_are_cut_and_not_retrained() -> None:
    model = ground_splats(400)
    result = joined([model, model], [WEST, EAST], foreign_opacity=1e-3)
    assert result.trained.num_steps == 0 and result.agreement_db is not None and result.agreement_db >= 48
    assert len(result.splats) == len(model)
    np.testing.assert_array_equal(np.unique(result.splats.means, axis=0), np.unique(model.means, axis=0))
    forced = joined([model, model], [WEST, EAST], foreign_opacity=1e-3, agreement_db=None)
    assert forced.trained.num_steps == 4 * CLOUD_EPOCHS


def test_what_no_second_model_knows_keeps_its_bits() -> None:
    """Two places far apart, each with two models; the second place's models share no view."""
    ground = ground_splats(400)
    far = replace(ground, means=ground.means + np.float32([1000, 0, 0]))
    west, east = halves()
    alone = cameras_above([(998, -1), (998, 1)])
    alone = replace(alone, names=tuple(f"far-{name}" for name in alone.names))
    models = [west, concatenate_splats([east, far])]
    result = joined(models, [WEST, concatenate_cameras([EAST, alone])])
    assert (result.num_shown, result.num_views) == (4, 6)
    kept = result.splats.select(result.splats.means[:, 0] > 500)
    order = np.lexsort(far.means.T)
    for name, array in kept.arrays().items():
        np.testing.assert_array_equal(array[np.lexsort(kept.means.T)], far.arrays()[name][order])


def test_nothing_contested_is_a_plain_cut() -> None:
    ground = ground_splats(100)
    far = replace(ground, means=ground.means + np.float32([1000, 0, 0]))
    alone = replace(cameras_above([(1002, 0)]), names=("far",))
    result = joined([ground, far], [WEST, alone])
    assert (result.num_shown, result.trained.num_steps) == (0, 0)
    # In the eastern cell, too, where the other model has nothing, the western one keeps all.
    np.testing.assert_array_equal(result.splats.means, np.concatenate([ground.means, far.means]))


def test_paper_preset_concatenates_and_retrains_everything() -> None:
    west, east = halves()
    both = concatenate_splats([west, east])
    result = joined([west, east], [WEST, EAST], method="paper", max_num_steps=3)
    assert result.trained.num_steps == 3 and len(result.splats) == len(both)
    assert (result.splats.means != both.means).any()


def test_joining_keeps_its_own_rates_however_long_it_takes() -> None:
    config = retraining_config(train_preset("default"), Join(epochs=100), ground_splats(), 50)
    assert config.num_steps == 5_000 and config.settle_epochs is None and train_preset("default").settle_epochs == 12


def test_a_single_model_comes_back_unchanged() -> None:
    model = ground_splats(50)
    result = joined([model], [WEST])
    np.testing.assert_array_equal(result.splats.sh0, model.sh0)
    assert result.trained.num_steps == 0


def test_a_gaussian_reaches_an_image_as_far_as_three_deviations() -> None:
    camera = cameras_above([(0, 0)])
    (view,) = render_views(ground_splats(1), camera)
    rng = np.random.default_rng(0)
    count = 4000
    places = replace(ground_splats(count), means=(rng.uniform(-12, 12, (count, 3))).astype(np.float32))
    places = replace(places, log_scales=np.log(rng.uniform(0.01, 2, (count, 1)).repeat(3, 1)).astype(np.float32))
    reached = reached_by(places, camera)
    height, width = view.alpha.shape
    pixels = np.stack(np.meshgrid(np.linspace(0, width, 25), np.linspace(0, height, 25)), -1).reshape(-1, 2)
    rays = np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(camera.Ks[0]).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    in_camera = places.means.astype(np.float64) @ camera.cam_from_world[0, :3, :3].T + camera.cam_from_world[0, :3, 3]
    along = np.maximum(0, in_camera @ rays.T)
    nearest = np.sqrt(np.maximum(0, (in_camera**2).sum(1)[:, None] - 2 * along * (in_camera @ rays.T) + along**2)).min(axis=1)
    radii = 3 * np.exp(places.log_scales[:, 0].astype(np.float64))
    assert reached[nearest < radii].all()
    # The test by planes keeps a few more, near the pyramid's edges and tip.
    assert 0.3 < reached.mean() < 0.9 and (reached & (nearest > 1.6 * radii + 0.1)).mean() < 0.02


class TestCropMerge:
    def test_two_copies_of_one_model_merge_into_that_model(self) -> None:
        model = ground_splats()
        merged = crop_merge([model, model], SITES, np.zeros(2))
        assert len(merged) == len(model)
        np.testing.assert_array_equal(np.sort(merged.means[:, 0]), np.sort(model.means[:, 0]))

    def test_a_weight_moves_the_border_by_the_documented_step(self) -> None:
        west = ground_splats(2000)
        east = replace(west, logit_opacities=west.logit_opacities + 1)
        shift_m = 1.0
        merged = crop_merge([west, east], SITES, np.array([2 * 4.0 * shift_m, 0.0]))
        from_west = np.isin(merged.logit_opacities, west.logit_opacities)
        assert merged.means[from_west, 0].max() <= shift_m < merged.means[~from_west, 0].min() + 0.05

    def test_no_models_or_poisoned_borders_are_refused(self) -> None:
        with pytest.raises(BadInput, match="no models"):
            crop_merge([], np.zeros((0, 2)), np.zeros(0))
        with pytest.raises(BadInput, match="weights has 1 values that are not finite"):
            crop_merge([ground_splats(10)] * 2, SITES, np.array([0, np.nan]))
