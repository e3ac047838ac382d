"""A new region joined to a finished scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.config import Join
from radiant_core.aggregate.extend import Extended, NewRegion, extend_scene
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import Adc, NoDensification
from radiant_core.train.trainer import FitOptions, fit_splats
from tests.core.scenes import cameras_above, ground_splats

TRAIN = replace(train_preset("draft"), long_side_px=48)
EAST = NewRegion(polygon=np.array([[0.0, -5], [5, -5], [5, 5], [0, 5]]), margin_m=1.0)
CAMERAS = cameras_above([(1, -2), (1, 0), (1, 2), (2.5, -1), (2.5, 1)])
AT_THE_BORDER = cameras_above([(0, -1), (0, 1)])


def grey_where(splats: Splats, away: np.ndarray) -> Splats:
    return replace(splats, sh0=np.where(away[:, None, None], np.float32(0), splats.sh0))


def old_and_new() -> tuple[Splats, Splats, Splats]:
    """The truth, an old scene that is grey in the east, a new model that is grey in the west."""
    truth = ground_splats(900)
    return truth, grey_where(truth, truth.means[:, 0] > 1.2), grey_where(truth, truth.means[:, 0] < -1.2)


def extended(old: Splats, new: Splats, region: NewRegion = EAST, *, epochs: int = 6) -> Extended:
    return extend_scene(old, Teacher(splats=new, cameras=CAMERAS), region, TRAIN, Join(epochs=epochs), FitOptions())


def border_psnr_db(made: Splats, truth: Splats) -> float:
    pairs = zip(render_views(made, AT_THE_BORDER), render_views(truth, AT_THE_BORDER), strict=True)
    return float(np.mean([psnr_db(one.image, other.image) for one, other in pairs]))


def test_beyond_the_margin_not_one_bit_changes_and_the_border_heals() -> None:
    truth, old, new = old_and_new()
    made = extended(old, new)
    kept = old.select(EAST.inside_m(old.means) < -EAST.margin_m)
    assert made.num_kept == len(kept) > 200 and made.num_replaced > 200 and made.num_shown == len(CAMERAS) and made.num_filled == 0
    for name, array in kept.arrays().items():
        assert np.array_equal(getattr(made.splats.select(np.arange(made.num_kept)), name), array, equal_nan=True), name
    core = new.select(EAST.inside_m(new.means) > EAST.margin_m)
    added = made.splats.select(np.arange(made.num_kept, made.num_kept + made.num_added))
    assert made.num_added == len(core) and np.array_equal(added.sh0, core.sh0)
    assert len(made.splats) == made.num_kept + made.num_filled + made.num_added + made.num_fitted
    assert border_psnr_db(made.splats, truth) > max(30.0, border_psnr_db(old, truth) + 6, border_psnr_db(new, truth) + 6)


def test_where_no_camera_looks_the_models_are_cut_at_the_border() -> None:
    _, old, new = old_and_new()
    far = NewRegion(polygon=np.array([[3.5, 3.5], [5, 3.5], [5, 5], [3.5, 5]]), margin_m=0.2)
    looks_away = replace(CAMERAS, cam_from_world=CAMERAS.cam_from_world - np.array([[0, 0, 0, 100.0], [0] * 4, [0] * 4, [0] * 4]))
    made = extend_scene(old, Teacher(splats=new, cameras=looks_away), far, TRAIN, Join(), FitOptions())
    assert made.num_shown == 0
    inside = far.inside_m(old.means) > 0
    expected = np.concatenate([old.means[~inside], new.means[far.inside_m(new.means) > 0]])
    assert np.array_equal(np.unique(made.splats.means, axis=0), np.unique(expected, axis=0))


def test_what_the_new_model_does_not_know_stays() -> None:
    _, old, new = old_and_new()
    blind = new.select(new.means[:, 1] < 1)
    made = extended(old, blind, epochs=1)
    assert made.num_filled > 30
    assert (made.splats.means[made.num_kept : made.num_kept + made.num_filled, 1] > 0.9).all()


def test_a_region_of_utm_size_is_the_same_region() -> None:
    _, old, _ = old_and_new()
    shift = np.array([4e5, 5.6e6])
    away = NewRegion(polygon=EAST.polygon + shift, margin_m=1.0).inside_m(old.means[:, :2].astype(np.float64) + shift)
    np.testing.assert_allclose(away, EAST.inside_m(old.means), atol=1e-8)
    assert np.isnan(EAST.inside_m(np.array([[np.nan, 0.0]])))[0]


@pytest.mark.parametrize(
    ("polygon", "margin_m", "reason"),
    [
        ([[0, 0], [1, 1]], 1.0, "corners"),
        ([[0, 0], [1, 1], [2, 2]], 1.0, "no area"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], 1.0, "crossing"),
        ([[0, 0], [1, 0], [np.nan, 1]], 1.0, "not finite"),
        ([[0, 0], [1, 0], [0, 1]], 0.0, "margin"),
        ([[0, 0], [1, 0], [0, 1]], np.inf, "margin"),
    ],
)
def test_impossible_regions_are_refused(polygon: list[list[float]], margin_m: float, reason: str) -> None:
    with pytest.raises(BadInput, match=reason):
        NewRegion(polygon=np.array(polygon, float), margin_m=margin_m)


def test_a_new_model_elsewhere_is_refused() -> None:
    _, old, new = old_and_new()
    with pytest.raises(BadInput, match="one frame"):
        extended(old, replace(new, means=new.means + np.float32([1000, 0, 0])))


def test_held_gaussians_keep_their_bits_and_need_a_fixed_count() -> None:
    truth, old, _ = old_and_new()
    from radiant_core.aggregate.synthetic_views import synthetic_views

    views, held = synthetic_views(truth, CAMERAS), np.arange(len(old)) % 3 == 0
    config = replace(TRAIN, num_steps=12, density=NoDensification(), start_scale=1.0)
    trained = fit_splats(old, views, config, FitOptions(frozen=held)).splats
    for name, array in old.arrays().items():
        assert np.array_equal(getattr(trained, name)[held], array[held]), name
    assert (trained.means[~held] != old.means[~held]).any()
    with pytest.raises(BadInput, match="density"):
        fit_splats(old, views, replace(config, density=Adc()), FitOptions(frozen=held))
    with pytest.raises(BadInput, match="one truth value"):
        fit_splats(old, views, config, FitOptions(frozen=held[1:]))
