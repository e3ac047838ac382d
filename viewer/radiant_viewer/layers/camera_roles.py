"""`CameraRoles`: edge, device and use of each camera of a scene. Once per run or plan."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan

NOBODY = -1
"""Edge or device of a camera that is not in the plan."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraRoles:
    """edge_of_camera, device_of_camera (C,) into edge_ids, device_ids, or -1; held_out (C,) bool;
    edge_of_device (D,) into edge_ids, for devices of all edges in order."""

    edge_ids: tuple[str, ...]
    device_ids: tuple[str, ...]
    edge_of_device: NDArray[np.int64]
    edge_of_camera: NDArray[np.int64]
    device_of_camera: NDArray[np.int64]
    held_out: NDArray[np.bool_]


def camera_roles(cameras: Cameras, cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], held_out: Collection[str]) -> CameraRoles:
    """Return the roles of all C cameras of a scene under a plan of all, or of those not held out,
    in the scene's order. BadInput where it fits neither, or a held-out name or edge is unknown."""
    unknown = sorted(set(held_out) - set(cameras.names))
    if unknown:
        raise BadInput(f"the held-out photograph {unknown[0]!r} is none of the scene's {len(cameras)} cameras: plan this scene again.")
    is_held_out = np.array([name in held_out for name in cameras.names], dtype=bool)
    planned = _planned_indices(is_held_out, len(cloud_plan.edge_of_camera))
    edge_of_camera = np.full(len(cameras), NOBODY, np.int64)
    edge_of_camera[planned] = cloud_plan.edge_of_camera
    device_of_camera = np.full(len(cameras), NOBODY, np.int64)
    device_ids: list[str] = []
    edge_of_device: list[int] = []
    for plan in edge_plans:
        _require_fits(plan, cloud_plan, len(planned))
        if plan.dealt:
            device_of_camera[planned[plan.camera_indices]] = len(device_ids) + plan.device_of_camera
        edge_of_device += [cloud_plan.edge_ids.index(plan.edge_id)] * len(plan.device_ids)
        device_ids += plan.device_ids
    return CameraRoles(
        edge_ids=cloud_plan.edge_ids,
        device_ids=tuple(device_ids),
        edge_of_device=np.array(edge_of_device, np.int64),
        edge_of_camera=edge_of_camera,
        device_of_camera=device_of_camera,
        held_out=is_held_out,
    )


def _planned_indices(is_held_out: NDArray[np.bool_], num_planned: int) -> NDArray[np.int64]:
    training = np.flatnonzero(~is_held_out)
    if num_planned == len(is_held_out):
        return np.arange(num_planned)
    if num_planned == len(training):
        return training
    raise BadInput(
        f"the plan assigns {num_planned} cameras, the scene has {len(is_held_out)} of which {len(training)} train: "
        "the two are not of one run, plan this scene again."
    )


def _require_fits(plan: EdgePlan, cloud_plan: CloudPlan, num_planned: int) -> None:
    if plan.edge_id not in cloud_plan.edge_ids:
        raise BadInput(
            f"the plan of edge {plan.edge_id!r} belongs to none of the edges {list(cloud_plan.edge_ids)}: plan this scene again."
        )
    if len(plan.camera_indices) and (plan.camera_indices.min() < 0 or plan.camera_indices.max() >= num_planned):
        raise BadInput(f"the plan of edge {plan.edge_id!r} names a camera beyond the {num_planned} planned ones: plan this scene again.")
