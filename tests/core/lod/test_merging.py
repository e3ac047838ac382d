"""Groups of Gaussians become one each: moments are kept, and nothing is seen from twice as far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.lod.merging import (
    MAX_OPACITY,
    MIN_OPACITY,
    covariances,
    ellipsoid_areas,
    group_neighbours,
    halve,
    halve_within,
    masses_of,
    merge_groups,
)
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import Splats, concatenate_splats
from tests.core.scenes import ground_splats


def made_up(count: int, seed: int = 0, degree: int = 1) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.normal(0, [8, 5, 1], (count, 3)),
        quats=rng.normal(0, 1, (count, 4)),
        log_scales=rng.normal(-3, 0.7, (count, 3)),
        logit_opacities=rng.normal(-3, 1, count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=0.1 * rng.normal(0, 1, (count, (degree + 1) ** 2 - 1, 3)),
    )


def moments_one_by_one(splats: Splats, groups: np.ndarray) -> list[dict[str, np.ndarray]]:
    """The plain twin: one group after another, from the definition."""
    weights, covariance = masses_of(splats), covariances(splats)
    found = []
    for group in range(int(groups.max()) + 1):
        members = np.flatnonzero(groups == group)
        w = weights[members] / weights[members].sum()
        mean = sum(share * splats.means[row].astype(float) for share, row in zip(w, members, strict=True))
        spread = sum(
            share * (covariance[row] + np.outer(splats.means[row] - mean, splats.means[row] - mean))
            for share, row in zip(w, members, strict=True)
        )
        colors = {
            name: sum(share * getattr(splats, name)[row].astype(float) for share, row in zip(w, members, strict=True))
            for name in ("sh0", "shN")
        }
        found.append({"mass": np.asarray(weights[members].sum()), "mean": np.asarray(mean), "spread": np.asarray(spread), **colors})
    return found


def test_mass_mean_covariance_and_harmonics_of_every_group_are_kept() -> None:
    splats = made_up(60, degree=2)
    # Near enough together that no group gets too faint for what is stored.
    splats = Splats(**{**splats.arrays(), "means": splats.means * np.float32(0.03)})
    groups = np.random.default_rng(1).permutation(np.repeat(np.arange(20), 3))
    groups = np.unique(groups, return_inverse=True)[1].ravel()
    merged = merge_groups(splats, groups)
    masses, spreads = masses_of(merged), covariances(merged)
    for row, truth in enumerate(moments_one_by_one(splats, groups)):
        # Results are stored as float32: 6e-8 of a number, of the logarithm of a scale some 3e-7.
        assert masses[row] == pytest.approx(truth["mass"], rel=3e-6)
        assert merged.means[row] == pytest.approx(truth["mean"], abs=2e-6)
        assert spreads[row] == pytest.approx(truth["spread"], rel=1e-5, abs=1e-6 * np.trace(truth["spread"]))
        assert merged.sh0[row] == pytest.approx(truth["sh0"], abs=1e-6)
        assert merged.shN[row] == pytest.approx(truth["shN"], abs=1e-6)


def test_levels_keep_the_mass_of_faint_models_and_groups_of_one_keep_their_bits() -> None:
    splats = made_up(501)
    half = halve(splats)
    assert len(half) == 251
    assert masses_of(half).sum() == pytest.approx(masses_of(splats).sum(), rel=1e-6)
    groups = group_neighbours(splats, 400)
    assert groups.max() + 1 == 400 and len(np.unique(groups)) == 400
    lone = np.flatnonzero(np.bincount(groups)[groups] == 1)
    merged = merge_groups(splats, groups)
    for name, array in splats.arrays().items():
        assert np.array_equal(getattr(merged, name)[groups[lone]], array[lone]), name


def test_what_is_opaque_keeps_the_area_that_it_covers() -> None:
    # Four opaque Gaussians in one place cover four times what one of their size can.
    base = made_up(1)
    four = Splats(**{**base.select(np.zeros(4, int)).arrays(), "logit_opacities": np.full(4, 20.0)})
    one = merge_groups(four, np.zeros(4, np.int64))
    assert masses_of(one)[0] == pytest.approx(masses_of(four).sum(), rel=1e-5)
    assert one.log_scales.max() - base.log_scales.max() == pytest.approx(np.log(4 / MAX_OPACITY) / 2, abs=1e-4)
    assert np.array_equal(one.means, base.means)


def test_a_group_joins_what_is_near_and_alike() -> None:
    pairs = np.repeat(np.array([[0.0, 0, 0], [5, 0, 0], [0, 5, 0]]), 2, axis=0) + np.tile([[0, 0, 0], [0.1, 0, 0]], (3, 1))
    base = made_up(1)
    splats = Splats(**{**base.select(np.zeros(6, int)).arrays(), "means": pairs.astype(np.float32)})
    assert group_neighbours(splats, 3).tolist() == [0, 0, 1, 1, 2, 2]
    # A red one beside a green one and another red one somewhat farther: the red ones are joined.
    colors = np.array([[2.0, -1, -1], [-1, 2, -1], [2, -1, -1]])[:, None]
    three = Splats(**{**base.select(np.zeros(3, int)).arrays(), "means": np.array([[0, 0, 0], [0.02, 0, 0], [-0.04, 0, 0]]), "sh0": colors})
    assert group_neighbours(three, 2).tolist() == [0, 1, 0]


def test_equal_input_gives_equal_bits_and_the_origin_far_away_does_not_matter() -> None:
    splats = made_up(300)
    again, half = halve(splats), halve(splats)
    assert all(np.array_equal(a, b) for a, b in zip(half.arrays().values(), again.arrays().values(), strict=True))
    # 2²⁰ m: float32 leaves 1/8 m there, so positions are put on that grid first.
    step = np.float32(0.125)
    rounded = Splats(**{**splats.arrays(), "means": np.round(splats.means / step) * step})
    shift = np.float32(2**20)
    moved = halve(Splats(**{**rounded.arrays(), "means": rounded.means + shift}))
    at_home = halve(rounded)
    assert np.abs(moved.means.astype(float) - shift - at_home.means).max() <= 0.0626  # half a step of float32 there
    assert moved.log_scales == pytest.approx(at_home.log_scales, abs=1e-5)


def test_opacities_stay_within_what_is_stored() -> None:
    splats = made_up(40)
    opaque = Splats(**{**splats.arrays(), "means": np.zeros((40, 3)), "logit_opacities": np.full(40, 20.0)})
    assert merge_groups(opaque, np.repeat(np.arange(20), 2)).opacities.max() <= MAX_OPACITY + 1e-7
    clear = Splats(**{**splats.arrays(), "logit_opacities": np.full(40, -200.0)})
    assert halve(clear).opacities.max() <= MIN_OPACITY * (1 + 1e-5), "what is transparent stays so"


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_the_smallest_models(count: int) -> None:
    assert len(halve(made_up(count))) == -(-count // 2)


@pytest.mark.parametrize(
    ("field", "value"),
    [("log_scales", 80.0), ("log_scales", -80.0), ("means", 1e30), ("quats", 0.0), ("logit_opacities", 3e38), ("logit_opacities", -3e38)],
)
def test_poison_gives_finite_gaussians(field: str, value: float) -> None:
    arrays = {name: array.copy() for name, array in made_up(20).arrays().items()}
    arrays[field][::3] = value
    with np.errstate(all="raise", under="ignore"):
        half = halve(Splats(**arrays))
    assert all(np.isfinite(array).all() for array in half.arrays().values())


def test_groups_with_gaps_are_refused() -> None:
    with pytest.raises(BadInput, match="without gaps"):
        merge_groups(made_up(3), np.array([0, 2, 2]))
    with pytest.raises(BadInput, match="without gaps"):
        merge_groups(made_up(3), np.array([-1, 0, 0]))


def test_only_gaussians_of_a_cell_are_joined_and_the_cheapest_of_all_cells() -> None:
    # Cell 1: large ones of unlike colours far apart, whose joining would be seen; cell 0: small
    # ones, alike. Halving takes from cell 0.
    small, large = ground_splats(300, half_side_m=3.0), ground_splats(100, half_side_m=3.0)
    colors = np.random.default_rng(3).normal(0, 2, large.sh0.shape).astype(np.float32)
    large = replace(large, means=large.means * 20, log_scales=large.log_scales + np.float32(3), sh0=colors)
    cells = np.repeat([0, 1], [300, 100])
    half, own = halve_within(concatenate_splats([small, large]), cells)
    assert len(half) == len(own) == 200
    assert (own == 1).sum() > 80, "the large ones are kept"
    assert np.abs(half.means[own == 0]).max() <= np.abs(small.means).max() + 1e-3, "none is drawn towards the other cell"
    with pytest.raises(BadInput, match="cells"):
        halve_within(small, cells)


def test_areas_agree_with_the_integral() -> None:
    scales = np.array([[1.0, 1, 1], [3, 2, 1], [1, 1, 0.01], [5, 0.1, 0.1], [1e25, 1e25, 1e25]])
    theta, phi = (np.arange(1500) + 0.5) * np.pi / 1500, (np.arange(600) + 0.5) * 2 * np.pi / 600
    found = ellipsoid_areas(scales)
    for (a, b, c), area in zip(scales[:4], found[:4], strict=True):
        st, ct = np.sin(theta)[:, None], np.cos(theta)[:, None]
        element = st * np.sqrt((b * c * st * np.cos(phi)) ** 2 + (a * c * st * np.sin(phi)) ** 2 + (a * b * ct) ** 2)
        assert area == pytest.approx(element.sum() * (np.pi / 1500) * (2 * np.pi / 600), rel=0.012)
    assert found[4] == pytest.approx(4 * np.pi * 1e50, rel=1e-9)


def test_from_twice_as_far_a_level_looks_as_the_one_before() -> None:
    # From 105 m a pixel is 0.76 m wide, twice the 0.38 m of a Gaussian: it is at the limit of what
    # can be told apart, where a level may begin. Nearer than that halving is seen: 29.5 dB at 40 m.
    splats = level = ground_splats(4000, half_side_m=20.0)
    for k in (1, 2, 3):
        level = halve(level)
        positions = 105.0 * 2**k * np.array([[0.0, 0.1, 1.0], [0.6, 0.3, 0.7]])
        cameras = cameras_looking_at(positions, np.zeros((2, 3)), Lens(size_wh=(160, 120)))
        for full, thin in zip(render_views(splats, cameras), render_views(level, cameras), strict=True):
            assert -10 * np.log10(((full.image - thin.image) ** 2).mean()) > 35, f"level {k}, dB"
