"""The options of `radiant render`, `export`, `evaluate` and `clean`; heavy libraries are imported
inside, as in `cli.app`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from radiant_app.cli.option_types import AsJson, FileCrsOption, LpipsNet, LpipsWeights, RequireCrsGridsOption, SizeOption
from radiant_app.quantities import size_wh_of
from radiant_app.report.figure_words import OF_GAUSSIANS
from radiant_app.report.tables import finish, print_figures
from radiant_core.choices import ExportFormat, SpzVersion, TileContent, Trajectory
from radiant_core.errors import BadInput

_PATH, _DETAIL, _SURFACE = "Where the camera goes", "Levels of detail and tiles", "Surfaces and maps"
_RULES, _STEPS = "What is left out", "Steps that were made"
_POLYGON = 'a .geojson file with one polygon, or "x,y x,y x,y" in the model\'s coordinates.'
Uncleaned = Annotated[bool, typer.Option("--uncleaned", help="The model as trained, including what its cleaning leaves out.")]

AroundOption = Annotated[
    bool | None,
    typer.Option(
        "--surroundings/--no-surroundings",
        help="What lies around the scene; by default in files of the model, not in a page.",
        show_default=False,
    ),
]


def render(
    model: Annotated[Path, typer.Argument(help="A run, the folder of `radiant train`, or a model file.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Argument(help="A .png, a film (.webm, .gif, .mp4), or a new folder for PNGs.", show_default=False),
    ] = None,
    out_option: Annotated[Path | None, typer.Option("--out", help="The same as OUT.")] = None,
    size: SizeOption = "960x540",
    long_side_px: Annotated[
        int | None, typer.Option("--long-side-px", min=16, help="Long side of the pictures, at most that of the cameras.")
    ] = None,
    uncleaned: Uncleaned = False,
    surroundings: Annotated[
        bool, typer.Option("--surroundings", help="Show what lies around the scene too; orbits and keyframes leave it out by default.")
    ] = False,
    cameras: Annotated[
        Path | None,
        typer.Option(help="cameras.safetensors to render; by default the held-out cameras.", rich_help_panel=_PATH),
    ] = None,
    trajectory: Annotated[
        Trajectory | None, typer.Option(help="orbit: once around; border: along --border or the worst seam.", rich_help_panel=_PATH)
    ] = None,
    border: Annotated[str | None, typer.Option(help="Two edges, as EAST,WEST: fly along their border.", rich_help_panel=_PATH)] = None,
    keyframes: Annotated[
        Path | None,
        typer.Option(help='JSON: {"keyframes": [{"time_s": 0, "position": [x, y, z], "target": [x, y, z]}, …]}.', rich_help_panel=_PATH),
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, max=100_000, help="Frames of an orbit or a flight along a border.", rich_help_panel=_PATH)
    ] = 120,
    fps: Annotated[
        float, typer.Option(min=1, max=120, help="Frames per second of a film, and between keyframes.", rich_help_panel=_PATH)
    ] = 24.0,
    as_json: AsJson = False,
) -> None:
    """Render pictures or a film of a model.

    The camera stands where photographs were held out, goes around the scene, along a border or
    through keyframes.

    radiant render RUN picture.png
    radiant render RUN orbit.webm --trajectory orbit
    radiant render RUN heldout_pictures
    """
    from radiant_app.report.progress import show_starting, terminal_display

    if (out is None) == (out_option is None):
        raise BadInput("name one place to write, a .png, a film or a new folder: radiant render MODEL OUT.")
    with show_starting():
        from radiant_app.commands.model.render import RenderRequest
        from radiant_app.commands.model.render import render as render_pictures

    request = RenderRequest(
        model=model,
        out=cast("Path", out or out_option),
        cameras=cameras,
        trajectory="border" if border is not None and trajectory is None else trajectory,
        border=None if border is None else tuple(border.split(",")),
        keyframes=keyframes,
        num_frames=frames,
        fps=fps,
        size_wh=size_wh_of(size),
        long_side_px=long_side_px,
        as_trained=uncleaned,
        surroundings=surroundings,
    )
    finish(render_pictures(request, terminal_display()), as_json)


FormatOption = Annotated[
    ExportFormat | None,
    typer.Option(
        metavar="FORMAT",
        help="Model: ply, spz, sog, usd, lod, tiles, viewer. Project: colmap, nerfstudio. TIFF: ortho, dsm, dtm. "
        "Also geojson, contours, mesh, laz, glb. By default as the ending of OUT says.",
    ),
]
CellOption = Annotated[
    float | None,
    typer.Option(
        min=1e-6,
        help="Metres of a cell; by default a pixel of the photographs (ortho), or two, or what fits.",
        rich_help_panel=_SURFACE,
    ),
]
SurfaceSideOption = Annotated[
    int | None,
    typer.Option(
        "--long-side-px", min=32, help="Long side of the pictures for a surface and --clean; by default 640.", rich_help_panel=_SURFACE
    ),
]
IntervalOption = Annotated[
    float | None, typer.Option(help="Metres between contours; by default some twenty levels.", rich_help_panel=_SURFACE)
]
TileSideOption = Annotated[
    int | None,
    typer.Option(
        "--tile-px",
        min=16,
        max=8192,
        help="Side of a GeoTIFF's tiles, a multiple of 16; by default 512.",
        rich_help_panel=_SURFACE,
    ),
]
LodOption = Annotated[
    bool,
    typer.Option("--lod", help="Streamed SOG in a folder: levels of detail that a viewer fetches as needed.", rich_help_panel=_DETAIL),
]
TilesOption = Annotated[
    TileContent | None,
    typer.Option("--tiles", help="3D Tiles in a folder. spz: as CesiumJS draws them; plain: float32 attributes.", rich_help_panel=_DETAIL),
]
SpzVersionOption = Annotated[
    int | None,
    typer.Option(
        "--spz-version",
        min=2,
        max=4,
        help="spz: 2 (default) or 3, which all readers know; 4: Zstandard.",
        rich_help_panel=_DETAIL,
    ),
]
LevelsOption = Annotated[
    int | None, typer.Option(min=1, max=8, help="Levels of detail; by default as many as the model needs.", rich_help_panel=_DETAIL)
]
FitOption = Annotated[
    bool | None,
    typer.Option(help="Fit coarser levels to pictures; by default where that takes under two minutes.", rich_help_panel=_DETAIL),
]
RegionsOption = Annotated[
    list[Path] | None,
    typer.Option(help="--lod of a PLY: run whose regions divide it into chunks; repeatable, a joined one last.", rich_help_panel=_DETAIL),
]


def export(
    model: Annotated[Path, typer.Argument(help="Folder of `radiant run`, `train` or `sfm`, or a model file.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="File to write, whose ending chooses the format; a folder for projects.", show_default=False)],
    format: FormatOption = None,  # noqa: A002
    clean: Annotated[bool, typer.Option("--clean", help="Move what too few photographs constrain into NAME_unconstrained.ply.")] = False,
    uncleaned: Uncleaned = False,
    surroundings: AroundOption = None,
    photographs: Annotated[
        bool, typer.Option("--photographs", help="viewer: show the worst photographs beside the model; without it none is included.")
    ] = False,
    lod: LodOption = False,
    tiles: TilesOption = None,
    spz_version: SpzVersionOption = None,
    levels: LevelsOption = None,
    fit_levels: FitOption = None,
    regions: RegionsOption = None,
    resolution: CellOption = None,
    long_side_px: SurfaceSideOption = None,
    interval: IntervalOption = None,
    tile_px: TileSideOption = None,
    crs: FileCrsOption = None,
    require_grids: RequireCrsGridsOption = False,
    as_json: AsJson = False,
) -> None:
    """Write a model, plan, cameras or surface for other programs.

    What the format cannot hold is reported.

    radiant export RUN scene.spz
    radiant export RUN ortho.tif --format ortho --crs EPSG:32632
    radiant export RUN page.html --format viewer
    """
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
        surroundings=surroundings,
        crs=crs,
        require_grids=require_grids,
        num_levels=levels,
        fit_levels=fit_levels,
        regions=tuple(regions or ()),
        photographs=photographs,
    )
    finish(write_export(request, terminal_display()), as_json)


def evaluate(
    model: Annotated[Path, typer.Argument(help="A run, a 3DGS PLY, or a model.safetensors.", show_default=False)],
    scene: Annotated[
        Path | None,
        typer.Argument(
            help="A run, a folder of `radiant sfm`, or an undistorted COLMAP project in its own frame; by default the run MODEL."
        ),
    ] = None,
    long_side_px: Annotated[
        int | None, typer.Option(min=16, help="Long side of the images; by default the run's, or 1600 at most.")
    ] = None,
    lpips_weights: LpipsWeights = None,
    lpips_net: LpipsNet = "vgg",
    out: Annotated[Path | None, typer.Option("--out", help="New JSON file for all figures.")] = None,
    as_json: AsJson = False,
) -> None:
    """Score a model on held-out photographs: PSNR, SSIM, FLIP and LPIPS.

    PSNR and SSIM are also given after colour correction.

    radiant evaluate RUN
    radiant evaluate model.ply SCENE --out figures.json
    """
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.evaluate import EvaluateRequest
        from radiant_app.commands.model.evaluate import evaluate as score

    request = EvaluateRequest(
        model=model, scene=scene, long_side_px=long_side_px, lpips_weights=lpips_weights, lpips_network=lpips_net, out=out
    )
    result = score(request, terminal_display())
    if not as_json:
        print_figures(result)
    finish(result, as_json)


MarginOption = Annotated[
    float | None,
    typer.Option("--regions-margin", min=0, help="Leave out what is farther than this from the plan's regions.", rich_help_panel=_RULES),
]
ViewsOption = Annotated[
    int | None, typer.Option("--min-views", min=1, help="Leave out what fewer photographs show.", rich_help_panel=_RULES)
]
ParallaxOption = Annotated[
    float | None,
    typer.Option(
        "--min-parallax-deg", min=0, max=180, help="Leave out Gaussians seen with less parallax than this.", rich_help_panel=_RULES
    ),
]
HeightsOption = Annotated[
    str | None,
    typer.Option(help="LOW,HIGH between which --keep or --remove apply; either may be empty.", rich_help_panel=_RULES),
]
OpacityOption = Annotated[
    float | None, typer.Option("--min-opacity", help="Leave out what is less opaque, 0 to 1.", rich_help_panel=_RULES)
]
LargestOption = Annotated[
    float | None, typer.Option("--max-size", help="Leave out Gaussians with a longer standard deviation.", rich_help_panel=_RULES)
]


def clean(
    model: Annotated[Path, typer.Argument(help="A run, the folder of `radiant train`, or a PLY.", show_default=False)],
    keep: Annotated[str | None, typer.Option(help=f"Leave out everything outside a polygon: {_POLYGON}", rich_help_panel=_RULES)] = None,
    remove: Annotated[str | None, typer.Option(help=f"Leave out everything inside a polygon: {_POLYGON}", rich_help_panel=_RULES)] = None,
    heights: HeightsOption = None,
    regions_margin: MarginOption = None,
    min_views: ViewsOption = None,
    min_parallax_deg: ParallaxOption = None,
    min_opacity: OpacityOption = None,
    max_size: LargestOption = None,
    undo: Annotated[bool, typer.Option("--undo", help="Undo the last step.", rich_help_panel=_STEPS)] = False,
    redo: Annotated[bool, typer.Option("--redo", help="Redo the step that was undone last.", rich_help_panel=_STEPS)] = False,
    reset: Annotated[bool, typer.Option("--reset", help="Undo all steps.", rich_help_panel=_STEPS)] = False,
    measure: Annotated[bool, typer.Option("--measure", help="Measure again which photographs show each Gaussian.")] = False,
    pages: Annotated[bool, typer.Option("--pages", help="Write report.html and scene.html of a run again, as cleaned now.")] = False,
    as_json: AsJson = False,
) -> None:
    """Leave floaters and haze out of a model; nothing is lost.

    They are left out wherever the model is shown or exported.

    radiant clean RUN --min-views 3 --min-parallax-deg 5
    radiant clean RUN --undo
    """
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.clean import CleanRequest
        from radiant_app.commands.model.clean import clean as change
        from radiant_core.geometry.cleaning import MAX_STEPS

    request = CleanRequest(
        model=model,
        keep=keep,
        remove=remove,
        heights=_heights(heights),
        regions_margin=regions_margin,
        min_views=min_views,
        min_parallax_deg=min_parallax_deg,
        min_opacity=min_opacity,
        max_size=max_size,
        undo=MAX_STEPS if reset else int(undo),
        redo=redo,
        measure=measure,
        pages=pages,
    )
    result = change(request, terminal_display())
    if not as_json:
        for step in result["steps"]:
            typer.echo(f"{step['left_out']:,} left out; kept: {step['keeps']}")
    finish(result, as_json, OF_GAUSSIANS)


def _heights(text: str | None) -> tuple[float | None, float | None]:
    try:
        low, high = (float(part) if part.strip() else None for part in (text or ",").split(","))
    except ValueError:
        raise BadInput(f"{text!r} are no heights: write LOW,HIGH, such as -2,30, or 2, for all above 2.") from None
    return low, high


def _asked_format(export_format: ExportFormat | None, lod: bool, tiles: TileContent | None) -> ExportFormat | None:
    """The format that options ask for; BadInput where they ask for two."""
    format_of_option: dict[str, ExportFormat | None] = {
        "--lod": "lod" if lod else None,
        "--tiles": "tiles" if tiles else None,
        "--format": export_format,
    }
    kinds: set[ExportFormat] = {kind for kind in format_of_option.values() if kind is not None}
    if len(kinds) > 1:
        named = " and ".join(option for option, kind in format_of_option.items() if kind is not None)
        raise BadInput(f"{named} ask for {' and '.join(sorted(kinds))}: ask for one of them.")
    return next(iter(kinds), None)
