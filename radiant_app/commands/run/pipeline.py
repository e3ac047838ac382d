"""The main job, from photographs to one Gaussian model: connects the stages, computes nothing.

    photographs ─ plan ─ conduct ─ report

`--frames` decides where structure from motion happens (`source.py`), the executor who works
(`conducting.py`), and nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Listener, Outlined, Warned
from radiant_app.executors.emulated import emulated_figures, require_emulable
from radiant_app.executors.fork_server import keep_servers
from radiant_app.executors.ray_cluster import require_cluster
from radiant_app.files.event_file import EventFile
from radiant_app.files.run_folder import Manifest, open_run
from radiant_app.network.far_devices import FarDevices
from radiant_app.network.home import open_home, require_cloud
from radiant_app.network.serving import require_network
from radiant_app.report.drawing import draw_report
from radiant_app.report.ground_control import placing_of_run, survey_of_run
from radiant_app.report.prediction_error import prediction_of
from radiant_app.run.conducting import conduct
from radiant_app.run.dealing import deal_files
from radiant_app.run.foreseen import foresee, planned_makespan_s, slowdown
from radiant_app.run.here import Here
from radiant_app.run.on_devices import DevicePhotographs
from radiant_app.run.pooled import PooledPhotographs
from radiant_app.run.predictions import refining_law_of
from radiant_app.run.progress import Progress
from radiant_app.run.promises import promises_of
from radiant_app.run.refining import left_out, partly_left_out
from radiant_app.run.source import Source
from radiant_app.run.stages import (
    begin_executor,
    list_nodes,
    require_plan,
    scale_for_uploads,
)
from radiant_app.run.this_machine import system_of
from radiant_app.run.whole_run import WholeRun
from radiant_app.workers.memory import peak_bytes
from radiant_app.workers.score_files import LPIPS_NAME
from radiant_app.workers.sources import SURVEY, detect_source
from radiant_core.errors import BadInput
from radiant_core.hierarchy.choosing import REFINED
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.signing import keeps_modes
from radiant_core.plan.system import System
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_app.network.cloud import OwnersMachines

NO_MODES = (
    "the disk of {out} keeps no access rights (NTFS, exFAT, a network drive?): whoever can read it can read the keys that this run signs "
    "its models and tasks with, and sign in their place. Where that matters, choose a folder on another disk."
)


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """The results of a finished run."""

    folder: Path
    metrics: dict[str, Any]
    """The content of metrics.json."""

    @property
    def report(self) -> Path:
        """The self-contained report."""
        return self.folder / "report.html"

    def load_splats(self) -> Splats:
        """Read the scene's Gaussians.

        Returns:
            All Gaussians of scene.ply, before activation.

        Raises:
            BadInput: the file is missing or broken.
        """
        return load_ply(self.folder / "scene.ply")


def run(
    config: RunConfig, listen: Listener = lambda event: None, *, resume: bool = False, clock: Callable[[], float] = time.monotonic
) -> RunResult:
    """Run everything in `config.out`; finished stages are skipped with `resume`.

    Use it to divide a scene among machines, or among processes of this one, with a report.

    Args:
        config: what is asked for.
        listen: receives every event of the run as it happens.
        resume: go on with the run that is in the folder, by the same settings.
        clock: seconds; the times of stages are its differences.

    Returns:
        The folder and the metrics; its `load_splats` reads the scene.

    Raises:
        BadInput: unusable input, in one sentence; nothing stays behind.
        StageFailed: a stage ended without its result; finished ones stay and can be resumed.

    Example:
        >>> config = radiant.RunConfig(source=Path("PHOTOGRAPHS"), out=Path("RUN"))
        >>> result = radiant.run(config)  # doctest: +SKIP
        >>> radiant.save_splats(result.load_splats(), "scene.spz")  # doctest: +SKIP
    """
    system = _check_system(config)
    save_lpips = _read_lpips(config)
    with open_run(config, resume) as manifest, EventFile(config.out, listen) as heard, _owners(config) as owners, keep_servers():
        save_lpips()
        whole = WholeRun(listen=heard, clock=clock, slowdown=slowdown())
        progress = Progress(manifest=manifest, listener=whole, clock=clock, started_s=clock() - manifest.ended_s)
        if not keeps_modes(config.out):
            progress.listen(Warned(stage="run", message=NO_MODES.format(out=config.out)))
        if owners is None and not resume:
            begin_executor(config)
        source = _locate_photographs(config, system, owners, progress)
        plan = source.make_plan(scale_for_uploads(system, config.upload, progress), progress)
        conducted = conduct(config, source, owners or Here(config=config), plan, progress)
        dealer, rounds = conducted.dealer, conducted.rounds
        deal_files(dealer.scene_folder, ["scene.ply"], config.out)
        emulation = emulated_figures(config.out, conducted.tree, rounds, manifest) if config.emulated else {}
        missed = {"not_refined": left_out(dealer, rounds), "partly_refined": partly_left_out(dealer, rounds)}
        refined = {"refined": dealer.version == REFINED, **missed}
        # The bound is that of plans whose models are joined.
        bound_s = None if plan.groups else dealer.recipe.cloud_plan.lower_bound_s
        planned = {"planned_makespan_s": planned_makespan_s(dealer.recipe, plan.groups), "plan_lower_bound_s": bound_s}
        more = {"executor": config.execution.executor, "missing": dealer.missing_devices(), **planned, **refined, **emulation}
        metrics = _write_metrics(config, manifest, dealer.recipe, plan.groups, more)
        manifest.status = "done"
        draw_report(config.out, manifest, metrics, whole)
    return RunResult(folder=config.out, metrics=metrics)


def _check_system(config: RunConfig) -> System:
    """Load the system and check the settings against it, before any stage runs."""
    if config.frames == "shared":
        detect_source(config.source, config.sfm.poses)
    system = system_of(config)
    if config.emulated:
        require_emulable(system)
    if config.plan.file is not None:
        if not config.plan.file.is_file():
            raise BadInput(f"--plan {config.plan.file} is no file: give the plan.json that `radiant plan` wrote, or leave --plan out.")
        require_plan(config.plan.file, system)
    if config.execution.address is not None:
        require_cluster(config.execution.address)
    if config.execution.executor == "network":
        require_network()
        require_cloud(open_home(config.source))
    return system


def _read_lpips(config: RunConfig) -> Callable[[], None]:
    """Read the weights of LPIPS, if any are given; what is returned saves them where scenes are
    scored. BadInput where they are none."""
    if config.evaluate.lpips_weights is None:
        return lambda: None
    from radiant_core.evaluate.lpips import load_lpips, save_lpips

    lpips, folder = load_lpips(config.evaluate.lpips_weights, config.evaluate.lpips_network), config.out / "evaluation"

    def save() -> None:
        folder.mkdir(exist_ok=True)
        save_lpips(folder / LPIPS_NAME, lpips)

    return save


@contextmanager
def _owners(config: RunConfig) -> Iterator[OwnersMachines | None]:
    """The machines that join this one, if the run is over a network; it listens until the end."""
    if config.execution.executor != "network":
        yield None
        return
    from radiant_app.network.cloud import OwnersMachines
    from radiant_app.network.hub import open_hub

    with open_home(config.source).lock(), open_hub(open_home(config.source)) as hub:
        yield OwnersMachines(config=config, hub=hub)


def _locate_photographs(config: RunConfig, system: System, owners: OwnersMachines | None, progress: Progress) -> Source:
    if owners is not None:
        return FarDevices.count(config, system, owners, progress)
    if config.frames != "shared":
        return DevicePhotographs.locate(config, system, progress)
    progress.listen(Outlined(stages=("sfm", *list_nodes(system), "evaluation")))
    if (foreseen := foresee(config, system)) is not None:
        progress.listen(foreseen)
    return PooledPhotographs.reconstruct(config, progress)


def _write_metrics(
    config: RunConfig, manifest: Manifest, recipe: Recipe, groups: Sequence[GroupPlan], more: dict[str, Any]
) -> dict[str, Any]:
    run = config.out
    result = read_json(run / "evaluation" / "result.json", ("images", "psnr_db"))
    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.stages.items()}
    edge_plans = load_plan(run / "plan.json")[1]
    # What devices that place their own photographs need beside training is mostly that.
    num_cameras, num_devices = sum(len(plan.camera_indices) for plan in edge_plans), len(recipe.system.devices)
    law = refining_law_of(recipe.train, recipe.aggregate, num_cameras, num_devices, fixed=config.train.step_policy == "fixed")
    prediction = prediction_of(run, manifest, edge_plans, law if config.frames == "shared" else None, groups)
    costs = {"peak_bytes": {**manifest.peak_bytes, "run": peak_bytes()}, "cpu_s": {**manifest.cpu_s, "run": time.process_time()}}
    promises = promises_of(config, pooled=result.get("pooled", True))
    if (survey := survey_of_run(run)) is not None:
        more = {SURVEY: survey, **more}
    more = {**placing_of_run(run), **more}
    metrics = {**result, "seconds": seconds, **costs, "prediction": prediction, "promises": promises, **more}
    write_json(run / "metrics.json", metrics)
    return metrics
