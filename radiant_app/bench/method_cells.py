"""A cell of `radiant bench methods`: one scene, dealt by one plan to edges and devices, with one seed.

Training the devices' models takes most of the time, so each is trained once per (photographs,
settings, seed) and cached under the hash of these; all methods share them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint, Point

from radiant_app.workers.sources import load_scored_scene
from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import Device, Edge, System
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.initialize import first_splats
from radiant_core.train.needs import fit_to_scene
from radiant_core.train.photographs import load_images
from radiant_core.train.trainer import fit_splats
from radiant_core.train.training_pixels import training_pixels
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import worth_training

DEVICE_SPEEDS = (1.0, 0.6)
"""Relative speeds of an edge's devices, in turn: unequal, so that plans by time and by number differ."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Edges × devices per edge."""

    num_edges: int
    num_devices: int

    def __str__(self) -> str:
        return f"{self.num_edges}x{self.num_devices}"

    def system(self, speeds: Sequence[float] = DEVICE_SPEEDS, sites: FloatArray | None = None) -> System:
        """Edges whose devices take 1 / speed seconds per camera; at sites (E,2) m, or without positions."""

        def device(edge: int, index: int) -> Device:
            speed = speeds[index % len(speeds)]
            return Device(
                id=f"e{edge}d{index}",
                init_s=CostCurve(),
                train_s=CostCurve(linear=1 / speed),
                model_bytes=CostCurve(linear=1e5),
                uplink_bytes_per_s=1e6,
            )

        return System(
            edges=tuple(
                Edge(
                    id=f"e{edge}",
                    position=None if sites is None else (float(sites[edge, 0]), float(sites[edge, 1])),
                    aggregate_s=CostCurve(linear=0.1),
                    uplink_bytes_per_s=1e6,
                    devices=tuple(device(edge, index) for index in range(self.num_devices)),
                )
                for edge in range(self.num_edges)
            )
        )


def random_sites(positions: FloatArray, count: int, placement: int) -> FloatArray:
    """Sites (count,2) m of edges, uniform over the hull of cameras (C,2) m and apart from each other, seeded by the placement.

    Sites are at least √(hull area / (2 count)) apart, a tenth less after each hundred rejected
    draws. k-means would not give different placements: from most seeds it ends at the same sites.
    """
    # Buffered, since cameras may stand in a line.
    hull = MultiPoint(positions).convex_hull.buffer(max(0.01 * float(np.ptp(positions, axis=0).max()), 1e-3))
    low, high = np.reshape(hull.bounds, (2, 2))
    apart_m, rng = float(np.sqrt(hull.area / 2 / count)), np.random.default_rng((placement, 1))
    sites, num_in_vain = np.zeros((0, 2)), 0
    while len(sites) < count:
        site = rng.uniform(low, high)
        if hull.covers(Point(site)) and np.hypot(*(sites - site).T).min(initial=np.inf) >= apart_m:
            sites = np.vstack([sites, site])
        else:
            num_in_vain += 1
            apart_m *= 0.9 if num_in_vain % 100 == 0 else 1.0
    return sites


def layout_of(text: str) -> Layout:
    """A layout such as 2x2; BadInput for anything else."""
    parts = text.split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise BadInput(f"layout {text!r} is not edges x devices per edge: write 2x2, for instance.")
    return Layout(num_edges=int(parts[0]), num_devices=int(parts[1]))


@dataclass(frozen=True, kw_only=True, eq=False)
class BenchScene:
    """A scene at the size of the comparison, its training and held-out parts; photographs are loaded once."""

    name: str
    training: SfmScene
    held_out: SfmScene
    images: Path
    long_side_px: int

    @cached_property
    def views(self) -> TrainingViews:
        """All training photographs."""
        cameras = self.training.cameras.scaled(self.long_side_px)
        return TrainingViews(cameras=cameras, images=load_images(self.images, cameras))

    @cached_property
    def held_out_views(self) -> TrainingViews:
        """All held-out photographs."""
        cameras = self.held_out.cameras.scaled(self.long_side_px)
        return TrainingViews(cameras=cameras, images=load_images(self.images, cameras))


def load_bench_scene(source: Path, long_side_px: int) -> BenchScene:
    """A finished run, a folder of `radiant sfm` or a COLMAP project; BadInput where nothing can be held out."""
    scene, _, images = load_scored_scene(source)
    held = held_out_mask(scene.cameras.names)
    if held.sum() < 2 or (~held).sum() < 8:
        raise BadInput(f"{source} has {len(scene.cameras)} placed photographs: at least 2 are held out and 8 trained on.")
    resolved = source.resolve()
    return BenchScene(
        name=resolved.parent.name if resolved.name in ("images", "sfm") else resolved.name,
        training=scene.restricted_to(np.flatnonzero(~held)),
        held_out=scene.restricted_to(np.flatnonzero(held)),
        images=images,
        long_side_px=long_side_px,
    )


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A model and the cost of its training."""

    splats: Splats
    cpu_s: float
    training_px: float
    """Pixels rendered by all of its steps."""
    num_views: int
    num_steps: int


@dataclass(frozen=True, kw_only=True)
class ModelCache:
    """Models by the hash of their inputs."""

    folder: Path

    def trained(self, scene: BenchScene, rows: Sequence[int], config: TrainConfig) -> Trained:
        """The model of the training photographs `rows` of a scene."""
        return self.trained_part(scene, scene.training.restricted_to(np.asarray(rows, np.int64)), config)

    def trained_part(self, scene: BenchScene, part: SfmScene, config: TrainConfig) -> Trained:
        """The model of a part of a scene's training photographs and points."""
        seen = {"names": part.cameras.names, "poses": part.cameras.cam_from_world, "points": part.points}
        key = content_key(__version__, {"scene": scene.name, "train": asdict(config), **seen})
        model, record = self.folder / f"{key}.safetensors", self.folder / f"{key}.json"
        if not (model.is_file() and record.is_file()):
            self.folder.mkdir(parents=True, exist_ok=True)
            made = _train(scene, part, config)
            save_splats(model, made.splats)
            write_json(record, {name: getattr(made, name) for name in ("cpu_s", "training_px", "num_views", "num_steps")})
        return Trained(splats=load_splats(model), **read_json(record))


def _train(scene: BenchScene, part: SfmScene, config: TrainConfig) -> Trained:
    begun_s = time.process_time()
    rows = [scene.training.cameras.names.index(name) for name in part.cameras.names]
    part, views, _ = worth_training(part, scene.views.select(rows), config)
    config, _ = fit_to_scene(config, part, views)
    initial, _ = first_splats(part, views, config)
    result = fit_splats(initial, views, config)
    return Trained(
        splats=result.splats,
        cpu_s=time.process_time() - begun_s,
        training_px=training_pixels(views.cameras, config, result.num_steps),
        num_views=len(views),
        num_steps=result.num_steps,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One scene under one plan and one seed, with the models of its devices, edge by edge."""

    scene: BenchScene
    layout: Layout
    placement: int
    """0: edges are placed as in a run; others: at random sites."""
    seed: int
    train: TrainConfig
    """Of a device."""
    cache: ModelCache
    speeds: tuple[float, ...] = DEVICE_SPEEDS
    """Of an edge's devices, in turn."""

    @property
    def name(self) -> str:
        """Prefix of the cell's files."""
        speeds = "" if self.speeds == DEVICE_SPEEDS else "-v" + "_".join(f"{speed:g}" for speed in self.speeds)
        return f"{self.scene.name}-{self.layout}{speeds}-p{self.placement}-s{self.seed}"

    @cached_property
    def plan(self) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
        """The exact plan: regions of the edges, cameras of the devices."""
        return self._planned("exact", self.speeds)

    @cached_property
    def even_plan(self) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
        """The plan with equally many cameras per device."""
        return self._planned("even", (1.0,))

    def _planned(self, method: PlanMethod, speeds: Sequence[float]) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
        positions = self.scene.training.cameras.centers[:, :2]
        sites = random_sites(positions, self.layout.num_edges, self.placement) if self.placement else None
        placed = place_edges(self.layout.system(speeds, sites), positions, None, 0)
        plan = plan_regions(positions, placed, method=method)
        if isinstance(plan, PlanInfeasible):
            raise BadInput(f"{self.name}: {plan.reason}")
        return plan, split_edges(positions, plan, placed)

    @cached_property
    def devices(self) -> list[list[Trained]]:
        """Per edge, the models of its devices with cameras."""
        return self.device_models(self.plan[1])

    def device_models(self, plans: Sequence[EdgePlan]) -> list[list[Trained]]:
        """The same for other plans of the edges."""
        config = replace(self.train, seed=self.seed)
        return [[self.cache.trained(self.scene, rows.tolist(), config) for rows in device_rows(plan)] for plan in plans]

    @cached_property
    def centralised(self) -> Trained:
        """One model of all photographs, with the steps of all devices together."""
        num_devices = sum(len(edge) for edge in self.devices)
        config = replace(self.train, seed=self.seed, num_steps=num_devices * self.train.num_steps)
        return self.cache.trained(self.scene, range(len(self.scene.training.cameras)), config)

    def cameras_of(self, rows: NDArray[np.int64]) -> Cameras:
        """Training cameras at the size of the comparison."""
        return self.scene.views.cameras.select(rows)


def device_rows(plan: EdgePlan) -> list[NDArray[np.int64]]:
    """Rows into the training cameras of each device that has any."""
    rows = [plan.cameras_of(device) for device in plan.device_ids]
    return [own for own in rows if len(own)]
