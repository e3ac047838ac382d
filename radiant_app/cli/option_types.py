"""Options that several commands have; those of a run are its fields' own, the others stand here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.config_options import option
from radiant_core.aggregate.config import AggregatePreset
from radiant_core.choices import Contradictions, CutBy, Effort, Heights, LpipsNetwork, MaskIgnores, Matching, PlanMethod
from radiant_core.train.config import Preset

PlanSource = Annotated[
    Path, typer.Argument(help="Waypoints (CSV, GeoJSON, KML), photographs with GPS, a scene, a run.", show_default=False)
]
PlanSettings = Annotated[
    list[str] | None, typer.Option("--set", help="d and T_thres of Alg. 1: plan.boundary_step=0.02, plan.threshold=0.1; repeatable.")
]
GroundOption = Annotated[float | None, typer.Option("--ground", help="Altitude of the ground in the waypoints' metres, else 0.")]
FieldOfViewOption = Annotated[float, typer.Option("--field-of-view", help="Degrees across an image, before capture.")]
BufferOption = Annotated[
    str | None,
    typer.Option("--buffer", help="Capture what a neighbour has too where it sees 20% of this region, or stands within 15m of it."),
]
DeadlineOption = Annotated[float | None, typer.Option("--deadline", min=0, help="Seconds within which an edge takes buffer captures.")]
CutByOption = Annotated[CutBy, option("plan.cut_by")]
RasterCellOption = Annotated[float | None, option("plan.raster_cell_m")]
CrsOption = Annotated[
    str | None,
    typer.Option("--crs", metavar="EPSG:NNNN[+MMMM]", help="Coordinate system of the file, +MMMM its vertical datum; PROJ strings, WKT."),
]
FileCrsOption = Annotated[
    str | None,
    typer.Option(
        "--crs",
        metavar="EPSG:NNNN[+MMMM]",
        help="Coordinate system of the file, +MMMM its vertical datum; PROJ strings, WKT; given: that of the COLMAP model.",
    ),
]
WholeLinesOption = Annotated[
    float | None, typer.Option(min=1, help="Devices fly whole lines where the makespan stays within so many times the shortest: 1.05.")
]
FlightFormatOption = Annotated[
    str | None, typer.Option(metavar="kmz,plan,kml", help="Flight lists beside CSV: DJI (WPML in KMZ), QGroundControl, KML.")
]
HeightsOption = Annotated[Heights | None, typer.Option(help="What heights in these lists count from; else take-off where that is known.")]
FlightHeightOption = Annotated[float | None, typer.Option("--height", help="Metres above take-off at which all waypoints are flown.")]
MinHeightOption = Annotated[
    float | None, typer.Option("--min-height", help="Least metres above take-off or ground in lists, else more than 0.")
]
MaxHeightOption = Annotated[
    float | None, typer.Option("--max-height", help="Most metres above take-off or ground in lists, else 120, the usual limit.")
]
GeoidOption = Annotated[
    float | None,
    typer.Option("--geoid", help="Metres that sea level lies above the WGS84 ellipsoid there."),
]
SpeedOption = Annotated[float, typer.Option(min=0.1, max=100, help="Metres a second in the air, for flight times and lists.")]
BatteryOption = Annotated[str, typer.Option(help="Time in the air on one battery, reserve taken off.")]
ImageWidthOption = Annotated[int, typer.Option("--image-width-px", min=16, help="Width of the images, for the ground sampling distance.")]
SizeOption = Annotated[str, typer.Option("--size", metavar="WxH", help="Width and height of a picture in px.")]
UpOption = Annotated[str | None, option("sfm.up")]
DistanceOption = Annotated[str | None, option("sfm.distance")]
HeightOption = Annotated[float | None, option("sfm.height_m")]
NorthOption = Annotated[str | None, option("sfm.north")]
GcpOption = Annotated[Path | None, option("sfm.gcp")]
GcpAccuracyOption = Annotated[str | None, option("sfm.gcp_accuracy")]
CheckPointsOption = Annotated[str | None, option("sfm.check_points")]
ContradictionsOption = Annotated[Contradictions, option("sfm.contradictions")]
RequireGridsOption = Annotated[bool, option("sfm.require_grids")]
RequireCrsGridsOption = Annotated[
    bool, typer.Option("--require-grids", help="Refuse a --crs whose best transformation lacks a grid; else a warning tells the metres.")
]
MatchingOption = Annotated[Matching, option("sfm.matching")]
EffortOption = Annotated[Effort, option("sfm.effort")]
MaskFolder = Annotated[Path | None, option("sfm.masks")]
PosesOption = Annotated[Path | None, option("sfm.poses")]
RefinePosesOption = Annotated[bool, option("sfm.refine_poses")]
MaskIgnoresOption = Annotated[MaskIgnores | None, option("sfm.mask_ignores")]
FilmFramesOption = Annotated[int | None, option("sfm.film_frames")]
SystemFile = Annotated[Path | None, option("system")]
PlanMethodOption = Annotated[PlanMethod, option("plan.method")]
TrainPresetOption = Annotated[Preset, option("train.preset")]
LongSide = Annotated[int | None, option("train.long_side_px")]
NumSteps = Annotated[int | None, option("train.num_steps")]
MaxSplats = Annotated[int | None, option("train.max_num_splats")]
AggregatePresetOption = Annotated[AggregatePreset, option("aggregate.preset")]
LpipsWeights = Annotated[Path | None, option("evaluate.lpips_weights")]
LpipsNet = Annotated[LpipsNetwork, option("evaluate.lpips_network")]
Seed = Annotated[int, option("seed")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print every decision too; the report holds them in any case.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object for a machine to read.")]
Out = Annotated[Path, typer.Option("--out", help="Where the result is written; must not exist or be empty.", show_default=False)]
