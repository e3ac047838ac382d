"""Rivals of `radiant bench methods` and of the paper's main table, made when they are named.

    field         one small radiance field of all photographs
    gp-nerf       the same with three dense planes beside the hash grid
    switch-nerf   the same with a gate and eight experts
    drone-nerf    blocks of the layout, poses refined, fused
    mega-nerf     cells of the layout, joined by inverse distance
    fednerf       federated averaging of the devices' fields, even counts of photographs
    f3dgs         federated averaging of Gaussians on a scaffold, even counts of photographs

Each is "-style": its module says what differs from the publication. All fields have the same size
and take the same steps in all; f3dgs takes as many steps per device as the devices' trainings. CPU
seconds and training pixels are of the whole training: nothing is shared with other rows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import typer

from benchmarks.fields.bounds import FieldBounds
from benchmarks.fields.field import Field, FieldConfig, RadianceField, make_field, num_parameters
from benchmarks.fields.fit import FitFieldConfig, FitFieldOptions, fit_field
from benchmarks.fields.rays import PixelRays
from benchmarks.fields.render import render_image
from benchmarks.methods.arms import Arm, ArmModel, Round
from benchmarks.methods.cells import Cell
from benchmarks.rivals.drone_nerf import DroneConfig, fit_drone
from benchmarks.rivals.f3dgs import F3dgsConfig, f3dgs
from benchmarks.rivals.fed_nerf import FedConfig, fit_fed
from benchmarks.rivals.gp_nerf import PlaneConfig, make_gp_field
from benchmarks.rivals.mega_nerf import MegaConfig, fit_mega
from benchmarks.rivals.switch_nerf import SwitchConfig, make_switch_field
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.initialize import first_splats
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews

FIELD_STEPS, QUICK_FIELD_STEPS = 1_000, 30
"""Of 2,048 rays each: some ten minutes of one core."""
F3DGS_ROUNDS = 5
TOLD_EVERY_S = 10.0


@dataclass(frozen=True, kw_only=True)
class FieldSettings:
    """Size and length of every field: part of its key in the cache."""

    num_steps: int = FIELD_STEPS
    sizes: FieldConfig = field(default_factory=FieldConfig)
    fit: FitFieldConfig = field(default_factory=FitFieldConfig)

    def __post_init__(self) -> None:
        if self.num_steps < 1:
            raise BadInput(f"a field was given {self.num_steps} steps, expected at least 1.")

    def of(self, recipe: Recipe) -> FitFieldConfig:
        """With the steps, and the seed of a recipe."""
        return replace(self.fit, num_steps=self.num_steps, seed=recipe.train.seed)


Fitted = tuple[Field, int, tuple[Round, ...]]
"""A field, its number of parameters, and its rounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitTask:
    """What a field is fitted to, and how."""

    cell: Cell
    recipe: Recipe
    sizes: FieldConfig
    fit: FitFieldConfig
    pixels: PixelRays
    options: FitFieldOptions


Fit = Callable[[FitTask], Fitted]
RIVALS = ("field", "gp-nerf", "switch-nerf", "drone-nerf", "mega-nerf", "fednerf", "f3dgs")


def rival_arms(settings: FieldSettings) -> Mapping[str, Arm]:
    """All of them by name."""
    fits: Mapping[str, Fit] = {
        "field": partial(_fit_whole, make_field),
        "gp-nerf": partial(_fit_whole, lambda sizes, seed: make_gp_field(sizes, PlaneConfig(), seed)),
        "switch-nerf": partial(_fit_whole, lambda sizes, seed: make_switch_field(sizes, SwitchConfig(), seed)),
        "drone-nerf": _fit_drone,
        "mega-nerf": _fit_mega,
        "fednerf": _fit_fednerf,
    }
    arms = {
        name: Arm(name=name, make=partial(_make_field, name, fit, settings), recipe=_recipe_of(name), settings=settings, of_gaussians=False)
        for name, fit in fits.items()
    }
    return {**arms, "f3dgs": Arm(name="f3dgs", make=_make_f3dgs, recipe=lambda cell: cell.even)}


def _recipe_of(name: str) -> Callable[[Cell], Recipe]:
    """The devices' photographs count for federated learning alone."""
    return (lambda cell: cell.even) if name == "fednerf" else (lambda cell: cell.recipe)


def _make_field(name: str, fit: Fit, settings: FieldSettings, cell: Cell, recipe: Recipe) -> ArmModel:
    pixels = PixelRays.of(cell.scene.views, FieldBounds.of(cell.scene.training))
    options = FitFieldOptions(report=partial(_tell, name), report_every_s=TOLD_EVERY_S)
    task = FitTask(cell=cell, recipe=recipe, sizes=settings.sizes, fit=settings.of(recipe), pixels=pixels, options=options)
    begun_s = time.process_time()
    fitted, parameters, rounds = fit(task)
    cpu_s = time.process_time() - begun_s
    return ArmModel(
        images=tuple(_pictures(fitted, task)),
        num_parameters=parameters,
        cpu_s=cpu_s,
        training_px=float(settings.num_steps * settings.fit.rays_a_step),
        rounds=rounds,
    )


def _tell(name: str, progress: TrainProgress) -> None:
    # A line, since the bar of the rows may be drawn below it.
    if progress.step < progress.num_steps:
        typer.echo(f"{name}: step {progress.step} of {progress.num_steps}, loss {progress.loss:.4f}", err=True)


def _pictures(fitted: Field, task: FitTask) -> list[FloatArray]:
    cameras = task.cell.scene.held_out_views.cameras
    return [render_image(fitted, cameras, task.pixels.bounds, view, task.fit.sampling) for view in range(len(cameras))]


def _fit_whole(make: Callable[[FieldConfig, int], RadianceField], task: FitTask) -> Fitted:
    whole = make(task.sizes, task.fit.seed)
    fit_field(whole, task.pixels, task.fit, task.options)
    return whole, num_parameters(whole), ()


def _fit_mega(task: FitTask) -> Fitted:
    config = MegaConfig(columns=task.cell.layout.num_edges, rows=task.cell.layout.num_devices)
    joined = fit_mega(task.pixels, task.sizes, task.fit, config, task.options)
    return joined, num_parameters(joined), ()


def _fit_drone(task: FitTask) -> Fitted:
    config = DroneConfig(columns=task.cell.layout.num_edges, rows=task.cell.layout.num_devices)
    fused = fit_drone(task.cell.scene.training, task.pixels, task.sizes, task.fit, config, task.options).field
    return fused, num_parameters(fused), ()


def _fit_fednerf(task: FitTask) -> Fitted:
    clients = [task.pixels.of_views(rows) for rows in _photographs_of_devices(task.recipe)]
    fitted = fit_fed(clients, task.sizes, task.fit, FedConfig(), task.options)
    rounds = tuple(Round(sent_bytes=fitted.sent_bytes_a_round) for _ in range(fitted.num_rounds))
    return fitted.field, num_parameters(fitted.field), rounds


def _make_f3dgs(cell: Cell, recipe: Recipe) -> ArmModel:
    scene, views = cell.scene.training, cell.scene.views
    rows = _photographs_of_devices(recipe)
    clients = [views.select(rows_of_client) for rows_of_client in rows]
    config = F3dgsConfig(num_rounds=F3DGS_ROUNDS, num_steps=max(1, round(recipe.train.num_steps / F3DGS_ROUNDS)))
    begun_s = time.process_time()
    scaffold, _ = first_splats(scene, views, recipe.train)
    scores: list[float] = []
    scoring_s = [0.0]

    def score(number: int, splats: Splats) -> None:
        del number
        at_s = time.process_time()
        scores.append(_mean_psnr_db(splats, cell.scene.held_out_views))
        scoring_s[0] += time.process_time() - at_s

    result = f3dgs(scaffold, clients, recipe.train, config, FitOptions(backend=recipe.backend), score)
    cpu_s = time.process_time() - begun_s - scoring_s[0]
    rounds = tuple(Round(sent_bytes=result.sent_bytes_a_round, psnr_db=psnr) for psnr in scores)
    return ArmModel(splats=result.splats, cpu_s=cpu_s, training_px=float(result.num_training_pixels), rounds=rounds)


def _mean_psnr_db(splats: Splats, held_out: TrainingViews) -> float:
    pairs = zip(render_views(splats, held_out.cameras), held_out.images, strict=True)
    return float(np.mean([psnr_db(view.image, image / 255) for view, image in pairs]))


def _photographs_of_devices(recipe: Recipe) -> Sequence[list[int]]:
    """Rows of the training photographs, of the devices that have any."""
    rows_of_devices = [plan.cameras_of(device) for plan in recipe.edge_plans for device in plan.device_ids]
    return [[int(row) for row in rows] for rows in rows_of_devices if len(rows)]
