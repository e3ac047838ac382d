"""Seam masks against polygons and hand-placed cameras; figures only where pixels suffice."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from benchmarks.methods.seam_error import SeamMask, band_and_interior_psnr_db, seam_masks
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import border_distance_m
from radiant_core.evaluate.image_error import psnr_db
from tests.core.plan.made_plans import plan_of


def power_cells(sites: np.ndarray, weights: np.ndarray, reach_m: float) -> list[shapely.Polygon]:
    """Cells clipped one half-plane at a time, each a large rectangle turned to its border."""
    cells = []
    for i, (site, weight) in enumerate(zip(sites, weights, strict=True)):
        cell = shapely.box(-reach_m, -reach_m, reach_m, reach_m)
        for j, (other, other_weight) in enumerate(zip(sites, weights, strict=True)):
            if i != j:
                spacing = np.linalg.norm(other - site)
                along = (other - site) / spacing
                across = np.array([-along[1], along[0]])
                middle = site + along * (spacing**2 + weight - other_weight) / (2 * spacing)
                far = 10 * reach_m
                corners = [middle - far * across, middle + far * across]
                cell = cell & shapely.Polygon([*corners, corners[1] - far * along, corners[0] - far * along])
        cells.append(cell)
    return cells


@pytest.mark.parametrize("seed", range(5))
def test_the_distance_is_that_to_the_boundary_of_the_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Uneven weights, so that some cells are empty or lie beside their site.
    sites, weights = rng.uniform(-40, 40, (7, 2)), rng.uniform(-400, 400, 7)
    points = rng.uniform(-60, 60, (200, 2))
    cells = power_cells(sites, weights, 1e4)
    distances_m = border_distance_m(points, plan_of(sites, weights))
    for point, distance_m in zip(points, distances_m, strict=True):
        own = next(cell for cell in cells if cell.covers(shapely.Point(point)))
        # Polygons 1e5 m long in float64 keep some 1e-9 m.
        assert distance_m == pytest.approx(own.boundary.distance(shapely.Point(point)), abs=1e-6)


def test_one_region_or_two_at_one_site_have_no_border() -> None:
    points = np.array([[0.0, 0.0], [5.0, 5.0]])
    assert np.isinf(border_distance_m(points, plan_of(np.zeros((1, 2)), np.zeros(1)))).all()
    assert np.isinf(border_distance_m(points, plan_of(np.zeros((2, 2)), np.array([0.0, 1.0])))).all()


def camera_above(x_m: float, height_m: float, size_px: int = 101, focal_px: float = 100.0) -> Cameras:
    """One camera at (x, 0, height) that looks straight down, image x along world x."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = -pose[:3, :3] @ [x_m, 0.0, height_m]
    K = np.array([[focal_px, 0, size_px / 2], [0, focal_px, size_px / 2], [0, 0, 1]])
    return Cameras(names=("down",), Ks=K[None], cam_from_world=pose[None], sizes_wh=np.array([[size_px, size_px]]))


TWO_HALVES = plan_of(np.array([[-10.0, 0.0], [10.0, 0.0]]), np.zeros(2))


def test_a_camera_over_the_border_sees_a_band_of_the_right_width() -> None:
    # 100 px focal length at 50 m: 0.5 m per pixel, so 5.1 m on both sides are columns 50 ± 10.
    (mask,) = seam_masks(camera_above(0, 50), [np.full((101, 101), 50.0)], TWO_HALVES, 5.1)
    columns = np.flatnonzero(mask.band[0])
    assert (columns.min(), columns.max()) == (40, 60)
    assert (mask.band == mask.band[0]).all()
    assert (mask.interior == ~mask.band).all()


def test_the_band_moves_with_the_camera() -> None:
    (mask,) = seam_masks(camera_above(10, 50), [np.full((101, 101), 50.0)], TWO_HALVES, 5.1)
    columns = np.flatnonzero(mask.band[0])
    assert (columns.min(), columns.max()) == (20, 40)


@pytest.mark.parametrize("sky", [0.0, -1.0, np.nan, np.inf])
def test_pixels_without_depth_are_in_no_part(sky: float) -> None:
    depth_m = np.full((101, 101), 50.0)
    depth_m[:50] = sky
    (mask,) = seam_masks(camera_above(0, 50), [depth_m], TWO_HALVES, 5.1)
    assert not (mask.band | mask.interior)[:50].any()
    assert (mask.band | mask.interior)[50:].all()


def test_wrong_sizes_are_bad_input() -> None:
    camera = camera_above(0, 50)
    whole = [np.ones((101, 101))]
    for depths_m, half_band_m in (([np.ones((3, 3))], 1.0), ([], 1.0), (whole, 0.0), (whole, np.nan)):
        with pytest.raises(BadInput):
            seam_masks(camera, depths_m, TWO_HALVES, half_band_m)
    mask = SeamMask(labels=np.zeros((4, 4), np.int16))
    with pytest.raises(BadInput, match="differ in size"):
        band_and_interior_psnr_db([np.zeros((4, 5, 3))], [np.zeros((4, 4, 3))], [mask])


def striped(num_images: int, side_px: int) -> tuple[list[np.ndarray], list[np.ndarray], list[SeamMask]]:
    """Images whose left half is the band, with an error of 0.1 there and 0.01 elsewhere."""
    left = np.zeros((side_px, side_px), bool)
    left[:, : side_px // 2] = True
    render = np.where(left[..., None], 0.1, 0.01) * np.ones(3)
    return (
        [render] * num_images,
        [np.zeros_like(render)] * num_images,
        [SeamMask(labels=np.where(left, 0, -1).astype(np.int16))] * num_images,
    )


def test_band_and_interior_are_scored_apart() -> None:
    error = band_and_interior_psnr_db(*striped(10, 64))
    assert error.seam_psnr_db == pytest.approx(20.0, abs=1e-9)
    assert error.interior_psnr_db == pytest.approx(40.0, abs=1e-9)
    assert error.reason is None


@pytest.mark.parametrize(("num_images", "side_px"), [(9, 200), (10, 63), (0, 0)])
def test_too_few_images_or_pixels_are_insufficient(num_images: int, side_px: int) -> None:
    error = band_and_interior_psnr_db(*striped(num_images, side_px))
    assert error.seam_psnr_db is None
    assert "insufficient" in str(error.reason)


def test_over_whole_images_it_is_the_ordinary_psnr() -> None:
    rng = np.random.default_rng(0)
    render, photo = rng.random((2, 50, 50, 3))
    everywhere = SeamMask(labels=np.zeros((50, 50), np.int16))
    error = band_and_interior_psnr_db([render] * 10, [photo] * 10, [everywhere] * 10)
    assert error.seam_psnr_db == pytest.approx(psnr_db(render, photo), abs=1e-9)
    assert error.interior_psnr_db is None
