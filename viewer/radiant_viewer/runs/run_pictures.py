"""The named views of a run as finished pictures, for `radiant inspect --view` and the report.

Each view is a list of layers and a page. Once per picture, 0.5 to 2 s.

    regions   the plan
    cameras   held-out error or split
    seams     colour steps along borders
    splats    the model in 3D
    compare   held-out photographs beside their renders: worst, middle and best
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import get_args

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.choices import View
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.borders.forecast import BorderForecast
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.render.trajectories import box_corners
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_viewer.charts.charts import comparison_picture
from radiant_viewer.layers.camera_layer import camera_layer
from radiant_viewer.layers.camera_roles import CameraRoles, camera_roles
from radiant_viewer.layers.forecast_layer import buffer_layer, forecast_layers
from radiant_viewer.layers.layer import Label, Layer, LegendEntry, framing_positions
from radiant_viewer.layers.palette import INK
from radiant_viewer.layers.region_layer import border_layer, duration_text, edge_site_layer, region_layer, strip_layer
from radiant_viewer.layers.splat_layer import sparse_point_layer
from radiant_viewer.layers.waypoint_layer import waypoint_layer
from radiant_viewer.pictures.images import Image, load_image
from radiant_viewer.pictures.offscreen import render_map, render_view
from radiant_viewer.pictures.page import PageText, compose_page, drawing_size_wh
from radiant_viewer.pictures.splat_picture import draw_ground_map, draw_splat_view, fit_camera
from radiant_viewer.runs.border_figures import border_figures
from radiant_viewer.runs.run_layers import figures_layer, ground_height, plan_layers
from radiant_viewer.runs.run_view import RunView, comparison_paths, load_run_view, require_splats
from radiant_viewer.runs.seam_findings import SeamFinding, proven_excess_db, seam_findings, verdict_text
from radiant_viewer.runs.shown_model import framed_box, framed_positions, model_box, shown_model, shown_of_run
from radiant_viewer.runs.unplanned import FolderKind, finish_command

SIZE_WH = (1280, 900)
USUAL_VIEW: dict[FolderKind, View] = {"run": "regions", "training": "splats", "scene": "cameras"}


def screenshot(run_folder: Path, view: str | None, size_wh: tuple[int, int] = SIZE_WH, camera: str | None = None) -> Image:
    """Return one view of a run, a training or a scene, (H,W,3).

    Args:
        run_folder: as in `load_run_view`.
        view: one of `View`; None for the usual one.
        size_wh: of the picture, px; the height of "compare" follows from its rows.
        camera: name of a photograph: the viewpoint of "splats", or the only row of "compare".

    Raises: BadInput for an unknown view or camera, or missing files; StoreDamaged for broken ones.
    """
    if view is not None and view not in get_args(View):
        raise BadInput(f"view {view!r} is unknown: use one of {', '.join(get_args(View))}.")
    run = load_run_view(run_folder)
    view = view or USUAL_VIEW[run.kind]
    if run.kind != "run" and view in ("regions", "seams"):
        raise BadInput(f"{run_folder} was made without a plan, so there are no {view}: use --view cameras, splats or compare.")
    if camera is not None:
        _require_camera(run, view, camera)
    if view == "regions":
        return plan_picture(run.scene, run.cloud_plan, run.edge_plans, run.held_out, size_wh)
    if view == "cameras":
        splats = None if run.splats is None else shown_of_run(run).splats
        return cameras_picture(run.scene, run.roles, run.psnr_db, size_wh, splats)
    if view == "seams":
        return seams_picture(run.scene, run.cloud_plan, require_splats(run), size_wh, proven_excess_db(run.folder))
    if view == "splats":
        return splats_picture(run.scene, run.cloud_plan, require_splats(run), size_wh, camera)
    return comparisons_picture(run, size_wh[0], camera)


def _require_camera(run: RunView, view: str, camera: str) -> None:
    if view not in ("splats", "compare"):
        raise BadInput(f"a camera is of the views splats and compare, not of {view!r}: leave it out.")
    names = run.photographs if view == "compare" else run.scene.cameras.names
    if camera not in names:
        near = get_close_matches(camera, names, 1, 0)
        raise BadInput(f"there is no photograph {camera!r} in this run: did you mean {near[0]!r}?" if near else "the run has no cameras.")


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
    """Return the map of a plan: regions, strips, cameras, edges; with forecasts where given."""
    roles = camera_roles(scene.cameras, cloud_plan, edge_plans, held_out)
    subtitle = f"{len(scene.cameras)} cameras, {_plan_text(cloud_plan, len(roles.device_ids))}"
    ground = ground_height(scene)
    layers = plan_layers(scene, cloud_plan, edge_plans, roles)
    if buffers:
        layers.insert(-2, buffer_layer(scene.cameras.centers, cloud_plan, buffers))
    layers[-1:-1] = forecast_layers(forecasts, ground)
    return render_map(layers, size_wh, PageText(title="Plan", subtitle=subtitle, unit=scene.frame.unit))


def waypoint_plan_picture(
    positions: FloatArray,
    cloud_plan: CloudPlan,
    edge_plans: Sequence[EdgePlan],
    size_wh: tuple[int, int] = SIZE_WH,
    *,
    forecasts: Sequence[BorderForecast] = (),
    buffers: Sequence[EdgeBuffer] = (),
) -> Image:
    """Return the map of a plan of waypoints (P,3) m before capture, with forecasts if given."""
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
    cut = "" if cloud_plan.looks is None else ", cut where cameras look"
    machines = f"{_counted(len(cloud_plan.edge_ids), 'edge')}, {_counted(num_devices, 'device')}"
    return (
        f"{machines}   ·   predicted makespan {duration_text(cloud_plan.makespan_s)}, "
        f"lower bound {duration_text(cloud_plan.lower_bound_s)}   ·   {cloud_plan.method}, {cloud_plan.status}{cut}"
    )


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def cameras_picture(
    scene: SfmScene,
    roles: CameraRoles,
    psnr_db: Mapping[str, float] | None = None,
    size_wh: tuple[int, int] = SIZE_WH,
    splats: Splats | None = None,
) -> Image:
    """Return cameras in 3D among the model, or without one over the sparse points, coloured by PSNR
    if known, else by split."""
    unplaced = len(set(psnr_db or ()) - set(scene.cameras.names))
    placed = psnr_db and len(psnr_db) > unplaced
    cameras = camera_layer(scene.cameras, roles, "psnr" if placed else "split", psnr_db)
    subtitle = f"{len(scene.cameras)} cameras, {int(roles.held_out.sum())} held out"
    if unplaced:
        subtitle = f"{len(scene.cameras)} cameras; {unplaced} held out, whose places stayed with their devices"
    if psnr_db:
        worst = min(psnr_db, key=lambda name: psnr_db[name])
        mean = float(np.mean(list(psnr_db.values())))
        subtitle += f"   ·   held-out PSNR {mean:.2f} dB on average, lowest {psnr_db[worst]:.2f} dB ({worst})"
    points = [sparse_point_layer(scene)] if len(scene.points) else []
    text = PageText(title="Cameras", subtitle=subtitle, unit=scene.frame.unit)
    if splats is None:
        return render_view([*points, cameras], size_wh, text)
    view = fit_camera(framing_positions([*points, cameras]), drawing_size_wh(size_wh, is_map=False))
    return compose_page(draw_splat_view([cameras], splats, view), [cameras], size_wh, text)


def seams_picture(
    scene: SfmScene,
    cloud_plan: CloudPlan,
    splats: Splats,
    size_wh: tuple[int, int] = SIZE_WH,
    proven_db: Mapping[frozenset[str], float] | None = None,
) -> Image:
    """Return the map of the model with its borders coloured by their colour steps; seams are named,
    also those that photographs show (`proven_excess_db`)."""
    findings = seam_findings(scene, cloud_plan, splats, proven_db)
    ground, unit = ground_height(scene), scene.frame.unit
    labels = tuple(_finding_label(finding, ground) for finding in findings if finding.has_seam)
    # Labels of seams are placed before those of edges.
    seams = replace(figures_layer(scene, cloud_plan, [finding.figures for finding in findings]), labels=labels)
    # Seams cover the borders between regions.
    outline = replace(border_layer(cloud_plan, ground), legend=(LegendEntry(text="Outer border", color=INK, marker="line"),))
    layers = [outline, seams, edge_site_layer(cloud_plan, ground)]
    drawing = draw_ground_map(layers, splats, drawing_size_wh(size_wh, is_map=True))
    return compose_page(drawing, layers, size_wh, PageText(title="Seams", subtitle=verdict_text(findings, unit), unit=unit))


def worst_border(run: RunView) -> Border:
    """Return the observed part of the border with the largest colour step of a run's model, without
    a verdict the longest border; BadInput without any border."""
    figures = border_figures(run.scene, run.cloud_plan, require_splats(run))
    worst = figures[0] if figures[0].has_verdict else max(figures, key=lambda one: one.border.length_m)
    return replace(worst.border, ends=worst.observed_ends)


def _finding_label(finding: SeamFinding, ground: float) -> Label:
    border = finding.figures.border
    step = [f"{finding.figures.step_levels:.0f} levels overall"] if finding.figures.has_step else []
    excess = [] if finding.excess_db is None else [f"{finding.excess_db:+.1f} dB of error beyond it"]
    text = f"{finding.figures.title}\nseam: {', '.join([*step, *excess])}"
    # Beside the line, so that it does not hide it.
    label_place = border.ends.mean(axis=0) + 0.15 * border.length_m * border.toward_first
    return Label(text=text, position=np.append(label_place, ground), strong=True)


def splats_picture(
    scene: SfmScene, cloud_plan: CloudPlan, splats: Splats, size_wh: tuple[int, int] = SIZE_WH, camera: str | None = None
) -> Image:
    """Return the model by our renderer, from obliquely above or from one of its cameras, with the
    regions' borders on the ground."""
    ground = ground_height(scene)
    has_regions = any(len(border) for border in cloud_plan.borders)
    layers = [border_layer(cloud_plan, ground), _region_names(cloud_plan, ground)] if has_regions else []
    room_wh = drawing_size_wh(size_wh, is_map=False, has_legend=has_regions)
    if camera is None:
        view = fit_camera(framed_positions(scene, cloud_plan), room_wh)
        visible = shown_model(splats, framed_box(scene, cloud_plan))
        subtitle, splats = _model_text(splats, visible.sentence), visible.splats
    else:
        view = _fit_to_page(scene.cameras.named([camera]), room_wh)
        subtitle = f"{_model_text(splats)}   ·   from {camera}"
    text = PageText(title="Model", subtitle=subtitle, unit=scene.frame.unit)
    return compose_page(draw_splat_view(layers, splats, view), layers, size_wh, text)


def _model_text(splats: Splats, hidden: str = "") -> str:
    """All Gaussians of a model, and what of them is `hidden`."""
    return f"{len(splats):,} Gaussians, spherical harmonics of degree {splats.sh_degree}{f'; {hidden}' if hidden else ''}"


def model_picture(splats: Splats, size_wh: tuple[int, int] = SIZE_WH) -> Image:
    """Return a model alone by our renderer, from obliquely above."""
    box = model_box(splats)
    model = shown_model(splats, box)
    subtitle = _model_text(splats, model.sentence)
    room_wh = drawing_size_wh(size_wh, is_map=False, has_legend=False)
    drawing = draw_splat_view([], model.splats, fit_camera(box_corners(box), room_wh))
    # A model alone has no unit.
    return compose_page(drawing, [], size_wh, PageText(title="Model", subtitle=subtitle, unit="units"))


def _region_names(cloud_plan: CloudPlan, ground: float) -> Layer:
    regions = [(edge, border) for edge, border in zip(cloud_plan.edge_ids, cloud_plan.borders, strict=True) if len(border) >= 3]
    labels = tuple(Label(text=edge, position=np.append(border.mean(axis=0), ground), strong=True) for edge, border in regions)
    return Layer(name="Regions", labels=labels)


def _fit_to_page(camera: Cameras, room_wh: tuple[int, int]) -> Cameras:
    """Return the camera with a picture of `room_wh`: all it sees, and more at two sides."""
    old_wh = camera.sizes_wh[0]
    scale = float(np.min(np.array(room_wh) / old_wh))
    K = camera.Ks[0].copy()
    K[:2] *= scale
    K[:2, 2] += (np.array(room_wh) - scale * old_wh) / 2
    return Cameras(names=camera.names, Ks=K[None], cam_from_world=camera.cam_from_world, sizes_wh=np.array([room_wh], np.int64))


def comparisons_picture(run: RunView, width_px: int = SIZE_WH[0], camera: str | None = None) -> Image:
    """Return photograph, render and difference of the held-out photographs with lowest, median and
    highest PSNR, or of `camera`; BadInput before evaluation, or where `camera` was trained on."""
    if not run.psnr_db:
        raise BadInput(f"{run.folder} has no figures of held-out photographs: {finish_command(run.folder)}.")
    psnr_db = run.psnr_db
    if camera is not None and camera not in psnr_db:
        raise BadInput(f"{camera!r} was trained on, so nothing compares it: choose one of {', '.join(sorted(psnr_db)[:4])} …")
    ordered = sorted(psnr_db, key=lambda name: psnr_db[name])
    # Keyed by name: with one or two photographs a row is not shown twice.
    places = {ordered[0]: "lowest", ordered[len(ordered) // 2]: "middle", ordered[-1]: "highest"} | {ordered[0]: "lowest"}
    if camera is not None:
        places = {camera: f"number {ordered.index(camera) + 1} from below"}
    rows = []
    for name, place in places.items():
        photo, render, difference = (load_image(path) for path in comparison_paths(run, name))
        title = f"{name}: {psnr_db[name]:.2f} dB, {place} of {len(ordered)}"
        rows.append(comparison_picture(photo, render, difference, title=title, width_px=width_px))
    width = max(row.shape[1] for row in rows)
    return np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows])
