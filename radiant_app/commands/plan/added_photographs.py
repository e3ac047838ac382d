"""`radiant join RUN --photographs NEW`: a finished model refined where new photographs show it.

    OUT/manifest.json metrics.json scene.ply    figures before and after, the refined model
    OUT/sfm/                                    the run's cameras, as they were, and the new ones
    OUT/pictures/                               held-out photographs beside their renders
    OUT/known_change.tif .png report.html       what is known of each cell before and after

OUT is a folder as `radiant train` makes one: every command that takes such a folder takes it, this
one again too.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.plan.before_after import CHANGE_NAME, PICTURE_NAME, BeforeAfter, known_before_after, write_before_after
from radiant_app.commands.run.train import Stage
from radiant_app.commands.survey.parts import Survey, load_survey
from radiant_app.commands.survey.surface import photographs_of_survey
from radiant_app.config.fields import train_options, values_of
from radiant_app.events import Decided, Event, Outlined, StageProgress, Warned
from radiant_app.files.run_folder import Manifest, create_folder, read_manifest
from radiant_app.report.added_page import write_added_page
from radiant_app.report.ground_control import placing_of_run
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.dealing import deal_files, deal_masks
from radiant_app.workers.evaluation import HeldOutViews, score_images, select_scored
from radiant_app.workers.score_files import summarize_scores
from radiant_app.workers.sources import captures_of, masks_folder_of
from radiant_core.aggregate.added_views import RefinedModel, refine_with_views
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.georef.given_frame import load_given_frame, save_given_frame
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_scene
from radiant_core.io.run_store import write_json
from radiant_core.light.canonical import light_of_score
from radiant_core.light.captures import save_captures
from radiant_core.light.solve import COMPARED_PX
from radiant_core.render.backends import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.sfm.adding import AddedPhotographs, add_photographs
from radiant_core.sfm.config import SfmConfig
from radiant_core.splats import Splats
from radiant_core.train.config import NEVER, Preset, TrainConfig, train_preset
from radiant_core.train.needs import Overrides, fit_to_backend, fit_to_cameras
from radiant_core.train.photographs import load_training_views
from radiant_core.train.trainer import FitOptions

STAGES = ("sfm", "train", "evaluation", "cells")
STEPS_SHARE = 1 / 3
"""Of the steps of a new training; docs/experiments/again.md has what more of them bring."""
MIN_SPLIT = 3
"""Fewer new photographs are all trained on."""


@dataclass(frozen=True, kw_only=True)
class AddedRequest:
    """What was asked for."""

    run: Path
    photographs: Path
    out: Path
    num_epochs: int | None = None
    """Times each photograph that is fitted is shown; None: `STEPS_SHARE` of the steps of a new
    training."""


def extend_by_photographs(request: AddedRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the refined run into the new folder `out`, whole or not at all.

    Args:
        request: the run, the folder of new photographs and the output.
        display: shows progress.

    Returns:
        Figures for the command line.

    Raises:
        BadInput: the run lacks its model or its photographs, none of the new ones can be placed, or
            they show nothing of the model.
        StageFailed: structure from motion or the training gives up.
    """
    if not request.photographs.is_dir():
        raise BadInput(f"{request.photographs} is no folder: give the folder of the new photographs.")
    before = load_survey(request.run, as_trained=True)
    images = _require_photographs(before)
    options = _training_of(request.run)
    with create_folder(request.out, whole=True):
        record = Manifest(folder=request.out, config=_settings(request, options))
        started_s = time.monotonic()

        def emit(event: Event) -> None:
            record.record(event, time.monotonic() - started_s)
            display(event)

        work = _Work(request=request, before=before, images=images, options=options, emit=emit)
        with display:
            emit(Outlined(stages=STAGES))
            placed, new_held_out = work.place()
            refined = work.refine(placed, new_held_out)
            metrics = work.score(placed, refined, new_held_out)
        change = work.compare(display)
        metrics["cells"] = change.figures()
        metrics["seconds"] = {stage: times["ended_s"] - times["started_s"] for stage, times in record.stages.items()}
        write_json(request.out / "metrics.json", metrics)
        write_added_page(request.out, metrics, record, PICTURE_NAME)
        record.status = "done"
        record.save()
    return _printed(request, metrics)


def _require_photographs(survey: Survey) -> Path:
    """The folder of the run's photographs; BadInput where it lacks what extending needs."""
    images, names = photographs_of_survey(survey), survey.run.scene.cameras.names
    folder = survey.run.folder
    if survey.run.in_field:
        raise BadInput(f"the photographs of {folder} stayed on its devices, and new ones are placed against them: make a new run of all.")
    missing = names if images is None else [name for name in names if not (images / name).is_file()]
    if images is None or missing:
        raise BadInput(
            f"{len(missing)} of the {len(names)} photographs of {folder} are not at hand ({missing[0]}), and new ones are placed against "
            "them: put them back, or make a new run of all."
        )
    return images


def _training_of(run: Path) -> tuple[Preset, Overrides]:
    """Preset and what differs from it, of the run's training."""
    config = read_manifest(run).config
    if "validate" in config:
        return config["preset"], Overrides(**config["overrides"])
    options = train_options(values_of({"train": config.get("train", {})}, "manifest"))
    return options.preset, options.overrides


def _settings(request: AddedRequest, options: tuple[Preset, Overrides]) -> dict[str, Any]:
    preset, overrides = options
    return {
        "source": str(request.run.resolve()),
        "photographs": str(request.photographs.resolve()),
        "preset": preset,
        "overrides": asdict(overrides),
        "num_epochs": request.num_epochs,
        "validate": False,
        "seed": 0,
    }


@dataclass(frozen=True, kw_only=True)
class _Work:
    """The stages of one extension, in their order."""

    request: AddedRequest
    before: Survey
    images: Path
    options: tuple[Preset, Overrides]
    emit: Any

    @property
    def folder(self) -> Path:
        return self.request.out / "sfm"

    @property
    def photographs(self) -> Path:
        """The folder of all photographs, undistorted."""
        return self.folder / "images"

    def place(self) -> tuple[AddedPhotographs, frozenset[str]]:
        """Place the new photographs and write sfm/; also which of them are held out."""
        run, scene = self.request.run, self.before.run.scene
        with Stage("sfm", self.emit, time.monotonic) as stage:
            self.folder.mkdir()
            with TemporaryDirectory(dir=self.folder) as work:
                placed = add_photographs(scene, self.images, self.request.photographs, Path(work), SfmConfig(), stage.reporter.sfm_progress)
                deal_files(self.images, scene.cameras.names, self.photographs)
                deal_files(placed.images, placed.scene.cameras.names[placed.num_before :], self.photographs)
            masks = deal_masks(run, scene.cameras.names, self.folder)
            save_scene(self.folder / "scene.safetensors", placed.scene)
            record = {"images": "images", "unregistered": list(placed.unplaced), **({"masks": masks[0].name} if masks else {})}
            write_json(self.folder / "result.json", record)
            save_captures(self.folder, captures_of(run))
            if (frame := load_given_frame(run)) is not None:
                save_given_frame(self.request.out, frame)
            for message in placed.warnings:
                stage.emit(Warned(stage="sfm", message=message))
            new = placed.scene.cameras.names[placed.num_before :]
            mask = held_out_mask(new) & (len(new) >= MIN_SPLIT)
            stage.emit(Decided(decision=_split_decision(len(new), int(mask.sum()))))
        return placed, frozenset(name for name, is_held in zip(new, mask, strict=True) if is_held)

    def config(self, scene: SfmScene) -> TrainConfig:
        """The settings of the run's training, of a new one of all these photographs."""
        preset, overrides = self.options
        config, _ = fit_to_backend(train_preset(preset), resolve_backend("auto"), overrides)
        return fit_to_cameras(config, scene.cameras.scaled(config.long_side_px))[0]

    def refine(self, placed: AddedPhotographs, new_held_out: frozenset[str]) -> RefinedModel:
        """Fit the model to the new photographs and the old ones beside them, and write it."""
        held_out = self.before.run.held_out | new_held_out
        with Stage("train", self.emit, time.monotonic) as stage:
            names = placed.scene.cameras.names
            rows = np.array([row for row, name in enumerate(names) if name not in held_out])
            scene = placed.scene.restricted_to(rows)
            config = self.config(scene)
            views = load_training_views(self.photographs, scene.cameras.scaled(config.long_side_px), masks_folder_of(self.request.out))
            num_steps = max(1, round(STEPS_SHARE * config.num_steps))
            is_new = rows >= placed.num_before
            options = FitOptions(
                report=lambda progress: stage.reporter.progress(progress.step, progress.num_steps, f"loss {progress.loss:.4f}")
            )
            epochs = self.request.num_epochs
            config = replace(config, num_steps=num_steps if epochs is None else NEVER, max_epochs=epochs)
            refined = refine_with_views(self.before.splats, scene, views, is_new, config, options)
            for decision in (*refined.decisions, _touched_decision(refined, is_new)):
                stage.reporter.decide(decision)
            save_ply(self.request.out / "scene.ply", refined.splats)
        return refined

    def score(self, placed: AddedPhotographs, refined: RefinedModel, new_held_out: frozenset[str]) -> dict[str, Any]:
        """Figures of the model before and after on all held-out photographs, for metrics.json."""
        names = placed.scene.cameras.names
        held_out = self.before.run.held_out | new_held_out
        rows = np.array([row for row, name in enumerate(names) if name in held_out], np.int64)
        config, out = self.config(placed.scene), self.request.out
        with Stage("evaluation", self.emit, time.monotonic) as stage:
            before = _scores(self, self.before.splats, placed.scene, rows, config, stage, None) if len(rows) else []
            after = _scores(self, refined.splats, placed.scene, rows, config, stage, out / "pictures") if len(rows) else []
        for row, earlier in zip(after, before, strict=True):
            row["before_psnr_db"] = earlier["psnr_db"]
            row["is_new"] = row["name"] in new_held_out
        scores = summarize_scores(after, lpips_network=None) if after else {"images": [], "psnr_db": None}
        extension = {
            "new_photographs": len(names) - placed.num_before,
            "unplaced": list(placed.unplaced),
            "moved": int(refined.moved.sum()),
            "unchanged": int((~refined.moved).sum()),
            "added": refined.num_added,
            "views": len(refined.views),
            "steps": refined.num_steps,
        }
        metrics = {**scores, **placing_of_run(out), "num_photographs": len(names), "num_gaussians": len(refined.splats)}
        write_json(out / "metrics.json", {**metrics, "extension": extension})
        return {**metrics, "extension": extension}

    def compare(self, display: ProgressDisplay) -> BeforeAfter:
        """What is known of each cell before and after; writes map and picture."""
        with Stage("cells", self.emit, time.monotonic):
            after = load_survey(self.request.out, as_trained=True)
            change = known_before_after(after, self.before, display)
            write_before_after(change, self.request.out)
        return change


def _scores(  # noqa: PLR0913
    work: _Work, model: Splats, scene: SfmScene, rows: NDArray[np.int64], config: TrainConfig, stage: Stage, pictures: Path | None
) -> list[dict[str, Any]]:
    """Figures of a model on the photographs of these rows of the scene, each in its own light."""
    masks, warn = masks_folder_of(work.request.out), stage.reporter.warn
    cameras, used = select_scored(scene.cameras.select(rows).scaled(config.long_side_px), masks, warn)
    light = None
    if config.light != "none":
        trained = scene.cameras.select(np.setdiff1d(np.arange(len(scene.cameras)), rows)).scaled(COMPARED_PX)
        captures = captures_of(work.request.out)
        light = light_of_score(model, load_training_views(work.photographs, trained, masks), cameras, captures, config.light)
    views = HeldOutViews(cameras=cameras, photographs=[work.photographs / name for name in cameras.names], used=used, light=light)
    figures = []
    for image in score_images(model, cameras, views):
        if pictures is not None:
            image.save(pictures)
        figures.append(image.row)
        stage.emit(StageProgress(stage=stage.name, done=len(figures), total=len(cameras), note=image.view.name))
    return figures


def _split_decision(count: int, num_held_out: int) -> Decision:
    return Decision(
        stage="sfm",
        topic="new photographs held out",
        choice=f"{num_held_out} of {count}",
        figure=float(num_held_out),
        unit="photographs",
        reason="every eighth by name, as in a run" if num_held_out else f"fewer than {MIN_SPLIT} are worth more in training",
    )


def _touched_decision(refined: RefinedModel, is_new: NDArray[np.bool_]) -> Decision:
    count, num_old = int(refined.moved.sum()), len(refined.views) - int(is_new.sum())
    return Decision(
        stage="train",
        topic="refined part",
        choice=f"{count:,} of {len(refined.moved):,} Gaussians move, {refined.num_added:,} are added, {num_old} old photographs are shown",
        figure=100 * count / max(1, len(refined.moved)),
        unit="% of the model",
        reason="what new photographs show moves, all else keeps its bits",
    )


def _printed(request: AddedRequest, metrics: dict[str, Any]) -> dict[str, Any]:
    rows: Sequence[dict[str, Any]] = metrics["images"]
    extension = metrics["extension"]
    scored = {f"{row['name']}": f"{row['before_psnr_db']:.2f} → {row['psnr_db']:.2f} dB" for row in rows}
    return {
        **{name: extension[name] for name in ("new_photographs", "moved", "unchanged", "added", "steps")},
        **({"unplaced": ", ".join(extension["unplaced"])} if extension["unplaced"] else {}),
        "held_out": "; ".join(f"{name} {figure}" for name, figure in scored.items()) or "none",
        **metrics["cells"],
        "map": str(request.out / CHANGE_NAME),
        "report": str(request.out / "report.html"),
        "model": str(request.out / "scene.ply"),
    }
