"""The light of photographs from common places: what was planted is found; poison, nothing in
common, one photograph and none say nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.light import solve
from radiant_core.light.lights import NUM_TERMS, Lights, cameras_alike, in_canonical_light
from radiant_core.light.solve import (
    COMPARED_PX,
    MIN_SHARED,
    Observations,
    lights_from_model,
    lights_from_tracks,
    lights_if_they_differ,
    solve_lights,
)
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, concatenate_splats
from radiant_core.train.views import TrainingViews
from tests.core.light.plain_lights import no_lights
from tests.core.scenes import cameras_above, ground_splats

NUM_VIEWS = 12
CAMERAS = cameras_above([(0.1 * view, 0.0) for view in range(NUM_VIEWS)], size_wh=(64, 48))
TERMS = np.array([[-0.2, -0.15, -0.1], [0.05, 0.0, 0.02], [-0.1, 0.0, 0.0]])


def planted(rng: np.random.Generator, num_places: int = 400, noise: float = 0.0) -> tuple[Observations, np.ndarray]:
    """Places that five photographs show each, and the log gains (V,3) with mean 0."""
    gains = rng.normal(0, 0.2, (NUM_VIEWS, 3))
    gains -= gains.mean(axis=0)
    albedos = rng.uniform(3.5, 4.8, (num_places, 3))
    place = np.repeat(np.arange(num_places), 5)
    view = np.concatenate([rng.choice(NUM_VIEWS, 5, replace=False) for _ in range(num_places)])
    squared = rng.uniform(0, 1, len(view))
    logs = albedos[place] + gains[view] + powers(squared) @ TERMS + rng.normal(0, noise, (len(view), 3))
    return Observations(view=view, squared_radii=squared, logs=logs, place=place), gains


def powers(squared: np.ndarray) -> np.ndarray:
    return np.stack([squared ** (term + 1) for term in range(NUM_TERMS)], axis=1)


def test_gains_and_vignetting_that_were_planted_are_found() -> None:
    rng = np.random.default_rng(0)
    observed, gains = planted(rng)
    wrong = rng.choice(len(observed.view), 150, replace=False)
    observed.logs[wrong] += rng.normal(0, 1, (150, 1))
    lights = solve_lights(observed, CAMERAS)
    radii = powers(np.linspace(0, 1, 50))
    # The prior and the wrong ones weigh next to nothing where all else agrees.
    assert np.abs(lights.log_gains - gains).max() < 1e-6
    assert np.abs(radii @ (lights.vignettings[0] - TERMS)).max() < 1e-6
    assert lights.is_known.all() and lights.spread == pytest.approx(np.sqrt(np.mean(gains.var(axis=0))), abs=1e-6)
    assert lights.corner == pytest.approx(-0.25, abs=1e-6)


def test_noise_of_five_percent_leaves_a_hundredth() -> None:
    observed, gains = planted(np.random.default_rng(1), noise=0.05)
    assert np.abs(solve_lights(observed, CAMERAS).log_gains - gains).max() < 0.02


def test_ratios_keep_the_mean_gain() -> None:
    observed, gains = planted(np.random.default_rng(2))
    ratios = replace(observed, logs=gains[observed.view] + 0.3 + powers(observed.squared_radii) @ TERMS, place=None)
    assert np.abs(solve_lights(ratios, CAMERAS).log_gains - gains - 0.3).max() < 1e-6


def test_each_set_that_shares_places_has_its_own_gauge() -> None:
    observed, gains = planted(np.random.default_rng(3), num_places=3_000)
    half = observed.view < NUM_VIEWS // 2
    assert observed.place is not None
    place = np.where(half, observed.place, 3_000 + observed.place)
    lights = solve_lights(replace(observed, place=place), CAMERAS)
    for part in (slice(0, NUM_VIEWS // 2), slice(NUM_VIEWS // 2, NUM_VIEWS)):
        own = gains[part] - gains[part].mean(axis=0)
        assert np.abs(lights.log_gains[part] - own).max() < 1e-6


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_poison_is_as_if_it_were_not_there(poison: float) -> None:
    observed, _ = planted(np.random.default_rng(4))
    bad = np.zeros(len(observed.view), bool)
    bad[::7] = True
    assert observed.place is not None
    clean = Observations(
        view=observed.view[~bad], squared_radii=observed.squared_radii[~bad], logs=observed.logs[~bad], place=observed.place[~bad]
    )
    observed.logs[bad] = poison
    found, expected = solve_lights(observed, CAMERAS), solve_lights(clean, CAMERAS)
    np.testing.assert_array_equal(found.log_gains, expected.log_gains)
    np.testing.assert_array_equal(found.vignettings, expected.vignettings)


def test_huge_and_tiny_values_stay_finite() -> None:
    observed, _ = planted(np.random.default_rng(5))
    observed.logs[::11] = 1e12
    observed.logs[1::11] = -1e12
    lights = solve_lights(observed, CAMERAS)
    assert np.isfinite(lights.log_gains).all() and np.isfinite(lights.vignettings).all()


@pytest.mark.parametrize("num_views", [1, 2, 12])
def test_photographs_that_share_nothing_are_not_known(num_views: int) -> None:
    cameras = CAMERAS.select(list(range(num_views)))
    view = np.repeat(np.arange(num_views), 2 * MIN_SHARED)
    logs = np.random.default_rng(6).normal(4, 1, (len(view), 3))
    alone = Observations(view=view, squared_radii=np.full(len(view), 0.5), logs=logs, place=np.arange(len(view)))
    lights = solve_lights(alone, cameras)
    assert not lights.is_known.any() and not lights.log_gains.any() and not lights.vignettings.any() and lights.spread == 0


def test_without_observations_nothing_is_known() -> None:
    nothing = Observations(view=np.zeros(0, np.int64), squared_radii=np.zeros(0), logs=np.zeros((0, 3)), place=np.zeros(0, np.int64))
    lights = solve_lights(nothing, CAMERAS)
    assert not lights.is_known.any() and lights.corner == 0
    assert np.array_equal(lights.factors(3, CAMERAS), np.ones((48, 64, 3), np.float32))


def two_cameras() -> Cameras:
    wide = replace(CAMERAS, Ks=CAMERAS.Ks * np.array([[0.5], [0.5], [1.0]]) + np.array([[0, 0, 16.0], [0, 0, 12.0], [0, 0, 0]]))
    wide = replace(wide, names=tuple(f"wide_{name}" for name in wide.names))
    return concatenate_cameras([CAMERAS, wide])


def test_two_cameras_have_vignettings_of_their_own() -> None:
    both = two_cameras()
    camera_of, count = cameras_alike(both)
    assert count == 2 and len(set(camera_of[:NUM_VIEWS])) == 1 and camera_of[0] != camera_of[-1]
    np.testing.assert_array_equal(cameras_alike(both.scaled(31))[0], camera_of)


@pytest.mark.parametrize("of_places", [False, True])
def test_sparse_equations_are_those_of_dense_least_squares(of_places: bool) -> None:
    both, rng = two_cameras(), np.random.default_rng(8)
    camera_of, num_cameras = cameras_alike(both)
    num_places, num_seen = 300, 2_000
    view, place = rng.integers(0, len(both), num_seen), np.arange(num_seen) % num_places
    squared, logs = rng.uniform(0, 1, num_seen), rng.normal(0, 0.1, (num_seen, 3)) + rng.normal(0, 0.2, len(both))[view, None]
    observed = Observations(view=view, squared_radii=squared, logs=logs, place=place if of_places else None)
    lights = solve_lights(observed, both)
    # Albedos as unknowns like the others, in one dense matrix.
    design = np.zeros((num_seen, len(both) + NUM_TERMS * num_cameras + of_places * num_places))
    design[np.arange(num_seen), view] = 1
    for term in range(NUM_TERMS):
        design[np.arange(num_seen), len(both) + NUM_TERMS * camera_of[view] + term] = squared ** (term + 1)
    if of_places:
        design[np.arange(num_seen), len(both) + NUM_TERMS * num_cameras + place] = 1
    priors = np.repeat([solve.GAIN_SPREAD, solve.TERM_SPREAD, np.inf], [len(both), NUM_TERMS * num_cameras, of_places * num_places]) ** -2.0
    weights, scale, solution = np.ones(num_seen), solve.FIRST_SCALE, np.zeros(design.shape[1])
    for _ in range(solve.NUM_ROUNDS):
        normal = design.T @ (weights[:, None] * design) + np.diag(scale**2 * priors)
        solution = np.linalg.solve(normal, design.T @ (weights * logs[:, 1]))
        residuals = logs[:, 1] - design @ solution
        scale = 1.4826 * np.median(np.abs(residuals))
        weights = 1 / (1 + (residuals / (solve.WIDTH * scale)) ** 2)
    gains = solution[: len(both)] - of_places * solution[: len(both)].mean()
    np.testing.assert_allclose(lights.log_gains[:, 1], gains, atol=1e-9)
    np.testing.assert_allclose(lights.vignettings[:, :, 1].ravel(), solution[len(both) :][: NUM_TERMS * num_cameras], atol=1e-9)


def uneven_scene() -> tuple[SfmScene, TrainingViews, np.ndarray, tuple[np.ndarray, ...]]:
    """Renders of one ground, darker towards the corners, each with gains of its own."""
    model = ground_splats(400)
    rng = np.random.default_rng(7)
    gains = rng.normal(0, 0.12, (NUM_VIEWS, 3))
    gains -= gains.mean(axis=0)
    truth = replace(no_lights(CAMERAS), log_gains=gains, vignettings=np.array([np.outer([-0.2, 0.0, 0.0], np.ones(3))]))
    plain = [view.image for view in render_views(model, CAMERAS)]
    images = tuple(
        np.clip(255 * image * truth.factors(index, CAMERAS), 0, 255).round().astype(np.uint8) for index, image in enumerate(plain)
    )
    points = model.means.astype(np.float64)
    observations = np.stack(np.meshgrid(np.arange(len(points)), np.arange(NUM_VIEWS), indexing="ij"), axis=-1).reshape(-1, 2)
    frame = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))
    colors = np.zeros((len(points), 3), np.uint8)
    scene = SfmScene(cameras=CAMERAS, points=points, colors=colors, observations=observations, frame=frame)
    return scene, TrainingViews(cameras=CAMERAS, images=images), gains, tuple(plain)


def test_photographs_of_one_ground_give_their_gains_and_are_alike_in_canonical_light() -> None:
    scene, views, gains, plain = uneven_scene()
    lights = lights_from_tracks(scene, views)
    # Colours of 8 bits, smoothed over 3 px beside edges.
    assert np.abs(lights.log_gains - gains).max() < 0.02
    level = in_canonical_light(views, lights)
    before = [np.abs(image / 255 - truth).mean() for image, truth in zip(views.images, plain, strict=True)]
    after = [np.abs(image / 255 - truth).mean() for image, truth in zip(level.images, plain, strict=True)]
    assert np.mean(after) < 0.25 * np.mean(before)
    assert all(image.dtype == np.uint8 for image in level.images) and level.cameras is views.cameras


def test_some_points_tell_that_light_is_alike_and_all_are_asked_where_it_differs(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, views, _, plain = uneven_scene()
    alike = replace(views, images=tuple(np.clip(255 * image, 0, 255).round().astype(np.uint8) for image in plain))
    solved: list[int] = []
    whole = solve.solve_lights
    monkeypatch.setattr(solve, "solve_lights", lambda observed, *rest: solved.append(len(observed.view)) or whole(observed, *rest))
    some, every = lights_if_they_differ(scene, alike), lights_from_tracks(scene, alike)
    assert 2 * solved[0] < solved[1] and len(solved) == 2
    assert some.regime.row == every.regime.row == "light-alike" and some.spread < 0.01 and some.is_known.all()
    solved.clear()
    different = lights_if_they_differ(scene, views)
    assert len(solved) == 2 and 2 * solved[0] < solved[1]
    np.testing.assert_array_equal(different.log_gains, lights_from_tracks(scene, views).log_gains)
    assert different.is_worth_modelling


def test_a_model_tells_the_light_of_photographs_beside_its_own() -> None:
    _, views, gains, _ = uneven_scene()
    model = ground_splats(400)
    seen = lights_from_model(model, views)
    assert np.abs(seen.lights.log_gains - gains).max() < 0.01 and seen.lights.is_known.all()
    assert seen.lights.corner == pytest.approx(-0.2, abs=0.02)
    # Places lie on the ground, |z| ≤ 0.3 m.
    assert all(len(own) > 30 and np.abs(own[:, 2]).max() < 0.8 for own in seen.places)
    masked = replace(views, weights=tuple(np.zeros(image.shape[:2], np.uint8) for image in views.images))
    assert not lights_from_model(model, masked).lights.is_known.any()


def test_a_model_shown_smaller_is_not_taken_for_another_light() -> None:
    """Fine bright Gaussians over dark ground cover more of a pixel the larger it is: as they are seen, nothing is brighter."""
    rng = np.random.default_rng(0)
    ground, fine = ground_splats(400), ground_splats(6_000, seed=1)
    dark = replace(ground, sh0=np.full_like(ground.sh0, (0.25 - 0.5) / SH_C0))
    bright = replace(
        fine,
        means=fine.means + np.array([0.0, 0.0, 0.05]),
        log_scales=np.full_like(fine.log_scales, np.log(0.004)),
        sh0=np.broadcast_to((rng.uniform(0.5, 0.8, (6_000, 1, 1)) - 0.5) / SH_C0, fine.sh0.shape).copy(),
    )
    model = concatenate_splats([dark, bright])
    cameras = cameras_above([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 1.0)], size_wh=(768, 576))
    images = tuple(np.uint8(255 * np.clip(view.image, 0, 1)) for view in render_views(model, cameras))
    views = TrainingViews(cameras=cameras, images=images)
    seen, smaller = (lights_from_model(model, views, seen_px=seen_px).lights.log_gains.mean() for seen_px in (None, COMPARED_PX))
    assert abs(seen) < 0.03 and smaller < -0.1


def test_lights_refuse_shapes_that_disagree() -> None:
    with pytest.raises(BadInput, match="flags that are not there"):
        Lights(log_gains=np.zeros((2, 3)), camera_of=np.array([0, 1]), vignettings=np.zeros((1, NUM_TERMS, 3)), is_known=np.ones(2, bool))
    with pytest.raises(BadInput, match="not finite"):
        replace(no_lights(CAMERAS), log_gains=np.full((NUM_VIEWS, 3), np.nan))
