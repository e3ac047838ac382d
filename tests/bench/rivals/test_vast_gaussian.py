"""VastGaussian: its cells against counts and brute force, its crop, and its pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.rivals.box_coverage import box_coverage
from benchmarks.rivals.vast_gaussian import VastGaussianConfig, crop_cells, scene_of_cell, vast_cells, vast_gaussian
from benchmarks.training_pixels import training_pixels
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train import view_loss
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

NUM_TRIED = 20_000


def looking(centers: FloatArray, rotations: Rotation, size_wh: tuple[int, int] = (64, 48)) -> Cameras:
    """Cameras at `centers` (C,3) whose rows of axes are those of `rotations`."""
    poses = np.tile(np.eye(4), (len(centers), 1, 1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = -np.einsum("cij,cj->ci", poses[:, :3, :3], centers)
    width, height = size_wh
    K = [[0.8 * width, 0, 0.45 * width], [0, 0.8 * width, 0.5 * height], [0, 0, 1]]
    names = tuple(str(index) for index in range(len(centers)))
    return Cameras(names=names, Ks=[K] * len(centers), cam_from_world=poses, sizes_wh=[size_wh] * len(centers))


def share_of_rays(cameras: Cameras, index: int, low: FloatArray, high: FloatArray, rng: np.random.Generator) -> float:
    """Share of random pixels whose ray meets the box before the camera (slabs); no hulls in it."""
    pixels = rng.random((NUM_TRIED, 2)) * cameras.sizes_wh[index]
    rays = np.column_stack([pixels, np.ones(NUM_TRIED)]) @ np.linalg.inv(cameras.Ks[index]).T @ cameras.cam_from_world[index, :3, :3]
    ends = (np.stack([low, high])[:, None] - cameras.centers[index]) / rays
    enters, leaves = ends.min(0).max(1), ends.max(0).min(1)
    return float((leaves > np.maximum(enters, 0)).mean())


def ground_scene(columns: int = 6, rows: int = 5, *, seed: int = 0) -> SfmScene:
    """Cameras in an uneven grid 6 m above 2,000 points of uneven ground of 16 × 12 m."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-6, 6, columns), np.linspace(-4, 4, rows))
    xy = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.5, 0.5, (columns * rows, 2))
    cameras = cameras_above([(float(x), float(y)) for x, y in xy])
    points = np.column_stack([rng.uniform(-8, 8, 2000), rng.uniform(-6, 6, 2000), rng.uniform(0, 1.5, 2000)])
    sees = np.stack([cameras.select([index]).any_sees(points) for index in range(len(cameras))], axis=1)
    return SfmScene(
        cameras=cameras,
        points=points,
        colors=np.full((2000, 3), 128, np.uint8),
        observations=np.argwhere(sees),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )


class TestBoxCoverage:
    def test_it_is_the_share_of_rays_that_meet_the_box(self) -> None:
        rng = np.random.default_rng(1)
        low, high = np.array([-3.0, -2.0, 0.0]), np.array([4.0, 2.5, 3.0])
        # Far off, near by, inside, with corners behind the camera, and turned away: at random
        # places in and about the box.
        cameras = looking(rng.uniform([-7, -6, -3], [8, 7, 6], (80, 3)), Rotation.random(80, rng=rng))
        shares = box_coverage(cameras, low, high)
        expected = np.array([share_of_rays(cameras, index, low, high, rng) for index in range(80)])
        # 20,000 rays: a standard error of at most 0.0036, of which four are allowed.
        np.testing.assert_allclose(shares, expected, atol=0.0145)
        assert (expected == 0).sum() >= 5 and ((expected > 0.05) & (expected < 0.95)).sum() >= 10

    def test_a_camera_inside_sees_nothing_else_and_one_turned_away_sees_nothing(self) -> None:
        inside = looking(np.array([[0.5, 0.5, 0.5]]), Rotation.random(1, rng=np.random.default_rng(0)))
        assert box_coverage(inside, [0, 0, 0], [1, 1, 1]) == pytest.approx([1.0], abs=1e-9)
        above = cameras_above([(0.0, 0.0)])
        assert box_coverage(above, [-1, -1, 7], [1, 1, 9]) == [0.0]

    def test_a_frontal_square_has_the_area_of_the_pinhole_formula(self) -> None:
        # 0.9 · 48 px · 2 m / 6 m wide: (14.4 px)² of 48 × 36 px, the top of the box at z = 0 being
        # nearest.
        assert box_coverage(cameras_above([(0.0, 0.0)]), [-1, -1, -5], [1, 1, 0]) == pytest.approx([14.4**2 / (48 * 36)], rel=1e-12)

    def test_places_of_an_utm_grid_change_nothing(self) -> None:
        offset = np.array([5e5, 5.4e6, 300.0])
        near = looking(np.array([[8.0, 1, 4]]), Rotation.from_euler("y", 110, degrees=True))
        far = looking(near.centers + offset, Rotation.from_matrix(near.cam_from_world[:, :3, :3]))
        low, high = np.array([-3.0, -2, 0]), np.array([4.0, 2.5, 3])
        # float64 keeps 1e-9 m at 5.4e6 m.
        np.testing.assert_allclose(box_coverage(far, low + offset, high + offset), box_coverage(near, low, high), atol=1e-7)
        assert 0.05 < box_coverage(near, low, high)[0] < 0.95

    def test_boxes_that_are_none_are_refused_or_cover_nothing(self) -> None:
        cameras = cameras_above([(0.0, 0.0)])
        assert box_coverage(cameras, [0, 0, 0], [0, 0, 0]) == [0.0]
        assert not len(box_coverage(cameras.select([]), [0, 0, 0], [1, 1, 1]))
        with pytest.raises(BadInput, match="before it begins"):
            box_coverage(cameras, [0, 0, 1], [1, 1, 0])
        with pytest.raises(BadInput, match="high has 1 values that are not finite"):
            box_coverage(cameras, [0, 0, 0], [1, 1, np.inf])


class TestCells:
    scene = ground_scene()

    @pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 2), (3, 3), (1, 5), (30, 1)])
    def test_every_camera_has_one_group_and_groups_are_even(self, m: int, n: int) -> None:
        cells = vast_cells(self.scene, m, n)
        own = np.concatenate([cell.own_cameras for cell in cells])
        assert len(cells) == m * n and sorted(own) == list(range(len(self.scene.cameras)))
        assert all(np.isin(cell.own_cameras, cell.cameras).all() for cell in cells)
        columns = [sum(len(cell.own_cameras) for cell in cells if cell.column == column) for column in range(m)]
        assert np.ptp(columns) <= 1
        assert all(np.ptp([len(cell.own_cameras) for cell in cells if cell.column == column]) <= 1 for column in range(m))

    def test_each_place_has_one_owner(self) -> None:
        cells = vast_cells(self.scene, 3, 2)
        borders = np.array([[*cell.bounds[0], 0.0] for cell in cells])
        places = np.concatenate([np.random.default_rng(0).normal(0, 30, (5000, 3)), borders])
        np.testing.assert_array_equal(np.sum([cell.owns(places) for cell in cells], axis=0), 1)

    def test_selection_follows_the_three_rules(self) -> None:
        config = VastGaussianConfig()
        rng = np.random.default_rng(2)
        added = 0
        for cell in vast_cells(self.scene, 3, 2, config):
            side = cell.bounds[1] - cell.bounds[0]
            low, high = cell.bounds[0] - 0.2 * side, cell.bounds[1] + 0.2 * side

            def near(places: FloatArray, low: FloatArray = low, high: FloatArray = high) -> Any:
                return ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1)

            inside = near(self.scene.cameras.centers)
            # Points fill the heights 0 to 1.5 m evenly, so the quantiles lie at 1 % of that.
            corners = np.array([*cell.bounds[0], 0.015]), np.array([*cell.bounds[1], 1.485])
            shares = np.array([share_of_rays(self.scene.cameras, index, *corners, rng) for index in range(len(inside))])
            sure = inside | (np.abs(shares - config.min_coverage) > 0.02)
            chosen = np.isin(np.arange(len(inside)), cell.cameras)
            np.testing.assert_array_equal(chosen[sure], (inside | (shares >= config.min_coverage))[sure])
            added += int((chosen & ~inside).sum())
            seen = np.zeros(len(self.scene.points), bool)
            seen[self.scene.observations[np.isin(self.scene.observations[:, 1], cell.cameras), 0]] = True
            np.testing.assert_array_equal(cell.points, np.flatnonzero(seen | near(self.scene.points)))
        assert added > 5, "no camera was added for what it sees, so that rule was not tried"

    def test_a_wrong_point_high_up_changes_no_selection(self) -> None:
        # As many as are allowed to be wrong: 5 of 2,000.
        points = self.scene.points.copy()
        points[::400, 2] = 1e4
        cells, wrong = vast_cells(self.scene, 3, 2), vast_cells(replace(self.scene, points=points), 3, 2)
        sizes = [(len(a.cameras), len(b.cameras)) for a, b in zip(cells, wrong, strict=True)]
        assert all(abs(a - b) <= 1 for a, b in sizes), sizes

    def test_the_scene_of_a_cell_keeps_who_sees_what(self) -> None:
        cell = vast_cells(self.scene, 3, 2)[1]
        part = scene_of_cell(self.scene, cell)
        assert part.cameras.names == tuple(self.scene.cameras.names[index] for index in cell.cameras)
        point, camera = part.observations.T
        original = {tuple(pair) for pair in self.scene.observations}
        mapped = set(zip(cell.points[point].tolist(), cell.cameras[camera].tolist(), strict=True))
        assert mapped == {pair for pair in original if pair[1] in set(cell.cameras)}

    def test_cameras_on_one_spot_still_have_a_cell_each(self) -> None:
        scene = ground_scene(2, 2)
        stacked = replace(scene.cameras, cam_from_world=np.tile(scene.cameras.cam_from_world[:1], (4, 1, 1)))
        cells = vast_cells(replace(scene, cameras=stacked), 2, 2)
        assert [len(cell.own_cameras) for cell in cells] == [1] * 4
        places = np.random.default_rng(0).normal(0, 5, (500, 3))
        np.testing.assert_array_equal(np.sum([cell.owns(places) for cell in cells], axis=0), 1)

    @pytest.mark.parametrize(("m", "n"), [(0, 2), (2, -1), (6, 6)])
    def test_grids_without_cameras_are_refused(self, m: int, n: int) -> None:
        with pytest.raises(BadInput, match="a camera per cell"):
            vast_cells(self.scene, m, n)

    def test_a_scene_without_points_and_numbers_out_of_range_are_refused(self) -> None:
        empty = replace(self.scene, points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8), observations=np.zeros((0, 2), np.int64))
        with pytest.raises(BadInput, match="no points"):
            vast_cells(empty, 2, 2)
        for poison in ({"widen": np.nan}, {"min_coverage": 0.0}, {"height_quantile": 0.5}, {"widen": -0.1}):
            with pytest.raises(BadInput, match="VastGaussian was given"):
                VastGaussianConfig(**poison)


class TestJoin:
    def test_every_gaussian_lies_in_the_cell_of_its_model(self) -> None:
        scene = ground_scene()
        opacity_of: list[float] = []

        def train(part: SfmScene, seed: int) -> Any:
            opacity_of.append(float(len(opacity_of)))
            model = ground_splats(500, seed=seed + len(opacity_of), half_side_m=9.0)
            return replace(model, logit_opacities=np.full(500, opacity_of[-1]))

        result = vast_gaussian(scene, 3, 2, train, seed=4)
        assert len(result.models) == 6 and len(result.splats) > 0
        for index, cell in enumerate(result.cells):
            mine = result.splats.logit_opacities == index
            assert mine.any() and cell.owns(result.splats.means[mine]).all()
            assert mine.sum() == cell.owns(result.models[index].means).sum()

    def test_copies_of_one_model_join_into_that_model(self) -> None:
        model, cells = ground_splats(), vast_cells(ground_scene(), 3, 2)
        joined = crop_cells([model] * 6, cells)
        assert len(joined) == len(model)
        np.testing.assert_array_equal(np.sort(joined.means[:, 0]), np.sort(model.means[:, 0]))

    def test_missing_and_empty_models_are_refused(self) -> None:
        cells = vast_cells(ground_scene(), 2, 1)
        with pytest.raises(BadInput, match="1 models for 2 cells"):
            crop_cells([ground_splats(10)], cells)
        with pytest.raises(BadInput, match="cell 1, 0 has no Gaussians"):
            crop_cells([ground_splats(10), ground_splats(10).select(np.zeros(10, bool))], cells)


class TestTrainingPixels:
    @pytest.mark.parametrize(("start_scale", "full_size_from"), [(1.0, 0.4), (0.5, 0.4), (0.3, 0.0), (0.5, 1.0)])
    def test_they_are_those_that_the_trainer_renders(
        self, start_scale: float, full_size_from: float, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        one, other = cameras_above([(-1, 0), (0, 1)]), cameras_above([(1, 0)], size_wh=(30, 41))
        cameras = Cameras(
            names=(*one.names, *other.names),
            Ks=np.concatenate([one.Ks, other.Ks]),
            cam_from_world=np.concatenate([one.cam_from_world, other.cam_from_world]),
            sizes_wh=np.concatenate([one.sizes_wh, other.sizes_wh]),
        )
        images = tuple(np.full((height, width, 3), 99, np.uint8) for width, height in cameras.sizes_wh)
        config = replace(
            train_preset("draft"), num_steps=23, start_scale=start_scale, full_size_from=full_size_from, density=NoDensification()
        )
        rendered: list[int] = []
        rasterize: Callable[..., Any] = view_loss.rasterize

        def counting(splats: Any, viewmats: Any, Ks: Any, width: int, height: int, **options: Any) -> Any:
            rendered.append(width * height)
            return rasterize(splats, viewmats, Ks, width, height, **options)

        monkeypatch.setattr(view_loss, "rasterize", counting)
        fit_splats(ground_splats(50), TrainingViews(cameras=cameras, images=images), config, FitOptions())
        assert training_pixels(cameras, config, 23) == sum(rendered) and len(rendered) == 23

    def test_a_budget_of_time_is_refused(self) -> None:
        with pytest.raises(BadInput, match="ends by time"):
            training_pixels(cameras_above([(0, 0)]), replace(train_preset("draft"), budget_s=1.0), 5)
