"""The main job: photographs in, one Gaussian model out. The order of the stages and what passes between them; nothing is computed here.

sfm → plan → Tree(cloud(edge(device …))) → evaluation → report
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import Listener, Outlined, Warned
from radiant_app.executors.emulated import emulated_figures, require_emulable
from radiant_app.executors.fold import Faults
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.ray_cluster import require_cluster
from radiant_app.files.event_file import EventFile
from radiant_app.files.run_folder import Manifest, opened_run
from radiant_app.files.system_file import even_system, load_system
from radiant_app.run.config import RunConfig
from radiant_app.run.dealing import SharedDealer, deal_files, evaluation_task, received
from radiant_app.run.field import run_in_the_field
from radiant_app.run.prediction_error import prediction_of
from radiant_app.run.promises import promises_of
from radiant_app.run.rescue import Rescue, plan_key, replanned
from radiant_app.run.source_key import source_key
from radiant_app.run.sources import detect_source, sfm_task
from radiant_app.run.stages import (
    Progress,
    counted,
    counting_down,
    executor_of,
    nodes_of,
    plan_stage,
    require_plan,
    training_settings,
    with_uploads,
)
from radiant_app.workers.evaluation import LPIPS_NAME, PICTURE_KINDS
from radiant_app.workers.memory import peak_bytes
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.image_error import SSIM_WINDOW_PX
from radiant_core.evaluate.lpips import MIN_SIDE_PX, LpipsNetwork, load_lpips, save_lpips
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene, save_splats
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.signing import keeps_modes
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.initialize import initial_splats

NO_MODES = (
    "the disk of {out} keeps no access rights (NTFS, exFAT, a network drive?): whoever can read it can read the keys that this run signs "
    "its models and tasks with, and sign in their place. Where that matters, choose a folder on another disk."
)


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


def run(
    config: RunConfig, listen: Listener = lambda event: None, *, resume: bool = False, clock: Callable[[], float] = time.monotonic
) -> RunResult:
    """Run everything in `config.out`; finished stages are skipped with `resume`.

    Raises BadInput with one sentence for unusable input (nothing stays behind), StageFailed when a stage ends without its result
    (what is finished stays and can be resumed).
    """
    from radiant_app.report.html import write_report

    if config.frames == "shared":
        detect_source(config.source)
    system = even_system(2, 2) if config.system is None else load_system(config.system)
    if config.emulated:
        require_emulable(system)
    if config.plan is not None:
        require_plan(config.plan, system)
    if config.address is not None:
        require_cluster(config.address)
    lpips = None if config.lpips_weights is None else load_lpips(config.lpips_weights, config.lpips_network)
    with opened_run(config, resume) as manifest, EventFile(config.out, listen) as heard:
        if lpips is not None:
            (config.out / "evaluation").mkdir(exist_ok=True)
            save_lpips(config.out / "evaluation" / LPIPS_NAME, lpips)
        progress = Progress(manifest=manifest, listener=heard, clock=clock, started_s=clock() - manifest.ended_s)
        if not keeps_modes(config.out):
            progress.listen(Warned(stage="run", message=NO_MODES.format(out=config.out)))
        more: dict[str, Any] = {"executor": config.executor}
        if config.frames == "shared":
            cloud_plan, tree, refused = _run_shared(config, system, progress)
            more["missing"] = refused
        else:
            cloud_plan, tree = run_in_the_field(config, system, progress)
        deal_files(config.out / "cloud", ["scene.ply"], config.out)
        emulation = emulated_figures(tree, manifest.emulated) if config.emulated else {}
        metrics = _write_metrics(config, manifest, cloud_plan, {**emulation, **more})
        manifest.status = "done"
        write_report(config.out, manifest, metrics)
    return RunResult(folder=config.out, metrics=metrics)


def _run_shared(config: RunConfig, system: System, progress: Progress) -> tuple[CloudPlan, Tree, dict[str, str]]:
    """One owner has all photographs: structure from motion once, then everything as planned. Ends with evaluation/result.json.

    The last of what it returns: devices whose models were refused, with the reasons. StageFailed where all were.
    """
    progress.listen(Outlined(stages=("sfm", *nodes_of(system), "evaluation")))
    scene, images = sfm_stage(config, progress)
    held_out = held_out_mask(scene.cameras.names)
    training = scene.restricted_to(np.flatnonzero(~held_out))
    origin = training.frame.origin_lat_lon_alt if training.frame.kind == "metric" else None
    system, cloud_plan, edge_plans = plan_stage(
        config, with_uploads(system, config.upload, progress), training.cameras.centers[:, :2], origin, progress
    )
    first_key = plan_key(cloud_plan, edge_plans)
    cloud_plan, edge_plans = replanned(config.out, cloud_plan, edge_plans)
    train, aggregate, backend = training_settings(config, progress)
    require_size(scene, train.long_side_px, config.lpips_network if config.lpips_weights else None)
    dealer = SharedDealer(
        run=config.out,
        images=images,
        scene=training,
        system=system,
        cloud_plan=cloud_plan,
        edge_plans=edge_plans,
        train=train,
        aggregate=aggregate,
        backend=backend,
        upload=config.upload,
        checkpoint_every_s=config.checkpoint_every_s,
    )
    tree = tree_of_plan(cloud_plan, edge_plans, teachers=config.early_teachers)
    progress.manifest.keep_stages({"sfm", "evaluation", *(node.id for node in tree)})
    progress.listen(Outlined(stages=("sfm", *counted(tree), "evaluation")))
    listen = counting_down(config, system, edge_plans, progress)
    positions = training.cameras.centers[:, :2]
    rescue = Rescue(dealer=dealer, positions=positions, tree=tree, first_plan_key=first_key, listen=listen)
    executor_of(config, system, progress, Faults(may_fail=_goes_on_without, watch=listen, on_lost=rescue)).fold(
        tree, dealer.prepare, listen
    )
    cloud_plan = dealer.cloud_plan
    pooled = {"node": "sfm", "tier": "owner", **received([images / name for name in scene.cameras.names])}
    progress.manifest.ledger = [*dealer.ledger, pooled]
    missing = dealer.missing()
    if not any(dealer.delivered(node) for node in tree if node.tier == "edge"):
        raise StageFailed("no device's model could be used. " + " ".join(missing.values()))
    _evaluation_stage(config, scene, train, (images, backend), progress)
    for kind in PICTURE_KINDS:
        shutil.copytree(config.out / "evaluation" / kind, config.out / "pictures" / kind, dirs_exist_ok=True)
    return cloud_plan, tree, missing


def _goes_on_without(node: Tree, error: BadInput | StageFailed) -> bool:
    """One owner can mend what is unusable input; a machine that is gone he may not get back."""
    return node.tier != "cloud" and isinstance(error, StageFailed)


def sfm_stage(config: RunConfig, progress: Progress, memory_bytes: float | None = None) -> tuple[SfmScene, Path]:
    """Structure from motion of the source in sfm/, within a limit of memory: the scene and the folder of its undistorted photographs."""
    folder = config.out / "sfm"
    folder.mkdir(exist_ok=True)
    sfm: dict[str, Any] = {"matching": config.matching, "seed": config.seed}
    if memory_bytes is not None:
        sfm["memory_bytes"] = memory_bytes
    task = sfm_task(config.source, sfm, config.masks, config.placement)
    write_json(folder / "task.json", task)
    settings = {**sfm, "placement": task["placement"]} if task["placement"] else sfm
    key = source_key(config, settings, folder, progress.listen)
    run_task(NodeTask(kind="sfm", stage="sfm", folder=folder, key=key), progress.listen, progress.clock)
    scene = load_scene(folder / "scene.safetensors")
    if len(scene.cameras) < 3:
        raise BadInput(f"only {len(scene.cameras)} photographs could be placed, expected at least 3: take more that overlap.")
    if scene.frame.kind == "unscaled":
        message = "frame=unscaled: no usable GPS, lengths are in arbitrary units, not metres."
        progress.listen(Warned(stage="sfm", message=message))
    return scene, folder / read_json(folder / "result.json", ("images",))["images"]


def require_size(scene: SfmScene, long_side_px: int, lpips: LpipsNetwork | None = None) -> None:
    """Raise BadInput where a photograph would become too small to be scored, with LPIPS where a network is named."""
    width, height = min(scene.cameras.scaled(long_side_px).sizes_wh.tolist(), key=min)
    least_px, figure = max((SSIM_WINDOW_PX, "SSIM"), (MIN_SIDE_PX[lpips] if lpips else 0, "LPIPS"))
    if min(width, height) < least_px:
        raise BadInput(
            f"with a long side of {long_side_px} px a photograph is {width} × {height} px, expected {least_px} or more a side "
            f"for {figure}: raise --long-side-px."
        )


def _evaluation_stage(config: RunConfig, scene: SfmScene, train: TrainConfig, rendering: tuple[Path, str], progress: Progress) -> None:
    images, backend = rendering
    folder = config.out / "evaluation"
    folder.mkdir(exist_ok=True)
    untrained = initial_splats(scene.points, scene.colors, scene.cameras, max_num_splats=train.max_num_splats, sh_degree=train.sh_degree)
    save_splats(folder / "initial.safetensors", untrained)
    held_out = scene.cameras.select(np.flatnonzero(held_out_mask(scene.cameras.names))).scaled(train.long_side_px)
    lpips_network = config.lpips_network if config.lpips_weights else None
    run_task(evaluation_task(config.out, images, held_out, backend, lpips_network), progress.listen, progress.clock)


def _write_metrics(config: RunConfig, manifest: Manifest, cloud_plan: CloudPlan, more: dict[str, Any]) -> dict[str, Any]:
    run = config.out
    result = read_json(run / "evaluation" / "result.json", ("images", "psnr_db"))
    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.stages.items()}
    planned = {"planned_makespan_s": cloud_plan.makespan_s, "plan_lower_bound_s": cloud_plan.lower_bound_s}
    prediction = prediction_of(run, manifest, load_plan(run / "plan.json")[1])
    peaks = {**manifest.peak_bytes, "run": peak_bytes()}
    promises = promises_of(config, pooled=result.get("pooled", True))
    metrics = {**result, "seconds": seconds, "peak_bytes": peaks, **planned, "prediction": prediction, "promises": promises, **more}
    write_json(run / "metrics.json", metrics)
    return metrics
