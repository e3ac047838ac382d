"""`radiant train`: its options; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiant_app.cli.config_options import option
from radiant_app.cli.option_types import (
    AsJson,
    ContradictionsOption,
    DistanceOption,
    FilmFramesOption,
    HeightOption,
    LongSide,
    MaskFolder,
    MaskIgnoresOption,
    PosesOption,
    RefinePosesOption,
    Seed,
    TrainPresetOption,
    UpOption,
    Verbose,
)
from radiant_app.config.fields import train_options, with_settings
from radiant_app.quantities import bytes_of, seconds_of
from radiant_app.report.tables import finish, print_model

if TYPE_CHECKING:
    from radiant_app.config.run_config import TrainOptions
    from radiant_core.train.config import Preset


def train(
    scene: Annotated[Path, typer.Argument(help="A run, a folder of `radiant sfm`, a COLMAP project, photographs, a film.")],
    out: Annotated[
        Path, typer.Option("--out", help="Folder of model, figures, pictures; or MODEL.ply, of a run or scene.", show_default=False)
    ],
    train_preset: TrainPresetOption = "default",
    time: Annotated[str | None, typer.Option(help="End training after this time: 90, 90s, 5m, 1h.")] = None,
    steps: Annotated[int | None, option("train.num_steps", help="End training after so many steps.")] = None,
    gaussians: Annotated[
        int | None, option("train.max_num_splats", "--gaussians", "--max-splats", help="Upper limit of Gaussians.")
    ] = None,
    memory: Annotated[
        str | None, typer.Option(help="What it may hold: 600MB, 2GB; limits Gaussians, and bounds finding features.", show_default=False)
    ] = None,
    validate: Annotated[
        bool | None, typer.Option(help="An eighth of the training photographs only picks the best model.", show_default="from 100 on")
    ] = None,
    long_side_px: LongSide = None,
    masks: MaskFolder = None,
    poses: PosesOption = None,
    refine_poses: RefinePosesOption = False,
    mask_ignores: MaskIgnoresOption = None,
    film_frames: FilmFramesOption = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    contradictions: ContradictionsOption = "stop",
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Any field of TrainConfig: train.PATH=VALUE, such as train.sky=false; repeatable.")
    ] = None,
    seed: Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the training in --out from its last checkpoint.")] = False,
    checkpoint_every: Annotated[str, option("execution.checkpoint_every_s", help="Time between two checkpoints.")] = "10s",
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """One model from all photographs of a scene but every 8th, which score it; without regions."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.run import train as commands
        from radiant_core.sfm.intake import Intake

    options = _options_of(train_preset, {"long_side_px": long_side_px, "num_steps": steps, "max_num_splats": gaussians}, settings or [])
    request = commands.TrainRequest(
        source=scene,
        out=out,
        preset=options.preset,
        overrides=options.overrides,
        time_s=None if time is None else seconds_of(time),
        masks=masks,
        poses=poses,
        refine_poses=refine_poses,
        intake=Intake(mask_ignores=mask_ignores, film_frames=film_frames),
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


def _print_result(out: Path, result: dict[str, Any], num_hidden: int) -> None:
    print_model(out / "scene.ply", result)
    if num_hidden:
        typer.echo(f"decisions: {num_hidden}, in {out / 'manifest.json'}; -v prints them here")
    typer.echo(f"next: radiant inspect {quote(str(out))}")


def _options_of(preset: Preset, numbers: Mapping[str, int | None], settings: Sequence[str]) -> TrainOptions:
    """The preset with the numbers that were typed and what `--set` says."""
    typed = {f"train.{name}": value for name, value in numbers.items() if value is not None}
    return train_options({"train.preset": preset, **with_settings(typed, settings, "train")})
