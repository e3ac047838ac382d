"""delivered/ of a run on devices: what the run may show. Once per run.

The poses that edges received, under numbers, and their plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.run.dealing import Dealer
from radiant_core.cameras import concatenate_cameras
from radiant_core.frames import Frame
from radiant_core.hierarchy.joining import move_cameras, number_cameras
from radiant_core.io.messages import CAMERAS_NAME
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, save_plan, save_scene
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0

MAX_SHOWN_POINTS = 20_000


def save_delivered(run: Path, dealer: Dealer, origin: FloatArray | None) -> None:
    """Write delivered/scene.safetensors and plan.json: the poses that edges received, in the
    scene's frame, and their devices."""
    parts, owners = [], []
    for device, moves in sorted(dealer.load_moves().items()):
        inbox = run / "edges" / dealer.recipe.plan_of(device).edge_id / "inbox"
        cameras = number_cameras(load_cameras(inbox / device / CAMERAS_NAME), device)
        for move in moves:
            cameras = move_cameras(cameras, move)
        parts.append(cameras)
        owners += [device] * len(cameras)
    splats = load_ply(dealer.scene_folder / "scene.ply")
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
