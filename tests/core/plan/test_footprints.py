"""Footprints and shares against Monte Carlo and shapely, on poison and on impossible cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.plan.borders.footprints import (
    Optics,
    RegionShares,
    Views,
    common_areas_m2,
    ground_footprints,
    region_shares,
    signed_areas_m2,
    views_before_capture,
    views_of_cameras,
)
from radiant_core.plan.regions.power_diagram import cell_polygons, rectangle
from tests.core.scenes import cameras_above

from .instances import dense


def test_a_camera_straight_down_sees_a_rectangle() -> None:
    optics = Optics(field_of_view_deg=90, aspect=0.5)
    footprints = ground_footprints(views_before_capture([[10.0, 20.0]], [100.0], optics, [[0.0, -90.0]]))
    np.testing.assert_allclose(footprints.areas_m2, [200 * 100], rtol=1e-12)
    np.testing.assert_allclose(footprints.polygons[0].min(axis=0), [-90, -30])
    np.testing.assert_allclose(footprints.polygons[0].max(axis=0), [110, 70])


def test_footprints_are_the_ground_whose_rays_fall_into_the_image() -> None:
    """Monte Carlo: a spot is inside if it projects into the image and lies in the horizon's box."""
    rng = np.random.default_rng(1)
    optics = Optics(field_of_view_deg=60, aspect=0.75)
    for heading, pitch in ((0, -90), (30, -60), (200, -25), (310, 0), (90, 20)):
        made = ground_footprints(views_before_capture([[0.0, 0.0]], [50.0], optics, [[heading, pitch]]), horizon=4.0)
        spots = rng.uniform(-320, 320, (40_000, 2))
        h, p = np.radians([heading, pitch])
        forward = np.array([np.sin(h) * np.cos(p), np.cos(h) * np.cos(p), np.sin(p)])
        right = np.array([np.cos(h), -np.sin(h), 0])
        rays = np.column_stack([spots, np.full(len(spots), -50.0)])
        depth, x, y = rays @ forward, rays @ right, rays @ np.cross(right, forward)
        half = np.tan(np.radians(30))
        along, across = spots @ [np.sin(h), np.cos(h)], spots @ [np.cos(h), -np.sin(h)]
        near = (np.abs(along) <= 200) & (np.abs(across) <= 200)
        expected = (depth > 0) & (np.abs(x) <= half * depth) & (np.abs(y) <= 0.75 * half * depth) & near
        inside = shapely.contains_xy(shapely.Polygon(made.polygons[0]), *spots.T) if made.areas_m2[0] else np.zeros(len(spots), bool)
        assert (inside == expected).mean() > 0.9999, (heading, pitch)
        share = expected.mean()
        # Three standard deviations of a binomial count.
        assert abs(made.areas_m2[0] / 640**2 - share) <= 3 * np.sqrt(share * (1 - share) / 40_000) + 1e-12


def test_shares_equal_shapelys_areas_far_from_the_origin() -> None:
    rng = np.random.default_rng(2)
    offset = np.array([5e5, 4e6])
    positions = rng.random((300, 2)) * [500, 300] + offset
    angles = np.column_stack([rng.uniform(0, 360, 300), rng.uniform(-90, -20, 300)])
    made = ground_footprints(views_before_capture(positions, rng.uniform(20, 120, 300), Optics(), angles))
    outline = rectangle(offset, offset + np.array([500.0, 300.0]))
    cells = (*cell_polygons(rng.random((9, 2)) * [500, 300] + offset, rng.normal(scale=500, size=9), outline), np.zeros((0, 2)))
    shares = dense(region_shares(made, cells))
    polygons = [shapely.Polygon(polygon - offset) for polygon in made.polygons]
    for column, cell in enumerate(cells):
        region = shapely.Polygon(cell - offset) if len(cell) else shapely.Polygon()
        expected = [polygon.intersection(region).area / polygon.area for polygon in polygons]
        np.testing.assert_allclose(shares[:, column], expected, atol=1e-9)
    assert (shares.sum(axis=1) <= 1 + 1e-9).all()


def test_nothing_is_seen_from_below_the_ground_or_into_the_sky() -> None:
    views = views_before_capture(np.zeros((3, 2)), [-1.0, 0.0, 10.0], Optics(), [[0, -90], [0, -90], [0, 90]])
    made = ground_footprints(views)
    np.testing.assert_array_equal(made.areas_m2, 0)
    assert not len(region_shares(made, [rectangle(np.array([-9.0, -9]), np.array([9.0, 9]))]).shares)


def test_unknown_angles_are_down_and_along_the_flight() -> None:
    views = views_before_capture([[0, 0], [10, 0], [10, 10]], [30, 30, 30], Optics(), np.full((3, 2), np.nan))
    told = views_before_capture([[0, 0], [10, 0], [10, 10]], [30, 30, 30], Optics(), [[90, -90], [0, -90], [0, -90]])
    np.testing.assert_allclose(views.corner_rays, told.corner_rays, atol=1e-12)


def test_poison_is_refused() -> None:
    with pytest.raises(BadInput, match="field of view is 180"):
        Optics(field_of_view_deg=180)
    with pytest.raises(BadInput, match=r"^positions .*not finite"):
        Views(positions=np.array([[0, np.nan]]), heights_m=np.ones(1), corner_rays=np.ones((1, 4, 3)))
    with pytest.raises(BadInput, match="not finite"):
        views_before_capture([[0, np.nan]], [1.0], Optics())
    with pytest.raises(BadInput, match="not finite"):
        views_before_capture([[0, 0]], [np.inf], Optics())
    with pytest.raises(BadInput, match="pitch −90"):
        views_before_capture([[0, 0]], [1.0], Optics(), [[0, 91]])
    with pytest.raises(BadInput, match="without a direction"):
        Views(positions=np.zeros((1, 2)), heights_m=np.ones(1), corner_rays=np.zeros((1, 4, 3)))
    made = ground_footprints(views_before_capture([[0, 0]], [1.0], Optics()))
    with pytest.raises(BadInput, match="no region"):
        region_shares(made, [])
    for horizon in (0.0, np.nan, np.inf):
        with pytest.raises(BadInput, match="horizon"):
            ground_footprints(views_before_capture([[0, 0]], [1.0], Optics()), horizon)
    with pytest.raises(BadInput, match="above 0"):
        RegionShares(images=np.array([0]), regions=np.array([0]), shares=np.array([np.nextafter(1, 2)]), num_images=1, num_regions=1)


def test_huge_and_empty_inputs() -> None:
    none = ground_footprints(views_before_capture(np.zeros((0, 2)), [], Optics()))
    square = rectangle(np.zeros(2), np.ones(2))
    assert dense(region_shares(none, [square])).shape == (0, 1)
    far = ground_footprints(views_before_capture([[1e8, -1e8]], [1e5], Optics()))
    inside = region_shares(far, [rectangle(np.array([0.0, -2e8]), np.array([2e8, 0.0]))])
    np.testing.assert_allclose(inside.shares, 1.0)


@pytest.mark.parametrize("heading", [0.0, 30.0])
def test_a_wide_view_straight_down_ends_at_the_horizon_on_all_sides(heading: float) -> None:
    # tan 75° = 3.7 heights, the horizon is at 2.
    made = ground_footprints(
        views_before_capture([[0.0, 0.0]], [10.0], Optics(field_of_view_deg=150, aspect=1.0), [[heading, -90.0]]), horizon=2.0
    )
    inside = shapely.Polygon(made.polygons[0])
    if not heading:
        np.testing.assert_allclose(inside.bounds, [-20, -20, 20, 20], atol=1e-9)
    assert made.areas_m2[0] == pytest.approx(inside.area) == pytest.approx(40 * 40)


def test_posed_cameras_see_what_their_pixels_see() -> None:
    """From 6 m with a focal length of 0.9 widths: 1/0.9 of the height wide, in the frame's own
    place, and higher ground is nearer."""
    cameras = cameras_above([(1.0, -2.0), (3.0, 4.0)], height_m=6.0, size_wh=(48, 36))
    for ground_m, height_m in ((0.0, 6.0), (-3.0, 9.0)):
        made = ground_footprints(views_of_cameras(cameras, ground_m))
        width_m, length_m = height_m / 0.9, height_m / 0.9 * 36 / 48
        np.testing.assert_allclose(made.areas_m2, [width_m * length_m] * 2)
        for polygon, (x, y) in zip(made.polygons, [(1.0, -2.0), (3.0, 4.0)], strict=True):
            np.testing.assert_allclose(
                [polygon.min(axis=0), polygon.max(axis=0)], np.add([x, y], np.outer([-0.5, 0.5], [width_m, length_m]))
            )
    above = replace(cameras, cam_from_world=np.array([pose @ moved(np.array([0, 0, 7.0])) for pose in cameras.cam_from_world]))
    assert not ground_footprints(views_of_cameras(above, 0.0)).areas_m2.any(), "below the ground"


def moved(step: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = step
    return pose


SQUARE = np.array([[0.0, 0.0], [1, 0], [1, 1], [0, 1]])


def of_corners(corners: np.ndarray) -> np.ndarray:
    """A footprint (8,2) of a convex polygon, its last corner repeated."""
    return corners[np.minimum(np.arange(8), len(corners) - 1)]


@pytest.mark.parametrize(
    ("polygon", "area"),
    [
        ([[-5, -5], [5, -5], [5, 5]], 0.5),  # its side goes through two corners of the square
        ([[0, 0], [1, 0], [1, 1], [0, 1]], 1.0),
        ([[0, 0], [1, 0], [1, 1]], 0.5),
        ([[1, 0], [2, 0], [2, 1], [1, 1]], 0.0),
        ([[1, 1], [2, 1], [2, 2], [1, 2]], 0.0),
        ([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]], 0.25),
        ([[0.5, -1], [2, 0.5], [0.5, 2], [-1, 0.5]], 1.0),
        ([[0.5, -0.25], [1.25, 0.5], [0.5, 1.25], [-0.25, 0.5]], 0.875),
        ([[0, 0], [2, 0], [0, 2]], 1.0),
        ([[0, 0], [1.5, 0], [0, 1.5]], 0.875),
        ([[-1, 0.5], [2, 0.5], [2, 3], [-1, 3]], 0.5),
    ],
)
def test_what_two_polygons_share_where_sides_and_corners_meet(polygon: list, area: float) -> None:
    other = np.array(polygon, float)
    for turned in (of_corners(SQUARE), of_corners(np.roll(SQUARE, 1, axis=0))):
        for start in range(len(other)):
            assert common_areas_m2(turned[None], np.roll(other, start, axis=0)) == pytest.approx([area], abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_polygons_of_many_corners_share_what_shapely_says(seed: int) -> None:
    """Regions of up to 12 sides cut footprints of up to 8 corners: more corners than either has,
    and half of one ends in the other."""
    rng = np.random.default_rng(seed)

    def convex(count: int, radius: float) -> np.ndarray:
        angles = np.sort(rng.uniform(0, 2 * np.pi, count))
        return rng.uniform(-1, 1, 2) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    footprints = np.array([of_corners(convex(int(rng.integers(3, 9)), rng.uniform(0.3, 3))) for _ in range(40)])
    for count in (3, 5, 12):
        region = convex(count, 1.5)
        truth = [shapely.Polygon(f).intersection(shapely.Polygon(region)).area for f in footprints]
        np.testing.assert_allclose(common_areas_m2(footprints, region), truth, atol=1e-12)
        moved = common_areas_m2(footprints + 1e6, region + 1e6)
        np.testing.assert_allclose(moved, truth, atol=1e-8)


def test_areas_are_signed_by_the_way_round() -> None:
    np.testing.assert_allclose(signed_areas_m2(np.array([SQUARE, SQUARE[::-1], 3 * SQUARE])), [1, -1, 9])


@pytest.mark.parametrize("horizon", [0.25, 0.5, 1.0, 3.0])
def test_a_level_view_ends_at_the_horizon_and_a_narrow_one_is_not_cut(horizon: float) -> None:
    """Looking level to the north with 90° across and 90° up: the ground from one height away on, as
    far as the horizon lets."""
    level = views_before_capture([[0.0, 0.0]], [10.0], Optics(field_of_view_deg=90, aspect=1.0), [[0.0, 0.0]])
    footprint = ground_footprints(level, horizon)
    far = 10 * horizon
    # Between the lower edge of the picture, 10 m away, and the horizon; as wide to either side as
    # it is away, to the horizon at most.
    area = 0.0 if horizon <= 1 else (far**2 - 10.0**2)
    assert footprint.areas_m2[0] == pytest.approx(area, abs=1e-9)
    down = views_before_capture([[0.0, 0.0]], [10.0], Optics(field_of_view_deg=2 * np.degrees(np.arctan(0.2)), aspect=1.0), [[0.0, -90.0]])
    assert ground_footprints(down, horizon).areas_m2[0] == pytest.approx(16.0)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(BadInput, match=f"the horizon is {wrong} heights away, expected a positive number"):
            ground_footprints(down, wrong)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"images": [2, 0]}, "images of shares run from 0 to 2, expected 0 to 1"),
        ({"images": [-1, 0]}, "images of shares run from -1 to 0, expected 0 to 1"),
        ({"regions": [0, 3]}, "regions of shares run from 0 to 3, expected 0 to 2"),
        ({"shares": [0.0, 1.0]}, r"shares run from 0\.0 to 1\.0, expected above 0 and at most 1"),
        ({"shares": [0.5, 1.001]}, r"shares run from 0\.5 to 1\.001"),
        ({"images": [1, 0], "regions": [1, 1]}, "shares must come by region, then image, each pair once: sort them"),
        ({"images": [1, 1], "regions": [1, 1]}, "each pair once"),
        ({"images": [0, 1], "regions": [2, 1]}, "by region, then image"),
        ({"images": [0, 1], "regions": [1, 1], "shares": [1.0, 1e-300]}, None),
        ({"images": [], "regions": [], "shares": []}, None),
    ],
)
def test_limits_of_shares(change: dict, told: str | None) -> None:
    fields = {"images": [1, 0], "regions": [0, 2], "shares": [0.5, 0.25], "num_images": 2, "num_regions": 3, **change}
    if told is None:
        RegionShares(**fields)
    else:
        with pytest.raises(BadInput, match=told):
            RegionShares(**fields)


def test_a_sparse_matrix_of_shares_is_the_dense_one() -> None:
    shares = RegionShares(images=[1, 0, 1], regions=[0, 2, 2], shares=[0.5, 0.25, 1.0], num_images=2, num_regions=3)  # type: ignore[arg-type]
    np.testing.assert_array_equal(dense(shares), [[0, 0, 0.25], [0.5, 0, 1]])
    for region, (images, values) in enumerate((([1], [0.5]), ([], []), ([0, 1], [0.25, 1.0]))):
        found = shares.of_region(region)
        assert (found[0].tolist(), found[1].tolist()) == (images, values)


@pytest.mark.parametrize("angles", [[[0.0, -90.1]], [[0.0, 90.1]], [[np.inf, 0.0]], [[0.0, 0.0], [0.0, 0.0]], [[0.0]]])
def test_angles_that_are_none_are_refused(angles: list) -> None:
    with pytest.raises(BadInput, match="headings and pitches need two angles per position in degrees"):
        views_before_capture([[0.0, 0.0]], [1.0], Optics(), angles)
    for pitch in (-90.0, 90.0):
        assert len(views_before_capture([[0.0, 0.0]], [1.0], Optics(), [[0.0, pitch]])) == 1


def test_an_unknown_heading_is_the_way_to_the_next_position_and_of_the_last_from_the_one_before() -> None:
    positions = [[0.0, 0.0], [5.0, 0.0], [5.0, -3.0], [5.0, -3.0]]
    views = views_before_capture(positions, np.ones(4), Optics(field_of_view_deg=90, aspect=1.0), np.tile([np.nan, -45.0], (4, 1)))
    forward = views.corner_rays.sum(axis=1)[:, :2]
    np.testing.assert_allclose(forward / np.linalg.norm(forward, axis=1, keepdims=True), [[1, 0], [0, -1], [0, 1], [0, 1]], atol=1e-12)
    alone = views_before_capture(positions[:1], [1.0], Optics(), [[np.nan, -45.0]]).corner_rays.sum(axis=1)[0, :2]
    assert alone[0] == pytest.approx(0, abs=1e-12) and alone[1] > 0


@pytest.mark.parametrize(("height_m", "area"), [(0.5, 1.0), (1e-3, 4e-6), (0.0, 0.0), (-0.5, 0.0)])
def test_a_camera_sees_ground_from_however_low(height_m: float, area: float) -> None:
    down = views_before_capture([[0.0, 0.0]], [height_m], Optics(field_of_view_deg=90, aspect=1.0), [[0.0, -90.0]])
    assert ground_footprints(down).areas_m2[0] == pytest.approx(area)
