"""`radiant train`: one model of all training photographs of a scene, the centralised baseline.

    OUT/manifest.json metrics.json scene.ply         settings, held-out figures, model
    OUT/pictures/{photographs,renders,differences}/  held-out photographs beside their renders
    OUT/sfm/                                         where the source is no scene yet
    OUT/checkpoints/ done.json                       while it trains; once the model is whole
    OUT/trials.json                                  scores of --set train.cross_validate

With --out MODEL.ply the model alone is written, of a source that has a scene: nothing is scored,
and a kill starts again from nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.run.steps import require_file_to_be
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Decided, Event, Listener, Outlined, StageDone, StageProgress, StageSkipped, StageStarted, Warned
from radiant_app.files.out_folder import folder_made_for
from radiant_app.files.run_folder import Manifest, open_folder
from radiant_app.files.score_file import SCORES, ScoreFile
from radiant_app.report.ground_control import placing_of_run
from radiant_app.reporting import EventReporter
from radiant_app.run.pooled import require_size, sfm_stage
from radiant_app.run.progress import Progress
from radiant_app.workers.evaluation import HeldOutViews, score_images, select_scored
from radiant_app.workers.memory import base_bytes_in, peak_bytes, resident_bytes
from radiant_app.workers.score_files import summarize_scores
from radiant_app.workers.sources import captures_of, detect_source, has_scene, load_scored_scene, masks_folder_of
from radiant_app.workers.training import CHECKPOINTS, remove_checkpoints
from radiant_core.cameras import Cameras
from radiant_core.choices import Contradictions
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask, validation_mask
from radiant_core.georef.given_frame import load_given_frame, save_given_frame
from radiant_core.hierarchy.device import PreparedTraining, fit_prepared, prepare_training, training_summary
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Machine
from radiant_core.io.photos.listing import DECODED_BYTES_PER_PX
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.run_store import is_sealed, read_json, seal, write_json
from radiant_core.light.canonical import light_of_score
from radiant_core.light.captures import Captures
from radiant_core.light.solve import COMPARED_PX
from radiant_core.render.backends import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.sfm.intake import AS_FOUND, Intake
from radiant_core.sfm.world_frame.placement import AUTO, Placement
from radiant_core.splats import Splats
from radiant_core.train.checkpoint import CheckpointFolder
from radiant_core.train.config import CHECKPOINT_EVERY_S, NEVER, Preset, TrainConfig, train_preset
from radiant_core.train.few import NoKeptScores
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.photographs import load_training_views
from radiant_core.train.results import TrainResult
from radiant_core.train.views import TrainingViews

STAGE = "train"
MIN_PHOTOGRAPHS = 3
MIN_VALIDATED = 100
"""Fewer photographs are worth more in training than for choosing (experiments/training.md)."""
STEPS_OF_A_TIME = 10_000_000
"""Limit of steps where a time ends the training."""
WORTH_RESUMING = ("sfm/done.json", SCORES, f"{CHECKPOINTS}/*.json", "done.json")
"""What is worth resuming after an error."""


@dataclass(frozen=True, kw_only=True)
class TrainRequest:
    """What `radiant train` was asked for."""

    source: Path
    """A finished run, a folder of `radiant sfm`, a COLMAP project with images, or photographs."""
    out: Path
    """A folder, new or empty; or the name of a PLY."""
    preset: Preset = "default"
    overrides: Overrides = Overrides()
    time_s: float | None = None
    """Seconds of training, loading and scoring apart; None: as many steps as the preset says."""
    masks: Path | None = None
    """Folder of masks, see `radiant_core.io.photos.masks`; not with a scene, which has its own."""
    poses: Path | None = None
    """Alignment to use, as `SfmOptions.poses`; not with a scene, which has its poses."""
    refine_poses: bool = False
    """As `SfmOptions.refine_poses`; not with a scene either."""
    intake: Intake = AS_FOUND
    """Not with a scene either."""
    up: str | None = None
    """Which way is up; like the next two a field of `Placement`, and not with a scene."""
    distance: str | None = None
    height_m: float | None = None
    contradictions: Contradictions = "stop"
    memory_bytes: int | None = None
    """What the process may hold; None: as much as the preset's Gaussians take."""
    validate: bool | None = None
    """Whether an eighth of them only chooses the model; None: from `MIN_VALIDATED` on."""
    seed: int = 0
    checkpoint_every_s: float = CHECKPOINT_EVERY_S

    def __post_init__(self) -> None:
        for name, value, unit in (("--time", self.time_s, "seconds"), ("--checkpoint-every", self.checkpoint_every_s, "seconds")):
            if value is not None and not 0 < value < np.inf:
                raise BadInput(f"{name} is {value}, expected a positive number of {unit}.")
        Placement(up=self.up or AUTO, distance=self.distance, height_m=self.height_m)
        if self.time_s is not None and self.overrides.settings.get("cross_validate") == "always":
            raise BadInput(
                "--time is how long one training takes, and --set train.cross_validate=always asks for up to eight before it: "
                "leave one of them out."
            )

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides the result, as the manifest keeps it."""
        masks = None if self.masks is None else str(self.masks.resolve())
        poses = None if self.poses is None else str(self.poses)
        fields = {**asdict(self), **asdict(self.intake), "source": str(self.source.resolve()), "masks": masks, "poses": poses}
        return {name: value for name, value in fields.items() if name not in ("out", "checkpoint_every_s", "intake")}


def train(
    request: TrainRequest, listen: Listener = lambda event: None, *, resume: bool = False, clock: Callable[[], float] = time.monotonic
) -> dict[str, Any]:
    """Train one model of all photographs of a source and score it on those held out.

    Args:
        request: source, output and settings.
        listen: receives the events of the training.
        resume: go on with what an interrupted training left in the output folder.
        clock: seconds, for tests.

    Returns:
        The content of metrics.json, or figures of the training for a single PLY.

    Raises:
        BadInput: unusable input, in one sentence; nothing stays behind.
        StageFailed: the training diverges.
    """
    if request.out.suffix.lower() == ".ply":
        return _single_ply(request, listen, resume, clock)
    with open_folder(request.out, request.settings, resume, WORTH_RESUMING) as manifest:
        progress = Progress(manifest=manifest, listener=listen, clock=clock, started_s=clock() - manifest.ended_s)
        listen(Outlined(stages=(*(() if has_scene(request.source) else ("sfm",)), STAGE, "evaluation")))
        scene, photos = _scene_and_photos(request, progress)

        def emit(event: Event) -> None:
            manifest.record(event, clock() - progress.started_s)
            listen(event)

        with Stage(STAGE, emit, clock) as stage:
            training = _prepare(request, scene, photos, stage)
            model, summary = _train_model(training, request, stage)
        with Stage("evaluation", emit, clock) as stage:
            held_out = scene.cameras.select(np.flatnonzero(held_out_mask(scene.cameras.names))).scaled(training.config.long_side_px)
            figures = _score_model(request.out, (model, training), held_out, photos, stage)
        placing = placing_of_run(request.source if has_scene(request.source) else request.out)
        metrics = {**figures, **placing, "num_photographs": len(scene.cameras), "training": summary, **_totals(manifest, len(model))}
        write_json(request.out / "metrics.json", metrics)
        return metrics


class Stage:
    """One stage of this process: tells when it begins and ends."""

    def __init__(self, name: str, emit: Listener, clock: Callable[[], float]) -> None:
        self.name, self.emit, self._clock = name, emit, clock
        self._begun_s = clock()

    def __enter__(self) -> Stage:
        self.emit(StageStarted(stage=self.name))
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.emit(StageDone(stage=self.name, seconds=self._clock() - self._begun_s))

    @property
    def reporter(self) -> EventReporter:
        """What its training reports to."""
        return EventReporter(stage=self.name, emit=self.emit)


@dataclass(frozen=True, kw_only=True)
class _Photos:
    """The folders of a scene's photographs and of their masks, and what EXIF says of them."""

    images: Path
    masks: Path | None
    captures: Captures


def _scene_and_photos(request: TrainRequest, progress: Progress) -> tuple[SfmScene, _Photos]:
    """The scene of the source and its photographs; by structure from motion if it has none yet."""
    if has_scene(request.source):
        return _load_scene(request, progress.listen)
    detect_source(request.source, request.poses)
    config = RunConfig(
        source=request.source,
        out=request.out,
        seed=request.seed,
        sfm=SfmOptions(
            poses=request.poses,
            refine_poses=request.refine_poses,
            masks=request.masks,
            **asdict(request.intake),
            up=request.up,
            distance=request.distance,
            height_m=request.height_m,
            contradictions=request.contradictions,
        ),
    )
    scene, images = sfm_stage(config, progress, request.memory_bytes)
    return scene, _Photos(images=images, masks=masks_folder_of(request.out), captures=captures_of(request.out))


def _load_scene(request: TrainRequest, listen: Listener) -> tuple[SfmScene, _Photos]:
    if (request.up, request.distance, request.height_m) != (None, None, None):
        raise BadInput(
            f"{request.source} is a scene, which has its frame: give --up, --distance and --height to `radiant sfm` or `radiant run` when "
            "it is made, or train from the photographs."
        )
    if request.poses is not None or request.refine_poses:
        raise BadInput(
            f"{request.source} is a scene, which has its poses: leave out --poses and --refine-poses, or train from the photographs."
        )
    if request.masks is not None or request.intake != AS_FOUND:
        raise BadInput(
            f"{request.source} is a scene, whose photographs may have been undistorted since: give --masks to `radiant sfm` or "
            "`radiant run` when it is made, or train from the photographs."
        )
    scene, warnings, images = load_scored_scene(request.source)
    source_frame = load_given_frame(request.source)
    if source_frame is not None and request.out.is_dir():
        save_given_frame(request.out, source_frame)
    for message in warnings:
        listen(Warned(stage=STAGE, message=message))
    return scene, _Photos(images=images, masks=masks_folder_of(request.source), captures=captures_of(request.source))


def _prepare(request: TrainRequest, scene: SfmScene, photos: _Photos, stage: Stage) -> PreparedTraining:
    base_bytes = resident_bytes()
    if len(scene.cameras) < MIN_PHOTOGRAPHS:
        raise BadInput(f"the scene has {len(scene.cameras)} photographs, expected at least {MIN_PHOTOGRAPHS}: take more that overlap.")
    backend = resolve_backend("auto")
    config, decisions = _resolve_config(request, backend)
    require_size(scene, config.long_side_px)
    if request.memory_bytes is not None and request.overrides.max_num_splats is None:
        # As many as the memory holds, whatever the preset says.
        config = replace(config, max_num_splats=NEVER)
    held_out = held_out_mask(scene.cameras.names)
    num_training = len(held_out) - int(held_out.sum())
    validate = num_training >= MIN_VALIDATED if request.validate is None else request.validate
    validated = validation_mask(scene.cameras.names) & validate
    if validate and validated.sum() + held_out.sum() >= len(held_out):
        raise BadInput(f"of {len(held_out)} photographs none is left to train on: leave out --validate.")
    for decision in (*decisions, _validation_decision(request, num_training, int(validated.sum()))):
        stage.emit(Decided(decision=decision))

    def views_of(chosen: NDArray[np.bool_]) -> TrainingViews:
        return load_training_views(photos.images, scene.cameras.select(np.flatnonzero(chosen)).scaled(config.long_side_px), photos.masks)

    if request.memory_bytes is not None and request.out.is_dir():
        base_bytes = base_bytes_in(request.out, base_bytes)
    # Held-out photographs are decoded one by one beside the finished model.
    base_bytes += DECODED_BYTES_PER_PX * int(scene.cameras.sizes_wh.prod(axis=1).max())
    training = scene.restricted_to(np.flatnonzero(~held_out & ~validated))
    task = DeviceTask(scene=training, train=config, backend=backend, memory_bytes=request.memory_bytes)
    validation = views_of(validated) if validate else None
    kept_scores = ScoreFile(request.out / SCORES, stage.reporter.warn) if request.out.is_dir() else NoKeptScores()
    machine = Machine(base_bytes=base_bytes, kept_scores=kept_scores)
    return prepare_training(task, views_of(~held_out & ~validated), stage.reporter, machine, validation)


def _validation_decision(request: TrainRequest, num_training: int, num_validated: int) -> Decision:
    return Decision(
        stage=STAGE,
        topic="validation",
        choice=f"{num_validated} photographs only choose the best model" if num_validated else "the last model is returned",
        figure=float(num_training),
        unit="training photographs",
        reason=f"with {MIN_VALIDATED} or more photographs an eighth is set aside for this; with fewer, all are worth more in training",
        forced=request.validate is not None,
    )


def _resolve_config(request: TrainRequest, backend: str) -> tuple[TrainConfig, tuple[Decision, ...]]:
    config, decisions = fit_to_backend(replace(train_preset(request.preset), seed=request.seed), backend, request.overrides)
    if request.time_s is None:
        return config, decisions
    config = replace(config, budget_s=request.time_s, num_steps=request.overrides.num_steps or STEPS_OF_A_TIME)
    budget = Decision(
        stage=STAGE,
        topic="budget",
        choice="the training ends by time" + (", or by steps if they come first" if request.overrides.num_steps else ""),
        figure=request.time_s,
        unit="s",
        reason="asked for on the command line",
        forced=True,
    )
    # What the preset's steps were cut to says nothing where a time ends the training.
    return config, (budget, *(decision for decision in decisions if decision.topic != "num_steps" or request.overrides.num_steps))


def _train_model(training: PreparedTraining, request: TrainRequest, stage: Stage) -> tuple[Splats, dict[str, Any]]:
    """The model and a summary of its training: taken from the folder if whole, else trained on."""
    out = request.out
    if is_sealed(out, training.key):
        record = read_json(out / "training.json")
        for decision in record["decisions"]:
            stage.emit(Decided(decision=Decision(**decision)))
        for message in record["warnings"]:
            stage.emit(Warned(stage=STAGE, message=message))
        stage.emit(StageSkipped(stage=STAGE))
        remove_checkpoints(out)
        return load_ply(out / "scene.ply"), record["summary"]
    recorded: list[Event] = []

    def emit(event: Event) -> None:
        recorded.append(event)
        stage.emit(event)

    reporter = EventReporter(stage=STAGE, emit=emit)
    # Checkpoints of another training are refused; a node of a run removes them.
    checkpoints = CheckpointFolder(out / CHECKPOINTS, training.key, every_s=request.checkpoint_every_s, warn=stage.reporter.warn)
    result = fit_prepared(replace(training, options=replace(training.options, checkpoints=checkpoints)), reporter)
    summary = {**training_summary(result), "num_photographs": len(training.views), **_validation_figures(result)}
    save_ply(out / "scene.ply", result.splats)
    record = {
        "summary": summary,
        "decisions": [asdict(event.decision) for event in recorded if isinstance(event, Decided)],
        "warnings": [event.message for event in recorded if isinstance(event, Warned)],
    }
    write_json(out / "training.json", record)
    seal(out, training.key, ["scene.ply", "training.json"])
    remove_checkpoints(out)
    return result.splats, summary


def _validation_figures(result: TrainResult) -> dict[str, Any]:
    if result.best_step is None:
        return {}
    return {"best_step": result.best_step, "validation": [{"step": step, "psnr_db": figure} for step, figure in result.validation]}


def _score_model(out: Path, models: tuple[Splats, PreparedTraining], cameras: Cameras, photos: _Photos, stage: Stage) -> dict[str, Any]:
    """Figures of the trained and the first model on the held-out photographs; writes the
    pictures."""
    model, training = models
    cameras, used = select_scored(cameras, photos.masks, lambda message: stage.emit(Warned(stage=stage.name, message=message)))
    light = None
    if training.config.light != "none":
        trained = load_training_views(photos.images, training.scene.cameras.scaled(COMPARED_PX), photos.masks)
        light = light_of_score(model, trained, cameras, photos.captures, training.config.light)
    if light is not None:
        stage.emit(Decided(decision=light.decision(stage.name)))
    paths = [photos.images / name for name in cameras.names]
    views = HeldOutViews(cameras=cameras, photographs=paths, used=used, initial=training.initial, light=light)
    rows = []
    for image in score_images(model, cameras, views):
        image.save(out / "pictures")
        rows.append(image.row)
        stage.emit(StageProgress(stage=stage.name, done=len(rows), total=len(cameras), note=image.view.name))
    return summarize_scores(rows, lpips_network=None)


def _totals(manifest: Manifest, num_splats: int) -> dict[str, Any]:
    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.stages.items()}
    costs = {"peak_bytes": {**manifest.peak_bytes, STAGE: peak_bytes()}, "cpu_s": {**manifest.cpu_s, STAGE: time.process_time()}}
    return {"num_gaussians": num_splats, "seconds": seconds, **costs}


def _single_ply(request: TrainRequest, listen: Listener, resume: bool, clock: Callable[[], float]) -> dict[str, Any]:
    if resume:
        raise BadInput(f"{request.out} is a file and keeps no checkpoints: give a folder as --out to resume.")
    require_file_to_be(request.out)
    if not has_scene(request.source):
        detect_source(request.source, request.poses)
        raise BadInput(
            f"{request.source} holds no scene yet, which a training into the single file {request.out.name} needs: give a folder as --out, "
            "which gets scene and model, or the folder that 'radiant sfm' made of it."
        )
    scene, photos = _load_scene(request, listen)
    decisions: list[Decision] = []

    def emit(event: Event) -> None:
        if isinstance(event, Decided):
            decisions.append(event.decision)
        listen(event)

    with Stage(STAGE, emit, clock) as stage:
        training = _prepare(request, scene, photos, stage)
        result = fit_prepared(training, stage.reporter)
    with folder_made_for(request.out):
        save_ply(request.out, result.splats)
    return {**training_summary(result), "decisions": [asdict(decision) for decision in decisions], "model": str(request.out)}
