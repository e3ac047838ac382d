"""Benchmark of the viewer: frames of map and 3D view of large scenes, while they move and when they come to rest, and the first picture.

Made-up scenes of a seed: C cameras over 8 × 8 regions, N sparse points and as many Gaussians, all layers shown but those of devices,
drawn as the web page draws them, 640 × 600 px each. Moving is the median of nine frames; at rest is the frame that follows them; first
is from scene.ply on disk to both views. CPU seconds stand beside wall seconds, since this machine may do other things. Some 2 minutes.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import typer

from radiant_app.report.progress import tracked
from radiant_core.cameras import Cameras
from radiant_core.evaluate.metric import Metric
from radiant_core.frames import Frame
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.camera_layer import camera_layer
from radiant_viewer.layers.camera_roles import camera_roles
from radiant_viewer.layers.detail import MOVING_POINTS, even_subset, visible_subset
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.region_layer import border_layer, edge_site_layer, region_layer
from radiant_viewer.layers.splat_layer import sparse_point_layer, splat_layer
from radiant_viewer.web.scene import WebScene, WebView

SIDE_M = 1000.0
GRID = 8
SIZE_WH = (640, 600)
NUM_FRAMES = 9
_CASES = tuple(product((200, 2000), (200_000, 1_000_000, 5_000_000)))
_QUICK_CASES = ((200, 200_000),)


def bench_viewer(quick: bool) -> list[Metric]:
    """`viewer.<cameras>x<points>.<map|3d>.<moving|rest>_<wall|cpu>_ms`, `….first_<wall|cpu>_s` and `….choose_<moving|rest>_cpu_s`."""
    typer.echo(f"{os.cpu_count()} cores, load before {os.getloadavg()[0]:.1f}, {SIZE_WH[0]} × {SIZE_WH[1]} px a view, software rasterizer")
    metrics: list[Metric] = []
    for num_cameras, num_points in tracked(_QUICK_CASES if quick else _CASES, "bench viewer"):
        metrics += _case(num_cameras, num_points)
    typer.echo(f"load after {os.getloadavg()[0]:.1f}")
    return metrics


def _case(num_cameras: int, num_points: int) -> list[Metric]:
    key = f"viewer.{num_cameras}x{num_points}"
    waiting: list[Callable[[], None]] = []
    with tempfile.TemporaryDirectory() as folder:
        scene, splats = made_up_scene(num_cameras, num_points)
        path = Path(folder) / "scene.ply"
        save_ply(path, splats)
        del splats
        clocks = _clocks()
        layers = _layers(scene, load_ply(path))
        shown = WebScene(layers, (), later=lambda _seconds, call: waiting.append(call))
        for view in shown.views:
            view.plotter.window_size = list(SIZE_WH)
            view.plotter.show(auto_close=False, interactive=False)
        wall_s, cpu_s = _since(clocks)
    metrics = [_metric(f"{key}.first_wall_s", wall_s, "s"), _metric(f"{key}.first_cpu_s", cpu_s, "s")]
    for name, view in (("map", shown.map), ("3d", shown.view)):
        moving, rest = _frames(view, waiting)
        for kind, (wall_s, cpu_s) in (("moving", moving), ("rest", rest)):
            metrics.append(_metric(f"{key}.{name}.{kind}_wall_ms", 1000 * wall_s, "ms"))
            metrics.append(_metric(f"{key}.{name}.{kind}_cpu_ms", 1000 * cpu_s, "ms"))
    shown.close()
    return [*metrics, *_choosing(key, scene.points)]


def _choosing(key: str, points: FloatArray) -> list[Metric]:
    """CPU seconds of choosing what one cloud draws while it moves, and at rest seen whole from above."""
    clocks = _clocks()
    even_subset(points, MOVING_POINTS)
    moving_s = _since(clocks)[1]
    clip_from_world = np.diag([2 / SIDE_M, 2 / SIDE_M, 1e-3, 1.0])
    clip_from_world[:2, 3] = -1.0
    placed = points.astype(np.float32)
    clocks = _clocks()
    visible_subset(placed, clip_from_world, SIZE_WH, 1.0)
    return [_metric(f"{key}.choose_moving_cpu_s", moving_s, "s"), _metric(f"{key}.choose_rest_cpu_s", _since(clocks)[1], "s")]


def _frames(view: WebView, waiting: list[Callable[[], None]]) -> tuple[tuple[float, float], tuple[float, float]]:
    """(wall, CPU) seconds of a moving frame and of the one at rest."""
    camera, times, step = view.plotter.camera, [], np.array([SIDE_M / 200, 0, 0])
    window = view.plotter.render_window
    assert window is not None
    for _ in range(NUM_FRAMES):
        camera.focal_point, camera.position = (tuple(np.array(place) + step) for place in (camera.focal_point, camera.position))
        clocks = _clocks()
        view.plotter.render()
        window.WaitForCompletion()
        times.append(_since(clocks))
    clocks = _clocks()
    waiting[-1]()
    window.WaitForCompletion()
    moving = np.median(np.array(times), axis=0)
    return (float(moving[0]), float(moving[1])), _since(clocks)


def made_up_scene(num_cameras: int, num_points: int) -> tuple[SfmScene, Splats]:
    """Cameras on a grid 60 m over 1 km² of rolling ground, its points, and a Gaussian at each."""
    rng = np.random.default_rng(num_cameras + num_points)
    xy = rng.uniform(0, SIDE_M, (num_points, 2))
    heights = 8 * np.sin(xy[:, 0] / 90) * np.cos(xy[:, 1] / 70) + rng.uniform(0, 3, num_points)
    points = np.column_stack([xy, heights])
    colors = np.clip(120 + 60 * np.sin(points / 25) + rng.normal(0, 15, points.shape), 0, 255).astype(np.uint8)
    scene = SfmScene(
        cameras=_cameras(num_cameras),
        points=points,
        colors=colors,
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3)),
    )
    splats = Splats(
        means=points.astype(np.float32),
        quats=np.tile([1.0, 0, 0, 0], (num_points, 1)),
        log_scales=np.full((num_points, 3), -1.0),
        logit_opacities=np.full(num_points, 2.0),
        sh0=((colors / 255 - 0.5) / 0.28209479)[:, None].astype(np.float32),
        shN=np.zeros((num_points, 0, 3), np.float32),
    )
    return scene, splats


def _cameras(count: int) -> Cameras:
    columns = int(np.ceil(np.sqrt(count)))
    place = np.arange(count)
    centers = np.column_stack([place % columns, place // columns, np.zeros(count)]) * (SIDE_M / columns) + (0, 0, 60.0)
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    poses[:, :3, 3] = -centers * (1, -1, -1)
    K = np.array([[800.0, 0, 640], [0, 800, 480], [0, 0, 1]])
    names = tuple(f"{index:05d}.jpg" for index in range(count))
    return Cameras(names=names, Ks=np.tile(K, (count, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([1280, 960], (count, 1)))


def _plan(cameras: Cameras) -> CloudPlan:
    """One square region for each of 64 edges."""
    side = SIDE_M / GRID
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    cells = np.array(list(product(range(GRID), range(GRID))), np.float64)
    owner = np.clip(cameras.centers[:, :2] // side, 0, GRID - 1).astype(np.int64)
    return CloudPlan(
        method="voronoi",
        edge_ids=tuple(f"edge-{index:02d}" for index in range(GRID**2)),
        sites=(cells + 0.5) * side,
        weights=np.zeros(GRID**2),
        borders=tuple((corners + cell) * side for cell in cells),
        edge_of_camera=owner[:, 0] * GRID + owner[:, 1],
        edge_time_s=np.full(GRID**2, 60.0),
        lower_bound_s=60.0,
        status="converged",
        certified=True,
    )


def _layers(scene: SfmScene, splats: Splats) -> list[Layer]:
    plan = _plan(scene.cameras)
    cameras = camera_layer(scene.cameras, camera_roles(scene.cameras, plan, (), ()), "region")
    return [region_layer(plan), sparse_point_layer(scene), splat_layer(splats), border_layer(plan), cameras, edge_site_layer(plan)]


def _clocks() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(clocks: tuple[float, float]) -> tuple[float, float]:
    return time.perf_counter() - clocks[0], time.process_time() - clocks[1]


def _metric(key: str, value: float, unit: str) -> Metric:
    return Metric(key=key, value=value, unit=unit, direction="lower")
