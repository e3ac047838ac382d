"""A made-up town for tests: 24 cameras, three regions of two devices, ground, and run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from shapely.geometry import Polygon, box

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_plan, save_scene
from radiant_core.io.run_store import write_json
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, Splats

SITES = np.array([[-60.0, -10.0], [50.0, 30.0], [40.0, -40.0]])
EDGE_IDS = ("north", "harbour", "quarry")
HALF_WH = (120.0, 72.0)


@dataclass(frozen=True, kw_only=True)
class Town:
    """What a run of the town would hold."""

    scene: SfmScene
    cloud_plan: CloudPlan
    edge_plans: tuple[EdgePlan, ...]
    splats: Splats
    held_out: frozenset[str]


def made_up_town(
    shift: tuple[float, float] = (0.0, 0.0),
    *,
    step_levels: float = 0.0,
    quarry_levels: float = 0.0,
    grid: tuple[int, int] = (8, 3),
) -> Town:
    """The town, moved by `shift` metres, with the regions "harbour" and "quarry" brighter by
    `step_levels` and `quarry_levels` of 255, planted seams, and a grid of so many cameras east by
    north."""
    rng = np.random.default_rng(3)
    offset = np.array([*shift, 0.0])
    xy = np.array([(x, y) for y in np.linspace(-45, 45, grid[1]) for x in np.linspace(-90, 90, grid[0])])
    cameras = _cameras(np.column_stack([xy, np.full(len(xy), 60.0)]) + offset)
    points = np.column_stack(
        [rng.uniform(-HALF_WH[0], HALF_WH[0], 9000), rng.uniform(-HALF_WH[1], HALF_WH[1], 9000), rng.uniform(0, 1, 9000)]
    )
    colors = np.clip(np.array([95, 125, 75]) + rng.normal(0, 12, (9000, 3)), 0, 255)
    scene = SfmScene(
        cameras=cameras,
        points=points + offset,
        colors=colors.astype(np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3)),
    )
    cloud_plan = _cloud_plan(xy, shift)
    brighter = np.array([0.0, step_levels, quarry_levels])[_nearest(points[:, :2])]
    splats = _splats(points, offset, colors + brighter[:, None])
    edge_plans = tuple(_edge_plan(cloud_plan, edge) for edge in range(3))
    return Town(scene=scene, cloud_plan=cloud_plan, edge_plans=edge_plans, splats=splats, held_out=frozenset(cameras.names[::8]))


def save_run(folder: Path, town: Town) -> dict[str, float]:
    """Write the town as a finished run; returns the PSNR of its held-out photographs."""
    psnr_db = {name: 20.0 + index for index, name in enumerate(sorted(town.held_out))}
    for name in ("sfm", *(f"pictures/{kind}" for kind in ("photographs", "renders", "differences"))):
        (folder / name).mkdir(parents=True)
    save_scene(folder / "sfm/scene.safetensors", town.scene)
    save_plan(folder / "plan.json", town.cloud_plan, town.edge_plans)
    save_ply(folder / "scene.ply", town.splats)
    write_json(folder / "manifest.json", {})
    write_json(folder / "metrics.json", {"images": [{"name": name, "psnr_db": value} for name, value in psnr_db.items()]})
    for kind, level in (("photographs", 200), ("renders", 180), ("differences", 60)):
        for name in town.held_out:
            cv2.imwrite(str(folder / "pictures" / kind / f"{name}.png"), np.full((60, 80, 3), level, np.uint8))
    return psnr_db


def _cameras(centers: np.ndarray) -> Cameras:
    down = np.diag([1.0, -1.0, -1.0])
    poses = np.tile(np.eye(4), (len(centers), 1, 1))
    poses[:, :3, :3] = down
    poses[:, :3, 3] = -centers @ down.T
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    count = len(centers)
    names = tuple(f"DJI_{index:04d}.JPG" for index in range(count))
    return Cameras(names=names, Ks=np.tile(K, (count, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([640, 480], (count, 1)))


def _nearest(xy: np.ndarray) -> np.ndarray:
    return ((xy[:, None] - SITES) ** 2).sum(axis=2).argmin(axis=1)


def _cloud_plan(xy: np.ndarray, shift: tuple[float, float]) -> CloudPlan:
    borders = tuple(np.array(_cell(edge).exterior.coords)[:-1] + shift for edge in range(3))
    return CloudPlan(
        method="voronoi",
        edge_ids=EDGE_IDS,
        sites=SITES + shift,
        weights=np.zeros(3),
        borders=borders,
        edge_of_camera=_nearest(xy),
        edge_time_s=np.array([190.0, 260.0, 210.0]),
        lower_bound_s=240.0,
        status="converged",
        certified=True,
    )


def _cell(edge: int) -> Polygon:
    """The part of the town nearest to one site, by cutting with half-planes."""
    cell = box(-HALF_WH[0], -HALF_WH[1], *HALF_WH)
    for other in np.delete(SITES, edge, axis=0):
        toward = (other - SITES[edge]) / np.linalg.norm(other - SITES[edge])
        along = np.array([-toward[1], toward[0]])
        middle, far = (SITES[edge] + other) / 2, 1000.0
        cell = cell.intersection(
            Polygon([middle + far * along, middle - far * along, middle - far * (along + toward), middle + far * (along - toward)])
        )
    turned = cell.normalize().reverse()
    assert isinstance(turned, Polygon)
    return turned


def _edge_plan(cloud_plan: CloudPlan, edge: int) -> EdgePlan:
    cameras = np.flatnonzero(cloud_plan.edge_of_camera == edge)
    cell = Polygon(cloud_plan.borders[edge])
    west, south, east, north = cell.bounds
    cut = (west + east) / 2
    halves = (cell.intersection(box(west, south, cut, north)), cell.intersection(box(cut, south, east, north)))
    return EdgePlan(
        edge_id=EDGE_IDS[edge],
        device_ids=(f"{EDGE_IDS[edge]}-1", f"{EDGE_IDS[edge]}-2"),
        camera_indices=cameras,
        device_of_camera=np.arange(len(cameras)) % 2,
        strips=tuple(np.array(half.exterior.coords)[:-1] for half in halves if isinstance(half, Polygon)),
        device_time_s=np.array([150.0, 140.0]),
    )


def _splats(points: np.ndarray, offset: np.ndarray, levels: np.ndarray) -> Splats:
    count = len(points)
    return Splats(
        means=points + offset,
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.full((count, 3), -0.5),
        logit_opacities=np.full(count, 2.0),
        sh0=((levels / 255 - 0.5) / SH_C0)[:, None].astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
