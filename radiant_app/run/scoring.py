"""Scores a scene on devices: each on the photographs it held out; only numbers go up. Once per run.

delivered/ holds what the run may show: the poses that edges received, under numbers, and their
plan.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.run.dealing import Dealer, count_received, deal_files
from radiant_app.run.progress import Progress
from radiant_app.workers.delivering import identify_scoring, sign_task
from radiant_app.workers.evaluation import LPIPS_NAME, PICTURE_KINDS, region_width, summarize_scores
from radiant_app.workers.tasks import Move, ScoreTask
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree
from radiant_core.cameras import concatenate_cameras
from radiant_core.choices import LpipsNetwork
from radiant_core.errors import StageFailed
from radiant_core.evaluate.seam_error import pooled_seam_error
from radiant_core.frames import Frame, Sim3
from radiant_core.hierarchy.joining import moved_cameras, numbered
from radiant_core.io.messages import TASK_NAME, save_task, task_key
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, save_plan, save_scene
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0

MAX_SHOWN_POINTS = 20_000


def score_on_devices(
    config: RunConfig, dealer: Dealer, executor: Executor, progress: Progress, origin: FloatArray | None, num_held_out: int
) -> list[dict[str, Any]]:
    """Score the scene on every device whose model is in it; writes evaluation/result.json and
    returns the access log of the devices.

    Raises:
        StageFailed: no device holds a photograph out that it could place.
    """
    scorer = _Scorer(dealer=dealer, lpips_network=config.evaluate.lpips_network if config.evaluate.lpips_weights else None)
    devices = sorted(scorer.moves)
    nodes = tuple(Tree(id=f"devices/{device}/score", tier="device") for device in devices)
    executor.fold(Tree(id="scoring", tier="cloud", children=nodes), scorer.prepare, progress.listen)
    result = _collected(config.out, devices, scorer.lpips_network, num_held_out)
    (config.out / "evaluation").mkdir(exist_ok=True)
    pooled = dealer.photographs.positions is not None
    write_json(config.out / "evaluation" / "result.json", {**result, "frames": config.frames, "pooled": pooled})
    _save_delivered(config.out, dealer, origin)
    # Pictures of photographs leave a device only where all devices are one owner's.
    for kind in PICTURE_KINDS if config.single_owner else ():
        for device in devices:
            made = config.out / "devices" / device / "score" / kind
            if made.is_dir():
                shutil.copytree(made, config.out / "pictures" / kind, dirs_exist_ok=True)
    return scorer.access_log


@dataclass(kw_only=True)
class _Scorer:
    """Prepares the scoring of the finished scene on each device's own held-out photographs."""

    dealer: Dealer
    lpips_network: LpipsNetwork | None
    """If set, evaluation/ holds the weights."""
    moves: dict[str, list[Sim3]] = field(init=False)
    access_log: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.moves = self.dealer.load_moves()

    def prepare(self, node: Tree) -> NodeTask | None:
        """Copy the scene and the borders to the device; its task holds the moves of its frame."""
        if not node.id.startswith("devices/"):
            return None
        run, folder = self.dealer.run, self.dealer.run / node.id
        device, recipe = node.id.split("/")[1], self.dealer.recipe
        shutil.rmtree(folder / "inbox", ignore_errors=True)
        deal_files(run / "cloud", ["scene.ply"], folder / "inbox")
        self._deal_borders(folder / "inbox" / "plan.json")
        if self.lpips_network:
            deal_files(run / "evaluation", [LPIPS_NAME], folder / "inbox")
        task = ScoreTask(
            corrections=tuple(map(Move.of, self.moves[device])),
            long_side_px=recipe.train.long_side_px,
            backend=recipe.backend,
            lpips=self.lpips_network,
        )
        save_task(folder, task)
        edge = f"edges/{recipe.plan_of(device).edge_id}"
        identify_scoring(run, node.id, f"devices/{device}", edge)
        given = [f"inbox/{path.name}" for path in sorted((folder / "inbox").iterdir())]
        sign_task(run, edge, f"devices/{device}", "score_task", folder, [TASK_NAME, *given])
        inputs = [folder / "inbox", *(folder.parent / name for name in ("held_out.safetensors", "model.safetensors"))]
        self.access_log.append({"node": node.id, "tier": "device", **count_received([folder / "inbox"])})
        return NodeTask(kind="score", stage=node.id, folder=folder, key=content_key(__version__, task_key(task), *inputs))

    def _deal_borders(self, path: Path) -> None:
        """Write the regions alone: a device receives no cameras, strips or devices of others."""
        cloud, _ = load_plan(self.dealer.run / "plan.json")
        save_plan(path, replace(cloud, edge_of_camera=np.zeros(0, np.int64)), ())


def _collected(run: Path, devices: Sequence[str], lpips_network: LpipsNetwork | None, num_held_out: int) -> dict[str, Any]:
    """Merge the figures of all devices; `num_unscored` of the `num_held_out` photographs have none,
    since their device is missing or could not place them.

    Raises:
        StageFailed: no device has a held-out photograph.
    """
    results = {
        device: read_json(run / "devices" / device / "score" / "result.json", ("images", "leakage", "seam_sums"))
        for device in devices
        if (run / "devices" / device / "score" / "result.json").is_file()
    }
    images = [row for result in results.values() for row in result["images"]]
    if not images:
        raise StageFailed("no device could score the scene: none holds a photograph out that it could place; give more photographs.")
    seams = pooled_seam_error([np.array(result["seam_sums"]) for result in results.values()])
    plan, _ = load_plan(run / "plan.json")
    return {
        **summarize_scores(images, lpips_network=lpips_network),
        "num_unscored": num_held_out - len(images),
        "num_gaussians": len(load_ply(run / "cloud" / "scene.ply")),
        "seam_psnr_db": seams.seam_psnr_db,
        "interior_psnr_db": seams.interior_psnr_db,
        "seam_reason": seams.reason,
        "seam_half_band": region_width(plan.sites),
        "leakage": {device: result["leakage"] for device, result in results.items()},
    }


def _save_delivered(run: Path, dealer: Dealer, origin: FloatArray | None) -> None:
    """Write delivered/scene.safetensors and plan.json: the poses that edges received, in the scene's frame, and their devices."""
    moves = dealer.load_moves()
    parts, owners = [], []
    for device, path in _device_cameras(dealer).items():
        cameras = numbered(load_cameras(path), device)
        for move in moves[device]:
            cameras = moved_cameras(cameras, move)
        parts.append(cameras)
        owners += [device] * len(cameras)
    splats = load_ply(run / "cloud" / "scene.ply")
    shown = np.random.default_rng(0).permutation(len(splats))[:MAX_SHOWN_POINTS]
    colors = np.clip(0.5 + SH_C0 * splats.sh0[shown, 0], 0, 1)
    scene = SfmScene(
        cameras=concatenate_cameras(parts),
        points=splats.means[shown].astype(np.float64),
        colors=(255 * colors).round().astype(np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="unscaled" if origin is None else "metric", origin_lat_lon_alt=np.zeros(3) if origin is None else origin),
    )
    (run / "delivered").mkdir(exist_ok=True)
    save_scene(run / "delivered" / "scene.safetensors", scene)
    save_plan(run / "delivered" / "plan.json", *_plan_of(owners, dealer))


def _plan_of(owners: Sequence[str], dealer: Dealer) -> Any:
    """The plan's regions, strips and times with the delivered cameras."""
    edges = []
    edge_of_camera = np.zeros(len(owners), np.int64)
    for plan in dealer.recipe.edge_plans:
        own = np.array([index for index, owner in enumerate(owners) if owner in plan.device_ids], np.int64)
        devices = np.array([plan.device_ids.index(owners[index]) for index in own], np.int64)
        edge_of_camera[own] = dealer.recipe.cloud_plan.edge_ids.index(plan.edge_id)
        edges.append(replace(plan, camera_indices=own, device_of_camera=devices))
    return replace(dealer.recipe.cloud_plan, edge_of_camera=edge_of_camera), tuple(edges)


def _device_cameras(dealer: Dealer) -> dict[str, Path]:
    """Device → the poses it sent to its edge, for devices whose model is in the scene."""
    edge_of = {device: dealer.recipe.plan_of(device).edge_id for device in sorted(dealer.load_moves())}
    return {device: dealer.run / "edges" / edge / "inbox" / device / "cameras.safetensors" for device, edge in edge_of.items()}
