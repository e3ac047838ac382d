"""Scores a finished scene where its photographs are. Once per run.

Each machine scores the photographs that it has, held out for the quality and trained on for the
seams: a device its own, in score/ of its folder, or the owner of pooled photographs all of them, in
evaluation/. Figures travel, photographs do not.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Listener, Warned
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.run.choosing import keep_best
from radiant_app.run.dealing import Dealer, count_received, deal_files
from radiant_app.run.progress import Progress
from radiant_app.workers.delivering import DELIVERIES, find_refusals, identify_part, sign_task
from radiant_app.workers.score_files import LPIPS_NAME, PICTURE_KINDS, SCENE_NAME, SCORES_NAME, summarize_scores, version_file
from radiant_app.workers.scores import Claimable, Scores, admit_scores, read_scores
from radiant_app.workers.tasks import Move, ScoreTask
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree, scored_at
from radiant_core.choices import LpipsNetwork, Version
from radiant_core.errors import StageFailed
from radiant_core.evaluate.seam_excess import SeamExcess, excess_by_border, pooled_excess
from radiant_core.frames import Sim3
from radiant_core.hierarchy.codec import SUMMARY_NAME, TASK_NAME, save_task, task_key
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import content_key, is_sealed, read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.plan.plans import CloudPlan


@dataclass(frozen=True, kw_only=True)
class ScoringMachine:
    """A machine with held-out photographs."""

    stage: str
    """The folder in the run where it scores."""
    inputs: tuple[Path, ...]
    """Of its files those that decide the figures."""
    moves: tuple[Sim3, ...] = ()
    """From the frame of its cameras to the scene's, in order."""
    edge: str | None = None
    """The node that signs the tasks of a device; None: the owner of all photographs scores."""


def lpips_network_of(config: RunConfig) -> LpipsNetwork | None:
    """The network of LPIPS whose weights lie in evaluation/; None where none were given."""
    return config.evaluate.lpips_network if config.evaluate.lpips_weights else None


@dataclass(kw_only=True)
class Scoring:
    """The scoring of one run's scene on its machines."""

    config: RunConfig
    recipe: Recipe
    machines: Sequence[ScoringMachine]
    scenes: Mapping[Version, Path] = field(default_factory=dict)
    """The file of each version of the scene: the first is scored, and all are compared where there
    are more."""
    access_log: list[dict[str, Any]] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    """Stage → the key of its seal, so that figures of another scene are not used."""
    claimable: Callable[[str], Claimable] | None = None
    """What a device can score by the plan; None: all photographs are one owner's."""
    failed: tuple[str, ...] = ()
    """Stages of the machines that ended without figures that can be used."""

    def run(self, dealer: Dealer, executor: Executor, progress: Progress) -> dict[str, Any]:
        """Keep the version of the dealer's scene that is best on all machines, and combine its
        figures; raises as `combine_figures`."""

        def score(scenes: Mapping[Version, Path]) -> dict[str, Path]:
            self.scenes = scenes
            paths = {folder.parent.name: folder / SCORES_NAME for folder in self.fold(executor, progress.listen)}
            admitted.clear()
            admitted.update(self._admit(paths, progress.listen))
            return {machine: paths[machine] for machine in admitted}

        admitted: dict[str, Scores] = {}
        run, (scores, facts) = self.config.out, keep_best(dealer, score, progress.listen)
        # Pictures of photographs leave a machine only where all are one owner's.
        for kind in PICTURE_KINDS if self.config.frames == "shared" or self.config.single_owner else ():
            for pictures in (path.parent / kind for path in scores.values()):
                if pictures.is_dir():
                    shutil.copytree(pictures, run / "pictures" / kind, dirs_exist_ok=True)
        figures = combine_figures(run, {machine: admitted[machine] for machine in scores}, lpips_network_of(self.config))
        return {**figures, **facts}

    def _admit(self, paths: Mapping[str, Path], listen: Listener) -> dict[str, Scores]:
        """The scores of the machines that can have what they say."""
        if self.claimable is None:
            return {machine: read_scores(path) for machine, path in paths.items()}

        def warn(device: str, message: str) -> None:
            listen(Warned(stage=scored_at(f"devices/{device}"), message=message))

        admitted = admit_scores(paths, self.claimable, warn)
        self.failed = (*self.failed, *(scored_at(f"devices/{device}") for device in paths if device not in admitted))
        return admitted

    def fold(self, executor: Executor, listen: Listener) -> list[Path]:
        """Score on every machine; the folders of those that have figures."""
        nodes = tuple(Tree(id=machine.stage, tier="device") for machine in self.machines)
        executor.fold(Tree(id="scoring", tier="cloud", children=nodes), self._prepare, listen)
        run, stages = self.config.out, [machine.stage for machine in self.machines]
        finished = [machine for machine in self.machines if is_sealed(run / machine.stage, self.keys.get(machine.stage, ""))]
        forged = self._forged([machine for machine in finished if machine.edge is not None])
        for stage, reason in forged.items():
            listen(Warned(stage=stage, message=f"the figures of this device are left out: {reason}"))
        folders = [run / machine.stage for machine in finished if machine.stage not in forged]
        self.failed = tuple(stage for stage in stages if run / stage not in folders)
        return folders

    def _forged(self, machines: Sequence[ScoringMachine]) -> dict[str, str]:
        """Stage of a device → why its edge does not take its figures."""
        run, forged = self.config.out, {}
        for edge in sorted({machine.edge for machine in machines if machine.edge is not None}):
            places = {Path(machine.stage).parent.name: run / machine.stage for machine in machines if machine.edge == edge}
            part = run / scored_at(edge)
            shutil.rmtree(part / DELIVERIES, ignore_errors=True)
            identify_part(run, scored_at(edge), edge, "cloud")
            for device, place in places.items():
                deal_files(place, [RECORD_NAME, SIGNATURE_NAME], part / DELIVERIES / device)
            refused = find_refusals(part, [*places], places, "scores", run / edge)
            forged |= {scored_at(f"devices/{device}"): reason for device, reason in refused.items()}
        return forged

    def _prepare(self, node: Tree) -> NodeTask | None:
        """Copy the scene and the borders to a machine; its task holds the moves of its frame."""
        machine = next((machine for machine in self.machines if machine.stage == node.id), None)
        if machine is None:
            return None
        run, lpips = self.config.out, lpips_network_of(self.config)
        folder, inbox = run / node.id, run / node.id / "inbox"
        shutil.rmtree(inbox, ignore_errors=True)
        inbox.mkdir(parents=True)
        names: list[Version] = [*self.scenes] if len(self.scenes) > 1 else []
        for index, (name, file) in enumerate(self.scenes.items()):
            shutil.copyfile(file, inbox / (SCENE_NAME if not index else version_file(name)))
        save_plan(inbox / "plan.json", regions_alone(load_plan(run / "plan.json")[0]), ())
        if lpips:
            deal_files(run / "evaluation", [LPIPS_NAME], inbox)
        task = ScoreTask(
            corrections=tuple(map(Move.of, machine.moves)),
            long_side_px=self.recipe.train.long_side_px,
            backend=self.recipe.backend,
            lpips=lpips,
            light=self.recipe.train.light,
            owned=machine.edge is not None,
            versions=tuple(names),
        )
        save_task(folder, task)
        if machine.edge is not None:
            device = node.id.removesuffix("/score")
            identify_part(run, node.id, device, machine.edge)
            inputs = [f"inbox/{path.name}" for path in sorted(inbox.iterdir())]
            sign_task(run, machine.edge, device, "score_task", folder, [TASK_NAME, *inputs])
        self.access_log.append({"node": node.id, "tier": "device", **count_received([inbox])})
        key = self.keys[node.id] = content_key(__version__, task_key(task), inbox, *machine.inputs)
        return NodeTask(kind="score", stage=node.id, folder=folder, key=key)


def regions_alone(plan: CloudPlan) -> CloudPlan:
    """A plan without cameras, and without where they look: a device receives none of others."""
    return replace(plan, edge_of_camera=np.zeros(0, np.int64), looks=None)


def combine_figures(run: Path, scores: Mapping[str, Scores], lpips_network: LpipsNetwork | None) -> dict[str, Any]:
    """Combine scores, by machine, into the figures of metrics.json; StageFailed where no machine
    has a held-out photograph."""
    images = [row for machine_scores in scores.values() for row in machine_scores.rows]
    if not images:
        none_placed = "the machines that scored have none whose pose is known; give more photographs."
        reason = none_placed if scores else "scoring ended without figures on every machine that has any; --resume tries again."
        raise StageFailed(f"no held-out photograph could be scored: {reason}")
    errors = [error for machine_scores in scores.values() for error in machine_scores.border_errors]
    leakage = {name: machine_scores.leakage.model_dump() for name, machine_scores in scores.items() if machine_scores.leakage is not None}
    return {
        **summarize_scores(images, lpips_network=lpips_network),
        "num_gaussians": read_json(run / "cloud" / SUMMARY_NAME, ("num_splats",))["num_splats"],
        **_seam_figures(pooled_excess(errors)),
        "borders": [{"between": between, **_seam_figures(excess)} for between, excess in excess_by_border(errors).items()],
        **({"leakage": leakage} if leakage else {}),
    }


def _seam_figures(excess: SeamExcess) -> dict[str, Any]:
    return {
        "seam_excess_db": excess.excess_db,
        "seam_excess_at_least_db": excess.at_least_db,
        "seam_found": excess.has_seam,
        "seam_reason": excess.reason,
        "seam_photographs": excess.num_photographs,
    }
