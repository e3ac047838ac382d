"""Tiles of an orthophoto against plain orthographic splatting in float64, their seams, their place, and a GeoTIFF as GDAL reads it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput, CannotWrite
from radiant_core.export.geotiff import TiledRaster, cut_tiles, save_tiles
from radiant_core.frames import Frame
from radiant_core.geometry.support import Support
from radiant_core.splats import SH_C0, Splats
from radiant_core.survey.map_grid import MapGrid, grid_over, map_frame_of
from radiant_core.survey.orthophoto import SeenSplats, _render, from_above, ortho_camera, ortho_tiles, render_tile
from tests.core.scenes import cameras_above, ground_splats

ALPS = Frame(kind="metric", origin_lat_lon_alt=np.array([47.3, 8.54, 410.0]))
NOWHERE = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))


def hilly_splats(count: int, seed: int = 0) -> Splats:
    """Long, flat and turned Gaussians at heights of −20 to 60 m, 8 m to each side, half of them faint."""
    rng = np.random.default_rng(seed)
    base = ground_splats(count, seed=seed, half_side_m=8.0)
    means = np.column_stack([base.means[:, :2], rng.uniform(-20, 60, count)])
    quats, scales = rng.normal(size=(count, 4)), rng.uniform(np.log(0.1), np.log(1.5), (count, 3))
    return replace(base, means=means, quats=quats, log_scales=scales, logit_opacities=rng.normal(0, 2, count))


def all_seen(splats: Splats) -> SeenSplats:
    count = len(splats)
    return SeenSplats(splats=splats, num_views=np.full(count, 7), constrained=np.ones(count, bool))


def plain_orthographic(splats: Splats, grid: MapGrid) -> tuple[np.ndarray, np.ndarray]:
    """Colours (H,W,3) times alpha and alpha (H,W): the contract's equations with u = x / cell, cell after cell, in float64."""
    down = np.array([[1.0, 0, 0], [0, -1, 0]]) / grid.cell
    corner = down @ np.append(grid.north_west, 0.0)
    means = splats.means.astype(np.float64)
    axes = (
        Rotation.from_quat(splats.quats[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix()
        * np.exp(splats.log_scales.astype(np.float64))[:, None]
    )
    half = down @ axes
    covariances = half @ half.transpose(0, 2, 1) + 0.3 * np.eye(2)
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    colors = np.maximum(0, 0.5 + SH_C0 * splats.sh0[:, 0].astype(np.float64))
    y, x = np.mgrid[: grid.rows, : grid.columns] + 0.5
    pixels = np.stack([x, y], axis=-1)
    image, left = np.zeros((*grid.shape, 3)), np.ones(grid.shape)
    stopped = np.zeros(grid.shape, bool)
    for index in np.argsort(-means[:, 2], kind="stable"):
        away = pixels - (down @ means[index] - corner)
        alpha = np.minimum(
            0.999, opacities[index] * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", away, np.linalg.inv(covariances[index]), away))
        )
        alpha[alpha < 1 / 255] = 0
        stopped |= (alpha > 0) & (left * (1 - alpha) <= 1e-4)
        alpha[stopped] = 0
        image += (left * alpha)[..., None] * colors[index]
        left *= 1 - alpha
    return image, 1 - left


@pytest.mark.parametrize("cell", [0.02, 0.25])
def test_a_tile_is_plain_orthographic_splatting(cell: float) -> None:
    splats = hilly_splats(120)
    grid = MapGrid(north_west=np.array([-2.0, 3.0]), cell=cell, rows=40, columns=56, epsg=None)
    ours, alpha = _render(splats, ortho_camera(grid, map_frame_of(NOWHERE), 0.0, (0, 0), grid.shape))
    image, plain_alpha = plain_orthographic(splats, grid)
    # α near its threshold of 1/255 may fall to either side of it in float32.
    assert np.quantile(np.abs(ours - image), 0.999) < 1e-4 and np.abs(ours - image).max() < 1.5 / 255
    assert np.abs(alpha - plain_alpha).max() < 1.5 / 255


@pytest.mark.parametrize("tile_px", [16, 48])
@pytest.mark.parametrize("frame", [ALPS, NOWHERE])
def test_tiles_of_any_size_meet_without_a_seam(tile_px: int, frame: Frame) -> None:
    seen, map_frame = all_seen(hilly_splats(400)), map_frame_of(frame)
    middle = map_frame.from_world(np.zeros((1, 3)))[0]
    grid = grid_over(middle - 4.8, middle + 4.8, 0.1, map_frame)
    whole, _ = _render(seen.splats, ortho_camera(grid, map_frame, 20.0, (0, 0), grid.shape))
    for row in range(0, grid.rows - tile_px + 1, tile_px):
        for column in range(0, grid.columns - tile_px + 1, tile_px):
            part, _ = _render(seen.splats, ortho_camera(grid, map_frame, 20.0, (row, column), (tile_px, tile_px)))
            difference = np.abs(part - whole[row : row + tile_px, column : column + tile_px])
            # A quarter of a level of 255: nobody sees the seam. What exceeds it is α at its threshold.
            assert np.quantile(difference, 0.999) < 0.25 / 255 and difference.max() < 1 / 255
    tiles = list(ortho_tiles(seen, grid, map_frame, 20.0, tile_px))
    assert len(tiles) == (-(-grid.rows // tile_px)) * (-(-grid.columns // tile_px))


def test_a_tile_lies_where_the_map_says_a_kilometre_from_the_origin() -> None:
    map_frame = map_frame_of(ALPS)
    at = map_frame.from_world(np.array([[900.0, -700.0, 15.0]]))[0]
    grid = MapGrid(north_west=at[:2] + np.array([-12.8, 12.8]), cell=0.05, rows=512, columns=512, epsg=map_frame.epsg)
    camera = ortho_camera(grid, map_frame, 15.0, (0, 0), grid.shape)
    rng = np.random.default_rng(1)
    places = np.column_stack([at[:2] + rng.uniform(-12.8, 12.8, (200, 2)), at[2] + rng.uniform(-1, 1, 200)])
    in_camera = map_frame.to_world(places) @ camera.cam_from_world[0, :3, :3].T + camera.cam_from_world[0, :3, 3]
    pixels = (in_camera @ camera.Ks[0].T)[:, :2] / in_camera[:, 2:]
    # Up leans by 1e-4 rad a kilometre from the origin: 1 m of height moves a place by 0.1 mm, 0.003 cells.
    assert np.abs(pixels[:, ::-1] - grid.cells_of(places)).max() < 0.005


def test_what_only_the_sky_or_one_photograph_knows_does_not_hide_the_ground() -> None:
    ground, cameras = ground_splats(600), cameras_above([(-1.0, 0.0), (1.0, 0.0)])
    count = len(ground)
    haze = replace(ground.select(np.arange(50)), means=ground.means[:50] + np.array([0, 0, 3.0], np.float32))
    sky = replace(ground.select(np.arange(50)), means=ground.means[:50] + np.array([0, 0, 30.0], np.float32))
    arrays = {name: np.concatenate([part.arrays()[name] for part in (ground, haze, sky)]) for name in ground.arrays()}
    num_views = np.concatenate([np.full(count, 5), np.full(50, 1), np.full(50, 9)])
    support = Support(num_views=num_views, parallax_deg=np.full(count + 100, 30.0), shown_px=np.ones(count + 100))
    seen = from_above(Splats(**arrays), support, cameras)
    grid = MapGrid(north_west=np.array([-3.0, 3.0]), cell=0.1, rows=60, columns=60, epsg=None)
    camera = ortho_camera(grid, map_frame_of(NOWHERE), 0.0, (0, 0), grid.shape)
    tile, clear = render_tile(seen, camera), render_tile(all_seen(ground), camera)
    assert clear.is_known.mean() > 0.9
    np.testing.assert_array_equal(tile.image[clear.is_known], clear.image[clear.is_known])
    assert (tile.views[clear.is_known] == 5).all() and (tile.bands()[..., 3][~tile.is_known] == 0).all()
    # Ground of ±0.3 m.
    assert np.abs(tile.height[clear.is_known]).max() < 0.6
    with pytest.raises(BadInput, match="no Gaussian lies below the cameras"):
        from_above(sky, Support(num_views=np.full(50, 9), parallax_deg=np.full(50, 30.0), shown_px=np.ones(50)), cameras)


def test_a_tile_that_nothing_reaches_is_empty() -> None:
    grid = MapGrid(north_west=np.array([1e4, 1e4]), cell=0.1, rows=16, columns=16, epsg=None)
    tile = render_tile(all_seen(ground_splats(50)), ortho_camera(grid, map_frame_of(NOWHERE), 0.0, (0, 0), grid.shape))
    assert not tile.is_known.any() and not tile.bands().any() and np.isnan(tile.height).all()


def test_gdal_reads_the_bands_their_place_and_their_system(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 256, (70, 90, 5)).astype(np.uint8)
    grid = MapGrid(north_west=np.array([465300.5, 5246400.25]), cell=0.25, rows=70, columns=90, epsg=32632)
    names = ("red", "green", "blue", "alpha", "views <2>")
    raster = TiledRaster(place=grid, shape=grid.shape, bands=names, tile_px=32, dtype=np.uint8, colors=True)
    save_tiles(tmp_path / "a.tif", raster, cut_tiles(values, 32))
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.crs.to_epsg() == 32632 and file.transform.to_gdal() == (465300.5, 0.25, 0, 5246400.25, 0, -0.25)
        assert file.descriptions == names and file.colorinterp[3] == ColorInterp.alpha and file.block_shapes[0] == (32, 32)
        np.testing.assert_array_equal(np.moveaxis(file.read(), 0, -1), values)
    heights = np.random.default_rng(1).normal(size=(20, 40)).astype(np.float32)
    heights[3, 4] = -9999
    one = replace(
        raster, place=replace(grid, epsg=None), shape=(20, 40), bands=("height",), dtype=np.float32, colors=False, no_data=-9999.0
    )
    save_tiles(tmp_path / "b.tif", one, cut_tiles(heights, 32))
    with rasterio.open(tmp_path / "b.tif") as file:
        assert file.crs is None or not file.crs.is_geographic
        assert file.nodata == -9999 and file.read_masks(1)[3, 4] == 0
        np.testing.assert_array_equal(file.read(1), heights)


def test_tiles_that_break_off_leave_no_file_and_odd_tiles_are_refused(tmp_path: Path) -> None:
    grid = MapGrid(north_west=np.zeros(2), cell=1.0, rows=64, columns=64, epsg=None)
    raster = TiledRaster(place=grid, shape=grid.shape, bands=("a",), tile_px=32, dtype=np.uint8)

    def broken() -> Iterator[np.ndarray]:
        yield np.zeros((32, 32), np.uint8)
        raise BadInput("nothing is seen.")

    with pytest.raises(BadInput, match="nothing is seen"):
        save_tiles(tmp_path / "a.tif", raster, broken())
    assert not list(tmp_path.iterdir())
    with pytest.raises(CannotWrite):
        save_tiles(tmp_path / "none" / "a.tif", raster, cut_tiles(np.zeros((64, 64), np.uint8), 32))
    with pytest.raises(BadInput, match="multiple of 16"):
        replace(raster, tile_px=100)
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(BadInput, match="above zero"):
            replace(grid, cell=bad)
    with pytest.raises(BadInput, match="larger cells"):
        grid_over(np.zeros(2), np.full(2, 1e6), 0.01, map_frame_of(NOWHERE))
