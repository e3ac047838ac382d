"""What a device does: fit Gaussians to its photographs (paper Sec. III-A). Once per device.

    scene, photographs ─ leave out what adds nothing ─ one light ─ settle size and limits, where
                         asked for by trials ─ first Gaussians ─ fit → DeviceModel

The only place that prepares a training: device nodes, `radiant train` and the benchmarks call it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.decisions import Decision
from radiant_core.hierarchy.decisions import density_decision, fill_decision, shapes_decision, sky_decision
from radiant_core.hierarchy.messages import DeviceModel, DeviceTask
from radiant_core.hierarchy.reporter import Machine, OneOfSeveral, Reporter, fit_options
from radiant_core.io.run_store import content_key
from radiant_core.light.canonical import canonical_validation, canonical_views
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import resolve_backend
from radiant_core.render.contract import Backend
from radiant_core.render.gsplat_backend import free_vram_bytes
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import TrainConfig
from radiant_core.train.dense.seeding import seed_densely
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.extent import extent_decision
from radiant_core.train.few import Trial, choose_for_few, score_apart
from radiant_core.train.fill_in import NO_POINTS, AddedPoints, fill_in_points
from radiant_core.train.gates import choose_helpers, open_gates
from radiant_core.train.initialize import first_splats, sky_share
from radiant_core.train.memory import STATISTICS_BUDGET_BYTES, memory_plan, within_memory, within_vram
from radiant_core.train.needs import fit_to_views, most_splats
from radiant_core.train.results import TrainResult
from radiant_core.train.trainer import FitOptions, NoCheckpoints, fit_splats
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import worth_training


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedTraining:
    """A training that is ready to begin."""

    task: DeviceTask
    scene: SfmScene
    """That of the task without photographs that add nothing."""
    views: TrainingViews
    config: TrainConfig
    initial: Splats
    options: FitOptions

    @property
    def key(self) -> str:
        """Hash of all that decides the bits of the model."""
        return training_key(self.initial, self.views, self.config, self.options)


def train_device(
    task: DeviceTask, views: TrainingViews, reporter: Reporter, machine: Machine = Machine(), validation: TrainingViews | None = None
) -> DeviceModel:
    """Train the model of one device.

    Args:
        task: the scene and the settings.
        views: the photographs of the scene's cameras, in their order, at the training size.
        reporter: hears decisions, warnings and progress.
        machine: memory, checkpoints and clock.
        validation: views that only choose which state of the model is returned.

    Returns:
        The model, with the cameras of the task's scene.

    Raises:
        BadInput: the photographs or the settings cannot be used.
        StageFailed: the training diverges.
    """
    prepared = prepare_training(task, views, reporter, machine, validation)
    # What is trained on may be a copy in another light.
    del views, validation
    _warn_of_thinned(prepared, reporter)
    result = fit_prepared(prepared, reporter)
    return device_model(prepared, result)


def _warn_of_thinned(prepared: PreparedTraining, reporter: Reporter) -> None:
    """Where a limit beside that of the photographs' pixels leaves no room for the sparse points."""
    config, num_points = prepared.config, len(prepared.scene.points)
    law = most_splats(replace(config, max_num_splats=num_points), prepared.views)
    if isinstance(config.density, NoDensification) or not config.max_num_splats < min(num_points, law):
        return
    reporter.warn(
        f"{num_points:,} sparse points are thinned out to the limit of {config.max_num_splats:,} Gaussians, and hardly any can grow. "
        "On sixteen devices of 88 photographs twice the limit gained 1.2 dB (docs/experiments/paper_size.md). "
        "Raise --max-splats, or the memory where that sets the limit."
    )


def prepare_training(
    task: DeviceTask, views: TrainingViews, reporter: Reporter, machine: Machine = Machine(), validation: TrainingViews | None = None
) -> PreparedTraining:
    """Everything up to the first step of `train_device`, trials included where the settings ask for
    them, with the decisions taken on the way."""
    config, statistics_bytes = task.train, STATISTICS_BUDGET_BYTES
    if task.memory_bytes is not None:
        cameras = views.cameras if validation is None else concatenate_cameras([views.cameras, validation.cameras])
        masked, limit = views.weights is not None, int(task.memory_bytes)
        plan = memory_plan(config, cameras, limit, machine.base_bytes, validated=validation is not None, masked=masked)
        config, decision = within_memory(config, plan, limit, reporter.stage, config.max_num_splats)
        reporter.decide(decision)
        statistics_bytes = plan.statistics_bytes
    scene, views, decisions = worth_training(task.scene, views, config)
    _decide(reporter, decisions)
    views, lights, decisions = canonical_views(scene, views, config.light)
    _decide(reporter, decisions)
    trials = _Trials(task=task, scene=scene, views=views, reporter=reporter, machine=machine, statistics_bytes=statistics_bytes)
    filled = fill_in_points(scene, views) if config.fill_in else NO_POINTS
    helpers = choose_helpers(*open_gates(config, filled, views), views, trials.score)
    choice = choose_for_few(helpers.config, views, trials.score)
    config, heard = choice.config, reporter
    _decide(reporter, (*helpers.decisions, *choice.decisions))
    if trials.ended:
        heard = OneOfSeveral(reporter=reporter, before=trials.ended, work=1, whole=trials.ended + 1, name="the model itself")
    config, decisions = fit_to_views(config, views)
    _decide(reporter, decisions)
    if validation is not None and lights is not None:
        validation = canonical_validation(lights, scene, validation)
    config, decisions = _within_cuda(config, views.cameras, task.backend, reporter.stage)
    _decide(reporter, decisions)
    reporter.decide(sky_decision(reporter.stage, sky_share(views.cameras), wanted=config.sky))
    config, dense, decisions = seed_densely(config, scene, views)
    _decide(reporter, decisions)
    initial, num_filled = first_splats(scene, views, config, dense, filled)
    if config.fill_in or not helpers.decisions:
        added = fill_decision(reporter.stage, num_filled, len(scene.points), filled.placed, wanted=bool(config.fill_in))
        reporter.decide(replace(added, row="", otherwise="") if helpers.decisions else added)
    _decide(reporter, [extent_decision(views.cameras, initial, config.max_extent_per_distance)])
    bare = FitOptions(backend=task.backend, validation=validation)
    options = fit_options(task.backend, heard, machine, lambda: training_key(initial, views, config, bare))
    options = replace(options, validation=validation, statistics_bytes=statistics_bytes)
    return PreparedTraining(task=task, scene=scene, views=views, config=config, initial=initial, options=options)


def choose_for_share(
    task: DeviceTask, scene: SfmScene, views: TrainingViews, reporter: Reporter, machine: Machine, statistics_bytes: int
) -> tuple[TrainConfig, AddedPoints, Sequence[Decision]]:
    """The settings of the task with each helper of its own photographs on or off, by trials on
    these, which are in one light and worth training; and the points that are filled in."""
    trials = _Trials(task=task, scene=scene, views=views, reporter=reporter, machine=machine, statistics_bytes=statistics_bytes)
    filled = fill_in_points(scene, views) if task.train.fill_in else NO_POINTS
    choice = choose_helpers(*open_gates(task.train, filled, views), views, trials.score)
    return choice.config, filled if choice.config.fill_in else NO_POINTS, choice.decisions


@dataclass(kw_only=True, eq=False)
class _Trials:
    """Trainings of a task without some of its views, which are in one light, scored on these."""

    task: DeviceTask
    scene: SfmScene
    views: TrainingViews
    reporter: Reporter
    machine: Machine
    statistics_bytes: int
    ended: float = 0.0
    """Work of the trials that ended, the model's own training being 1."""

    def score(self, trial: Trial) -> FloatArray:
        """PSNR in dB of the views apart (K,), by a training or as it was kept."""
        views = self.views if trial.long_side_px is None else _reduced(self.views, trial.long_side_px)
        apart, trained_rows = views.select(np.flatnonzero(trial.held_out)), np.flatnonzero(~trial.held_out)
        name = f"trial {trial.number + 1} of {trial.most} at most"
        before, following = self.ended, trial.work * (trial.most - trial.number)
        self.ended += trial.work
        heard = OneOfSeveral(reporter=self.reporter, before=before, work=trial.work, whole=before + following + 1, name=name)
        # Views are in one light and worth training already, and memory has limited the Gaussians.
        config = replace(trial.config, light="none", skip_images="none")
        task = replace(self.task, scene=self.scene.restricted_to(trained_rows), train=config, memory_bytes=None)
        machine = replace(self.machine, checkpoints=lambda key: NoCheckpoints())
        prepared = prepare_training(task, views.select(trained_rows), heard, machine)
        key = content_key(prepared.key, training_key(prepared.initial, apart, config, FitOptions(backend=task.backend)))
        if (stored := self.machine.kept_scores.find(key)) is not None and len(stored) == len(apart):
            return stored
        result = fit_prepared(replace(prepared, options=replace(prepared.options, statistics_bytes=self.statistics_bytes)), heard)
        figures = score_apart(result.splats, apart, task.backend)
        self.machine.kept_scores.keep(key, figures)
        return figures


def _reduced(views: TrainingViews, long_side_px: int) -> TrainingViews:
    longest = int(views.cameras.sizes_wh.max())
    return views if longest <= long_side_px else views.scaled(long_side_px / longest)


def _within_cuda(config: TrainConfig, cameras: Cameras, backend: Backend, stage: str) -> tuple[TrainConfig, Sequence[Decision]]:
    free_bytes = free_vram_bytes(resolve_backend(backend))
    return (config, ()) if free_bytes is None else within_vram(config, cameras, free_bytes, stage)


def _decide(reporter: Reporter, decisions: Sequence[Decision]) -> None:
    for decision in decisions:
        reporter.decide(replace(decision, stage=reporter.stage))


def fit_prepared(prepared: PreparedTraining, reporter: Reporter) -> TrainResult:
    """Take the steps of a prepared training; reports density control and steps not taken."""
    result = fit_splats(prepared.initial, prepared.views, prepared.config, prepared.options)
    report_result(prepared.config, prepared.initial, result, reporter)
    return result


def report_result(config: TrainConfig, initial: Splats, result: TrainResult, reporter: Reporter) -> None:
    """Decisions of a training that show in its end, and steps that it did not take."""
    if config.density.kind != "none":
        reporter.decide(density_decision(reporter.stage, result.density, len(initial), len(result.splats)))
    if any(asdict(result.shapes).values()):
        reporter.decide(shapes_decision(reporter.stage, config, result.shapes))
    if result.num_rolled_back:
        reporter.warn(f"{result.num_rolled_back} of {result.num_steps:,} steps gave values that are not finite and were undone")


def device_model(prepared: PreparedTraining, result: TrainResult) -> DeviceModel:
    """The message of a trained model."""
    summary = {**training_summary(result), "num_photographs": len(prepared.views), "num_points": len(prepared.scene.points)}
    return DeviceModel(splats=result.splats, cameras=prepared.task.scene.cameras, initial=prepared.initial, summary=summary)


def training_summary(result: TrainResult) -> dict[str, float | int]:
    """What a node keeps of a training's figures."""
    return {
        "num_splats": len(result.splats),
        "model_bytes": result.splats.num_bytes,
        "num_steps": result.num_steps,
        "num_rolled_back": result.num_rolled_back,
        "train_s": result.seconds,
        "first_loss": result.first_loss,
        "last_loss": result.last_loss,
        **asdict(result.density),
        **asdict(result.shapes),
    }
