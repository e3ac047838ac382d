"""The options of `radiant inspect`; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.config_options import typed_options
from radiant_app.cli.option_types import SizeOption
from radiant_app.quantities import size_wh_of
from radiant_core.choices import Painter, View, Viewer
from radiant_core.errors import BadInput

_INSPECTED_HELP = (
    "Folder of `radiant run`, `train` or `sfm`; a plan, or its folder; for the window and --page also a 3D Gaussian Splatting .ply. "
    "Without it, a window or with --web a page, on which photographs, machines and quality are chosen and a run is begun."
)
_WEB_HELP = (
    "Serve the inspector read-only to a browser until Ctrl-C. The printed address contains a secret; without it the page stays empty."
)
_PAGE_HELP = "Serve a page that flies through the model to a browser on this machine until Ctrl-C; any size, no extra needed."
_PICTURE, _BROWSER, _PLAN = "A picture instead of the window", "In a browser", "Changing a plan"


def inspect(
    context: typer.Context,
    run_folder: Annotated[Path | None, typer.Argument(metavar="RUN", help=_INSPECTED_HELP, show_default=False)] = None,
    screenshot: Annotated[Path | None, typer.Option(help="Write this PNG.", rich_help_panel=_PICTURE)] = None,
    view: Annotated[
        View | None,
        typer.Option(help="View to draw; by default regions of a run, splats of a training, cameras of a scene.", rich_help_panel=_PICTURE),
    ] = None,
    size: SizeOption = "1280x900",
    camera: Annotated[
        str | None,
        typer.Option(help="Name of a photograph: splats are seen from there, compare shows it alone.", rich_help_panel=_PICTURE),
    ] = None,
    system: Annotated[
        Path | None, typer.Option(help="System file to change the plan with; by default the plan's own.", rich_help_panel=_PLAN)
    ] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene of a plan that was not made from waypoints.", rich_help_panel=_PLAN)] = None,
    viewer: Annotated[Viewer, typer.Option(help="open3d: Open3D's own window or picture, with the same layers.")] = "radiant",
    painter: Annotated[
        Painter | None,
        typer.Option(
            help="Who draws the model in the window: radiant, our renderer; vtk or open3d, with a graphics card.",
            show_default="ours, unless another is measured to be faster with the same picture",
        ),
    ] = None,
    page: Annotated[bool, typer.Option("--page", help=_PAGE_HELP, rich_help_panel=_BROWSER)] = False,
    web: Annotated[bool, typer.Option("--web", help=_WEB_HELP, rich_help_panel=_BROWSER)] = False,
    host: Annotated[
        str,
        typer.Option(help="--web: address to listen at; any but this machine's own is open to others.", rich_help_panel=_BROWSER),
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Port to listen at; 0 for any that is free.",
            show_default="8765; for --page any that is free",
            rich_help_panel=_BROWSER,
        ),
    ] = None,
) -> None:
    """Look at a run or model, or change a plan.

    Opens a window; a picture or a page in a browser needs no desktop.

    radiant inspect
    radiant inspect RUN
    radiant inspect RUN --view seams --screenshot seams.png
    radiant inspect RUN --page
    """
    if run_folder is None:
        return _start(typed_options(context), port)
    if (served := _served_as(typed_options(context))) is not None:
        return _serve(served, run_folder, host, port)
    if painter is not None and (screenshot is not None or viewer != "radiant"):
        raise BadInput("--painter is for the window: leave it out beside --screenshot and --viewer open3d.")
    from radiant_app.commands.inspect.window import Picture, inspect_with_open3d, open_inspector, save_picture

    if viewer == "open3d":
        raise typer.Exit(inspect_with_open3d(run_folder, view, screenshot, Picture(size_wh=size_wh_of(size), camera=camera, scene=scene)))
    if screenshot is None:
        raise typer.Exit(open_inspector(run_folder, system, scene, painter))
    typer.echo(save_picture(run_folder, view, screenshot, Picture(size_wh=size_wh_of(size), camera=camera, scene=scene)))
    return None


def _start(typed: dict[str, str], port: int | None) -> None:
    """The start window, or its page by --web; BadInput beside an option of something else."""
    if "web" in typed and "host" in typed:
        raise BadInput("a page that begins runs is served on this machine alone: leave out --host, and reach it by 'ssh -L'.")
    if others := [option for name, option in typed.items() if name not in ({"web", "port"} if "web" in typed else ())]:
        raise BadInput(f"{others[0]} needs something to show: name a run, a plan or a model, or type 'radiant inspect' alone.")
    if "web" in typed:
        from radiant_app.commands.inspect.feeds import start_feeds
        from radiant_viewer.web.server import PORT, open_start_page

        return open_start_page(start_feeds(), typer.echo, PORT if port is None else port)
    from radiant_app.commands.inspect.window import open_start_window

    raise typer.Exit(open_start_window())


def _served_as(typed: dict[str, str]) -> str | None:
    """--web, --page or None; BadInput where it was typed beside an option of something else."""
    served = [option for option in ("--web", "--page") if option.strip("-") in typed]
    if not served:
        if aimless := [option for option in ("--host", "--port") if option.strip("-") in typed]:
            raise BadInput(f"{aimless[0]} is for a page in a browser: add --web or --page, or leave it out.")
        return None
    if len(served) == 2:
        raise BadInput("--web serves the inspector and --page the model alone: ask for one of them.")
    allowed = {"run_folder", "port", "page"} if served[0] == "--page" else {"run_folder", "port", "web", "host"}
    if others := [option for name, option in typed.items() if name not in allowed]:
        raise BadInput(f"{served[0]} serves a page, and {others[0]} is for something else: leave one of them out.")
    return served[0]


def _serve(served: str, run_folder: Path, host: str, port: int | None) -> None:
    if served == "--web":
        from radiant_viewer.web.server import PORT, open_page

        return open_page(run_folder, typer.echo, host, PORT if port is None else port)
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.inspect.view import view as serve_page

    return serve_page(run_folder, port or 0, terminal_display(), typer.echo)
