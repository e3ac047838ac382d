"""An edge that leaves joining to the cloud: its models as one, and the pictures of each at the
virtual cameras near its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.agreement import MIN_AGREEMENT_DB, measure_agreement_db
from radiant_core.aggregate.cloud_choice import cloud_needs, pooled_needs
from radiant_core.aggregate.config import AggregateConfig, aggregate_preset
from radiant_core.aggregate.ownership import claims_of_cells, ownership
from radiant_core.aggregate.pooling import pool_teachers, render_pictures
from radiant_core.aggregate.retrain import retrain_on_synthetic_views
from radiant_core.aggregate.synthetic_views import Teacher, views_in_bytes
from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_C0, Splats
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

WEST, EAST = cameras_above([(-2, -1), (-2, 1)]), cameras_above([(2, -1), (2, 1)])
CELLS = claims_of_cells(np.array([[-2.0, 0.0], [2.0, 0.0]]), np.zeros(2))
POOL = AggregateConfig()


def dark_and_bright() -> tuple[Teacher, Teacher]:
    """The same ground for both; the second teacher's is brighter by a fifth of the range."""
    ground = ground_splats(300)
    bright = replace(ground, sh0=ground.sh0 + np.float32(0.2 / SH_C0))
    return Teacher(splats=ground, cameras=WEST), Teacher(splats=bright, cameras=EAST)


def virtual(seed: int = 0) -> tuple:
    teachers = dark_and_bright()
    return virtual_cameras(concatenate_cameras([WEST, EAST]), teachers[0].splats.means, np.random.default_rng(seed))


def test_a_virtual_camera_is_drawn_near_the_one_it_names() -> None:
    real = concatenate_cameras([WEST, EAST])
    drawn, near = virtual()
    assert sorted(near) == [0, 1, 2, 3]
    # Within 2 % of the distance to the ground, far less than the cameras stand apart.
    assert np.linalg.norm(drawn.centers - real.centers[near], axis=1).max() < 0.2
    again, _ = virtual_cameras(real, dark_and_bright()[0].splats.means, np.random.default_rng(0))
    assert again.names == drawn.names


def test_everything_is_pooled_and_nothing_moves_but_opacities_beyond_the_own_region() -> None:
    west, east = dark_and_bright()
    result = pool_teachers([west, east], POOL, CELLS)
    assert result.trained.num_steps == 0 and len(result.splats) == result.num_given == 600
    np.testing.assert_array_equal(result.splats.means[:300], west.splats.means)
    opacity, before = result.splats.opacities, west.splats.opacities
    owned = west.splats.means[:, 0] < -0.5  # well inside the western cell, both cover it
    np.testing.assert_allclose(opacity[:300][owned], before[owned], rtol=1e-5)
    np.testing.assert_allclose(opacity[300:][owned], POOL.foreign_opacity * before[owned], rtol=1e-4)
    with pytest.raises(BadInput, match="no models to pool"):
        pool_teachers([], POOL)


@pytest.mark.parametrize("least", [0.0, 0.1, 0.25])
def test_what_would_be_too_faint_in_anothers_place_is_left_out(least: float) -> None:
    west, east = dark_and_bright()
    thin = replace(west.splats, logit_opacities=np.linspace(-8, 8, 300, dtype=np.float32))
    west, east = replace(west, splats=thin), replace(east, splats=replace(east.splats, logit_opacities=thin.logit_opacities))
    result = pool_teachers([west, east], replace(POOL, faint_opacity=least), CELLS)
    opacity = 1 / (1 + np.exp(-thin.logit_opacities.astype(np.float64)))
    foreign = [ownership(thin.means, [WEST, EAST], CELLS).owner == other for other in (1, 0)]
    kept = np.concatenate([~away | (POOL.foreign_opacity * opacity >= least) for away in foreign])
    assert result.num_given == 600 and (kept.sum() < 600) == (least > 0)
    np.testing.assert_array_equal(result.splats.means, np.concatenate([thin.means, thin.means])[kept])
    # Of its own places, each model keeps all, however faint.
    assert result.splats.opacities.min() < 0.001


@pytest.mark.parametrize("least", [-0.1, 1.0, np.nan])
def test_a_least_opacity_that_is_none_is_refused(least: float) -> None:
    with pytest.raises(BadInput, match="faint_opacity"):
        AggregateConfig(faint_opacity=least)


def test_each_picture_is_of_the_model_whose_camera_is_near() -> None:
    west, east = dark_and_bright()
    drawn, near = virtual()
    pictures = render_pictures([west, east], drawn, near, 48)
    assert sorted(pictures) == [0, 1, 2, 3]
    for model, rows in ((west.splats, np.flatnonzero(near < 2)), (east.splats, np.flatnonzero(near >= 2))):
        for row, (image, weight) in zip(rows, views_in_bytes(model, drawn.select(rows).scaled(48)), strict=True):
            np.testing.assert_array_equal(pictures[row][0], image)
            np.testing.assert_array_equal(pictures[row][1], weight)
    with pytest.raises(BadInput, match="stand near rows"):
        render_pictures([west, east], drawn, near + 1, 48)


def mean_psnr_db(splats: Splats, teacher: Teacher) -> float:
    shown = zip(render_views(splats, teacher.cameras), render_views(teacher.splats, teacher.cameras), strict=True)
    return float(np.mean([psnr_db(one.image, other.image) for one, other in shown]))


def test_a_pooled_model_is_joined_also_where_it_is_the_only_one() -> None:
    west, east = dark_and_bright()
    drawn, near = virtual()
    one = Teacher(
        splats=pool_teachers([west, east], POOL, CELLS).splats, cameras=drawn, rendered=render_pictures([west, east], drawn, near, 48)
    )
    train = replace(train_preset("draft"), long_side_px=48)
    untouched = retrain_on_synthetic_views([one], train, POOL, FitOptions())
    assert untouched.trained.num_steps == 0 and untouched.splats is one.splats
    result = retrain_on_synthetic_views([replace(one, pooled=True)], train, POOL, FitOptions())
    assert (result.trained.num_steps, result.num_shown) == (4 * POOL.num_epochs, 4)
    assert min(mean_psnr_db(result.splats, teacher) - mean_psnr_db(one.splats, teacher) for teacher in (west, east)) > 0.1


def test_pictures_that_show_something_else_are_told_apart() -> None:
    west, east = dark_and_bright()
    drawn, near = virtual()
    pictures = render_pictures([west, east], drawn, near, 48)
    own, cameras = pool_teachers([west, east], POOL, CELLS).splats, drawn.scaled(48)
    assert measure_agreement_db(own, cameras, [pictures[index] for index in range(4)]) > MIN_AGREEMENT_DB
    inverted = [(255 - image, weight) for image, weight in (pictures[index] for index in range(4))]
    assert measure_agreement_db(own, cameras, inverted) < MIN_AGREEMENT_DB
    blind = [(image, np.zeros_like(weight)) for image, weight in inverted]
    assert measure_agreement_db(own, cameras, blind) == np.inf


def test_edges_pool_only_for_a_cloud_that_retrains() -> None:
    assert POOL.edges_pool and not aggregate_preset("paper").edges_pool
    assert not replace(POOL, cloud="crop_merge").edges_pool and not replace(POOL, edges="retrain").edges_pool
    with pytest.raises(BadInput, match="expected 'pool' or 'retrain'"):
        AggregateConfig(edges="both")  # type: ignore[arg-type]


def test_what_the_cloud_needs_is_foreseen_from_an_edges_share() -> None:
    west, _ = dark_and_bright()
    own = cloud_needs([west.splats], [WEST], 48, None)
    whole = cloud_needs([west.splats] * 4, [WEST] * 4, 48, None)
    foreseen = pooled_needs([west.splats], [WEST], 48, 0.25)
    assert foreseen.num_cameras == whole.num_cameras and own.memory_bytes < whole.memory_bytes <= foreseen.memory_bytes
