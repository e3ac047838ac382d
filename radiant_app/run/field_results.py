"""What a run in the field shows of itself: numbers that devices sent, and the cameras and plan of what was delivered. Once per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.run.field_dealing import FieldDealer, device_cameras
from radiant_app.workers.evaluation import region_width, summary_of
from radiant_app.workers.inbox import moved_cameras, numbered, sim3_of
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import StageFailed
from radiant_core.evaluate.seam_error import pooled_seam_error
from radiant_core.frames import Frame
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, save_plan, save_scene
from radiant_core.io.run_store import read_json
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0

MAX_SHOWN_POINTS = 20_000


def collect_scores(
    run: Path, devices: Sequence[str], missing: dict[str, str], lpips_network: str | None, num_held_out: int
) -> dict[str, Any]:
    """The figures of all devices as one record, and how many of the `num_held_out` photographs are in none of them, since their device is
    missing or could not place them; StageFailed when no device has a held-out photograph."""
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
        **summary_of(images, lpips_network=lpips_network),
        "num_unscored": num_held_out - len(images),
        "num_gaussians": len(load_ply(run / "cloud" / "scene.ply")),
        "seam_psnr_db": seams.seam_psnr_db,
        "interior_psnr_db": seams.interior_psnr_db,
        "seam_reason": seams.reason,
        "seam_half_band": region_width(plan.sites),
        "leakage": {device: result["leakage"] for device, result in results.items()},
        "missing": missing,
    }


def save_delivered(run: Path, dealer: FieldDealer, origin: FloatArray | None) -> None:
    """delivered/scene.safetensors and plan.json: the poses that edges hold, in the scene's frame, and who took them."""
    moves = dealer.moves()
    parts, owners = [], []
    for device, path in device_cameras(dealer).items():
        cameras = numbered(load_cameras(path), device)
        for move in moves[device]:
            cameras = moved_cameras(cameras, sim3_of(move))
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


def _plan_of(owners: Sequence[str], dealer: FieldDealer) -> Any:
    """The plan's regions, strips and times with the cameras that were delivered."""
    edges = []
    edge_of_camera = np.zeros(len(owners), np.int64)
    for plan in dealer.edge_plans:
        own = np.array([index for index, owner in enumerate(owners) if owner in plan.device_ids], np.int64)
        devices = np.array([plan.device_ids.index(owners[index]) for index in own], np.int64)
        edge_of_camera[own] = dealer.cloud_plan.edge_ids.index(plan.edge_id)
        edges.append(replace(plan, camera_indices=own, device_of_camera=devices))
    return replace(dealer.cloud_plan, edge_of_camera=edge_of_camera), tuple(edges)
