"""The native rasterizer at the sizes its limits are set for: 10,000 Gaussians, needles up to 1,800 long, and hostile training."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmarks.raster.accuracy import tile_errors
from benchmarks.raster.drone_scene import SIZES, drone_scene
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.train.native_loss import TargetStatistics, target_loss
from radiant_core.train.optimizer import SelectiveAdam
from tests.contract import gaussians
from tests.contract.backends import NATIVE, opacity_rounding, random_loss, relative_errors, render, undecided_pixels

pytestmark = pytest.mark.stress

HOSTILE = ("black", "white", "flat", "one pixel")


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(("kind", "limit"), [("regular", 1e-4), ("needles", 5e-2)])
def test_gradients_of_10000_gaussians(kind: str, limit: float, antialiased: bool) -> None:
    splats = getattr(gaussians, kind)(10_000)
    cameras = gaussians.off_centre_cameras(256, 192) if kind == "regular" else gaussians.off_centre_cameras(128, 96)
    keep = ~undecided_pixels(splats, cameras, antialiased=antialiased)
    exact = render(splats, cameras, "oracle", antialiased=antialiased)
    random_loss(exact.output, ("images",), keep).backward()
    truth = exact.gradients()
    for backend in NATIVE:
        got = render(splats, cameras, backend, antialiased=antialiased)
        random_loss(got.output, ("images",), keep).backward()
        for name, gradient in got.gradients().items():
            rounding = opacity_rounding(splats, truth) if name == "logit_opacities" else 0.0
            errors = relative_errors(gradient, truth[name], rounding)
            assert errors.max() <= limit, (backend, name, float(errors.max()))


def test_the_largest_bench_scene_on_64_tiles() -> None:
    errors = tile_errors(*drone_scene(SIZES["L"]))
    assert errors.image_max <= 1e-4
    assert errors.image_rms <= 1e-5
    assert errors.undecided_max <= 5e-3
    assert errors.gradient <= 1e-4


@pytest.mark.parametrize("picture", HOSTILE)
def test_25000_steps_at_ten_times_the_learning_rate_stay_finite(picture: str) -> None:
    # 100,000 steps over the four pictures, on a model small enough for minutes.
    leaves = SplatTensors.from_splats(gaussians.regular(60, bases=4))
    cameras = gaussians.off_centre_cameras(24, 16, focal_px=20)
    target = {"black": torch.zeros, "white": torch.ones, "flat": lambda *shape: torch.full(shape, 0.5), "one pixel": torch.zeros}[picture](
        16, 24, 3
    )
    if picture == "one pixel":
        target[7, 11] = 1.0
    rates = {"means": 1.6e-3, "quats": 1e-2, "log_scales": 5e-2, "logit_opacities": 5e-1, "sh0": 2.5e-2, "shN": 1.25e-3}
    optimizer, statistics = SelectiveAdam(leaves.tensors(), rates), TargetStatistics.of(target)
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    for step in range(25_000):
        optimizer.zero_grad()
        output = rasterize(leaves, viewmats, Ks, 24, 16, sh_degree=1, antialiased=step % 2 == 1, backend="native")
        target_loss(output.images.view_as(target), statistics, None, 0.2).backward()
        optimizer.step(output.visible)  # refuses gradients that are not finite
    assert all(np.isfinite(leaf.detach().numpy()).all() for leaf in leaves.tensors().values())
