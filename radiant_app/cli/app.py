"""The command `radiant`; commands import heavy libraries themselves, so that `--help` is quick."""

from __future__ import annotations

import atexit
import gc
import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from radiant_app.cli.bench import FORWARDED, bench
from radiant_app.cli.clean import clean
from radiant_app.cli.node import node
from radiant_app.cli.option_types import AggregatePresetOption, AsJson, LpipsNet, LpipsWeights, SizeOption
from radiant_app.cli.output import export, render, view
from radiant_app.cli.plan import plan
from radiant_app.cli.profile import profile
from radiant_app.cli.replan import replan_plan
from radiant_app.cli.run import demo, run
from radiant_app.cli.sfm import sfm
from radiant_app.cli.streams import CannotPrint, make_streams_last
from radiant_app.cli.survey import change, measure
from radiant_app.cli.train import train
from radiant_app.interrupts import INTERRUPTED, interrupt_on_signals, stop_repeating_interrupt
from radiant_app.plain_text import shown_text
from radiant_app.quantities import size_wh_of
from radiant_app.report.tables import finish, print_figures
from radiant_app.workers.memory import OUT_OF_MEMORY, is_out_of_memory
from radiant_core import __version__
from radiant_core.choices import View, Viewer
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed

app = typer.Typer(
    help="Photographs of a large scene into one 3D Gaussian model, planned and trained over unequal machines.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

RunFolder = Annotated[Path, typer.Argument(help="Folder of a finished run.", show_default=False)]
_INSPECTED_HELP = "Folder of `radiant run`, `train` or `sfm`; a plan, or its folder; for the window also a 3DGS .ply."
_WEB_HELP = (
    "Serve a read-only page for a browser until Ctrl-C, on 127.0.0.1 by default. The address that is printed holds a random secret; "
    "without it the page stays empty."
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"radiant {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")] = False,
) -> None:
    pass


app.command()(run)
app.command()(demo)
app.command()(sfm)
app.command()(plan)
app.command()(profile)
app.command("replan")(replan_plan)
app.command()(train)
app.add_typer(node, name="node")


@app.command()
def aggregate(
    run_folder: RunFolder,
    out: Annotated[Path, typer.Option("--out", help="PLY of the joined scene.", show_default=False)],
    aggregate_preset: AggregatePresetOption = "default",
    epochs: Annotated[int | None, typer.Option(min=1, help="How often each synthetic view is shown, else as the preset has it.")] = None,
    as_json: AsJson = False,
) -> None:
    """Join the device models of a run once more, in another way."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.aggregate import aggregate as join

    finish(join(run_folder, out, aggregate_preset, epochs, terminal_display()), as_json)


@app.command()
def extend(
    old: Annotated[Path, typer.Argument(help="A finished run, or a PLY in the frame of NEW.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="The run of the new region.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="PLY of the extended scene.", show_default=False)],
    region: Annotated[
        Path | None, typer.Option(help="GeoJSON polygons of the land that NEW takes over, else the hull of its cameras.")
    ] = None,
    margin_m: Annotated[
        float | None, typer.Option("--margin-m", help="Half width of the fitted strip, else 5 % of the region's side.")
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="How often each view of the strip is shown, else 5 times.")] = None,
    as_json: AsJson = False,
) -> None:
    """Join a new region to a finished scene, which keeps its bits beyond a margin."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.extend import ExtendRequest
        from radiant_app.commands.model.extend import extend as join

    request = ExtendRequest(old=old, new=new, out=out, region=region, margin_m=margin_m, num_epochs=epochs)
    finish(join(request, terminal_display()), as_json)


app.command()(render)


@app.command()
def evaluate(
    model: Annotated[Path, typer.Argument(help="A run, a 3DGS PLY, or a model.safetensors.", show_default=False)],
    scene: Annotated[
        Path | None,
        typer.Argument(help="A run, a folder of `radiant sfm`, or an undistorted COLMAP project in its own frame; else the run MODEL."),
    ] = None,
    long_side_px: Annotated[int | None, typer.Option(min=16, help="Long side of the images, else the run's, or 1600 at most.")] = None,
    lpips_weights: LpipsWeights = None,
    lpips_net: LpipsNet = "vgg",
    out: Annotated[Path | None, typer.Option("--out", help="JSON file for all figures; must not exist.")] = None,
    as_json: AsJson = False,
) -> None:
    """PSNR, SSIM (both also after colour correction), FLIP and LPIPS on held-out photographs."""
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


@app.command()
def inspect(
    run_folder: Annotated[Path, typer.Argument(help=_INSPECTED_HELP, show_default=False)],
    screenshot: Annotated[Path | None, typer.Option(help="Write this PNG instead of opening a window.")] = None,
    view: Annotated[
        View | None, typer.Option(help="What is shown; else regions of a run, splats of a training, cameras of a scene.")
    ] = None,
    size: SizeOption = "1280x900",
    camera: Annotated[str | None, typer.Option(help="A photograph's name: splats are seen from there, compare shows it alone.")] = None,
    system: Annotated[Path | None, typer.Option(help="TOML of edges and devices with which the plan is changed; else its own.")] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene of a plan that was not made from waypoints.")] = None,
    viewer: Annotated[Viewer, typer.Option(help="open3d: Open3D's own window or picture, with the same layers.")] = "radiant",
    web: Annotated[bool, typer.Option("--web", help=_WEB_HELP)] = False,
    host: Annotated[str, typer.Option(help="--web: address to bind; any but this machine's own is open to others.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="--web: port to bind; 0 for any that is free.")] = 8765,
) -> None:
    """Show a run, or a plan to be changed: in a window, as a picture, or as a page to browse."""
    if web and viewer != "radiant":
        raise BadInput("--web serves a page and --viewer open3d opens a window: ask for one of them.")
    if web and screenshot is not None:
        raise BadInput("--web serves a page and --screenshot writes a picture: ask for one of them.")
    if web:
        from radiant_viewer.web.server import open_page

        return open_page(run_folder, typer.echo, host, port)
    from radiant_app.commands.inspect.window import Picture, inspect_with_open3d, open_inspector, save_picture

    if viewer == "open3d":
        raise typer.Exit(inspect_with_open3d(run_folder, view, screenshot, Picture(size_wh=size_wh_of(size), camera=camera, scene=scene)))
    if screenshot is None:
        raise typer.Exit(open_inspector(run_folder, system, scene))
    typer.echo(save_picture(run_folder, view, screenshot, Picture(size_wh=size_wh_of(size), camera=camera, scene=scene)))
    return None


app.command()(export)
app.command()(view)
app.command()(change)
app.command()(measure)


app.command()(clean)


app.command(context_settings=FORWARDED)(bench)


@app.command()
def doctor(
    photographs: Annotated[int, typer.Option(min=1, help="Say what a run of so many will take here.")] = 100,
    profile: Annotated[Path | None, typer.Option(help="Curve file of this machine, by `radiant profile`; else a guess.")] = None,
    as_json: AsJson = False,
) -> None:
    """What this machine has, what is missing and how to get it, and what a run will take here."""
    from radiant_app.report.progress import show_starting

    with show_starting():
        from radiant_app.commands.machine.doctor import examine, table

        findings = examine(photographs, profile)
    typer.echo(json.dumps([vars(finding) for finding in findings], indent=2) if as_json else table(findings))
    if any(not finding.ok and finding.needed for finding in findings):
        raise typer.Exit(1)


def main() -> NoReturn:
    """Entry point: one sentence for what a user can mend; exit code 2: bad input, 130: Ctrl-C."""
    make_streams_last()
    interrupt_on_signals()
    # Memory goes with the process: what collects it before takes half a second of CPU time.
    atexit.register(gc.freeze)
    try:
        _require_working_folder()
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except RadiantError as error:
        _say(f"{error} {_how_to_go_on()}".strip() if isinstance(error, CannotWrite) else str(error))
        sys.exit(error.exit_code)
    except (MemoryError, RuntimeError) as error:
        if str(error).startswith("Symlink loop"):  # of pathlib before Python 3.13
            _say(f"{error}: links that lead to each other name no file, give another path.")
            sys.exit(BadInput.exit_code)
        if not is_out_of_memory(error):
            raise
        _say(f"{OUT_OF_MEMORY} {_how_to_go_on()}".strip())
        sys.exit(StageFailed.exit_code)
    except CannotPrint as error:
        _say(f"the result could not be printed ({error.strerror}): {_where_it_lies()}.")
        sys.exit(BadInput.exit_code)
    except OSError as error:
        _say(f"{error.strerror or error} ({error.filename}): check the path, the rights and the free space.")
        sys.exit(BadInput.exit_code)
    except typer.TyperException as error:
        _say(f"{error.format_message().rstrip('.')}: `radiant --help` and `radiant COMMAND --help` say what there is.")
        sys.exit(BadInput.exit_code)
    stop_repeating_interrupt()
    if code == INTERRUPTED:
        _say(f"interrupted. {_how_to_go_on()}".strip())
    sys.exit(code if isinstance(code, int) else 0)


def _require_working_folder() -> None:
    """Raise BadInput where the working folder is gone: libraries fail there in obscure ways."""
    try:
        Path.cwd()
    except FileNotFoundError:
        raise BadInput("the folder that this was started in does not exist any more: change to one that does.") from None


def _how_to_go_on() -> str:
    resumable = set(sys.argv[1:2]) & {"run", "demo", "train", "sfm"}
    return "What was finished is kept: go on with the same command and --resume." if resumable else ""


def _where_it_lies() -> str:
    given = [after for option, after in pairwise(sys.argv) if option == "--out"]
    given += [argument.removeprefix("--out=") for argument in sys.argv if argument.startswith("--out=")]
    made = [out for out in given if Path(out).exists()]
    return f"it lies in {made[0]}" if made else "send standard output elsewhere, or free space there"


def _say(message: str) -> None:
    typer.echo(f"radiant: {shown_text(message)}", err=True)


if __name__ == "__main__":
    main()
