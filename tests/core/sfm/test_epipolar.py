"""Known poses verify matches: what lies on its epipolar line is kept, and triangulates as before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap import quick_database
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.epipolar import MAX_EPIPOLAR_PX, MIN_MATCHES, epipolar_errors, verify_by_poses
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.known_poses import pinhole_photographs, scene_from_poses

FOCAL_PX = 800.0
VERIFIED = pycolmap.TwoViewGeometryConfiguration.CALIBRATED


def motion(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    relative = np.eye(4)
    relative[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix()
    relative[:3, 3] = rng.normal(0, 1, 3)
    return relative


def seen(relative: FloatArray, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Rays (N,3) of points in front of both photographs."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-4, 4, (count, 2)), rng.uniform(6, 14, count)])
    moved = points @ relative[:3, :3].T + relative[:3, 3]
    return points / points[:, 2:], moved / moved[:, 2:]


def lines(relative: FloatArray, first: FloatArray) -> FloatArray:
    """Directions (N,2) at right angles to the epipolar lines in the second photograph, the slow
    way: from where two points of each ray are seen."""
    near, far = (depth * first @ relative[:3, :3].T + relative[:3, 3] for depth in (6.0, 14.0))
    along = (near / near[:, 2:] - far / far[:, 2:])[:, :2]
    return np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(4))
def test_matches_off_their_lines_go_and_those_moved_along_them_stay(seed: int) -> None:
    relative = motion(seed)
    first, second = seen(relative, 60, seed)
    matches = np.column_stack([np.arange(60), np.arange(60)[::-1]]).astype(np.uint32)
    off = second.copy()
    # Sampson's distance of a point off by d is between d/√2 and d where both lines weigh alike, so
    # 12 px are surely too many and 2 px never.
    off[:, :2] += lines(relative, first) * np.where(np.arange(60) < 20, 12.0, 2.0)[:, None] / FOCAL_PX
    geometry = verify_by_poses(relative, (first, off), matches, FOCAL_PX)
    assert geometry is not None and geometry.config == VERIFIED
    errors = epipolar_errors(relative, first, off) * FOCAL_PX
    np.testing.assert_array_equal(geometry.inlier_matches, matches[errors <= MAX_EPIPOLAR_PX])
    assert set(geometry.inlier_matches[:, 0].tolist()) >= set(range(20, 60))
    assert not set(geometry.inlier_matches[:, 0].tolist()) & set(np.flatnonzero(errors > MAX_EPIPOLAR_PX).tolist())
    assert (errors[:20] > MAX_EPIPOLAR_PX).mean() > 0.7


def test_few_matches_verify_nothing_and_poison_is_no_match() -> None:
    relative = motion(1)
    first, second = seen(relative, 40, 1)
    matches = np.column_stack([np.arange(40), np.arange(40)]).astype(np.uint32)
    for count, verified in ((0, 0), (MIN_MATCHES - 1, 0), (MIN_MATCHES, MIN_MATCHES)):
        geometry = verify_by_poses(relative, (first[:count], second[:count]), matches[:count], FOCAL_PX)
        assert geometry is not None and len(geometry.inlier_matches) == verified
        assert (geometry.config == VERIFIED) == (verified > 0)
    second[3], first[5] = np.nan, np.inf
    geometry = verify_by_poses(relative, (first, second), matches, FOCAL_PX)
    assert geometry is not None and set(range(40)) - set(geometry.inlier_matches[:, 0].tolist()) == {3, 5}


def test_photographs_from_one_place_have_no_lines() -> None:
    turned = motion(2)
    turned[:3, 3] = 0
    first, second = seen(turned, 30, 2)
    assert verify_by_poses(turned, (first, second), np.zeros((30, 2), np.uint32), FOCAL_PX) is None


def test_known_poses_find_the_points_that_ransac_finds(hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras, photos = pinhole_photographs(hamlet / "known", hamlet / "images", tmp_path / "pinhole", 1, lambda _: None)
    config = SfmConfig(max_image_size_px=640, max_num_features=1500, num_threads=1)
    searched: list[object] = []
    estimate = pycolmap.estimate_two_view_geometry
    monkeypatch.setattr(pycolmap, "estimate_two_view_geometry", lambda *args: searched.append(args) or estimate(*args))
    found = scene_from_poses(cameras, photos, tmp_path / "known", config, lambda _: None)
    assert not searched, "the poses say which matches are right"
    monkeypatch.setattr(quick_database, "verify_by_poses", lambda *args: None)
    by_ransac = scene_from_poses(cameras, photos, tmp_path / "ransac", config, lambda _: None)
    assert searched
    # Both keep what COLMAP calls verified, RANSAC for an E that was fitted to the matches.
    assert len(found.points) > 0.97 * len(by_ransac.points) and len(found.observations) > 0.97 * len(by_ransac.observations)
    assert found.cameras.names == by_ransac.cameras.names
    known, ransac = (pycolmap.Reconstruction(tmp_path / kind / "sparse") for kind in ("known", "ransac"))
    for model in (known, ransac):
        model.update_point_3d_errors()  # pycolmap averages the errors in the file without projecting a point
    assert known.compute_mean_reprojection_error() < 1.1 * ransac.compute_mean_reprojection_error()
