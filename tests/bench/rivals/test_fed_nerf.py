"""FedNeRF-style: entries are averaged by who uses them, poses are aligned before, and nothing else goes up."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.fields.field import make_field, num_parameters
from benchmarks.fields.poses import SharedMove
from benchmarks.fields.rays import PixelRays
from benchmarks.rivals.fed_nerf import TABLE, FedConfig, average_fields, entries_used, fit_fed
from radiant_core.errors import BadInput
from tests.bench.fields.floor import FIT, SIZES, bounds_of, floor_scene


@pytest.fixture(scope="module")
def clients() -> list[PixelRays]:
    """The western and the eastern photographs of the floor."""
    scene, views = floor_scene()
    pixels = PixelRays.of(views, bounds_of(scene))
    return [pixels.of_views(range(3)), pixels.of_views(range(6, 9))]


def test_an_entry_is_learnt_from_whom_it_showed_something() -> None:
    server = make_field(SIZES, 0)
    sent = [deepcopy(server), deepcopy(server)]
    old = server.get_parameter(TABLE).detach().clone()
    with torch.no_grad():
        sent[0].get_parameter(TABLE).fill_(1)
        sent[1].get_parameter(TABLE).fill_(3)
        sent[0].get_parameter("sigma.0.weight").fill_(1)
        sent[1].get_parameter("sigma.0.weight").fill_(5)
    used = [torch.zeros(old.shape[:2]), torch.zeros(old.shape[:2])]
    used[0][0, 0], used[1][0, 1] = 2.0, 0.5
    used[0][0, 2], used[1][0, 2] = 3.0, 1.0
    average_fields(server, sent, used, [100, 300])
    table = server.get_parameter(TABLE).detach()
    # Plain averaging would give 2 everywhere.
    assert table[0, :3, 0].tolist() == [1, 3, 1.5] and torch.equal(table[1:], old[1:]) and torch.equal(table[0, 3:], old[0, 3:])
    assert (server.get_parameter("sigma.0.weight") == 4).all()


def test_use_is_the_blended_share_of_each_entry(clients: list[PixelRays]) -> None:
    field = make_field(SIZES, 0)
    west, east = (entries_used(field, pixels, SharedMove(), FIT, 500) for pixels in clients)
    # The weights of a ray add up to 1, and so do the shares of a sample in a level.
    np.testing.assert_allclose(west.sum(dim=1), 500, rtol=1e-4)
    assert (west >= 0).all() and field.get_parameter(TABLE).grad is None
    # In the coarse level, which has an entry for each corner, they look at different places.
    corners = torch.arange(125)
    x = corners % 5
    assert (west[0, :125] * x).sum() < (east[0, :125] * x).sum()


def test_rounds_join_two_halves_and_count_what_goes_up(clients: list[PixelRays]) -> None:
    config = FedConfig(num_rounds=2, num_probes=300)
    fitted = fit_fed(clients, SIZES, replace(FIT, num_steps=48), config)
    assert fitted.num_rounds == 2 and len(fitted.moves) == 2
    numbers = num_parameters(fitted.field) + 6 * 2**10
    assert fitted.sent_bytes_a_round == 2 * 4 * numbers
    assert all(0 < float(move.abs().max()) < 0.01 for move in fitted.moves)
    unaligned = fit_fed(clients, SIZES, replace(FIT, num_steps=8), replace(config, align_share=0.0))
    assert all((move == 0).all() for move in unaligned.moves)
    assert not torch.equal(fitted.field.get_parameter(TABLE), unaligned.field.get_parameter(TABLE))


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(BadInput, match="no client"):
        fit_fed([], SIZES, FIT, FedConfig())
    for wrong in ({"num_rounds": 0}, {"align_share": 1.0}, {"align_rate": float("inf")}):
        with pytest.raises(BadInput, match="FedNeRF was given"):
            FedConfig(**wrong)
