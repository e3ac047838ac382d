"""A cell of `radiant bench methods` and `paper`: one scene under one plan, settings and seed.

A plan is made for a layout of edges and devices, or is that of a finished run. What is trained and
joined in a cell follows from its `Recipe`, as in `radiant run`. Training takes most of the time, so
each device's model is cached under the hash of its task and photographs; all methods share it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from shapely import MultiPoint, Point

from benchmarks.hold_out import mask_of, name_of
from benchmarks.options import OF_RUN, HeldPart
from benchmarks.splits import AnyMethod, plan_by
from benchmarks.training_pixels import training_pixels
from radiant_app.files.run_folder import read_manifest
from radiant_app.files.system_file import load_system
from radiant_app.report.prediction_error import SYSTEM_NAME
from radiant_app.run.cutting import Planned, choose_cut, plan_places
from radiant_app.workers.sources import captures_of, load_scored_scene, masks_folder_of
from radiant_core import __version__
from radiant_core.aggregate.config import aggregate_preset, with_joins
from radiant_core.choices import CutBy, UploadFormat
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import load_task
from radiant_core.hierarchy.device import device_model, fit_prepared, prepare_training
from radiant_core.hierarchy.messages import CloudTask, DeviceModel, DeviceSettings, DeviceTask, EdgeTask, device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Recorder, Reporter
from radiant_core.io.records import load_plan, load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.light.captures import Captures
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible
from radiant_core.plan.system import Device, Edge, System
from radiant_core.render.backends import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.photographs import load_images, load_training_views
from radiant_core.train.views import TrainingViews

DEVICE_SPEEDS = (1.0, 0.6)
"""Speeds of an edge's devices, in turn: unequal, so that plans by time and number differ."""
MAX_NUM_SPLATS = 200_000
"""Of a device's model."""
MIN_TRAINED = 6
"""Photographs that are left to train on."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Edges × devices per edge."""

    num_edges: int
    num_devices: int

    def __str__(self) -> str:
        return f"{self.num_edges}x{self.num_devices}"

    def system(self, speeds: Sequence[float] = DEVICE_SPEEDS, sites: FloatArray | None = None) -> System:
        """Edges whose devices take 1 / speed seconds per camera; at sites (E,2) m, where given."""

        def device(edge: int, index: int) -> Device:
            speed = speeds[index % len(speeds)]
            return Device(
                id=f"e{edge}d{index}",
                init_s=CostCurve(),
                train_s=CostCurve(linear=1 / speed),
                model_bytes=CostCurve(linear=1e5),
                uplink_bytes_per_s=1e6,
                speed=speed,
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
    """Sites (count,2) m of edges, uniform over the hull of cameras (C,2) m, seeded by `placement`.

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


def layout_of(text: str) -> Layout | None:
    """A layout such as 2x2, or None for `OF_RUN`; BadInput for anything else."""
    if text == OF_RUN:
        return None
    parts = text.split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise BadInput(f"layout {text!r} is not edges x devices per edge: write 2x2, for instance, or {OF_RUN} for the plan of a run.")
    return Layout(num_edges=int(parts[0]), num_devices=int(parts[1]))


@dataclass(frozen=True, kw_only=True, eq=False)
class BenchScene:
    """A scene at the size of the comparison, in two parts: for training and held out. Photographs
    are loaded once."""

    name: str
    training: SfmScene
    held_out: SfmScene
    images: Path
    masks: Path | None
    long_side_px: int
    cut_by: CutBy = "auto"
    """What the regions and strips of its cells are cut by."""
    captures: Captures = field(default_factory=dict)
    """When photographs were taken and how exposed, as far as that is known."""

    @cached_property
    def views(self) -> TrainingViews:
        """All training photographs."""
        return load_training_views(self.images, self.training.cameras.scaled(self.long_side_px), self.masks)

    @cached_property
    def held_out_views(self) -> TrainingViews:
        """All held-out photographs."""
        cameras = self.held_out.cameras.scaled(self.long_side_px)
        return TrainingViews(cameras=cameras, images=load_images(self.images, cameras))


def load_bench_scene(source: Path, long_side_px: int, cut_by: CutBy = "auto", part: HeldPart = "interleaved") -> BenchScene:
    """A run, a folder of `radiant sfm` or a COLMAP project; BadInput if none can be held out."""
    scene, _, images = load_scored_scene(source)
    is_held_out = mask_of(part, scene.cameras)
    if is_held_out.sum() < 2 or (~is_held_out).sum() < MIN_TRAINED:
        counts = f"{len(scene.cameras)} placed photographs, of which {is_held_out.sum()} are held out"
        raise BadInput(f"{source} has {counts}: at least 2 are held out and {MIN_TRAINED} trained on.")
    resolved = source.resolve()
    return BenchScene(
        name=name_of(resolved.parent.name if resolved.name in ("images", "sfm") else resolved.name, part),
        training=scene.restricted_to(np.flatnonzero(~is_held_out)),
        held_out=scene.restricted_to(np.flatnonzero(is_held_out)),
        images=images,
        masks=masks_folder_of(source),
        long_side_px=long_side_px,
        cut_by=cut_by,
        captures=captures_of(source),
    )


Train = Callable[[DeviceTask, TrainingViews, Reporter], DeviceModel]


@dataclass(frozen=True, kw_only=True)
class ModelCache:
    """Devices' models by the hash of all that decides their bits."""

    folder: Path

    def train(self, task: DeviceTask, views: TrainingViews, reporter: Reporter) -> DeviceModel:
        """As `train_device`; the summary also has `cpu_s`, and `training_px` of all steps."""
        key = content_key(__version__, replace(task, upload="float32"), views)
        model, record = self.folder / f"{key}.safetensors", self.folder / f"{key}.json"
        if not (model.is_file() and record.is_file()):
            self.folder.mkdir(parents=True, exist_ok=True)
            begun_s = time.process_time()
            prepared = prepare_training(task, views, reporter)
            result = fit_prepared(prepared, reporter)
            trained = device_model(prepared, result)
            pixels = training_pixels(prepared.views.cameras, prepared.config, result.num_steps)
            save_splats(model, trained.splats)
            write_json(record, {**trained.summary, "cpu_s": time.process_time() - begun_s, "training_px": pixels})
        return DeviceModel(splats=load_splats(model), cameras=task.scene.cameras, summary=read_json(record))


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One scene under one plan and one seed."""

    name: str
    """Prefix of the cell's files."""
    scene: BenchScene
    layout: Layout
    """Edges × the most devices that one of them has."""
    recipe: Recipe
    """Plan and settings of `ours`."""
    cache: ModelCache

    @cached_property
    def even(self) -> Recipe:
        """The recipe with equally many photographs per device."""
        first = self.recipe.system.devices[0]
        alike = {name: getattr(first, name) for name in ("init_s", "train_s", "model_bytes", "uplink_bytes_per_s")}
        edges = [replace(e, devices=tuple(replace(device, **alike) for device in e.devices)) for e in self.recipe.system.edges]
        system = replace(self.recipe.system, edges=tuple(edges))
        return self.recipe.with_plan(*self._make_plan(system, "even"))

    def planned(self, method: AnyMethod) -> Recipe:
        """The same recipe by the plan of another method; BadInput where it leaves no plan."""
        return self.recipe.with_plan(*self._make_plan(self.recipe.system, method))

    def _make_plan(self, system: System, method: AnyMethod) -> Planned:
        """By the same places and edges as the cell's own plan."""
        plan = self.recipe.cloud_plan
        places = plan.places_of(self.scene.training.cameras.centers[:, :2])
        planned = plan_by(method, places, system)
        if isinstance(planned, PlanInfeasible):
            raise BadInput(f"{self.name}: {planned.reason}")
        return replace(planned, looks=plan.looks), split_edges(places, planned, system)

    @cached_property
    def devices(self) -> dict[str, DeviceModel]:
        """The models by the cell's own recipe."""
        return self.train_devices(self.recipe)

    def train_devices(self, recipe: Recipe, train: Train | None = None) -> dict[str, DeviceModel]:
        """The models of the devices with photographs."""
        rows_of = {device: rows for plan in recipe.edge_plans for device in plan.device_ids if len(rows := plan.cameras_of(device))}
        return {
            device: (train or self.cache.train)(
                device_task(recipe.device_settings(device), self.scene.training.restricted_to(rows)),
                self.scene.views.select(rows),
                Recorder(),
            )
            for device, rows in rows_of.items()
        }

    def model_of(self, part: SfmScene, **changes: Any) -> DeviceModel:
        """The model of a part of the training scene; `changes` of the training's settings."""
        row_of = {name: row for row, name in enumerate(self.scene.training.cameras.names)}
        task = DeviceTask(scene=part, train=replace(self.recipe.train, **changes), backend=self.recipe.backend)
        return self.cache.train(task, self.scene.views.select([row_of[name] for name in part.cameras.names]), Recorder())

    @cached_property
    def centralised_model(self) -> DeviceModel:
        """One model of all photographs, with the steps of all devices together and room for as many
        Gaussians: a run's limit is that of one device."""
        num_steps = sum(int(model.summary["num_steps"]) for model in self.devices.values())
        most = self.recipe.train.max_num_splats * len(self.devices)
        return self.model_of(self.scene.training, num_steps=num_steps, max_num_splats=most, max_epochs=None)


def bench_settings(long_side_px: int, num_steps: int, upload: UploadFormat = "float16") -> DeviceSettings:
    """How devices train: as by `radiant run --train-preset draft`, with that size and length."""
    backend = resolve_backend("auto")
    overrides = Overrides(long_side_px=long_side_px, num_steps=num_steps, max_num_splats=MAX_NUM_SPLATS)
    return DeviceSettings(train=fit_to_backend(train_preset("draft"), backend, overrides)[0], backend=backend, upload=upload)


def deal_cell(
    scene: BenchScene,
    cache: ModelCache,
    settings: DeviceSettings,
    layout: Layout,
    placement: int = 0,
    speeds: tuple[float, ...] = DEVICE_SPEEDS,
) -> Cell:
    """The scene dealt to a layout by the exact plan; sites as in a run (placement 0) or random."""
    of_speeds = "" if speeds == DEVICE_SPEEDS else "-v" + "_".join(f"{speed:g}" for speed in speeds)
    name = f"{scene.name}-{layout}{of_speeds}-p{placement}-s{settings.train.seed}"
    sites = random_sites(scene.training.cameras.centers[:, :2], layout.num_edges, placement) if placement else None
    return deal_system(scene, cache, settings, layout.system(speeds, sites), name)


def deal_system(scene: BenchScene, cache: ModelCache, settings: DeviceSettings, system: System, name: str) -> Cell:
    """The scene dealt to a system by the exact plan; edges without a position as in a run."""
    positions = scene.training.cameras.centers[:, :2]
    cut = choose_cut(scene.training, scene.cut_by, "exact", lambda places: plan_places(places, place_edges(system, places, None, 0)))
    places = cut.places_of(positions)
    placed = place_edges(system, places, None, 0)
    planned = plan_places(places, placed)
    if isinstance(planned, PlanInfeasible):
        raise BadInput(f"{name}: {planned.reason}")
    cloud_plan, edge_plans = cut.mark(planned[0]), planned[1]
    recipe = Recipe(
        system=placed,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        train=settings.train,
        aggregate=aggregate_preset("default"),
        backend=settings.backend,
        upload=settings.upload,
    )
    return Cell(name=name, scene=scene, layout=_layout_around(placed), recipe=recipe, cache=cache)


def _layout_around(system: System) -> Layout:
    return Layout(num_edges=len(system.edges), num_devices=max(len(edge.devices) for edge in system.edges))


def run_cell(run: Path, cache: ModelCache) -> Cell:
    """The scene of a finished run under the run's own plan, system and settings.

    Its recipe makes the run's scene bit for bit where every device delivered and none has a limit
    of memory: such a limit counts what the device's process held besides. Raises BadInput unless
    the run pooled its photographs (`--frames shared`) and its edges have joined.
    """
    tasks = [load_task(EdgeTask, path.parent, "edge task") for path in sorted(run.glob("edges/*/task.json"))]
    if not tasks:
        raise BadInput(f"{run} has no edge that received models: give the folder of a finished run, or a layout such as 2x2.")
    scene = load_bench_scene(run, tasks[0].train.long_side_px)
    cloud_plan, edge_plans = load_plan(run / "plan.json")
    if len(cloud_plan.edge_of_camera) != len(scene.training.cameras):
        raise BadInput(
            f"the plan of {run} deals {len(cloud_plan.edge_of_camera)} photographs, its scene has {len(scene.training.cameras)} "
            f"to train on: make the run anew, or give a layout such as 2x2."
        )
    config = read_manifest(run).config
    aggregate = with_joins(aggregate_preset(config["aggregate"]["preset"]), {}, config.get("refine", {}))
    recipe = Recipe(
        system=load_system(run / SYSTEM_NAME),
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        train=tasks[0].train,
        aggregate=replace(aggregate, edge=tasks[0].join, cloud=load_task(CloudTask, run / "cloud").join),
        backend=tasks[0].backend,
        upload=tasks[0].upload,
        step_policy=config["train"].get("step_policy", "fixed"),
    )
    name = f"{scene.name}-{OF_RUN}-s{recipe.train.seed}"
    return Cell(name=name, scene=scene, layout=_layout_around(recipe.system), recipe=recipe, cache=cache)
