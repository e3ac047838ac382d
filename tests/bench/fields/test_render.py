"""Rays and their blending: directions are the cameras', weights are a distribution, gradients those of finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.fields.field import FieldConfig, Sampled, density_of, make_field, num_parameters
from benchmarks.fields.hash_grid import GridConfig
from benchmarks.fields.poses import CameraMoves, SharedMove, turn
from benchmarks.fields.rays import PixelRays, rays_of_image
from benchmarks.fields.render import Sampling, blend_weights, render_image, render_rays, resample
from radiant_core.errors import BadInput
from tests.bench.fields.floor import FIT, SIZES, bounds_of, floor_scene, paint


class Floor:
    """An opaque floor below z = 0 in the paint of the photographs, known exactly."""

    def __init__(self, radius_m: float, center: np.ndarray) -> None:
        self.radius_m, self.center = radius_m, center

    def densities(self, places: Tensor) -> Tensor:
        return torch.where(places[:, 2] * self.radius_m + self.center[2] < 0, 1e5, 0.0)

    def __call__(self, places: Tensor, directions: Tensor) -> Sampled:
        colors = torch.from_numpy(paint(places.numpy()[:, :2] * self.radius_m + self.center[:2])).float()
        return Sampled(self.densities(places), colors, torch.zeros(()))


def test_an_opaque_floor_looks_like_its_photographs() -> None:
    scene, views = floor_scene()
    bounds = bounds_of(scene)
    image = render_image(Floor(bounds.radius_m, bounds.center), views.cameras, bounds, 4, Sampling(num_coarse=128, num_fine=64))
    # 128 coarse bins over 2.6 m of depth: the floor is found to a centimetre.
    assert np.abs(image - views.images[4] / 255).max() < 0.01
    rays = rays_of_image(views.cameras, bounds, 4)
    depths = render_rays(Floor(bounds.radius_m, bounds.center), rays, Sampling(num_coarse=128, num_fine=64)).depths
    heights = (rays.origins + depths[:, None] * rays.directions)[:, 2].numpy() * bounds.radius_m + bounds.center[2]
    assert np.abs(heights).max() < 0.03


def test_every_counting_pixel_is_a_ray_of_its_colour() -> None:
    scene, views = floor_scene()
    bounds = bounds_of(scene)
    weights = [np.full((18, 24), 255, np.uint8) for _ in range(len(views))]
    weights[2][:, :20] = 100
    masked = type(views)(cameras=views.cameras, images=views.images, weights=tuple(weights))
    pixels = PixelRays.of(masked, bounds)
    assert len(pixels) == 8 * 432 + 72 and len(pixels.of_views([2])) == 72
    rays, colors = pixels.batch(np.array([0, 431, len(pixels) - 1]))
    assert rays.views.tolist() == [0, 0, 8]
    np.testing.assert_allclose(colors[2].numpy() * 255, views.images[8][17, 23], atol=1e-4)
    in_camera = views.cameras.cam_from_world[8, :3, :3] @ rays.directions[2].double().numpy()
    column, row, _ = views.cameras.Ks[8] @ (in_camera / in_camera[2])
    assert (column, row) == pytest.approx((23.5, 17.5), abs=1e-4) and rays.directions.norm(dim=1) == pytest.approx(1, abs=1e-6)
    with pytest.raises(BadInput, match="no pixel to learn from"):
        pixels.select(np.zeros(len(pixels), bool))


def test_weights_are_those_of_the_plain_formula_and_add_up_to_one() -> None:
    rng = np.random.default_rng(0)
    densities, lengths = torch.from_numpy(rng.exponential(3, (7, 9))), torch.from_numpy(rng.uniform(0.01, 1, (7, 9)))
    found = blend_weights(densities, lengths).numpy()
    alphas = 1 - np.exp(-densities.numpy() * lengths.numpy())
    alphas[:, -1] = 1
    wanted = alphas * np.cumprod(np.column_stack([np.ones(7), 1 - alphas[:, :-1]]), axis=1)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_allclose(found.sum(axis=1), 1)
    assert torch.autograd.gradcheck(lambda d: blend_weights(d, lengths), densities.requires_grad_())


def test_samples_gather_where_the_share_is() -> None:
    edges = torch.tensor([[0.0, 1, 2, 4]])
    drawn = (torch.arange(1000)[None] + 0.5) / 1000
    found = resample(edges, torch.tensor([[0.25, 0.0, 0.75]]), drawn)
    assert ((found >= 0) & (found <= 4)).all() and (found.diff() >= 0).all()
    assert int((found < 1).sum()) == 250 and int(((found > 1) & (found < 2)).sum()) == 0
    assert float(found[found > 2].mean()) == pytest.approx(3, abs=0.01)


def test_a_field_has_the_gradients_of_finite_differences() -> None:
    field = make_field(FieldConfig(grid=GridConfig(num_levels=3, log2_entries=6, coarsest=2, finest=9), width=4, num_codes=2), 0).double()
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        # Entries of 1e-4 would leave every ReLU at its kink.
        field.get_parameter("encoding.table").uniform_(-1, 1, generator=generator)
    places = torch.rand(11, 3, generator=generator).double() - 0.5
    directions = torch.nn.functional.normalize(torch.randn(11, 3, generator=generator).double())
    names = [name for name, _ in field.named_parameters()]

    def colors(*values: Tensor) -> Tensor:
        found = torch.func.functional_call(field, dict(zip(names, values, strict=True)), (places, directions))
        return torch.cat([found.densities[:, None], found.colors], dim=1)

    assert torch.autograd.gradcheck(colors, tuple(field.get_parameter(name).detach().requires_grad_() for name in names), atol=1e-5)
    assert num_parameters(field) == 3 * 64 * 2 + (6 * 4 + 16 + 12) + (18 * 4 + 16 + 16 + 12)


def test_a_field_is_the_same_in_float32_and_float64() -> None:
    scene, views = floor_scene()
    bounds = bounds_of(scene)
    fields = [make_field(SIZES, 5), make_field(SIZES, 5).double()]
    for field in fields:
        with torch.no_grad():
            field.get_parameter("encoding.table").mul_(1e4)
    rays = rays_of_image(views.cameras, bounds, 0).select(slice(0, 64))
    places = (rays.origins + 0.5 * (rays.near + rays.far)[:, None] * rays.directions) * 0.9
    single, double = (
        field(places.to(kind), rays.directions.to(kind)) for field, kind in zip(fields, (torch.float32, torch.float64), strict=True)
    )
    torch.testing.assert_close(single.colors.double(), double.colors, rtol=0, atol=1e-4)
    torch.testing.assert_close(single.densities.double(), double.densities, rtol=1e-3, atol=1e-4)
    assert torch.isfinite(density_of(torch.tensor([1e30, -1e30]))).all()


def test_turns_are_rotations_with_gradients_at_none() -> None:
    turns = torch.tensor([[0, 0, np.pi / 2], [0, 0, 0], [1e-5, 0, 0], [0.3, -2, 0.7]], dtype=torch.float64, requires_grad=True)
    vectors = torch.tensor([[1.0, 0, 0]] * 4, dtype=torch.float64)
    turned = turn(turns, vectors)
    torch.testing.assert_close(turned[0].detach(), torch.tensor([0, 1.0, 0], dtype=torch.float64), atol=1e-12, rtol=0)
    torch.testing.assert_close(turned.norm(dim=1).detach(), torch.ones(4, dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda t: turn(t, vectors), turns)
    scene, views = floor_scene()
    rays = rays_of_image(views.cameras, bounds_of(scene), 1)
    for move in (CameraMoves(9), SharedMove()):
        assert torch.equal(move(rays).directions, rays.directions) and torch.equal(move(rays).origins, rays.origins)


def test_wrong_numbers_of_samples_are_named() -> None:
    with pytest.raises(BadInput, match="at least 2 coarse"):
        Sampling(num_coarse=1)
    with pytest.raises(BadInput, match="a width of 1 to 1024"):
        FieldConfig(width=0)
    assert FIT.sampling.num_fine == 16
