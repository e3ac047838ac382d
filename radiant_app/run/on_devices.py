"""`DevicePhotographs`: photographs stay with the device that took them (`--frames gps` or `known`).
Once per run.

The plan is made from positions alone, or from counts in a raster. Each device reconstructs, fixes
its frame and trains in its own folder, and scores the scene on the photographs it held out. A
device that cannot deliver is reported missing, and the run goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Warned
from radiant_app.executors.protocol import Executor
from radiant_app.files.run_folder import PLANNING_FOLDER
from radiant_app.report.prediction_error import save_system
from radiant_app.run.captured import Captured, device_folders, locate_photographs, photo_folder, weigh_claims
from radiant_app.run.dealing import Dealer, count_received
from radiant_app.run.delivered import save_delivered
from radiant_app.run.grouping import choose_run_groups
from radiant_app.run.predictions import planned_training
from radiant_app.run.progress import Progress
from radiant_app.run.scoring import Scoring, ScoringMachine
from radiant_app.run.source import Plan
from radiant_app.run.stages import costs_of_run, load_plan_before_capture, load_plan_in_frame, plan_stage, warn_about_predictions
from radiant_app.run.this_machine import divide, system_divided
from radiant_app.run.uncaptured import deal_uncaptured
from radiant_app.workers.scores import Claimable
from radiant_app.workers.tasks import HELD_OUT_NAME, FieldTask, PlacingTask, SfmSettings
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.georef.given_frame import save_given_frame
from radiant_core.hierarchy.codec import MODEL_NAME
from radiant_core.hierarchy.messages import DeviceSettings
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import write_json
from radiant_core.light.captures import CAPTURES_NAME
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import middles_of_cells
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.revision.assigned import assigned_plan, device_indices
from radiant_core.plan.revision.captured import find_captured_elsewhere, plan_of_owners
from radiant_core.plan.system import System
from radiant_core.sfm.given_poses import GivenPoses, read_given_poses
from radiant_core.train.config import TrainConfig


def _read_poses(config: RunConfig, folders: dict[str, Path] | None, progress: Progress) -> GivenPoses:
    """The given poses; says what of them is not used, and writes the way back to their frame."""
    poses = read_given_poses(config.source, config.sfm.poses, "together" if folders is None else "by device")
    for message in poses.notes:
        progress.listen(Warned(stage="plan", message=message))
    if poses.check is not None:
        progress.listen(Decided(decision=replace(poses.check, stage="plan")))
    save_given_frame(config.out, poses.frame)
    return poses


@dataclass(frozen=True, kw_only=True)
class DeviceShare:
    """Which photographs are a device's own: file names in `source`, to train on and held out."""

    source: Path
    names: tuple[str, ...]
    held_out: tuple[str, ...]
    copy: bool
    """Whether the device copies them into its folder; False where it has a folder of its own."""


@dataclass(kw_only=True)
class DevicePhotographs:
    """The photographs of many owners, or those that one folder holds for the devices to fetch."""

    config: RunConfig
    captured: Captured
    folders: dict[str, Path] | None
    """Folder of each device that has its own; None where one folder holds all photographs."""
    poses: GivenPoses | None
    shares: dict[str, DeviceShare] = field(default_factory=dict)
    kind: str = "field"

    @classmethod
    def locate(cls, config: RunConfig, system: System, progress: Progress) -> DevicePhotographs:
        """Locate the photographs by EXIF, given poses, or counts that devices send."""
        # A resumed run plans again, from the photographs it finds.
        progress.manifest.drop_notes("plan")
        folders = device_folders(config.source, system)
        poses = _read_poses(config, folders, progress) if config.frames == "known" else None
        return cls(config=config, captured=locate_photographs(config, poses, folders, progress), folders=folders, poses=poses)

    @property
    def positions(self) -> FloatArray | None:
        """None where photographs lie in devices' own folders: they are lost with their device."""
        return self.captured.positions[self.captured.planned, :2] if self.folders is None else None

    def check(self, train: TrainConfig) -> None:
        """Accept: sizes of photographs are unknown before devices read them."""

    def make_plan(self, system: System, progress: Progress) -> Plan:
        """The plan of the training photographs with a position."""
        config, captured = self.config, self.captured
        positions, owners = captured.positions[captured.planned, :2], [captured.owners[index] or "" for index in captured.planned]
        if captured.cell_middles is not None:
            positions = np.concatenate([*captured.cell_middles.values(), np.zeros((0, 2))])
            owners = [device for device, middles in captured.cell_middles.items() for _ in middles]
        if len(positions) < 2:
            raise BadInput(f"{len(positions)} training photographs have a position, expected at least 2: give more photographs with GPS.")
        if self.folders is None:
            division = divide(config, system, planned_training(config.train.preset, config.train.overrides), len(positions))
            if division is not None:
                system = system_divided(config, division, progress)
            system, cloud, edges = plan_stage(config, system, positions, captured.origin, progress)
            groups = choose_run_groups(config, system, edges, progress.listen) if division is None or division.holds_all else ()
            return Plan(system=system, cloud=cloud, edges=edges, groups=groups, num_workers=None if division is None else division.at_once)
        if captured.cell_middles is None and config.cell_m is not None:
            positions = middles_of_cells(positions, config.cell_m)
        weighed = weigh_claims(owners, progress)
        positions, owners = positions[weighed], [owners[index] for index in weighed]
        system, note = costs_of_run(config, system, len(positions))
        cloud, edges = self._plan_of_owners(system, positions, owners, progress)
        save_plan(config.out / "plan.json", cloud, edges, warnings=warn_about_predictions(config, system, edges, progress, note))
        save_system(config.out, system)
        self._warn_of_idle(system, set(owners), progress)
        groups = choose_run_groups(config, system, edges, progress.listen, photographs_move=False)
        return Plan(system=system, cloud=cloud, edges=edges, groups=groups)

    def _plan_of_owners(
        self, system: System, positions: FloatArray, owners: Sequence[str], progress: Progress
    ) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
        """The plan in which every device keeps the photographs it took."""
        if self.config.plan.file is None:
            return assigned_plan(positions, owners, system)
        regions, strips, planned = load_plan_in_frame(self.config.plan.file, self.captured.origin)
        devices = device_indices(owners, system)
        plan = plan_of_owners(regions, strips, devices, positions, system=system)
        strange = np.array(find_captured_elsewhere(strips, planned, devices, positions), bool)
        for device in sorted({owner for owner, is_strange in zip(owners, strange, strict=True) if is_strange}):
            is_elsewhere = strange[[owner == device for owner in owners]]
            message = (
                f"{is_elsewhere.sum()} of {len(is_elsewhere)} photographs of device {device} lie where the plan has devices of another edge"
            )
            progress.listen(Warned(stage="plan", message=f"{message}: were folders mixed up? What it shows there may be cut away."))
        return plan

    def _warn_of_idle(self, system: System, owners: set[str], progress: Progress) -> None:
        file = self.config.plan.file
        if file is not None and (message := deal_uncaptured(self.config.out, load_plan_before_capture(file), system, owners)) is not None:
            progress.listen(Warned(stage="plan", message=message))
        for device in (device.id for device in system.devices if device.id not in (self.folders or ())):
            progress.listen(Warned(stage="plan", message=f"device {device} has no folder of photographs and takes no part."))

    def use_recipe(self, recipe: Recipe) -> None:
        """Deal by the plan of this recipe from now on."""
        self.shares = self._own_shares() if self.folders is not None else self._dealt_shares(recipe.edge_plans)

    def num_dealt(self, device: str) -> int:
        """The number of its photographs that it does not hold out."""
        return len(self.shares[device].names) if device in self.shares else 0

    def devices(self) -> Sequence[str]:
        """The devices with photographs."""
        return sorted(self.shares)

    def fetched_files(self, device: str) -> list[Path]:
        """The photographs of a device that copies them into its folder."""
        return self._paths(device) if self.shares[device].copy else []

    def _paths(self, device: str) -> list[Path]:
        share = self.shares[device]
        return [share.source / name for name in (*share.names, *share.held_out)]

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[FieldTask, list[Path]]:
        """Write the given poses, if any; the task names the device's photographs."""
        share, settings = self.shares[device], recipe.device_settings(device)
        files = [path.stat() for path in self._paths(device)]
        names = [*share.names, *share.held_out]
        poses = None if self.poses is None else "poses" if self.poses.deal(names, folder) else "poses.safetensors"
        origin = self.captured.origin
        placing = PlacingTask(
            frames="gps" if self.poses is None else "known",
            source=str(share.source.resolve()),
            names=share.names,
            held_out=share.held_out,
            fetch=share.copy,
            origin=None if origin is None else (float(origin[0]), float(origin[1]), float(origin[2])),
            sfm=SfmSettings(
                matching=self.config.sfm.matching,
                effort=self.config.sfm.effort,
                seed=self.config.seed,
                memory_bytes=settings.memory_bytes,
            ),
            poses=poses,
        )
        changed = tuple((file.st_size, file.st_mtime_ns) for file in files)
        common = {field.name: getattr(settings, field.name) for field in fields(DeviceSettings)}
        return FieldTask(placing=placing, changed=changed, **common), [] if poses is None else [folder / poses]

    def _own_shares(self) -> dict[str, DeviceShare]:
        captured, folders = self.captured, self.folders or {}
        held_out = captured.held_out
        shares = {}
        for device, folder in folders.items():
            rows = [index for index, owner in enumerate(captured.owners) if owner == device]
            shares[device] = DeviceShare(
                source=folder,
                names=tuple(captured.names[index] for index in rows if not held_out[index]),
                held_out=tuple(captured.names[index] for index in rows if held_out[index]),
                copy=False,
            )
        return shares

    def _dealt_shares(self, edge_plans: Sequence[EdgePlan]) -> dict[str, DeviceShare]:
        """Training photographs as planned; a held-out one goes where the nearest of those does."""
        captured, chosen = self.captured, self.captured.planned
        owner_of = {int(index): device for plan in edge_plans for device in plan.device_ids for index in plan.cameras_of(device)}
        held_out = np.flatnonzero(captured.placed & captured.held_out)
        nearest = np.asarray(KDTree(captured.positions[chosen]).query(captured.positions[held_out])[1]) if len(held_out) else []
        shares: dict[str, DeviceShare] = {}
        for device in sorted(set(owner_of.values())):
            shares[device] = DeviceShare(
                source=photo_folder(self.config.source),
                names=tuple(captured.names[chosen[index]] for index in sorted(owner_of) if owner_of[index] == device),
                held_out=tuple(captured.names[row] for row, near in zip(held_out, nearest, strict=True) if owner_of[int(near)] == device),
                copy=True,
            )
        return shares

    def score(self, dealer: Dealer, executor: Executor, progress: Progress) -> None:
        """Score the scene on every device whose model is in it, each on what it held out."""
        run, recipe = self.config.out, dealer.recipe
        machines = [
            ScoringMachine(
                stage=f"devices/{device}/score",
                inputs=tuple(run / "devices" / device / name for name in (HELD_OUT_NAME, MODEL_NAME, CAPTURES_NAME)),
                moves=tuple(moves),
                edge=f"edges/{recipe.plan_of(device).edge_id}",
            )
            for device, moves in sorted(dealer.load_moves().items())
        ]
        scoring = Scoring(config=self.config, recipe=recipe, machines=machines, claimable=self._claimable)
        result = scoring.run(dealer, executor, progress)
        num_held_out = sum(len(share.held_out) for share in self.shares.values())
        facts = {"num_unscored": num_held_out - len(result["images"]), "frames": self.config.frames, "pooled": self.folders is None}
        if scoring.failed:
            facts["failed_scoring"] = [stage.removeprefix("devices/").removesuffix("/score") for stage in scoring.failed]
        (run / "evaluation").mkdir(exist_ok=True)
        write_json(run / "evaluation" / "result.json", {**result, **facts})
        save_delivered(run, dealer, self.captured.origin)
        progress.manifest.access_log = [*self._planning_access_log(), *dealer.access_log, *scoring.access_log]

    def _claimable(self, device: str) -> Claimable:
        share = self.shares[device]
        edges = load_plan(self.config.out / "plan.json")[0].edge_ids
        return Claimable(num_held_out=len(share.held_out), num_dealt=len(share.names), edges=edges)

    def _planning_access_log(self) -> list[dict[str, Any]]:
        """The access log of planning, by the owner and at the cloud."""
        run = self.config.out
        heads = sorted(path for path in (run / "positions").rglob("*.json") if path.name in ("positions.json", "raster.json"))
        owner = [{"node": "plan", "tier": "owner", **count_received(heads)}] if self.config.frames == "gps" else []
        task = run / PLANNING_FOLDER / "task.json"
        return [*owner, *([{"node": PLANNING_FOLDER, "tier": "cloud", **count_received([task])}] if task.is_file() else [])]

    def stages(self, tree: Tree) -> tuple[Sequence[str], Sequence[str]]:
        """Before: reading positions and planning at the cloud; after: scoring on each device."""
        positions = ["positions", *(f"positions/{device}" for device in self.folders or ())]
        planning = [PLANNING_FOLDER] if (self.config.out / PLANNING_FOLDER).is_dir() else []
        return [*positions, *planning], [f"{node.id}/score" for node in tree if node.tier == "device"]

    def may_fail(self, node: Tree, error: BadInput | StageFailed) -> bool:
        """Every device and edge may; the run goes on without them."""
        return node.tier != "cloud"
