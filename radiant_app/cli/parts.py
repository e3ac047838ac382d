"""`radiant sfm`, `train` and `join`, the parts of a run by themselves: their options; heavy
libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiant_app.cli import option_types as options
from radiant_app.cli.config_options import option, typed_options
from radiant_app.cli.option_types import (
    AggregatePresetOption,
    AsJson,
    ContradictionsOption,
    DistanceOption,
    FilmFramesOption,
    HeightOption,
    LongSide,
    MaskFolder,
    MaskIgnoresOption,
    MatchingOption,
    Out,
    PanoramasOption,
    PosesOption,
    RefinePosesOption,
    Seed,
    TrainPresetOption,
    UpOption,
    Verbose,
)
from radiant_app.config.fields import train_options, with_settings
from radiant_app.config.run_config import FIRST, OUTPUT
from radiant_app.quantities import bytes_of, seconds_of
from radiant_app.report.figure_words import OF_GAUSSIANS
from radiant_app.report.tables import finish, print_model, print_scene
from radiant_core.errors import BadInput

if TYPE_CHECKING:
    from radiant_app.config.run_config import TrainOptions
    from radiant_core.train.config import Preset

_NEW_REGION = "A new region"
PhotographsArgument = Annotated[
    Path, typer.Argument(help="Photographs, an alignment beside them, a film, a COLMAP project, a Mill 19 folder.", show_default=False)
]
TrainingOut = Annotated[
    Path, typer.Option("--out", help="Folder for the model, figures and pictures; or MODEL.ply, of a run or scene.", show_default=False)
]
TimeOption = Annotated[str | None, typer.Option(help="Stop training after this time: 90, 90s, 5m, 1h.")]
StepsOption = Annotated[int | None, option("train.num_steps", help="Stop training after this many steps.", group=FIRST)]
GaussiansOption = Annotated[
    int | None, option("train.max_num_splats", "--gaussians", "--max-splats", help="Upper limit of Gaussians.", group=FIRST)
]
MemoryOption = Annotated[
    str | None, typer.Option(help="Memory to use: 600MB, 2GB; limits Gaussians and the search for features.", show_default=False)
]
ValidateOption = Annotated[
    bool | None, typer.Option(help="Hold out an eighth of the training photographs to choose the best model.", show_default="from 100 on")
]
TrainSettings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Any field of TrainConfig: train.PATH=VALUE, such as train.sky=false; repeatable.", rich_help_panel=OUTPUT),
]


def sfm(
    source: PhotographsArgument,
    out: Out,
    matching: MatchingOption = "auto",
    effort: options.EffortOption = "auto",
    masks: MaskFolder = None,
    poses: PosesOption = None,
    refine_poses: RefinePosesOption = False,
    mask_ignores: MaskIgnoresOption = None,
    film_frames: FilmFramesOption = None,
    panoramas: PanoramasOption = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    north: options.NorthOption = None,
    gcp: options.GcpOption = None,
    gcp_accuracy: options.GcpAccuracyOption = None,
    check_points: options.CheckPointsOption = None,
    require_grids: options.RequireGridsOption = False,
    contradictions: ContradictionsOption = "stop",
    resume: Annotated[bool, typer.Option("--resume", help="Continue in --out; features and matches are kept.")] = False,
    as_json: AsJson = False,
) -> None:
    """Find cameras and sparse points, and undistort the photographs.

    radiant sfm PHOTOS --out SCENE
    radiant sfm PHOTOS --out SCENE --gcp gcp_list.txt --check-points every:4
    """
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.run import steps as commands
        from radiant_app.config.run_config import SfmOptions
        from radiant_core.sfm.config import SfmConfig

    placed = SfmOptions(
        mask_ignores=mask_ignores,
        film_frames=film_frames,
        panoramas=panoramas,
        up=up,
        distance=distance,
        height_m=height,
        north=north,
        gcp=gcp,
        gcp_accuracy=gcp_accuracy,
        check_points=check_points,
        require_grids=require_grids,
        contradictions=contradictions,
    )
    config = SfmConfig(matching=matching, effort=effort)
    result = commands.sfm(
        source,
        out,
        config,
        terminal_display(),
        masks,
        placed.placement,
        poses,
        refine_poses=refine_poses,
        intake=placed.intake,
        resume=resume,
    )
    if as_json:
        finish(result, as_json)
    else:
        print_scene(result)


def train(
    scene: Annotated[Path, typer.Argument(help="A run, a folder of `radiant sfm`, a COLMAP project, photographs, a film.")],
    out: TrainingOut,
    train_preset: TrainPresetOption = "default",
    time: TimeOption = None,
    steps: StepsOption = None,
    gaussians: GaussiansOption = None,
    memory: MemoryOption = None,
    validate: ValidateOption = None,
    long_side_px: LongSide = None,
    masks: MaskFolder = None,
    poses: PosesOption = None,
    refine_poses: RefinePosesOption = False,
    mask_ignores: MaskIgnoresOption = None,
    film_frames: FilmFramesOption = None,
    panoramas: PanoramasOption = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    contradictions: ContradictionsOption = "stop",
    settings: TrainSettings = None,
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the training in --out from its last checkpoint.")] = False,
    checkpoint_every: Annotated[str, option("execution.checkpoint_every_s", help="Time between two checkpoints.", group=OUTPUT)] = "10s",
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """Train one model of a whole scene, without regions.

    Every eighth photograph is held out and scores the model.

    radiant train PHOTOS --out MODEL --time 5m
    radiant train SCENE --out MODEL --train-preset standard --gaussians 200000
    """
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.run import train as commands
        from radiant_core.sfm.intake import Intake

    chosen = _options_of(train_preset, {"long_side_px": long_side_px, "num_steps": steps, "max_num_splats": gaussians}, settings or [])
    request = commands.TrainRequest(
        source=scene,
        out=out,
        preset=chosen.preset,
        overrides=chosen.overrides,
        time_s=None if time is None else seconds_of(time),
        masks=masks,
        poses=poses,
        refine_poses=refine_poses,
        intake=Intake(mask_ignores=mask_ignores, film_frames=film_frames, panoramas=panoramas),
        up=up,
        distance=distance,
        height_m=height,
        contradictions=contradictions,
        memory_bytes=None if memory is None else bytes_of(memory),
        validate=validate,
        seed=seed,
        checkpoint_every_s=seconds_of(checkpoint_every),
    )
    with terminal_display(with_decisions=verbose) as listen:
        result = commands.train(request, listen, resume=resume)
    if as_json or "psnr_db" not in result:
        finish(result, as_json)
    else:
        _print_result(out, result, 0 if verbose else listen.num_decisions)


def join(
    context: typer.Context,
    run_folder: Annotated[
        Path, typer.Argument(metavar="RUN", help="A finished run; with NEW also a PLY in its frame.", show_default=False)
    ],
    new: Annotated[Path | None, typer.Argument(help="The run of a new region beside it.")] = None,
    *,
    out: Annotated[Path, typer.Option("--out", help="PLY of the joined scene; with --photographs a new folder.", show_default=False)],
    photographs: Annotated[Path | None, typer.Option(help="Folder of new photographs: the model is refined where they show it.")] = None,
    epochs: Annotated[
        int | None,
        typer.Option(min=1, help="Times each view is shown; by default of the preset, with NEW 5, with --photographs by its steps."),
    ] = None,
    aggregate_preset: AggregatePresetOption = "default",
    region: Annotated[
        Path | None,
        typer.Option(
            help="GeoJSON polygons of the land that NEW takes over; by default the hull of its cameras.", rich_help_panel=_NEW_REGION
        ),
    ] = None,
    margin_m: Annotated[
        float | None,
        typer.Option(
            "--margin-m", help="Half width of the fitted strip; by default 5 % of the region's side.", rich_help_panel=_NEW_REGION
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Join a run's models again, a new region or new photographs to it.

    Joining the device models of a run again has no memory limit and refines nothing. Beyond the
    margin of a new region, and where no new photograph shows it, the model keeps every bit.

    radiant join RUN --out joined.ply --aggregate-preset paper
    radiant join RUN EAST_RUN --out larger.ply
    radiant join RUN --photographs NEW --out FOLDER
    """
    from radiant_app.report.progress import show_starting, terminal_display

    typed = typed_options(context)
    wrong = [typed[name] for name in ("new", "region", "margin_m", "aggregate_preset") if photographs is not None and name in typed]
    if wrong:
        raise BadInput(
            f"--photographs adds photographs to one run, and {wrong[0].replace('new', 'NEW')} joins models: leave one of them out."
        )
    if photographs is not None:
        with show_starting():
            from radiant_app.commands.plan.added_photographs import AddedRequest, extend_by_photographs

        added = AddedRequest(run=run_folder, photographs=photographs, out=out, num_epochs=epochs)
        return finish(extend_by_photographs(added, terminal_display()), as_json, OF_GAUSSIANS)
    wrong = [typed[name] for name in (("region", "margin_m") if new is None else ("aggregate_preset",)) if name in typed]
    if wrong and new is None:
        raise BadInput(f"{wrong[0]} is of a new region: name the run of that region too, radiant join RUN NEW.")
    if wrong:
        raise BadInput(f"{wrong[0]} is for joining one run again, and {new} is a second: leave one of them out.")
    with show_starting():
        from radiant_app.commands.model.aggregate import aggregate
        from radiant_app.commands.model.extend import ExtendRequest, extend

    if new is None:
        return finish(aggregate(run_folder, out, aggregate_preset, epochs, terminal_display()), as_json)
    request = ExtendRequest(old=run_folder, new=new, out=out, region=region, margin_m=margin_m, num_epochs=epochs)
    return finish(extend(request, terminal_display()), as_json, OF_GAUSSIANS)


def _print_result(out: Path, result: dict[str, Any], num_hidden: int) -> None:
    print_model(out / "scene.ply", result)
    if num_hidden:
        typer.echo(f"decisions: {num_hidden}, in {out / 'manifest.json'}; -v prints them here")
    typer.echo(f"next: radiant inspect {quote(str(out))}")


def _options_of(preset: Preset, numbers: Mapping[str, int | None], settings: Sequence[str]) -> TrainOptions:
    """The preset with the numbers that were typed and what `--set` says."""
    typed = {f"train.{name}": value for name, value in numbers.items() if value is not None}
    return train_options({"train.preset": preset, **with_settings(typed, settings, "train")})
