"""A known length and a known direction, applied to the frame of a world. Once per scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.frames import Sim3
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.placement import Placement


def rescale(world_from_model: Sim3, scene: SfmScene, placement: Placement) -> tuple[Sim3, tuple[Decision, ...]]:
    """The similarity with the scale of a known length, about the cameras' middle, and the decision;
    unchanged without one."""
    factor = placement.scale(scene.cameras, scene.points, scene.observations)
    if factor is None:
        return world_from_model, ()
    middle = scene.cameras.centers.mean(axis=0)
    scaled = Sim3(
        scale=factor * world_from_model.scale,
        rotation=world_from_model.rotation,
        translation=factor * (world_from_model.translation - middle) + middle,
    )
    decision = Decision(
        stage="sfm",
        topic="scale",
        choice="metres by a known length",
        figure=factor,
        unit="times the scale without it",
        reason=placement.length_option,
        forced=True,
    )
    return scaled, (decision,)


def turn_to_north(world_from_model: Sim3, cameras: Cameras, placement: Placement) -> tuple[Sim3, tuple[Decision, ...]]:
    """The similarity turned about up so that north is where the user says, and the decision."""
    level = Cameras(
        names=cameras.names,
        Ks=cameras.Ks,
        cam_from_world=world_from_model.apply_to_poses(cameras.cam_from_world),
        sizes_wh=cameras.sizes_wh,
    )
    turn = placement.turn_to_north(level)
    if turn is None:
        return world_from_model, ()
    turned = Sim3(scale=world_from_model.scale, rotation=turn @ world_from_model.rotation, translation=turn @ world_from_model.translation)
    angle_deg = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    decision = Decision(
        stage="sfm",
        topic="north",
        choice="north by a photograph's direction",
        figure=angle_deg,
        unit="deg turned",
        reason=f"--north {placement.north}",
        forced=True,
    )
    return turned, (decision,)


def agreeing_north(turned: Decision) -> Decision:
    """GPS has north within what a compass is good for, and is the surer of both."""
    return replace(turned, choice="north by GPS, with which --north agrees", unit="deg away by --north", forced=False)
