"""Thin surfaces: flat starts, the gradient of thickness, the spread of depth against float64 sums."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.initialize import lie_flat
from radiant_core.train.thin_surfaces import MIN_SPREAD, THINNEST, depth_spread, thickness_gradient
from radiant_core.train.trainer import fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats


def plane(count: int, *, tilt_deg: float, noise: float = 0.0) -> Splats:
    """Round Gaussians on a plane that leans by an angle about x."""
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.normal(0, noise, count)])
    means = flat @ Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix().T
    return Splats(
        means=means, quats=np.tile([1.0, 0, 0, 0], (count, 1)), log_scales=np.full((count, 3), -3.0),
        logit_opacities=np.zeros(count), sh0=np.zeros((count, 1, 3)), shN=np.zeros((count, 0, 3)),
    )  # fmt: skip


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, 90.0])
def test_first_gaussians_lie_in_the_plane_of_their_neighbours(tilt_deg: float) -> None:
    splats = lie_flat(plane(200, tilt_deg=tilt_deg), 200, 0.1)
    np.testing.assert_allclose(splats.log_scales, np.tile([-3 + np.log(0.1), -3, -3], (200, 1)), atol=1e-5)
    across = Rotation.from_quat(splats.quats, scalar_first=True).as_matrix()[:, :, 0]
    normal = Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix()[:, 2]
    assert np.abs(across @ normal).min() > 1 - 1e-6


def test_a_thick_cloud_stays_as_thick_as_it_is_and_the_rest_of_a_model_stays() -> None:
    splats = plane(300, tilt_deg=10.0, noise=0.5)
    flat = lie_flat(splats, 200, 0.05)
    assert -3 + np.log(0.2) < np.median(flat.log_scales[:200, 0]) < -3
    for name, array in flat.arrays().items():
        np.testing.assert_array_equal(array[200:], splats.arrays()[name][200:])
        assert np.isfinite(array).all()
    assert lie_flat(splats, 200, 1.0) is splats and lie_flat(splats, 8, 0.1) is splats


def test_neighbours_on_a_line_on_one_spot_or_far_away_give_a_proper_rotation() -> None:
    line = plane(40, tilt_deg=0.0)
    on_line = replace(line, means=np.column_stack([np.arange(40), np.zeros((40, 2))]).astype(np.float32))
    on_spot = replace(line, means=np.ones((40, 3), np.float32))
    huge = replace(line, means=line.means * np.float32(1e15))
    for splats in (on_line, on_spot, huge):
        flat = lie_flat(splats, 40, 0.1)
        assert all(np.isfinite(array).all() for array in flat.arrays().values())
        np.testing.assert_allclose(np.linalg.norm(flat.quats, axis=1), 1, atol=1e-6)
        assert (flat.log_scales[:, 0] >= -3 + np.log(0.1) - 1e-5).all()


def test_the_gradient_of_thickness_is_that_of_the_mean_shortest_axis() -> None:
    logs = torch.tensor(np.random.default_rng(1).normal(-2, 0.8, (50, 3)), requires_grad=True)
    ordered = logs.sort(dim=1).values
    thick = ordered[:, 0] > ordered[:, 1] + np.log(THINNEST)
    (torch.where(thick, ordered[:, 0], torch.zeros(()).to(ordered)).sum() / 50).backward()
    torch.testing.assert_close(thickness_gradient(logs), logs.grad)
    assert not thickness_gradient(torch.tensor([[-9.0, -1.0, 0.0]])).any()
    assert thickness_gradient(torch.zeros((0, 3))).shape == (0, 3)


def two_layers(opacity: float, below: float) -> tuple[Splats, object]:
    """A camera 6 above a wide layer at height 0 and another one so far below."""
    splats = plane(2, tilt_deg=0.0)
    logit = float(np.log(opacity / (1 - opacity)))
    means = np.array([[0, 0, 0], [0, 0, -below]], np.float32)
    model = replace(splats, means=means, log_scales=np.full((2, 3), 2.0, np.float32), logit_opacities=np.array([logit, 6.0], np.float32))
    return model, cameras_above([(0.0, 0.0)], size_wh=(8, 6))


def test_the_spread_is_that_of_the_blended_depths_and_zero_for_one_surface() -> None:
    model, cameras = two_layers(0.5, 3.0)
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)  # pyright: ignore
    for backend in ("native", "reference"):
        found = float(depth_spread(SplatTensors.from_splats(model), viewmats, Ks, (8, 6), backend))
        # In the middle of the picture both are all but even: weights 1/2 at depth 6 and 1/2 at 9;
        # towards its rim the upper one, of deviation 7.4, is a little thinner.
        assert found == pytest.approx(1.5 / 7.5, rel=0.1)
    same = replace(model, means=np.zeros((2, 3), np.float32))
    assert float(depth_spread(SplatTensors.from_splats(same), viewmats, Ks, (8, 6))) == pytest.approx(MIN_SPREAD, rel=0.2)
    behind = replace(model, means=np.array([[0, 0, 20.0], [0, 0, 30]], np.float32))
    assert float(depth_spread(SplatTensors.from_splats(behind), viewmats, Ks, (8, 6))) == 0.0


def test_the_gradient_of_the_spread_makes_the_upper_layer_opaque_or_vanish() -> None:
    for opacity, sense in ((0.8, -1), (0.2, 1)):
        model, cameras = two_layers(opacity, 3.0)
        tensors = SplatTensors.from_splats(model)
        tensors.logit_opacities.requires_grad_()
        depth_spread(tensors, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), (8, 6)).backward()  # pyright: ignore
        gradient = tensors.logit_opacities.grad
        assert gradient is not None and np.sign(float(gradient[0])) == sense


def test_a_training_with_the_weights_ends_thinner_and_less_spread() -> None:
    truth, cameras = ground_splats(200), cameras_above([(-1.0, 0.0), (1.0, 0.0), (0.0, 1.5)])
    rng = np.random.default_rng(3)
    images = tuple(rng.integers(0, 255, (36, 48, 3), dtype=np.uint8) for _ in range(3))
    views = TrainingViews(cameras=cameras, images=images)
    start = replace(truth, logit_opacities=np.full(200, -1.0, np.float32))
    plain = TrainConfig(num_steps=60, scales_lr=2e-2)
    thin = replace(plain, thickness_weight=0.5, depth_spread_weight=2.0)
    ends = [fit_splats(start, views, config).splats for config in (plain, thin)]
    shortest = [float(np.sort(end.log_scales, axis=1)[:, 0].mean()) for end in ends]
    assert shortest[1] < shortest[0] - 0.1
    viewmats, Ks = torch.tensor(cameras.cam_from_world[:1]), torch.tensor(cameras.Ks[:1])
    spreads = [float(depth_spread(SplatTensors.from_splats(end), viewmats, Ks, (48, 36))) for end in ends]
    assert spreads[1] < spreads[0]


@pytest.mark.parametrize("name", ["initial_opacity", "initial_thickness", "thickness_weight", "depth_spread_weight"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_settings_out_of_range_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(BadInput, match=name):
        replace(TrainConfig(), **{name: value})
