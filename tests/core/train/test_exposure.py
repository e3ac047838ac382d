"""Exposures: the native map against float64 and autograd, the gauge, what they are for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core import _native
from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.errors import StageFailed
from radiant_core.render.contract import SplatTensors
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.exposure import Exposures
from radiant_core.train.needs import MIN_EXPOSURE_SPREAD, exposure_spread
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment
from radiant_core.train.trainer import fit_splats
from radiant_core.train.validation import validation_psnr_db
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

MODEL = SplatTensors.from_splats(ground_splats(1))
CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])


def moment(view: int, progress: float = 0.0) -> Moment:
    return Moment(step=1, view=view, progress=progress, schedule_step=1.0)


@pytest.mark.parametrize("size_wh", [(1, 1), (37, 70), (640, 96)])
@pytest.mark.parametrize("scale", [1.0, 1e15])
def test_the_native_map_and_its_derivatives_are_those_of_float64(size_wh: tuple[int, int], scale: float) -> None:
    rng = np.random.default_rng(0)
    image = torch.tensor(scale * rng.normal(size=(*size_wh[::-1], 3)).astype(np.float32), requires_grad=True)
    exposures = Exposures(2, 1e-3, "cpu")
    exposures._maps[1] = torch.tensor(rng.normal(size=(3, 4)).astype(np.float32))
    towards = torch.tensor(rng.normal(size=image.shape).astype(np.float32))
    shown = exposures.show(moment(1), image)
    shown.backward(towards)
    exact = image.detach().double().requires_grad_()
    map_ = exposures._maps[1].double().requires_grad_()
    expected = exact + exact @ map_[:, :3].T + map_[:, 3]
    expected.backward(towards.double())
    assert exposures._shown is not None and image.grad is not None and exact.grad is not None and map_.grad is not None
    for ours, theirs in ((shown, expected), (image.grad, exact.grad), (exposures._shown.grad, map_.grad)):
        assert ours is not None
        np.testing.assert_allclose(ours.detach().double(), theirs.detach(), atol=2e-6 * float(theirs.detach().abs().max()))


def test_any_number_of_threads_gives_the_same_bits() -> None:
    rng = np.random.default_rng(1)
    image, gradient = (torch.tensor(rng.normal(size=(300, 200, 3)).astype(np.float32)) for _ in range(2))
    map_ = torch.tensor(rng.normal(size=(3, 4)).astype(np.float32))
    results = []
    for threads in (1, 2, 5):
        to_image, to_map = torch.empty_like(image), torch.empty_like(map_)
        _native.apply_exposure_backward(image, map_, gradient, to_image, to_map, threads)
        results.append((to_image, to_map))
    assert all(torch.equal(one, other) for result in results[1:] for one, other in zip(results[0], result, strict=True))


def test_wrong_shapes_are_refused_by_name() -> None:
    image, map_ = torch.zeros(4, 5, 3), torch.zeros(3, 4)
    with pytest.raises(ValueError, match="color_map has shape"):
        _native.apply_exposure(image, torch.zeros(4, 3), torch.zeros(4, 5, 3))
    with pytest.raises(ValueError, match="shown_gradient has shape"):
        _native.apply_exposure_backward(image, map_, torch.zeros(5, 4, 3), torch.zeros(4, 5, 3), torch.zeros(3, 4))


def test_a_step_keeps_the_gauge_and_poison_is_refused_before_anything_moves() -> None:
    exposures = Exposures(4, 1e-2, "cpu")
    for step in range(20):
        image = torch.rand(6, 8, 3, requires_grad=True)
        now = moment(step % 3, step / 20)
        (exposures.show(now, image) * (step % 3 + 1)).sum().backward()
        exposures.after_backward(MODEL)
        exposures.after_update(now, MODEL, SelectiveAdam({}, {}))
    assert exposures.largest_change > 0
    torch.testing.assert_close(exposures._maps.mean(dim=0), torch.zeros(3, 4), atol=1e-6, rtol=0)
    before = exposures.state_arrays()
    (exposures.show(moment(0), torch.full((6, 8, 3), torch.nan, requires_grad=True))).sum().backward()
    with pytest.raises(StageFailed, match="exposure is not finite"):
        exposures.after_backward(MODEL)
    assert all(np.array_equal(array, before[name]) for name, array in exposures.state_arrays().items())


def differently_exposed() -> tuple[TrainingViews, TrainingViews]:
    """Views of one ground as they are, and with gains from 0.75 to 1.25."""
    views = synthetic_views(ground_splats(400), CAMERAS)
    gains = np.linspace(0.75, 1.25, len(views.images))
    images = tuple(
        np.clip(gain * image.astype(np.float64), 0, 255).astype(np.uint8) for gain, image in zip(gains, views.images, strict=True)
    )
    return TrainingViews(cameras=CAMERAS, images=views.images), TrainingViews(cameras=CAMERAS, images=images)


def test_photographs_of_different_exposures_are_learnt_better_with_a_map_each() -> None:
    even, uneven = differently_exposed()
    config = replace(train_preset("default"), num_steps=300, density=NoDensification(), start_scale=1.0, sh_degree=0, exposure_lr=5e-3)
    figures = {}
    for exposure in ("none", "affine"):
        result = fit_splats(ground_splats(400), uneven, replace(config, exposure=exposure))
        figures[exposure] = validation_psnr_db(result.splats, even, "auto")
        assert (result.max_exposure > 0.03) == (exposure == "affine")
    assert figures["affine"] > figures["none"] + 2, figures


def test_the_spread_of_exposures_is_seen_at_common_points() -> None:
    from radiant_core.frames import Frame
    from radiant_core.scene import SfmScene

    even, uneven = differently_exposed()
    points = ground_splats(400).means.astype(np.float64)
    observations = np.stack(np.meshgrid(np.arange(len(points)), np.arange(len(CAMERAS)), indexing="ij"), axis=-1).reshape(-1, 2)
    frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    scene = SfmScene(cameras=CAMERAS, points=points, colors=np.zeros((400, 3), np.uint8), observations=observations, frame=frame)
    gains = np.linspace(0.75, 1.25, len(CAMERAS))
    assert exposure_spread(scene, even) < 0.01 < MIN_EXPOSURE_SPREAD
    assert exposure_spread(scene, uneven) == pytest.approx(np.log(gains).std(), rel=0.3)
    alone = replace(scene, observations=np.zeros((0, 2), np.int64))
    assert exposure_spread(alone, uneven) == 0
