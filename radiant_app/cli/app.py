"""The command `radiant`. Heavy libraries are imported inside the commands, so that `radiant --help` answers at once."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, NoReturn

import typer

from radiant_app.cli.bench import bench
from radiant_app.cli.option_types import (
    AsJson,
    DistanceOption,
    HeightOption,
    LongSide,
    LpipsNet,
    LpipsWeights,
    MaskFolder,
    Matching,
    RasterCellOption,
    SizeOption,
    UpOption,
)
from radiant_app.cli.output import export, render
from radiant_app.cli.plan import plan
from radiant_app.cli.profile import profile
from radiant_app.cli.quantities import bytes_of, seconds_of
from radiant_app.cli.replan import replan_plan
from radiant_app.cli.sfm import MATCHING_HELP, sfm
from radiant_app.cli.streams import CannotPrint, make_streams_last
from radiant_app.report.tables import finish, print_figures, print_summary
from radiant_app.workers.memory import OUT_OF_MEMORY, is_out_of_memory
from radiant_core.errors import BadInput, CannotWrite, RadiantError, StageFailed

app = typer.Typer(
    help="Photographs of a large scene into one 3D Gaussian model, planned and trained over unequal machines.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

MAX_SEED = 2**31 - 1
"""What numpy, torch and COLMAP all take."""
INTERRUPTED = 130
"""Exit code after Ctrl-C; what typer returns for it."""

TrainPreset = Literal["draft", "default", "standard", "paper"]
AggregatePreset = Literal["default", "paper"]
PlanMethod = Literal["exact", "paper", "voronoi", "even"]
Frames = Literal["shared", "gps", "known"]
RunPreset = Literal["default", "paper"]
UploadFormat = Literal["float32", "float16", "spz"]
Teachers = Literal["early", "late"]
View = Literal["regions", "cameras", "seams", "splats", "compare"]

RunFolder = Annotated[Path, typer.Argument(help="Folder of a finished run.", show_default=False)]
_UPLOAD_HELP = "What devices and edges send: exact, half the bytes, or a fifth. Without it float16, or float32 by --preset paper."
_PRESET_HELP = (
    "paper: all as in the paper, nothing skipped or reduced: Alg. 1 and RTP, 20,000 steps with densification, edges and cloud retrain all "
    "parameters for 10 epochs, crop-merge only beyond the limits of [cloud] in the system file. A single option given beside it wins."
)
_TRAIN_HELP = (
    "draft: quick; standard: 3DGS, its schedule scaled to the steps and, on a CPU, with 200,000 Gaussians at most; paper: its 20,000 steps."
)
_AGGREGATE_HELP = "paper: retrain every parameter at the edges and the cloud."
_PLAN_HELP = "exact: least makespan; paper: Alg. 1; voronoi; even."
_INSPECTED_HELP = "Folder of `radiant run`, `train` or `sfm`; a plan, or its folder; for the window also a 3DGS .ply."
_WEB_HELP = (
    "Serve a read-only page for a browser until Ctrl-C, on 127.0.0.1 by default. The address that is printed holds a random secret; "
    "without it the page stays empty."
)
TrainPresetOption = Annotated[TrainPreset, typer.Option(help=_TRAIN_HELP)]
NumSteps = Annotated[int | None, typer.Option("--steps", min=1, help="Training steps of a device.")]
Settings = Annotated[list[str] | None, typer.Option("--set", help="Any setting of training: NAME=VALUE, as in TrainConfig; repeatable.")]
MaxSplats = Annotated[int | None, typer.Option("--max-splats", min=100, help="Upper limit of Gaussians of a device.")]
PlanFile = Annotated[Path | None, typer.Option(help="Plan made by `radiant plan` before capture; else what was captured is planned.")]
Seed = Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of every random choice.")]
RunOut = Annotated[Path | None, typer.Option("--out", help="Folder of the run, new or empty; a batch has one beside its file.")]
SystemFile = Annotated[Path | None, typer.Option("--system", help="TOML of edges and devices; else two edges with two each.")]


@app.command()
def run(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(help="Photographs, a COLMAP project, a Mill 19 folder, or a JOBS.toml.", show_default=False)],
    out: RunOut = None,
    system: SystemFile = None,
    emulate: Annotated[Path | None, typer.Option(help="System whose speeds and uplinks are played on this machine.")] = None,
    preset: Annotated[RunPreset, typer.Option(help=_PRESET_HELP)] = "default",
    train_preset: Annotated[TrainPreset | None, typer.Option(help=f"{_TRAIN_HELP} Without it that of --preset.")] = None,
    aggregate_preset: Annotated[AggregatePreset | None, typer.Option(help=f"{_AGGREGATE_HELP} Without it that of --preset.")] = None,
    plan_method: Annotated[PlanMethod | None, typer.Option(help=f"{_PLAN_HELP} Without it exact, or paper by --preset paper.")] = None,
    matching: Annotated[Matching | None, typer.Option(help=f"{MATCHING_HELP} Without it auto, or exhaustive by --preset paper.")] = None,
    frames: Annotated[Frames, typer.Option(help="shared: photographs are pooled; gps, known: each device places its own.")] = "shared",
    poses: Annotated[Path | None, typer.Option(help="COLMAP model with the poses, for --frames known.")] = None,
    masks: MaskFolder = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    plan: PlanFile = None,
    raster_cell_m: RasterCellOption = None,
    single_owner: Annotated[bool, typer.Option("--single-owner", help="Collect the devices' comparison pictures in the run.")] = False,
    upload: Annotated[UploadFormat | None, typer.Option(help=_UPLOAD_HELP)] = None,
    teachers: Annotated[Teachers, typer.Option(help="Render an edge's teachers as each device arrives, or after the last.")] = "early",
    long_side_px: LongSide = None,
    steps: NumSteps = None,
    max_splats: MaxSplats = None,
    settings: Settings = None,
    lpips_weights: LpipsWeights = None,
    lpips_net: LpipsNet = "vgg",
    seed: Seed = 0,
    workers: Annotated[int, typer.Option(min=0, help="Processes at a time; 0: one per core.")] = 0,
    executor: Annotated[Literal["local", "ray"], typer.Option(help="local: processes here; ray: tasks of one owner's cluster.")] = "local",
    address: Annotated[str | None, typer.Option(help="ray: host:port of the cluster's head, or local.", show_default=False)] = None,
    deadline: Annotated[float, typer.Option("--deadline-factor", min=0, help="Give up who takes so many times its time; 0: never.")] = 10.0,
    checkpoint_every: Annotated[str, typer.Option(help="Time between two checkpoints of a training.")] = "10s",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out; finished stages are skipped.")] = False,
    as_json: AsJson = False,
) -> None:
    """Photographs in, one Gaussian model out: structure from motion, plan, devices, edges, cloud, report.

    A JOBS.toml runs several scenes, goes on after a failure and ends with a summary (radiant_app/files/job_file.py says what stands in it).
    """
    from radiant_app.files.job_file import is_job_file

    if is_job_file(source):
        _run_batch(context, source, out, resume, as_json)
        return
    out = _checked_out(out, both_systems=None not in (system, emulate), both_plans=None not in (plan, plan_method))
    from radiant_app.cli.settings import settings_of
    from radiant_app.run.config import RunConfig, run_preset
    from radiant_core.train.needs import Overrides

    given = {"train_preset": train_preset, "aggregate_preset": aggregate_preset, "plan_method": plan_method, "matching": matching}
    chosen = run_preset(preset, **given, upload=upload, executor=executor, address=address, deadline_factor=deadline, teachers=teachers)
    placed: dict[str, Any] = {"frames": frames, "poses": poses, "up": up, "distance": distance, "height_m": height}
    held: dict[str, Any] = {"masks": masks, "plan": plan, "single_owner": single_owner, "raster_cell_m": raster_cell_m}
    config = RunConfig(
        source=source,
        out=out,
        system=emulate or system,
        emulated=emulate is not None,
        **{**chosen, **held, **placed},
        overrides=Overrides(long_side_px=long_side_px, num_steps=steps, max_num_splats=max_splats, settings=settings_of(settings or ())),
        lpips_weights=lpips_weights,
        lpips_network=lpips_net,
        seed=seed,
        max_workers=workers,
        checkpoint_every_s=seconds_of(checkpoint_every),
    )
    _run(config, resume, as_json, context.obj)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")] = Path("demo_run"),
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an interrupted demo.")] = False,
) -> None:
    """The whole job on the sample town that comes with the project: some minutes on two cores."""
    from radiant_app.commands.demo import demo_config

    _run(demo_config(out), resume or out.exists(), as_json=False)


app.command()(sfm)
app.command()(plan)
app.command()(profile)


app.command("replan")(replan_plan)


@app.command()
def train(
    scene: Annotated[
        Path, typer.Argument(help="A run, the folder of `radiant sfm`, a COLMAP project, or photographs.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", help="Folder of model, figures and pictures; or, of a run or scene, MODEL.ply.", show_default=False)
    ],
    train_preset: TrainPresetOption = "default",
    time: Annotated[str | None, typer.Option(help="End training after this time: 90, 90s, 5m, 1h.", show_default=False)] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="End training after so many steps.")] = None,
    gaussians: Annotated[int | None, typer.Option("--gaussians", "--max-splats", min=100, help="Upper limit of Gaussians.")] = None,
    memory: Annotated[
        str | None,
        typer.Option(
            help="What the process may hold: 600MB, 2GB; sets the upper limit of Gaussians, and bounds finding features.",
            show_default=False,
        ),
    ] = None,
    validate: Annotated[
        bool | None,
        typer.Option(help="An eighth of the training photographs only picks the best model.", show_default="from 100 on"),
    ] = None,
    long_side_px: LongSide = None,
    masks: MaskFolder = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    settings: Settings = None,
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the training in --out from its last checkpoint.")] = False,
    checkpoint_every: Annotated[str, typer.Option(help="Time between two checkpoints.")] = "10s",
    as_json: AsJson = False,
) -> None:
    """One model from all photographs of a scene but every 8th, without regions; scored on those that were held out."""
    from radiant_app.cli.settings import settings_of
    from radiant_app.commands.train import TrainRequest
    from radiant_app.commands.train import train as run_training
    from radiant_core.train.needs import Overrides

    request = TrainRequest(
        source=scene,
        out=out,
        preset=train_preset,
        overrides=Overrides(long_side_px=long_side_px, num_steps=steps, max_num_splats=gaussians, settings=settings_of(settings or ())),
        time_s=None if time is None else seconds_of(time),
        masks=masks,
        up=up,
        distance=distance,
        height_m=height,
        memory_bytes=None if memory is None else bytes_of(memory),
        validate=validate,
        seed=seed,
        checkpoint_every_s=seconds_of(checkpoint_every),
    )
    with _listener() as listener:
        result = run_training(request, listener, resume=resume)
    if as_json or "psnr_db" not in result:
        finish(result, as_json)
        return
    typer.echo(f"held-out {result['psnr_db']:.2f} dB, {result['num_gaussians']:,} Gaussians")
    typer.echo(f"model: {out / 'scene.ply'}")


@app.command()
def aggregate(
    run_folder: RunFolder,
    out: Annotated[Path, typer.Option("--out", help="PLY of the joined scene.", show_default=False)],
    aggregate_preset: Annotated[AggregatePreset, typer.Option(help=_AGGREGATE_HELP)] = "default",
    epochs: Annotated[int | None, typer.Option(min=1, help="How often each synthetic view is shown, else as the preset has it.")] = None,
    as_json: AsJson = False,
) -> None:
    """Join the device models of a run once more, in another way."""
    from radiant_app.commands import steps as commands

    finish(commands.aggregate(run_folder, out, aggregate_preset, epochs, _listener()), as_json)


@app.command()
def extend(
    old: Annotated[Path, typer.Argument(help="A finished run, or a PLY in the frame of NEW.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="The run of the new region.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="PLY of the extended scene.", show_default=False)],
    region: Annotated[
        Path | None,
        typer.Option(help="GeoJSON polygons of the land that NEW takes over, else the hull of its cameras.", show_default=False),
    ] = None,
    margin_m: Annotated[
        float | None, typer.Option("--margin-m", help="Half width of the strip that is fitted, else 5 % of the region's side.")
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="How often each view of the strip is shown, else twice.")] = None,
    as_json: AsJson = False,
) -> None:
    """Join a new region to a finished scene, which keeps its bits beyond a margin."""
    from radiant_app.commands.extend import ExtendRequest
    from radiant_app.commands.extend import extend as join

    request = ExtendRequest(old=old, new=new, out=out, region=region, margin_m=margin_m, num_epochs=epochs)
    finish(join(request, _listener()), as_json)


app.command()(render)


@app.command()
def evaluate(
    model: Annotated[Path, typer.Argument(help="A run, a 3DGS PLY, or a model.safetensors.", show_default=False)],
    scene: Annotated[
        Path | None,
        typer.Argument(
            help="A run, a folder of `radiant sfm`, or an undistorted COLMAP project in its own frame; without it the run MODEL.",
            show_default=False,
        ),
    ] = None,
    long_side_px: Annotated[
        int | None, typer.Option("--long-side-px", min=16, help="Long side of the images; without it the run's, else 1600 at most.")
    ] = None,
    lpips_weights: LpipsWeights = None,
    lpips_net: LpipsNet = "vgg",
    out: Annotated[Path | None, typer.Option("--out", help="JSON file for all figures; must not exist.")] = None,
    as_json: AsJson = False,
) -> None:
    """PSNR, SSIM (both also after colour correction), FLIP and LPIPS on the photographs that a scene holds out."""
    from radiant_app.commands.evaluate import EvaluateRequest
    from radiant_app.commands.evaluate import evaluate as score

    request = EvaluateRequest(
        model=model, scene=scene, long_side_px=long_side_px, lpips_weights=lpips_weights, lpips_network=lpips_net, out=out
    )
    result = score(request, _listener())
    if not as_json:
        print_figures(result)
    finish(result, as_json)


@app.command()
def inspect(
    run_folder: Annotated[Path, typer.Argument(help=_INSPECTED_HELP, show_default=False)],
    screenshot: Annotated[Path | None, typer.Option(help="Write this PNG instead of opening a window.")] = None,
    view: Annotated[
        View | None,
        typer.Option(help="What the picture shows; else regions of a run, splats of a training, cameras of a scene.", show_default=False),
    ] = None,
    size: SizeOption = "1280x900",
    camera: Annotated[
        str | None, typer.Option(help="A photograph's name: splats are seen from there, compare shows it alone.", show_default=False)
    ] = None,
    system: Annotated[Path | None, typer.Option(help="TOML of edges and devices with which the plan is changed; else its own.")] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene of a plan that was not made from waypoints.")] = None,
    web: Annotated[bool, typer.Option("--web", help=_WEB_HELP)] = False,
    host: Annotated[
        str, typer.Option(help="--web: address to bind; all but this machine's own can be reached from outside.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="--web: port to bind; 0 for any that is free.")] = 8765,
) -> None:
    """Regions, cameras, seams and splats of a run, or a plan to be changed: in a window, as a picture, or as a page for a browser."""
    if web and screenshot is not None:
        raise BadInput("--web serves a page and --screenshot writes a picture: ask for one of them.")
    if web:
        from radiant_viewer.web.server import open_page

        return open_page(run_folder, typer.echo, host, port)
    from radiant_app.commands.inspect import Picture, open_inspector, save_picture

    if screenshot is None:
        raise typer.Exit(open_inspector(run_folder, system, scene))
    from radiant_app.cli.quantities import size_wh_of

    typer.echo(save_picture(run_folder, view, screenshot, Picture(size_wh=size_wh_of(size), camera=camera, scene=scene)))
    return None


app.command()(export)


app.command()(bench)


@app.command()
def doctor(as_json: AsJson = False) -> None:
    """What this machine has and what is missing, with what to do about it."""
    from radiant_app.commands.doctor import examine, table

    findings = examine()
    typer.echo(json.dumps([vars(finding) for finding in findings], indent=2) if as_json else table(findings))
    if any(not finding.ok and finding.needed for finding in findings):
        raise typer.Exit(1)


def main() -> NoReturn:
    """Entry point: one sentence for what a user can mend, exit code 2 for bad input, 130 for Ctrl-C."""
    make_streams_last()
    interrupt_on_signals()
    try:
        _require_working_folder()
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except RadiantError as error:
        _say(f"{error} {_how_to_go_on()}".strip() if isinstance(error, CannotWrite) else str(error))
        sys.exit(error.exit_code)
    except (MemoryError, RuntimeError) as error:
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
    signal.setitimer(signal.ITIMER_REAL, 0)
    if code == INTERRUPTED:
        _say(f"interrupted. {_how_to_go_on()}".strip())
    sys.exit(code if isinstance(code, int) else 0)


def _require_working_folder() -> None:
    """Raise BadInput where the folder that a relative path begins in is gone: libraries die there of what they cannot find."""
    try:
        Path.cwd()
    except FileNotFoundError:
        raise BadInput("the folder that this was started in does not exist any more: change to one that does.") from None


def _how_to_go_on() -> str:
    """What to say of a command that did not come to its end."""
    resumable = set(sys.argv[1:2]) & {"run", "demo", "train", "sfm"}
    return "What was finished is kept: go on with the same command and --resume." if resumable else ""


def _where_it_lies() -> str:
    """What to say of a result that exists and was not printed."""
    given = [after for option, after in pairwise(sys.argv) if option == "--out"]
    given += [argument.removeprefix("--out=") for argument in sys.argv if argument.startswith("--out=")]
    made = [out for out in given if Path(out).exists()]
    return f"it lies in {made[0]}" if made else "send standard output elsewhere, or free space there"


def interrupt_on_signals() -> None:
    """A polite kill ends like Ctrl-C, through the same clean-up, so that no worker outlives the run."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, _interrupt)


def _interrupt(number: int, frame: Any) -> NoReturn:
    # Raised inside a finalizer, Python drops it: ask again until somebody hears.
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    raise KeyboardInterrupt


def _checked_out(out: Path | None, *, both_systems: bool, both_plans: bool) -> Path:
    """The folder of `radiant run`; BadInput where options contradict."""
    if out is None:
        raise BadInput("--out is missing: name the run's folder.")
    if both_systems:
        raise BadInput("--system and --emulate both name a system: keep one of them.")
    if both_plans:
        raise BadInput("--plan keeps to a plan that is made and --plan-method makes another: leave one of them out.")
    return out


def _run(config: Any, resume: bool, as_json: bool, listener: Any = None) -> None:
    """`listener` gets the events instead of the terminal, where a batch runs the command."""
    from radiant_app.run.pipeline import run as run_pipeline

    with nullcontext(listener) if listener else _listener() as listener:
        result = run_pipeline(config, listener, resume=resume)
    if as_json:
        typer.echo(json.dumps(result.metrics))
        return
    typer.echo(f"held-out {result.metrics['psnr_db']:.2f} dB, {result.metrics['num_gaussians']:,} Gaussians")
    if unscored := result.metrics.get("num_unscored", 0):
        scored = len(result.metrics["images"])
        typer.echo(f"scored on {scored} of {scored + unscored} held-out photographs: the others lie on missing devices or have no pose")
    if result.metrics.get("emulated_makespan_s") is not None:
        emulated, planned = (result.metrics[f"{kind}_makespan_s"] for kind in ("emulated", "planned"))
        typer.echo(f"emulated: the last edge's model arrived after {emulated:.1f} s, planned {planned:.1f} s")
    typer.echo(f"report: {result.report}")
    typer.echo(f"next: radiant inspect {quote(str(config.out))}")


def _run_batch(context: typer.Context, source: Path, out: Path | None, resume: bool, as_json: bool) -> None:
    from radiant_app.commands.batch import run_batch

    given = [name for name in context.params if str(context.get_parameter_source(name)).endswith("COMMANDLINE")]
    extra = sorted(set(given) - {"source", "out", "resume", "as_json"})
    if extra:
        raise BadInput(f"--{extra[0].replace('_', '-')} stands beside a job file: write it into its [defaults].")
    result = run_batch(source, out, _job_display, resume=resume)
    if as_json:
        typer.echo(json.dumps(result.record))
    else:
        print_summary(result)
    raise typer.Exit(result.exit_code)


@contextmanager
def _job_display(title: str) -> Iterator[Any]:
    typer.echo(title, err=True)
    with _listener() as listener:
        yield listener


def _listener() -> Any:
    from radiant_app.report.progress import terminal_display

    return terminal_display()


def _say(message: str) -> None:
    typer.echo(f"radiant: {message}", err=True)


if __name__ == "__main__":
    main()
