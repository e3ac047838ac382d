"""`PooledPhotographs`: one owner reconstructs all photographs and deals each device its share
(`--frames shared`).

Afterwards a device reads only its own folder; the access log records that photographs were pooled.
Once per run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Warned
from radiant_app.executors.local import LocalExecutor, run_task
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.run.capture_warnings import capture_warnings
from radiant_app.run.dealing import Dealer, count_received, deal_files, deal_masks
from radiant_app.run.few_photographs import Workforce, choose_workforce
from radiant_app.run.grouping import choose_run_groups
from radiant_app.run.predictions import planned_training
from radiant_app.run.progress import Progress
from radiant_app.run.scoring import Scoring, ScoringMachine, lpips_network_of
from radiant_app.run.source import Plan
from radiant_app.run.source_key import source_key
from radiant_app.run.stages import plan_stage
from radiant_app.run.this_machine import divide, system_divided
from radiant_app.workers.sources import sfm_task
from radiant_app.workers.tasks import HELD_OUT_NAME, INITIAL_NAME, OWN_NAME, TRAINED_NAME
from radiant_core.aggregate.tree import Tree
from radiant_core.choices import LpipsNetwork
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.image_error import LPIPS_SIDE_PX, SSIM_WINDOW_PX
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy.codec import save_task
from radiant_core.hierarchy.messages import DeviceTask, device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_scene, save_cameras, save_splats
from radiant_core.io.run_store import read_json, write_json
from radiant_core.light.captures import CAPTURES_NAME
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.config import TrainConfig
from radiant_core.train.initialize import initial_splats


@dataclass(kw_only=True)
class PooledPhotographs:
    """The photographs of one owner, in one scene."""

    config: RunConfig
    scene: SfmScene
    images: Path
    """Folder of the undistorted photographs."""
    recipe: Recipe = field(init=False)
    kind: str = "device"

    @classmethod
    def reconstruct(cls, config: RunConfig, progress: Progress) -> PooledPhotographs:
        """Structure from motion of the whole source."""
        scene, images = sfm_stage(config, progress)
        return cls(config=config, scene=scene, images=images)

    @property
    def training(self) -> SfmScene:
        """The scene without its held-out cameras; a plan's indices point into it."""
        return self.scene.restricted_to(np.flatnonzero(~held_out_mask(self.scene.cameras.names)))

    @property
    def positions(self) -> FloatArray | None:
        """Of all: any device can take over any photograph."""
        return self.training.cameras.centers[:, :2]

    def make_plan(self, system: System, progress: Progress) -> Plan:
        """The plan of the training photographs."""
        config, training = self.config, self.training
        train = planned_training(config.train.preset, config.train.overrides)
        pixels = training.cameras.scaled(train.long_side_px).sizes_wh.prod(axis=1)
        division = divide(config, system, train, len(training.cameras), float(pixels.mean()))
        if division is not None:
            system = system_divided(config, division, progress)
        if division is None or division.forced:
            working = choose_workforce(config, system, len(training.cameras), train)
        else:
            working = Workforce(system=system)
        if working.decision is not None:
            progress.listen(Decided(decision=working.decision))
        origin = training.frame.origin_lat_lon_alt if training.frame.kind == "metric" else None
        system, cloud, edges = plan_stage(config, working.system, training.cameras.centers[:, :2], origin, progress, training)
        if working.warning is not None:
            progress.listen(Warned(stage="plan", message=working.warning))
        groups = choose_run_groups(config, system, edges, progress.listen) if division is None or division.holds_all else ()
        return Plan(system=system, cloud=cloud, edges=edges, groups=groups, num_workers=None if division is None else division.at_once)

    def check(self, train: TrainConfig) -> None:
        """Raise BadInput where photographs cannot be scored at the size of the training."""
        require_size(self.scene, train.long_side_px, lpips_network_of(self.config))

    def use_recipe(self, recipe: Recipe) -> None:
        """Deal by the plan of this recipe from now on."""
        self.recipe = recipe

    def num_dealt(self, device: str) -> int:
        """The number of cameras in the plan."""
        return len(self.recipe.cameras_of(device))

    def devices(self) -> Sequence[str]:
        """The devices that have photographs in the plan."""
        return [device for plan in self.recipe.edge_plans for device in plan.device_ids if len(plan.cameras_of(device))]

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[DeviceTask, list[Path]]:
        """Copy the device's photographs and masks; its task holds its part of the scene."""
        device_scene = self.training.restricted_to(recipe.cameras_of(device))
        deal_files(self.images, device_scene.cameras.names, folder / "photos")
        masks = deal_masks(self.config.out, device_scene.cameras.names, folder)
        return device_task(recipe.device_settings(device), device_scene), [folder / "photos", *masks]

    def fetched_files(self, device: str) -> list[Path]:
        """None: photographs are dealt."""
        return []

    def stages(self, tree: Tree) -> tuple[Sequence[str], Sequence[str]]:
        """Structure from motion; the evaluation."""
        return ["sfm"], ["evaluation"]

    def may_fail(self, node: Tree, error: BadInput | StageFailed) -> bool:
        """A lost machine may; unusable input may not, since its owner can correct it."""
        return node.tier != "cloud" and isinstance(error, StageFailed)

    def score(self, dealer: Dealer, executor: Executor, progress: Progress) -> None:
        """Score the finished scene in evaluation/, where the owner has all held-out photographs."""
        config, scene, train = self.config, self.scene, dealer.recipe.train
        folder = config.out / "evaluation"
        folder.mkdir(exist_ok=True)
        untrained = initial_splats(
            scene.points, scene.colors, scene.cameras, max_num_splats=train.max_num_splats, sh_degree=train.sh_degree
        )
        save_splats(folder / INITIAL_NAME, untrained)
        held_out = scene.cameras.select(np.flatnonzero(held_out_mask(scene.cameras.names))).scaled(train.long_side_px)
        save_cameras(folder / HELD_OUT_NAME, held_out)
        deal_files(self.images, held_out.names, folder / "photos")
        save_cameras(folder / TRAINED_NAME, self.training.cameras)
        write_json(folder / OWN_NAME, {"images": str(folder / "photos"), "training_images": str(self.images)})
        files = [folder / name for name in (HELD_OUT_NAME, INITIAL_NAME, TRAINED_NAME)]
        (folder / CAPTURES_NAME).unlink(missing_ok=True)
        if (config.out / "sfm" / CAPTURES_NAME).is_file():
            deal_files(config.out / "sfm", [CAPTURES_NAME], folder)
            files.append(folder / CAPTURES_NAME)
        inputs = [folder / "photos", *deal_masks(config.out, scene.cameras.names, folder), *files]
        machine = ScoringMachine(stage="evaluation", inputs=tuple(inputs))
        scoring = Scoring(config=config, recipe=dealer.recipe, machines=[machine])
        # Where the owner is, whatever runs the tree.
        write_json(folder / "result.json", scoring.run(dealer, LocalExecutor(num_workers=1, clock=progress.clock), progress))
        owner = {"node": "sfm", "tier": "owner", **count_received([self.images / name for name in scene.cameras.names])}
        progress.manifest.access_log = [*dealer.access_log, owner]


def sfm_stage(config: RunConfig, progress: Progress, memory_bytes: float | None = None) -> tuple[SfmScene, Path]:
    """Run structure from motion in sfm/ within `memory_bytes`; returns the scene and the folder of
    its undistorted photographs."""
    folder = config.out / "sfm"
    folder.mkdir(exist_ok=True)
    sfm = SfmConfig(matching=config.sfm.matching, effort=config.sfm.effort, seed=config.seed, memory_bytes=memory_bytes)
    options, placement = config.sfm, Placement(**config.sfm.placement)
    task = sfm_task(config.source, sfm, options.masks, placement, options.poses, refine_poses=options.refine_poses, intake=options.intake)
    save_task(folder, task)
    key = source_key(config, task, folder, progress.listen)
    run_task(NodeTask(kind="sfm", stage="sfm", folder=folder, key=key), progress.listen, progress.clock)
    scene = load_scene(folder / "scene.safetensors")
    if len(scene.cameras) < 3:
        raise BadInput(f"only {len(scene.cameras)} photographs could be placed, expected at least 3: take more that overlap.")
    if scene.frame.kind == "unscaled":
        message = "frame=unscaled: no usable GPS, lengths are in arbitrary units, not metres."
        progress.listen(Warned(stage="sfm", message=message))
    images = folder / read_json(folder / "result.json", ("images",))["images"]
    for sentence in capture_warnings(scene, images):
        progress.listen(Warned(stage="sfm", message=sentence))
    return scene, images


def require_size(scene: SfmScene, long_side_px: int, lpips: LpipsNetwork | None = None) -> None:
    """Raise BadInput where a photograph would be too small to be scored, with LPIPS if named."""
    width, height = min(scene.cameras.scaled(long_side_px).sizes_wh.tolist(), key=min)
    least_px, figure = max((SSIM_WINDOW_PX, "SSIM"), (LPIPS_SIDE_PX[lpips] if lpips else 0, "LPIPS"))
    if min(width, height) < least_px:
        raise BadInput(
            f"with a long side of {long_side_px} px a photograph is {width} × {height} px, expected {least_px} or more a side "
            f"for {figure}: raise --long-side-px."
        )
