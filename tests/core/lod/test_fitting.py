"""Levels fitted to pictures: nearer from where they are for, and a function of the chunk alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.lod.fitting import fit_level, fitting_s
from radiant_core.lod.levels import LodLimits, chunks_of, lay_out
from radiant_core.lod.merging import halve
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import Splats, concatenate_splats
from tests.core.lod.test_levels import at, square
from tests.core.lod.test_merging import made_up
from tests.core.scenes import ground_splats

FITTED = LodLimits(num_levels=2, chunk_count=1000, leaf_side_m=2.0, leaf_count=100, fit=fit_level)


def rubble(count: int) -> Splats:
    """Ground of unequal, turned, half transparent Gaussians, each of a colour of its own."""
    rng = np.random.default_rng(5)
    ground = ground_splats(count, half_side_m=float(np.sqrt(count) / 3))
    return Splats(
        means=ground.means + rng.normal(0, 0.3, ground.means.shape),
        quats=rng.normal(0, 1, ground.quats.shape),
        log_scales=ground.log_scales + rng.normal(0, 0.6, ground.log_scales.shape),
        logit_opacities=rng.normal(0.5, 1.5, count),
        sh0=rng.normal(0, 0.5, ground.sh0.shape),
        shN=ground.shN,
    )


def psnr_db(finest: Splats, level: Splats, height_m: float) -> float:
    positions = height_m * np.array([[0.1, 0.05, 1.0], [0.5, -0.3, 0.8]])
    cameras = cameras_looking_at(positions, np.zeros((2, 3)), Lens(size_wh=(200, 150)))
    pairs = zip(render_views(finest, cameras), render_views(level, cameras), strict=True)
    return float(-10 * np.log10(np.mean([((full.image - thin.image) ** 2).mean() for full, thin in pairs])))


def test_a_fitted_level_is_nearer_from_other_places_than_it_was_fitted_to() -> None:
    finest = rubble(800)
    level = halve(finest)
    shares: list[float] = []
    fitted = fit_level(finest, level, 1, shares.append)
    assert len(fitted) == len(level) and 0 < shares[0] <= shares[-1] == 1
    for height_m in (100.0, 160.0):
        assert psnr_db(finest, fitted, height_m) > psnr_db(finest, level, height_m) + 0.6, height_m
    again = fit_level(finest, level, 1)
    assert all(np.array_equal(array, again.arrays()[name]) for name, array in fitted.arrays().items())


def test_without_a_known_up_a_level_is_seen_from_all_around() -> None:
    # The same ground, y up: straight down z it is seen edge on.
    flat = rubble(800)
    turned = replace(flat, means=flat.means[:, [0, 2, 1]] * np.float32([1, 1, -1]), quats=flat.quats[:, [2, 3, 0, 1]])
    level = halve(turned)
    fitted = fit_level(turned, level, 1, from_above=False)
    cameras = cameras_looking_at(np.array([[5.0, 120, 8]]), np.zeros((1, 3)), Lens(size_wh=(200, 150)))
    (full,), (thin,), (better,) = (list(render_views(splats, cameras)) for splats in (turned, level, fitted))
    assert ((full.image - better.image) ** 2).mean() < ((full.image - thin.image) ** 2).mean()


def test_time_grows_with_chunks_levels_and_gaussians() -> None:
    # 110,952 Gaussians in one chunk with seven levels took 151 s.
    assert 120 < fitting_s(110_952, 7, 1) < 190
    assert fitting_s(50_000, 1, 2) == 0 < fitting_s(50_000, 2, 1) < fitting_s(50_000, 2, 2) < fitting_s(50_000, 3, 2)


def test_a_level_that_is_near_enough_keeps_its_values() -> None:
    # Of even colours: halving costs so little that fitting would add noise.
    finest = ground_splats(2000, half_side_m=15.0)
    level = halve(finest)
    assert fit_level(finest, level, 1) is level


def test_what_cannot_be_fitted_keeps_its_values() -> None:
    few = made_up(40)
    assert fit_level(few, halve(few), 1).means.tolist() == halve(few).means.tolist()
    many = ground_splats(400, half_side_m=5.0)
    bright = replace(many, sh0=np.full_like(many.sh0, 1e30))
    huge = replace(many, log_scales=np.full_like(many.log_scales, 300.0))
    for finest in (bright, huge):
        level = finest.select(np.arange(200))
        with np.errstate(all="raise", under="ignore"):
            assert fit_level(finest, level, 1) is level
    for finest in (replace(many, means=np.zeros_like(many.means)), replace(many, log_scales=np.full_like(many.log_scales, 60.0))):
        assert all(np.isfinite(array).all() for array in fit_level(finest, halve(finest), 1).arrays().values())


def test_a_fitted_chunk_is_a_function_of_its_gaussians() -> None:
    west, east = at(rubble(500), (-10, 0, 0)), at(rubble(500), (10, 0, 0))
    regions = [square(-20.0), square(0.0)]
    both, changed = (concatenate_splats([west, other]) for other in (east, at(east, (0, 0, 1.0))))
    (kept, moved), (same, other) = (list(chunks_of(splats, lay_out(splats, regions, FITTED))) for splats in (both, changed))
    plain = next(iter(chunks_of(both, lay_out(both, regions, replace(FITTED, fit=None)))))
    assert all(np.array_equal(array, same.levels[1].arrays()[name]) for name, array in kept.levels[1].arrays().items())
    assert not np.array_equal(moved.levels[1].means, other.levels[1].means)
    assert not np.array_equal(kept.levels[1].means, plain.levels[1].means) and len(kept.levels[1]) == len(plain.levels[1])
