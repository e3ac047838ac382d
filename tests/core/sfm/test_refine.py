"""The last bundle adjustment: wrong matches do not bend the model, an unfixed lens stays."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from radiant_core.geometry.align import fit_sim3
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.refine import refine
from radiant_core.sfm.config import SfmConfig, SfmProgress

FOCAL_PX = 500.0
CONFIG = SfmConfig(num_threads=1)


def model_of(centers: FloatArray, points: FloatArray, *, noise_px: float, wrong_share: float, focal_px: float = FOCAL_PX):
    """Cameras at `centers` (C,3) that look straight down on `points` (P,3) through a lens of
    `FOCAL_PX`, as a model that takes it for `focal_px`: every projection has noise, and a share of
    them is off by 2 to 3 px."""
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[focal_px, 320.0, 240.0, 0.0], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    down = np.diag([1.0, -1.0, -1.0])
    seen: dict[int, list[tuple[int, int]]] = {}
    for number, center in enumerate(centers, 1):
        turned = (points - center) @ down.T
        pixels = FOCAL_PX * turned[:, :2] / turned[:, 2:] + [320.0, 240.0]
        inside = np.flatnonzero((pixels > 0).all(axis=1) & (pixels < [640, 480]).all(axis=1))
        pixels = pixels[inside] + rng.normal(0, noise_px, (len(inside), 2))
        pixels += np.where(rng.random((len(inside), 1)) < wrong_share, rng.uniform(2, 3, (len(inside), 2)), 0)
        image = pycolmap.Image(name=f"{number}.jpg", keypoints=pixels, camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(down), -down @ center))
        for row, point in enumerate(inside):
            seen.setdefault(int(point), []).append((number, row))
    for point, places in seen.items():
        if len(places) >= 2:
            model.add_point3D(points[point], pycolmap.Track([pycolmap.TrackElement(*place) for place in places]), np.zeros(3, np.uint8))
    return model


def centers_of(model: pycolmap.Reconstruction) -> FloatArray:
    return np.array([model.image(number).projection_center() for number in sorted(model.reg_image_ids())])


def error_m(model: pycolmap.Reconstruction, centers: FloatArray) -> float:
    found = centers_of(model)
    return float(np.sqrt(np.square(fit_sim3(found, centers).apply(found) - centers).sum(axis=1).mean()))


def grid(heights: tuple[float, ...]) -> FloatArray:
    return np.array([(8.0 * x, 6.0 * y, heights[(x + y) % len(heights)]) for x in range(4) for y in range(3)])


def ground(relief_m: float) -> FloatArray:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-15, 40, 1200), rng.uniform(-12, 25, 1200), rng.uniform(0, relief_m, 1200)])


def test_wrong_matches_bend_less_than_by_squares() -> None:
    centers = grid((30.0, 24.0))
    model = model_of(centers, ground(10.0), noise_px=0.2, wrong_share=0.15)
    by_squares = pycolmap.Reconstruction(model)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    pycolmap.bundle_adjustment(by_squares, options)
    told: list[SfmProgress] = []
    refined = refine(model, CONFIG, told.append)
    assert error_m(refined, centers) < 0.5 * error_m(by_squares, centers)
    assert refined.camera(1).focal_length == pytest.approx(FOCAL_PX, rel=2e-3)
    assert [(row.phase, row.done, row.total) for row in told] == [("refining", 0, 12), ("refining", 12, 12)]


def test_the_model_that_comes_in_is_left_alone() -> None:
    model = model_of(grid((30.0, 24.0)), ground(10.0), noise_px=0.5, wrong_share=0.1)
    before = centers_of(model)
    refined = refine(model, CONFIG, lambda progress: None)
    np.testing.assert_array_equal(centers_of(model), before)
    assert not np.array_equal(centers_of(refined), before)


def test_a_lens_that_flat_ground_does_not_fix_is_kept() -> None:
    centers = grid((30.0,))[:4]
    model = model_of(centers, ground(0.01)[:150], noise_px=1.0, wrong_share=0.0)
    free = pycolmap.Reconstruction(model)
    pycolmap.bundle_adjustment(free, pycolmap.BundleAdjustmentOptions(print_summary=False))
    refined = refine(model, CONFIG, lambda progress: None)
    assert abs(free.camera(1).focal_length / FOCAL_PX - 1) > 0.01, "the case must leave the focal length open"
    assert list(refined.camera(1).params) == list(model.camera(1).params)
    assert np.isfinite(centers_of(refined)).all() and error_m(refined, centers) < 0.5


def test_the_equations_of_thousands_of_images_are_factorised(monkeypatch: pytest.MonkeyPatch) -> None:
    """By iterations, as COLMAP solves them from 1,000 images on, 1,600 took four times as long and ended farther from the truth."""
    limits: list[int] = []
    monkeypatch.setattr(
        pycolmap, "bundle_adjustment", lambda _, options, **__: limits.append(options.ceres.max_num_images_direct_sparse_cpu_solver)
    )
    points = np.random.default_rng(0).uniform([0, 0, 0], [20, 10, 1], (200, 3))
    refine(model_of(grid((20.0,)), points, noise_px=0.1, wrong_share=0.0), CONFIG, lambda _: None)
    assert limits == [4_000]
