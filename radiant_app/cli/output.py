"""The options of `radiant render` and `radiant export`: what leaves a run as other files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from radiant_app.cli.option_types import AsJson, FileCrsOption, RequireCrsGridsOption, SizeOption
from radiant_app.report.tables import finish
from radiant_core.choices import ExportFormat, SpzVersion, TileContent, Trajectory
from radiant_core.errors import BadInput


def render(
    model: Annotated[Path, typer.Argument(help="A run, the folder of `radiant train`, or a model file.", show_default=False)],
    out: Annotated[
        Path, typer.Option("--out", help="New folder of PNGs, a .png, or a film: .webm, .gif, .mp4 (no browser).", show_default=False)
    ],
    cameras: Annotated[Path | None, typer.Option(help="cameras.safetensors; without any path the held-out cameras.")] = None,
    trajectory: Annotated[Trajectory | None, typer.Option(help="orbit: once around; border: along --border or the worst seam.")] = None,
    border: Annotated[str | None, typer.Option(help="Two edges, as EAST,WEST: fly along their border.")] = None,
    keyframes: Annotated[
        Path | None, typer.Option(help='JSON: {"keyframes": [{"time_s": 0, "position": [x, y, z], "target": [x, y, z]}, …]}.')
    ] = None,
    frames: Annotated[int, typer.Option(min=1, max=100_000, help="Frames of an orbit or a flight along a border.")] = 120,
    fps: Annotated[float, typer.Option(min=1, max=120, help="Frames a second of a film, and between keyframes.")] = 24.0,
    size: SizeOption = "960x540",
    long_side_px: Annotated[int | None, typer.Option("--long-side-px", min=16, help="Long side of the pictures, at most as given.")] = None,
    uncleaned: Annotated[bool, typer.Option("--uncleaned", help="The model as trained, whatever its cleaning leaves out.")] = False,
    as_json: AsJson = False,
) -> None:
    """Pictures or a film of a model: from cameras, around it, along a border, or by keyframes."""
    from radiant_app.quantities import size_wh_of
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.render import RenderRequest
        from radiant_app.commands.model.render import render as render_pictures

    request = RenderRequest(
        model=model,
        out=out,
        cameras=cameras,
        trajectory="border" if border is not None and trajectory is None else trajectory,
        border=None if border is None else tuple(border.split(",")),
        keyframes=keyframes,
        num_frames=frames,
        fps=fps,
        size_wh=size_wh_of(size),
        long_side_px=long_side_px,
        as_trained=uncleaned,
    )
    finish(render_pictures(request, terminal_display()), as_json)


def export(
    model: Annotated[Path, typer.Argument(help="Folder of `radiant run`, `train` or `sfm`, or a model alone.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="File to write; a folder for projects. Its ending says what.", show_default=False)],
    format: Annotated[  # noqa: A002
        ExportFormat | None,
        typer.Option(
            help="Model: ply, spz, sog, usd, lod, tiles, viewer. Project: colmap, nerfstudio. TIFF: ortho, dsm, dtm. Else as named."
        ),
    ] = None,
    resolution: Annotated[
        float | None, typer.Option(min=1e-6, help="Metres of a cell; else one pixel of the photographs (ortho), or two, or what fits.")
    ] = None,
    long_side_px: Annotated[
        int | None, typer.Option("--long-side-px", min=32, help="Long side of the pictures for a surface and --clean, else 640.")
    ] = None,
    interval: Annotated[float | None, typer.Option(help="Metres from one contour to the next, else some twenty levels.")] = None,
    tile_px: Annotated[
        int | None, typer.Option("--tile-px", min=16, max=8192, help="Side of a GeoTIFF's tiles, a multiple of 16, else 512.")
    ] = None,
    clean: Annotated[
        bool, typer.Option("--clean", help="A model: what too few photographs constrain goes into NAME_unconstrained.ply.")
    ] = False,
    uncleaned: Annotated[bool, typer.Option("--uncleaned", help="The model as trained, whatever its cleaning leaves out.")] = False,
    crs: FileCrsOption = None,
    require_grids: RequireCrsGridsOption = False,
    lod: Annotated[bool, typer.Option("--lod", help="A folder of streamed SOG: levels of detail that a viewer fetches as needed.")] = False,
    tiles: Annotated[
        TileContent | None,
        typer.Option("--tiles", help="A folder of 3D Tiles. spz: as CesiumJS draws them; plain: float32 attributes."),
    ] = None,
    spz_version: Annotated[
        int | None, typer.Option("--spz-version", min=2, max=4, help="spz: 2 (else) or 3, which all readers know; 4: Zstandard.")
    ] = None,
    levels: Annotated[int | None, typer.Option(min=1, max=8, help="Levels of detail, else as many as the model needs.")] = None,
    fit_levels: Annotated[bool | None, typer.Option(help="Fit coarser levels to pictures; else where two minutes do.")] = None,
    regions: Annotated[
        list[Path] | None, typer.Option(help="--lod of a PLY: run whose regions its chunks belong to; repeatable, a joined one last.")
    ] = None,
    photographs: Annotated[
        bool, typer.Option("--photographs", help="viewer: show the worst photographs beside the model; without it none leaves.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """A model, its plan, cameras or surface in the files of other programs; says what is lost."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.export.export import export as write_export
        from radiant_app.commands.export.request import ExportRequest

    request = ExportRequest(
        model=model,
        out=out,
        format=_asked_format(format, lod, tiles),
        tile_form=tiles,
        spz_version=cast("SpzVersion | None", spz_version),
        resolution=resolution,
        long_side_px=long_side_px,
        tile_px=tile_px,
        interval=interval,
        clean=clean,
        as_trained=uncleaned,
        crs=crs,
        require_grids=require_grids,
        num_levels=levels,
        fit_levels=fit_levels,
        regions=tuple(regions or ()),
        photographs=photographs,
    )
    finish(write_export(request, terminal_display()), as_json)


def view(
    model: Annotated[Path, typer.Argument(help="Folder of a run or training, or a 3DGS .ply.", show_default=False)],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0 for any that is free.")] = 0,
) -> None:
    """Fly through a model in a browser on this machine, until Ctrl-C.

    The page is kept in the run's folder viewer/ and made anew when the model has changed. Only this
    machine can open it, by the address that is printed, which holds a secret.
    """
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.inspect.view import view as serve_page

    serve_page(model, port, terminal_display(), typer.echo)


def _asked_format(given: ExportFormat | None, lod: bool, tiles: TileContent | None) -> ExportFormat | None:
    """The format that options ask for; BadInput where they ask for two."""
    asked: dict[str, ExportFormat | None] = {"--lod": "lod" if lod else None, "--tiles": "tiles" if tiles else None, "--format": given}
    kinds: set[ExportFormat] = {kind for kind in asked.values() if kind is not None}
    if len(kinds) > 1:
        named = " and ".join(option for option, kind in asked.items() if kind is not None)
        raise BadInput(f"{named} ask for {' and '.join(sorted(kinds))}: ask for one of them.")
    return next(iter(kinds), None)
