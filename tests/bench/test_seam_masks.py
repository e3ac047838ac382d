"""The same masks for all methods: per border, both levels, hidden ground, and planted errors."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.methods.device_borders import DeviceBorders
from benchmarks.methods.seam_error import SeamMasks, band_and_interior_psnr_db, seam_masks
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import EdgeBorders
from tests.bench.test_seam_error import camera_above
from tests.core.plan.made_plans import plan_of, two_edges_of_strips
from tests.core.scenes import cameras_above

TWO_HALVES = plan_of(np.array([[-10.0, 0.0], [10.0, 0.0]]))


def oblique_camera(height_m: float = 30.0, tilt_deg: float = 60.0, shift: float = 0.0, size_px: int = 101) -> Cameras:
    """Above (0, 0) shifted, looking towards x and `tilt_deg` up from straight down."""
    tilt = np.radians(tilt_deg)
    forward = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    right = np.array([0.0, -1.0, 0.0])
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ [shift, shift, height_m]
    K = np.array([[100.0, 0, size_px / 2], [0, 100.0, size_px / 2], [0, 0, 1]])
    return Cameras(names=("oblique",), Ks=K[None], cam_from_world=pose[None], sizes_wh=[[size_px, size_px]])


def depth_of_ground(cameras: Cameras) -> np.ndarray:
    """Depth (H,W) of the plane z = 0, infinite above the horizon."""
    width, height = cameras.sizes_wh[0]
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([columns, rows, np.ones_like(columns)], 2) @ np.linalg.inv(cameras.Ks[0]).T @ cameras.cam_from_world[0, :3, :3]
    with np.errstate(divide="ignore"):
        depth = -cameras.centers[0, 2] / rays[..., 2]
    return np.where(depth > 0, depth, np.inf)


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_a_plane_counts_however_flatly_it_is_seen(shift: float) -> None:
    camera = oblique_camera(shift=shift, tilt_deg=62.0)
    plan = plan_of(np.array([[40.0, 0.0], [60.0, 0.0]]) + shift)
    (mask,) = seam_masks(camera, [depth_of_ground(camera)], plan, 3.0)
    assert (mask.labels >= -1).all()
    assert mask.band.any()
    assert mask.interior.any()


def test_the_edge_of_what_hides_the_ground_is_out() -> None:
    camera = oblique_camera()
    depth = depth_of_ground(camera)
    # A wall 15 m before the camera hides the left half; its depth mixes with the ground's in one
    # column.
    wall = np.minimum(depth, 15.0)
    depth[:, :50] = wall[:, :50]
    depth[:, 50] = (wall[:, 50] + depth[:, 50]) / 2
    (mask,) = seam_masks(camera, [depth], plan_of(np.array([[40.0, 0.0], [60.0, 0.0]])), 3.0)
    jump = depth_of_ground(camera)[:, 50] > 20
    assert (mask.labels[jump, 50] == -2).all()
    assert (mask.labels[:, 54:] >= -1).all()
    # The wall stands 13 m from the camera, so nothing of it belongs to the border at 50 m that it
    # hides.
    assert not mask.band[:, :48].any()


def test_nan_zero_and_missing_regions_leave_nothing() -> None:
    camera = camera_above(0, 50)
    for depth in (np.full((101, 101), np.nan), np.zeros((101, 101)), np.full((101, 101), -3.0)):
        masks = seam_masks(camera, [depth], TWO_HALVES, 5.0)
        assert (masks.masks[0].labels == -2).all()
        assert masks.borders == ()
    for plan in (plan_of(np.zeros((1, 2))), plan_of(np.array([[1e6, 0.0], [1.1e6, 0.0]]))):
        masks = seam_masks(camera, [np.full((101, 101), 50.0)], plan, 5.0)
        assert (masks.masks[0].labels == -1).all()
        error = band_and_interior_psnr_db([np.zeros((101, 101, 3))], [np.zeros((101, 101, 3))], masks)
        assert error.seam_psnr_db is None and "insufficient" in str(error.reason)


def test_a_pixel_belongs_to_the_nearest_border_of_both_levels() -> None:
    plan, edge_plans = two_edges_of_strips()
    cameras = cameras_above([(-50.0, 0.0)], height_m=100.0, size_wh=(120, 90))
    kinds = [EdgeBorders(plan=plan), DeviceBorders(plan=plan, edge_plans=edge_plans)]
    masks = seam_masks(cameras, [np.full((90, 120), 100.0)], kinds, 6.0)
    assert set(masks.borders) == {("edge-0", "edge-1"), ("edge-0-0", "edge-0-2")}
    labels = masks.masks[0].labels
    x, y = np.meshgrid((np.arange(120) + 0.5 - 60) / 1.08 - 50, -(np.arange(90) + 0.5 - 45) / 1.08)
    to_edge, to_device = np.abs(x), np.where(x < 0, np.abs(0.8 * x + 0.6 * y + 40), np.inf)
    expected = np.where(to_edge <= to_device, masks.borders.index(("edge-0", "edge-1")), masks.borders.index(("edge-0-0", "edge-0-2")))
    np.testing.assert_array_equal(labels, np.where(np.minimum(to_edge, to_device) <= 6.0, expected, -1))


def masks_and_photographs(num_images: int = 20) -> tuple[SeamMasks, list[np.ndarray]]:
    cameras = cameras_above([(float(x), 0.0) for x in np.linspace(-8, 8, num_images)], height_m=50.0, size_wh=(100, 80))
    sites = np.array([[-30.0, 0.0], [-2.0, 0.0], [30.0, 0.0]])
    masks = seam_masks(cameras, [np.full((80, 100), 50.0)] * num_images, plan_of(sites), 8.0)
    rng = np.random.default_rng(0)
    return masks, [rng.uniform(0.2, 0.8, (80, 100, 3)) for _ in range(num_images)]


def noisy(photographs: list[np.ndarray], masks: SeamMasks, sigma: float, factors: dict[int, float], seed: int) -> list[np.ndarray]:
    """Renders with an error of `sigma` per pixel times the factor of the border of its band."""
    rng = np.random.default_rng(seed)
    scale = [np.select([mask.labels == border for border in factors], list(factors.values()), 1.0) for mask in masks]
    return [photo + sigma * s[..., None] * rng.normal(size=photo.shape) for photo, s in zip(photographs, scale, strict=True)]


def gap_db(photographs: list[np.ndarray], masks: SeamMasks, sigma: float, factors: dict[int, float], seed: int) -> float:
    error = band_and_interior_psnr_db(noisy(photographs, masks, sigma, factors, seed), photographs, masks)
    assert error.seam_psnr_db is not None and error.interior_psnr_db is not None
    return error.seam_psnr_db - error.interior_psnr_db


def test_the_headline_finds_the_planted_error_of_the_borders() -> None:
    masks, photographs = masks_and_photographs()
    assert masks.borders == (("edge-0", "edge-1"), ("edge-1", "edge-2"))
    reference_db = gap_db(photographs, masks, 0.02, {0: 1.3, 1: 1.3}, 1)
    # The whole method is worse by 3 dB, which is no seam; both borders by 2 dB more, then one of
    # them alone.
    worse = 1.3 * 10 ** (2 / 20)
    # Sampling: √(2 / 60,000 values) of the error is 0.03 dB.
    assert gap_db(photographs, masks, 0.0283, {0: worse, 1: worse}, 3) - reference_db == pytest.approx(-2.0, abs=0.15)
    assert gap_db(photographs, masks, 0.0283, {0: 1.3, 1: 1.3}, 3) - reference_db == pytest.approx(0.0, abs=0.15)
    assert -2.0 < gap_db(photographs, masks, 0.0283, {0: 1.3, 1: worse}, 3) - reference_db < -0.3


def test_masks_shrink_to_the_used_pixels() -> None:
    masks, photographs = masks_and_photographs()
    used = np.zeros((80, 100), bool)
    used[:40] = True
    halved = masks.within([used] * 20)
    counted = [mask.labels >= -1 for mask in halved]
    assert np.sum(counted) == 20 * 4000
    assert band_and_interior_psnr_db(photographs, photographs, halved).seam_psnr_db == pytest.approx(100.0)
    assert masks.within([None] * 20).masks[0].band.sum() == masks.masks[0].band.sum()


def test_poison_is_bad_input() -> None:
    masks, photographs = masks_and_photographs()
    poisoned = [photo.copy() for photo in photographs]
    poisoned[3][10, 10, 1] = np.nan
    with pytest.raises(BadInput, match="not finite"):
        band_and_interior_psnr_db(poisoned, photographs, masks)
