"""What lies far before a scene is left out for an eye outside it, and nothing else ever is."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.render.reach import NEAR_M, REACH, Reach
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_C0, Splats, concatenate_splats

BLUE, GREY = (0.1, 0.2, 0.9), (0.4, 0.4, 0.4)


def dots(means: np.ndarray, size_m: float, rgb: tuple[float, float, float]) -> Splats:
    count = len(means)
    return Splats(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(size_m), np.float32),
        logit_opacities=np.full(count, 6, np.float32),
        sh0=np.tile((np.array(rgb, np.float32) - 0.5) / SH_C0, (count, 1, 1)),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def town() -> Splats:
    """4,096 opaque grey dots over 64 × 64 m of ground."""
    steps = np.arange(64) - 31.5
    return dots(np.stack([*np.meshgrid(steps, steps), np.zeros((64, 64))], axis=-1).reshape(-1, 3), 0.6, GREY)


def sky(count: int, radius_m: float = 360.0) -> Splats:
    """An opaque blue half sphere."""
    index = np.arange(count) + 0.5
    z, angle = index / count, np.pi * (1 + np.sqrt(5)) * index
    flat = np.sqrt(1 - z * z)
    return dots(radius_m * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1), 1.5 * radius_m / np.sqrt(count), BLUE)


def camera(eye: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0), focal_px: float = 60.0) -> Cameras:
    forward = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    right = np.cross(forward, (0, 0, 1.0))
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 0 else np.array([1.0, 0, 0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ np.array(eye)
    K = np.array([[[focal_px, 0, 48], [0, focal_px, 36], [0, 0, 1]]])
    return Cameras(names=("eye",), Ks=K, cam_from_world=pose[None], sizes_wh=np.array([[96, 72]]))


def picture(splats: Splats, eye: Cameras) -> np.ndarray:
    return next(render_views(splats, eye, "native", near_m=Reach.of(splats).near_m(eye))).image


@pytest.mark.parametrize("share", [0.01, 0.08, 0.25, 0.45])
@pytest.mark.parametrize("distance_m", [420.0, 600.0, 5000.0])
def test_a_sky_does_not_hide_what_is_below_it(share: float, distance_m: float) -> None:
    whole = concatenate_splats([town(), sky(round(share / (1 - share) * len(town())))])
    eye = camera((0.0, -0.7 * distance_m, 0.7 * distance_m), focal_px=0.9 * distance_m)
    everything = next(render_views(whole, eye, "native")).image
    assert (everything[..., 2] > everything[..., 0] + 0.3).mean() > 0.99
    # Few large Gaussians of a sky reach into the picture from its sides.
    np.testing.assert_allclose(picture(whole, eye), next(render_views(town(), eye, "native")).image, atol=0.08 if share < 0.05 else 1e-3)


def test_whether_anything_is_before_a_scene_is_known() -> None:
    eyes = [camera((0, -420, 420)), camera((0, -40, 20)), camera((0, -600, 5), (0, -700, 5))]
    whole = concatenate_splats([town(), sky(400)])
    assert [bool(Reach.of(whole).hides(whole, eye)[0]) for eye in eyes] == [True, False, False]
    assert not any(Reach.of(town()).hides(town(), eye)[0] for eye in eyes)


def test_nothing_is_left_out_within_reach_nor_behind_an_eye() -> None:
    whole = concatenate_splats([town(), sky(400)])
    reach = Reach.of(whole)
    assert 100 < reach.distance < 300
    for eye in (camera((0, -40, 20)), camera((0, -0.7 * reach.distance, 0.7 * reach.distance)), camera((0, -600, 5), (0, -700, 5))):
        assert reach.near_m(eye) == [NEAR_M]
        np.testing.assert_array_equal(picture(whole, eye), next(render_views(whole, eye, "native")).image)


def test_a_second_place_is_seen_from_its_own_side_and_from_above() -> None:
    second = dots(town().means[:300] + np.array([1000.0, 0, 0]), 0.6, BLUE)
    whole = concatenate_splats([town(), second])
    aside = float(second.means[:, 0].mean())
    low = float(second.means[:, 1].mean())
    for eye in (camera((aside - 30, low, 20), (aside, low, 0)), camera((aside / 2, 0, 60000), (aside / 2, 0.1, 0), 6000.0)):
        np.testing.assert_array_equal(picture(whole, eye), next(render_views(whole, eye, "native")).image)
    assert (picture(second, camera((aside + 5000, low, 3000), (aside, low, 0), 6000.0))[..., 2] > 0.5).any()


def test_the_near_plane_moves_with_the_eye_and_not_by_steps() -> None:
    reach = Reach(middle=np.array([3.0, 4, 5]), distance=10.0)
    eyes = [camera((3.0, 4 - away, 5), (3.0, 4, 5)) for away in (1.0, 9.99, 10.5, 1e3, 1e9)]
    np.testing.assert_allclose([float(reach.near_m(eye)[0]) for eye in eyes], [NEAR_M, NEAR_M, 0.5, 990.0, 1e9 - 10], rtol=1e-9)


def test_of_degenerate_models() -> None:
    one = town().select(np.zeros(3, np.int64))
    assert Reach.of(one).distance == np.inf
    assert Reach.of(one).near_m(camera((0, -100, 50))) == [NEAR_M]
    assert picture(one, camera((-31.5, -60, 20), (-31.5, -31.5, 0))).max() > 0.05
    huge = dots(np.array([[3e37, 0, 0], [-3e37, 0, 0], [0, 0, 0.0]]), 1.0, GREY)
    assert np.isfinite(Reach.of(huge).distance) and Reach.of(huge).near_m(camera((0, -100, 50))) == [NEAR_M]
    with pytest.raises(BadInput, match="no Gaussian"):
        Reach.of(town().select(np.zeros(0, np.int64)))
    assert REACH * np.median(np.linalg.norm(town().means, axis=1)) == pytest.approx(Reach.of(town()).distance)
