"""`FarDevices`: photographs of devices that are machines of others. Once per run.

Their edges are asked how many each device has, where they stand in cells, and what a scene is worth
on those held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Warned
from radiant_app.executors.protocol import Executor
from radiant_app.network.contents import OpenedReport
from radiant_app.network.messages import LPIPS_NAME, PLAN_NAME, SCENE_NAME, EdgeCountTask, EdgeRasterTask, EdgeScoreTask
from radiant_app.run.captured import Captured, place_rasters
from radiant_app.run.choosing import keep_best
from radiant_app.run.dealing import Dealer
from radiant_app.run.delivered import save_delivered_by_edges
from radiant_app.run.on_devices import DevicePhotographs
from radiant_app.run.progress import Progress
from radiant_app.run.scoring import combine_figures, lpips_network_of, regions_alone
from radiant_app.run.source import Plan
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.rasters import Raster, raster_problem
from radiant_app.workers.score_files import LPIPS_NAME as SCORED_LPIPS
from radiant_app.workers.score_files import SCORES_NAME, version_file
from radiant_app.workers.scores import Claimable, Scores, admit_scores
from radiant_app.workers.tasks import Move
from radiant_core.aggregate.tree import Tree, scored_at
from radiant_core.choices import Version
from radiant_core.errors import BadInput, StageFailed
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import save_plan
from radiant_core.io.run_store import content_key, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.train.config import TrainConfig

HELD_OUT_EVERY = 8
"""As of `radiant_core.evaluate.split.held_out_mask`."""


class Edges(Protocol):
    """Machines of others that speak of their devices."""

    def begin(self, system: System) -> None:
        """Hear the edges of this system."""
        ...

    def ask(self, kind: str, tasks: Mapping[str, Any], progress: Progress, files: Mapping[str, Path] | None = None) -> OpenedReport:
        """Ask every edge of the same kind of work; what all their devices answer."""
        ...

    def seal_reported(self, node: str, files: Mapping[str, Any], key: str) -> None:
        """Lay out what an edge reports of a device."""
        ...


@dataclass(kw_only=True)
class FarDevices:
    """See `Source`; as seen by the cloud."""

    config: RunConfig
    edges: Edges
    counts: Mapping[str, int]
    """Device → how many photographs it has."""
    origin: FloatArray | None = None
    kind: str = "own_field"

    @property
    def positions(self) -> FloatArray | None:
        """None: they are lost with their device."""
        return None

    def first_held_out(self, device: str) -> int:
        """Which of a device's photographs by name is the first to be held out.

        Position 0, 8, 16, … of all "device/name" in sorted order is held out; where a device's
        names begin in that order follows from the counts of those before it.
        """
        before = sum(count for name, count in self.counts.items() if f"{name}/" < f"{device}/")
        return -before % HELD_OUT_EVERY

    def num_held_out(self, device: str) -> int:
        """How many of its photographs a device holds out."""
        return len(range(self.first_held_out(device), self.counts[device], HELD_OUT_EVERY))

    def num_dealt(self, device: str) -> int:
        """The number of its photographs that a device does not hold out."""
        return self.counts[device] - self.num_held_out(device) if device in self.counts else 0

    def devices(self) -> Sequence[str]:
        """Those with photographs."""
        return sorted(device for device, count in self.counts.items() if count)

    def use_recipe(self, recipe: Recipe) -> None:
        """The photographs stay where they are, whatever the plan."""

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[Any, list[Path]]:
        """Devices are filled by their edges."""
        raise AssertionError(f"{device} is filled by its edge.")

    def fetched_files(self, device: str) -> list[Path]:
        """None."""
        return []

    @classmethod
    def count(cls, config: RunConfig, system: System, edges: Edges, progress: Progress) -> FarDevices:
        """Ask how many photographs each device has."""
        require_names(system)
        # A resumed run plans again, from the photographs that devices have now.
        progress.manifest.drop_notes("plan")
        edges.begin(system)
        frames = config.frames
        assert frames != "shared"
        tasks = {edge.id: EdgeCountTask(frames=frames, devices=tuple(device.id for device in edge.devices)) for edge in system.edges}
        report = edges.ask("edge_count", {edge: task for edge, task in tasks.items() if task.devices}, progress)
        for device, reason in report.missing.items():
            progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {reason}"))
        return cls(config=config, edges=edges, counts=dict(sorted(report.records.items())))

    def make_plan(self, system: System, progress: Progress) -> Plan:
        """The plan in which every device keeps what it took."""
        assert self.config.frames != "shared" and self.config.cell_m is not None
        tasks = {}
        for edge in system.edges:
            counted = tuple(device.id for device in edge.devices if self.counts.get(device.id, 0))
            if counted:
                tasks[edge.id] = EdgeRasterTask(
                    frames=self.config.frames,
                    devices=counted,
                    cell_m=self.config.cell_m,
                    first_held_out=tuple(self.first_held_out(device) for device in counted),
                )
        report = self.edges.ask("edge_raster", tasks, progress)
        for device, reason in report.missing.items():
            progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {reason}"))
        rasters = self._usable_rasters({device: report.records[device] for device in self.devices() if device in report.records}, progress)
        places = {device: raster.middles for device, raster in rasters.items()}
        origin: FloatArray | None = None
        if self.config.frames == "gps":
            origin, middles = place_rasters(places, progress)
        else:
            middles = {device: place[:, :2] for device, place in places.items()}
        captured = Captured(names=(), owners=(), positions=np.zeros((0, 3)), origin=origin, cell_middles=middles)
        self.origin = origin
        folders = dict.fromkeys(rasters, self.config.out)
        return DevicePhotographs(config=self.config, captured=captured, folders=folders, poses=None).make_plan(system, progress)

    def _usable_rasters(self, rasters: Mapping[str, Raster], progress: Progress) -> dict[str, Raster]:
        """Those that are of devices with as many photographs as these counted; the others are left
        out by name."""
        usable = {}
        for device, raster in rasters.items():
            if problem := raster_problem(raster, self.counts[device], self.num_dealt(device)):
                progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {problem}"))
                continue
            if raster.num_unplaced:
                message = f"{raster.num_unplaced} of {raster.num_photographs} photographs of device {device} have no usable position."
                progress.listen(Warned(stage="plan", message=message))
            usable[device] = raster
        return usable

    def check(self, train: TrainConfig) -> None:
        """Accept: sizes of photographs are known where they are."""

    def stages(self, tree: Tree) -> tuple[Sequence[str], Sequence[str]]:
        """Scoring on the devices."""
        return [], [scored_at(node.id) for node in tree if node.tier == "device"]

    def may_fail(self, node: Tree, error: BadInput | StageFailed) -> bool:
        """See `may_fail`."""
        return may_fail(node, error)

    def score(self, dealer: Dealer, executor: Executor, progress: Progress) -> None:
        """Let the devices score the scene, and combine their figures."""
        del executor
        place = self.config.out / "evaluation"
        place.mkdir(exist_ok=True)
        save_plan(place / PLAN_NAME, regions_alone(dealer.recipe.cloud_plan), ())
        missing: dict[str, str] = {}

        admitted: dict[str, Scores] = {}

        def claimable(device: str) -> Claimable:
            held_out, dealt = self.num_held_out(device), self.num_dealt(device)
            return Claimable(num_held_out=held_out, num_dealt=dealt, edges=dealer.recipe.cloud_plan.edge_ids)

        def warn(device: str, message: str) -> None:
            progress.listen(Warned(stage=f"devices/{device}/score", message=message))

        def ask(scenes: Mapping[Version, Path]) -> dict[str, Path]:
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
                self.edges.seal_reported(f"devices/{device}/score", {SCORES_NAME: device_scores.record}, content_key(device_scores.record))
                scores[device] = self.config.out / f"devices/{device}/score" / SCORES_NAME
            return scores

        scores, choice = keep_best(dealer, ask, progress.listen)
        figures = combine_figures(self.config.out, {device: admitted[device] for device in scores}, lpips_network_of(self.config))
        result = {**figures, **choice}
        num_held_out = sum(self.num_held_out(device) for device in self.devices())
        facts: dict[str, Any] = {"num_unscored": num_held_out - len(result["images"]), "frames": self.config.frames, "pooled": False}
        if missing:
            facts["failed_scoring"] = sorted(missing)
        write_json(place / "result.json", {**result, **facts})
        save_delivered_by_edges(self.config.out, dealer, self.origin)
        progress.manifest.access_log = [*dealer.access_log]

    def _ask_scores(self, dealer: Dealer, scenes: Mapping[Version, Path], progress: Progress) -> OpenedReport:
        """Let the devices score the first of these versions of the scene, and compare all."""
        moves, to_cloud = dealer.load_moves(), load_corrections(self.config.out / "cloud")
        versions, tasks = (tuple(scenes) if len(scenes) > 1 else ()), {}
        for plan in dealer.recipe.edge_plans:
            names, move = tuple(name for name in sorted(moves) if name in plan.device_ids), to_cloud.get(plan.edge_id)
            if names and move is not None:
                tasks[plan.edge_id] = EdgeScoreTask(devices=names, to_cloud=Move.of(move), versions=versions)
        files = {SCENE_NAME if not index else version_file(name): file for index, (name, file) in enumerate(scenes.items())}
        files[PLAN_NAME] = self.config.out / "evaluation" / PLAN_NAME
        if lpips_network_of(self.config):
            files[LPIPS_NAME] = self.config.out / "evaluation" / SCORED_LPIPS
        return self.edges.ask("edge_score", tasks, progress, files)


def may_fail(node: Tree, error: BadInput | StageFailed) -> bool:
    """Machines of others may, whatever they say."""
    del error
    return node.tier != "cloud"


def require_names(system: System) -> None:
    """Raise BadInput for names that would hold out other photographs than a run on one machine."""
    if {device.id for device in system.devices} == {"train", "val"}:
        raise BadInput("two devices named train and val are taken for a set with its own split: name them otherwise.")
