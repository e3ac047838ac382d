"""Points whose coordinates in an alignment's file are known, looked for in every file that `radiant export` writes."""

from __future__ import annotations

import importlib
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
import trimesh
from pyproj import Transformer
from rich.console import Console
from scipy.spatial import KDTree

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.survey import surface
from radiant_app.commands.survey.parts import load_survey
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.sources import load_scene_of
from radiant_core.georef.given_frame import load_given_frame
from radiant_core.io.model_reader import read_model as read_splats
from radiant_core.io.ply import save_ply
from radiant_core.splats import Splats
from radiant_core.train.dense.fuse import DensePoints
from radiant_viewer.layers.ortho_layer import ORTHO, ortho_layer

NEAR_M = 1e-3
CELL_M = 0.5
SLOPE = 0.2


def quiet_display() -> ProgressDisplay:
    return ProgressDisplay(Console(file=io.StringIO()))


def model_at(means: np.ndarray, sigma: float) -> Splats:
    """Opaque white balls."""
    count = len(means)
    return Splats(
        means=means.astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scales=np.full((count, 3), np.log(sigma), np.float32),
        logit_opacities=np.full(count, 6, np.float32),
        sh0=np.full((count, 1, 3), 1.7, np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def inside_of(trained: Path, points: np.ndarray) -> np.ndarray:
    """Points of the file's coordinates in the scene's own."""
    given = load_given_frame(trained)
    assert given is not None
    return given.given_from_scene.inverse().apply(points)


def offset_said(figures: dict[str, object]) -> np.ndarray:
    return np.array([float(number) for number in str(figures["offset"]).partition(" (")[0].split(", ")])


def require_models(trained: Path, points: np.ndarray, folder: Path, systems: tuple[str, ...]) -> None:
    """A model of Gaussians at the known points, in every form of a model, and the cameras of a project."""
    save_ply(trained / "scene.ply", model_at(inside_of(trained, points), 0.02))
    for crs in systems:
        for name in ("a.ply", "b.spz", "c.sog", "d.usdc"):
            out = folder / f"{crs}_{name}".replace(":", "_")
            figures = export(ExportRequest(model=trained, out=out, crs=crs), quiet_display())
            written = usd_positions(out) if name == "d.usdc" else read_splats(out).splats.means
            offset = offset_said(figures)
            assert json.loads(out.with_name(f"{out.stem}.georef.json").read_text())["offset"] == offset.tolist()
            # Each coordinate within a millimetre.
            away_m, nearest = KDTree(written.astype(np.float64)).query(points - offset, p=np.inf)
            assert away_m.max() < NEAR_M, (crs, name)
            assert len(set(nearest.tolist())) > 0.9 * len(points)
        out = folder / f"{crs}_nerfstudio".replace(":", "_")
        figures = export(ExportRequest(model=trained, out=out, crs=crs, format="nerfstudio"), quiet_display())
        frames = json.loads((out / "transforms.json").read_text())
        places = {Path(frame["file_path"]).name: np.array(frame["transform_matrix"])[:3, 3] for frame in frames["frames"]}
        applied = np.array(frames.get("applied_transform", np.eye(3, 4)))
        scene, given = load_scene_of(trained).cameras, load_given_frame(trained)
        assert given is not None
        wanted = given.given_from_scene.apply(scene.centers)
        for row, camera in enumerate(scene.names):
            # applied_transform leads from the original to what the file holds.
            original = applied[:, :3].T @ (places[Path(camera).name] - applied[:, 3])
            assert np.abs(original + offset_said(figures) - wanted[row]).max() < NEAR_M


def usd_positions(path: Path) -> np.ndarray:
    usd, vol = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdVol"))

    stage = usd.Stage.Open(str(path))
    return np.array(vol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/Scene/Splats")).GetPositionsAttr().Get())


def geocentric_of_utm(places: np.ndarray) -> np.ndarray:
    """By PROJ: what is in WGS84 UTM 32N, in ECEF."""
    lon, lat = Transformer.from_crs("EPSG:32632", "EPSG:4979", always_xy=True).transform(*places[:, :2].T)
    return np.column_stack(Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon, lat, places[:, 2]))


def require_rasters(
    trained: Path, file_from_map: Callable[[np.ndarray], np.ndarray], monkeypatch: pytest.MonkeyPatch, folder: Path, epsg: int | None
) -> None:
    """Surfaces and the orthophoto in the default system; `file_from_map` leads from it to the coordinates of the alignment.

    The surface is of points that lie a millimetre inside the borders of the raster's cells, each cell with a height of its
    own: a raster that is a millimetre aside mixes neighbours, whose heights differ by decimetres. The orthophoto is of balls,
    whose middles are the centroids of what is opaque.
    """
    middle, half_m = _ground_of(trained)
    first, last = (np.floor((middle[:2] + side * half_m) / CELL_M).astype(int) for side in (-1, 1))
    columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    inner = np.array([NEAR_M, CELL_M / 2, CELL_M - NEAR_M])
    across, along = (axis.ravel() for axis in np.meshgrid(inner, inner))

    def heights(column: np.ndarray, row: np.ndarray) -> np.ndarray:
        return middle[2] + 0.1 * ((7 * column + 11 * row) % 23)

    def matched(*given: object) -> list[DensePoints]:
        del given
        return [_dense(inside_of(trained, file_from_map(places)))]

    monkeypatch.setattr(surface, "_matched", matched)
    east = (columns.ravel()[:, None] * CELL_M + across).ravel()
    north = (rows.ravel()[:, None] * CELL_M + along).ravel()
    places = np.column_stack([east, north, np.repeat(heights(columns.ravel(), rows.ravel()), len(across))])
    request = ExportRequest(model=trained, out=folder / "dsm.tif", format="dsm", resolution=CELL_M)
    export(request, quiet_display())
    with rasterio.open(folder / "dsm.tif") as file:
        assert (file.crs.to_epsg() if file.crs else None) == epsg
        bands, corner = file.read(), np.array([file.transform.c, file.transform.f])
    row, column = np.nonzero(bands[2] == 1)
    at = np.rint(corner / CELL_M)
    assert len(row) > 500 and np.abs(bands[0, row, column] - heights(column + at[0], at[1] - 1 - row)).max() < NEAR_M
    export(replace(request, out=folder / "points.laz", format="laz"), quiet_display())
    # A LAZ counts in millimetres, so half of one is rounded.
    assert KDTree(laspy.read(folder / "points.laz").xyz).query(places, p=np.inf)[0].max() < NEAR_M
    figures = export(replace(request, out=folder / "mesh.glb", format="glb"), quiet_display())
    mesh = trimesh.load_mesh(folder / "mesh.glb")
    vertices = np.asarray(mesh.vertices)[:, [0, 2, 1]] * (1, -1, 1) + offset_said(figures)
    cells = np.floor(vertices[:, :2] / CELL_M)
    is_measured = np.abs(vertices[:, 2] - heights(*cells.T)) < NEAR_M
    assert np.abs(vertices[:, :2] - (cells + 0.5) * CELL_M).max() < NEAR_M and is_measured.sum() >= len(row)
    _require_contours(places, middle, trained, folder, epsg)
    _require_balls(trained, middle, half_m, file_from_map, folder)


def _ground_of(trained: Path) -> tuple[np.ndarray, float]:
    """Middle (3,) on the default map of what the photographs saw, and half the side of a square about it."""
    survey = load_survey(trained)
    level = survey.map_frame.from_world([[0.0, 0.0, survey.ground.level]])[0, 2]
    middle = (survey.ground.low + survey.ground.high) / 2
    return np.array([*middle[:2], np.round(level, 1)]), float((survey.ground.high - survey.ground.low)[:2].min() / 2) + 2


def _dense(points: np.ndarray) -> DensePoints:
    count = len(points)
    return DensePoints(
        points=points,
        normals=np.tile([0.0, 0, 1], (count, 1)),
        colors=np.full((count, 3), 128, np.uint8),
        pixels_m=np.full(count, 0.1),
        costs=np.zeros(count),
        views=np.zeros(count, np.int64),
    )


def _require_contours(places: np.ndarray, middle: np.ndarray, trained: Path, folder: Path, epsg: int | None) -> None:
    """Of a plane: each corner of a contour lies where the plane has its height."""
    places[:, 2] = middle[2] + SLOPE * (places[:, 0] - middle[0])
    export(ExportRequest(model=trained, out=folder / "c.geojson", format="contours", resolution=CELL_M, interval=0.25), quiet_display())
    lines = json.loads((folder / "c.geojson").read_text())["features"]
    corners = np.concatenate([np.array(line["geometry"]["coordinates"]) for line in lines])
    assert len(corners) > 100
    if epsg is not None:
        corners[:, :2] = np.column_stack(Transformer.from_crs("EPSG:4326", epsg, always_xy=True).transform(*corners[:, :2].T))
    # Away from the borders, where cells are filled.
    inside = (np.abs(corners[:, :2] - middle[:2]) < 5).all(axis=1)
    aside_m = (corners[inside, 2] - middle[2]) / SLOPE - (corners[inside, 0] - middle[0])
    # Heights have four digits, which are half a tenth of a millimetre, and the plane is that steep.
    assert inside.sum() > 50 and np.abs(aside_m).max() < NEAR_M


def _require_balls(
    trained: Path, middle: np.ndarray, half_m: float, file_from_map: Callable[[np.ndarray], np.ndarray], folder: Path
) -> None:
    """Centroids of what an orthophoto shows of nine balls."""
    steps = np.array([-0.3, 0.017, 0.31]) * half_m
    balls = middle + np.column_stack([*(axis.ravel() for axis in np.meshgrid(steps, steps)), np.full(9, 0.5)])
    save_ply(trained / "scene.ply", model_at(inside_of(trained, file_from_map(balls)), 0.9))
    export(ExportRequest(model=trained, out=folder / "ortho.tif", format="ortho", resolution=0.02), quiet_display())
    with rasterio.open(folder / "ortho.tif") as file:
        bounds = file.bounds
        rows, columns = np.nonzero(file.read(4) == 255)
        places = np.column_stack(file.transform @ np.array([columns + 0.5, rows + 0.5, np.ones(len(rows))]).reshape(3, -1))
    away_m, nearest = KDTree(balls[:, :2]).query(places[:, :2])
    assert away_m.max() < 1.5
    # Of a disc of radius 53 px: a third of a millimetre is the raster's.
    centroids = np.array([places[nearest == number, :2].mean(axis=0) for number in range(9)])
    assert np.abs(centroids - balls[:, :2]).max() < NEAR_M
    # The window shows the picture where the scene is.
    (trained / "survey").mkdir()
    (folder / "ortho.tif").rename(trained / ORTHO)
    layer = ortho_layer(trained, load_scene_of(trained).frame, 0.0)
    assert layer is not None and layer.picture is not None
    corners = np.column_stack([[[bounds.left, bounds.top], [bounds.right, bounds.bottom]], np.full(2, middle[2])])
    assert np.abs(layer.picture.corners[[0, 2], :2] - inside_of(trained, file_from_map(corners))[:, :2]).max() < 0.02
