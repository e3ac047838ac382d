"""The layers that an edit draws again, and footprints. Pure; once per edit or frame of a drag."""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.borders.footprints import Footprints, ground_footprints, views_of_cameras
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.scene import SfmScene
from radiant_viewer.editing.model.edited_plan import EditedPlan, PlanSubject
from radiant_viewer.layers.camera_layer import camera_layer
from radiant_viewer.layers.camera_roles import CameraRoles, camera_roles
from radiant_viewer.layers.change_layer import changed_layer, constraint_layer
from radiant_viewer.layers.footprint_layer import footprint_layer, overlap_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.load_layer import load_layer
from radiant_viewer.layers.region_layer import border_layer, edge_site_layer, region_layer, strip_layer
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView

PYRAMIDS_IN_DRAGS = 500
"""With more cameras a drag draws dots only: the lines of 2,000 take 15 % of a frame, and are 3 px
long on a map."""


def edited_layers(run: RunView, subject: PlanSubject, plan: EditedPlan, base: EditedPlan) -> list[Layer]:
    """Return the layers that depend on a plan; those of devices only where it has strips."""
    ground = ground_height(run.scene)
    cloud = plan.cloud
    roles = edited_roles(run, plan)
    owners = [np.array(edited.cloud.edge_ids)[edited.cloud.edge_of_camera] for edited in (base, plan)]
    is_drag = not plan.edges
    pyramids = not is_drag or len(run.scene.cameras) <= PYRAMIDS_IN_DRAGS
    layers = [
        region_layer(cloud, ground),
        border_layer(cloud, ground),
        changed_layer(subject.positions, owners[0] != owners[1]),
        camera_layer(run.scene.cameras, roles, "region", pyramids=pyramids),
        constraint_layer(subject.positions, cloud, plan.wishes.constraints, ground),
        load_layer(cloud, ground),
        edge_site_layer(cloud, ground),
    ]
    if not is_drag:
        layers += [strip_layer(cloud, plan.edges, ground), camera_layer(run.scene.cameras, roles, "device")]
    return layers


def edited_roles(run: RunView, plan: EditedPlan) -> CameraRoles:
    """Return the roles of the run's cameras under an edited plan."""
    return camera_roles(run.scene.cameras, plan.cloud, plan.edges, run.held_out)


def add_planning_layers(run: RunView, layers: list[Layer]) -> list[Layer]:
    """Insert footprints, changes, constraints and loads into a run's layers, in drawing order."""
    ground = ground_height(run.scene)
    positions = run.scene.cameras.centers
    below = sight_layers(run.scene, run, ground)
    changed = changed_layer(positions, np.zeros(len(positions), bool))
    above = [constraint_layer(positions, run.cloud_plan, PlanConstraints(), ground), load_layer(run.cloud_plan, ground)]
    names = [layer.name for layer in layers]
    first_cameras = next((index for index, name in enumerate(names) if name.startswith("Cameras by")), len(layers))
    edges = names.index("Edges") if "Edges" in names else len(layers)
    regions = names.index("Regions") + 1 if "Regions" in names else 0
    return [*layers[:regions], *below, *layers[regions:first_cameras], changed, *layers[first_cameras:edges], *above, *layers[edges:]]


def sight_layers(scene: SfmScene, run: RunView, ground: float) -> list[Layer]:
    """Return overlap and footprints, empty where no camera sees the ground from above."""
    footprints = scene_footprints(scene, ground)
    if footprints is None:
        return []
    try:
        return [overlap_layer(footprints, run.cloud_plan, run.unit, ground), footprint_layer(footprints, run.roles, run.cloud_plan, ground)]
    except BadInput:
        # The regions have no borders, so there is no area to count cells on.
        return []


def scene_footprints(scene: SfmScene, ground: float) -> Footprints | None:
    """Return the footprints of all images; None where no image sees the ground."""
    if not len(scene.cameras):
        return None
    footprints = ground_footprints(views_of_cameras(scene.cameras, ground))
    return footprints if (footprints.areas_m2 > 0).any() else None
