"""The hash grid: the native kernel against its plain twin, gradients against finite differences, every edge of its places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import _radiant_fields
import numpy as np
import pytest
import torch

from benchmarks.fields.hash_grid import GridConfig, HashGrid, encode_places, entry_of
from radiant_core._native import instruction_sets
from radiant_core.errors import BadInput

CONFIG = GridConfig(num_levels=5, log2_entries=9, coarsest=3, finest=40)


def grid_and_places(count: int = 203, config: GridConfig = CONFIG) -> tuple[HashGrid, torch.Tensor]:
    """A grid with entries of size 1; places inside and, some, a little outside 0..1."""
    generator = torch.Generator().manual_seed(1)
    grid = HashGrid(config, generator)
    with torch.no_grad():
        grid.table.uniform_(-1, 1, generator=generator)
    return grid, torch.rand(count, 3, generator=generator) * 1.2 - 0.1


@pytest.mark.parametrize("instruction_set", instruction_sets())
def test_every_build_of_the_kernel_is_the_plain_twin(instruction_set: str) -> None:
    grid, places = grid_and_places()
    upstream = torch.randn(len(places), grid.num_features, generator=torch.Generator().manual_seed(2))
    wanted_places, wanted_table = places.double().requires_grad_(), grid.table.detach().double().requires_grad_()
    wanted = encode_places(wanted_places, wanted_table, grid.resolutions)
    (wanted * upstream.double()).sum().backward()
    columns = places.T.contiguous()
    features = torch.empty(grid.num_features, len(places))
    _radiant_fields.encode_places(columns, grid.table.detach(), grid.resolutions, features, 1, instruction_set)
    # A place of 24 bits times 40 cells leaves 2e-6 of a cell.
    torch.testing.assert_close(features.T.double(), wanted.detach(), rtol=0, atol=2e-5)
    table_gradients, place_gradients = torch.zeros_like(grid.table), torch.empty_like(columns)
    _radiant_fields.grid_gradients(
        columns, grid.table.detach(), grid.resolutions, upstream.T.contiguous(), table_gradients, place_gradients, 2, instruction_set
    )
    assert wanted_table.grad is not None and wanted_places.grad is not None
    torch.testing.assert_close(table_gradients.double(), wanted_table.grad, rtol=0, atol=2e-4)
    inside = ((places >= 0) & (places <= 1)).all(dim=1)
    torch.testing.assert_close(place_gradients.T.double()[inside], wanted_places.grad[inside], rtol=1e-3, atol=2e-3)


def differences(function: Callable[[torch.Tensor], torch.Tensor], at: torch.Tensor, step: float = 1e-6) -> torch.Tensor:
    """Derivatives of what a function gives by every number of `at`: central differences, all of them
    in one batched evaluation."""
    moves = step * torch.eye(at.numel(), dtype=at.dtype).reshape(-1, *at.shape)
    ahead, behind = (torch.func.vmap(function)(at + sign * moves) for sign in (1, -1))
    return ((ahead - behind) / (2 * step)).movedim(0, -1)


def test_gradients_are_those_of_finite_differences() -> None:
    # As many entries as the coarsest level has corners.
    grid, places = grid_and_places(20, replace(CONFIG, log2_entries=6))
    # Away from the borders of cells, where the slope jumps.
    places = ((torch.floor(places.clamp(0, 0.99) * 40) + 0.5) / 40 + 0.003).double()
    table = grid.table.detach().double()
    by_place = lambda where: encode_places(where, table, grid.resolutions)  # noqa: E731
    by_entry = lambda entries: encode_places(places, entries, grid.resolutions)  # noqa: E731
    for function, at in ((by_place, places), (by_entry, table)):
        derivatives = torch.autograd.functional.jacobian(function, at, vectorize=True)
        assert isinstance(derivatives, torch.Tensor) and bool(derivatives.any())
        # Differences of numbers of size 1 over 2e-6 leave 1e-10.
        torch.testing.assert_close(derivatives.flatten(2), differences(function, at), rtol=1e-6, atol=1e-6)


def test_the_module_adds_up_the_parts_of_a_step_and_leaves_places_outside_alone() -> None:
    grid, places = grid_and_places()
    places = places.requires_grad_()
    upstream = torch.ones(len(places), grid.num_features)
    grid(places).backward(upstream)
    whole = grid.table.grad
    assert whole is not None and places.grad is not None
    outside = (places < 0) | (places > 1)
    assert outside.any() and (places.grad[outside] == 0).all() and (places.grad[~outside] != 0).any()
    grid.table.grad = None
    for part in (slice(0, 100), slice(100, None)):
        grid(places.detach()[part]).backward(upstream[part])
    torch.testing.assert_close(grid.table.grad, whole, rtol=1e-5, atol=1e-5)
    assert torch.equal(grid.double()(places.double()).float(), encode_places(places.double(), grid.table, grid.resolutions).float())


def test_coarse_levels_have_an_entry_for_each_corner_and_fine_ones_share() -> None:
    corners = torch.cartesian_prod(*[torch.arange(4)] * 3)
    assert len(torch.unique(entry_of(corners, 3, 512))) == 64 == int(entry_of(corners, 3, 512).max()) + 1
    shared = entry_of(torch.cartesian_prod(*[torch.arange(41)] * 3), 40, 512)
    assert int(shared.min()) >= 0 and int(shared.max()) < 512 and len(torch.unique(shared)) == 512


def test_what_is_wrong_is_named() -> None:
    grid, places = grid_and_places(4)
    for wrong, told in (
        ({"num_levels": 0}, "1 to 32 levels"),
        ({"log2_entries": 30}, "2²⁴"),
        ({"coarsest": 9, "finest": 8}, "coarsest ≤ finest"),
    ):
        with pytest.raises(BadInput, match=told):
            GridConfig(**wrong)
    for poison in (np.nan, np.inf):
        places[2, 1] = poison
        with pytest.raises(ValueError, match="places has a number that is not finite at index 6"):
            grid(places)
    features = torch.empty(grid.num_features, 4)
    with pytest.raises(ValueError, match=r"places has another shape than \(3, N\)"):
        _radiant_fields.encode_places(torch.rand(4, 3), grid.table.detach(), grid.resolutions, features)
    with pytest.raises(ValueError, match="features has another shape"):
        _radiant_fields.encode_places(torch.rand(3, 5), grid.table.detach(), grid.resolutions, features)
    with pytest.raises(ValueError, match="power of two"):
        _radiant_fields.encode_places(torch.rand(3, 4), torch.rand(5, 500, 2), grid.resolutions, features)
    assert grid(torch.empty(0, 3)).shape == (0, 10)
