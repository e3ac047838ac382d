"""delivered/ of a run on devices: what the run may show. Once per run.

The poses that edges received, under numbers, and their plan; over a network those stay with the
edges, and what is shown are the virtual cameras that they sent, by the strips they stand in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from shapely import Point, Polygon

from radiant_app.run.dealing import Dealer
from radiant_app.together.places import GROUP_FOLDER
from radiant_app.workers.inbox import load_corrections
from radiant_core.cameras import Cameras, concatenate_cameras, number_cameras
from radiant_core.frames import Frame
from radiant_core.geometry.similarity import move_cameras
from radiant_core.hierarchy.codec import CAMERAS_NAME, VIRTUAL_CAMERAS
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
        cameras = number_cameras(_received_cameras(run, dealer, device), device)
        for move in moves:
            cameras = move_cameras(cameras, move)
        parts.append(cameras)
        owners += [device] * len(cameras)
    _save(run, dealer, origin, parts, owners)


def _received_cameras(run: Path, dealer: Dealer, device: str) -> Cameras:
    """The poses of a device as the tier above has them: its edge beside its model, or in its start
    the root of the machines it trains together with."""
    group = dealer.recipe.group_of(device)
    if group is not None:
        from radiant_core.hierarchy.group_codec import load_start

        return load_start(run / group.root / GROUP_FOLDER / f"{device}.safetensors").cameras
    inbox = run / "edges" / dealer.recipe.plan_of(device).edge_id / "inbox"
    return load_cameras(inbox / device / CAMERAS_NAME)


def save_delivered_by_edges(run: Path, dealer: Dealer, origin: FloatArray | None) -> None:
    """The same of a run over a network: the edges' virtual cameras, by the nearest strip."""
    parts, owners = [], []
    present = set(dealer.load_moves())
    for edge, move in sorted(load_corrections(run / "cloud").items()):
        path = run / "cloud" / "inbox" / edge / VIRTUAL_CAMERAS
        if move is None or not path.is_file():
            continue
        cameras = move_cameras(number_cameras(load_cameras(path), edge), move)
        plan = next(plan for plan in dealer.recipe.edge_plans if plan.edge_id == edge)
        strips = {name: Polygon(strip) for name, strip in zip(plan.device_ids, plan.strips, strict=True) if name in present and len(strip)}
        first = next(name for name in plan.device_ids if name in present)
        owners += [_nearest(strips, Point(x, y)) or first for x, y in cameras.centers[:, :2]]
        parts.append(cameras)
    _save(run, dealer, origin, parts, owners)


def _nearest(strips: Mapping[str, Polygon], place: Point) -> str | None:
    return min(strips, key=lambda name: strips[name].distance(place), default=None)


def _save(run: Path, dealer: Dealer, origin: FloatArray | None, parts: Sequence[Cameras], owners: Sequence[str]) -> None:
    splats = load_ply(dealer.scene_folder / "scene.ply")
    rows = np.random.default_rng(0).permutation(len(splats))[:MAX_SHOWN_POINTS]
    colors = np.clip(0.5 + SH_C0 * splats.sh0[rows, 0], 0, 1)
    scene = SfmScene(
        cameras=concatenate_cameras(parts),
        points=splats.means[rows].astype(np.float64),
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
        rows = np.array([index for index, owner in enumerate(owners) if owner in plan.device_ids], np.int64)
        devices = np.array([plan.device_ids.index(owners[index]) for index in rows], np.int64)
        edge_of_camera[rows] = dealer.recipe.cloud_plan.edge_ids.index(plan.edge_id)
        edges.append(replace(plan, camera_indices=rows, device_of_camera=devices))
    return replace(dealer.recipe.cloud_plan, edge_of_camera=edge_of_camera), tuple(edges)
