"""What an edge does over a network: fold its devices, as the cloud asked. Once per task.

    HOME/runs/<run>/asked/<kind>/        the cloud's task as it came, and the report that answers it
                    devices/<id>/        what was asked of a device and what it sent
                    edges/<id>/          the edge's own join, as in a run on one machine
                    cloud/               the scene, where it is refined, as it came last

The same `Folding`, `Dealer` and `Scoring` work as in a run on one machine; the edge signs its
devices' tasks by its own key, and nobody else's is here.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from radiant_app.config.run_config import EvaluateOptions, RunConfig
from radiant_app.events import Event, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import worker_command
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.files.system_file import load_system
from radiant_app.network.contents import MAX_REASON_CHARS, check_count, check_frame, check_raster, check_summary
from radiant_app.network.executor import NetworkExecutor
from radiant_app.network.hub import Hub
from radiant_app.network.kinds import NOTES_NAME, REPORT_NAME
from radiant_app.network.messages import (
    LPIPS_NAME,
    PLAN_NAME,
    SCENE_NAME,
    SYSTEM_NAME,
    DevicesReport,
    EdgeCountTask,
    EdgeRasterTask,
    EdgeRefineTask,
    EdgeScoreTask,
    RegionTask,
)
from radiant_app.run.conducting import Folding
from radiant_app.run.dealing import Dealer, Refining, deal_files
from radiant_app.run.photographs import Photographs
from radiant_app.run.refining import left_out_of
from radiant_app.run.refining_deadlines import RefiningDeadlines, expected_times
from radiant_app.run.scoring import Scoring, ScoringMachine
from radiant_app.run.source import Plan
from radiant_app.run.stages import ATTEMPTS
from radiant_app.run.time_left import TimeLeftListener
from radiant_app.workers.delivering import identify_owned, register_sender, use_run_number
from radiant_app.workers.inbox import CORRECTIONS_NAME, REFUSED_NAME, load_corrections
from radiant_app.workers.rasters import Raster
from radiant_app.workers.score_files import SCORES_NAME, version_file
from radiant_app.workers.scores import read_scores
from radiant_app.workers.tasks import CountTask, Move, OwnFieldTask, RasterTask
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree, refines_for, tree_of_round
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.hierarchy.choosing import JOINED
from radiant_core.hierarchy.codec import (
    FRAME_NAME,
    MODEL_NAME,
    REFINED_NAME,
    ROWS_NAME,
    SUMMARY_NAME,
    load_task,
    message_record,
    save_task,
    sent_files,
    task_key,
)
from radiant_core.hierarchy.messages import DeviceSettings, Training
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import SEAL_NAME, content_key, is_sealed, read_json, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.numerics import FloatArray
from radiant_core.plan.timeline.prediction import planned_stages

REQUESTS, TIMES_NAME = "asked", "times.json"
COUNTED = {"edge_count": ("count", "count.json"), "edge_raster": ("raster", "raster.json")}
ALL_MAY_FAIL = RetryPolicy(may_fail=lambda node, error: True)
NOTHING_SENT = "nothing was heard of it in time, or it could not do what was asked; the messages of its edge say how."


@dataclass(kw_only=True)
class FarPhotographs:
    """See `Photographs`: those of devices that are machines of others."""

    task: RegionTask
    kind: str = "own_field"

    @property
    def positions(self) -> FloatArray | None:
        """None: they are lost with their device."""
        return None

    def use_recipe(self, recipe: Recipe) -> None:
        """The photographs stay where they are, whatever the plan."""

    def num_dealt(self, device: str) -> int:
        """The number of its photographs that it does not hold out."""
        return self.task.num_dealt[self.task.devices.index(device)]

    def devices(self) -> Sequence[str]:
        """The edge's devices."""
        return self.task.devices

    def fetched_files(self, device: str) -> list[Path]:
        """None."""
        return []

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[OwnFieldTask, list[Path]]:
        """The task names no photograph."""
        settings = recipe.device_settings(device)
        device_settings = {field.name: getattr(settings, field.name) for field in fields(DeviceSettings)}
        sfm = {field.name: getattr(self.task.sfm, field.name) for field in fields(self.task.sfm)}
        return OwnFieldTask(
            frames=self.task.frames,
            first_held_out=self.task.first_held_out[self.task.devices.index(device)],
            origin=self.task.origin,
            sfm=type(self.task.sfm)(**{**sfm, "memory_bytes": settings.memory_bytes}),
            **device_settings,
        ), []


@dataclass(kw_only=True)
class EdgeRun:
    """An edge's part of one run."""

    hub: Hub
    number: str
    """Number of the run."""
    emit: Callable[[Event], None]
    stopping: threading.Event = field(default_factory=threading.Event)
    command: Callable[[NodeTask], list[str]] = worker_command
    num_threads: int = 1

    @property
    def folder(self) -> Path:
        """Laid out as that of a run on one machine."""
        return self.hub.home.run_folder(self.number)

    @property
    def edge(self) -> str:
        """The id of the node."""
        return self.hub.home.node

    def answer(self, kind: str, task: Any) -> Mapping[str, Path]:
        """Do what the cloud asks; name → file of the result. Raises BadInput and StageFailed."""
        use_run_number(self.folder, self.number)
        if kind in COUNTED:
            report, files = self._count(kind, task), {}
        elif kind == "region":
            report, files = self._join(task)
        elif kind == "edge_refine":
            report, files = self._refine(task)
        else:
            report, files = self._score(task), {}
        write_json(self._request_folder(kind) / REPORT_NAME, message_record(report))
        return {REPORT_NAME: self._request_folder(kind) / REPORT_NAME, **files}

    def _request_folder(self, kind: str) -> Path:
        return self.folder / REQUESTS / kind

    # As `Conductor`

    def make_dealer(self, recipe: Recipe, source: Photographs) -> Dealer:
        """Its devices have keys of their own, and tasks the edge's."""
        return Dealer(run=self.folder, recipe=recipe, photographs=source, conductor=self.edge, exchange=self._exchange_keys)

    def num_workers(self, plan: Plan, tree: Tree) -> int:
        """All at once, on whatever cores they have."""
        del plan
        return sum(1 for _ in tree)

    def preparing(self, dealer: Dealer) -> Prepare:
        """As it is dealt."""
        return dealer.prepare

    def refining_deadlines(self, dealer: Dealer, tree: Tree, times: Mapping[str, Mapping[str, float]]) -> RefiningDeadlines:
        """By what its devices took before."""
        return RefiningDeadlines(expected_s=expected_times(dealer, tree, times), deadline_factor=self.region.deadline_factor)

    def make_executor(self, plan: Plan | None, clock: Callable[[], float], retry_policy: RetryPolicy) -> NetworkExecutor:
        """Runs leaves at its devices, whatever the plan."""
        del plan
        expected = self._expected_s
        return NetworkExecutor(
            hub=self.hub,
            run=self.number,
            lease_s=lambda node_id: expected.get(refines_for(node_id), 0.0),
            command=self.command,
            clock=clock,
            retry_policy=replace(retry_policy, max_attempts=ATTEMPTS),
            stopping=self.stopping,
            num_threads=self.num_threads,
            is_far=lambda node: node.tier == "device",
        )

    @property
    def _expected_s(self) -> dict[str, float]:
        """Node → the plan's seconds; nothing before there is a plan."""
        folder = self._request_folder("region")
        if not (folder / PLAN_NAME).is_file():
            return {}
        expected: dict[str, float] = {}
        for row in planned_stages(load_system(folder / SYSTEM_NAME), load_plan(folder / PLAN_NAME)[1]):
            expected[row.node] = expected.get(row.node, 0.0) + row.seconds
        return expected

    def _count(self, kind: str, task: EdgeCountTask | EdgeRasterTask) -> DevicesReport:
        """Let every device count."""
        node_kind, name = COUNTED[kind]
        keys: dict[str, str] = {}

        def prepare(node: Tree) -> NodeTask | None:
            if node.tier != "device":
                return None
            device_task: CountTask = CountTask(frames=task.frames)
            if isinstance(task, EdgeRasterTask):
                first = task.first_held_out[task.devices.index(node.id.split("/")[1])]
                device_task = RasterTask(frames=task.frames, cell_m=task.cell_m, first_held_out=first)
            folder = self.folder / node.id
            folder.mkdir(parents=True, exist_ok=True)
            save_task(folder, device_task)
            keys[node.id] = content_key(__version__, task_key(device_task))
            return NodeTask(kind=node_kind, stage=node.id, folder=folder, key=keys[node.id])

        nodes = tuple(Tree(id=f"devices/{device}/{node_kind}", tier="device") for device in task.devices)
        executor = self.make_executor(None, time.monotonic, ALL_MAY_FAIL)
        executor.fold(Tree(id=node_kind, tier="edge", children=nodes), prepare, self.emit)
        finished = [node.id.split("/")[1] for node in nodes if is_sealed(self.folder / node.id, keys[node.id])]
        readers: Mapping[str, Callable[[Any], Any]] = {"count": check_count, "raster": check_raster}
        counts = {device: readers[node_kind](read_json(self.folder / "devices" / device / node_kind / name)) for device in finished}
        records = {device: one.record if isinstance(one, Raster) else {"num_photographs": one} for device, one in counts.items()}
        return DevicesReport(found=records, missing={device: NOTHING_SENT for device in task.devices if device not in records})

    def _folding(self, task: RegionTask) -> Folding:
        request_folder = self._request_folder("region")
        cloud, edges = load_plan(request_folder / PLAN_NAME)
        recipe = Recipe(
            system=load_system(request_folder / SYSTEM_NAME),
            cloud_plan=cloud,
            edge_plans=edges,
            **{item.name: getattr(task, item.name) for item in fields(Training)},
            aggregate=task.aggregate,
            upload=task.upload,
            num_devices=task.num_devices,
            step_policy=task.step_policy,
            num_photographs=task.num_photographs,
        )
        plan = Plan(system=recipe.system, cloud=cloud, edges=edges)
        dealer = self.make_dealer(recipe, FarPhotographs(task=task))
        return Folding(dealer=dealer, conductor=self, plan=plan, clock=time.monotonic)

    @cached_property
    def region(self) -> RegionTask:
        """The region of this run; BadInput before the cloud gave one."""
        return load_task(RegionTask, self._request_folder("region"), "region task")

    def _exchange_keys(self) -> None:
        """Sign as this edge, and take what its devices sign with the keys that they joined by."""
        upper = self.hub.home.upper
        key = upper.key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
        identify_owned(self.folder, self.edge, upper.upper, self.hub.home.identity, key, conducts=True)
        for device in self.region.devices:
            member = self.hub.store.member(f"devices/{device}")
            if member is not None and member.key is not None:
                register_sender(self.folder, member.id, self.edge, self.hub.public_key(member.id))

    def _join(self, task: RegionTask) -> tuple[DevicesReport, dict[str, Path]]:
        """Fold the devices and join their models."""
        folding = self._folding(task)
        dealer = folding.dealer
        nodes = tuple(Tree(id=f"devices/{device}", tier="device") for device in task.devices)
        tree = Tree(id=self.edge, tier="edge", children=nodes)
        listen = TimeLeftListener(
            listen=self.emit,
            system=dealer.recipe.system,
            edge_plans=dealer.recipe.edge_plans,
            num_workers=self.num_workers(folding.plan, tree),
            emulated=False,
            deadline_factor=task.deadline_factor,
        )
        # The edge's own part must not fail.
        policy = RetryPolicy(may_fail=lambda node, error: node.tier == "device", deadlines=listen)
        self._keep_times(folding.fold(tree, folding.make_executor(policy), listen))
        edge_folder = self.folder / self.edge
        refused = read_json(edge_folder / REFUSED_NAME) if dealer.is_done(self.edge) else {}
        records, missing = {}, {}
        for node in nodes:
            place = self.folder / node.id
            if not dealer.is_done(node.id):
                missing[node.name] = NOTHING_SENT
            elif node.name in refused:
                missing[node.name] = f"{self.edge} refused {node.name}: {refused[node.name]}"
            if dealer.is_done(node.id):
                frame, summary = check_frame(read_json(place / FRAME_NAME)), check_summary(read_json(place / SUMMARY_NAME))
                records[node.name] = {"frame": frame.model_dump(), "summary": summary.model_dump()}
        for device, reason in refused.items():
            # The next time that this region is asked for, the device makes its model anew.
            self.hub.reject_stage(self.number, f"devices/{device}", reason)
            (self.folder / "devices" / device / SEAL_NAME).unlink(missing_ok=True)
        files = {}
        if dealer.is_done(self.edge):
            names = [FRAME_NAME, SUMMARY_NAME, NOTES_NAME, CORRECTIONS_NAME, REFUSED_NAME]
            names += [RECORD_NAME, SIGNATURE_NAME] if dealer.has_model(self.edge) else []
            files = {name: edge_folder / name for name in names} | (sent_files(edge_folder) if dealer.has_model(self.edge) else {})
        return DevicesReport(found=records, missing=missing), files

    def _keep_times(self, times: Mapping[str, NodeTime]) -> None:
        """Remember how long nodes took; those that were skipped keep what they had."""
        path = self.folder / TIMES_NAME
        earlier = read_json(path) if path.is_file() else {}
        took = {node: {"started_s": time.started_s, "ended_s": time.ended_s} for node, time in times.items()}
        write_json(path, {**earlier, **{node: span for node, span in took.items() if span["ended_s"] > span["started_s"]}})

    def _moves(self, to_cloud: Move) -> dict[str, list[Sim3]]:
        moved = load_corrections(self.folder / self.edge)
        return {device: [move, to_cloud.sim3] for device, move in moved.items() if move is not None}

    def _own_devices(self, devices: Sequence[str], moves: Mapping[str, Any]) -> tuple[str, ...]:
        """The devices that the cloud names, all of which have to be in this edge's model."""
        if strange := [device for device in devices if device not in moves]:
            raise BadInput(f"the cloud asks {self.edge} for {strange[0]}, whose model it did not join: run the region again.")
        return tuple(devices)

    def _refine(self, task: EdgeRefineTask) -> tuple[DevicesReport, dict[str, Path]]:
        """Let devices refine the scene and average what they send."""
        moves = self._moves(task.to_cloud)
        devices = self._own_devices(task.devices, moves)
        cloud, request_folder = self.folder / "cloud", self._request_folder("edge_refine")
        deal_files(request_folder, [SCENE_NAME], cloud)
        write_json(cloud / SUMMARY_NAME, {"num_splats": len(load_ply(cloud / SCENE_NAME))})
        name = self.edge.split("/")[1]
        folding = self._folding(self.region)
        dealer = folding.dealer
        self._exchange_keys()
        dealer.refining = Refining(run=self.folder, devices={name: devices}, moves=moves, joined=task.joined)
        (tree,) = tree_of_round(dealer.refining.devices, task.number).children
        times = read_json(self.folder / TIMES_NAME) if (self.folder / TIMES_NAME).is_file() else {}
        folding.fold_round(tree, times, self.emit)
        left_out = left_out_of(dealer, tree)
        records: dict[str, dict[str, Any]] = {device: {} for device in devices if device not in left_out}
        result_folder = self.folder / tree.id
        names = [REFINED_NAME, ROWS_NAME, NOTES_NAME, REFUSED_NAME, RECORD_NAME, SIGNATURE_NAME]
        files = {file: result_folder / file for file in names} if dealer.is_done(tree.id) else {}
        return DevicesReport(found=records, missing=left_out), files

    def _score(self, task: EdgeScoreTask) -> DevicesReport:
        """Let devices score the finished scene; their figures."""
        moves, request_folder = self._moves(task.to_cloud), self._request_folder("edge_score")
        devices = self._own_devices(task.devices, moves)
        folding = self._folding(self.region)
        self._exchange_keys()
        shutil.copyfile(request_folder / PLAN_NAME, self.folder / PLAN_NAME)
        evaluate = EvaluateOptions()
        if self.region.lpips is not None:
            deal_files(request_folder, [LPIPS_NAME], self.folder / "evaluation")
            evaluate = EvaluateOptions(lpips_weights=self.folder / "evaluation" / LPIPS_NAME, lpips_network=self.region.lpips)
        machines = [
            ScoringMachine(
                stage=f"devices/{device}/score",
                inputs=(self.folder / "devices" / device / MODEL_NAME,),
                moves=tuple(moves[device]),
                edge=self.edge,
            )
            for device in devices
        ]
        names: tuple[Version, ...] = task.versions or (JOINED,)
        scenes: dict[Version, Path] = {
            name: request_folder / (version_file(name) if index else SCENE_NAME) for index, name in enumerate(names)
        }
        config = RunConfig(source=self.folder, out=self.folder, frames=self.region.frames, evaluate=evaluate)
        scoring = Scoring(config=config, recipe=folding.dealer.recipe, machines=machines, scenes=scenes)
        reasons: dict[str, str] = {}

        def listen(event: Event) -> None:
            # The last warning of a device that is given up says why. What is said at the very end
            # of a task may not be heard above; its report is.
            if isinstance(event, Warned):
                reasons[event.stage] = event.message[:MAX_REASON_CHARS]
            self.emit(event)

        folders = scoring.fold(folding.make_executor(ALL_MAY_FAIL), listen)
        records = {folder.parent.name: read_scores(folder / SCORES_NAME).record for folder in folders}
        reason_of = {device: reasons.get(f"devices/{device}/score", NOTHING_SENT) for device in devices}
        return DevicesReport(found=records, missing={device: reason for device, reason in reason_of.items() if device not in records})
