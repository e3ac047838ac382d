"""What cameras see of the block, and the laws of what is known of it."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.next_flight.sightings import known_by, log_det
from tests.core.next_flight.block import LENS, SIDE, block_sights, looks


def test_a_nadir_view_leaves_walls_unseen_and_depth_weak() -> None:
    sights = block_sights()
    cameras = looks((0.0, 0.0, 40.0))
    known = known_by(sights, cameras, sights.all_of(cameras))
    walls = sights.facets.is_wall
    # From above its middle every wall of the block is beyond 80° or hidden by its own roof.
    assert known.unseen[walls].all()
    # The ground within a metre of the block lies behind the edge of its roof: 8 m · 5 / 40.
    away = np.abs(sights.facets.places[:, :2]).max(axis=1)
    clear = ~walls & ((away > SIDE / 2 + 1) | (sights.facets.places[:, 2] > 0))
    assert not known.unseen[clear].any()
    assert known.unseen[~walls & ~clear].mean() > 0.8
    assert known.weak[clear].all()
    assert (known.parallax_deg == 0).all()
    # Width of a pixel: depth over focal length.
    ground = ~walls & (sights.facets.places[:, 2] == 0)
    assert known.gsd[ground & clear] == pytest.approx(40.0 / LENS.K[0, 0], rel=1e-6)


def test_a_second_side_makes_depth_known_and_opens_its_wall() -> None:
    sights = block_sights()
    cameras = looks((0.0, 0.0, 40.0), (35.0, 0.0, 20.0))
    known = known_by(sights, cameras, sights.all_of(cameras))
    east = sights.facets.is_wall & (sights.facets.normals[:, 0] > 0.5)
    west = sights.facets.is_wall & (sights.facets.normals[:, 0] < -0.5)
    assert known.unseen[west].all()
    assert not known.unseen[east].any()
    roof = sights.facets.places[:, 2] == 8.0
    assert not known.weak[roof & ~sights.facets.is_wall].any()
    # The angle at the roof between straight above and the other camera.
    row = int(np.flatnonzero(roof & ~sights.facets.is_wall)[0])
    rays = cameras.centers - sights.facets.places[row]
    cosine = rays[0] @ rays[1] / np.linalg.norm(rays, axis=1).prod()
    assert known.parallax_deg[row] == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)


def test_log_det_is_numpys() -> None:
    halves = np.random.default_rng(0).normal(size=(50, 3, 3))
    matrices = halves @ halves.transpose(0, 2, 1) + np.eye(3)
    numbers = np.stack([matrices[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=1)
    assert log_det(numbers) == pytest.approx(np.linalg.slogdet(matrices)[1], abs=1e-9)


def test_gains_shrink_with_what_is_known() -> None:
    """The law that makes greedy choice good: what a view adds to more is less."""
    sights = block_sights()
    cameras = looks((0.0, 0.0, 40.0), (35.0, 0.0, 20.0), (0.0, 30.0, 30.0))
    views = sights.all_of(cameras)

    def total(*chosen: int) -> float:
        return float((sights.facets.areas * known_by(sights, cameras, [views[index] for index in chosen]).score).sum())

    assert total(0, 2) > total(0)
    assert total(0, 2) - total(0) > total(0, 1, 2) - total(0, 1)
