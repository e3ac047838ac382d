"""`OwnersMachines`: machines of others do the work of a run. Once per run.

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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from radiant_app.config.run_config import RunConfig
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import worker_command
from radiant_app.executors.protocol import NodeTask, Prepare
from radiant_app.files.system_file import dump_system
from radiant_app.network.contents import DeviceRecord, OpenedReport, open_report
from radiant_app.network.executor import NetworkExecutor
from radiant_app.network.far_devices import FarDevices, may_fail
from radiant_app.network.hub import Hub
from radiant_app.network.kinds import NOTES_NAME, REPORT_NAME, remove_earlier
from radiant_app.network.messages import PLAN_NAME, SCENE_NAME, SYSTEM_NAME, EdgeRefineTask, RegionTask
from radiant_app.run.dealing import Dealer
from radiant_app.run.progress import Progress
from radiant_app.run.scoring import lpips_network_of, regions_alone
from radiant_app.run.source import Plan, Source
from radiant_app.run.stages import ATTEMPTS
from radiant_app.workers.delivering import identify_owned, register_sender, run_number
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.tasks import Move, SfmSettings
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree, refines_for, round_of
from radiant_core.hierarchy.codec import FRAME_NAME, MODEL_NAME, REFINED_NAME, SUMMARY_NAME, save_task, task_key
from radiant_core.hierarchy.recipe import Recipe, devices_with_photographs
from radiant_core.io.records import save_plan
from radiant_core.io.run_store import SEAL_NAME, content_key, is_sealed, seal, write_atomic, write_json
from radiant_core.plan.system import System
from radiant_core.plan.timeline.prediction import planned_stages


@dataclass(kw_only=True)
class OwnersMachines:
    """See `Conductor`; the run at the cloud."""

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

    def begin(self, system: System) -> None:
        """Hear the edges of this system, and of nothing that was asked of them before."""
        self.devices = {f"edges/{edge.id}": frozenset(device.id for device in edge.devices) for edge in system.edges}
        self.hub.store.withdraw_all(run_number(self.folder))

    def make_dealer(self, recipe: Recipe, source: Source) -> Dealer:
        """Its machines have keys of their own, and may be silent as long as the plan gives them."""
        for row in planned_stages(recipe.system, recipe.edge_plans):
            self.expected_s[row.node] = self.expected_s.get(row.node, 0.0) + row.seconds
        return Dealer(run=self.folder, recipe=recipe, photographs=source, exchange=lambda: self._exchange_keys(recipe))

    def num_workers(self, plan: Plan, tree: Tree) -> int:
        """All at once, on whatever cores they have."""
        del plan
        return sum(1 for _ in tree)

    def make_executor(self, plan: Plan | None, clock: Callable[[], float], retry_policy: RetryPolicy) -> NetworkExecutor:
        """Runs leaves at the edges, whatever the plan."""
        del plan
        return NetworkExecutor(
            hub=self.hub,
            run=run_number(self.folder),
            lease_s=lambda node_id: self.expected_s.get(refines_for(node_id), 0.0),
            clock=clock,
            command=worker_command,
            retry_policy=replace(retry_policy, max_attempts=ATTEMPTS),
            num_threads=os.cpu_count() or 1,
            is_far=lambda node: node.tier == "edge",
            devices_of=lambda machine: self.devices.get(machine, ()),
        )

    def preparing(self, dealer: Dealer) -> Prepare:
        """Edges fill their devices; the cloud opens what they report first."""

        def prepare(node: Tree) -> NodeTask | None:
            if node.tier == "device":
                return None
            refines = round_of(node.id) > 0
            if node.tier == "edge":
                return self._prepare_refining(node, dealer) if refines else self._prepare_region(node, dealer)
            for edge in node.children:
                (self._open_refined if refines else self._open_region)(edge, dealer)
            return dealer.prepare(node)

        return prepare

    def refining_deadlines(self, dealer: Dealer, tree: Tree, times: Mapping[str, Mapping[str, float]]) -> None:
        """None: edges keep the deadlines of their devices, and a lease those of edges."""

    def _exchange_keys(self, recipe: Recipe) -> None:
        """Take what edges sign with the keys that they joined by."""
        identify_owned(self.folder, "cloud", None, self.hub.home.identity, None, conducts=True)
        for plan in recipe.edge_plans:
            member = self.hub.store.member(f"edges/{plan.edge_id}")
            if member is not None and member.key is not None:
                register_sender(self.folder, member.id, "cloud", self.hub.public_key(member.id))

    # Asking edges

    def ask(self, kind: str, tasks: Mapping[str, Any], progress: Progress, files: Mapping[str, Path] | None = None) -> OpenedReport:
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
        executor = self.make_executor(None, progress.clock, RetryPolicy(may_fail=may_fail))
        executor.fold(Tree(id=name, tier="cloud", children=nodes), prepare, progress.listen)
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

    def seal_reported(self, node: str, files: Mapping[str, Any], key: str) -> None:
        """Lay out what an edge reports of a device as if the device had worked here."""
        folder = self.folder / node
        folder.mkdir(parents=True, exist_ok=True)
        contents = {**files, NOTES_NAME: {"decisions": [], "warnings": []}}
        for name, record in contents.items():
            write_json(folder / name, record)
        seal(folder, key, sorted(contents))

    # Regions and rounds

    def _prepare_region(self, edge: Tree, dealer: Dealer) -> NodeTask:
        devices = dealer.photographs
        assert isinstance(devices, FarDevices)
        recipe, folder = dealer.recipe, self.folder / edge.id
        folder.mkdir(parents=True, exist_ok=True)
        plan = next(plan for plan in recipe.edge_plans if plan.edge_id == edge.name)
        edge_machines = next(part for part in recipe.system.edges if part.id == edge.name)
        names = tuple(device.name for device in edge.children)
        assert self.config.frames != "shared"
        task = RegionTask(
            **recipe.common,
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
                self.seal_reported(device.id, files, self._key_of_device(key, device.name))
        if (folder / MODEL_NAME).is_file():
            dealer.keys[edge.id] = key

    def _prepare_refining(self, node: Tree, dealer: Dealer) -> NodeTask:
        """The task of an edge in a round."""
        assert dealer.refining is not None, "which devices refine is planned before their round"
        folder, edge = self.folder / node.id, node.id.split("/")[1]
        folder.mkdir(parents=True, exist_ok=True)
        move = load_corrections(self.folder / "cloud")[edge]
        assert move is not None
        devices = tuple(child.id.split("/")[1] for child in node.children)
        number = round_of(node.id)
        task = EdgeRefineTask(devices=devices, to_cloud=Move.of(move), joined=dealer.refining.joined_sha256, number=number)
        save_task(folder, task)
        dealer.deal_start(number, folder)
        # The edge's own model stands for what its devices have.
        report_path = self.folder / f"edges/{edge}" / REPORT_NAME
        key = self.keys[node.id] = content_key(__version__, task_key(task), folder / SCENE_NAME, report_path)
        for child, device in zip(node.children, devices, strict=True):
            dealer.keys[child.id] = self._key_of_device(key, device)
        ask_again("edge_refine", folder, key)
        return NodeTask(kind="edge_refine", stage=node.id, folder=folder, key=key)

    def _open_refined(self, edge: Tree, dealer: Dealer) -> None:
        folder, key = self.folder / edge.id, self.keys[edge.id]
        if not is_sealed(folder, key):
            return
        report = open_report("edge_refine", folder)
        for device in edge.children:
            name = device.id.split("/")[1]
            if name in report.records:
                self.seal_reported(device.id, {}, self._key_of_device(key, name))
        if (folder / REFINED_NAME).is_file():
            dealer.keys[edge.id] = key


def ask_again(kind: str, folder: Path, key: str) -> None:
    """Unseal an edge's report that lacks devices: a run that goes on waits for them once more."""
    if is_sealed(folder, key) and open_report(kind, folder).missing:
        (folder / SEAL_NAME).unlink()
