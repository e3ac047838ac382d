"""`radiant export` of levels of detail: streamed SOG, 3D Tiles, and the page that shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from radiant_app.commands.export.request import ExportRequest, exported_model, left_out_of, run_of
from radiant_app.commands.inspect.lod_regions import lod_regions
from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.model.place import ExportPlace
from radiant_app.commands.run.steps import stage_bar
from radiant_app.events import Warned
from radiant_app.files.run_folder import create_folder
from radiant_app.report.progress import ProgressDisplay
from radiant_core.choices import TileContent
from radiant_core.errors import BadInput
from radiant_core.lod.cells import LodRegion
from radiant_core.lod.levels import LodLimits
from radiant_core.splats import Splats

MAX_FITTING_S = 120.0
"""Levels are fitted without being asked for where that takes less processor time: some 100,000
Gaussians."""


def export_lod(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """A folder of streamed SOG; its figures."""
    from radiant_core.export.lod import META_NAME, save_lod

    splats, cleaned = exported_model(request, display)
    regions = lod_regions(request.model, splats, request.regions)
    limits = _limits_of(request, LodLimits(), splats, regions, display)
    with create_folder(request.out, whole=True), stage_bar(display, "levels") as report:
        figures = save_lod(
            request.out,
            splats,
            regions,
            limits,
            lambda num_done, total: report(num_done, total, "Gaussians"),
        )
        place = _place_of(request).write_local(request.out / META_NAME)
    errors = {name: float(f"{value:.3g}") for name, value in asdict(figures.errors).items()}
    levels = {
        "levels": ", ".join(f"{count:,}" for count in figures.counts),
        **_limit_texts(limits),
        "far_field": figures.num_far,
        "chunks": figures.num_chunks,
    }
    return {"gaussians": len(splats), **levels, **errors, **cleaned, **place}


def export_tiles(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """A folder of 3D Tiles, on the globe where the run has GPS; its figures."""
    from radiant_core.export.tiles import TILE_LIMITS, TILESET_NAME, TileOptions, save_tiles

    splats, cleaned = exported_model(request, display)
    regions = lod_regions(request.model, splats, request.regions)
    limits = _limits_of(request, TILE_LIMITS, splats, regions, display)
    form = request.tile_form or "spz"
    _warn_of_form(form, splats, display)
    place = _place_of(request)
    frame = place.frame
    if frame is None or frame.kind != "metric":
        display(Warned(stage="export", message="without GPS the tiles have no place on the globe."))
    with create_folder(request.out, whole=True), stage_bar(display, "tiles") as report:
        counts = save_tiles(
            request.out,
            splats,
            regions,
            TileOptions(frame=frame, limits=limits, form=form),
            lambda num_done, total: report(num_done, total, "Gaussians"),
        )
        written = place.write_local(request.out / TILESET_NAME)
    return {"gaussians": len(splats), "levels": ", ".join(f"{count:,}" for count in counts), **_limit_texts(limits), **cleaned, **written}


def _warn_of_form(form: TileContent, splats: Splats, display: ProgressDisplay) -> None:
    """Say which readers a form of tiles shuts out, and what it cannot hold."""
    from radiant_core.io.spz_cuts import spz_cuts

    if form == "plain":
        message = (
            "CesiumJS (1.139 to 1.145) does not draw plain tiles: they are for readers of glTF's extension itself, such as three.js; "
            "--tiles spz is what CesiumJS draws."
        )
        display(Warned(stage="export", message=message))
        return
    # Each tile has its own middle and as many bits as its centres need.
    if lost := replace(spz_cuts(splats), num_left_out=0).sentence():
        display(Warned(stage="export", message=lost))


def export_viewer(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """The page that flies through a model, as a folder or one .html; its figures."""
    from radiant_app.commands.inspect.view import scene_page
    from radiant_viewer.share.folder import save_page, save_single_page

    model = given_model(request.model, display, as_trained=request.as_trained)
    splats = None if request.model.is_dir() else model.splats
    page = scene_page(
        request.model, splats, with_photographs=request.photographs, as_trained=request.as_trained, surroundings=request.surroundings
    )
    counts = {"gaussians": len(page.splats), "places": len(page.places), "photographs": len(page.pairs), **left_out_of(model)}
    if request.out.suffix.lower() == ".html":
        from radiant_core.export.sog import moved_sentence

        if lost := moved_sentence(page.splats):
            display(Warned(stage="export", message=lost))
        if request.num_levels is not None or request.fit_levels is not None or request.regions:
            raise BadInput("--levels, --fit-levels and --regions are of a folder, and one file has no levels: leave them out.")
        return {**counts, "bytes": save_single_page(request.out, page)}
    regions = lod_regions(request.model, page.splats, request.regions)
    limits = _limits_of(request, LodLimits(), page.splats, regions, display)
    with create_folder(request.out, whole=True), stage_bar(display, "page") as report:
        figures = save_page(request.out, page, regions, limits, lambda num_done, total: report(num_done, total, "Gaussians"))
    return {
        **counts,
        "levels": ", ".join(f"{count:,}" for count in figures.counts),
        **_limit_texts(limits),
        "open": "on any static host: index.html",
    }


def _limits_of(
    request: ExportRequest, limits: LodLimits, splats: Splats, regions: Sequence[LodRegion], display: ProgressDisplay
) -> LodLimits:
    """What was asked for of the levels of a model; says so where they are not fitted."""
    from radiant_core.lod.fitting import fit_level, fitting_s

    limits = replace(limits, num_levels=request.num_levels)
    num_levels, num_chunks = limits.levels_of(len(splats)), max(len(regions), -(-len(splats) // limits.chunk_count))
    if num_levels == 1 and request.fit_levels:
        raise BadInput(f"--fit-levels is of coarser levels, and {len(splats):,} Gaussians get one level: leave it out, or add --levels 2.")
    takes_s = fitting_s(len(splats), num_levels, num_chunks)
    fit = takes_s <= MAX_FITTING_S if request.fit_levels is None else request.fit_levels
    if request.fit_levels is None and not fit:
        message = (
            f"the coarser levels of {len(splats):,} Gaussians are merged, not fitted: fitting brings them some 1 to 5 dB nearer to the"
            f" finest and takes about {takes_s / 60:.0f} min of processor time; --fit-levels does it, --no-fit-levels keeps this quiet."
        )
        display(Warned(stage="export", message=message))
    if not (fit and num_levels > 1):
        return limits
    # Only a run says which way is up.
    return replace(limits, fit=partial(fit_level, from_above=request.model.is_dir() or bool(request.regions)))


def _limit_texts(limits: LodLimits) -> dict[str, str]:
    """How the coarser levels were made, for the command line."""
    return {"coarser_levels": "fitted where that is nearer" if limits.fit else "merged"}


def _place_of(request: ExportRequest) -> ExportPlace:
    """Where the scene's own metres lie; of a run in the field as its delivery says."""
    return ExportPlace(frame=run_of(request).scene.frame if request.model.is_dir() else None)
