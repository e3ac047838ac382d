"""Needles and screen-filling Gaussians are held at their limits, the dead are left out without a
trace; backgrounds and antialiasing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.transport.upload import load_upload, save_upload
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.shapes import limit_shapes, with_needle_width, without_dead
from radiant_core.train.trainer import FitOptions, Training, fit_splats
from tests.core.scenes import ground_splats
from tests.core.train.test_trainer import CAMERAS, CONFIG, grey_start, photographs


def axes(*scales: tuple[float, float, float]) -> SplatTensors:
    model = ground_splats().select(np.arange(len(scales)))
    return SplatTensors.from_splats(replace(model, log_scales=np.log(np.array(scales, np.float64)).astype(np.float32)))


def test_a_needle_is_cut_to_its_limit_and_a_disc_is_none() -> None:
    splats = axes((0.5, 0.01, 0.02), (0.01, 0.2, 0.2), (0.1, 1e-20, 0.01), (0.02, 0.02, 0.02))
    config = replace(train_preset("default"), max_elongation=10.0, max_scale_per_distance=None)
    counts = limit_shapes(splats, CAMERAS.centers, config)
    expected = [(0.2, 0.01, 0.02), (0.01, 0.2, 0.2), (0.1, 1e-20, 0.01), (0.02, 0.02, 0.02)]
    np.testing.assert_allclose(np.exp(splats.log_scales.numpy().astype(np.float64)), expected, rtol=1e-5)
    assert (counts.num_needles, counts.num_screen_filling, counts.num_dead) == (1, 0, 0)


def test_what_is_thinner_than_a_pixel_counts_as_a_pixel_wide() -> None:
    """A needle a tenth of a pixel wide may be ten pixels long, one that is two pixels wide twenty."""
    center = CAMERAS.centers[0]
    config = with_needle_width(replace(train_preset("default"), max_scale_per_distance=None), CAMERAS)
    assert config.needle_width_per_distance == pytest.approx(1 / np.median(CAMERAS.Ks[:, 0, 0]))
    assert with_needle_width(replace(config, needle_width_per_distance=0.0), CAMERAS).needle_width_per_distance == 0
    depth_m = 3.0
    pixel_m = depth_m * float(config.needle_width_per_distance)
    splats = axes((50 * pixel_m, 0.1 * pixel_m, 0.1 * pixel_m), (50 * pixel_m, 2 * pixel_m, 0.1 * pixel_m), (9 * pixel_m, 1e-9, 1e-9))
    splats = replace(splats, means=torch.tensor(center - np.array([0.0, 0.0, depth_m]), dtype=torch.float32).expand(3, 3).contiguous())
    assert limit_shapes(splats, center[None], config).num_needles == 2
    np.testing.assert_allclose(np.exp(splats.log_scales.numpy().astype(np.float64))[:, 0] / pixel_m, [10, 20, 9], rtol=1e-4)


def test_what_fills_the_screen_is_counted_and_no_limit_leaves_all_bits() -> None:
    splats = axes((50.0, 50.0, 50.0), (0.5, 0.01, 0.02))
    free = replace(train_preset("default"), max_elongation=None, max_scale_per_distance=None)
    before = splats.log_scales.clone()
    assert limit_shapes(splats, CAMERAS.centers, free).num_screen_filling == 0 and torch.equal(splats.log_scales, before)
    assert limit_shapes(splats, CAMERAS.centers, replace(free, max_scale_per_distance=1 / 3)).num_screen_filling == 1
    assert (splats.log_scales[1] == before[1]).all()
    empty = SplatTensors.from_splats(ground_splats().select(np.zeros(0, np.int64)))
    assert limit_shapes(empty, CAMERAS.centers, CONFIG).num_needles == 0


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf])
def test_a_limit_of_needles_must_be_positive(limit: float) -> None:
    with pytest.raises(BadInput, match="max_elongation"):
        TrainConfig(max_elongation=limit)


@pytest.mark.parametrize("antialiased", [False, True])
def test_the_dead_leave_no_trace_in_any_picture(antialiased: bool) -> None:
    model = replace(ground_splats(), antialiased=antialiased)
    logits = model.logit_opacities.copy()
    at_limit = np.log((1 / 255) / (1 - 1 / 255))
    logits[::3] = np.float32(at_limit - 1e-4)
    logits[1::3] = np.float32(at_limit + 1e-4)
    model = replace(model, logit_opacities=logits)
    kept, num_dead = without_dead(model)
    assert num_dead == len(logits[::3]) and len(kept) == len(model) - num_dead
    for with_them, without in zip(render_views(model, CAMERAS), render_views(kept, CAMERAS), strict=True):
        np.testing.assert_array_equal(with_them.image, without.image)
    poison = replace(model, logit_opacities=np.full_like(logits, -1e30))
    survivors, gone = without_dead(poison)
    assert len(survivors) == 1 and gone == len(model) - 1
    nobody, none = without_dead(model.select(np.zeros(0, np.int64)))
    assert len(nobody) == none == 0


def test_a_random_background_closes_what_is_half_transparent() -> None:
    black = np.zeros(3, np.uint8)
    views = photographs()
    dark = replace(views, images=tuple(np.broadcast_to(black, image.shape).copy() for image in views.images))
    alphas = {}
    for background in ("black", "random"):
        config = replace(CONFIG, background=background, density=NoDensification())
        model = fit_splats(grey_start(), dark, config).splats
        alphas[background] = np.mean([view.alpha.mean() for view in render_views(model, CAMERAS)])
    assert alphas["random"] > alphas["black"] + 0.1, alphas


def test_a_run_before_random_backgrounds_goes_on_with_the_same_bits() -> None:
    config = replace(CONFIG, background="random", num_steps=12)
    whole = Training(grey_start(), photographs(), config, FitOptions())
    parted = Training(grey_start(), photographs(), config, FitOptions())
    for _ in range(5):
        whole.take_step()
        parted.take_step()
    again = Training(grey_start(), photographs(), config, FitOptions())
    again.restore(parted.state())
    while not whole.is_done:
        whole.take_step()
        again.take_step()
    for name, array in whole.result().splats.arrays().items():
        np.testing.assert_array_equal(array, again.result().splats.arrays()[name])


def test_antialiasing_travels_with_the_model(tmp_path: Path) -> None:
    model = replace(ground_splats(), antialiased=True)
    save_ply(tmp_path / "a.ply", model)
    save_splats(tmp_path / "a.safetensors", model)
    for upload in ("float32", "float16", "spz"):
        save_upload(tmp_path / f"{upload}.safetensors", model, upload)
        assert load_upload(tmp_path / f"{upload}.safetensors").antialiased, upload
    moved = move_splats(model, Sim3(scale=2.0, rotation=np.eye(3), translation=np.zeros(3)))
    parts = [
        load_ply(tmp_path / "a.ply"),
        load_splats(tmp_path / "a.safetensors"),
        moved,
        model.select([0]),
        concatenate_splats([model, model]),
    ]
    assert all(part.antialiased for part in parts)
    assert SplatTensors.from_splats(model).to_splats().antialiased
    save_ply(tmp_path / "b.ply", ground_splats())
    assert not load_ply(tmp_path / "b.ply").antialiased and b"comment" not in (tmp_path / "b.ply").read_bytes()[:300]
    with pytest.raises(BadInput, match="some of the models are antialiased"):
        concatenate_splats([model, ground_splats()])


def test_antialiasing_keeps_small_gaussians_from_growing_with_the_distance() -> None:
    """Half-pixel Gaussians at a quarter of the size: without it each covers as many pixels."""
    fine = ground_splats()
    fine = replace(fine, log_scales=np.full_like(fine.log_scales, np.log(0.03)))
    shares = {}
    for antialiased in (False, True):
        model = replace(fine, antialiased=antialiased)
        near, far = (np.mean([view.alpha.mean() for view in render_views(model, CAMERAS.scaled(side))]) for side in (64, 16))
        shares[antialiased] = far / near
    assert shares[True] < 0.5 * shares[False], shares


def test_an_antialiased_model_learns_and_ends_antialiased() -> None:
    config = replace(CONFIG, antialiased=True, density=NoDensification())
    start: Splats = replace(grey_start(), antialiased=True)
    result = fit_splats(start, photographs(), config)
    assert result.splats.antialiased and result.last_loss < result.first_loss
