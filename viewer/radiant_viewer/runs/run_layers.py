"""The layers of a run from the ground up, for window, page and pictures. Once per run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.layers.camera_layer import camera_layer
from radiant_viewer.layers.camera_roles import CameraRoles
from radiant_viewer.layers.known_layer import NAME as KNOWN_LAYER
from radiant_viewer.layers.known_layer import known_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.region_layer import border_layer, edge_site_layer, region_layer, strip_layer
from radiant_viewer.layers.seam_layer import SeamPieces, seam_layer
from radiant_viewer.layers.splat_layer import sparse_point_layer
from radiant_viewer.layers.support_layer import NAME as SUPPORT
from radiant_viewer.layers.support_layer import support_layer
from radiant_viewer.runs.border_figures import VISIBLE_LEVELS, BorderFigures, border_figures, seam_band_width
from radiant_viewer.runs.run_view import RunView, run_support
from radiant_viewer.runs.shown_model import SURROUNDINGS, framed_box, model_layers

COVERING = frozenset(
    {
        "Device strips",
        "Gaussians",
        SURROUNDINGS,
        SUPPORT,
        KNOWN_LAYER,
        "Overlap",
        "Footprints",
        "Cameras by device",
        "Cameras by split",
        "Cameras by PSNR",
    }
)
"""Layers that cover others."""


def run_layers(run: RunView, *, with_seams: bool = True) -> list[Layer]:
    """Return the layers of a run: points, plan, cameras and, if it has them, model, errors, seams.
    A training or a scene has no plan: points, model, and cameras by split and error."""
    # Before capture there are no points, and "0 points" in a legend looks like a run that failed.
    points = [sparse_point_layer(run.scene)] if len(run.scene.points) else []
    # The points of a run in the field are its Gaussians already.
    if run.splats is not None:
        names = {layer.name for layer in points}
        points += [layer for layer in model_layers(run.splats, framed_box(run.scene, run.cloud_plan)) if layer.name not in names]
    if run.splats is not None and (support := run_support(run)) is not None:
        points.append(support_layer(run.splats, support, run.scene.points))
    if (what_is_known := layer_of_known(run)[0]) is not None:
        points.append(what_is_known)
    cameras = [camera_layer(run.scene.cameras, run.roles, "split")]
    if run.placed_psnr_db:
        cameras.append(camera_layer(run.scene.cameras, run.roles, "psnr", run.placed_psnr_db))
    if run.kind != "run":
        return [*points, *cameras]
    regions, strips, borders, by_region, edges = plan_layers(run.scene, run.cloud_plan, run.edge_plans, run.roles)
    by_device = camera_layer(run.scene.cameras, run.roles, "device")
    seams = []
    if with_seams and run.splats is not None and len(run.cloud_plan.edge_ids) > 1:
        seams.append(color_step_layer(run.scene, run.cloud_plan, run.splats))
    return [regions, strips, *points, borders, by_region, by_device, *cameras, *seams, edges]


def layer_of_known(run: RunView) -> tuple[Layer | None, str]:
    """Return the layer of the map that `radiant plan --next RUN --out RUN/known` made, if there is
    one, and why it cannot be shown, as the end of a summary."""
    try:
        return known_layer(run.folder, run.scene.frame, ground_height(run.scene)), ""
    except BadInput as error:
        return None, f".   {error}"


def hidden_at_first(layers: Sequence[Layer]) -> frozenset[str]:
    """Return the names of the layers that are hidden at first, since they cover others."""
    names = {layer.name for layer in layers}
    # The model is what one sees; without one, its points are.
    hidden = COVERING - {"Gaussians"} | ({"Sparse points"} if "Gaussians" in names else set())
    return hidden - (set() if "Cameras by region" in names else {"Cameras by split"})


def plan_layers(scene: SfmScene, cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], roles: CameraRoles) -> list[Layer]:
    """Return regions, strips, borders, cameras by region and edges, in drawing order."""
    ground = ground_height(scene)
    return [
        region_layer(cloud_plan, ground),
        strip_layer(cloud_plan, edge_plans, ground),
        border_layer(cloud_plan, ground),
        camera_layer(scene.cameras, roles, "region"),
        edge_site_layer(cloud_plan, ground),
    ]


def color_step_layer(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats) -> Layer:
    """Return the layer of the borders' colour steps; BadInput for a plan of one region."""
    return figures_layer(scene, cloud_plan, border_figures(scene, cloud_plan, splats))


def figures_layer(scene: SfmScene, cloud_plan: CloudPlan, figures: Sequence[BorderFigures]) -> Layer:
    """Return the layer of borders whose figures are known; its scale ends at twice the visible
    levels or higher."""
    pieces = SeamPieces(
        ends=np.concatenate([one.ends for one in figures]),
        edge_pairs=np.concatenate([np.tile([one.border.first, one.border.second], (len(one.ends), 1)) for one in figures]),
    )
    label = f"Levels over texture, in pieces of {seam_band_width(cloud_plan):.3g} {scene.frame.unit}"
    levels = np.concatenate([one.levels_above_texture for one in figures])
    return seam_layer(pieces, levels, label, ground_height(scene), 2 * VISIBLE_LEVELS)


def ground_height(scene: SfmScene) -> float:
    """Return the height of regions in 3D: the lowest tenth of the sparse points, 0 without any."""
    return float(np.quantile(scene.points[:, 2], 0.1)) if len(scene.points) else 0.0
