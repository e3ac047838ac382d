"""What the model of a group is to the tiers around it. Once per group.

root "cloud"          the scene: nothing is joined, and no device refines what all have fitted
root "edges/NAME"     that edge's model, as if it had joined its devices'
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import NO_CAMERAS, Cameras, concatenate_cameras, number_cameras
from radiant_core.hierarchy.device import training_summary
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.joining import UNMOVED
from radiant_core.hierarchy.messages import EdgeModel, EdgeTask, SceneModel
from radiant_core.hierarchy.together import ShareStart
from radiant_core.io.run_store import content_key
from radiant_core.splats import Splats, morton_order
from radiant_core.train.results import TrainResult


def scene_of_group(plan: GroupTraining, starts: Mapping[str, ShareStart], result: TrainResult) -> SceneModel:
    """The scene that devices trained below the cloud; edges of which no device sent a start count
    as refused."""
    present = {edge: any(device in starts for device in devices) for edge, devices in plan.views.items()}
    return SceneModel(
        splats=result.splats,
        corrections={edge: UNMOVED if is_there else None for edge, is_there in present.items()},
        refused={edge: NO_START for edge, is_there in present.items() if not is_there},
        summary=training_summary(result),
    )


NO_START = "none of its devices has begun the training."
NOT_BEGUN = "it has not begun the training."


def edge_of_group(task: EdgeTask, starts: Mapping[str, ShareStart], result: TrainResult) -> EdgeModel:
    """The model that an edge's devices trained together.

    Args:
        task: of the edge, as if it joined their models.
        starts: what they sent before the first step, by device.
        result: of the training.
    """
    # Along a Z curve, as of a joined model.
    splats = result.splats.select(morton_order(result.splats.means))
    begun = {device: starts[device] for device in task.devices if device in starts}
    cameras = _virtual_cameras(begun, splats) if task.draws_cameras else NO_CAMERAS
    return EdgeModel(
        splats=splats,
        cameras=cameras,
        corrections={device: UNMOVED if device in begun else None for device in task.devices},
        refused={device: NOT_BEGUN for device in task.devices if device not in begun},
        summary={**training_summary(result), "num_models": len(begun)},
    )


def cameras_of_starts(starts: Mapping[str, ShareStart]) -> Cameras:
    """Cameras (C) of all photographs that a group trains on, under numbers."""
    return concatenate_cameras([number_cameras(start.cameras, device) for device, start in starts.items()])


def _virtual_cameras(starts: Mapping[str, ShareStart], splats: Splats) -> Cameras:
    """Near the devices' cameras; drawn by a seed made of what the edge received and the cloud does
    not."""
    received = {device: [start.cameras, start.points, start.colors] for device, start in starts.items()}
    rng = np.random.default_rng(int(content_key(received)[:32], 16))
    return virtual_cameras(cameras_of_starts(starts), splats.means, rng)
