"""The named views of a run as finished pictures: what `radiant inspect --view … --screenshot` and the report show.

Each view is a list of layers and a page; window and pictures take the layers from here. Once per picture, 0.5 to 2 s.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import border_distance_m
from radiant_core.numerics import FloatArray
from radiant_core.plan.border_forecast import BorderForecast
from radiant_core.plan.buffers import EdgeBuffer
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.camera_layer import camera_layer
from radiant_viewer.camera_roles import CameraRoles, camera_roles
from radiant_viewer.charts import comparison_picture
from radiant_viewer.forecast_layer import buffer_layer, forecast_layers
from radiant_viewer.images import Image, load_image
from radiant_viewer.layers import Layer
from radiant_viewer.offscreen import render_map, render_view
from radiant_viewer.page import PageText
from radiant_viewer.region_layer import border_layer, duration_text, edge_site_layer, region_layer, strip_layer
from radiant_viewer.run_view import RunView, comparison_paths, finish_command, load_run_view, required_splats
from radiant_viewer.seam_layer import color_steps, seam_layer, seam_pieces
from radiant_viewer.splat_layer import sparse_point_layer, splat_layer
from radiant_viewer.waypoint_layer import waypoint_layer

View = Literal["regions", "cameras", "seams", "splats", "compare"]
"""regions: the plan; cameras: held-out error or split; seams: colour steps along borders; splats: the model in 3D;
compare: held-out photographs beside their renders, worst, middle and best."""
SIZE_WH = (1280, 900)


def screenshot(run_folder: Path, view: str, size_wh: tuple[int, int] = SIZE_WH) -> Image:
    """One view of a run (H,W,3); BadInput for an unknown view or one the run is not ready for, StoreDamaged for broken files."""
    if view not in get_args(View):
        raise BadInput(f"view {view!r} is unknown: use one of {', '.join(get_args(View))}.")
    run = load_run_view(run_folder)
    if view == "regions":
        return plan_picture(run.scene, run.cloud_plan, run.edge_plans, run.held_out, size_wh)
    if view == "cameras":
        return cameras_picture(run.scene, run.roles, run.psnr_db, size_wh)
    if view == "seams":
        return seams_picture(run.scene, run.cloud_plan, required_splats(run), size_wh)
    if view == "splats":
        return splats_picture(run.scene, run.cloud_plan, required_splats(run), size_wh)
    return comparisons(run)


def plan_picture(  # noqa: PLR0913
    scene: SfmScene,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    held_out: Collection[str] = (),
    size_wh: tuple[int, int] = SIZE_WH,
    *,
    forecasts: Sequence[BorderForecast] = (),
    buffers: Sequence[EdgeBuffer] = (),
) -> Image:
    """The map of a plan: regions, strips, cameras and edges with counts and predicted times, borders by forecast where there is one."""
    roles = camera_roles(scene.cameras, cloud_plan, edge_plans, held_out)
    subtitle = f"{len(scene.cameras)} cameras, {_plan_text(cloud_plan, len(roles.device_ids))}"
    ground = ground_height(scene)
    layers = plan_layers(scene, cloud_plan, edge_plans, roles)
    if buffers:
        layers.insert(-2, buffer_layer(scene.cameras.centers, cloud_plan, buffers))
    layers[-1:-1] = forecast_layers(forecasts, ground)
    return render_map(
        layers,
        size_wh,
        PageText(title="Plan", subtitle=subtitle, unit=scene.frame.unit),
    )


def waypoint_plan_picture(
    positions: FloatArray,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    size_wh: tuple[int, int] = SIZE_WH,
    *,
    forecasts: Sequence[BorderForecast] = (),
    buffers: Sequence[EdgeBuffer] = (),
) -> Image:
    """The map of a plan made from waypoints (P,3) m before anything was captured, borders by forecast where there is one."""
    num_devices = sum(len(plan.device_ids) for plan in edge_plans)
    layers = [
        region_layer(cloud_plan),
        strip_layer(cloud_plan, edge_plans),
        border_layer(cloud_plan),
        *([buffer_layer(positions, cloud_plan, buffers)] if buffers else []),
        waypoint_layer(positions, cloud_plan),
        *forecast_layers(forecasts),
        edge_site_layer(cloud_plan),
    ]
    subtitle = f"{len(positions)} waypoints, {_plan_text(cloud_plan, num_devices)}"
    return render_map(layers, size_wh, PageText(title="Plan before capture", subtitle=subtitle, unit="m"))


def _plan_text(cloud_plan: CloudPlan, num_devices: int) -> str:
    return (
        f"{len(cloud_plan.edge_ids)} edges, {num_devices} devices   ·   predicted makespan {duration_text(cloud_plan.makespan_s)}, "
        f"lower bound {duration_text(cloud_plan.lower_bound_s)}   ·   {cloud_plan.method}, {cloud_plan.status}"
    )


def plan_layers(scene: SfmScene, cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], roles: CameraRoles) -> list[Layer]:
    """Regions, strips, cameras by region, edges, from the ground up."""
    ground = ground_height(scene)
    return [
        region_layer(cloud_plan, ground),
        strip_layer(cloud_plan, edge_plans, ground),
        border_layer(cloud_plan, ground),
        camera_layer(scene.cameras, roles, "region"),
        edge_site_layer(cloud_plan, ground),
    ]


def cameras_picture(
    scene: SfmScene, roles: CameraRoles, psnr_db: Mapping[str, float] | None = None, size_wh: tuple[int, int] = SIZE_WH
) -> Image:
    """All cameras over the sparse points in 3D, coloured by PSNR once there are figures, by split before."""
    cameras = camera_layer(scene.cameras, roles, "psnr" if psnr_db else "split", psnr_db)
    subtitle = f"{len(scene.cameras)} cameras, {int(roles.held_out.sum())} held out"
    if psnr_db:
        worst = min(psnr_db, key=lambda name: psnr_db[name])
        mean = float(np.mean(list(psnr_db.values())))
        subtitle += f"   ·   held-out PSNR {mean:.2f} dB on average, lowest {psnr_db[worst]:.2f} dB ({worst})"
    return render_view([sparse_point_layer(scene), cameras], size_wh, PageText(title="Cameras", subtitle=subtitle, unit=scene.frame.unit))


def seams_picture(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, size_wh: tuple[int, int] = SIZE_WH) -> Image:
    """The map of the model with its borders coloured by the colour step across them."""
    layer, worst = seam_of(scene, cloud_plan, splats)
    layers = [splat_layer(splats), layer, edge_site_layer(cloud_plan, ground_height(scene))]
    subtitle = "Colour step across borders, beyond the scene's own texture   ·   " + worst
    return render_map(layers, size_wh, PageText(title="Seams", subtitle=subtitle, unit=scene.frame.unit))


def seam_of(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats) -> tuple[Layer, str]:
    """The layer of the borders' colour steps and one phrase about the worst; BadInput when the plan has one region only."""
    width = seam_band_width(cloud_plan)
    pieces = seam_pieces(cloud_plan, width)
    if not len(pieces.ends):
        raise BadInput("the plan has one region only: there is no border and no seam to look at.")
    steps = color_steps(splats, pieces, width)
    label = f"Colour step (8-bit levels), bands of {width:.3g} {scene.frame.unit}"
    layer = seam_layer(pieces, steps, label, ground_height(scene))
    whole_borders = color_steps(splats, pieces, width, pooled_widths=np.inf)
    if not np.isfinite(whole_borders).any():
        return layer, "too few Gaussians beside the borders to say"
    worst = int(np.nanargmax(whole_borders))
    first, second = (cloud_plan.edge_ids[edge] for edge in pieces.edge_pairs[worst])
    whole = f"over its whole length the border of {first} and {second} steps by {whole_borders[worst]:.1f} levels"
    return layer, f"{whole}, single pieces by up to {np.nanmax(steps):.0f}"


def seam_band_width(cloud_plan: CloudPlan) -> float:
    """Width of the bands beside a border: a twentieth of the regions' diagonal, at most a third of the deepest site."""
    corners = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    if len(corners) < 3:
        raise BadInput("the plan has no regions: there is no border and no seam to look at.")
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    middles = np.array([border.mean(axis=0) for border in cloud_plan.borders if len(border) >= 3])
    depths = border_distance_m(middles, cloud_plan)
    depth = float(depths[np.isfinite(depths)].max(initial=0.0))
    return min(diagonal / 20, depth / 3) if depth > 0 else diagonal / 20


def splats_picture(scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, size_wh: tuple[int, int] = SIZE_WH) -> Image:
    """The model's Gaussians as points in 3D with the borders of the regions on the ground."""
    layers = [splat_layer(splats), border_layer(cloud_plan, ground_height(scene))]
    subtitle = f"{len(splats):,} Gaussians, spherical harmonics of degree {splats.sh_degree}"
    return render_view(layers, size_wh, PageText(title="Model", subtitle=subtitle, unit=scene.frame.unit))


def comparisons(run: RunView) -> Image:
    """Photograph, render and difference of the held-out photographs with the lowest, the middle and the highest PSNR, one below the
    other; BadInput before evaluation."""
    if not run.psnr_db:
        raise BadInput(f"{run.folder} has no figures of held-out photographs: {finish_command(run.folder)}.")
    psnr_db = run.psnr_db
    ordered = sorted(psnr_db, key=lambda name: psnr_db[name])
    # Keyed by name: with one or two photographs a row is not shown twice.
    shown = {ordered[0]: "lowest", ordered[len(ordered) // 2]: "middle", ordered[-1]: "highest"} | {ordered[0]: "lowest"}
    rows = []
    for name, place in shown.items():
        photo, render, difference = (load_image(path) for path in comparison_paths(run, name))
        rows.append(comparison_picture(photo, render, difference, title=f"{name}: {psnr_db[name]:.2f} dB, {place} of {len(ordered)}"))
    width = max(row.shape[1] for row in rows)
    return np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows])


def ground_height(scene: SfmScene) -> float:
    """Height at which regions are drawn in 3D: that of the lowest tenth of the sparse points, 0 without points."""
    return float(np.quantile(scene.points[:, 2], 0.1)) if len(scene.points) else 0.0
