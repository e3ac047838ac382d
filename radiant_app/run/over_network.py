"""`CloudRun`: a run whose edges and devices are machines of others. Once per run.

    count, raster   how many photographs each device has, and where they stand in cells
    region          each edge folds its devices and sends its model, by its own key
    cloud           joins the edges' models here, as in a run on one machine
    refine, score   each edge lets its devices refine and score the scene, and sends their mean and
                    their figures

What an edge reports of its devices is laid into their folders here, so that the rest of the run
reads it as that of a run on one machine. No name of a photograph, no pose and no device's model is
among it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Outlined, Warned
from radiant_app.executors.fold import Deadlines, RetryPolicy
from radiant_app.executors.local import worker_command
from radiant_app.executors.protocol import NodeTask, Prepare
from radiant_app.files.system_file import dump_system
from radiant_app.network.contents import DeviceRecord, OpenedReport, open_report
from radiant_app.network.executor import NetworkExecutor
from radiant_app.network.hub import Hub
from radiant_app.network.kinds import NOTES_NAME, REPORT_NAME, remove_earlier
from radiant_app.network.messages import (
    LPIPS_NAME,
    PLAN_NAME,
    SCENE_NAME,
    SYSTEM_NAME,
    EdgeCountTask,
    EdgeRasterTask,
    EdgeRefineTask,
    EdgeScoreTask,
    RegionTask,
)
from radiant_app.run.captured import Captured, place_rasters
from radiant_app.run.choosing import keep_best
from radiant_app.run.dealing import Dealer, deal_files
from radiant_app.run.delivered import save_delivered_by_edges
from radiant_app.run.far_devices import FarDevices, require_names
from radiant_app.run.foreseen import foresee_planned
from radiant_app.run.on_devices import DevicePhotographs
from radiant_app.run.progress import Progress
from radiant_app.run.refining import Refining, expected_refines, fold_rounds, plan_rounds
from radiant_app.run.scoring import combine_figures, lpips_network_of, regions_alone
from radiant_app.run.source import Plan
from radiant_app.run.stages import ATTEMPTS, make_recipe, make_time_left_listener
from radiant_app.workers.delivering import identify_owned, register_sender, run_number
from radiant_app.workers.evaluation import LPIPS_NAME as SCORED_LPIPS
from radiant_app.workers.evaluation import SCORES_NAME, version_file
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.rasters import Raster, raster_problem
from radiant_app.workers.scores import Claimable, Scores, admit_scores
from radiant_app.workers.tasks import Move, SfmSettings
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree, refines_for, tree_of_plan
from radiant_core.choices import Version
from radiant_core.errors import StageFailed
from radiant_core.hierarchy.codec import FRAME_NAME, MODEL_NAME, REFINED_NAME, SUMMARY_NAME, save_task, task_key
from radiant_core.hierarchy.recipe import Recipe, devices_with_photographs
from radiant_core.io.records import save_plan
from radiant_core.io.run_store import SEAL_NAME, content_key, is_sealed, seal, write_atomic, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.plan.timeline.prediction import planned_stages


@dataclass(kw_only=True)
class CloudRun:
    """The run at the cloud."""

    config: RunConfig
    hub: Hub
    keys: dict[str, str] = field(default_factory=dict)
    """Node of a task to an edge → the key of its seal."""
    expected_s: dict[str, float] = field(default_factory=dict)
    devices: dict[str, frozenset[str]] = field(default_factory=dict)
    """Edge → names of its devices, of which it speaks."""

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return self.config.out

    def join(self, system: System, progress: Progress) -> tuple[Dealer, Tree, tuple[Refining, ...]]:
        """Everything between the machines: plan, fold, refine, score. Raises StageFailed where no
        model can be used."""
        require_names(system)
        self.devices = {f"edges/{edge.id}": frozenset(device.id for device in edge.devices) for edge in system.edges}
        self.hub.store.withdraw_all(run_number(self.folder))
        devices = self._count(system, progress)
        plan = self._plan(system, devices, progress)
        recipe = make_recipe(self.config, plan, devices_with_photographs(plan.edges), progress)
        dealer = Dealer(run=self.folder, recipe=recipe, photographs=devices, exchange=lambda: self._exchange_keys(recipe))
        tree = tree_of_plan(plan.cloud, plan.edges)
        nodes = [node.id for node in tree]
        refines = expected_refines(recipe, tree)
        scores = [f"{node.id}/score" for node in tree if node.tier == "device"]
        progress.manifest.keep_stages({*nodes, *refines, *scores})
        progress.listen(Outlined(stages=(*nodes, *refines, *scores)))
        # Its machines all work at once, on whatever cores they have.
        progress.listen(foresee_planned(self.config, plan, recipe, len(nodes)))
        listen = make_time_left_listener(self.config, plan, progress)
        for row in planned_stages(plan.system, plan.edges):
            self.expected_s[row.node] = self.expected_s.get(row.node, 0.0) + row.seconds
        self._executor(progress, listen).fold(tree, lambda node: self._prepare(node, dealer, devices), listen)
        if not dealer.has_model("cloud"):
            reasons = " ".join(f"{device}: {reason}" for device, reason in dealer.missing_devices().items())
            raise StageFailed(f"no device delivered a model that could be used. {reasons}")
        rounds, finished = plan_rounds(dealer, dealer.load_moves()), [node for node in nodes if dealer.is_done(node)]
        progress.listen(Outlined(stages=(*finished, *(node.id for refining in rounds for node in refining.tree or ()), *scores)))
        rounds = self._refine(rounds, progress)
        refined = [node.id for refining in rounds for node in refining.tree or () if refining.is_done(node.id)]
        progress.listen(Outlined(stages=(*finished, *refined, *scores)))
        self._score(dealer, progress)
        progress.manifest.access_log = [*dealer.access_log]
        return dealer, tree, rounds

    # Machines

    def _executor(self, progress: Progress, deadlines: Deadlines | None = None) -> NetworkExecutor:
        policy = RetryPolicy(may_fail=lambda node, error: node.tier != "cloud", max_attempts=ATTEMPTS, deadlines=deadlines)
        return NetworkExecutor(
            hub=self.hub,
            run=run_number(self.folder),
            lease_s=lambda node_id: self._lease_s(refines_for(node_id)),
            clock=progress.clock,
            command=worker_command,
            retry_policy=policy,
            num_threads=os.cpu_count() or 1,
            is_far=lambda node: node.tier == "edge",
            devices_of=lambda machine: self.devices.get(machine, ()),
        )

    def _lease_s(self, node_id: str) -> float:
        """How long an edge may be silent: as long as the plan gives it."""
        return self.expected_s.get(node_id, 0.0)

    def _exchange_keys(self, recipe: Recipe) -> None:
        """Take what edges sign with the keys that they joined by."""
        identify_owned(self.folder, "cloud", None, self.hub.home.identity, None, conducts=True)
        for plan in recipe.edge_plans:
            member = self.hub.store.member(f"edges/{plan.edge_id}")
            if member is not None and member.key is not None:
                register_sender(self.folder, member.id, "cloud", self.hub.public_key(member.id))

    # Counting

    def _ask_edges(self, kind: str, tasks: Mapping[str, Any], progress: Progress, files: Mapping[str, Path] | None = None) -> OpenedReport:
        """Ask every edge of the same kind of work; what all their devices answer."""
        name = kind.removeprefix("edge_")

        def prepare(node: Tree) -> NodeTask | None:
            if node.tier != "edge":
                return None
            folder = self.folder / node.id
            folder.mkdir(parents=True, exist_ok=True)
            task = tasks[node.id.split("/")[1]]
            save_task(folder, task)
            remove_earlier(kind, folder, files or ())
            for file_name, path in (files or {}).items():
                shutil.copyfile(path, folder / file_name)
            key = content_key(__version__, task_key(task), *((folder / file_name) for file_name in files or ()))
            self.keys[node.id] = key
            ask_again(kind, folder, key)
            return NodeTask(kind=kind, stage=node.id, folder=folder, key=key)

        nodes = tuple(Tree(id=f"edges/{edge}/{name}", tier="edge") for edge in tasks)
        self._executor(progress).fold(Tree(id=name, tier="cloud", children=nodes), prepare, progress.listen)
        records: dict[str, dict[str, Any]] = {}
        missing: dict[str, str] = {}
        for edge, task in tasks.items():
            place = self.folder / f"edges/{edge}/{name}"
            is_answered = is_sealed(place, self.keys[f"edges/{edge}/{name}"])
            report = open_report(kind, place, self.config.frames) if is_answered else OpenedReport(records={}, missing={})
            edge_records = {device: report.records[device] for device in task.devices if device in report.records}
            records |= edge_records
            missing |= {
                device: report.missing.get(device, f"edges/{edge} did not answer.") for device in task.devices if device not in edge_records
            }
        return OpenedReport(records=records, missing=missing)

    def _count(self, system: System, progress: Progress) -> FarDevices:
        """How many photographs each device has."""
        frames = self.config.frames
        assert frames != "shared"
        tasks = {edge.id: EdgeCountTask(frames=frames, devices=tuple(device.id for device in edge.devices)) for edge in system.edges}
        report = self._ask_edges("edge_count", {edge: task for edge, task in tasks.items() if task.devices}, progress)
        for device, reason in report.missing.items():
            progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {reason}"))
        return FarDevices(counts=dict(sorted(report.records.items())))

    def _plan(self, system: System, devices: FarDevices, progress: Progress) -> Plan:
        """The plan in which every device keeps what it took."""
        assert self.config.frames != "shared" and self.config.cell_m is not None
        tasks = {}
        for edge in system.edges:
            counted = tuple(device.id for device in edge.devices if devices.counts.get(device.id, 0))
            if counted:
                tasks[edge.id] = EdgeRasterTask(
                    frames=self.config.frames,
                    devices=counted,
                    cell_m=self.config.cell_m,
                    first_held_out=tuple(devices.first_held_out(device) for device in counted),
                )
        report = self._ask_edges("edge_raster", tasks, progress)
        for device, reason in report.missing.items():
            progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {reason}"))
        rasters = self._usable_rasters(
            {device: report.records[device] for device in devices.devices() if device in report.records}, devices, progress
        )
        places = {device: raster.middles for device, raster in rasters.items()}
        origin: FloatArray | None = None
        if self.config.frames == "gps":
            origin, middles = place_rasters(places, progress)
        else:
            middles = {device: place[:, :2] for device, place in places.items()}
        captured = Captured(names=(), owners=(), positions=np.zeros((0, 3)), origin=origin, cell_middles=middles)
        devices.origin = origin
        folders = dict.fromkeys(rasters, self.folder)
        return DevicePhotographs(config=self.config, captured=captured, folders=folders, poses=None).make_plan(system, progress)

    def _usable_rasters(self, rasters: Mapping[str, Raster], devices: FarDevices, progress: Progress) -> dict[str, Raster]:
        """Those that are of devices with as many photographs as these counted; the others are left
        out by name."""
        usable = {}
        for device, raster in rasters.items():
            if problem := raster_problem(raster, devices.counts[device], devices.num_dealt(device)):
                progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {problem}"))
                continue
            if raster.num_unplaced:
                message = f"{raster.num_unplaced} of {raster.num_photographs} photographs of device {device} have no usable position."
                progress.listen(Warned(stage="plan", message=message))
            usable[device] = raster
        return usable

    # Folding

    def _prepare(self, node: Tree, dealer: Dealer, devices: FarDevices) -> NodeTask | None:
        if node.tier == "device":
            return None
        if node.tier == "edge":
            return self._prepare_region(node, dealer, devices)
        for edge in node.children:
            self._open_region(edge, dealer)
        return dealer.prepare(node)

    def _prepare_region(self, edge: Tree, dealer: Dealer, devices: FarDevices) -> NodeTask:
        recipe, folder = dealer.recipe, self.folder / edge.id
        folder.mkdir(parents=True, exist_ok=True)
        plan = next(plan for plan in recipe.edge_plans if plan.edge_id == edge.name)
        edge_machines = next(part for part in recipe.system.edges if part.id == edge.name)
        names = tuple(device.name for device in edge.children)
        assert self.config.frames != "shared"
        task = RegionTask(
            train=recipe.train,
            backend=recipe.backend,
            checkpoint_every_s=recipe.checkpoint_every_s,
            frames=self.config.frames,
            devices=names,
            first_held_out=tuple(map(devices.first_held_out, names)),
            num_dealt=tuple(map(devices.num_dealt, names)),
            origin=None if devices.origin is None else (float(devices.origin[0]), float(devices.origin[1]), float(devices.origin[2])),
            sfm=SfmSettings(matching=self.config.sfm.matching, effort=self.config.sfm.effort, seed=self.config.seed),
            aggregate=recipe.aggregate,
            upload=recipe.upload,
            step_policy=recipe.step_policy,
            num_devices=recipe.num_devices or devices_with_photographs(recipe.edge_plans),
            num_photographs=sum(len(part.camera_indices) for part in recipe.edge_plans),
            deadline_factor=self.config.execution.deadline_factor,
            lpips=lpips_network_of(self.config),
        )
        save_task(folder, task)
        save_plan(folder / PLAN_NAME, regions_alone(recipe.cloud_plan), (plan,))
        write_atomic(folder / SYSTEM_NAME, dump_system(replace(recipe.system, edges=(edge_machines,))).encode())
        key = content_key(__version__, task_key(task), folder / PLAN_NAME, folder / SYSTEM_NAME)
        self.keys[edge.id] = key
        for name in names:
            dealer.keys[f"devices/{name}"] = self._key_of_device(key, name)
        ask_again("region", folder, key)
        return NodeTask(kind="region", stage=edge.id, folder=folder, key=key)

    def _key_of_device(self, key: str, device: str) -> str:
        return content_key(key, device)

    def _open_region(self, edge: Tree, dealer: Dealer) -> None:
        """Lay out what an edge reports of its devices, and count its model as there."""
        folder, key = self.folder / edge.id, self.keys[edge.id]
        if not is_sealed(folder, key):
            return
        report = open_report("region", folder)
        for device in edge.children:
            record: DeviceRecord | None = report.records.get(device.name)
            if record is not None:
                files = {FRAME_NAME: record.frame.model_dump(), SUMMARY_NAME: record.summary.model_dump()}
                self._seal_reported(device.id, files, self._key_of_device(key, device.name))
        if (folder / MODEL_NAME).is_file():
            dealer.keys[edge.id] = key

    def _seal_reported(self, node: str, files: Mapping[str, Any], key: str) -> None:
        folder = self.folder / node
        folder.mkdir(parents=True, exist_ok=True)
        contents = {**files, NOTES_NAME: {"decisions": [], "warnings": []}}
        for name, record in contents.items():
            write_json(folder / name, record)
        seal(folder, key, sorted(contents))

    # Refining and scoring

    def _refine(self, rounds: Sequence[Refining], progress: Progress) -> tuple[Refining, ...]:
        def fold(refining: Refining, tree: Tree) -> None:
            self._executor(progress).fold(tree, self._preparing(refining), progress.listen)

        return fold_rounds(rounds, fold, progress.listen)

    def _preparing(self, refining: Refining) -> Prepare:
        """Tasks of the edges in a round, and of the cloud when they have answered."""
        to_cloud = load_corrections(self.folder / "cloud")

        def prepare(node: Tree) -> NodeTask | None:
            if node.tier == "device":
                return None
            if node.tier == "cloud":
                for edge in node.children:
                    self._open_refined(edge, refining)
                return refining.prepare(node)
            folder, edge = self.folder / node.id, node.id.split("/")[1]
            folder.mkdir(parents=True, exist_ok=True)
            move = to_cloud[edge]
            assert move is not None
            devices = tuple(child.id.split("/")[1] for child in node.children)
            task = EdgeRefineTask(devices=devices, to_cloud=Move.of(move), joined=refining.joined_sha256, number=refining.number)
            save_task(folder, task)
            deal_files(refining.start_folder, [SCENE_NAME], folder)
            # The edge's own model stands for what its devices have.
            report_path = self.folder / f"edges/{edge}" / REPORT_NAME
            key = self.keys[node.id] = content_key(__version__, task_key(task), folder / SCENE_NAME, report_path)
            for device in devices:
                refining.keys[refining.node(f"devices/{device}")] = self._key_of_device(key, device)
            ask_again("edge_refine", folder, key)
            return NodeTask(kind="edge_refine", stage=node.id, folder=folder, key=key)

        return prepare

    def _open_refined(self, edge: Tree, refining: Refining) -> None:
        folder, key = self.folder / edge.id, self.keys[edge.id]
        if not is_sealed(folder, key):
            return
        report = open_report("edge_refine", folder)
        for device in edge.children:
            name = device.id.split("/")[1]
            if name in report.records:
                self._seal_reported(device.id, {}, self._key_of_device(key, name))
        if (folder / REFINED_NAME).is_file():
            refining.keys[edge.id] = key

    def _score(self, dealer: Dealer, progress: Progress) -> None:
        """Let the devices score the scene, and combine their figures."""
        place = self.folder / "evaluation"
        place.mkdir(exist_ok=True)
        save_plan(place / PLAN_NAME, regions_alone(dealer.recipe.cloud_plan), ())
        missing: dict[str, str] = {}

        counts = dealer.photographs
        assert isinstance(counts, FarDevices)
        admitted: dict[str, Scores] = {}

        def claimable(device: str) -> Claimable:
            held_out, dealt = counts.num_held_out(device), counts.num_dealt(device)
            return Claimable(num_held_out=held_out, num_dealt=dealt, edges=dealer.recipe.cloud_plan.edge_ids)

        def warn(device: str, message: str) -> None:
            progress.listen(Warned(stage=f"devices/{device}/score", message=message))

        def score(scenes: Mapping[Version, Path]) -> dict[str, Path]:
            report = self._ask_scores(dealer, scenes, progress)
            admitted.clear()
            admitted.update(admit_scores(dict(sorted(report.records.items())), claimable, warn))
            missing.clear()
            missing.update(report.missing)
            for device, reason in report.missing.items():
                warn(device, f"this device has no figures: {reason}")
            missing.update({device: "its figures are left out." for device in report.records if device not in admitted})
            scores = {}
            for device, device_scores in admitted.items():
                self._seal_reported(f"devices/{device}/score", {SCORES_NAME: device_scores.record}, content_key(device_scores.record))
                scores[device] = self.folder / f"devices/{device}/score" / SCORES_NAME
            return scores

        scores, choice = keep_best(dealer, score, progress.listen)
        figures = combine_figures(self.folder, {device: admitted[device] for device in scores}, lpips_network_of(self.config))
        result = {**figures, **choice}
        num_held_out = sum(counts.num_held_out(device) for device in counts.devices())
        facts: dict[str, Any] = {"num_unscored": num_held_out - len(result["images"]), "frames": self.config.frames, "pooled": False}
        if missing:
            facts["failed_scoring"] = sorted(missing)
        write_json(place / "result.json", {**result, **facts})
        save_delivered_by_edges(self.folder, dealer, counts.origin)

    def _ask_scores(self, dealer: Dealer, scenes: Mapping[Version, Path], progress: Progress) -> OpenedReport:
        """Let the devices score the first of these versions of the scene, and compare all."""
        moves, to_cloud = dealer.load_moves(), load_corrections(self.folder / "cloud")
        versions, tasks = (tuple(scenes) if len(scenes) > 1 else ()), {}
        for plan in dealer.recipe.edge_plans:
            names, move = tuple(name for name in sorted(moves) if name in plan.device_ids), to_cloud.get(plan.edge_id)
            if names and move is not None:
                tasks[plan.edge_id] = EdgeScoreTask(devices=names, to_cloud=Move.of(move), versions=versions)
        files = {SCENE_NAME if not index else version_file(name): file for index, (name, file) in enumerate(scenes.items())}
        files[PLAN_NAME] = self.folder / "evaluation" / PLAN_NAME
        if lpips_network_of(self.config):
            files[LPIPS_NAME] = self.folder / "evaluation" / SCORED_LPIPS
        return self._ask_edges("edge_score", tasks, progress, files)


def ask_again(kind: str, folder: Path, key: str) -> None:
    """Unseal an edge's report that lacks devices: a run that goes on waits for them once more."""
    if is_sealed(folder, key) and open_report(kind, folder).missing:
        (folder / SEAL_NAME).unlink()
