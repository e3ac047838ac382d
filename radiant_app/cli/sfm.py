"""The options of `radiant sfm`; heavy libraries are imported inside, as in `cli`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli import option_types as options
from radiant_app.cli.option_types import AsJson, DistanceOption, HeightOption, MaskFolder, MatchingOption, Out, UpOption
from radiant_app.report.tables import finish, print_scene


def sfm(
    source: Annotated[
        Path,
        typer.Argument(help="Photographs, an alignment beside them, a film, a COLMAP project, a Mill 19 folder.", show_default=False),
    ],
    out: Out,
    matching: MatchingOption = "auto",
    effort: options.EffortOption = "auto",
    masks: MaskFolder = None,
    poses: options.PosesOption = None,
    refine_poses: options.RefinePosesOption = False,
    mask_ignores: options.MaskIgnoresOption = None,
    film_frames: options.FilmFramesOption = None,
    up: UpOption = None,
    distance: DistanceOption = None,
    height: HeightOption = None,
    north: options.NorthOption = None,
    gcp: options.GcpOption = None,
    gcp_accuracy: options.GcpAccuracyOption = None,
    check_points: options.CheckPointsOption = None,
    require_grids: options.RequireGridsOption = False,
    contradictions: options.ContradictionsOption = "stop",
    resume: Annotated[bool, typer.Option("--resume", help="Go on in --out: features and matches are kept.")] = False,
    as_json: AsJson = False,
) -> None:
    """Structure from motion alone: cameras and sparse points, undistorted photographs."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.run import steps as commands
        from radiant_app.config.run_config import SfmOptions
        from radiant_core.sfm.config import SfmConfig

    placed = SfmOptions(
        mask_ignores=mask_ignores,
        film_frames=film_frames,
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
