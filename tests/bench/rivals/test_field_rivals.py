"""Ways to split and join a radiance field: each keeps its rule, and its test fails without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.fields.field import make_field
from benchmarks.fields.fit import fit_field
from benchmarks.fields.hash_grid import GridConfig, HashGrid
from benchmarks.fields.rays import PixelRays, rays_of_image
from benchmarks.fields.render import render_image
from benchmarks.rivals.gp_nerf import PlaneConfig, make_gp_field
from benchmarks.rivals.mega_nerf import (
    MegaConfig,
    MegaField,
    fit_mega,
    inverse_distance_weights,
    mega_centroids,
    pixels_of_cells,
    rays_of_cells,
)
from benchmarks.rivals.switch_nerf import SwitchConfig, SwitchNetwork, make_switch_field
from radiant_core.errors import BadInput
from tests.bench.fields.floor import FIT, SIZES, bounds_of, floor_scene


@pytest.fixture(scope="module")
def pixels() -> PixelRays:
    """All pixels of the floor's photographs."""
    scene, views = floor_scene()
    return PixelRays.of(views, bounds_of(scene))


def test_mega_with_one_cell_is_the_single_field_bit_for_bit(pixels: PixelRays) -> None:
    fit = replace(FIT, num_steps=5)
    single = make_field(SIZES, fit.seed)
    fit_field(single, pixels, fit)
    mega = fit_mega(pixels, SIZES, fit, MegaConfig(columns=1, rows=1))
    images = [render_image(field, pixels.cameras, pixels.bounds, 3, fit.sampling) for field in (single, mega)]
    assert np.array_equal(images[0], images[1]) and images[0].std() > 0


def test_a_ray_is_of_every_cell_that_it_passes_within_the_margin(pixels: PixelRays) -> None:
    centroids = mega_centroids(pixels.cameras, pixels.bounds, MegaConfig(columns=2, rows=2))
    xy = centroids.numpy() * pixels.bounds.radius_m + pixels.bounds.center[:2]
    np.testing.assert_allclose(xy, [(-1.25, -1.25), (-1.25, 1.25), (1.25, -1.25), (1.25, 1.25)], atol=1e-6)
    # The outermost ray of the corner's camera is its cell's alone; those of the middle one go to all, near their borders.
    corner, middle = (rays_of_cells(rays_of_image(pixels.cameras, pixels.bounds, view), centroids, 1.15) for view in (0, 4))
    assert corner[17 * 24].tolist() == [True, False, False, False]
    assert middle.any(dim=1).all() and (middle.sum(dim=1) > 1).any() and (middle.sum(dim=1) == 1).any()
    wider = rays_of_cells(rays_of_image(pixels.cameras, pixels.bounds, 4), centroids, 2.0)
    assert (wider | ~middle).all() and wider.sum() > middle.sum()
    every = pixels_of_cells(pixels, centroids, 1.15)
    assert np.array_equal(every[4 * 432 : 5 * 432], middle.numpy()) and len(every) == len(pixels)
    # A plain twin, place by place.
    rays = rays_of_image(pixels.cameras, pixels.bounds, 4)
    for row in (0, 200, 431):
        steps = np.linspace(float(rays.near[row]), float(rays.far[row]), 16)
        places = rays.origins[row].numpy() + steps[:, None] * rays.directions[row].numpy()
        apart = np.linalg.norm(places[:, None, :2] - centroids.numpy(), axis=2)
        assert middle[row].tolist() == ((apart / apart.min(axis=1, keepdims=True)).min(axis=0) <= 1.15).tolist()


def test_mega_cells_are_joined_by_inverse_distance() -> None:
    centroids = torch.tensor([[0.0, 0], [1, 0]])
    places = torch.tensor([[0.2, 0, 5], [0.48, 0, 0], [0.5, 0, 0], [0, 0, 0], [1e9, 0, 0]])
    weights = inverse_distance_weights(places, centroids, 1.15)
    np.testing.assert_allclose(weights[:4], [(1, 0), (0.52, 0.48), (0.5, 0.5), (1, 0)], atol=1e-6)
    assert torch.isfinite(weights).all() and weights.sum(dim=1) == pytest.approx(1)
    fields = [make_field(SIZES, seed) for seed in (0, 1)]
    joined = MegaField(fields, centroids, 1.15)
    directions = torch.tensor([[0, 0, -1.0]]).expand(5, 3)
    found, (one, other) = joined(places, directions), (field(places, directions) for field in fields)
    torch.testing.assert_close(found.densities, weights[:, 0] * one.densities + weights[:, 1] * other.densities)
    torch.testing.assert_close(found.colors, weights[:, :1] * one.colors + weights[:, 1:] * other.colors)
    torch.testing.assert_close(found.densities, joined.densities(places))


def test_a_cell_that_no_ray_passes_is_named(pixels: PixelRays) -> None:
    # Only the western photographs, but a grid over all cameras.
    with pytest.raises(BadInput, match="no ray passes near cell"):
        fit_mega(pixels.of_views([0]), SIZES, FIT, MegaConfig(columns=8, rows=8, margin=1.0))
    with pytest.raises(BadInput, match="margin of at least 1"):
        MegaConfig(margin=0.9)


def switch_network(**changes: float) -> tuple[SwitchNetwork, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    network = SwitchNetwork(12, SIZES, SwitchConfig(**changes), generator)  # pyright: ignore[reportArgumentType]
    return network, torch.randn(400, 12, generator=generator)


def test_each_place_has_one_expert_and_its_output_times_the_gate() -> None:
    network, features = switch_network()
    with torch.no_grad():
        output, penalty = network.eval()(features)
        gates, chosen = torch.softmax(network.gate(features), dim=1).max(dim=1)
        every = torch.stack([expert(features) for expert in network.experts.children()], dim=1)
        wanted = gates[:, None] * every[torch.arange(400), chosen]
    torch.testing.assert_close(output, wanted)
    assert float(penalty) == 0 and len(torch.unique(chosen)) > 3


def test_an_expert_takes_no_more_than_its_capacity_while_it_learns() -> None:
    network, features = switch_network()
    output, _ = network.train()(features)
    gates, chosen = torch.softmax(network.gate(features), dim=1).max(dim=1)
    turned_away = (output == 0).all(dim=1)
    for expert in range(8):
        rows = torch.nonzero(chosen == expert).squeeze(1)
        assert int((~turned_away[rows]).sum()) == min(50, len(rows))
        if len(rows) > 50:
            assert gates[rows][turned_away[rows]].max() <= gates[rows][~turned_away[rows]].min()
    assert turned_away.any() and not (network.eval()(features)[0] == 0).all(dim=1).any()
    roomy, _ = switch_network(capacity=8.0)
    assert not (roomy.train()(features)[0] == 0).all(dim=1).any()


def test_the_balance_loss_is_least_where_experts_share_evenly() -> None:
    network, features = switch_network(balance=1.0)
    _, penalty = network.train()(features)
    shares = torch.softmax(network.gate(features), dim=1)
    counts = torch.bincount(shares.argmax(dim=1), minlength=8) / 400
    assert float(penalty.detach()) == pytest.approx(8 * float((counts * shares.mean(dim=0)).sum().detach()), rel=1e-5)
    penalty.backward()
    gradient = network.get_parameter("gate.0.weight").grad
    assert gradient is not None and float(gradient.abs().max()) > 0
    lazy, _ = switch_network(balance=0.0)
    assert float(lazy.train()(features)[1].detach()) == 0


def test_switch_and_gp_learn_the_floor(pixels: PixelRays) -> None:
    planes = PlaneConfig(num_levels=2, coarsest=8, finest=24)
    # Eight experts that turn places away learn slower: to 0.70 of the first loss, planes to 0.30.
    fields = {0.8: make_switch_field(SIZES, SwitchConfig(), 0), 0.5: make_gp_field(SIZES, planes, 0)}
    for share, field in fields.items():
        losses = fit_field(field, pixels, replace(FIT, num_steps=60)).losses
        assert np.mean(losses[-5:]) < share * np.mean(losses[:3])


def test_dense_planes_tell_apart_what_the_hash_confuses() -> None:
    config = replace(SIZES, grid=GridConfig(num_levels=1, log2_entries=4, coarsest=64, finest=64))
    field = make_gp_field(config, PlaneConfig(num_levels=2, coarsest=16, finest=64), 0)
    with torch.no_grad():
        for parameter in field.encoding.parameters():
            parameter.uniform_(-1, 1, generator=torch.Generator().manual_seed(1))
    places = torch.rand(2000, 3, generator=torch.Generator().manual_seed(2))
    grid: HashGrid = field.encoding.grid  # pyright: ignore[reportAssignmentType]
    hashed, both = grid(places), field.encoding(places)
    assert both.shape == (2000, 2 + 3 * 2 * 2) and torch.equal(both[:, :2], hashed)
    # Bilinear in each plane: halfway between two corners is their mean.
    plane = field.encoding.planes.levels[0]  # pyright: ignore
    found = field.encoding.planes(torch.tensor([[0.5 / 16, 0.0, 0.7]]))[0, :2]  # pyright: ignore
    torch.testing.assert_close(found, (plane[0, :, 0, 0] + plane[0, :, 0, 1]) / 2)
    for wrong in ({"finest": 8, "coarsest": 16}, {"num_levels": 0}):
        with pytest.raises(BadInput, match="planes were given"):
            PlaneConfig(**wrong)


def test_an_axis_of_a_plane_is_the_axis_of_a_place() -> None:
    field = make_gp_field(SIZES, PlaneConfig(num_levels=1, num_features=1, coarsest=4, finest=4), 0)
    levels = list(field.encoding.planes.levels)  # pyright: ignore
    with torch.no_grad():
        for level in levels:
            # Columns rise along the first axis of the plane.
            level.copy_(torch.arange(5.0).expand(1, 1, 5, 5))
    found = field.encoding.planes(torch.tensor([[0.25, 0.5, 0.75]]))  # pyright: ignore
    torch.testing.assert_close(found.detach(), torch.tensor([[1.0, 1.0, 2.0]]))
