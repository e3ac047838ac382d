"""The main job: photographs in, one Gaussian model out. The order of the stages and what passes between them; nothing is computed here.

sfm → plan → Tree(cloud(edge(device …))) → evaluation → report
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.config import RunConfig
from radiant_app.dealing import Dealer, deal_files, evaluation_task
from radiant_app.events import Decided, Event, Listener, StageSkipped, Warned
from radiant_app.executors.emulated import EmulatedExecutor, emulated_figures, require_emulable
from radiant_app.executors.local import LocalExecutor, run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.nodes import read_notes
from radiant_app.run_folder import Manifest, opened_run
from radiant_app.sources import detect_source, source_files
from radiant_app.system_file import even_system, load_system
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import tree_of_plan
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import SSIM_WINDOW_PX
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_scene, save_plan, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.plan.device_split import split_edges
from radiant_core.plan.edge_sites import place_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.region_plan import PlanInfeasible, choose_method, plan_regions
from radiant_core.plan.system import System
from radiant_core.render.contract import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.initialize import initial_splats
from radiant_core.train.needs import fit_to_backend

REFERENCE_RETRAIN_STEPS = 100
"""Limit of an edge's retraining on the plain PyTorch backend."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a finished run left behind."""

    folder: Path
    metrics: dict[str, Any]
    """The content of metrics.json."""

    @property
    def report(self) -> Path:
        """The self-contained report."""
        return self.folder / "report.html"

    def load_splats(self) -> Splats:
        """The scene's Gaussians."""
        return load_ply(self.folder / "scene.ply")


@dataclass(frozen=True, kw_only=True)
class _Progress:
    """Who listens and which clock runs; passed through the stages."""

    manifest: Manifest
    listener: Listener
    clock: Callable[[], float]
    started_s: float

    def listen(self, event: Event) -> None:
        self.manifest.note(event, self.clock() - self.started_s)
        self.listener(event)
        if isinstance(event, StageSkipped):
            for noted in read_notes(self.manifest.folder / event.stage, event.stage):
                self.listen(noted)


def run(
    config: RunConfig, listen: Listener = lambda event: None, *, resume: bool = False, clock: Callable[[], float] = time.monotonic
) -> RunResult:
    """Run everything in `config.out`; finished stages are skipped with `resume`.

    Raises BadInput with one sentence for unusable input (nothing stays behind), StageFailed when a stage ends without its result
    (what is finished stays and can be resumed).
    """
    from radiant_app.report import write_report

    detect_source(config.source)
    system = even_system(2, 2) if config.system is None else load_system(config.system)
    if config.emulated:
        require_emulable(system)
    with opened_run(config, resume) as manifest:
        progress = _Progress(manifest=manifest, listener=listen, clock=clock, started_s=clock() - manifest.ended_s)
        scene, images = _sfm_stage(config, progress)
        held_out = held_out_mask(scene.cameras.names)
        training = scene.restricted_to(np.flatnonzero(~held_out))
        system, cloud_plan, edge_plans = _plan_stage(config, system, training, progress)
        train, aggregate, backend = _training_settings(config, progress)
        _require_size(scene, train)
        dealer = Dealer(
            run=config.out,
            images=images,
            scene=training,
            cloud_plan=cloud_plan,
            edge_plans=edge_plans,
            train=train,
            aggregate=aggregate,
            backend=backend,
        )
        tree = tree_of_plan(cloud_plan, edge_plans)
        manifest.keep_stages({"sfm", "evaluation", *(node.id for node in tree)})
        local = LocalExecutor(num_workers=config.num_workers, clock=clock)
        executor = EmulatedExecutor(system=system, local=local) if config.emulated else local
        executor.fold(tree, dealer.prepare, progress.listen)
        manifest.ledger = dealer.ledger
        _evaluation_stage(config, scene, train, (images, backend), progress)
        deal_files(config.out / "cloud", ["scene.ply"], config.out)
        for kind in ("photographs", "renders", "differences"):
            shutil.copytree(config.out / "evaluation" / kind, config.out / "pictures" / kind, dirs_exist_ok=True)
        emulation = emulated_figures(tree, manifest.emulated) if config.emulated else {}
        metrics = _write_metrics(config.out, manifest, cloud_plan, emulation)
        manifest.status = "done"
        write_report(config.out, manifest, metrics)
    return RunResult(folder=config.out, metrics=metrics)


def _sfm_stage(config: RunConfig, progress: _Progress) -> tuple[SfmScene, Path]:
    folder = config.out / "sfm"
    folder.mkdir(exist_ok=True)
    sfm = {"matching": config.matching, "seed": config.seed}
    write_json(folder / "task.json", {"source": str(config.source.resolve()), "sfm": sfm})
    key = content_key(__version__, sfm, source_files(config.source, config.out))
    run_task(NodeTask(kind="sfm", stage="sfm", folder=folder, key=key), progress.listen, progress.clock)
    scene = load_scene(folder / "scene.safetensors")
    if len(scene.cameras) < 3:
        raise BadInput(f"only {len(scene.cameras)} photographs could be placed, expected at least 3: take more that overlap.")
    if scene.frame.kind == "unscaled":
        message = "frame=unscaled: no usable GPS, lengths are in arbitrary units, not metres."
        progress.listen(Warned(stage="sfm", message=message))
    return scene, folder / read_json(folder / "result.json", ("images",))["images"]


def _plan_stage(
    config: RunConfig, system: System, training: SfmScene, progress: _Progress
) -> tuple[System, CloudPlan, tuple[EdgePlan, ...]]:
    positions = training.cameras.centers[:, :2]
    origin = training.frame.origin_lat_lon_alt if training.frame.kind == "metric" else None
    system = place_edges(system, positions, origin, config.seed)
    method, decisions = choose_method(config.plan_method, len(positions), len(system.edges))
    for decision in decisions:
        progress.listen(Decided(decision=decision))
    cloud_plan = plan_regions(positions, system, method=method)
    if isinstance(cloud_plan, PlanInfeasible):
        raise BadInput(f"plan: {cloud_plan.reason} Structure from motion is kept: change {config.system} and add --resume.")
    edge_plans = split_edges(positions, cloud_plan, system)
    save_plan(config.out / "plan.json", cloud_plan, edge_plans)
    return system, cloud_plan, edge_plans


def _training_settings(config: RunConfig, progress: _Progress) -> tuple[TrainConfig, AggregateConfig, str]:
    backend = resolve_backend("auto")
    preset = replace(train_preset(config.train_preset), seed=config.seed)
    train, decisions = fit_to_backend(preset, backend, config.overrides)
    aggregate = AggregateConfig(preset=config.aggregate_preset)
    if backend == "reference":
        aggregate = replace(aggregate, max_num_steps=REFERENCE_RETRAIN_STEPS)
        decisions = (*decisions, _retrain_decision())
    for decision in decisions:
        progress.listen(Decided(decision=decision))
    return train, aggregate, backend


def _require_size(scene: SfmScene, train: TrainConfig) -> None:
    width, height = min(scene.cameras.scaled(train.long_side_px).sizes_wh.tolist(), key=min)
    if min(width, height) < SSIM_WINDOW_PX:
        raise BadInput(
            f"with a long side of {train.long_side_px} px a photograph is {width} × {height} px, expected {SSIM_WINDOW_PX} or more a side "
            "for SSIM: raise --long-side-px."
        )


def _evaluation_stage(config: RunConfig, scene: SfmScene, train: TrainConfig, rendering: tuple[Path, str], progress: _Progress) -> None:
    images, backend = rendering
    folder = config.out / "evaluation"
    folder.mkdir(exist_ok=True)
    untrained = initial_splats(scene.points, scene.colors, scene.cameras, max_num_splats=train.max_num_splats, sh_degree=train.sh_degree)
    save_splats(folder / "initial.safetensors", untrained)
    held_out = scene.cameras.select(np.flatnonzero(held_out_mask(scene.cameras.names))).scaled(train.long_side_px)
    run_task(evaluation_task(config.out, images, held_out, backend), progress.listen, progress.clock)


def _write_metrics(run: Path, manifest: Manifest, cloud_plan: CloudPlan, more: dict[str, Any]) -> dict[str, Any]:
    result = read_json(run / "evaluation" / "result.json", ("images", "psnr_db"))
    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.stages.items()}
    planned = {"planned_makespan_s": cloud_plan.makespan_s, "plan_lower_bound_s": cloud_plan.lower_bound_s}
    metrics = {**result, "seconds": seconds, **planned, **more}
    write_json(run / "metrics.json", metrics)
    return metrics


def _retrain_decision() -> Decision:
    return Decision(
        stage="edges",
        topic="retraining",
        choice=f"at most {REFERENCE_RETRAIN_STEPS} steps",
        figure=float(REFERENCE_RETRAIN_STEPS),
        unit="steps",
        reason="ten epochs would take most of the run on the plain PyTorch backend",
    )
